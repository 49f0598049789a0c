"""Policies for the online game of polycubes: shape, rotation and location together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, ClassVar, Self
from weakref import WeakKeyDictionary

import numpy as np

from packit_agents.online.column_kernels import plan
from packit_agents.online.columns import FORM_START
from packit_agents.online.value_tables import ValueTables
from packit_sim.core.assets import assets_folder
from packit_sim.core.errors import ArgumentError, StateError
from packit_sim.game.episodes.episode import Episode
from packit_sim.geometry.items import PlacedItem
from packit_sim.geometry.lattice import STEP, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.rules import Rules


@dataclass(frozen=True)
class Ahead:
    """How far a policy looks ahead.

    Attributes
    ----------
    depth : int
        Placements of visible shapes.
    width : int
        States that are kept after each.
    """

    depth: int
    width: int


GREEDY = Ahead(1, 1)
"""The placement with the highest value."""

SEARCH = Ahead(5, 30)
"""A beam of five placements, and the mean over what may arrive after them."""


@dataclass(frozen=True)
class _Choice:
    shape: int
    rotation: int
    location: Triple


class ColumnPlanner:
    """Finds the best placement in the present state of episodes.

    Parameters
    ----------
    tables : ValueTables
        The values of states.
    ahead : Ahead
        How far it looks.
    """

    def __init__(self, tables: ValueTables, ahead: Ahead) -> None:
        self.tables = tables
        self._ahead = ahead
        self._known: WeakKeyDictionary[Episode, tuple[tuple[PlacedItem, ...], _Choice]] = (
            WeakKeyDictionary()
        )

    def action(self, episode: Episode) -> int:
        """Choose the action of the episode's stage that leads to the best placement.

        Returns
        -------
        int
            An index into the action mask.

        Raises
        ------
        ArgumentError
            If the values are for another box, other rules or other shapes.
        StateError
            If another policy has chosen another shape, rotation or location.
        """
        placed = tuple(episode.box.placed)
        known = self._known.get(episode)
        if known is None or known[0] != placed:
            known = self._known[episode] = placed, self._choose(episode)
        choice = known[1]
        wanted = choice.shape, choice.rotation, choice.location
        chosen = episode.shape, episode.rotation, episode.location
        if any(own not in (None, best) for own, best in zip(chosen, wanted, strict=True)):
            raise StateError(
                "values of columns choose the shape, the rotation and the location together: name "
                "the agent alone, not next to others, and without a search"
            )
        location = int(np.ravel_multi_index(choice.location, episode.box.nodes))
        return (choice.shape, choice.rotation, location)[episode.stage]

    def _choose(self, episode: Episode) -> _Choice:
        game = self.tables.game
        self._check(episode.rules, episode.box.cells)
        visible = np.flatnonzero(episode.visible).tolist()
        shapes = [self._shape(episode.task.items[n]) for n in visible]
        counts = np.bincount(shapes, minlength=len(game.shapes))
        heights = game.heights(episode.box.placed)
        buffer = episode.rules.buffer or len(visible)
        plies = 0 if self._ahead == GREEDY else 2 if len(visible) == 1 else 1
        found, _ = plan(
            heights,
            counts,
            np.empty(0, dtype=np.int64),
            game.arrays,
            self.tables.arrays(buffer),
            min(self._ahead.depth, len(visible)),
            self._ahead.width,
            plies,
        )
        shape, form, x, y = found.tolist()
        row = game.forms[form]
        columns = row[FORM_START : FORM_START + 4 * row[4]].reshape(-1, 4)
        below = heights.reshape(game.sides[:2])[x + columns[:, 0], y + columns[:, 1]]
        base = max(0, int((below - columns[:, 2]).max()))
        return _Choice(visible[shapes.index(shape)], int(row[0]), (x, y, base))

    def _shape(self, item: Item) -> int:
        shape = self.tables.game.shape(item)
        if shape is None:
            raise ArgumentError(
                f"shape {item.shape.id!r} is none of the {len(self.tables.game.shapes)} that these "
                "values of columns are for: choose another agent, or train one with it"
            )
        return shape

    def _check(self, rules: Rules, cells: Triple) -> None:
        game = self.tables.game
        wanted = Rules(
            kinematic=True, easy=rules.easy, buffer=rules.buffer, rotations=game.rotations
        )
        if rules.changed(cells=None, values=False) != wanted:
            raise ArgumentError(
                f"these values of columns are for the rules {wanted}, not for {rules}"
            )
        if tuple(count / STEP for count in cells) != game.sides:
            own = " x ".join(str(side * STEP) for side in game.sides)
            raise ArgumentError(
                f"these values of columns are for a box of {own} cells, not of "
                f"{' x '.join(map(str, cells))}"
            )


class ColumnPolicy:
    """The placement with the highest value of the columns' heights, of all visible polycubes.

    Parameters
    ----------
    file : Path or str
        The tables, of `ValueTables.write`.
    """

    _ahead: ClassVar[Ahead] = GREEDY

    def __init__(self, file: Path | str) -> None:
        self._file = Path(file)
        self._planner = _planner(self._file.resolve(), self._ahead)
        self.weights_digest = self._planner.tables.digest

    @classmethod
    def parse(cls, value: str) -> Self:
        """Load the tables of a file.

        Parameters
        ----------
        value : str
            Path of the file.

        Returns
        -------
        Self
            The policy.

        Raises
        ------
        TensorFileError
            If the file can't be loaded.
        """
        return cls(value)

    def __call__(self, episode: Episode, rng: np.random.Generator) -> int:
        return self._planner.action(episode)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._file,)


class ColumnPolicyAhead(ColumnPolicy):
    """The same, looking ahead over the visible polycubes and the mean of what may arrive."""

    _ahead = SEARCH


@cache
def _planner(file: Path, ahead: Ahead) -> ColumnPlanner:
    """Share a planner between the three policies of an agent."""
    return ColumnPlanner(ValueTables.read(file), ahead)


_BLOCKOUT = assets_folder() / "weights" / "blockout.safetensors"


@cache
def bundled_tables() -> ValueTables:
    """Read the bundled values of columns, of BlockOut, once per process."""
    return ValueTables.read(_BLOCKOUT)


BLOCKOUT = partial(ColumnPolicy, _BLOCKOUT)
"""The placement with the highest value in BlockOut, by bundled values of columns."""

BLOCKOUT_AHEAD = partial(ColumnPolicyAhead, _BLOCKOUT)
"""The same, looking ahead over the visible polycubes and the mean of what may arrive."""
