"""Comparisons of `packit selftest`. Each check is a function of a case and a tally."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from packit_sim import placement
from packit_sim.core import caches
from packit_sim.core.counters import counters
from packit_sim.geometry import rotations
from packit_sim.geometry.items import BoxState, PlacedItem
from packit_sim.geometry.lattice import ORIGIN, STEP, Triple
from packit_sim.geometry.shapes import Item
from packit_sim.placement import Mask, conflicts, fits, is_inside, oracle
from packit_sim.selftest import motion, volumes
from packit_sim.selftest.cases import Case, locations_inside
from packit_sim.selftest.tally import Difference, Tally

ANSWERS = ("collisions", "no-fit tables", "pairs that met", "columns", "surfaces")
"""The caches of answers; every eighth case also starts without voxels and collision meshes."""

SAMPLES = 8
"""Locations at which a case is compared in ways that take long."""


def check_masks(case: Case, tally: Tally) -> None:
    """Compare masks with the oracle's: with empty caches, with full ones, and from tables."""
    _count_truth(tally, case.cells, case.item, case.truth)
    caches.clear(*(ANSWERS if sum(case.seed) % 8 else ()))
    box = case.box()
    before = counters()
    tally.compare_masks("cold", box.feasible(case.item), case.truth)
    tally.counts["by meshes"] += counters().since(before).undecided
    tally.compare_masks("warm", box.feasible(case.item), case.truth)
    for _ in range(placement.MEETINGS_BEFORE_TABLE + 1):
        placement.no_fit_tables(box.placed, case.item)
    tally.compare_masks("tables", box.feasible(case.item), case.truth)
    tally.compare_masks("tables", box.feasible(case.item), case.truth)


def check_rotations(case: Case, tally: Tally) -> None:
    """Compare the masks of all 24 rotations, their union, and the rotations at locations."""
    if not case.easy:
        return
    state = BoxState(case.cells, case.placed)
    turned = [case.item.turned(n) for n in range(rotations.COUNT)]
    truth = np.stack([oracle(state, item) for item in turned])
    for item, mask in zip(turned, truth, strict=True):
        _count_truth(tally, case.cells, item, mask)
    box = case.box()
    tally.compare_masks("union", box.feasible_in_any(case.item), np.logical_or.reduce(truth))
    for found, expected in zip(box.feasible_rotations(case.item), truth, strict=True):
        tally.compare_masks("rotations", found, expected)
    for location in case.border(SAMPLES, case.rng("rotations")):
        found = box.rotations_at(case.item, location).tolist()
        tally.compare("rotations at", found, truth[(slice(None), *location)].tolist(), location)


def check_blbf(case: Case, tally: Tally) -> None:
    """Compare the bottom-left-back location with the first one of the oracle's mask."""
    caches.clear("collisions")
    feasible = [(k, i, j) for i, j, k in np.argwhere(case.truth).tolist()]
    k, i, j = min(feasible, default=(-1, -1, -1))
    expected = (i, j, k) if feasible else None
    box = case.box()
    tally.compare("BLBF", box.blbf(case.item), expected)
    tally.compare("BLBF", box.blbf(case.item, expected or ORIGIN), expected)


def check_blockers(case: Case, tally: Tally) -> None:
    """Compare single locations, and what blocks the item there."""
    rng = case.rng("blockers")
    box = case.box()
    anywhere = rng.integers(box.nodes, size=(SAMPLES, 3)).tolist()
    for i, j, k in [*case.border(SAMPLES, rng), *anywhere]:
        candidate = PlacedItem(case.item, (i, j, k))
        expected = bool(case.truth[i, j, k])
        tally.compare("one location", box.is_feasible(case.item, (i, j, k)), expected, (i, j, k))
        reason = box.why_not(case.item, (i, j, k))
        items = tuple(n for n, other in enumerate(case.placed) if conflicts(other, candidate))
        found = (not reason, not reason.walls, reason.items)
        whole = (expected, is_inside(case.cells, candidate), items)
        tally.compare("why not", found, whole, (i, j, k))


def check_table(case: Case, tally: Tally) -> None:
    """Compare a no-fit table of one pair with the oracle, in both orders of the pair."""
    if not case.placed or not fits(case.cells, case.item):
        return
    rng = case.rng("table")
    other = case.placed[rng.integers(len(case.placed))]
    one, two = sorted((other.item, case.item), key=lambda item: item.key)
    table = placement.NoFit(one, two)
    below, above = (-(-np.array(item.cells) // STEP) for item in (case.item, other.item))
    for apart in rng.integers(-below, above + 1, size=(8 * SAMPLES, 3)):
        i, j, k = (other.location + apart).tolist()
        candidate = PlacedItem(case.item, (i, j, k))
        expected = conflicts(other, candidate)
        tally.compare("table offsets", table.conflict(other, candidate), expected, (i, j, k))


def check_history(case: Case, tally: Tally) -> None:
    """Compare the mask after other items came and went, and from another order of the items."""
    rng = case.rng("history")
    box = case.box()
    start = box.snapshot()
    for _ in range(3):
        locations = np.argwhere(box.feasible(case.item))
        if len(locations) and rng.random() < 0.6:
            box.place(case.item, rng.choice(locations).tolist())
        elif box.placed:
            box.undo()
    box.restore(start)
    tally.compare_masks("restored", box.feasible(case.item), case.truth)
    order = rng.permutation(len(case.placed)).tolist()
    box.restore(BoxState(case.cells, tuple(case.placed[n] for n in order)))
    tally.compare_masks("other order", box.feasible(case.item), case.truth)
    tally.compare("other order", bool((box.outer == case.box().outer).all()), True, "cells")


def check_kinematic(case: Case, tally: Tally) -> None:
    """Compare the kinematic rule with all triangles, and with small steps along the way."""
    if not case.kinematic:
        return
    box = case.box(kinematic=True)
    mask = box.feasible(case.item)
    tally.compare_masks("kinematic", mask & case.truth, mask)
    locations = np.argwhere(case.truth)
    if len(locations) == 0:
        return
    rng = case.rng("kinematic")
    paths = motion.Paths(case.cells, case.placed, case.item)
    for number, (i, j, k) in enumerate(rng.permutation(locations)[:SAMPLES].tolist()):
        candidate = PlacedItem(case.item, (i, j, k))
        clear = bool(mask[i, j, k])
        if number == 0:
            expected = placement.is_insertable_oracle(case.placed, candidate)
            tally.compare("clear", clear, expected, (i, j, k))
        if paths.is_blocked((i, j, k)):
            tally.compare("ways up", clear, False, (i, j, k))
        else:
            tally.counts["ways up"] += 1
        reason = box.why_not(case.item, (i, j, k))
        tally.compare("why not", bool(reason.above), not clear, (i, j, k))


def check_volumes(case: Case, tally: Tally) -> None:
    """Compare with the volume that solids share: little if feasible, more if not."""
    if not volumes.is_available():
        return
    for location in case.near(SAMPLES, case.rng("volumes")):
        candidate = PlacedItem(case.item, location)
        if not volumes.is_solid(candidate):
            return
        for other in case.placed:
            apart = np.abs(candidate.center - other.center)
            if (apart > (case.item.extents + other.item.extents) / 2).any():
                continue
            if not conflicts(candidate, other):
                if volumes.is_solid(other):
                    depth = volumes.shared_depth(candidate, other)
                    where = f"{location}, {depth:g} deep"
                    tally.compare("shared volumes", depth <= volumes.DEPTH, True, where)
            elif volumes.is_one_solid(candidate) and volumes.is_one_solid(other):
                shared = volumes.touch(candidate, other)
                tally.compare("shared volumes", shared, True, location)


def _count_truth(tally: Tally, cells: Triple, item: Item, truth: Mask) -> None:
    tally.counts["masks"] += 1
    tally.counts["locations"] += truth.size
    tally.counts["inside"] += math.prod(locations_inside(cells, item))
    tally.counts["feasible"] += int(truth.sum())


CHECKS: dict[str, Callable[[Case, Tally], None]] = {
    check.__name__.removeprefix("check_"): check
    for check in (
        check_masks,
        check_rotations,
        check_blbf,
        check_blockers,
        check_table,
        check_history,
        check_kinematic,
        check_volumes,
    )
}
"""The checks, in the order in which they are made, by name."""


def differences(case: Case, name: str, tally: Tally | None = None) -> list[Difference]:
    """Make a check, and return the differences that it found; what it raises is one as well.

    Parameters
    ----------
    name : str
        The name of the check.
    tally : Tally, optional
        The counts, to which comparisons are added.

    Returns
    -------
    list of Difference
        The differences that this check added to the tally.
    """
    tally = tally or Tally()
    before = len(tally.differences)
    try:
        CHECKS[name](case, tally)
    except Exception as error:  # any failure of the engine is what we look for
        tally.differences.append(Difference(name, f"{type(error).__name__}: {error}"))
    return tally.differences[before:]
