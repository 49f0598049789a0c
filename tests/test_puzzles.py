"""Puzzles: the pieces fill the box, fit by the oracle, and can be put in from above."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage
from typer.testing import CliRunner, Result

from packit_sim import cut_puzzle, dataset_file, load_tasks, read_packs, verify, write_packs
from packit_sim.cli.app import app
from packit_sim.core.errors import ArgumentError, PackItError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.pack_checks import PUZZLE_SLACK, puzzle_problems
from packit_sim.game.datasets.pack_files import dataset_library
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Puzzle, PuzzleName
from packit_sim.game.datasets.result_checks import insertion_problems
from packit_sim.game.generation import cuboid_cuts, curved_cuts, polycube_cuts
from packit_sim.game.generation.jobs import GenerationError
from packit_sim.game.generation.puzzle_pieces import NODES, PuzzlePiece
from packit_sim.game.generation.puzzles import (
    CUTTERS,
    PuzzleJob,
    generate_puzzles,
)
from packit_sim.geometry import rotations
from packit_sim.placement import is_inside

KINDS: tuple[PuzzleName, ...] = tuple(CUTTERS)
EXACT = "guillotine", "pinwheel"

SMALL = PuzzleJob(KINDS, (5,), 1, 7)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("puzzles") / "small"
    generate_puzzles(SMALL, path)
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def drawn(kind: PuzzleName, pieces: int, seed: int) -> list[PuzzlePiece]:
    rng = np.random.default_rng(seed)
    while (found := CUTTERS[kind].cut(pieces, rng)) is None:
        pass
    return found


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("pieces", "seed"), [(8, 1), (13, 2)])
def test_the_pieces_fill_the_box_and_come_in_from_above(
    kind: PuzzleName, pieces: int, seed: int
) -> None:
    box = cut_puzzle(kind, pieces, seed)
    assert len(box.placed) == pieces and box.cells == (100, 100, 100)
    assert all(one.item.shape.is_solid and is_inside(box.cells, one) for one in box.placed)
    assert not [*insertion_problems(box.placed)]
    if kind in EXACT:
        assert box.density == pytest.approx(1, abs=1e-12)
    else:
        assert 0.996 < box.density < 1


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", KINDS)
def test_many_seeds_give_puzzles(kind: PuzzleName) -> None:
    cutter = CUTTERS[kind]
    for seed in range(12):
        for pieces in (cutter.min_pieces, 8, 16, 24, 32, cutter.max_pieces):
            box = cut_puzzle(kind, pieces, seed)
            assert len(box.placed) == pieces and 0.995 < box.density < 1 + 1e-9


def test_a_dataset_holds_by_the_oracle_and_finds_its_library_where_it_is_moved(
    folder: Path, tmp_path: Path
) -> None:
    moved = tmp_path / "elsewhere"
    shutil.copytree(folder, moved)
    library = dataset_library(moved)
    assert library.path.parent == moved
    report = verify_dataset(moved, library)
    assert report.is_valid, "\n".join(map(str, report.problems))
    tasks = load_tasks(moved)
    assert [task.pack.provenance for task in tasks] == [*SMALL.records]
    assert all(len(task.items) == task.pack.provenance.pieces for task in tasks)  # type: ignore[union-attr]


@pytest.mark.slow
def test_a_fresh_process_writes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    options = [f"--puzzle={kind}" for kind in KINDS] + ["--pieces=5", "--seed=7"]
    command = [sys.executable, "-m", "packit_sim", "generate", *options, "--out", "again"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    assert contents(tmp_path / "again") == contents(folder)


def test_packs_of_one_job_are_extended_and_others_are_kept(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    one = PuzzleJob(("guillotine",), (5,), 1, 7)
    generate_puzzles(one, copy)
    two = generate_puzzles(replace(one, packs=2), copy)
    assert read_packs(copy / "packs.jsonl") == two and len(two) == 2
    with pytest.raises(GenerationError, match="other packs than these puzzles"):
        generate_puzzles(replace(one, seed=50), copy)


def test_a_pack_that_is_not_the_whole_puzzle_is_found_out(folder: Path, tmp_path: Path) -> None:
    library = dataset_library(folder)
    pack = next(
        pack
        for pack in read_packs(folder / "packs.jsonl")
        if pack.provenance.cuts == "polycubes"  # type: ignore[union-attr]
    )

    def problems(changed: Pack) -> str:
        write_packs(tmp_path / "packs.jsonl", [changed])
        return "\n".join(map(str, verify_dataset(tmp_path, library).problems))

    assert not problems(pack)
    assert "from above" in problems(replace(pack, items=pack.items[::-1]))
    just_full = replace(pack, density=1 - PUZZLE_SLACK)
    assert not list(puzzle_problems(just_full, just_full.provenance))
    kept = pack.items[:-1]
    density = sum(library[one.shape].volume * one.scale for one in kept)
    found = problems(replace(pack, items=kept, density=density))
    assert "has 5 pieces, but 4 are in the box" in found and "fill the box" in found
    assert not verify(replace(pack, items=kept, density=density), library)


@pytest.mark.parametrize("kind", KINDS)
def test_equal_pieces_have_one_shape_in_any_rotation(kind: PuzzleName) -> None:
    piece = max(drawn(kind, 6, 3), key=lambda piece: len(piece.faces))
    own = piece.item()
    ends = own.center + own.item.mesh.bounds
    cut = [piece.vertices.min(axis=0), piece.vertices.max(axis=0)]
    assert np.allclose(ends * 1e6, cut, atol=20)
    for matrix in rotations.MATRICES[[3, 9, 14, 22]]:
        turned = piece.vertices @ matrix.T
        again = replace(piece, vertices=turned - turned.min(axis=0)).item()
        assert again.item.shape == own.item.shape
        assert again.item.scale == own.item.scale


def test_pinwheels_are_separated_by_no_plane() -> None:
    rng = np.random.default_rng(0)
    blocks = cuboid_cuts.divided([cuboid_cuts.WHOLE], 2, cuboid_cuts.whirled, rng)
    assert blocks is not None and len(blocks) == 9
    filled = np.zeros((NODES,) * 3, dtype=int)
    for start, stop in blocks:
        filled[tuple(map(slice, start, stop))] += 1
    assert (filled == 1).all()
    assert not cuboid_cuts.separating_planes(blocks)
    halves = cuboid_cuts.split(2, rng)
    assert halves is not None and cuboid_cuts.separating_planes(halves)


@pytest.mark.parametrize("kind", EXACT)
def test_cuboids_are_within_the_stated_limits(kind: PuzzleName) -> None:
    for seed in range(5):
        for piece in drawn(kind, 16, seed):
            sides = np.ptp(piece.vertices, axis=0) / 40_000
            assert sides.min() >= cuboid_cuts.MIN_SIDE
            share = sides.prod() / NODES**3 * 16
            assert cuboid_cuts.SHARES[0] <= share <= cuboid_cuts.SHARES[1]


@pytest.mark.parametrize("pieces", [6, 20, 32])
def test_polycubes_are_connected_and_interlock(pieces: int) -> None:
    rng = np.random.default_rng(pieces)
    labels = None
    while labels is None:
        labels = polycube_cuts.joined_cubes(pieces, rng)
    names, counts = np.unique(labels, return_counts=True)
    least, most = polycube_cuts.sizes(pieces)
    assert len(names) == pieces and least <= counts.min() and counts.max() <= most
    assert all(ndimage.label(labels == name)[1] == 1 for name in names)
    layers = np.arange(5).repeat(25).reshape(5, 5, 5)
    assert not polycube_cuts.interlocks(layers)


def test_a_twisted_polycube_has_a_closed_surface_drawn_in_by_the_clearance() -> None:
    """Four cubes around a corner, at which faces look both ways along each axis."""
    cubes = np.zeros((5, 5, 5), dtype=bool)
    cubes[(1, 1, 1, 2), (1, 1, 2, 2), (1, 2, 2, 2)] = True
    shape = polycube_cuts.piece_of(cubes).item().item.shape
    assert shape.is_solid
    volume = shape.volume / shape.extents.max() ** 3 * (0.4 - 1.5e-4) ** 3
    area = 18 * 0.04
    assert volume == pytest.approx(4 * 0.2**3 - area * 0.75e-4, rel=1e-4)


@pytest.mark.parametrize("name", curved_cuts.PROFILES)
def test_two_curved_pieces_leave_only_the_gap(name: str) -> None:
    block = (0, 0, 0), (10, 12, 8)
    surface = curved_cuts.CutSurface(0, 1, curved_cuts.PROFILES[name], 3, 7)
    pieces = [piece.item() for piece in surface.cut(block)]
    volume = sum(one.item.volume for one in pieces)
    sizes = np.array([0.4, 0.48, 0.32])
    gaps = 2 * curved_cuts.GAP / 1e6 * sizes[1] * sizes[2]
    assert volume == pytest.approx(sizes.prod() - gaps, rel=1e-4)
    low, high = (one.center - one.item.extents / 2 for one in pieces)
    assert low[0] == pytest.approx(0, abs=3e-4) and high[0] == pytest.approx(0.12, abs=3e-4)


@pytest.mark.parametrize(
    ("kind", "pieces", "message"),
    [
        (
            "hexagons",
            8,
            "no puzzle 'hexagons': choose from guillotine, pinwheel, polycubes, curved",
        ),
        ("curved", 0, "pieces 0 is not possible: 2 to 64 for a curved puzzle"),
        ("polycubes", 200, "pieces 200 is not possible: 2 to 40 for a polycubes puzzle"),
        ("pinwheel", 4, "pieces 4 is not possible: 5 to 48 for a pinwheel puzzle"),
    ],
)
def test_what_can_not_be_cut_is_refused(kind: str, pieces: int, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        cut_puzzle(kind, pieces)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=message):
        PuzzleJob((kind,), (8, pieces))  # type: ignore[arg-type]


def packit(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["generate", *map(str, arguments)])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--puzzle=hexagons"], "no puzzle 'hexagons'"),
        (["--puzzle=curved", "--pieces=1"], "pieces 1 is not possible"),
        (["--pieces=8"], "--pieces has no effect without --puzzle"),
        (["--shapes=here"], "--shapes has no effect without --puzzle"),
        (["--puzzle=curved", "--size-range", "1", "2"], "--size-range has no effect with --puzzle"),
    ],
)
def test_options_that_do_not_belong_together_are_refused(
    options: list[str], message: str, tmp_path: Path
) -> None:
    result = packit(*options, "--out", tmp_path / "new")
    assert isinstance(result.exception, PackItError) and message in str(result.exception)
    assert not (tmp_path / "new").exists()


def test_the_command_writes_packs_and_pieces(tmp_path: Path) -> None:
    options = ["--puzzle=guillotine", "--pieces=5", "--packs=2", "--shapes", tmp_path / "pieces"]
    result = packit(*options, "--out", tmp_path / "new")
    assert result.exit_code == 0, result.output
    packs = read_packs(tmp_path / "new" / "packs.jsonl")
    assert [pack.provenance for pack in packs] == [
        Puzzle(cuts="guillotine", pieces=5, seed=seed) for seed in (0, 1)
    ]
    assert dataset_library(tmp_path / "new").path == tmp_path / "pieces"


@pytest.mark.parametrize("number", [0, 10, 20, 30])
def test_the_generator_cuts_the_bundled_puzzles(number: int) -> None:
    pack = read_packs(dataset_file("puzzles"))[number]
    record = pack.provenance
    assert isinstance(record, Puzzle)
    box = cut_puzzle(record.cuts, record.pieces, record.seed)
    assert Pack.of(box, pack.library, record) == pack


def test_the_benchmark_writes_a_table_and_a_plot_and_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    from benchmarks import puzzles

    rule = "largest-first/aligned/blbf"
    monkeypatch.setattr(puzzles, "KINDS", ("guillotine", "pinwheel"))
    monkeypatch.setattr(puzzles, "PIECES", (5,))
    monkeypatch.setattr(puzzles, "RULE", rule)
    monkeypatch.setattr(puzzles, "SEARCH", f"{rule}+lns=2")
    monkeypatch.setattr(puzzles, "LABELS", {rule: "rule", f"{rule}+lns=2": "search"})
    options = ["--boxes=2", "--searched=1", "--folder", tmp_path / "f", "--out", tmp_path]
    monkeypatch.setattr(sys, "argv", ["puzzles", *map(str, options)])
    puzzles.main()
    table = capsys.readouterr().out
    assert table.count("| `guillotine` | 5 |") == table.count("| `pinwheel` | 5 |") == 1
    written = (tmp_path / "puzzles.json").read_text()
    assert (tmp_path / "puzzles.png").stat().st_size > 10_000
    results = (tmp_path / "f" / "results.jsonl").read_bytes()
    puzzles.main()
    assert capsys.readouterr().out == table
    assert (tmp_path / "puzzles.json").read_text() == written
    assert (tmp_path / "f" / "results.jsonl").read_bytes() == results
