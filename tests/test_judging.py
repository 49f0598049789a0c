"""Quality scores of rollouts: solved by hand, computed once, stored, shown."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import pytest

from packit_sim.box import Box
from packit_sim.core.errors import BusyError, PackFormatError
from packit_sim.core.extras import MissingPackageError
from packit_sim.core.files import claimed
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_files import write_packs
from packit_sim.game.evaluation import judging, results_store
from packit_sim.game.evaluation.judging import SCORES, is_judged, judge
from packit_sim.game.evaluation.results import ResultsError, Rollout, read_results, write_results
from packit_sim.game.reports import tables
from packit_sim.game.reports.runs import Runs
from packit_sim.physics.convex import decomposition, disk_cache
from packit_sim.physics.convex.settings import DecompositionSettings
from packit_sim.physics.quality import QualityScores
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.placement import BoxState
from tests.runs import everyday, packit, rollout
from tests.zoo import cube_of

HALVES = PhysicsSettings(decomposition=DecompositionSettings(method="bisection"))
GOOD, BAD = "largest-first/aligned/blbf", "random/random/random"


@pytest.fixture(autouse=True, scope="module")
def _store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path_factory.mktemp("kept")))
        yield


@pytest.fixture(scope="module")
def played() -> list[Rollout]:
    return [rollout(GOOD, 0, 3), rollout(GOOD, 1, 2), rollout(BAD, 0, 1), rollout(BAD, 1, 0)]


@pytest.fixture(scope="module")
def judged(played) -> list[Rollout]:
    return judge(played, everyday(), "bisection")


def scores_of(one: Rollout) -> dict[str, float]:
    return {name: one.played.scores[name] for name in SCORES}


def test_cubes_by_hand() -> None:
    stands, floats = Box((40, 40, 40)), Box((40, 40, 40))
    stands.place(cube_of(12), (2, 2, 0))
    floats.place(cube_of(12), (2, 2, 3))
    assert QualityScores.of(stands, HALVES) == QualityScores(stable=1.0, insertable=1.0, floating=0)
    assert QualityScores.of(floats, HALVES) == QualityScores(stable=0.0, insertable=1.0, floating=1)
    assert QualityScores.of(Box(), HALVES) == QualityScores(stable=1.0, insertable=1.0, floating=0)


def test_each_rollout_has_the_scores_of_its_box(played, judged) -> None:
    assert [(one.agent, one.task, one.total) for one in judged] == [
        (one.agent, one.task, one.total) for one in played
    ]
    for one in judged:
        assert is_judged(one, "bisection") and not is_judged(one, "coacd")
        found = QualityScores.of(BoxState(one.pack.cells, one.pack.placed(everyday())), HALVES)
        assert scores_of(one) == vars(found)
    assert not any(is_judged(one, "bisection") for one in played)
    assert scores_of(judged[-1]) == {"stable": 1.0, "insertable": 1.0, "floating": 0}


@pytest.mark.slow
def test_workers_find_the_same(played, judged, tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    write_results(file, played)
    with Workers(2) as workers:
        assert judge(played, everyday(), "bisection", workers=workers, file=file) == judged
    assert read_results(file) == judged


def test_what_is_judged_is_not_judged_again(played, judged, tmp_path, monkeypatch) -> None:
    file = tmp_path / "results.jsonl"
    write_results(file, played)
    assert judge(played[2:], everyday(), "bisection", file=file) == judged[2:]
    half = read_results(file)
    assert half == [*played[:2], *judged[2:]]
    new: list[Rollout] = []
    assert judge(half, everyday(), "bisection", new.append, file=file) == judged
    assert sorted((one.agent, one.task) for one in new) == [(GOOD, 0), (GOOD, 1)]
    before = file.read_bytes()
    other = tmp_path / "at-once.jsonl"
    write_results(other, played)
    judge(read_results(other), everyday(), "bisection", file=other)
    assert other.read_bytes() == before
    monkeypatch.setattr(judging, "judge_one", None)
    monkeypatch.setattr(results_store, "write_results", None)
    assert judge(judged, everyday(), "bisection", file=file) == judged
    assert file.read_bytes() == before and list(tmp_path.glob(".*")) == []


def test_a_stop_keeps_what_was_judged(played, judged, tmp_path, monkeypatch) -> None:
    file = tmp_path / "results.jsonl"
    write_results(file, played)
    monkeypatch.setattr(results_store, "CHECKPOINT_SECONDS", -1.0)
    begun: list[Rollout] = []

    def stop(one: Rollout) -> None:
        begun.append(one)
        if len(begun) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        judge(played, everyday(), "bisection", stop, file=file)
    kept = read_results(file)
    assert kept == [*judged[:2], *played[2:]]
    assert judge(kept, everyday(), "bisection", file=file) == judged == read_results(file)


def test_other_pieces_are_another_score(judged, monkeypatch) -> None:
    scores = QualityScores(0.5, 0.25, 7)
    monkeypatch.setattr(judging, "judge_one", lambda n, box, pieces: (n, scores))
    monkeypatch.setattr(judging, "require", lambda settings: None)
    again = judge(judged[:1], everyday(), "coacd")
    assert scores_of(again[0]) == {"stable": 0.5, "insertable": 0.25, "floating": 7}
    assert is_judged(again[0], "coacd") and not is_judged(again[0], "bisection")


def test_what_can_not_be_judged(played, tmp_path) -> None:
    file = tmp_path / "results.jsonl"
    write_results(file, played[:2])
    before = file.read_bytes()
    with pytest.raises(ResultsError, match=f"does not contain this result of {BAD} on task"):
        judge(played, everyday(), "bisection", file=file)
    with pytest.raises(ResultsError, match="does not contain"):
        judge([rollout(GOOD, 0, 2)], everyday(), "bisection", file=file)
    with claimed(file.with_name(".results.jsonl.lock"), file), pytest.raises(BusyError):
        judge(played[:2], everyday(), "bisection", file=file)
    assert file.read_bytes() == before
    pack = played[0].pack
    foreign = replace(pack, library=replace(pack.library, digest="0" * 64))
    with pytest.raises(PackFormatError, match="the pack is of library"):
        judge([replace(played[0], pack=foreign)], everyday(), "bisection")


def test_evaluate_prints_scores_and_stores_them(played, tmp_path, monkeypatch) -> None:
    file, packs = tmp_path / "results.jsonl", tmp_path / "few.jsonl"
    write_packs(packs, [one.pack for one in played[:2]])
    common = (packs, "--workers", "1", "--agent", GOOD, "--out", file)
    packit("evaluate", *common)
    (plain,) = {is_judged(one, "bisection") for one in read_results(file)}
    assert not plain
    shown = packit("evaluate", *common, "--scores", "--decomposition", "bisection")
    heading = re.compile(r"density +reward +stable +insertable +floating")
    assert heading.search(shown) and "boxes of 2 tasks" in shown
    mean = sum(one.played.scores["stable"] for one in read_results(file)) / 2
    assert f"{mean:.3f}" in shown.partition("insertable")[2]
    before = file.read_bytes()
    monkeypatch.setattr(judging, "judge_one", None)
    again = packit("evaluate", *common, "--scores", "--decomposition", "bisection")
    assert heading.search(again) and file.read_bytes() == before
    assert not heading.search(packit("evaluate", *common)) and file.read_bytes() == before


def test_without_coacd_nothing_is_played(tmp_path, monkeypatch) -> None:
    def missing(name: str) -> str:
        raise decomposition.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(decomposition.metadata, "version", missing)
    with pytest.raises(MissingPackageError, match=r"pip install 'packit-sim\[physics\]'"):
        packit("evaluate", "absent", "--scores", "--out", tmp_path / "sub" / "results.jsonl")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(MissingPackageError, match="method='bisection'"):
        judge([], everyday())


def test_a_report_has_a_column_for_each(played, judged, tmp_path) -> None:
    file = tmp_path / "mixed.jsonl"
    write_results(file, [*judged[:2], *played[2:]])
    table = tables.more_scores(Runs.read([file]).played)
    assert table is not None
    shown = {column.name: (n, column.meaning) for n, column in enumerate(table.columns)}
    for name, meaning in SCORES.items():
        n, told_as = shown[name]
        assert told_as == meaning
        mean = sum(one.played.scores[name] for one in judged[:2]) / 2
        assert [row[n].text for row in table.rows] == [f"{mean:.3f}", ""]
    assert "pieces" not in shown
