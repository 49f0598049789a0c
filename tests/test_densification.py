"""Densification: dense packs of large items that are valid, reproducible and resumable."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from typer.testing import CliRunner

from benchmarks import densification as benchmark
from packit_sim import Box, Item
from packit_sim.cli.app import app
from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets import datasheet
from packit_sim.game.datasets.densification_settings import DensificationSettings
from packit_sim.game.datasets.pack_checks import density_problems, verify
from packit_sim.game.datasets.pack_files import read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Densified
from packit_sim.game.generation.densification import (
    Densification,
    DensificationError,
    DensificationState,
)
from packit_sim.game.generation.holes import Holes
from packit_sim.game.generation.jobs import GenerationError, GenerationJob, generate
from packit_sim.geometry import rotations
from packit_sim.libraries.library import ShapeLibrary

SMALL = DensificationSettings(items=(4, 6), floor=0.05, largest=0.4, pool=8, rounds=3, moves=6)


@pytest.fixture(scope="module")
def library() -> ShapeLibrary:
    return ShapeLibrary.open("everyday").split("train")


def dense(library: ShapeLibrary, seed: int = 7, settings=SMALL) -> Densification:
    return finished(Densification(library, seed, settings))


def finished(densification: Densification) -> Densification:
    while not densification.is_over:
        densification.step()
    return densification


@pytest.fixture(scope="module")
def undisturbed(library) -> Densification:
    return dense(library)


def test_a_pack_is_valid_and_keeps_to_its_settings(library, undisturbed) -> None:
    pack = undisturbed.best
    assert verify(pack, library) == []
    assert Pack.from_json(pack.to_json()) == pack
    assert pack.provenance == Densified(seed=7, rounds=3, settings=SMALL)
    volumes = [placed.item.volume for placed in pack.placed(library)]
    assert 4 <= len(volumes) <= 6
    assert min(volumes) >= 0.05 * sum(volumes)
    assert max(volumes) <= 0.4
    assert len({item.shape for item in pack.items}) == len(pack.items)


def test_a_pack_becomes_denser(undisturbed) -> None:
    assert len(undisturbed.densities) == 4
    assert undisturbed.densities[-1] > undisturbed.densities[0] + 0.05
    assert undisturbed.best.density == pytest.approx(undisturbed.densities[-1])


def test_a_resumed_densification_ends_in_the_same_pack(library, undisturbed) -> None:
    stopped = Densification(library, 7, SMALL)
    for _ in range(2):
        stopped.step()
    text = typed_json.encode(stopped.state)
    resumed = Densification(library, 7, SMALL)
    resumed.restore(typed_json.decode(text, DensificationState, ArgumentError))
    assert finished(resumed).best.to_json() == undisturbed.best.to_json()
    for seed, settings in ((8, SMALL), (7, replace(SMALL, moves=9))):
        with pytest.raises(ArgumentError, match="can't be resumed"):
            Densification(library, seed, settings).restore(stopped.state)


def test_a_pack_with_items_that_stay_too_small_is_begun_again(library) -> None:
    settings = DensificationSettings(
        items=(4, 4), floor=0.22, largest=0.4, pool=5, rounds=2, moves=6, tolerance=0.1
    )
    densification = Densification(library, 5, settings)
    states = []
    while not densification.is_over:
        densification.step()
        states.append(densification.state)
    assert [state.beginnings for state in states] == [1] * 7 + [2] * (len(states) - 7)
    assert len(states) > 7
    pack = densification.best
    volumes = [placed.item.volume for placed in pack.placed(library)]
    assert min(volumes) >= 0.22 * sum(volumes)
    assert pack.provenance.rounds == len(states) - 8
    resumed = Densification(library, 5, settings)
    resumed.restore(states[6])
    assert finished(resumed).best == pack
    assert resumed.state == densification.state


@pytest.mark.slow
def test_a_pack_is_given_up_after_five_beginnings(library) -> None:
    settings = replace(SMALL, items=(6, 6), floor=0.16, rounds=2, moves=10, tolerance=0.05)
    densification = Densification(library, 0, settings)
    with pytest.raises(DensificationError, match=r"^seed 0: the smallest item has 1\d.\d\d% of "):
        finished(densification)
    assert densification.state.beginnings == 5


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({}, None),
        ({"items": (7, 9), "pool": 9}, "items, its settings say 7 to 9"),
        ({"floor": 0.16}, "of the volume, not 0.16 at least"),
        ({"largest": 0.06}, "of the box, not 0.06 at most"),
        ({"fill": 0.02}, "of its bounding box, not 0.02 at most"),
        ({"cells": (100, 100, 104)}, "its settings say [100, 100, 104]"),
    ],
)
def test_a_contradiction_of_the_settings_is_reported(
    changes, problem, library, undisturbed
) -> None:
    pack = undisturbed.best
    recorded = structs.replace(pack.provenance, settings=replace(SMALL, **changes))
    found = list(density_problems(pack, pack.placed(library), recorded))
    assert len(found) == (problem is not None)
    assert all(problem in sentence for sentence in found)
    placed = pack.placed(library)
    volumes = [one.item.volume for one in placed]
    least = min(volumes) / sum(volumes)
    limits = replace(SMALL, items=(len(placed), len(placed)), floor=least)
    exact = structs.replace(pack.provenance, settings=limits)
    assert not list(density_problems(pack, placed, exact))
    same = tuple(structs.replace(item, shape=pack.items[0].shape) for item in pack.items)
    found = list(density_problems(replace(pack, items=same), pack.placed(library), recorded))
    assert any("of its items have the shape" in sentence for sentence in found)


COMMAND = (
    *("generate", "--dense", "--items", "3", "4", "--floor", "0.08", "--pool", "6"),
    *("--largest", "0.4", "--fill", "0.5", "--tolerance", "0.01", "--rounds", "0"),
    *("--seed", "3", "--split", "train"),
)


DENSE = DensificationSettings(
    items=(3, 4), floor=0.08, largest=0.4, fill=0.5, pool=6, rounds=0, tolerance=0.01
)


@pytest.mark.slow
def test_a_dataset_has_the_same_bytes_in_a_fresh_process(library, tmp_path) -> None:
    file = tmp_path / "here" / "train.jsonl"
    generate(GenerationJob(library, 1, 3, "train", settings=DENSE), file)
    command = [sys.executable, "-m", "packit_sim", *COMMAND, "--workers", "1", "--out"]
    subprocess.run(
        [*command, str(tmp_path / "there")], check=True, capture_output=True, env=os.environ
    )
    there = tmp_path / "there" / "train.jsonl"
    assert there.read_bytes() == file.read_bytes()
    assert verify(read_packs(there)[0], library) == []


def test_no_item_is_larger_than_allowed(library) -> None:
    settings = DensificationSettings(
        items=(5, 5), floor=0.1, largest=0.02, pool=8, rounds=2, moves=8
    )
    pack = dense(library, 0, settings).best
    assert list(density_problems(pack, pack.placed(library), pack.provenance)) == []


def test_a_job_resumes_only_with_its_settings(library, tmp_path) -> None:
    file = tmp_path / "train.jsonl"
    settings = replace(SMALL, rounds=0)
    packs = generate(GenerationJob(library, 1, 7, "train", settings=settings), file)
    assert generate(GenerationJob(library, 1, 7, "train", settings=settings), file) == packs
    for other in (replace(settings, floor=0.04), GenerationJob(library, 1).settings):
        with pytest.raises(GenerationError, match="other settings"):
            generate(GenerationJob(library, 1, 7, "train", settings=other), file)
    with pytest.raises(GenerationError, match="only evolutions have a history"):
        GenerationJob(library, 1, history=True, settings=settings)


def test_the_datasheet_has_the_command_that_generates_the_packs(library, tmp_path) -> None:
    file = tmp_path / "train.jsonl"
    generate(GenerationJob(library, 1, 3, "train", settings=DENSE), file)
    (part,) = datasheet.read(tmp_path, ShapeLibrary.open("everyday"))
    assert part.command("everyday", "here") == (
        "packit generate --dense --packs 1 --seed 3 --split train "
        "--items 3 4 --floor 0.08 --largest 0.4 --fill 0.5 --pool 6 --rounds 0 "
        "--tolerance 0.01 --out here"
    )
    page = datasheet.page(tmp_path, [part], ShapeLibrary.open("everyday"), picture="x.png")
    assert "| floor | 0.08 |" in page
    assert "bottom-left" not in page and "evolved for" not in page


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"items": (5, 4)}, "items = (5, 4) is not possible: two numbers from 1"),
        ({"items": (0, 4)}, "items = (0, 4) is not possible: two numbers from 1"),
        ({"floor": 0.05}, "floor = 0.05 is not possible: above 0, and at most 0.0417 for 24 items"),
        ({"floor": 0.0}, "floor = 0.0 is not possible"),
        ({"largest": 0.0}, "largest = 0.0 is not possible: above 0, at most 1"),
        ({"fill": 1.1}, "fill = 1.1 is not possible: above 0, at most 1"),
        ({"pool": 23}, "pool = 23 is not possible: at least 24 for 24 items with at most 1 of a"),
        ({"copies": 0}, "copies = 0 is not possible: at least 1"),
        ({"rounds": -1}, "rounds = -1 is not possible"),
        ({"moves": 0}, "moves = 0 is not possible"),
        ({"tolerance": float("nan")}, "tolerance = nan is not possible"),
    ],
)
def test_settings_are_checked(changes, message) -> None:
    with pytest.raises(ArgumentError) as raised:
        DensificationSettings(**changes)
    assert message in str(raised.value)


def test_a_library_needs_enough_large_shapes(library) -> None:
    few = ShapeLibrary(library.source, "train", dict.fromkeys(library.ids[5:], "left out"))
    with pytest.raises(DensificationError, match="shapes can have 5% of the box's volume: too few"):
        Densification(few, 0, replace(SMALL, items=(6, 6)))
    with pytest.raises(DensificationError, match="of their bounding boxes"):
        Densification(library, 0, replace(SMALL, fill=0.01))


def test_shapes_that_fill_their_bounding_boxes_are_left_out(library, undisturbed) -> None:
    assert SMALL.fill == 1 and max(fills(library, undisturbed)) > 0.3
    loose = dense(library, settings=replace(SMALL, fill=0.3, rounds=0))
    assert max(fills(library, loose)) <= 0.3


def fills(library: ShapeLibrary, densification: Densification) -> list[float]:
    return [library[item.shape].fill for item in densification.best.items]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--floor", "0.03"), "--floor has no effect without --dense: leave it out"),
        (("--dense", "--size-range", "0.5", "1"), "--size-range has no effect with --dense"),
        (("--dense", "--items", "9", "3"), "items = (9, 3) is not possible"),
        (("--dense", "--floor", "0.5"), "floor = 0.5 is not possible"),
    ],
)
def test_bad_options_are_one_clear_error(options, message, tmp_path) -> None:
    result = CliRunner().invoke(app, ["generate", *options, "--out", str(tmp_path / "new")])
    assert result.exit_code != 0
    assert message in str(result.exception or result.output)
    assert not (tmp_path / "new").exists()


def test_points_of_a_shape_never_exclude_a_feasible_placement(library) -> None:
    pack = read_packs(Path("assets/packs/everyday-v1/train.jsonl"))[3]
    box = Box()
    for placed in pack.placed(library)[::2]:
        box.place(placed.item, placed.location)
    assert compared_placements(box, library, 0.01) > 500


def test_the_same_in_a_box_with_more_rows_than_bits_of_a_word(library) -> None:
    box, rng = Box((40, 300, 40)), np.random.default_rng(0)
    for id in rng.choice(list(library), size=30).tolist():
        item = Item(library[id], (0.3 / library[id].extents.max()) ** 3)
        if len(free := np.argwhere(box.feasible(item))):
            box.place(item, free[rng.integers(len(free))].tolist())
    assert compared_placements(box, library, 0.005) > 500


def compared_placements(box: Box, library: ShapeLibrary, volume: float) -> int:
    """Check that all feasible placements of some shapes are found; return how many there are."""
    rng = np.random.default_rng(0)
    holes, compared = Holes.of(box), 0
    for id in rng.choice(list(library), size=4, replace=False).tolist():
        shape = library[id]
        scale = min(volume, holes.largest_volume(shape)) / shape.volume
        turns = rng.choice(rotations.COUNT, size=2, replace=False).tolist()
        most = 2 * math.prod(box.nodes)
        found = set(holes.placements(shape, scale, turns, most, most))
        for turn in turns:
            mask = box.feasible(Item(shape, scale, turn))
            feasible = {(turn, tuple(node)) for node in np.argwhere(mask).tolist()}
            assert feasible <= found
            compared += len(feasible)
    return compared


def test_the_benchmark_measures_packs_once(monkeypatch, tmp_path, capsys) -> None:
    tiny = {"items": (3, 3), "floor": 0.08, "pool": 6, "rounds": 0}
    monkeypatch.setattr(benchmark, "KINDS", {"tiny": tiny})
    options = ["--packs", "1", "--seconds", "0.05", "--kinds", "tiny", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["densification", *options])
    benchmark.main()
    file = tmp_path / "densification.json"
    first = file.read_bytes()
    row = json.loads(first)["runs"]["tiny"]["0"]
    assert row["items"] == row["shapes"] == 3
    assert row["smallest"] >= 0.08
    assert [0 < total <= 1 for total in row["returns"].values()] == [True, True]
    monkeypatch.setattr(benchmark, "generated", None)  # not called again
    benchmark.main()
    assert file.read_bytes() == first
    assert "tiny" in capsys.readouterr().out
