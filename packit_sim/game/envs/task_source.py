"""Tasks of an environment: given, from a dataset, or generated on the fly."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from packit_sim.core.checks import as_integer
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.builtin import DEFAULT_LIBRARY
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.generation.task_sampler import TaskSampler
from packit_sim.geometry.lattice import BOX_CELLS, Triple
from packit_sim.libraries.library import ShapeLibrary

FRESH = "fresh"
"""The name of tasks that are generated on the fly."""

T = TypeVar("T")

GENERATED = -1
"""The number of a task that does not belong to the source."""

TaskMaker = Callable[..., Task]
"""A function that makes a task with a random generator. If it has a parameter `episode`, it also
gets the number of the environment's episode, from 0."""

Order = Literal["random", "cycle"] | Sequence[float] | Callable[..., int]
"""What is next: a task at random, the one after the last, one drawn by these weights, or the one
whose number the function returns, which is called like a `TaskMaker`."""


class TaskSource:
    """The tasks that an environment plays, and which of them is next.

    Parameters
    ----------
    tasks : str, Path, sequence of Task, or callable
        The same argument as for `PackItEnv`.
    library : str, Path, mapping or ShapeLibrary, optional
        The same argument as for `PackItEnv`.
    split : str, optional
        Split of the dataset, or of the library for fresh tasks.
    order : str, sequence of float, or callable
        The same argument as for `PackItEnv`.
    cells : tuple of int, optional
        Cells of the box of fresh tasks.

    Attributes
    ----------
    tasks : tuple of Task
        The tasks; empty if they are generated on the fly.
    maker : callable, optional
        The function that generates tasks with a random generator, if they are.

    Raises
    ------
    ArgumentError
        If there are no tasks, or a split or an order does not apply.
    """

    def __init__(
        self,
        tasks: str | Path | Sequence[Task] | TaskMaker,
        library: str | Path | Mapping[str, Any] | ShapeLibrary | None,
        split: str | None,
        order: Order,
        cells: Triple | None,
    ) -> None:
        self.tasks: tuple[Task, ...] = ()
        self.maker: TaskMaker | None = None
        self._order = order
        if isinstance(tasks, str | Path):
            if isinstance(library, str | Path):
                library = ShapeLibrary.open(library)
            elif isinstance(library, Mapping):
                library = ShapeLibrary.from_json(library)
            if tasks != FRESH:
                self.tasks = load_tasks(tasks, library, split)
            else:
                shapes = library or ShapeLibrary.open(DEFAULT_LIBRARY)
                shapes = shapes.split(split) if split else shapes
                self.maker = TaskSampler(shapes, EvolutionSettings(cells=cells or BOX_CELLS))
        elif split is not None:
            raise ArgumentError(f"split {split!r} is of a dataset or a library: tasks have none")
        elif callable(tasks):
            self.maker = tasks
        elif not tasks:
            raise ArgumentError("an environment needs a task, or a function that makes them")
        else:
            self.tasks = tuple(tasks)
        self._weights = self._checked_weights()

    @property
    def cells(self) -> Triple:
        """Cells of the box of all tasks; the benchmark's box if they are generated.

        Raises ArgumentError if the boxes of the tasks differ.
        """
        boxes = {task.cells for task in self.tasks} or {BOX_CELLS}
        if len(boxes) != 1:
            raise ArgumentError(
                f"the tasks of an environment must share one box, not {sorted(boxes)}: "
                "give `cells` to say which"
            )
        return boxes.pop()

    def named(self, wanted: Task | int) -> tuple[Task, int]:
        """Return the task that a caller names.

        Parameters
        ----------
        wanted : Task or int
            A task, or the number of one.

        Returns
        -------
        task : Task
            The task.
        number : int
            Its number, or `GENERATED` if it was given itself.

        Raises
        ------
        ArgumentError
            If there is no task of the number, or it is not an integer.
        """
        if isinstance(wanted, Task):
            return wanted, GENERATED
        number = as_integer("task", wanted)
        if number not in range(len(self.tasks)):
            hint = (
                f"choose 0 to {len(self.tasks) - 1}"
                if self.tasks
                else "tasks are generated on the fly"
            )
            raise ArgumentError(f"there is no task {number}: {hint}")
        return self.tasks[number], number

    def draw(self, last: int, episode: int, rng: np.random.Generator) -> tuple[Task, int]:
        """Choose the task of the next episode.

        Parameters
        ----------
        last : int
            The number of the last task.
        episode : int
            The number of the next episode.

        Returns
        -------
        task : Task
            The task.
        number : int
            Its number, or `GENERATED`.
        """
        if self.maker is not None:
            return _call(self.maker, rng, episode), GENERATED
        if callable(self._order):
            return self.named(_call(self._order, rng, episode))
        if self._weights is not None:
            number = int(rng.choice(len(self.tasks), p=self._weights))
        elif self._order == "cycle":
            number = (last + 1) % len(self.tasks)
        else:
            number = int(rng.integers(len(self.tasks)))
        return self.tasks[number], number

    def _checked_weights(self) -> npt.NDArray[np.float64] | None:
        """Return the probability of each task if the order is one of weights, or None."""
        is_name = isinstance(self._order, str)
        if self.maker is not None and not (is_name and self._order == "random"):
            raise ArgumentError(
                f"order {self._order!r:.80} has no effect on tasks that are generated: leave it out"
            )
        if callable(self._order) or (is_name and self._order in ("random", "cycle")):
            return None
        try:
            weights = np.array(self._order, dtype=np.float64)
            total = weights.sum()
            is_one_each = weights.shape == (len(self.tasks),)
            if not (is_one_each and (weights >= 0).all() and 0 < total < np.inf):
                raise ValueError
        except (TypeError, ValueError):
            raise ArgumentError(
                f"order {self._order!r:.80} is not possible: choose random, cycle, a function, or "
                f"a weight for each of the {len(self.tasks)} tasks: 0 or more, and not all 0"
            ) from None
        return weights / total


def _call(function: Callable[..., T], rng: np.random.Generator, episode: int) -> T:
    """Call a function with a generator, and with the episode's number if it asks for it."""
    if "episode" in inspect.signature(function).parameters:
        return function(rng, episode=episode)
    return function(rng)
