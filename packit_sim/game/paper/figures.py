"""The paper's figures, drawn from our data, and a figure of looks."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.box import Box
from packit_sim.core.errors import PackItError
from packit_sim.game.datasets.packs import Pack, Task
from packit_sim.game.datasets.provenance import Evolved
from packit_sim.game.evaluation.results import Rollout
from packit_sim.geometry import rotations
from packit_sim.geometry.items import BoxState, Contents, ItemInBox
from packit_sim.geometry.lattice import BOX_CELLS, CELL, STEP
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.render import plots
from packit_sim.render.cameras import FRONT, TOP, Camera
from packit_sim.render.coloring import COLORINGS, UNKNOWN_COLOR, Color, Colors
from packit_sim.render.layouts import Layout
from packit_sim.render.looks import Cut, Look
from packit_sim.render.rendering import Snapshot
from packit_sim.scene import Scene

_WHITE = Look(background=(255, 255, 255))
_CHOSEN: Color = (0.84, 0.37, 0.00)
_FEASIBLE = "#0072B2"
_SIDE = 800
_PANEL = 1.25
"""Width over height of a panel of the environment's figure."""

_TURNS_A_ROW = 6


@dataclass(frozen=True)
class Highlight:
    """A rule that colours some items, given by their indices; the others are grey."""

    chosen: frozenset[int]

    def __call__(self, items: Sequence[Item]) -> Colors:
        return Colors(
            tuple(_CHOSEN if n in self.chosen else UNKNOWN_COLOR for n in range(len(items)))
        )


def draw_task(pack: Pack, library: ShapeLibrary, path: Path | str) -> None:
    """Draw a task, its items next to the empty box, and the pack that solves it."""
    task = pack.task(library)
    size = np.array(task.cells) * CELL
    layout = Layout.standing(task.items, size)
    items = BoxState(task.cells, layout.posed(task.items))
    outside = _shot(items, _WHITE, layout, 5 / 3)
    inside = _shot(pack.contents(library))
    with plots.drawn(path, [["outside"] * 5 + ["inside"] * 3], 12, 4.9) as (_, axes):
        _show(axes["outside"], outside, f"A task: {len(task.items)} items and an empty box")
        _show(axes["inside"], inside, f"Packed by evolution: density {pack.density:.2f}")


def draw_looks(pack: Pack, library: ShapeLibrary, path: Path | str) -> None:
    """Draw a pack in many looks, each with its options of `packit render`."""
    box = pack.contents(library)
    middle = float(pack.cells[1]) * CELL / 2
    looks = {
        "(usual)": Look(),
        "--camera front": Look(FRONT),
        "--camera top": Look(TOP),
        "--explode 0.8": Look(explode=0.8),
        f"--cut y={middle:g}": Look(cut=Cut("y", middle)),
        "--box-style ghost": Look(box="ghost"),
        "--box-style none --background #20242c": Look(box="none", background=(32, 36, 44)),
        "--color category": Look(coloring=COLORINGS["category"]),
        "--color order": Look(coloring=COLORINGS["order"]),
        "--color share": Look(coloring=COLORINGS["share"]),
    }
    names = list(looks)
    with plots.drawn(path, [names[:5], names[5:]], 15, 6.7) as (_, axes):
        for name, look in looks.items():
            background = look.background if look.box == "none" else _WHITE.background
            _show(axes[name], _shot(box, replace(look, background=background)), "")
            axes[name].set_xlabel(name, family="monospace")


def draw_environment(task: Task, path: Path | str, placed: int = 4) -> None:
    """Draw the three sub-tasks, in the order of PackIt and in that of PackIt-Easy.

    Parameters
    ----------
    placed : int
        The number of the solution's items in the box; the item of median volume among the others
        is chosen.

    Raises
    ------
    PackItError
        If no item is left.
    """
    if len(task.solution) <= placed:
        raise PackItError(f"the task has {len(task.solution)} items: {placed + 1} are needed")
    box = Box(task.cells)
    for n, rotation, location in task.solution[:placed]:
        box.place(task.items[n].turned(rotation), location)
    rest = sorted(task.solution[placed:], key=lambda step: task.items[step[0]].volume)
    number, rotation, location = rest[len(rest) // 2]
    inside = {n for n, _, _ in task.solution[:placed]}
    left = [n for n in range(len(task.items)) if n not in inside]
    item = task.items[number].turned(rotation)
    fits = np.flatnonzero(box.rotations_at(item, location)).tolist()
    one, any_ = box.feasible(item), box.feasible_in_any(item)
    shapes = _outside([task.items[n] for n in left], left.index(number))
    box.place(item, location)
    view = _shot(box, replace(_WHITE, coloring=Highlight(frozenset([placed]))), aspect=_PANEL)
    turns, allowed = (_turned(item, frozenset(some)) for some in ([rotation], fits))
    counts = [f"{np.count_nonzero(mask):,} of {mask.size:,} locations" for mask in (one, any_)]
    panels = {
        "shape": (shapes, "Shape-Selection", f"one of {len(left)} shapes outside"),
        "rotation": (turns, "Rotation-Selection", "one of 24 rotations"),
        "location": (view, "Location-Selection", f"it fits so at {counts[0]}"),
        "easy shape": (shapes, "Shape-Selection", f"one of {len(left)} shapes outside"),
        "easy location": (view, "Location-Selection", f"it fits somehow at {counts[1]}"),
        "easy rotation": (allowed, "Rotation-Selection", f"{len(fits)} of 24 rotations fit there"),
    }
    rows = [["shape", "rotation", "location"], ["easy shape", "easy location", "easy rotation"]]
    with plots.drawn(path, rows, 12, 8) as (figure, axes):
        figure.set_layout_engine("constrained", h_pad=0.15, w_pad=0.15)
        for name, (shot, title, caption) in panels.items():
            _show(axes[name], shot, title)
            axes[name].set_xlabel(caption, labelpad=4)
        for row, name in zip(rows, ("PackIt", "PackIt-Easy"), strict=True):
            axes[row[0]].set_ylabel(name, fontsize=15, fontweight="bold", labelpad=10)
            for first, then in itertools.pairwise(row):
                _arrow(axes[first], axes[then])
            share = item.volume / task.volume
            _note(axes[row[2]], f"reward: {share:.3f}, its share of the volume; then the next")
        _mark(axes["location"], view, one)
        _mark(axes["easy location"], view, any_)


def first_evolution(packs: Sequence[Pack]) -> list[Pack]:
    """Select the packs of the first evolution, in the order of their generations."""
    seed = _seed(packs[0])
    return [pack for pack in packs if _seed(pack) == seed]


def _seed(pack: Pack) -> int | None:
    """Return the seed of a pack's evolution."""
    return pack.provenance.seed if isinstance(pack.provenance, Evolved) else None


def draw_evolution(packs: Sequence[Pack], library: ShapeLibrary, path: Path | str) -> None:
    """Draw the best packs of one evolution: the first, the last, and some at doubling distances.

    Parameters
    ----------
    packs : Sequence[Pack]
        The packs, in the order of generations.

    Raises
    ------
    PackItError
        If a pack does not record its generation.
    """
    after = [pack.provenance.after for pack in packs if isinstance(pack.provenance, Evolved)]
    if len(after) < len(packs) or None in after:
        raise PackItError(
            "packs of an evolution must record `provenance.after`: choose a dataset of "
            "`packit generate --history`"
        )
    last = len(packs) - 1
    shown = [n for n in range(len(packs)) if n in (0, last) or n.bit_count() == 1]
    names = [f"{n}" for n in range(len(shown))]
    with plots.drawn(path, [names], 3.2 * len(shown), 3.7) as (_, axes):
        for name, n in zip(names, shown, strict=True):
            pack = packs[n]
            _show(axes[name], _shot(pack.contents(library)), f"Generation {after[n]}")
            axes[name].set_xlabel(f"density {pack.density:.3f}, {len(pack.items)} items")


def draw_rollouts(
    rollouts: Sequence[Rollout], tasks: Sequence[Task], library: ShapeLibrary, path: Path | str
) -> None:
    """Draw the four best and the four worst rollouts; items left outside are next to the box."""
    ranked = sorted(rollouts, key=lambda rollout: rollout.total)
    shown = [*ranked[::-1][:4], *ranked[:4]]
    names = [[f"{row}{n}" for n in range(4)] for row in ("best ", "worst ")]
    layouts = [_left(rollout, tasks[rollout.task], library) for rollout in shown]
    points = np.concatenate([layout.points for _, layout in layouts])
    with plots.drawn(path, names, 15, 6.4) as (figure, axes):
        figure.set_layout_engine("constrained", h_pad=0.15, w_pad=0.15)
        cells = [name for row in names for name in row]
        for name, rollout, (contents, layout) in zip(cells, shown, layouts, strict=False):
            shot = _shot(contents, _WHITE, replace(layout, points=points), 3 / 2)
            _show(axes[name], shot, _return(rollout))
            packed, items = len(rollout.pack.items), len(tasks[rollout.task].items)
            axes[name].set_xlabel(f"{packed} of {items} items: {rollout.end}")
        axes[cells[0]].set_ylabel("Success", fontsize=13, fontweight="bold")
        axes[cells[4]].set_ylabel("Failure", fontsize=13, fontweight="bold")


def draw_failures(
    rollouts: Sequence[Rollout], tasks: Sequence[Task], library: ShapeLibrary, path: Path | str
) -> None:
    """Draw rollouts, the items left outside next to the box, and below them the tasks' own packs.

    Parameters
    ----------
    rollouts : Sequence[Rollout]
        The rollouts, one for each column.
    tasks : Sequence[Task]
        All tasks of the dataset.
    """
    columns = range(len(rollouts))
    names = [[f"{row} {n}" for n in columns] for row in ("left", "solved")]
    with plots.drawn(path, names, 4 * len(rollouts), 7) as (figure, axes):
        figure.set_layout_engine("constrained", h_pad=0.15, w_pad=0.15)
        for n, rollout in enumerate(rollouts):
            task = tasks[rollout.task]
            contents, layout = _left(rollout, task, library)
            shot = _shot(contents, _WHITE, layout, 3 / 2)
            _show(axes[f"left {n}"], shot, f"Task {rollout.task}: {_return(rollout)}")
            packed, items = len(rollout.pack.items), len(task.items)
            axes[f"left {n}"].set_xlabel(f"{packed} of {items} items")
            _show(axes[f"solved {n}"], _shot(task.pack.contents(library)), "Its own solution")
            axes[f"solved {n}"].set_xlabel(f"density {task.pack.density:.2f}")


def _return(rollout: Rollout) -> str:
    """Write the return, never rounded up to 1."""
    return f"return {math.floor(1000 * rollout.total) / 1000:.3f}"


def _shot(
    contents: Contents[ItemInBox],
    look: Look = _WHITE,
    layout: Layout | None = None,
    aspect: float = 1.0,
) -> Snapshot:
    with Scene(contents) as scene:
        return scene.snapshot(round(_SIDE * aspect), _SIDE, look, layout)


def _outside(items: Sequence[Item], chosen: int) -> Snapshot:
    """Draw the items outside, the chosen one in colour."""
    look = replace(_WHITE, coloring=Highlight(frozenset([chosen])), box="none")
    layout = Layout.standing(items)
    return _shot(BoxState(BOX_CELLS, layout.posed(items)), look, layout, _PANEL)


def _turned(item: Item, chosen: frozenset[int]) -> Snapshot:
    """Draw an item in all 24 rotations, some in colour."""
    turned = [item.turned(n) for n in range(rotations.COUNT)]
    pitch = 1.25 * float(item.extents.max())
    rows = rotations.COUNT // _TURNS_A_ROW
    poses = tuple(
        Motion.turn(
            one.rotation, pitch * np.array((-(n % _TURNS_A_ROW), 0.0, rows - n // _TURNS_A_ROW))
        )
        for n, one in enumerate(turned)
    )
    points = np.array(
        [p.translation + np.array((s, 0, s)) * pitch / 2 for p in poses for s in (-1, 1)]
    )
    camera = Camera(azimuth=90, elevation=14, fov=12)
    look = replace(_WHITE, camera=camera, box="none", coloring=Highlight(chosen))
    layout = Layout(poses, points)
    return _shot(BoxState(BOX_CELLS, layout.posed(turned)), look, layout, _PANEL)


def _left(
    rollout: Rollout, task: Task, library: ShapeLibrary
) -> tuple[Contents[ItemInBox], Layout]:
    """Lay out a box at the end of an episode, with the other items next to it."""
    placed = rollout.pack.placed(library)
    outside = list(task.items)
    for one in placed:
        outside.remove(one.item.turned(0))
    size = np.array(task.cells) * CELL
    packed, standing = Layout.packed(placed, size), Layout.standing(outside, size)
    contents: BoxState[ItemInBox] = BoxState(task.cells, (*placed, *standing.posed(outside)))
    points = np.concatenate((packed.points, standing.points))
    return contents, Layout((*packed.poses, *standing.poses), points)


def _show(axes: Any, shot: Snapshot, title: str) -> None:
    axes.imshow(shot.image, interpolation="antialiased")
    axes.set(title=title, xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_visible(False)


def _mark(axes: Any, shot: Snapshot, mask: npt.NDArray[np.bool_]) -> None:
    """Draw dots at the locations of a mask, faint where something hides them."""
    places = np.argwhere(mask) * STEP * CELL
    seen = np.column_stack((places, np.ones(len(places)))) @ shot.projection.T
    columns, rows = (seen[:, :2] / seen[:, 2:]).T
    at = np.rint(np.stack((rows, columns))).astype(int)
    hidden = seen[:, 2] > shot.depth[tuple(at)] + CELL
    opacity = np.where(hidden, 0.12, 0.8)
    axes.scatter(columns, rows, s=3, color=_FEASIBLE, linewidths=0, alpha=opacity)


def _arrow(one: Any, other: Any) -> None:
    """Draw an arrow from one panel to the next."""
    style = {"arrowstyle": "-|>,head_width=0.5,head_length=0.9", "color": plots.INK, "lw": 2}
    one.annotate(
        "",
        xy=(-0.01, 0.5),
        xycoords=other.transAxes,
        xytext=(1.01, 0.5),
        textcoords=one.transAxes,
        arrowprops=style,
        annotation_clip=False,
    )


def _note(axes: Any, text: str) -> None:
    """Write a note below a panel's caption."""
    axes.annotate(
        text,
        xy=(0.5, 0),
        xycoords="axes fraction",
        xytext=(0, -32),
        textcoords="offset points",
        ha="center",
        fontsize=9,
        color=plots.INK,
    )
