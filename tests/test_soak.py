"""The soak finds what grows, and its page has its results."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path

import pytest
from trimesh import creation

pytest.importorskip("pybullet", reason="PyBullet is not installed")

from campaigns import soak
from packit_sim.game.datasets.packs import ItemRecord, LibraryRef, Pack
from packit_sim.geometry.lattice import BOX_CELLS
from packit_sim.libraries.library import ShapeLibrary


@pytest.mark.slow
def test_episodes_are_played_and_everything_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PACKIT_RENDERER", "software")
    opened = []
    creation.box((1, 1, 1)).export(tmp_path / "cube.stl")
    library = ShapeLibrary.open(tmp_path)
    items = (ItemRecord("cube", 0.1),)
    pack = Pack(LibraryRef.of(library), BOX_CELLS, (), 0.0, outside=items)
    tasks = [pack.task(library)]
    samples = list(islice(soak.play(tasks, 0, 1, lambda: opened.append(os.dup(0))), 2))
    assert [one["episode"] for one in samples] == [1, 2] and len(opened) == 2
    assert samples[1]["descriptors"] == samples[0]["descriptors"] + 1
    assert samples[1]["clients"] == samples[0]["clients"]
    for handle in opened:
        os.close(handle)


def made_up(growth: float) -> list[soak.Sample]:
    """100 samples with so many MB and descriptors more in each."""
    return [
        {
            "episode": 100 * n,
            **dict.fromkeys(soak.MEMORIES, 1000 + growth * n + n % 3),
            "descriptors": 3 + growth * n,
        }
        for n in range(1, 101)
    ]


@pytest.mark.parametrize(("growth", "flat"), [(0.0, True), (1.0, False)])
def test_growth_is_found(growth: float, flat: bool) -> None:
    samples = made_up(growth)
    assert soak.growth(samples, soak.RESIDENT)[0] == pytest.approx(100 * growth, abs=1)
    assert soak.is_flat(samples, soak.RESIDENT) == soak.is_flat(samples, "descriptors") == flat


def test_few_samples_are_fitted_one_by_one() -> None:
    slope, low, high = soak.growth(made_up(1.0)[:9], soak.RESIDENT)
    assert low <= slope <= high and slope == pytest.approx(100, abs=50)


def test_samples_are_tabulated_and_drawn(tmp_path: Path) -> None:
    results = {
        "samples": {"software": [{**dict.fromkeys(soak.COUNTS, 3), **one} for one in made_up(1.0)]}
    }
    table = soak.table(results)
    assert "| software | 10,000 | resident memory, MB | 1035 | 1101 | +" in table
    assert table.count("| none | yes |") == len(soak.COUNTS) - 1 and table.count("**no**") == 3
    soak.draw(results, tmp_path / "soak.png")
    assert (tmp_path / "soak.png").stat().st_size > 1000
