"""The packs that the explorer shows: those of a dataset, or results of agents on its tasks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from packit_sim.box import Box
from packit_sim.core.caches import cached_property
from packit_sim.core.errors import PackItError
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.pack_files import dataset_file, dataset_library, read_packs
from packit_sim.game.datasets.packs import Pack, Task
from packit_sim.game.datasets.provenance import UNKNOWN_PROVENANCE, Densified, Evolved, Played
from packit_sim.game.evaluation.results import ResultsError, Rollout, stored_trajectory
from packit_sim.geometry.items import BoxState, PlacedItem, PosedItem
from packit_sim.geometry.lattice import Triple
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.robot.trajectory import Trajectory
from packit_sim.rules import PACKIT, Rules


@dataclass(frozen=True)
class PackView:
    """A packed box and the items that were left outside.

    Attributes
    ----------
    title : str
        A unique title.
    name : str
        The title above the box.
    facts : tuple[tuple[str, str], ...]
        Names and values, as text.
    cells : Triple
        Cells along each axis of the box.
    placed : tuple[PlacedItem | PosedItem, ...]
        The items in the box, on the grid or where they settled, in the order of placing.
    outside : tuple[Item, ...]
        The other items, in canonical orientation.
    total : float
        Volume of all items of the task, in box units cubed: rewards are shares of it.
    rules : Rules
        The rules of the episode; those of the paper for packs that no agent packed.
    values : tuple of float
        The value of each item, if the rules count values.
    has_arm : bool
        Whether an arm packed it, of which a trajectory was recorded.
    """

    title: str
    name: str
    facts: tuple[tuple[str, str], ...]
    cells: Triple
    placed: tuple[PlacedItem | PosedItem, ...]
    outside: tuple[Item, ...]
    total: float
    rules: Rules = PACKIT
    values: tuple[float, ...] = ()
    has_arm: bool = False

    @cached_property
    def items(self) -> tuple[Item, ...]:
        """All items: the placed ones in order, then those outside."""
        return tuple(placed.item for placed in self.placed) + self.outside

    def reward(self, number: int) -> float:
        """Return an item's reward: its share of the volume, or of the value, of all items."""
        if self.values:
            return self.values[number] / plain_sum(self.values)
        return self.items[number].volume / self.total

    @cached_property
    def is_on_grid(self) -> bool:
        """True if all items in the box have a location on the grid."""
        return all(isinstance(placed, PlacedItem) for placed in self.placed)

    def contents(self) -> BoxState[PlacedItem | PosedItem]:
        """Return the content of the box."""
        return BoxState(self.cells, self.placed)

    def box(self, step: int) -> Box:
        """Return the box after a number of items were placed, all of which must be on the grid."""
        placed = tuple(one for one in self.placed[:step] if isinstance(one, PlacedItem))
        rules = self.rules
        box = Box(self.cells, kinematic=rules.kinematic, support=rules.support, boxes=rules.boxes)
        box.restore(BoxState(self.cells, placed))
        return box

    def same(self, item: Item) -> frozenset[int]:
        """Return the numbers of placed items that have the shape and the scale of an item."""
        return frozenset(
            n
            for n, placed in enumerate(self.placed)
            if (placed.item.shape, placed.item.scale) == (item.shape, item.scale)
        )


@dataclass(frozen=True)
class _Entry:
    """A pack, the number of its task, and whether the pack is the task's solution."""

    pack: Pack
    task: int | None = None
    is_truth: bool = False


class PackCollection:
    """A sequence of packs to show, each loaded when it is first needed.

    Parameters
    ----------
    packs : Sequence[Pack]
        Packs of a dataset, or results.
    tasks : Sequence[Pack]
        The packs of the tasks that agents played: they show which items were left outside, and
        follow the results in the sequence.
    file : Path, optional
        The file of the packs, next to which trajectories of an arm are.

    Examples
    --------
    >>> from packit_sim import PackCollection
    >>> collection = PackCollection.read("starter")
    >>> len(collection)
    10
    >>> collection.titles[0]
    '0: 35 items, density 0.431'
    >>> view = collection[0]
    >>> len(view.placed), round(view.reward(0), 3)
    (35, 0.347)
    """

    def __init__(
        self,
        packs: Sequence[Pack],
        library: ShapeLibrary,
        tasks: Sequence[Pack] = (),
        file: Path | None = None,
    ) -> None:
        self._library = library
        self._tasks = tasks
        self._file = file
        self._entries = [_Entry(pack, _task_of(pack)) for pack in packs]
        played = dict.fromkeys(e.task for e in self._entries if e.task is not None)
        for number in played if tasks else ():
            if number >= len(tasks):
                raise ResultsError(
                    f"the results are of task {number}, and the tasks given are 0 to "
                    f"{len(tasks) - 1}: choose the dataset that was played"
                )
            self._entries.append(_Entry(tasks[number], number, is_truth=True))
        self.titles = tuple(f"{n}: {_title(entry)}" for n, entry in enumerate(self._entries))

    @classmethod
    def read(
        cls,
        source: Path | str,
        library: ShapeLibrary | None = None,
        split: str | None = None,
        tasks: Path | str | None = None,
        tasks_split: str | None = None,
    ) -> PackCollection:
        """Read a dataset or results, and the tasks that were played.

        Parameters
        ----------
        source : Path or str
            The dataset or results (see `dataset_file`).
        library : ShapeLibrary, optional
            The library of the shapes; by default the one that the dataset records.
        split : str, optional
            A split of the dataset.
        tasks : Path or str, optional
            The dataset that was played.
        tasks_split : str, optional
            A split of that dataset.

        Returns
        -------
        PackCollection
            The packs.
        """
        file = dataset_file(source, split)
        packs = read_packs(file)
        library = library or dataset_library(file)
        played = [] if tasks is None else read_packs(dataset_file(tasks, tasks_split))
        return cls(packs, library, played, file)

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, number: int) -> PackView:
        """Load a pack; raise PackItError if there is no such number, or a shape is unknown."""
        if not 0 <= number < len(self):
            raise PackItError(f"there is no pack {number}: choose 0 to {len(self) - 1}")
        entry = self._entries[number]
        pack = entry.pack
        placed = pack.placed(self._library)
        outside = tuple(Item(self._library[one.shape], one.scale) for one in pack.outside)
        if self._tasks and entry.task is not None and not entry.is_truth:
            outside = _left(self._task(entry), placed)
        played = pack.provenance if isinstance(pack.provenance, Played) else None
        rules = PACKIT if played is None else played.rules
        items = (*(p.item for p in placed), *outside)
        if not outside and played is not None and played.total > 0 and not rules.values:
            volume = pack.counted_volume / played.total
        else:
            volume = plain_sum(item.volume for item in items)
        values = [pack.values[item.shape.id, item.scale] for item in items if rules.values]
        return PackView(
            self.titles[number],
            _name(entry),
            _facts(pack, len(placed) + len(outside)),
            pack.cells,
            placed,
            outside,
            volume or 1.0,
            rules,
            tuple(values),
            self._file is not None and played is not None and played.trajectory is not None,
        )

    def trajectory(self, number: int) -> Trajectory:
        """Read the trajectory of the arm that packed a box (see `PackView.has_arm`).

        Returns
        -------
        Trajectory
            What the arm and the items did.

        Raises
        ------
        PackFormatError
            If it is missing, or not a trajectory.
        """
        assert self._file is not None
        return stored_trajectory(self._file, Rollout(self._entries[number].pack), self._library)

    def rivals(self, number: int) -> tuple[int, ...]:
        """Return the packs to compare with one: those of the same task, or of no task."""
        task = self._entries[number].task
        return tuple(
            n for n, entry in enumerate(self._entries) if n != number and entry.task == task
        )

    def _task(self, entry: _Entry) -> Task:
        assert entry.task is not None
        task = self._tasks[entry.task].task(self._library)
        digest = Rollout(entry.pack).task_digest
        if task.digest != digest:
            raise ResultsError(
                f"the results are of another task {entry.task} ({digest}) than the dataset has "
                f"({task.digest}): choose the dataset that was played"
            )
        return task


def _task_of(pack: Pack) -> int | None:
    """Return the number of a result's task; None for a pack that is not a result."""
    return pack.provenance.task if isinstance(pack.provenance, Played) else None


def _left(task: Task, placed: Sequence[PlacedItem | PosedItem]) -> tuple[Item, ...]:
    """Return the items of a task that are not placed."""
    inside = Counter((p.item.shape, p.item.scale) for p in placed)
    left = []
    for item in task.items:
        key = item.shape, item.scale
        if inside[key] > 0:
            inside[key] -= 1
        else:
            left.append(item)
    return tuple(left)


def _name(entry: _Entry) -> str:
    played = entry.pack.provenance
    if entry.is_truth:
        return "the task's own pack"
    if not isinstance(played, Played):
        return f"density {entry.pack.density:.3f}"
    return f"{played.agent}: {played.total:.3f}"


def _title(entry: _Entry) -> str:
    if entry.task is not None:
        return f"task {entry.task}, {_name(entry)}"
    return f"{len(entry.pack.items)} items, {_name(entry)}"


def _facts(pack: Pack, items: int) -> tuple[tuple[str, str], ...]:
    """List what a pack records about itself."""
    origin = pack.provenance
    rows = [
        ("items", f"{len(pack.items)} of {items} in the box"),
        ("density", f"{pack.density:.3f}"),
        ("box", " x ".join(f"{c / 100:g}" for c in pack.cells)),
    ]
    if origin != UNKNOWN_PROVENANCE:
        rows.append(("by", origin.producer))
    if isinstance(origin, Played):
        rows += [("return", f"{origin.total:.3f}"), ("ended", origin.end)]
    if isinstance(origin, Evolved):
        rows.append(("generation", str(origin.generation)))
    if isinstance(origin, Played | Evolved | Densified):
        rows.append(("seed", str(origin.seed)))
    return tuple(rows)
