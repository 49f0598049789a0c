"""The benchmark of nesting: results are stored once, verified again, and tabulated."""

import gzip
import json
import math
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from trimesh import creation, transformations

pytest.importorskip("matplotlib")
from benchmarks.nesting import ablations, cases, records, report
from benchmarks.nesting.__main__ import main
from benchmarks.nesting.cases import CASES, Case, names
from benchmarks.nesting.runs import Results, Search, run_all
from packit_sim import NestSettings, nest
from packit_sim.core.errors import ArgumentError
from packit_sim.parts.packings.containers import BoxContainer
from packit_sim.parts.packings.instance_names import BUILTIN_NAMES
from packit_sim.parts.packings.instances import write_instance, write_solution
from packit_sim.parts.packings.item_types import ItemType
from packit_sim.parts.packings.packing import Packing
from packit_sim.parts.packings.placements import Placement


@pytest.fixture(name="small")
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every instance of the literature is four cubes in a strip."""
    box = creation.box((1, 1, 1))

    def cubes(name: str, rotations: str, data: Path | None) -> Case:
        types = (ItemType("cube", box.vertices, box.faces, 4, rotations),)
        strip = BoxContainer((2, 2, float("inf")))
        others = {"sparrow-3d, 60 s": 2.0, "sparrow-3d, 10 min": 1.0, "record before": 1.5}
        return Case("literature", name, rotations, types, strip, "strip", others)

    monkeypatch.setitem(CASES, "literature", cubes)
    case = cubes("", "fixed", None)  # kernels that are not compiled yet would take up the time
    nest(case.types, case.container, settings=NestSettings(workers=1, iterations=1))


@pytest.mark.slow
def test_results_are_stored_once_verified_and_tabulated(
    small, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(report, "PICTURED", (("literature", "four cubes", "fixed"),))
    searches = [Search("literature", "four cubes", "fixed", seed, 60) for seed in (0, 1)]
    results = Results(tmp_path, tmp_path)
    run_all(searches, results, workers=1)
    assert results.verify() == []
    stored = results.read()
    assert [run["score"] for run in stored.values()] == pytest.approx([1, 1], abs=1e-3)
    run_all(searches, results, workers=1)
    assert results.read() == stored and capsys.readouterr().out.count("done before") == 2
    report.write_report(stored, tmp_path, tmp_path)
    page = (tmp_path / "nesting.md").read_text()
    assert (
        "| `four cubes` | 4 | fixed | 1.00 (2) | 1.000 | - | - | 1.00 | 1.00 | - | 2.00 |" in page
    )
    assert (tmp_path / "nesting.png").stat().st_size > 0
    assert "*four cubes, fixed: height 1.00*" in page
    assert (tmp_path / "nesting-literature-four cubes.png").stat().st_size > 1000


def test_a_packing_that_was_changed_is_found(small, tmp_path) -> None:
    results = Results(tmp_path, tmp_path)
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
    assert len(names("literature", None)) == 14 and len(names("strips", None)) == 6
    case = cases.strips("0", "cube", None)
    assert sum(each.volume for each in case.types) == pytest.approx(1.148, abs=5e-4)
    assert cases.published()["Liu et al. 2015/Experiment1", "axis-8"]["sparrow-3d, 60 s"] == 24.35


def literatures(folder: Path) -> Path:
    """Writes four cubes in place of one of the literature's instances."""
    box = creation.box((1, 1, 1))
    types = (ItemType("cube.obj", box.vertices, box.faces, 4),)
    file = folder / "data" / "Stoyan et al. 2005" / "Example1.json"
    write_instance(types, BoxContainer((2, 2, float("inf"))), file)
    return folder / "data"


def test_the_literature_needs_a_folder_of_its_meshes(tmp_path, capsys, monkeypatch) -> None:
    name = "Stoyan et al. 2005/Example1"
    with pytest.raises(ArgumentError, match=r"'Stoyan.*' are not part of this project: give"):
        cases.literature(name, "cube", None)
    folder = literatures(tmp_path)
    case = cases.literature(name, "cube", folder)
    assert sum(each.demand for each in case.types) == 4 and case.others["record before"] == 16
    results = Results(tmp_path, folder)
    run_all([Search("literature", name, "cube", 0, 1)], results, workers=1)
    assert results.verify() == []
    own = ["nesting", "--out", str(tmp_path), "--verify"]
    monkeypatch.setattr("sys.argv", own)
    main()
    output = capsys.readouterr().out
    assert "0 packings, 0 problems" in output
    assert "1 packings not verified: give --data, folder of the literature's" in output
    monkeypatch.setattr("sys.argv", [*own, "--data", str(folder)])
    main()
    assert "1 packings, 0 problems" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["nesting", "literature", "--out", str(tmp_path)])
    with pytest.raises(SystemExit):
        main()
    assert "literature needs --data: folder of" in capsys.readouterr().err


def test_without_the_literature_the_built_in_instances_are_measured(tmp_path) -> None:
    assert set(names("clearance", None)) <= set(BUILTIN_NAMES)
    assert set(names("clearance", tmp_path)) <= set(names("literature", None))
    assert cases.clearance("gears-12", "cube", None).clearance == pytest.approx(0.1)
    results = Results(tmp_path)
    run_all([Search("builtin", "rings-12", "cube", 0, 0.5)], results, workers=1)
    (found,) = results.read().values()
    assert found["others"]["optimum"] == pytest.approx(8) and results.verify() == []
    report.write_report(results.read(), tmp_path)
    assert "| `rings-12` | cube | 0.5 s | 0 |" in (tmp_path / "nesting.md").read_text()
    assert (tmp_path / "nesting-builtin.png").stat().st_size > 1000


@pytest.mark.parametrize("variant", ["no construction", "overlap without sizes"])
def test_a_variant_of_the_search_is_measured_once(
    variant, small, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(ablations, "BUILTIN_STRIPS", (("literature", "four cubes", "fixed"),))
    monkeypatch.setattr(ablations, "WARM_UP", 0)

    def measure(seed: int) -> None:
        try:
            ablations.measure(variant, 1.0, [seed], 1, tmp_path)
        finally:
            patch.stopall()

    for _ in range(2):
        measure(0)
    (run,) = ablations.read(tmp_path).values()
    assert run["valid"] and run["score"] == pytest.approx(1, abs=1e-3)
    assert capsys.readouterr().out.count(variant) == 1
    ablations.measure(ablations.WHOLE, 1.0, [0], 1, tmp_path)
    report.write_report({}, tmp_path)
    assert f"| {variant} | 1.00 (1) | 1.000 |" in (tmp_path / "nesting.md").read_text()
    measure(1)
    ablations.measure(ablations.WHOLE, 1.0, [1], 1, tmp_path)
    report.write_report({}, tmp_path)
    assert f"| {variant} | 1.00 (2) | 1.000 (0.000) |" in (tmp_path / "nesting.md").read_text()


def test_a_record_is_checked_by_its_file_and_the_instance(tmp_path) -> None:
    folder = literatures(tmp_path)
    name = "Stoyan et al. 2005/Example1"
    case = cases.literature(name, "fixed", folder)
    placements = []
    for x, y in ((0.5, 0.5), (1.5, 0.5), (0.5, 1.5), (1.5, 1.5)):
        placements.append(Placement.from_matrix(0, transformations.translation_matrix((x, y, 0.5))))
    file = tmp_path / "Stoyan-et-al-2005-Example1-fixed.json"
    write_solution(Packing(case.types, case.container, tuple(placements)), file, f"{name}.json")
    assert records.problems(file, folder) == []
    good = json.loads(file.read_text())

    def changed(matrix: Any) -> list[str]:
        content = json.loads(json.dumps(good))
        content["items"][0]["transformation"]["matrix"] = np.transpose(matrix).tolist()
        file.write_text(json.dumps(content))
        return records.problems(file, folder)

    def problems_at(x: float, y: float, z: float) -> list[str]:
        return changed(transformations.translation_matrix((x, y, z)))

    assert problems_at(0.5, 0.5, 0.5) == []
    assert any("overlaps" in text for text in problems_at(0.51, 0.5, 0.5))
    assert any("overlaps" in text for text in problems_at(1.5, 0.5, 0.5))
    assert any("leaves the base" in text for text in problems_at(0.49, 0.5, 0.5))
    assert problems_at(0.5, 0.5, 0.6) == ["the height is 1.1, not 1.0"]
    slanted = transformations.euler_matrix(0, 0, math.pi / 2)
    slanted[:3, 3] = 0.5
    assert changed(slanted) == ["item 0 (cube.obj) has a rotation that is not of fixed"]
    for count, problem in ((3, "1 of cube.obj are missing"), (5, "item 4 (cube.obj) is not one")):
        file.write_text(json.dumps({**good, "items": (2 * good["items"])[:count]}))
        assert any(problem in text for text in records.problems(file, folder))


def test_the_name_of_a_record_says_its_rotations(tmp_path) -> None:
    folder = literatures(tmp_path)
    file = tmp_path / "cubes.json"
    file.write_text('{"instancePath": "Stoyan et al. 2005/Example1.json", "items": []}')
    assert records.problems(file, folder) == [
        "the name does not end with the rotations: -fixed or -axis-N"
    ]


def test_a_body_inside_another_one_is_found() -> None:
    boxes = [creation.box((side, side, side)) for side in (3, 1)]
    types = [ItemType(str(n), box.vertices, box.faces) for n, box in enumerate(boxes)]
    bodies = [(each.name, each.vertices, each) for each in types]
    assert records._conflicts(bodies, 1e-4) == ["0 and 1 are one inside the other"]


def test_only_heights_below_the_best_published_are_records(tmp_path) -> None:
    folder = literatures(tmp_path)
    results = Results(tmp_path, folder)
    searches = [Search("literature", "Stoyan et al. 2005/Example1", "fixed", 0, 1)]
    run_all(searches, results, workers=1)
    records.write_records(results, tmp_path / "records", folder)
    (file,) = (tmp_path / "records").iterdir()
    assert records.problems(file, folder) == []
    stored = json.loads(results.file.read_text())
    for run in stored["runs"].values():
        run["score"] = 17.46
    results.file.write_text(json.dumps(stored))
    file.unlink()
    records.write_records(results, tmp_path / "records", folder)
    assert not list((tmp_path / "records").iterdir())
