"""Learning curves, and the folders of trainings that they are in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from packit_sim.core import typed_json
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
        """Return the point in JSON's types."""
        return asdict(self)

    @classmethod
    def from_json(cls, raw: Any) -> Point:
        """Read a point. Raises CurveError that names the field that is wrong."""
        return typed_json.convert(raw, cls, CurveError, "a point")


@dataclass(frozen=True)
class Trained:
    """A training, as its folder records it.

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
        settings = _read(folder / SETTINGS_FILE, _Settings, "the settings", "at the start")
        curve = _read(folder / CURVE_FILE, _Curve, "the curve", "at the first validation")
        return cls(folder, dict(_flat(settings.settings)), curve)


class _Settings(Struct):
    """The content of `settings.json`."""

    settings: dict[str, Any]


_Curve = Annotated[tuple[Point, ...], Meta(min_length=1)]


def _read(file: Path, kind: Any, what: str, when: str) -> Any:
    try:
        return typed_json.decode(file.read_bytes(), kind, CurveError, what)
    except OSError as error:
        raise CurveError(
            f"{file.parent} is no folder of a training: {file.name} can't be read: "
            f"{error.strerror}; `packit train` writes it {when}"
        ) from None
    except CurveError as error:
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
