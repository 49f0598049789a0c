"""The page of results quotes the last full `packit reproduce all`, in every one of its tables."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from packit_sim.core.confidence import Estimate, format_estimate

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "benchmarks" / "results.md").read_text(encoding="utf-8")

Row = dict[str, Any]


def reproduced(table: str) -> dict[str, Row]:
    """The rows of a reproduced table, by agent."""
    content = json.loads((ROOT / "docs" / "reproduced" / f"{table}.json").read_text())
    assert "150 tasks" in content["what"]
    return {row["agent"]: row for row in content["rows"]}


def cells(heading: str, columns: int) -> list[list[str]]:
    """The rows of the tables with so many columns in the section of a heading."""
    (_, section) = re.split(rf"^##+ {re.escape(heading)}$", PAGE, flags=re.MULTILINE)
    lines = re.split(r"^##", section, maxsplit=1, flags=re.MULTILINE)[0].splitlines()
    rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in lines if line[:1] == "|"]
    return [row for row in rows if len(row) == columns and row[0] != "agent" and "---" not in row]


def reward(row: Row) -> str:
    return format_estimate(Estimate(**row["ours"]["reward"]), ".3f")


def success(row: Row) -> list[str]:
    return [f"{row['ours'][level]['mean']:.1f}" for level in ("S@0.7", "S@0.9")]


def seconds(row: Row) -> str:
    return "< 0.01" if row["seconds"] < 0.01 else f"{row['seconds']:.2f}"


def all_agents() -> tuple[list[list[str]], list[list[str]]]:
    """The rows of the table of all agents, and of the one for PackIt-Easy."""
    rows = cells("All agents", 5)
    easy = len(rows) - len(reproduced("easy"))
    return rows[:easy], rows[easy:]


def test_the_table_has_every_agent_of_the_last_run() -> None:
    played: dict[str, Row] = {}
    for table in ("table1", "beam", "backtrack", "baselines"):
        played = {**reproduced(table), **played}
    quoted = {name.strip("`"): rest for name, *rest in all_agents()[0]}
    assert set(quoted) == set(played) | {"champion", "packnn-placement/aligned/blbf"}
    for agent, row in played.items():
        assert quoted[agent] == [reward(row), *success(row), seconds(row)], agent


def test_the_table_quotes_the_network_that_is_not_in_the_last_run() -> None:
    measured = json.loads((ROOT / "benchmarks" / "results" / "learned.json").read_text())["rows"]
    (row,) = (row for row in measured if row["name"] == "packnn-placement, 3")
    quoted = {name.strip("`"): rest for name, *rest in all_agents()[0]}
    ours, at_07, *_ = quoted["packnn-placement/aligned/blbf"]
    assert ours == format_estimate(Estimate(**row["reward"]), ".3f")
    assert at_07 == f"{row['success']['mean']:.1f}"


def test_the_table_quotes_the_champion_of_the_leaderboard() -> None:
    page = ROOT / "docs" / "benchmarks" / "boards" / "everyday-v1.md"
    board = page.read_text(encoding="utf-8")
    first = next(line for line in board.splitlines() if "| `champion` |" in line)
    _, _, ours, at_07, at_09, *_ = (cell.strip() for cell in first[1:-1].split("|")[1:])
    quoted = {name.strip("`"): rest for name, *rest in all_agents()[0]}
    assert quoted["champion"][:3] == [ours, at_07, at_09]


def test_the_table_of_packit_easy_quotes_the_last_run() -> None:
    quoted = {name.strip("`"): rest for name, *rest in all_agents()[1]}
    expected = {
        agent: [reward(row), *success(row), seconds(row)]
        for agent, row in reproduced("easy").items()
    }
    assert quoted == expected


@pytest.mark.parametrize("rows", all_agents(), ids=["PackIt", "PackIt-Easy"])
def test_a_table_of_all_agents_begins_with_the_best(rows) -> None:
    rewards = [float(row[1].split()[0]) for row in rows]
    assert len(rewards) > 2 and rewards == sorted(rewards, reverse=True)


@pytest.mark.parametrize(
    ("heading", "table"),
    [
        ("Agents", "table1"),
        ("Beam search", "beam"),
        ("Backtracking", "backtrack"),
        ("PackIt-Easy", "easy"),
    ],
)
def test_a_table_of_the_paper_quotes_the_last_run_and_the_paper(heading, table) -> None:
    expected = []
    for row in reproduced(table).values():
        line = [row["label"], reward(row), f"{row['paper']['reward']:g}"]
        for level in ("S@0.7", "S@0.9"):
            ours = format_estimate(Estimate(**row["ours"][level]), ".1f")
            line += [ours, f"{row['paper'][level]:g}"]
        expected.append(line)
    assert cells(heading, 7) == expected


def test_the_table_of_evolution_quotes_the_last_run() -> None:
    content = json.loads((ROOT / "docs" / "reproduced" / "evolution.json").read_text())
    points = {str(point["generation"]): point for point in content["points"]}
    rows = [row for row in cells("Evolution", 3) if row[0] != "generation"]
    assert len(rows) == 3
    for generation, *rest in rows:
        assert rest == [
            format_estimate(Estimate(**points[generation][name]), ".3f")
            for name in ("reward", "density")
        ]


def test_the_table_beyond_the_paper_quotes_the_last_run() -> None:
    rows = cells("Beyond the paper", 3)
    assert len(rows) >= 8
    for label, ours, difference in rows:
        row = reproduced("baselines")[label.split("`")[1]]
        assert ours == reward(row), label
        if row["comparison"]:
            found = Estimate(**row["comparison"]["difference"])
            assert difference == format_estimate(found, "+.3f"), label
