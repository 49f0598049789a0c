"""Learning curves, and the folders of trainings that they are in."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from packit_sim.core.confidence import Estimate
from packit_sim.core.errors import PackItError

SETTINGS_FILE = "settings.json"
CURVE_FILE = "curve.json"


class CurveError(PackItError, ValueError):
    """A folder that holds no training, or one that is damaged."""


@dataclass(frozen=True)
class Point:
    """A point of a learning curve: after so many steps.

    reward: mean return of the latest training episodes, None before one has ended. validation:
    Average Reward on the validation tasks, without chance.
    """

    steps: int
    reward: float | None
    validation: Estimate

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Point:
        """Raises KeyError, TypeError or ValueError where it is no point."""
        reward, validation = told["reward"], told["validation"]
        low, high = (validation[end] for end in ("low", "high"))
        return cls(
            int(told["steps"]),
            None if reward is None else float(reward),
            Estimate(
                float(validation["mean"]),
                None if low is None else float(low),
                None if high is None else float(high),
            ),
        )


@dataclass(frozen=True)
class Trained:
    """What a training's folder tells.

    settings: all of them by name, those of a part as PART.NAME. curve: at least one point.
    """

    folder: Path
    settings: Mapping[str, Any]
    curve: tuple[Point, ...]

    @property
    def best(self) -> Point:
        """The point with the highest validation reward, the first of equal ones."""
        return max(self.curve, key=lambda point: point.validation.mean)

    @classmethod
    def read(cls, folder: Path) -> Trained:
        """Raises CurveError that names the file, and what it must be."""
        settings = _read(folder / SETTINGS_FILE, "`packit train` writes it at the start")
        curve = _read(folder / CURVE_FILE, "`packit train` writes it at the first validation")
        if not isinstance(settings, dict) or not isinstance(settings.get("settings"), dict):
            raise CurveError(
                f"{folder / SETTINGS_FILE}: field 'settings' must be an object of settings by name"
            )
        if not isinstance(curve, list) or not curve:
            raise CurveError(f"{folder / CURVE_FILE} must be a list of at least one point")
        points = []
        for n, told in enumerate(curve):
            try:
                points.append(Point.from_json(told))
            except (KeyError, TypeError, ValueError) as error:
                raise CurveError(
                    f"{folder / CURVE_FILE}, point {n} is no point of a learning curve: {error!r}"
                ) from None
        return cls(folder, dict(_flat(settings["settings"])), tuple(points))


def _read(file: Path, when: str) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise CurveError(
            f"{file.parent} is no folder of a training: {file.name} can't be read: "
            f"{error.strerror}; {when}"
        ) from None
    except (ValueError, RecursionError) as error:
        raise CurveError(f"{file} is damaged: {error}") from None


def _flat(settings: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Pairs of names and values, in their order."""
    pairs: list[tuple[str, Any]] = []
    for name, value in settings.items():
        if isinstance(value, dict):
            pairs += [(f"{name}.{inner}", each) for inner, each in _flat(value)]
        else:
            pairs.append((name, value))
    return pairs
