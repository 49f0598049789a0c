"""Puzzles: boxes cut into pieces, which a perfect packing puts together again.

The pieces fill the box, except for the clearance between polycubes and between curved surfaces, and
can be put in one after the other from above.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from packit_sim.box import Box
from packit_sim.core.checks import Range, check_range
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.pack_files import WHOLE, read_packs, write_packs
from packit_sim.game.datasets.packs import LibraryRef, Pack
from packit_sim.game.datasets.provenance import Puzzle, PuzzleName
from packit_sim.game.generation.cuboid_cuts import WHIRL, guillotine, pinwheel
from packit_sim.game.generation.curved_cuts import curved
from packit_sim.game.generation.jobs import GenerationError
from packit_sim.game.generation.polycube_cuts import polycubes
from packit_sim.game.generation.puzzle_pieces import PuzzlePiece
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries import stored
from packit_sim.libraries.library import ShapeLibrary

LIBRARY = "puzzles", "1"
"""Name and version of a library of pieces."""

LIBRARY_FOLDER = "library"
"""The folder of the pieces, in the dataset's folder."""

ATTEMPTS = 1000
"""Maximum number of draws of cuts for one puzzle; most draws succeed."""


class Cutter(NamedTuple):
    """A way to cut a box.

    Attributes
    ----------
    cut : callable
        Draws cuts into a number of pieces; None if they are not valid.
    min_pieces, max_pieces : int
        The range of the number of pieces.
    """

    cut: Callable[[int, np.random.Generator], list[PuzzlePiece] | None]
    min_pieces: int
    max_pieces: int


CUTTERS: dict[PuzzleName, Cutter] = {
    "guillotine": Cutter(guillotine, 2, 64),
    "pinwheel": Cutter(pinwheel, WHIRL, 48),
    "polycubes": Cutter(polycubes, 2, 40),
    "curved": Cutter(curved, 2, 64),
}
"""The kinds of puzzles."""


@dataclass(frozen=True)
class PuzzleJob:
    """A dataset of puzzles: a number of packs of each kind and number of pieces.

    Parameters
    ----------
    cuts : tuple of PuzzleName
        The kinds.
    packs : int, default: 1
        The number of puzzles of each kind and number of pieces.
    seed : int, default: 0
        The seed of the first; that of number n is `seed` + n.

    Raises
    ------
    ArgumentError
        If there is no such kind, or a box can't be cut into this number of pieces.
    """

    cuts: tuple[PuzzleName, ...]
    pieces: tuple[int, ...]
    packs: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        for cuts, pieces in itertools.product(self.cuts, self.pieces):
            _cutter(cuts, pieces)

    @property
    def records(self) -> Iterator[Puzzle]:
        """The provenance of each pack, in order."""
        for cuts, pieces, n in itertools.product(self.cuts, self.pieces, range(self.packs)):
            yield Puzzle(cuts=cuts, pieces=pieces, seed=self.seed + n)


def cut_puzzle(cuts: PuzzleName, pieces: int, seed: int = 0) -> Box:
    """Cut a box into pieces.

    Parameters
    ----------
    cuts : str
        The kind: "guillotine" (cuboids, by planes), "pinwheel" (cuboids that no plane separates),
        "polycubes" (interlocking, of cubes), or "curved" (by slanted and curved surfaces).
    seed : int, default: 0
        The seed of the cuts.

    Returns
    -------
    Box
        The box with all pieces in it, packed by the kinematic rule.

    Raises
    ------
    ArgumentError
        If there is no such kind, or a box can't be cut into this number of pieces.
    GenerationError
        If no valid cuts were found.

    Examples
    --------
    >>> from packit_sim import cut_puzzle
    >>> box = cut_puzzle("guillotine", pieces=8, seed=0)
    >>> box
    Box((100, 100, 100), 8 items, density 1.000)
    >>> box.placed[0].item.cells
    (16, 100, 100)
    """
    cut = _cutter(cuts, pieces).cut
    rng = np.random.default_rng([seed, pieces, *cuts.encode()])
    for _ in range(ATTEMPTS):
        found = cut(pieces, rng)
        if found is not None:
            break
    else:
        raise GenerationError(f"{cuts} puzzle of {pieces} pieces, seed {seed}: no cuts were found")
    box = Box(kinematic=True)
    for piece in found:
        placed = piece.item()
        box.place(placed.item, placed.location)
    return box


def generate_puzzles(
    job: PuzzleJob,
    folder: Path,
    shapes: Path | None = None,
    on_pack: Callable[[Pack], None] = lambda pack: None,
) -> list[Pack]:
    """Generate a dataset of puzzles, and the library of their pieces.

    Parameters
    ----------
    folder : Path
        The dataset's folder.
    shapes : Path, optional
        The folder of the library; by default "library" in the dataset's folder.
    on_pack : callable
        Called with each pack.

    Returns
    -------
    list of Pack
        The packs, in the order of the job.

    Raises
    ------
    GenerationError
        If the folder has packs that are not of this job.
    LibraryError
        If the folder of the library has anything else.
    """
    file, shapes = folder / f"{WHOLE}.jsonl", shapes or folder / LIBRARY_FOLDER
    records = list(job.records)
    if file.exists() and not {pack.provenance for pack in read_packs(file)} <= {*records}:
        raise GenerationError(f"{file} has other packs than these puzzles: choose another folder")
    stored.require_replaceable(shapes)
    boxes = []
    pieces: dict[str, Shape] = {}
    for record in records:
        boxes.append(cut_puzzle(record.cuts, record.pieces, record.seed))
        pieces |= {one.item.shape.id: one.item.shape for one in boxes[-1].placed}
        on_pack(Pack.of(boxes[-1], LibraryRef(*LIBRARY, ""), record))
    entries = (
        stored.entry(shape, author="PackIt-Sim", licence="CC0-1.0")
        for _, shape in sorted(pieces.items())
    )
    stored.write(shapes, *LIBRARY, entries)
    library = ShapeLibrary.open(shapes)
    packs = [Pack.of(*each) for each in zip(boxes, itertools.repeat(library), records)]
    write_packs(file, packs)
    return packs


def _cutter(cuts: PuzzleName, pieces: int) -> Cutter:
    """Look up a kind, and check the number of pieces."""
    if cuts not in CUTTERS:
        raise ArgumentError(f"no puzzle {cuts!r}: choose from {', '.join(CUTTERS)}")
    cutter = CUTTERS[cuts]
    check_range(
        "pieces", pieces, Range(cutter.min_pieces, cutter.max_pieces), f"for a {cuts} puzzle"
    )
    return cutter
