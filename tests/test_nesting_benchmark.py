"""The benchmark of nesting: results are stored once, verified again, and tabulated."""

import gzip
import json
from pathlib import Path
from unittest.mock import patch

import pytest
from trimesh import creation

pytest.importorskip("matplotlib")
from benchmarks.nesting import ablations, cases, report
from benchmarks.nesting.cases import CASES, Case, names
from benchmarks.nesting.runs import Results, Search, run_all
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.item_types import ItemType


@pytest.fixture(name="small")
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every instance of the literature is four cubes in a strip."""
    box = creation.box((1, 1, 1))

    def cubes(name: str, rotations: str) -> Case:
        types = (ItemType("cube", box.vertices, box.faces, 4, rotations),)
        strip = BoxContainer((2, 2, float("inf")))
        others = {"sparrow-3d, 60 s": 2.0, "sparrow-3d, 10 min": 1.0, "record before": 1.5}
        return Case("literature", name, rotations, types, strip, "strip", others)

    monkeypatch.setitem(CASES, "literature", cubes)


def test_results_are_stored_once_verified_and_tabulated(
    small, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(report, "PICTURED", (("literature", "four cubes", "fixed"),))
    searches = [Search("literature", "four cubes", "fixed", seed, 60) for seed in (0, 1)]
    results = Results(tmp_path)
    run_all(searches, results, workers=1)
    assert results.verify() == []
    stored = results.read()
    assert [run["score"] for run in stored.values()] == pytest.approx([1, 1], abs=1e-3)
    run_all(searches, results, workers=1)
    assert results.read() == stored and capsys.readouterr().out.count("done before") == 2
    report.write_report(stored, tmp_path)
    page = (tmp_path / "nesting.md").read_text()
    row = "| `four cubes` | fixed | 1.00 (2) | 1.00 | - | 2.00 | 1.00 | 1.50 | 0.500 | - | yes |"
    assert row in page and (tmp_path / "nesting.png").stat().st_size > 0
    assert "*four cubes, fixed: height 1.00*" in page
    assert (tmp_path / "nesting-literature-four cubes.png").stat().st_size > 1000


def test_a_packing_that_was_changed_is_found(small, tmp_path) -> None:
    results = Results(tmp_path)
    search = Search("literature", "four cubes", "fixed", 0, 60)
    run_all([search], results, workers=1)
    file: Path = results.packings / search.file
    content = json.loads(gzip.decompress(file.read_bytes()))
    content["placements"][0][2 + 3] += 0.1
    file.write_bytes(gzip.compress(json.dumps(content).encode()))
    assert any("crosses" in problem or "reaches" in problem for problem in results.verify())
    del content["placements"][0]
    file.write_bytes(gzip.compress(json.dumps(content).encode()))
    assert any("not all items" in problem for problem in results.verify())
    file.unlink()
    assert any("is missing" in problem for problem in results.verify())


def test_the_cases_are_those_that_others_packed() -> None:
    assert len(names("literature")) == 10 and len(names("strips")) == 6
    case = cases.strips("0", "cube")
    assert sum(each.volume for each in case.types) == pytest.approx(1.148, abs=5e-4)
    liu = cases.literature("Liu et al. 2015/Experiment1", "axis-8")
    assert liu.others["sparrow-3d, 60 s"] == 24.35


@pytest.mark.parametrize("variant", ["no construction", "overlap without sizes"])
def test_a_variant_of_the_search_is_measured_once(
    variant, small, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(ablations, "STRIPS", (("literature", "four cubes", "fixed"),))
    monkeypatch.setattr(ablations, "WARM_UP", 0)
    ablations.VARIANTS[variant]()
    try:
        for _ in range(2):
            ablations.measure(variant, 1.0, [0], 1, tmp_path)
    finally:
        patch.stopall()
    (run,) = ablations.read(tmp_path).values()
    assert run["valid"] and run["score"] == pytest.approx(1, abs=1e-3)
    assert capsys.readouterr().out.count(variant) == 1
    ablations.measure(ablations.WHOLE, 1.0, [0], 1, tmp_path)
    report.write_report({}, tmp_path)
    assert f"| {variant} | 1.00 (1) | 1.000 |" in (tmp_path / "nesting.md").read_text()
