"""The folder of a training: its settings, its learning curve and its weights."""

from __future__ import annotations

import json
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from packit_sim.core import typed_json
from packit_sim.core.errors import PackItError, located
from packit_sim.core.files import claimed, replace_text, require_free
from packit_sim.core.version import __version__
from packit_sim.game.evaluation.learning_curves import CURVE_FILE, SETTINGS_FILE, CurvePoint, flat

if TYPE_CHECKING:
    from packit_agents.learning.actor_critic import ActorCritic

_WRITTEN = ("best.safetensors", "last.safetensors", "last.npz", "curve.png")
"""Files that trainings write into the folder, in addition to those that are named here."""


class TrainingError(PackItError, ValueError):
    """A training that can't be started or resumed as requested."""


class RunFolder:
    """A new folder, or that of a training with the same settings.

    Parameters
    ----------
    provenance : dict
        The settings, and the digests of the tasks and the library, in JSON's types.

    Raises
    ------
    TrainingError
        If the folder holds a training with other settings.
    ArgumentError
        If it holds none, but files that would be replaced.
    """

    def __init__(self, path: Path, provenance: dict[str, Any]) -> None:
        self._path = path
        self._provenance = provenance
        self.checkpoint = path / "checkpoint.pt"
        self.dagger_dataset = path / "dagger_dataset"
        self.logs = path / "tensorboard"
        file = path / SETTINGS_FILE
        if not file.exists():
            own = (self.checkpoint, self.dagger_dataset, self.logs)
            require_free(path, (*_WRITTEN, CURVE_FILE, *(each.name for each in own)))
            path.mkdir(parents=True, exist_ok=True)
            replace_text(file, json.dumps(provenance, indent=1) + "\n")
            return
        with located(f"{file} can't be read", TrainingError):
            found = typed_json.decode(file.read_bytes(), dict[str, Any], TrainingError)
        if found != provenance:
            old, new = flat(found), flat(provenance)
            names = [name for name in {**new, **old} if old.get(name) != new.get(name)]
            raise TrainingError(
                f"{path} holds a training with another {', '.join(names)}: choose another folder"
            )

    def claim(self) -> AbstractContextManager[None]:
        """Keep other processes out of the folder within a `with` block, or raise BusyError."""
        return claimed(self._path / ".lock", self._path)

    def write_curve(self, curve: list[CurvePoint]) -> None:
        """Write the learning curve."""
        content = json.dumps([point.to_json() for point in curve], indent=1)
        replace_text(self._path / CURVE_FILE, content + "\n")

    def write_weights(self, name: str, policy: ActorCritic, point: CurvePoint) -> None:
        """Write the weights of the policy network.

        Parameters
        ----------
        name : str
            "best" or "last".
        policy : ActorCritic
            The networks.
        point : CurvePoint
            The validation point of the weights.
        """
        provenance = {"version": __version__, **self._provenance, "point": point.to_json()}
        policy.write_weights(self._path / f"{name}.safetensors", provenance)
