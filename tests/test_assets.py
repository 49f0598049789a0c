"""The bundled datasets: complete, valid, and correctly described.

`packit verify` is the long form: here a sample of each is held against the oracle, and with the
slow tests every pack.
"""

import hashlib
import json
import re
from pathlib import Path

import pytest

from packit_sim.core.assets import assets_folder
from packit_sim.core.check_reports import Report
from packit_sim.game.datasets.builtin import builtin_datasets
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.manifests import manifest_path
from packit_sim.game.datasets.pack_files import (
    dataset_files,
    dataset_library,
    dataset_path,
    load_tasks,
    read_packs,
    write_packs,
)
from packit_sim.game.datasets.provenance import Puzzle
from packit_sim.game.generation.jobs import work_folder

SAMPLE = 2
"""Packs of each file: the first, the last, and with more, what lies evenly between."""

FILES = [file for name in builtin_datasets() for file in dataset_files(name)]
NAMES = [f"{file.parent.name}/{file.stem}" for file in FILES]

ROOT = Path(__file__).parents[1]


def problem_lines(report: Report) -> str:
    return "\n".join(map(str, report.problems))


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_a_file_is_the_one_that_its_manifest_describes(file: Path) -> None:
    manifest = json.loads(manifest_path(file).read_text())
    assert manifest["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    packs = read_packs(file)
    assert manifest["packs"] == len(packs)
    assert [ref["digest"] for ref in manifest["libraries"]] == [dataset_library(file).digest]
    origins = [pack.provenance for pack in packs]
    if all(isinstance(one, Puzzle) for one in origins):
        assert len(set(origins)) == len(packs)
        return
    assert len({(one.seed, getattr(one, "after", None)) for one in origins}) == len(packs)
    assert len({one.settings for one in origins}) == 1


@pytest.mark.parametrize(
    "file",
    [
        pytest.param(file, id=name, marks=[] if "starter" in name else [pytest.mark.slow])
        for file, name in zip(FILES, NAMES, strict=True)
    ],
)
def test_a_sample_is_valid(file: Path, tmp_path: Path) -> None:
    """In a file of the same name, so that the split of the shapes is looked at too."""
    packs = read_packs(file)
    places = {round(n * (len(packs) - 1) / (SAMPLE - 1)) for n in range(SAMPLE)}
    write_packs(tmp_path / file.name, [packs[n] for n in sorted(places)])
    report = verify_dataset(tmp_path, dataset_library(file))
    assert report.is_valid, problem_lines(report)
    assert report.packs == len(places)


@pytest.mark.parametrize("file", FILES, ids=NAMES)
def test_tasks_hold_what_their_packs_hold(file: Path) -> None:
    for task in load_tasks(file):
        assert len(task.items) == len(task.solution) == len(task.pack.items) > 1
        assert task.volume == pytest.approx(task.pack.density)


def test_every_dataset_is_named_with_its_licence() -> None:
    readme = (assets_folder() / "README.md").read_text(encoding="utf-8")
    for name in builtin_datasets():
        assert re.search(rf"^\| `packs/{re.escape(name)}/` \|.*CC0-1\.0", readme, re.MULTILINE), (
            name
        )


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", builtin_datasets())
def test_every_pack_is_valid(name: str) -> None:
    report = verify_dataset(dataset_path(name), dataset_library(name))
    assert report.is_valid, problem_lines(report)


@pytest.mark.slow
@pytest.mark.parametrize("name", builtin_datasets())
def test_a_page_is_of_the_dataset_that_there_is(name: str) -> None:
    page = ROOT / "docs" / "reference" / f"{name}.md"
    if not page.exists():
        pytest.skip(f"{page.name}: there is none")
    if any(work_folder(file).exists() for file in dataset_files(name)):
        pytest.skip(f"{name} is being generated")
    digests = set(re.findall(r"`([0-9a-f]{64})` \|$", page.read_text(), re.MULTILINE))
    assert digests == {hashlib.sha256(f.read_bytes()).hexdigest() for f in dataset_files(name)}
