"""The docs quote results of the last full `packit reproduce all`, and their code runs."""

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import packit_sim
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.datasets.pack_files import write_packs
from packit_sim.paper.reproduction import HEURISTIC, TABLES
from packit_sim.physics.convex import decomposition, disk_cache
from tests.runs import rollout

ROOT = Path(__file__).parents[1]
REPRODUCED = ROOT / "docs" / "reproduced"

IN_THE_README = {
    **{row.label: ("table1", row.agent) for row in TABLES["table1"].rows},
    "the Heuristic with 4 beams": ("beam", f"{HEURISTIC}+beam=4"),
    "the same with 8 backtracks": ("backtrack", f"{HEURISTIC}+backtrack=8"),
    "the same in PackIt-Easy": ("easy", HEURISTIC),
}
"""The tables and agents in the README, by their names there."""


@cache
def rows(table: str) -> dict[str, dict]:
    content = json.loads((REPRODUCED / f"{table}.json").read_text())
    assert "150 tasks" in content["what"]
    return {row["agent"]: row for row in content["rows"]}


def cells(document: Path) -> list[list[str]]:
    """The rows of all tables of a document."""
    lines = document.read_text(encoding="utf-8").splitlines()
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines if line[:1] == "|"]


def reward(row: dict) -> str:
    return format_estimate(Estimate(**row["ours"]["reward"]), ".3f")


def test_the_readme_quotes_the_last_run() -> None:
    quoted = 0
    for label, ours, *rest in cells(ROOT / "README.md"):
        agent = re.fullmatch(r"`([^`]+/[^`]+/[^`]+)`", label)
        if label in IN_THE_README:
            table, name = IN_THE_README[label]
            row = rows(table)[name]
            assert rest == [f"{row['paper']['reward']:g}"]
        elif agent:
            row = rows("baselines")[agent[1]]
        else:
            continue
        assert ours == reward(row), label
        quoted += 1
    assert quoted >= 8


@pytest.mark.parametrize("name", TABLES)
def test_all_agents_that_can_be_played_were(name) -> None:
    assert list(rows(name)) == [row.agent for row in TABLES[name].playable]
    assert (REPRODUCED / f"{name}.png").exists() and (REPRODUCED / f"{name}.md").exists()


def examples(page: str) -> list[str]:
    """The Python code on a page of the docs."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)


def test_the_code_for_agents_runs(capsys) -> None:
    (example,) = examples("guides/agents.md")
    exec(compile(example, "agents.md", "exec"), {})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [int(rollouts) for rollouts, _ in lines] == list(range(1, len(lines) + 1))
    best = [float(reward) for _, reward in lines]
    assert 1 < len(best) <= 20 and best == sorted(best) and 0 < best[0] <= best[-1] <= 1 + 1e-9


def test_the_code_for_physics_runs(tmp_path, monkeypatch) -> None:
    """With a few items of a pack, by halving, as where CoACD fails: all would take minutes."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path))
    monkeypatch.setattr(decomposition, "_by_coacd", lambda shape, settings: ([], "not asked"))
    write_packs(tmp_path / "few.jsonl", [rollout("a/b/c", 0, 3).pack])
    monkeypatch.setattr(packit_sim, "dataset_file", lambda name: tmp_path / "few.jsonl")
    names: dict[str, Any] = {}
    exec(compile(examples("guides/physics.md")[0], "physics.md", "exec"), names)
    assert len(names["settled"].items) == len(names["box"].placed) == 3
    assert (tmp_path / "settled.png").stat().st_size > 1000
