"""Draw the pictures of the concept pages: python scripts/concept_figures.py [FOLDER].

The folder is docs/images by default. The pictures have their own white background, so that
they can be read on light and on dark pages.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Polygon, Rectangle

from packit_sim import Box, Item, Look, Scene, ShapeLibrary, dataset_file, read_packs
from packit_sim.geometry.lattice import CELLS_PER_UNIT, FINE_PER_CELL, STEP
from packit_sim.geometry.rotations import by_alignment
from packit_sim.render.coloring import UNKNOWN_COLOR, Colors

IMAGES = Path(__file__).parents[1] / "docs" / "images"

BLUE, ORANGE, VERMILION, GREY, DARK = "#0072B2", "#E69F00", "#D55E00", "#B0B0B0", "#303030"
TOUCHED, INSIDE = "#F4C979", "#6FB1DC"
"""Fine cells that a surface touches, and those that it encloses."""


def draw_grid(library: ShapeLibrary, file: Path) -> None:
    """Draw the grid's nodes with an item in its cell box, and the fine cells of that item."""
    item = Item(library["mug"], scale=0.03)
    start = np.array([8, 0]) * STEP
    size = np.array([item.cells[0], item.cells[2]])
    figure, (whole, close) = plt.subplots(1, 2, figsize=(9.6, 4.9), layout="constrained")

    nodes = np.arange(CELLS_PER_UNIT // STEP) * STEP
    whole.scatter(*np.meshgrid(nodes, nodes), s=2.5, color=BLUE, zorder=1)
    for line in _section(item):
        whole.plot(*(line + start + size / 2).T, color=DARK, linewidth=1.2)
    _outline(whole, start, size)
    whole.annotate(
        "a node: location (8, ·, 0)\nthe min corner of the cell box",
        start,
        (2, 64),
        arrowprops={"arrowstyle": "->", "color": VERMILION, "linewidth": 1.2},
        color=VERMILION,
        fontsize=10,
        bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": "none"},
    )
    _frame(whole, (0, 0), (CELLS_PER_UNIT, CELLS_PER_UNIT), 20)
    whole.set_title("The box from the front: 25 nodes an axis, 4 cells apart", fontsize=11)
    whole.set_xlabel("x, in cells")
    whole.set_ylabel("z, in cells")

    middle = item.cells[1] * FINE_PER_CELL // 2
    outer, inner = item.voxels.outer_fine[:, middle], item.voxels.inner_fine[:, middle]
    _fill(close, outer & ~inner, TOUCHED)
    _fill(close, inner, INSIDE)
    for line in _section(item):
        close.plot(*(line + size / 2).T, color=DARK, linewidth=1.6)
    _frame(close, (0, 0), tuple(size), 1)
    close.grid(color=DARK, linewidth=0.5, alpha=0.6)
    close.set_title("A slice of the item: cells, each of 4 x 4 x 4 fine cells", fontsize=11)
    close.set_xlabel(f"{size[0]} cells wide, centred on the item")
    close.tick_params(labelbottom=False, labelleft=False)
    legend = (
        Patch(facecolor=TOUCHED, label="touched by the surface"),
        Patch(facecolor=INSIDE, label="inner: enclosed, not touched"),
    )
    close.legend(
        handles=legend,
        loc="upper center",
        bbox_to_anchor=(0.45, -0.07),
        ncols=2,
        frameon=False,
        fontsize=9,
    )
    _save(figure, file)


def draw_mask(library: ShapeLibrary, file: Path) -> None:
    """Draw a box, and one layer of the mask of the next item."""
    pack = read_packs(dataset_file("starter"))[0]
    task = pack.task(library)
    box = Box(task.cells)
    large = sorted(task.items, key=lambda item: -item.volume)
    for item in large[:5]:
        turned = item.turned(by_alignment(item.extents)[0])
        location = box.blbf(turned)
        if location is not None:
            box.place(turned, location)
    item = next(item for item in large[5:] if box.feasible(item)[:, :, 0].sum() > 40)
    mask = box.feasible(item)
    location = box.blbf(item)
    assert location is not None
    k = location[2]
    layer = np.asarray(box.outer[:, :, k * STEP : k * STEP + item.cells[2]].any(axis=2))

    figure, (picture, plan) = plt.subplots(1, 2, figsize=(9.6, 4.8), layout="constrained")
    filled = Box(box.cells)
    filled.restore(box.snapshot())
    filled.place(item, location)
    with Scene(filled) as scene:
        picture.imshow(scene.snapshot(720, 720, Look(coloring=_last_in_orange)).image)
    picture.set_axis_off()
    picture.set_title(f"{item.shape.id} at its BLBF location {location}", fontsize=11)

    _fill(plan, layer, "#D8D8D8", 1)
    xy = np.argwhere(np.ones(mask.shape[:2], dtype=bool))
    free = mask[:, :, k][tuple(xy.T)]
    plan.scatter(*(xy[~free] * STEP).T, s=4, color="#909090")
    plan.scatter(*(xy[free] * STEP).T, s=11, color=BLUE)
    corner = np.array(location[:2]) * STEP
    _outline(plan, corner, np.array(item.cells[:2]))
    _frame(plan, (0, 0), box.cells[:2], 20)
    plan.set_title(
        f"Layer k = {k} from above: {free.sum()} feasible nodes\n"
        f"(of {mask.sum():,} in all layers, of {mask.size:,} nodes)",
        fontsize=11,
    )
    plan.set_xlabel("x, in cells")
    plan.set_ylabel("y, in cells")
    _save(figure, file)


def draw_filters(file: Path) -> None:
    """Draw the three answers of cells for two items: free, blocked, undecided."""
    ring = np.linspace(0, 2 * np.pi, 90)
    disc = np.column_stack([np.cos(ring), np.sin(ring)]) * 3.1 + (4.6, 6.1)
    block = np.array([[0, 0], [5.2, -1.9], [6.6, 1.9], [1.4, 3.8]])
    cases = (
        ((8.6, 3.6), "No common cell:\nfree", BLUE),
        ((5.6, 5.0), "Inside of one, surface of the other:\nblocked", VERMILION),
        ((6.85, 2.35), "Only touched cells in common:\nthe meshes decide", DARK),
    )
    figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.2), layout="constrained")
    for axis, (shift, title, color) in zip(axes, cases, strict=True):
        shapes = [disc, block + shift]
        cells = [_classify(shape, (17, 11)) for shape in shapes]
        for touched, enclosed in cells:
            _fill(axis, touched, TOUCHED, 1)
            _fill(axis, enclosed, INSIDE, 1)
        (a_touched, a_inside), (b_touched, b_inside) = cells
        clash = (a_inside & (b_touched | b_inside)) | (b_inside & (a_touched | a_inside))
        _fill(axis, a_touched & b_touched & ~clash, ORANGE, 1)
        _fill(axis, clash, VERMILION, 1)
        for shape in shapes:
            axis.add_patch(Polygon(shape, fill=False, edgecolor=DARK, linewidth=1.6))
        _frame(axis, (0, 0), (17, 11), 1)
        axis.grid(color=DARK, linewidth=0.3, alpha=0.4)
        axis.tick_params(labelbottom=False, labelleft=False, length=0)
        axis.set_title(title, fontsize=11, color=color)
    figure.legend(
        handles=(
            Patch(facecolor=TOUCHED, label="touched"),
            Patch(facecolor=INSIDE, label="inner"),
            Patch(facecolor=ORANGE, label="touched by both"),
            Patch(facecolor=VERMILION, label="inner for one, outer for the other"),
        ),
        loc="outside lower center",
        ncols=4,
        frameon=False,
    )
    _save(figure, file)


def _section(item: Item) -> list[np.ndarray]:
    """Cut an item's mesh through its middle across y: polylines (n, 2) of x and z in cells."""
    path = item.mesh.section(plane_origin=(0, 1e-4, 0), plane_normal=(0, 1, 0))
    assert path is not None
    return [np.asarray(line)[:, [0, 2]] * CELLS_PER_UNIT for line in path.discrete]


def _classify(polygon: np.ndarray, cells: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Find the cells that a polygon's outline touches, and those that it encloses."""
    outline = mpl.path.Path(polygon, closed=False)
    samples = np.linspace(0.01, 0.99, 12)
    x, y = np.meshgrid(np.arange(cells[0]), np.arange(cells[1]), indexing="ij")
    points = np.stack(
        np.broadcast_arrays(
            x[..., None, None] + samples[:, None], y[..., None, None] + samples[None, :]
        ),
        axis=-1,
    )
    inside = outline.contains_points(points.reshape(-1, 2)).reshape(*cells, -1)
    enclosed = np.asarray(inside.all(axis=2))
    return np.asarray(inside.any(axis=2)) & ~enclosed, enclosed


def _last_in_orange(items: Sequence[Item]) -> Colors:
    orange = mpl.colors.to_rgb(VERMILION)
    return Colors((*[UNKNOWN_COLOR] * (len(items) - 1), orange))


def _outline(axis: Axes, corner: np.ndarray, size: np.ndarray) -> None:
    """Draw a cell box with a dot at its min corner; all in cells."""
    (x, y), (width, height) = corner.tolist(), size.tolist()
    box = Rectangle((x, y), width, height, fill=False, edgecolor=VERMILION, linewidth=1.8)
    axis.add_patch(box)
    axis.plot(x, y, "o", color=VERMILION, markersize=7, zorder=3, clip_on=False)


def _fill(axis: Axes, cells: np.ndarray, color: str, side: float = 1 / FINE_PER_CELL) -> None:
    """Fill the true cells of a bool array [x, y], whose sides have this length."""
    image = np.zeros((*cells.T.shape, 4))
    image[cells.T] = mpl.colors.to_rgba(color)
    extent = (0, cells.shape[0] * side, 0, cells.shape[1] * side)
    axis.imshow(image, origin="lower", extent=extent, interpolation="nearest", zorder=0)


def _frame(axis: Axes, low: tuple[int, int], high: tuple[int, ...], step: int) -> None:
    axis.set_aspect("equal")
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_xticks(range(low[0], high[0] + 1, step))
    axis.set_yticks(range(low[1], high[1] + 1, step))
    axis.set_axisbelow(False)


def _save(figure: plt.Figure, file: Path) -> None:
    figure.savefig(file, dpi=110, facecolor="white", metadata={"Software": None})
    plt.close(figure)
    print(f"wrote {file}")


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    library = ShapeLibrary.open("everyday")
    draw_grid(library, folder / "concept-grid.png")
    draw_mask(library, folder / "concept-mask.png")
    draw_filters(folder / "concept-filters.png")


if __name__ == "__main__":
    main()
