"""Archives of data: complete, the same each time, opened again, and valid as Croissant."""

import hashlib
import importlib
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.archives import dataset_archive
from packit_sim.game.datasets.builtin import builtin_datasets
from packit_sim.game.datasets.croissant import croissant
from packit_sim.game.datasets.pack_files import dataset_file, load_tasks, read_packs, write_packs
from packit_sim.libraries.library import ShapeLibrary, builtin_names
from tests.runs import packit

DATE = "--date", "2026-11-27"

RESPONSIBLE_AI = {
    "dataBiases",
    "dataCollection",
    "dataCollectionType",
    "dataLimitations",
    "dataPreprocessingProtocol",
    "dataReleaseMaintenancePlan",
    "dataSocialImpact",
    "dataUseCases",
    "personalSensitiveInformation",
}


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.mark.slow
def test_an_archive_of_a_dataset_has_everything_and_is_a_dataset(tmp_path, in_this_process) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "archive"
    printed = packit("datasets", "archive", "starter", "--out", out, *DATE)
    files = contents(out)
    assert {"packs.jsonl", "packs.jsonl.manifest.json", "statistics.png", "README.md"} < {*files}
    described = json.loads(files["croissant.json"])
    assert described["version"] in printed and described["version"].startswith("0.1.0+")
    assert {key.removeprefix("rai:") for key in described if "rai:" in key} == RESPONSIBLE_AI
    assert any("bottom-left-back-fill" in text for text in described["rai:dataLimitations"])
    digests = {one["contentUrl"]: one["sha256"] for one in described["distribution"]}
    assert digests == {
        name: hashlib.sha256(files[name]).hexdigest()
        for name in ("packs.jsonl", "packs.jsonl.manifest.json", "statistics.png")
    }
    sums = dict(reversed(line.split("  ")) for line in files["SHA256SUMS"].decode().splitlines())
    assert sums == {
        name: hashlib.sha256(data).hexdigest()
        for name, data in files.items()
        if name != "SHA256SUMS"
    }
    assert b"license: cc0-1.0\n" in files["README.md"] and b"## Known limits" in files["README.md"]
    assert b'date-released: "2026-11-27"' in files["CITATION.cff"]
    with zipfile.ZipFile(tmp_path / "archive.zip") as whole:
        assert {name: whole.read(f"starter/{name}") for name in files} == files
    assert [task.digest for task in load_tasks(out)] == [
        task.digest for task in load_tasks("starter")
    ]


def test_an_archive_of_a_library_names_each_author_and_is_a_library(
    tmp_path, in_this_process
) -> None:
    out = tmp_path / "archive"
    packit("datasets", "archive", "blockout", "--shape-library", "--out", out, *DATE)
    assert ShapeLibrary.open(out).digest == ShapeLibrary.open("blockout").digest
    table = (out / "ATTRIBUTION.md").read_text()
    assert "| `tripod` |" in table and table.count("| CC0-1.0 |") == 8
    again = tmp_path / "again"
    packit("datasets", "archive", "blockout", "--shape-library", "--out", again, *DATE)
    assert contents(again) == contents(out)
    archives = [file.read_bytes() for file in (tmp_path / "archive.zip", tmp_path / "again.zip")]
    assert archives[0] == archives[1]
    with pytest.raises(ArgumentError, match="again is not an empty folder"):
        packit("datasets", "archive", "blockout", "--shape-library", "--out", again)


def test_ones_own_packs_need_a_licence_and_an_author(tmp_path) -> None:
    mine, library = tmp_path / "mine", ShapeLibrary.open("everyday")
    write_packs(mine / "packs.jsonl", read_packs(dataset_file("starter"))[:2])
    with pytest.raises(ArgumentError, match=r"the licence of .* is not known: name it \(--licence"):
        dataset_archive(mine, library, "2026-11-27")
    with pytest.raises(ArgumentError, match=r"the author of .* is not known: name it \(--author"):
        dataset_archive(mine, library, "2026-11-27", "MIT")
    described = croissant(dataset_archive(mine, library, "2026-11-27", "MIT", "Ada")[0])
    assert described["name"] == "mine" and described["creator"]["name"] == "Ada"
    assert described["license"] == ["https://spdx.org/licenses/MIT.html"]
    assert "Unknown" not in described["rai:personalSensitiveInformation"][0]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:::(mlcroissant|rdflib|etils|jsonpath_rw|ply|pandas)")
@pytest.mark.parametrize(
    ("name", "options"),
    [*((n, ()) for n in builtin_datasets()), *((n, ("--shapes",)) for n in builtin_names())],
)
def test_the_metadata_of_built_in_data_is_valid_and_loads_them(
    name, options, tmp_path, in_this_process
) -> None:
    pytest.importorskip("mlcroissant", reason="mlcroissant comes with the extra dev")
    mlcroissant = importlib.import_module("mlcroissant")
    packit("datasets", "archive", name, *options, "--out", tmp_path / "archive", *DATE)
    dataset = mlcroissant.Dataset(str(tmp_path / "archive" / "croissant.json"))
    issues = dataset.metadata.issues
    assert not issues.errors and not issues.warnings
    assert dataset.metadata.data_limitations and dataset.metadata.data_biases
    for table in dataset.metadata.record_sets:
        rows = [*dataset.records(table.name)]
        if options:
            assert {row["shapes/id"].decode() for row in rows} == {*ShapeLibrary.open(name)}
        else:
            split = None if table.name == "packs" else table.name
            packs = read_packs(dataset_file(name, split))
            found = [row[f"{table.name}/density"] for row in rows]
            assert found == pytest.approx([pack.density for pack in packs])
    pytest.importorskip("check_jsonschema")
    schema = ("--builtin-schema", "vendor.citation-file-format")
    command = [sys.executable, "-m", "check_jsonschema", *schema, "archive/CITATION.cff"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
