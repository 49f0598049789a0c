"""Checks of one pack: items, density, settings and order of placing.

The oracle (`engine.oracle`) decides about the geometry, independently of the code that packed.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np
import numpy.typing as npt

from packit_sim.core.check_reports import named
from packit_sim.core.errors import PackFormatError, UnknownShapeError
from packit_sim.core.sums import plain_sum
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Densified, Evolved, Played, Puzzle
from packit_sim.geometry.items import PlacedItem, PosedItem
from packit_sim.geometry.lattice import CELL, CELLS_PER_UNIT, STEP, Triple
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.settings import INSIDE
from packit_sim.placement import conflicts, is_inside
from packit_sim.robot.cell import INSIDE as ROBOT_INSIDE

DENSITY_SLACK = 1e-9
"""Largest difference between a recorded and a replayed density: rounding of sums."""

SCALE_SLACK = 1e-12
"""Largest relative difference between an item's scale and its settings': rounding of products."""

PUZZLE_SLACK = 0.005
"""Largest share of the box between the pieces of a puzzle: the clearance of those that need one."""

INSIDE_ROUNDING = 1e-6
"""Box units by which poses are rounded in files and trajectories."""

MOST_NAMED = 8
"""Most items that a problem names."""

WITNESSES = 512
"""Number of inner and of outer cells of an item that are tested at all locations before the oracle
is asked."""


def verify(pack: Pack, library: ShapeLibrary) -> list[str]:
    """Check a pack.

    Items on the grid are replayed one by one against the oracle, without the engine that packed
    them. Items that settled off the grid must be inside the box if they count; whether they overlap
    or rest is not judged.

    Returns
    -------
    list of str
        A sentence for each problem; empty for a correct pack.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from packit_sim import ShapeLibrary, dataset_file, read_packs, verify
    >>> library = ShapeLibrary.open("everyday")
    >>> pack = read_packs(dataset_file("starter"))[0]
    >>> verify(pack, library)
    []
    >>> verify(replace(pack, density=0.9), library)
    ['density is recorded as 0.9, replayed it is 0.431...']
    """
    try:
        items = pack.placed(library)
    except (PackFormatError, UnknownShapeError) as error:
        return [str(error)]
    problems = []
    before: dict[int, PlacedItem] = {}
    size = np.array(pack.cells) * CELL
    for n, candidate in enumerate(items):
        what = named(n, candidate.item.shape.id)
        if isinstance(candidate, PosedItem):
            vertices = candidate.vertices
            slack = _inside_slack(pack)
            inside = (vertices > -slack).all() and (vertices < size + slack).all()
            if pack.items[n].counted and not inside:
                problems.append(f"{what} is not inside the box, within {slack:.4g} box units")
            continue
        if not is_inside(pack.cells, candidate):
            problems.append(f"{what} is not inside the box")
            continue
        found = (n for n, other in before.items() if conflicts(other, candidate))
        blocking = list(islice(found, MOST_NAMED + 1))  # all would be quadratic in equal items
        if blocking:
            others = " and others" if len(blocking) > MOST_NAMED else ""
            problems.append(f"{what} is in conflict with items {blocking[:MOST_NAMED]}{others}")
        before[n] = candidate
    counted = [p.item for p, record in zip(items, pack.items, strict=True) if record.counted]
    volume = plain_sum(item.volume for item in counted)
    density = volume / (math.prod(pack.cells) / CELLS_PER_UNIT**3)
    if not abs(density - pack.density) <= DENSITY_SLACK:
        problems.append(f"density is recorded as {pack.density!r}, replayed it is {density!r}")
    if density > 1 + DENSITY_SLACK:
        problems.append(f"density is {density!r}: items can't be larger than their box")
    return problems


def _inside_slack(pack: Pack) -> float:
    """Return the box units by which an item that counts may protrude from the box."""
    played = pack.provenance
    cell = played.rules.robot if isinstance(played, Played) else None
    return INSIDE if cell is None else ROBOT_INSIDE / cell.edge + INSIDE_ROUNDING


def settings_problems(pack: Pack, evolved: Evolved) -> Iterator[str]:
    """Yield the contradictions between a pack and the settings of its evolution."""
    settings, size = evolved.settings, evolved.size
    if len(pack.items) > settings.pool:
        yield f"it holds {len(pack.items)} items, more than its pool of {settings.pool}"
    if settings.cells != pack.cells:
        yield f"its box has {list(pack.cells)} cells, its settings say {list(settings.cells)}"
    low, high = settings.size_range
    if not low <= size <= high:
        yield f"its size {size!r} is outside its settings' range {list(settings.size_range)}"
    possible = [scale * size**3 for scale in settings.scales]
    for n, item in enumerate(pack.items):
        if not any(math.isclose(item.scale, scale, rel_tol=SCALE_SLACK) for scale in possible):
            yield (
                f"{named(n, item.shape)} has scale {item.scale!r}, "
                f"which is none of its settings' {list(settings.scales)} at size {size!r}"
            )


def density_problems(
    pack: Pack, placed: Sequence[PlacedItem | PosedItem], densified: Densified
) -> Iterator[str]:
    """Yield the contradictions between a pack and the settings of its densification.

    Parameters
    ----------
    densified : Densified
        Its provenance.

    Yields
    ------
    str
        A sentence for each contradiction.
    """
    settings = densified.settings
    low, high = settings.items
    if not low <= len(pack.items) <= high:
        yield f"it has {len(pack.items)} items, its settings say {low} to {high}"
    if settings.cells != pack.cells:
        yield f"its box has {list(pack.cells)} cells, its settings say {list(settings.cells)}"
    shape, count = Counter(item.shape for item in pack.items).most_common(1)[0]
    if count > settings.copies:
        yield f"{count} of its items have the shape {shape!r}, its settings allow {settings.copies}"
    volumes = [one.item.volume for one in placed]
    share = min(volumes) / plain_sum(volumes)
    if share < settings.floor * (1 - SCALE_SLACK):
        yield f"its smallest item has {share:.4g} of the volume, not {settings.floor} at least"
    largest = max(volumes) / (math.prod(pack.cells) / CELLS_PER_UNIT**3)
    if largest > settings.largest * (1 + SCALE_SLACK):
        yield f"its largest item fills {largest:.4g} of the box, not {settings.largest} at most"
    solid = max((one.item.shape for one in placed), key=lambda shape: shape.fill)
    if solid.fill > settings.fill:
        yield (
            f"shape {solid.id!r} fills {solid.fill:.4g} of its bounding box, not {settings.fill} "
            "at most"
        )


def puzzle_problems(pack: Pack, puzzle: Puzzle) -> Iterator[str]:
    """Yield the reasons why a pack is not a complete puzzle."""
    if len(pack.items) != puzzle.pieces or pack.outside:
        yield (
            f"its puzzle has {puzzle.pieces} pieces, but {len(pack.items)} are in the box and "
            f"{len(pack.outside)} outside"
        )
    if pack.density < 1 - PUZZLE_SLACK:
        yield f"its density is {pack.density!r}, but the pieces of a puzzle fill the box"


def order_problems(cells: Triple, placed: Sequence[PlacedItem]) -> Iterator[str]:
    """Yield the items for which bottom-left-back fill has an earlier location.

    Parameters
    ----------
    cells : tuple of int
        The box's cells along x, y and z.
    placed : sequence of PlacedItem
        The items, in the order of placing.

    Yields
    ------
    str
        A sentence for each such item.
    """
    outer, inner = np.zeros(cells, dtype=bool), np.zeros(cells, dtype=bool)
    before: list[PlacedItem] = []
    for n, candidate in enumerate(placed):
        if not is_inside(cells, candidate):
            continue
        free = _earlier(outer, inner, before, candidate)
        if free is not None:
            yield (
                f"{named(n, candidate.item.shape.id)} stands at {candidate.location}, "
                f"but bottom-left-back fill puts it at {free}"
            )
        where = tuple(map(slice, candidate.start, candidate.stop))
        outer[where] |= candidate.item.outer
        inner[where] |= candidate.item.inner
        before.append(candidate)


def _earlier(
    outer: npt.NDArray[np.bool_],
    inner: npt.NDArray[np.bool_],
    placed: Sequence[PlacedItem],
    candidate: PlacedItem,
) -> Triple | None:
    """Return the first location before the candidate's in (z, x, y) that the oracle finds feasible.

    `outer` and `inner` are bool over the box's cells, for the items placed. A cell that is inner
    for one item and outer for another contains a fine cell of both, and proves a conflict. The
    choice of the item's cells has no influence on the answer: if they prove no conflict, the oracle
    decides.
    """
    item, (i, j, k) = candidate.item, candidate.location
    nx, ny = ((outer.shape[axis] - item.cells[axis]) // STEP + 1 for axis in (0, 1))
    z, x, y = np.unravel_index(np.arange((k * nx + i) * ny + j), (k + 1, nx, ny))
    left = np.column_stack([x, y, z])
    corners = np.ravel_multi_index(tuple(left.T * STEP), outer.shape)
    rng = np.random.default_rng(0)
    for own, theirs in ((item.inner, outer.ravel()), (item.outer, inner.ravel())):
        cells = np.flatnonzero(own)
        cells = cells[rng.permutation(len(cells))[:WITNESSES]]
        offsets = np.ravel_multi_index(np.unravel_index(cells, own.shape), outer.shape)
        for some in np.array_split(offsets, 2 ** np.arange(9)):  # more at once, as fewer are left
            free = ~theirs[corners + some[:, None]].any(axis=0)
            corners, left = corners[free], left[free]
    asked = list(placed)
    for x, y, z in left.tolist():
        at = PlacedItem(item, (x, y, z))
        for n, other in enumerate(asked):
            if conflicts(other, at):
                asked.insert(0, asked.pop(n))
                break
        else:
            return at.location
    return None
