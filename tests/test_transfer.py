"""Shapes by formulas, and the comparison of the champion with rules on sets of tasks."""

import json
import sys

import numpy as np
import pytest

from benchmarks import transfer
from benchmarks.formula_shapes import FAMILIES, write_shapes
from packit_sim import ShapeLibrary
from packit_sim.parts.packings.builtin_instances import builtin_instance
from packit_sim.parts.packings.instances import write_instance


@pytest.mark.parametrize("name", FAMILIES)
def test_shapes_by_formulas_are_closed_and_different(name) -> None:
    rng = np.random.default_rng(0)
    meshes = [FAMILIES[name](rng) for _ in range(6)]
    assert all(mesh.is_watertight and mesh.is_winding_consistent for mesh in meshes)
    assert all(0.01 < mesh.volume / mesh.bounding_box.volume < 1 for mesh in meshes)
    assert len({round(mesh.volume, 6) for mesh in meshes}) == 6


def test_the_same_seed_writes_the_same_shapes(tmp_path) -> None:
    for folder in ("one", "again"):
        write_shapes(tmp_path / folder, 2, 5)
    one, again = (ShapeLibrary.open(tmp_path / folder) for folder in ("one", "again"))
    assert len(one) == 2 * len(FAMILIES)
    assert [one[id].digest for id in one] == [again[id].digest for id in again]


@pytest.mark.slow
def test_the_items_of_the_built_in_instances_are_all_different(tmp_path) -> None:
    library = transfer.builtin_items(tmp_path)
    assert len({library[id].digest for id in library}) == len(library) > 20


def test_the_literatures_items_are_read_where_they_are(tmp_path, monkeypatch) -> None:
    assert "polytopes of the literature" not in transfer.sets(None)
    for name in ("one/first", "one/again", "other/first"):
        types, container, _ = builtin_instance("gears-12")
        write_instance(types, container, tmp_path / "data" / f"{name}.json")
    monkeypatch.setattr(transfer, "literature_names", lambda: ["one/first", "one/again"])
    open_library, _ = transfer.sets(tmp_path / "data")["polytopes of the literature"]
    assert len(open_library(tmp_path / "shapes")) == 4


@pytest.mark.slow
def test_the_benchmark_compares_each_set(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(transfer, "ROUNDS", 1)
    options = ["--packs", "1", "--workers", "1", "--folder", str(tmp_path), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["transfer", *options])
    transfer.main()
    found = json.loads((tmp_path / "transfer.json").read_text())["sets"]
    assert list(found) == [*transfer.sets(None), transfer.PUZZLES]
    for each in found.values():
        assert set(each["rewards"]) == {transfer.CHAMPION, *transfer.RULES}
        best, own = (each["rewards"][name]["mean"] for name in (each["best rule"], "champion"))
        assert each["comparison"]["difference"]["mean"] == pytest.approx(own - best)
