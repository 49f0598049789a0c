"""Learning curves, and the folders of trainings that contain them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from packit_sim.core import typed_json
from packit_sim.core.confidence import Estimate
from packit_sim.core.errors import PackItError
from packit_sim.core.files import read_whole

SETTINGS_FILE = "settings.json"
CURVE_FILE = "curve.json"


class CurveError(PackItError, ValueError):
    """A folder that contains no training, or a damaged one."""


@dataclass(frozen=True)
class CurvePoint:
    """A point of a learning curve.

    Attributes
    ----------
    steps : int
        The number of training steps so far.
    reward : float | None
        The mean return of the latest training episodes; None before one has ended.
    validation : Estimate
        Average Reward on the validation tasks, with the most probable actions.
    """

    steps: int
    reward: float | None
    validation: Estimate

    def to_json(self) -> dict[str, Any]:
        """Return the point in JSON's types."""
        return asdict(self)

    @classmethod
    def from_json(cls, raw: Any) -> CurvePoint:
        """Read a point; raise CurveError if a field is wrong."""
        return typed_json.convert(raw, cls, CurveError, "a point")


@dataclass(frozen=True)
class TrainingRecord:
    """A training, as its folder records it.

    Attributes
    ----------
    settings : Mapping[str, Any]
        All settings by name; those of a part are named PART.NAME.
    curve : tuple[CurvePoint, ...]
        The learning curve, at least one point.
    """

    folder: Path
    settings: Mapping[str, Any]
    curve: tuple[CurvePoint, ...]

    @property
    def best(self) -> CurvePoint:
        """The point with the highest validation reward, the first of equal ones."""
        return max(self.curve, key=lambda point: point.validation.mean)

    @classmethod
    def read(cls, folder: Path) -> TrainingRecord:
        """Read the folder of a training; raise CurveError if a file is missing or wrong."""
        settings = _read(folder / SETTINGS_FILE, _Settings, "the settings", "at the start")
        curve = _read(folder / CURVE_FILE, _Curve, "the curve", "at the first validation")
        return cls(folder, flat(settings.settings), curve)


class _Settings(Struct):
    """The content of `settings.json`."""

    settings: dict[str, Any]


_Curve = Annotated[tuple[CurvePoint, ...], Meta(min_length=1)]


def _read(file: Path, kind: Any, what: str, when: str) -> Any:
    try:
        return typed_json.decode(read_whole(file), kind, CurveError, what)
    except OSError as error:
        raise CurveError(
            f"{file.parent} is not the folder of a training: {file.name} can't be read: "
            f"{error.strerror}; `packit train` writes it {when}"
        ) from None
    except CurveError as error:
        raise CurveError(f"{file} is damaged: {error}") from None


def flat(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings by name; those of a part are named PART.NAME."""
    named: dict[str, Any] = {}
    for name, value in settings.items():
        inner = flat(value) if isinstance(value, dict) else None
        named |= {name: value} if inner is None else {f"{name}.{k}": v for k, v in inner.items()}
    return named
