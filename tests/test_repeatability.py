"""The campaign of repeatability sees when a command writes something else."""

import json
import sys
from pathlib import Path

import pytest
from trimesh import creation

from campaigns import common, repeatability
from campaigns.repeatability import Way

FAKE = """
import json, sys
from pathlib import Path
out = Path(sys.argv[sys.argv.index("--out") + 1])
found = {"seconds": SECONDS, "improvements": [[SECONDS, 0.5]], "value": VALUE}
text = json.dumps(found)
(out if out.suffix else out.with_suffix(".jsonl")).write_text(text)
"""


def fake(folder: Path, value: str) -> str:
    """The command of a Python whose PackIt-Sim writes the value of an expression, and a time."""
    module = folder / "packit_sim.py"
    module.write_text(FAKE.replace("VALUE", value).replace("SECONDS", "__import__('time').time()"))
    return f"env -C {folder} {sys.executable}"


@pytest.mark.parametrize(
    ("value", "same"),
    [("1", True), ("hash('a')", False), ("sys.argv[sys.argv.index('--workers') + 1]", False)],
)
def test_what_depends_on_hashes_or_on_workers_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: str, same: bool
) -> None:
    (tmp_path / "work" / "meshes").mkdir(parents=True)
    monkeypatch.setattr("sys.argv", ["repeatability", "--out", str(tmp_path)])
    monkeypatch.setattr(repeatability, "write_into_page", lambda *page: None)
    arguments = ["--python", fake(tmp_path, value), "--work", str(tmp_path / "work")]
    sys.argv += [*arguments, "--commands", "evaluate"]
    for _ in range(2):  # the second time there is nothing to do
        repeatability.main()
    records = common.read_results("repeatability", tmp_path)["runs"]
    assert len(records) == 4
    assert ("differs" in repeatability.table(records)) != same


@pytest.mark.slow
def test_a_command_that_fails_is_no_result(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    found = repeatability.run("import", Way(sys.executable), 0, tmp_path / "meshes")
    assert found.startswith("failed: ")


@pytest.mark.slow
def test_an_import_gives_a_digest(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    creation.box((1, 2, 3)).export(tmp_path / "meshes" / "block.stl")
    found = repeatability.run("import", Way(sys.executable), 0, tmp_path / "meshes")
    assert len(found) == 16


def test_the_page_has_the_results() -> None:
    records = json.loads((common.RESULTS / "repeatability.json").read_text())["runs"]
    assert common.table_in_page("repeatability") == repeatability.table(records)
