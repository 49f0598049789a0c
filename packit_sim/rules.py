"""The rules of the game: which variant of PackIt is played, and how an episode can end."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from packit_sim.box import BaseBox, Box
from packit_sim.core import typed_json
from packit_sim.core.checks import Range, as_integer, check_keywords, check_range
from packit_sim.core.choices import RotationSet
from packit_sim.core.errors import ArgumentError
from packit_sim.geometry.lattice import MAX_CELLS, Triple, box_cells
from packit_sim.geometry.rotations import COUNT
from packit_sim.geometry.shapes import Item
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.robot.cell import RobotCell

_ROTATIONS: dict[RotationSet, int] = {"all": COUNT, "yaw": 4}
"""The number of rotations of each set, which are the first ones by index."""


class End(enum.StrEnum):
    """Why an episode ended."""

    COMPLETE = "all placed"
    NO_LOCATION = "no room"
    INVALID_ACTION = "invalid action"


@dataclass(frozen=True)
class Rules:
    """The variant of the game that an episode plays.

    Parameters
    ----------
    easy : bool
        Whether a location is chosen before a rotation, as in PackIt-Easy.
    kinematic : bool
        Whether an item must come straight down from the open top to its location.
    physics : PhysicsSettings, optional
        The world in which all items settle after each placement; None keeps items on the grid.
    cells : tuple of int, optional
        Cells of the box along x, y and z; None takes those of the task.
    buffer : int, optional
        Number of visible items in the online game, in which items arrive one by one (see
        `Episode`); None is the offline game, in which all are visible.
    rotations : str
        The rotations that items may have: "all" 24, or "yaw", the four about the vertical axis.
    robot : RobotCell, optional
        The cell in which an arm packs the box, in physics; None without an arm.
    values : bool
        Whether the return is the packed share of the items' values instead of their volumes.
    support : float
        The least share of an item's base that must rest on something, from 0 to 1 (see
        docs/concepts/rules.md).
    boxes : int
        The number of boxes, which stand side by side along x: the cells along x of the grid are
        those of all of them.

    Raises
    ------
    ArgumentError
        If a value is not possible, two of `kinematic`, `physics` and `robot` are asked for, support
        or several boxes where items move, or values with a robot.

    Examples
    --------
    >>> from packit_sim import Rules
    >>> print(Rules())
    PackIt
    >>> print(Rules(easy=True, buffer=5, rotations="yaw"))
    PackIt-Easy, online with a buffer of 5, yaw rotations
    >>> print(Rules(values=True, support=0.6, boxes=2))
    PackIt, values, support 0.6, 2 boxes
    >>> Rules(buffer=0)
    Traceback (most recent call last):
        ...
    packit_sim...ArgumentError: a buffer of 0 items is not possible: choose 1 or more, ...
    """

    easy: bool = False
    kinematic: bool = False
    physics: PhysicsSettings | None = None
    cells: Triple | None = None
    buffer: int | None = None
    rotations: RotationSet = "all"
    robot: RobotCell | None = None
    values: bool = False
    support: float = 0.0
    boxes: int = 1

    def __post_init__(self) -> None:
        if self.kinematic and self.physics is not None:
            raise ArgumentError("a box is either kinematic or has physics, not both")
        if self.robot is not None and (self.kinematic or self.physics is not None):
            raise ArgumentError(
                "a robot cell has physics of its own, and its `reachable` says whether items must "
                "come from above: leave out kinematic and physics"
            )
        if self.robot is not None and self.values:
            raise ArgumentError("an arm's packing is measured by volume: leave out values")
        if self.cells is not None:
            object.__setattr__(self, "cells", box_cells(self.cells))
        if self.buffer is not None:
            object.__setattr__(self, "buffer", as_integer("buffer", self.buffer))
            if self.buffer < 1:
                raise ArgumentError(
                    f"a buffer of {self.buffer} items is not possible: choose 1 or more, or None"
                )
        if self.rotations not in _ROTATIONS:
            raise ArgumentError(
                f"rotations {self.rotations!r} are not known: choose from {', '.join(_ROTATIONS)}"
            )
        check_range("support", self.support, Range(0, 1))
        object.__setattr__(self, "support", float(self.support))
        object.__setattr__(self, "boxes", as_integer("boxes", self.boxes))
        check_range("boxes", self.boxes, Range(1))
        if self.moves_items and (self.support or self.boxes > 1):
            raise ArgumentError(
                "support and several boxes need items that stay on the grid: leave out physics "
                "and robot"
            )

    def __str__(self) -> str:
        parts = ["PackIt-Easy" if self.easy else "PackIt"]
        if self.kinematic:
            parts.append("kinematic")
        if self.physics is not None:
            changed = _changed(asdict(self.physics), asdict(PhysicsSettings()))
            parts.append(" ".join(["physics", *changed]))
        if self.cells is not None:
            parts.append(f"box of {' x '.join(map(str, self.cells))} cells")
        if self.buffer is not None:
            parts.append(f"online with a buffer of {self.buffer}")
        if self.rotations != "all":
            parts.append(f"{self.rotations} rotations")
        if self.robot is not None:
            changed = _changed(asdict(self.robot), asdict(RobotCell()))
            parts.append(" ".join(["robot", *changed]))
        if self.values:
            parts.append("values")
        if self.support:
            parts.append(f"support {self.support:g}")
        if self.boxes > 1:
            parts.append(f"{self.boxes} boxes")
        return ", ".join(parts)

    def changed(self, **changes: Any) -> Rules:
        """Return these rules with other values in some fields.

        Parameters
        ----------
        **changes : Any
            Values by the name of a field; `physics` and `robot` may also be a bool or a mapping, as
            in `from_json`.

        Returns
        -------
        Rules
            The changed rules.

        Raises
        ------
        TypeError
            If there is no rule of such a name.
        ArgumentError
            If a value is not possible, or two of `kinematic`, `physics` and `robot` are asked for.
        """
        check_keywords("Rules.changed", changes, RULES)
        changes = _with_settings(changes)
        for name in _SETTINGS:
            if isinstance(changes.get(name), Mapping):
                changes[name] = getattr(Rules.from_json({name: changes[name]}), name)
        return replace(self, **changes)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Rules:
        """Build rules from JSON or TOML.

        Parameters
        ----------
        values : Mapping
            Values by the name of a field; those that are missing keep their defaults. `physics` and
            `robot` are a mapping of their settings, true, false or null.

        Returns
        -------
        Rules
            The rules; the inverse of `dataclasses.asdict`.

        Raises
        ------
        ArgumentError
            If there is no rule or setting of such a name, or a value is not valid.
        """
        typed_json.check_names(values, cls, ArgumentError)
        return typed_json.convert(_with_settings(values), cls, ArgumentError, "rules")

    @property
    def moves_items(self) -> bool:
        """True if items may move after they were placed, off the grid."""
        return self.physics is not None or self.robot is not None

    @property
    def allowed_rotations(self) -> range:
        """The indices of the rotations that items may have."""
        return range(_ROTATIONS[self.rotations])

    def grid(self, cells: Triple) -> Triple:
        """Return the cells of the grid of all boxes.

        Parameters
        ----------
        cells : tuple of int
            Cells of the task's box along x, y and z, which `self.cells` overrides.

        Returns
        -------
        tuple of int
            The same with the cells of all boxes along x.

        Raises
        ------
        ArgumentError
            If so many boxes are too long together.
        """
        x, y, z = self.cells or cells
        if x * self.boxes > MAX_CELLS:
            raise ArgumentError(
                f"{self.boxes} boxes of {x} cells along x are not possible: together they may have "
                f"{MAX_CELLS} cells"
            )
        return x * self.boxes, y, z

    def check_items(self, cells: Triple, items: Sequence[Item]) -> None:
        """Check, before anything is simulated, that an arm can pack items.

        Parameters
        ----------
        cells : tuple of int
            Cells of the task's box along x, y and z.

        Raises
        ------
        ArgumentError
            If the arm can't reach the box, or lift an item.
        """
        if self.robot is not None:
            from packit_sim.robot.robot_box import RobotBox  # loads PyBullet

            RobotBox(self.cells or cells, self.robot).check(items)

    def by_alignment(self, item: Item) -> tuple[Item, ...]:
        """Return an item in the allowed rotations, in the order of alignment.

        Parameters
        ----------
        item : Item
            The item, in any rotation.

        Returns
        -------
        tuple of Item
            The item in each of them, the best aligned first (see `rotations.by_alignment`).
        """
        allowed = self.allowed_rotations
        return tuple(turned for turned in item.by_alignment if turned.rotation in allowed)

    def new_box(self, cells: Triple) -> BaseBox[Any]:
        """Create an empty box to pack by these rules.

        Parameters
        ----------
        cells : tuple of int
            Cells of the task's box along x, y and z, which `self.cells` overrides.

        Returns
        -------
        BaseBox
            A `Box` with the grid of all boxes, a `SettlingBox` if items settle, or a `RobotBox` if
            an arm packs it.
        """
        cells = self.grid(cells)
        if self.robot is not None:
            from packit_sim.robot.robot_box import RobotBox  # loads PyBullet

            return RobotBox(cells, self.robot)
        if self.physics is None:
            return Box(cells, kinematic=self.kinematic, support=self.support, boxes=self.boxes)
        from packit_sim.physics.settling_box import SettlingBox  # loads PyBullet

        return SettlingBox(cells, self.physics)


RULES = tuple(field.name for field in fields(Rules))
"""The names of the fields of `Rules`."""

PACKIT = Rules()
"""The rules of the paper."""


_SETTINGS = {"physics": PhysicsSettings, "robot": RobotCell}
"""The rules that are settings of their own."""


def _with_settings(values: Mapping[str, Any]) -> dict[str, Any]:
    """Replace a bool under "physics" or "robot" by default settings or None."""
    found = dict(values)
    for name, kind in _SETTINGS.items():
        if isinstance(value := values.get(name), bool):
            found[name] = kind() if value else None
    return found


def _changed(values: Mapping[str, Any], defaults: Mapping[str, Any], group: str = "") -> list[str]:
    """List the settings that are not the default as NAME=VALUE, those of a group as GROUP.NAME."""
    found = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            found += _changed(value, defaults[name], f"{group}{name}.")
        elif value != defaults[name]:
            found.append(f"{group}{name}={value!r}")
    return found
