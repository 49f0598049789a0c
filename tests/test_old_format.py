"""Format 1 of packs and results, as version 0.1.0 wrote it: still read, rewritten as format 2."""

import json
import runpy
import sys
from pathlib import Path

import pytest

from packit_sim.core.errors import PackFormatError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.manifests import manifest_path
from packit_sim.game.datasets.pack_files import read_packs, write_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import (
    UNKNOWN_PROVENANCE,
    Evolved,
    FromOriginal,
    Other,
    Played,
    Sampled,
)
from packit_sim.libraries.library import ShapeLibrary

RECORDS = Path(__file__).parent / "references" / "format-1"

FILES = sorted(RECORDS.glob("*/*.jsonl"))

KINDS = {"other": Other, "original": FromOriginal, "sampled": Sampled}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_file_is_read_and_rewritten(file: Path, tmp_path: Path) -> None:
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    packs = read_packs(file)
    expected = Played if file.parent.name == "results" else KINDS.get(file.stem, Evolved)
    for line, pack in zip(lines, packs, strict=True):
        assert line["format"] == 1 and type(pack.provenance) is expected
        assert line["density"] == pack.density and line["cells"] == list(pack.cells)
        items = [
            (i["shape"], i["scale"], i["rotation"], tuple(i["location"])) for i in line["items"]
        ]
        assert items == [(i.shape, i.scale, i.rotation, i.location) for i in pack.items]
        outside = [(i["shape"], i["scale"]) for i in line.get("outside", ())]
        assert outside == [(i.shape, i.scale) for i in pack.outside]
    write_packs(tmp_path / "new.jsonl", packs)
    assert read_packs(tmp_path / "new.jsonl") == packs
    assert json.loads(manifest_path(tmp_path / "new.jsonl").read_text())["format"] == 2


def test_all_that_was_recorded_of_an_evolution_is_kept() -> None:
    for name in ("history", "starter", "everyday-v1-train"):
        file = RECORDS / "packs" / f"{name}.jsonl"
        made = [json.loads(line)["made"] for line in file.read_text().splitlines()]
        for before, pack in zip(made, read_packs(file), strict=True):
            evolved = pack.provenance
            assert isinstance(evolved, Evolved)
            after = {} if evolved.after is None else {"after": evolved.after}
            assert before == {
                "by": "evolution",
                "seed": evolved.seed,
                "generation": evolved.generation,
                "size": evolved.size,
                "settings": evolved.settings.to_json(),
                **after,
            }


def test_all_that_was_recorded_of_a_rollout_is_kept() -> None:
    for file in (RECORDS / "results").glob("*.jsonl"):
        made = [json.loads(line)["made"] for line in file.read_text().splitlines()]
        for before, pack in zip(made, read_packs(file), strict=True):
            played = pack.provenance
            assert isinstance(played, Played)
            known = {"weights": played.weights, "pieces": played.pieces}
            assert before == {
                "results": 1,
                "by": played.agent.replace("packnn-placement", "packnn-prospects"),  # renamed since
                "task": played.task,
                "task_digest": played.task_digest,
                "seed": played.seed,
                "easy": played.rules.easy,
                "kinematic": played.rules.kinematic,
                "return": played.total,
                "end": played.end,
                "seconds": played.seconds,
                **{name: value for name, value in known.items() if value is not None},
                **played.scores,
            }
            assert (file.stem == "judged") == bool(played.scores)


def test_free_form_records_become_notes() -> None:
    unknown, noted = read_packs(RECORDS / "packs" / "other.jsonl")
    assert unknown.provenance == UNKNOWN_PROVENANCE
    assert isinstance(noted.provenance, Other)
    assert (noted.provenance.author, noted.provenance.split) == ("somebody", "train")
    assert json.loads(noted.provenance.notes) == {"tool": {"name": "mine", "version": 3}}


def test_a_pack_by_a_search_that_was_removed_is_read() -> None:
    line = json.loads((RECORDS / "packs" / "starter.jsonl").read_text().splitlines()[0])
    line["made"]["settings"]["search"] = "climbing"
    found = Pack.from_json(json.dumps(line)).provenance
    assert isinstance(found, Other) and found.author == "evolution"
    assert json.loads(found.notes)["settings"]["search"] == "climbing"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"made": []}, r"field 'made' is \[\]: expected object"),
        ({"made": {"results": 2}}, "field 'made.results' is 2: expected 1"),
        ({"made": {"by": "evolution"}}, "field 'provenance.seed' is missing"),
        ({"items": [{}]}, r"field 'items\[0\].shape' is missing"),
    ],
)
def test_a_broken_line_is_refused(change: dict[str, object], message: str) -> None:
    line = json.loads((RECORDS / "packs" / "starter.jsonl").read_text().splitlines()[0])
    with pytest.raises(PackFormatError, match=message):
        Pack.from_json(json.dumps({**line, **change}))


@pytest.mark.slow
def test_a_dataset_in_the_old_format_is_valid() -> None:
    file = RECORDS / "packs" / "history.jsonl"
    report = verify_dataset(file, ShapeLibrary.open("everyday"))
    assert report.is_valid, report.problems


def test_the_script_rewrites_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = Path(__file__).parents[1] / "scripts" / "migrate_packs.py"
    before = {}
    for name in ("history", "other"):
        source = RECORDS / "packs" / f"{name}.jsonl"
        before[name] = read_packs(source)
        (tmp_path / f"{name}.jsonl").write_bytes(source.read_bytes())
    monkeypatch.setattr(sys, "argv", [script.name, str(tmp_path)])
    for _ in ("once", "again"):
        runpy.run_path(str(script), run_name="__main__")
        for name, packs in before.items():
            file = tmp_path / f"{name}.jsonl"
            assert read_packs(file) == packs and '{"format":2,' in file.read_text()
