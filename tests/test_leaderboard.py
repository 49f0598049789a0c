"""The leaderboard: its page agrees with the kept results files, and only entries are accepted."""

import gzip
import json
import math
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec import structs

from benchmarks import leaderboard
from benchmarks.common import table_in_page
from benchmarks.leaderboard import BOARDS, LIMITS, PAGE, Board, Row, add, entries, read_boards
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.core.errors import ArgumentError
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.evaluation.evaluation import Score
from packit_sim.game.evaluation.results import ResultsError, Rollout, read_results, write_results
from packit_sim.rules import PACKIT, Rules
from tests.runs import packit, rollout

ROOT = Path(__file__).parents[1]

MEGABYTES = 5
"""What all kept results files may take."""

KEPT = [file for folder in read_boards() for file in entries(folder)]


@pytest.fixture
def boards(tmp_path) -> Path:
    """A folder with a board of the starter packs."""
    folder = tmp_path / "boards"
    (folder / "starter").mkdir(parents=True)
    (folder / "starter" / "board.json").write_text('{"title": "Starter", "dataset": "starter"}')
    return folder


def played(agent: str = "a/b/c", items: int = 2) -> list[Rollout]:
    """Results of all starter packs: the first so many items of each."""
    return [rollout(agent, task, items) for task in range(10)]


def changed(one: Rollout, **changes: object) -> Rollout:
    return Rollout(replace(one.pack, provenance=structs.replace(one.played, **changes)))


def submit(rollouts: Sequence[Rollout], boards: Path) -> Path:
    file = boards.parent / "results.jsonl"
    write_results(file, rollouts)
    return add(file, boards)


def table_of(boards: Path) -> list[str]:
    """The lines of the page of the board of the starter packs."""
    (text,) = leaderboard.pages(boards, boards / "page.md").values()
    return text.splitlines()


@pytest.mark.slow
def test_the_pages_agree_with_the_kept_files() -> None:
    assert table_in_page(PAGE) == leaderboard.markdown()
    pages = leaderboard.pages()
    assert {path: path.read_text() for path in (PAGE.parent / "boards").glob("*.md")} == pages


def test_each_board_has_an_entry_and_all_together_are_small() -> None:
    assert {file.parent for file in KEPT} == set(read_boards()) != set()
    assert sum(file.stat().st_size for file in BOARDS.rglob("*")) < MEGABYTES * 2**20


@pytest.mark.parametrize(("board", "table"), [("", "baselines"), ("-easy", "easy")])
def test_rows_of_the_paper_are_those_that_were_reproduced(board, table) -> None:
    """Another run of the same agents, on another machine, is in `docs/reproduced`."""
    content = json.loads((ROOT / "docs" / "reproduced" / f"{table}.json").read_text())
    reproduced = {row["agent"]: row["ours"] for row in content["rows"]}
    folder = BOARDS / f"everyday-v1{board}"
    found = {row.score.agent: row.score for row in leaderboard.rows(folder, Board.read(folder))}
    shared = found.keys() & reproduced.keys()
    assert "largest-first/aligned/blbf" in shared
    for agent in shared:
        known = {level: Estimate(**each) for level, each in reproduced[agent].items()}
        assert format_estimate(found[agent].reward, ".3f") == format_estimate(
            known["reward"], ".3f"
        )
        assert found[agent].success[0.9].mean == pytest.approx(known["S@0.9"].mean)


@pytest.mark.slow
@pytest.mark.parametrize("file", KEPT, ids=lambda file: f"{file.parent.name}/{file.name}")
def test_the_oracle_accepts_a_kept_file(file) -> None:
    assert leaderboard.verify([file]) == []


@pytest.mark.slow
def test_results_that_hold_are_kept_as_they_are_and_get_a_row(boards) -> None:
    kept = submit(played("a/b/c+d=5s"), boards)
    assert kept == boards / "starter" / "a-b-c-d-5s.jsonl.gz"
    assert gzip.decompress(kept.read_bytes()) == (boards.parent / "results.jsonl").read_bytes()
    with leaderboard.unpacked(kept) as path:
        assert read_results(path) == played("a/b/c+d=5s")
        assert "10 of 10 packs hold" in packit("verify", path)
    submit(played("x/y/z", 3), boards)
    submit([changed(each, weights="0123456789abcdef") for each in played("l/e/s", 1)], boards)
    cells = [line.strip("| ").split(" | ") for line in table_of(boards) if line.startswith("| 1 s")]
    assert [row[1] for row in cells] == ["`x/y/z`", "`a/b/c+d=5s`", "`l/e/s`"]
    score = Score.of("x/y/z", played("x/y/z", 3))
    success = [f"{score.success[x].mean:.1f}" for x in (0.7, 0.9, 1.0)]
    reward = format_estimate(score.reward, ".3f")
    link = "[file](../starter/x-y-z.jsonl.gz)"
    assert cells[0] == ["1 s", "`x/y/z`", "0.50", reward, *success, "", "`packit-sim`", link]
    assert cells[2][7] == "`0123456789abcdef`"


def test_a_board_of_an_arm_has_its_command_and_measures() -> None:
    board = Board.read(BOARDS / "robot")
    assert board.command("stable-champion") == (
        "packit execute everyday-v1 --split test --tasks 50 --arm gantry --level 1 "
        "--decomposition bisection --agent stable-champion --out results.jsonl"
    )
    row = leaderboard.rows(BOARDS / "robot", board)[0]
    loss, collapses, failed, deepest = row.measured
    assert 0 <= float(loss) < 0.05 and float(collapses) >= 0 and deepest.endswith(" mm")
    assert float(failed) == 0
    assert row.cells(PAGE)[4:8] == row.measured
    assert board.rules.robot is not None
    slippery = Rules(robot=replace(board.rules.robot, friction=0.1))
    with pytest.raises(ArgumentError, match="`packit execute` has no options for the rules"):
        structs.replace(board, rules=slippery).command("stable-champion")


def test_a_new_run_replaces_the_one_before(boards) -> None:
    assert submit(played(items=3), boards) == submit(played(items=1), boards)
    (row,) = leaderboard.rows(boards / "starter", Board.read(boards / "starter"))
    assert row.score.reward == Score.of("a/b/c", played(items=1)).reward


def test_where_to_get_an_agent_is_part_of_its_row(boards) -> None:
    submit(played(), boards)
    file = boards / "starter" / "board.json"
    packages = {"a/b/c": "abc-agents==1.2"}
    file.write_text(json.dumps({**json.loads(file.read_text()), "packages": packages}))
    assert any("| `abc-agents==1.2` |" in line for line in table_of(boards))


REFUSED: dict[str, tuple[Callable[[list[Rollout]], list[Rollout]], str]] = {
    "another seed": (lambda all: [changed(each, seed=1) for each in all], "seed 1, not 0"),
    "other rules": (
        lambda all: [changed(each, rules=Rules(easy=True)) for each in all],
        "no leaderboard has task .* with the rules PackIt-Easy; there are 'Starter'",
    ),
    "other rules for one task": (
        lambda all: [*all[:-1], changed(all[-1], rules=Rules(kinematic=True))],
        "rules PackIt, kinematic",
    ),
    "a missing task": (lambda all: all[:-1], "9 results: the board 'Starter' needs one of each"),
    "the easiest task for each": (
        lambda all: [all[0], *(changed(all[0], task=n) for n in range(1, 10))],
        "with task 1 ",
    ),
    "two agents": (lambda all: [*all, *played("x/y/z")], "2 agents, a/b/c, x/y/z: write"),
    "new weights halfway": (
        lambda all: [changed(each, weights="new" if each.task > 4 else "old") for each in all],
        "weights of a/b/c new, not old",
    ),
    "no duration": (lambda all: [*all[1:], changed(all[0], seconds=0.0)], "how long each task"),
    "a return that is too high": (
        lambda all: [changed(all[0], total=0.999), *all[1:]],
        r"pack 0: its return is recorded as 0\.999, .*problems: 1;",
    ),
    "an item inside another": (
        lambda all: [
            *all[:-1],
            Rollout(replace(all[-1].pack, items=(*all[-1].pack.items, all[-1].pack.items[0]))),
        ],
        "pack 9: ",
    ),
}


@pytest.mark.parametrize(("forge", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_not_an_entry_is_refused_and_not_kept(forge, message, boards) -> None:
    with pytest.raises(ResultsError, match=message):
        submit(forge(played()), boards)
    assert entries(boards / "starter") == []


def forge_kept(boards: Path, rollouts: Sequence[Rollout]) -> Path:
    """Keep results without a check, as a pull request could."""
    plain = boards / "starter" / "a-b-c.jsonl"
    write_results(plain, rollouts)
    kept = plain.with_name(f"{plain.name}.gz")
    kept.write_bytes(gzip.compress(plain.read_bytes(), mtime=0))
    plain.unlink()
    return kept


@pytest.mark.parametrize(
    "name",
    ["another seed", "a missing task", "a return that is too high", "an item inside another"],
)
def test_a_forged_entry_of_a_pull_request_is_refused(name, boards, monkeypatch, capsys) -> None:
    """The workflow runs the command on the files that a pull request changes."""
    forge, message = REFUSED[name]
    kept = forge_kept(boards, forge(played()))
    monkeypatch.setattr(sys, "argv", ["leaderboard", "--verify", str(kept)])
    with pytest.raises(SystemExit, match=message.partition(", .*problems")[0]):
        leaderboard.main(boards)
    assert "wrote" not in capsys.readouterr().out


def test_a_file_outside_the_boards_is_no_entry(boards, tmp_path) -> None:
    kept = forge_kept(boards, played())
    assert leaderboard.verify([kept], boards) == []
    other = tmp_path / "other.jsonl.gz"
    kept.rename(other)
    with pytest.raises(ResultsError, match="is not kept on a board"):
        leaderboard.verify([other], boards)


def test_sequences_of_a_board_are_those_of_its_command(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    rules = Rules(kinematic=True, buffer=5, rotations="yaw")
    board = Board(title="Online", dataset="blockout", sequences=2, rules=rules)
    program, *words = shlex.split(board.preparation)
    assert program == "packit"
    packit(*words)
    written = load_tasks("blockout")
    assert [task.digest for task in board.tasks] == [task.digest for task in written]
    assert board.command("a/b/c").startswith("packit evaluate blockout --kinematic --buffer 5 ")


@pytest.mark.parametrize(
    ("seconds", "limit"),
    [(0.01, 1.0), (1.0, 1.0), (1.09, 1.0), (1.11, 10.0), (10.5, 10.0), (65, 60.0), (67, math.inf)],
)
def test_the_limit_is_the_smallest_that_the_mean_keeps(seconds, limit) -> None:
    score = Score.of("a/b/c", played())
    row = Row(BOARDS / "some.jsonl.gz", score, seconds, None, "packit-sim")
    assert row.limit == limit and limit in (*LIMITS, math.inf)
    label = "over 60 s" if limit == math.inf else f"{limit:g} s"
    assert row.cells(PAGE)[0] == label


@pytest.mark.parametrize(
    "rules",
    [
        PACKIT,
        Rules(easy=True),
        pytest.param(Rules(kinematic=True, buffer=3, rotations="yaw"), marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_the_command_of_a_board_plays_by_its_rules(rules, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    board = Board(title="Starter", dataset="starter", rules=rules)
    program, *words = shlex.split(board.command("oldest-first/aligned/blbf"))
    assert program == "packit"
    packit(*words, "--tasks", 1, "--workers", 1)
    (one,) = read_results("results.jsonl")
    assert one.rules == rules and one.seed == leaderboard.SEED
    assert one.agent == "oldest-first/aligned/blbf"


def test_rules_without_options_have_no_command() -> None:
    board = Board(title="Cubes", dataset="starter", rules=Rules(cells=(52, 52, 52)))
    with pytest.raises(ArgumentError, match="no options for the rules PackIt, box of 52 x 52 x 52"):
        board.command("a/b/c")


def test_a_wrong_board_is_refused_with_its_name(boards) -> None:
    (boards / "starter" / "board.json").write_text('{"title": "Starter", "rule": {}}')
    with pytest.raises(ArgumentError, match=r"starter/board\.json is not a leaderboard.*rule"):
        read_boards(boards)
