"""Results: the same with any workers, kept in resumable files, and compared."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from packit_sim.core.confidence import Comparison, Estimate
from packit_sim.core.errors import BusyError, PackItError
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_checks import verify
from packit_sim.game.datasets.pack_files import load_tasks, read_packs
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation import evaluation
from packit_sim.game.evaluation.evaluation import Score, compare, evaluate
from packit_sim.game.evaluation.results import ResultsError, Rollout, read_results, write_results
from packit_sim.game.paper import reproduction
from packit_sim.game.paper.reproduction import TABLES, markdown, reproduced
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import Rules
from tests.runs import packit

NAMES = ("largest-first/aligned/blbf", "random/random/random", "random/aligned/blbf+backtrack=3")


@pytest.fixture(scope="module")
def library() -> ShapeLibrary:
    return ShapeLibrary.open("everyday")


@pytest.fixture(scope="module")
def tasks(library) -> tuple[Task, ...]:
    return load_tasks("starter", library)[:3]


@pytest.fixture(scope="module")
def agents() -> list[Agent]:
    return [Agent.from_name(name) for name in NAMES]


@pytest.fixture(scope="module")
def rollouts(agents, tasks) -> list[Rollout]:
    return evaluate(agents, tasks, seed=2)


@pytest.mark.slow
def test_rollouts_are_the_same_on_workers(agents, tasks, rollouts) -> None:
    with Workers(2) as workers:
        played = evaluate(agents, tasks, seed=2, workers=workers)
    assert played == rollouts
    assert list(map(without_times, played)) == list(map(without_times, rollouts))


def without_times(rollout: Rollout) -> dict[str, object]:
    content = json.loads(rollout.pack.to_json())
    for times in ("seconds", "improvements"):
        content["provenance"].pop(times, None)
    return content


def test_results_read_back_are_what_was_played(agents, tasks, rollouts, library, tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    assert evaluate(agents, tasks, seed=2, file=file) == rollouts
    assert read_results(file) == rollouts
    assert all(rollout.seconds > 0 for rollout in read_results(file))
    assert all(verify(pack, library) == [] for pack in read_packs(file)[:2])


def test_what_is_in_the_file_is_not_played_again(agents, tasks, rollouts, tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    write_results(file, rollouts[:4])
    played: list[Rollout] = []
    assert evaluate(agents, tasks, 2, played.append, file=file) == rollouts
    assert sorted((r.agent, r.task) for r in played) == sorted(
        (r.agent, r.task) for r in rollouts[4:]
    )
    before = file.read_bytes()
    assert evaluate(agents[1:2], tasks, seed=2, file=file) == rollouts[3:6]
    assert file.read_bytes() == before
    more = Agent.from_name("smallest-first/aligned/blbf")
    evaluate([more], tasks, seed=2, file=file)
    assert read_results(file)[:9] == rollouts and len(read_results(file)) == 12


@pytest.mark.slow
def test_an_evaluation_that_was_killed_resumes(agents, tasks, rollouts, tmp_path) -> None:
    """Killed after a checkpoint, and started again: the file of an undisturbed one."""
    file = tmp_path / "results.jsonl"
    script = (
        "from packit_sim import ShapeLibrary\n"
        "from packit_sim.game.evaluation import evaluation, results_store\n"
        "from packit_sim.game.datasets.pack_files import load_tasks\n"
        "from packit_sim.game.episodes.agents import Agent\n"
        "from pathlib import Path\n"
        "results_store.CHECKPOINT_SECONDS = 0\n"
        f"agents = [Agent.from_name(name) for name in {NAMES!r}]\n"
        "tasks = load_tasks('starter', ShapeLibrary.open('everyday'))[:3]\n"
        f"evaluation.evaluate(agents, tasks, 2, file=Path({str(file)!r}))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script], start_new_session=True)
    while not file.exists() and process.poll() is None:
        time.sleep(0.002)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    kept = read_results(file)
    assert 0 < len(kept) < len(rollouts)
    assert evaluate(agents, tasks, seed=2, file=file) == rollouts
    assert read_results(file) == rollouts


def test_results_of_something_else_are_refused_and_stay(agents, tasks, rollouts, tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    write_results(file, rollouts)
    before = file.read_bytes()
    cases = (
        (tasks, 3, Rules(), "seed 2, not 3"),
        (tasks, 2, Rules(easy=True), "rules PackIt, not PackIt-Easy: "),
        (tasks[::-1], 2, Rules(), "task 0"),
    )
    for others, seed, rules, message in cases:
        with pytest.raises(ResultsError, match=f"results.jsonl contains results with {message}"):
            evaluate(agents, others, seed, rules=rules, file=file)
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "game"}, "line 1: field 'provenance.kind' is 'game': choose from .*rollout"),
        ({"kind": None}, "field 'provenance.kind' is None"),
        ({"task": "0"}, "'provenance.task' is '0': expected int"),
        ({"rules": {"easy": 1}}, "'provenance.rules.easy' is 1: expected bool"),
        ({"return": None}, "'provenance.return' is None: expected float"),
        ({"return": True}, "'provenance.return' is True: expected float"),
        ({"end": "tired"}, "line 1: field 'provenance.end' is 'tired': choose from all placed"),
        ({"taks": 0}, "field 'provenance.taks' is unknown"),
    ],
)
def test_files_that_hold_no_results_are_named(rollouts, tmp_path, change, message) -> None:
    line = json.loads(rollouts[0].pack.to_json())
    line["provenance"].update(change)
    (tmp_path / "other.jsonl").write_text(json.dumps(line) + "\n")
    with pytest.raises(PackItError, match=f"other.jsonl, .*{message}"):
        read_results(tmp_path / "other.jsonl")


def test_packs_are_no_results() -> None:
    with pytest.raises(ResultsError, match="packit evaluate --out"):
        read_results(Path("assets/packs/starter/packs.jsonl"))


def test_a_comparison_by_hand() -> None:
    found = Comparison.of([0.5, 0.6, 0.7, 0.9], [0.5, 0.5, 0.8, 0.5], tolerance=1e-9)
    assert (found.wins, found.ties, found.losses, found.pairs) == (2, 1, 1, 4)
    assert found.difference.mean == pytest.approx(0.1)
    assert found.ratio.mean == pytest.approx(2.7 / 2.3)
    assert found.difference.low is not None and found.difference.low < 0 < found.difference.mean
    same = Comparison.of([0.5, 0.7], [0.5, 0.7], tolerance=1e-9)
    assert same.difference == Estimate(0, 0, 0) and same.ratio == Estimate(1, 1, 1)
    nothing = Comparison.of([0.5, 0.7], [0.0, 0.0], tolerance=1e-9)
    assert not np.isfinite(nothing.ratio.mean) and nothing.ratio.low is None
    sometimes = Comparison.of([0.5, 0.7, 0.0], [0.0, 0.0, 0.6], tolerance=1e-9)
    assert sometimes.ratio == Estimate(pytest.approx(2.0), None, None)


def test_agents_are_compared_on_the_tasks_that_both_have_played(rollouts) -> None:
    first, second = rollouts[:3], rollouts[3:6]
    whole = compare(first, second)
    assert whole.pairs == 3 and whole.wins == 3
    assert whole.difference.mean == pytest.approx(
        np.mean([a.total - b.total for a, b in zip(first, second, strict=True)])
    )
    assert compare(first[:2], second[::-1]).pairs == 2
    with pytest.raises(ValueError, match="no task that both"):
        compare(first[:1], second[1:])


def test_a_score_contains_density_and_time(rollouts) -> None:
    score = Score.of(NAMES[0], rollouts)
    assert score.tasks == 3
    assert score.density.mean == pytest.approx(np.mean([r.pack.density for r in rollouts[:3]]))
    assert score.seconds == np.median([r.seconds for r in rollouts[:3]])


def test_evaluate_and_compare_on_the_command_line(tmp_path) -> None:
    file, other = tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    common = ("--tasks", "2", "--workers", "1", "--agent")
    packit("evaluate", "starter", *common, NAMES[0], "--out", file)
    output = packit("evaluate", "starter", *common, NAMES[0], "--agent", NAMES[1], "--out", file)
    assert "tasks: 2, seed: 0" in output and f"2 {NAMES[1]}" in output and "0.000" not in output
    packit("evaluate", "starter", *common, NAMES[2], "--easy", "--out", other)
    assert read_results(other)[0].rules == Rules(easy=True)
    assert "   2     0       0" in packit("compare", file)
    assert f"3 {NAMES[2]}" in packit("compare", file, other)
    for wrong, message in (
        ((other,), "contains one agent only"),
        ((file, file, file), "3 files can't be compared"),
        (("assets/packs/starter/packs.jsonl",), "packit evaluate --out"),
        (("absent.jsonl",), "absent.jsonl"),
    ):
        with pytest.raises(PackItError, match=message):
            packit("compare", *wrong)


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_whole(name) -> None:
    table = TABLES[name]
    assert table.against in [row.agent for row in table.rows]
    assert len({row.agent for row in table.rows}) == len(table.rows)
    for row in table.playable:
        Agent.from_name(row.agent)
    if name == "baselines":
        assert not any(row.paper for row in table.rows)
        return
    assert all(set(row.paper) == set(table.metrics) for row in table.rows)
    assert all(0 <= row.paper["reward"] <= 1 for row in table.rows)


def test_two_evaluations_refuse_to_write_one_file(agents, tasks, rollouts, tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    refused = []

    def second(rollout: Rollout) -> None:
        with pytest.raises(BusyError, match=rf"results\.jsonl: process {os.getpid()} is at work"):
            evaluate(agents, tasks, seed=2, file=file)
        refused.append(rollout)

    assert evaluate(agents, tasks, seed=2, on_rollout=second, file=file) == rollouts
    assert refused and [path.name for path in tmp_path.glob(".*")] == []
    assert evaluate(agents, tasks, seed=2, file=file) == rollouts


def test_a_table_compares_ours_with_the_papers(agents, tasks, rollouts) -> None:
    names = [reproduction.HEURISTIC, "random/aligned/blbf"]
    played = evaluate([Agent.from_name(name) for name in names], tasks, seed=2)
    table = TABLES["table1"]
    found = reproduced(table, played)
    assert [each.row.agent for each in found] == ["random/aligned/blbf", reproduction.HEURISTIC]
    text = markdown(table, found)
    heuristic = Score.of(reproduction.HEURISTIC, played).reward
    assert f"| ours | {heuristic.mean:.3f} ({heuristic.low:.3f} to {heuristic.high:.3f}) |" in text
    assert "| | paper | 0.592 | 75.15 |" in text
    assert f"| {0.419 / 0.592:.3f} | 0 / 0 / 3 |" in text


def test_a_table_that_the_paper_does_not_have(tasks, tmp_path) -> None:
    names = ("largest-fitting-first/aligned/blbf", reproduction.HEURISTIC)
    played = evaluate([Agent.from_name(name) for name in names], tasks, seed=2)
    table = TABLES["baselines"]
    found = reproduced(table, played)
    text = markdown(table, found)
    assert all(f"| {name} | ours |" in text for name in names)
    assert "paper |" not in text and "ratio |" in text
    (line,) = [row for row in text.splitlines() if row.startswith(f"| {names[0]} | +")]
    assert line.endswith(") | 3 / 0 / 0 |")
    reproduction.draw(table, found, tmp_path / "table.png")
    assert (tmp_path / "table.png").stat().st_size > 1000


def test_reproduce_resumes(tmp_path, monkeypatch) -> None:
    common = ("--dataset", "starter", "--workers", "1", "--out", tmp_path)
    monkeypatch.setattr("packit_sim.cli.reproductions.QUICK_TASKS", 2)
    packit("reproduce", "table1", *common, "--quick")
    written = {path.name for path in tmp_path.iterdir()}
    assert {"table1.md", "table1.json", "table1.png", "packit.jsonl"} <= written
    monkeypatch.setattr(evaluation, "play", None)  # nothing is played again
    packit("reproduce", "table1", *common, "--quick")
    message = "no table or figure 'table2': did you mean table1? choose from table1, beam"
    with pytest.raises(PackItError, match=re.escape(message)):
        packit("reproduce", "table2", *common)


@pytest.mark.slow
def test_the_portfolio_at_a_glance(tmp_path, monkeypatch) -> None:
    common = ("--dataset", "starter", "--workers", "1", "--out", tmp_path, "--quick")
    monkeypatch.setattr("packit_sim.cli.reproductions.QUICK_TASKS", 2)
    monkeypatch.setattr("packit_sim.cli.reproductions.QUICK_SECONDS", 0.05)
    monkeypatch.setattr("packit_sim.game.paper.portfolio._POINTS", 3)
    packit("reproduce", "portfolio", *common)
    found = json.loads((tmp_path / "portfolio.json").read_text())
    *single, best, everything = found["rows"]
    pairs = [row for row in single if "+" in row["label"]]
    assert len(pairs) >= 6 and all(list(row["rewards"]) == ["0.05"] for row in found["rows"])
    assert "first 3 pairs" in best["label"] and "all 6 pairs" in everything["label"]
    assert (tmp_path / "portfolio.png").stat().st_size > 1000
    for row in found["rows"]:
        assert row["label"] in (tmp_path / "portfolio.md").read_text()
    monkeypatch.setattr(evaluation, "play", None)  # nothing is played again
    packit("reproduce", "portfolio", *common)
    assert json.loads((tmp_path / "portfolio.json").read_text()) == found


@pytest.mark.slow
def test_agents_may_be_names_and_workers_a_number(tasks, rollouts) -> None:
    assert evaluate(NAMES, tasks, seed=2, workers=2) == rollouts
    (one,) = evaluate("random/random/random", tasks[:1], seed=2)
    assert one == rollouts[3]
    mixed = [Agent.from_name(NAMES[0]), NAMES[1]]
    assert evaluate(mixed, tasks, seed=2) == rollouts[:6]


def test_the_library_of_tasks_is_found(tasks) -> None:
    assert [task.digest for task in load_tasks("starter")[:3]] == [task.digest for task in tasks]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"agents": ["best/aligned/blbf"]}, "no shape policy 'best'"),
        ({"agents": [7]}, 'agent 7 is not possible: an Agent, or a name such as "largest-first'),
        ({"workers": -1}, "-1 workers are not possible"),
        ({"numbers": [1, 2]}, r"numbers \[1, 2\] is not possible: one for each of the 3 tasks"),
    ],
)
def test_arguments_of_evaluate_that_are_not_possible(wrong, message, tasks) -> None:
    arguments = {"agents": NAMES, "tasks": tasks, "seed": 0, **wrong}
    with pytest.raises(PackItError, match=message):
        evaluate(**arguments)


def test_tasks_keep_the_numbers_of_their_dataset(tasks, rollouts) -> None:
    found = evaluate(NAMES[:1], tasks[1:], seed=2, numbers=[1, 2])
    assert found == rollouts[1:3]
