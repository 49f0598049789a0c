"""Sequences of items that are drawn at random: tasks for the online game."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from packit_sim.core.checks import check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.packs import MAX_SCALE, ItemRecord, LibraryRef, Pack, Task
from packit_sim.game.datasets.provenance import Drawn
from packit_sim.geometry.lattice import CELL, STEP, Triple, box_cells
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.libraries.sources import SizeCm


@dataclass(frozen=True)
class SequenceSampler:
    """Draws the items of a task from a library, each shape with the same probability.

    Parameters
    ----------
    library : ShapeLibrary
        The library of shapes, or one of its splits; their real sizes must be known.
    cells : tuple of int
        Cells of the box along x, y and z.
    step_cm : float
        Length of a grid step, 4 cells, in cm.
    items : int
        Number of items of a task.

    Raises
    ------
    ArgumentError
        If a value is not possible, a shape's real size is not known or much larger than the box, or
        no shape fits into it.

    Notes
    -----
    The order in which items arrive follows from the task (see `Task.arriving`): each order is as
    likely as any other, as if shapes were drawn one by one.

    Examples
    --------
    >>> import numpy as np
    >>> from packit_sim import Episode, Rules, SequenceSampler, ShapeLibrary
    >>> library = ShapeLibrary.open("blockout")
    >>> sampler = SequenceSampler(library, cells=(20, 20, 40), step_cm=5.9, items=12)
    >>> task = sampler(np.random.default_rng(0))
    >>> len(task.items)
    12
    >>> int(Episode(task, Rules(buffer=3)).visible.sum())
    3
    """

    library: ShapeLibrary
    cells: Triple
    step_cm: float
    items: int = 50

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", box_cells(self.cells))
        check_range("items", self.items, (self.items >= 1, "1 or more"))
        check_range("step_cm", self.step_cm, (0 < self.step_cm < math.inf, "more than 0"))
        sizes = np.array([self._size_cm(id) for id in self.library])
        cells = np.ceil(np.sort(sizes) / self.step_cm * STEP - 1e-6)
        fits = (cells <= np.sort(self.cells)).all(axis=1)
        too_large = [id for id in self.library if self._scale(id) > MAX_SCALE]
        if too_large or not fits.any():
            what = f"shape {too_large[0]!r} is" if too_large else "all shapes are"
            sides = " x ".join(f"{count * self.step_cm / STEP:.4g}" for count in self.cells)
            raise ArgumentError(
                f"{what} larger than the box of {sides} cm: choose a longer step_cm or more cells"
            )

    def pack(self, seed: int) -> Pack:
        """Draw a sequence from a seed: an empty box with all items outside."""
        return self._pack(np.random.default_rng(seed), seed)

    def __call__(self, rng: np.random.Generator) -> Task:
        """Draw a task, as an environment wants it."""
        return self._pack(rng).task(self.library)

    def item(self, id: str) -> Item:
        """Return a shape of the library at its real size."""
        return Item(self.library[id], self._scale(id))

    def _pack(self, rng: np.random.Generator, seed: int | None = None) -> Pack:
        ids = self.library.ids
        drawn = [ids[n] for n in rng.integers(len(ids), size=self.items)]
        outside = tuple(ItemRecord(id, self._scale(id)) for id in drawn)
        library = LibraryRef.of(self.library)
        return Pack(library, self.cells, (), 0.0, Drawn(seed=seed), outside)

    def _scale(self, id: str) -> float:
        unit_cm = self.step_cm / (STEP * CELL)
        return (math.hypot(*self._size_cm(id)) / unit_cm) ** 3

    def _size_cm(self, id: str) -> SizeCm:
        size = self.library.info(id).size_cm
        if size is None:
            raise ArgumentError(f"the real size of shape {id!r} is not known: choose other shapes")
        return size


@dataclass(frozen=True)
class ItemSampler:
    """Draws the items of a task from those of other tasks, each with the same probability.

    They have the sizes of the items of a benchmark, and mostly more volume than fits into the box.

    Parameters
    ----------
    library : ShapeLibrary
        The library of the tasks.
    tasks : sequence of Task
        The tasks, all with the same box.
    items : int
        Number of items of a task.

    Raises
    ------
    ArgumentError
        If a value is not possible, there are no tasks, or their boxes differ.

    Examples
    --------
    >>> from packit_sim import Episode, ItemSampler, Rules, ShapeLibrary, load_tasks
    >>> library = ShapeLibrary.open("everyday")
    >>> sampler = ItemSampler(library, load_tasks("starter", library), items=12)
    >>> task = sampler.pack(seed=0).task(library)
    >>> len(task.items), int(Episode(task, Rules(buffer=3)).visible.sum())
    (12, 3)
    """

    library: ShapeLibrary
    tasks: Sequence[Task]
    items: int = 40

    def __post_init__(self) -> None:
        check_range("items", self.items, (self.items >= 1, "1 or more"))
        boxes = {task.cells for task in self.tasks}
        if len(boxes) != 1:
            raise ArgumentError(
                f"the tasks have {len(boxes)} different boxes: choose tasks with one box"
            )

    def pack(self, seed: int) -> Pack:
        """Draw a sequence from a seed: an empty box with all items outside."""
        return self._pack(np.random.default_rng(seed), seed)

    def __call__(self, rng: np.random.Generator) -> Task:
        """Draw a task, as an environment wants it."""
        return self._pack(rng).task(self.library)

    def _pack(self, rng: np.random.Generator, seed: int | None = None) -> Pack:
        items = [item for task in self.tasks for item in task.items]
        drawn = [items[n] for n in rng.integers(len(items), size=self.items)]
        outside = tuple(ItemRecord(item.shape.id, item.scale) for item in drawn)
        library = LibraryRef.of(self.library)
        return Pack(library, self.tasks[0].cells, (), 0.0, Drawn(seed=seed), outside)
