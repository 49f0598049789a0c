"""Settings of environments in JSON's types, so that Gymnasium's specs can be written."""

from __future__ import annotations

import copy
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gymnasium.envs.registration import EnvSpec

from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.rules import Rules


class WritableSpec:
    """A base of environments with a spec whose settings are in JSON's types, as far as they can be.

    A library becomes a record of its name, path and digest (see `ShapeLibrary.to_json`). Tasks and
    policies that are objects stay what they are: such a spec can't be written.
    """

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """The spec that creates the environment, of `gymnasium.make`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = copy.copy(spec)
            spec.kwargs = {name: _plain(value) for name, value in spec.kwargs.items()}
        self._spec = spec


def _plain(value: Any) -> Any:
    if isinstance(value, ShapeLibrary):
        return value.to_json()
    if isinstance(value, Rules | PhysicsSettings):
        return asdict(value)
    return str(value) if isinstance(value, Path) else value
