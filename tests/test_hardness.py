"""The curve of hardness, for evolutions computed by hand and for real ones."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from PIL import Image
from typer.testing import CliRunner

from packit_sim.cli.app import app
from packit_sim.core.errors import PackItError
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import read_packs
from packit_sim.game.datasets.packs import LibraryRef, Pack, PackedItem
from packit_sim.game.datasets.provenance import Evolved
from packit_sim.game.generation.jobs import GenerationJob, generate
from packit_sim.game.paper import hardness
from packit_sim.libraries.library import ShapeLibrary

SMALL = EvolutionSettings(
    *(8, 8, 2, 2), generations=6, patience=3, keep_every=2, size_range=(0.6, 0.8)
)


def pack(seed: int, after: int, density: float) -> Pack:
    evolved = Evolved(seed=seed, generation=0, size=1.0, settings=SMALL, after=after)
    items = (PackedItem("cube", density, 0, (0, 0, 0)),)
    return Pack(LibraryRef("zoo", "1", ""), (100, 100, 100), items, density, evolved)


def test_an_evolution_that_ended_counts_by_its_last_pack() -> None:
    packs = [
        pack(0, 0, 0.2),
        pack(0, 50, 0.4),
        pack(1, 0, 0.3),
        pack(1, 50, 0.5),
        pack(1, 100, 0.6),
    ]
    totals = {(0, 0): 1.0, (0, 50): 0.7, (1, 0): 0.8, (1, 50): 0.65, (1, 100): 0.5}
    points = hardness.curve(hardness.by_evolution(packs, Path("history")), totals)
    assert [(point.generation, point.under_way) for point in points] == [(0, 2), (50, 2), (100, 1)]
    assert [p.reward.mean for p in points] == pytest.approx([0.9, 0.675, 0.6])
    assert [p.success[1.0].mean for p in points] == [50, 0, 0]
    assert [p.success[0.7].mean for p in points] == [100, 50, 50]
    assert [p.density.mean for p in points] == pytest.approx([0.25, 0.45, 0.5])
    assert (points[0].reward.low, points[0].reward.high) == pytest.approx((0.8, 1.0))


def test_packs_without_a_history_are_refused() -> None:
    best = pack(3, 0, 0.2)
    single = replace(best, provenance=structs.replace(best.provenance, after=None))
    with pytest.raises(PackItError, match=r"dataset, pack 1 records no generation .* --history"):
        hardness.by_evolution([pack(0, 0, 0.2), single], Path("dataset"))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("history") / "tiny"
    library = ShapeLibrary.open("everyday").split("test")
    generate(
        GenerationJob(library, 3, 0, "test", history=True, settings=SMALL), folder / "test.jsonl"
    )
    return folder


def test_a_history_becomes_a_table_a_json_and_a_picture(dataset: Path, tmp_path: Path) -> None:
    arguments = ["reproduce", "evolution", "--history-dataset", str(dataset)]
    found = CliRunner().invoke(app, [*arguments, "--workers", "1", "--out", str(tmp_path / "new")])
    assert found.exit_code == 0 and "the packs of 3 evolutions" in found.output
    content = json.loads((tmp_path / "new" / "evolution.json").read_text())
    assert content["settings"] == SMALL.to_json()
    under_way = {p["generation"]: p["under_way"] for p in content["points"]}
    after = Counter(p.provenance.after for p in read_packs(dataset / "test.jsonl"))
    assert under_way == after and under_way[0] == 3
    densities = [point["density"]["mean"] for point in content["points"]]
    assert densities == sorted(densities)
    assert "| 0 | 3 |" in (tmp_path / "new" / "evolution.md").read_text()
    with Image.open(tmp_path / "new" / "evolution.png") as picture:
        assert picture.width >= 1000 and len(np.unique(np.asarray(picture))) > 100


def test_a_pack_that_was_kept_again_is_there_once(dataset: Path) -> None:
    evolutions = hardness.by_evolution(read_packs(dataset / "test.jsonl"), dataset)
    packs, at = hardness.distinct(evolutions)
    expected = {(seed, pack.items) for seed, kept in evolutions.items() for pack in kept.values()}
    assert len(packs) == len(expected) <= len(at) == sum(map(len, evolutions.values()))
    for seed, kept in evolutions.items():
        for after, pack in kept.items():
            assert packs[at[seed, after]].items == pack.items
