"""Reports without a browser: numbers in tables, models, and errors."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from base64 import b64decode
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from packit_sim.core.errors import PackItError
from packit_sim.game.evaluation.evaluation import Score, compare
from packit_sim.game.evaluation.learning_curves import CurveError, TrainingRecord
from packit_sim.game.evaluation.results import write_results
from packit_sim.game.reports import charts, tables
from packit_sim.game.reports.examples import SOLUTION, Example, extremes, gallery
from packit_sim.game.reports.page import page
from packit_sim.game.reports.runs import ReportError, Runs
from packit_sim.rules import Rules
from packit_sim.web import page_models
from packit_sim.web.page_models import Models
from packit_sim.web.surfaces import MAX_TRIANGLES
from tests.runs import everyday, packit, results, rollout, tasks, training

GOOD, BAD = "largest-first/aligned/blbf", "random/random/<b>&random"
ALL = [len(task.items) for task in tasks()[:4]]


@pytest.fixture
def runs(tmp_path: Path) -> Runs:
    """A good agent on four tasks, a bad one on three of them, and two trainings."""
    file = results(tmp_path / "played.jsonl", {GOOD: [ALL[0], 6, 9, 7], BAD: [3, 6, 1]})
    first = training(tmp_path / "first", [0.5, 0.7, 0.6])
    second = training(tmp_path / "second", [0.4, 0.9], rules={"easy": True})
    return Runs.read([file, first, second])


def texts(table: tables.Table, column: str) -> list[str]:
    """A column of a table."""
    (n,) = (n for n, each in enumerate(table.columns) if each.name == column)
    return [row[n].text for row in table.rows]


def test_scores_are_those_of_the_evaluation(runs) -> None:
    table = tables.scores(runs.played)
    good, bad = (Score.of(one.name, one.rollouts) for one in runs.played)
    assert texts(table, "agent") == [GOOD, BAD]
    assert texts(table, "tasks") == ["4", "3"]
    assert texts(table, "reward") == [f"{good.reward.mean:.3f}", f"{bad.reward.mean:.3f}"]
    assert texts(table, "S@1") == ["25.0", "0.0"]
    assert texts(table, "s") == ["0.5", "0.5"]
    reward = table.rows[0][2]
    assert reward.best and not table.rows[1][2].best
    assert reward.low_high == f"{good.reward.low:.2f} to {good.reward.high:.2f}"


def test_comparisons_are_those_of_packit_compare(runs) -> None:
    against = tables.comparisons(runs.played)
    good, bad = (one.rollouts for one in runs.played)
    found = compare(good, bad)
    (row,) = against[BAD].rows
    cells = [cell.text for cell in row]
    assert cells[:3] == [GOOD, "3", f"{found.difference.mean:+.3f}"]
    assert cells[4:] == ["2", "1", "0"]
    assert [cell.text for cell in against[GOOD].rows[0]][4:] == ["0", "1", "2"]


def test_agents_without_a_task_in_common_are_not_compared(tmp_path) -> None:
    write_results(tmp_path / "one.jsonl", [rollout("a/b/c", 0, 3)])
    write_results(tmp_path / "other.jsonl", [rollout("d/e/f", 1, 3)])
    played = Runs.read([tmp_path / "one.jsonl", tmp_path / "other.jsonl"]).played
    (row,) = tables.comparisons(played)["d/e/f"].rows
    assert [cell.text for cell in row] == ["a/b/c", "0", "", "", "", "", ""]


def test_further_scores_in_results_are_columns(tmp_path) -> None:
    file = tmp_path / "scored.jsonl"
    scored = [
        rollout("a/b/c", n, 3, scores={"stable": share}) for n, share in enumerate((0.25, 0.5))
    ]
    halves = [rollout("d/e/f", 0, 3, scores={"stable": 1.0}), rollout("d/e/f", 1, 3)]
    write_results(file, [*scored, *halves])
    played = Runs.read([file]).played
    table = tables.more_scores(played)
    assert table is not None
    assert texts(table, "stable") == ["0.375", ""]
    assert not any(row[-1].best for row in table.rows)  # more of it may be worse
    assert [column.name for column in table.columns] == ["agent", "stable"]
    assert "stable" not in {column.name for column in tables.scores(played).columns}


def test_results_without_further_scores_have_no_table_of_them(tmp_path) -> None:
    results(tmp_path / "plain.jsonl", {GOOD: [3]})
    assert tables.more_scores(Runs.read([tmp_path / "plain.jsonl"]).played) is None


def test_names_that_are_in_several_files_are_made_unique(tmp_path) -> None:
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
    files = [tmp_path / name for name in ("x/one.jsonl", "x/two.jsonl", "y/two.jsonl")]
    for file in files:
        results(file, {GOOD: [3]})
    results(files[0], {GOOD: [3], "a/b/c": [2]})
    names = [one.name for one in Runs.read([*files, files[0]]).played]
    assert names == [f"{GOOD} (one)", "a/b/c", f"{GOOD} ({files[1]})", f"{GOOD} ({files[2]})"]


def test_rules_are_listed_file_by_file(tmp_path) -> None:
    easy = [rollout("a/b/c", 0, 3, Rules(easy=True, kinematic=True))]
    write_results(tmp_path / "easy.jsonl", easy)
    results(tmp_path / "usual.jsonl", {"a/b/c": [3, 3], "d/e/f": [2, 2]})
    found = Runs.read([tmp_path / "easy.jsonl", tmp_path / "usual.jsonl"])
    table = tables.evaluations(found.played)
    assert texts(table, "rules") == ["PackIt-Easy, kinematic", "PackIt"]
    assert texts(table, "agents") == ["1", "2"] and texts(table, "tasks") == ["1", "2"]


def test_settings_of_trainings_that_differ_are_marked(runs) -> None:
    table = tables.trainings(runs.learned)
    assert texts(table, "best") == ["0.700", "0.900"]
    assert texts(table, "after") == ["1,000", "1,000"] and texts(table, "steps")[0] == "2,000"
    asked = {row[0].text: row for row in tables.settings(runs.learned).rows}
    assert [cell.text for cell in asked["rules.easy"]] == ["rules.easy", "false", "true"]
    assert [cell.differs for cell in asked["rules.easy"]] == [False, True, True]
    assert [cell.text for cell in asked["network.width"]] == ["network.width", "64", "64"]
    assert not any(cell.differs for cell in asked["network.width"])


@pytest.mark.parametrize(
    ("count", "each", "best", "worst"),
    [
        (6, 2, [5, 2], [0, 1]),
        (3, 2, [2, 1], [0]),
        (1, 3, [0], []),
        (6, 0, [], []),
    ],
)
def test_the_best_and_the_worst_are_none_twice(count, each, best, worst) -> None:
    items = [1, 2, 9, 4, 5, len(tasks()[5].items)]
    played = [rollout("a/b/c", n, items[n]) for n in range(count)]
    expected = sorted(played, key=lambda one: -one.total)
    found = extremes(played, each)
    assert [rank for rank, _ in found] == ["best"] * len(best) + ["worst"] * len(worst)
    ours = [one.task for _, one in found]
    assert ours[: len(best)] == [one.task for one in expected[: len(best)]]
    assert ours[len(best) :] == [one.task for one in expected[::-1][: len(worst)]]


def test_the_gallery_shows_every_agent_and_the_ground_truth(runs) -> None:
    known = {task.digest: task for task in tasks()}
    found = gallery(runs, everyday(), 1, tasks=known)
    best = found.tasks[0]
    assert found.agent == GOOD and (best.task, best.rank) == (0, "best")
    assert [view.by for view in best.examples] == [GOOD, BAD, SOLUTION]
    assert [best.examples[n].total for n in (0, -1)] == pytest.approx([1, 1])
    assert f"3 of {ALL[0]} items" in best.examples[1].summary
    shown = found.models.to_json()
    boxes = [shown["boxes"][view.model] for view in best.examples]
    assert [len(box["items"]) for box in boxes] == [ALL[0], 3, ALL[0]]
    shares = [sum(item["share"] for item in box["items"]) for box in boxes]
    assert shares == pytest.approx([view.total for view in best.examples], abs=1e-4)
    assert {item["shape"] for item in boxes[1]["items"]} <= {i["shape"] for i in boxes[0]["items"]}
    assert gallery(runs, everyday(), 1, agent=BAD).tasks[0].examples[0].by == BAD


@pytest.mark.parametrize(
    ("total", "shown"), [(1 - 1e-12, "1.000"), (0.9996, "0.999"), (0.5006, "0.501"), (0.0, "0.000")]
)
def test_a_return_is_shown_as_whole_only_where_it_is(total, shown) -> None:
    assert Example("a/b/c", 0, total, "").shown == shown


def test_an_agent_that_placed_nothing_has_an_empty_box(tmp_path) -> None:
    file = results(tmp_path / "none.jsonl", {"a/b/c": [0]})
    found = gallery(Runs.read([file]), everyday(), 1)
    assert found.models.to_json()["boxes"] == [{"size": [1, 1, 1], "outline": [], "items": []}]
    assert found.tasks[0].examples[0].total == 0


def test_a_model_is_the_box_within_what_is_seen() -> None:
    placed = tasks()[0].pack.placed(everyday())
    models = Models()
    models.add((100, 100, 100), placed, 1.0)
    content = models.to_json()
    assert content["boxes"][0]["size"] == [1, 1, 1]
    for one, item in zip(placed, content["boxes"][0]["items"], strict=True):
        shape = content["shapes"][item["shape"]]
        vertices = np.frombuffer(b64decode(shape["vertices"]), "<u2").reshape(-1, 3)
        faces = np.frombuffer(b64decode(shape["faces"]), "<u4").reshape(-1, 3)
        assert len(faces) <= MAX_TRIANGLES and faces.max() < len(vertices)
        canonical = (vertices / 65535 - 0.5) * shape["extents"]
        pose = np.array(item["pose"]).reshape(3, 4)
        shown = canonical @ pose[:, :3].T + pose[:, 3]
        real = one.item.shape.mesh.vertices @ one.matrix[:3, :3].T + one.matrix[:3, 3]
        assert np.abs(shown.min(axis=0) - real.min(axis=0)).max() < 0.02
        assert np.abs(shown.max(axis=0) - real.max(axis=0)).max() < 0.02
        assert re.fullmatch("#[0-9a-f]{6}", item["colors"]["share"])


def test_models_are_stored_as_documented_and_as_the_page_reads_them() -> None:
    """The documentation, what is written and `box_scene.js` agree on the types of arrays."""
    script = (Path(page_models.__file__).parent / "box_scene.js").read_text(encoding="utf-8")
    read = dict(re.findall(r"new (\w+)Array\(bytes\(shape\.(\w+)\)\)", script))
    types = {name: array.lower() for array, name in read.items()}
    assert types == {"vertices": "uint16", "faces": "uint32"}
    documented = " ".join(str(Models.to_json.__doc__).split())
    for name, written in {
        "vertices": page_models.VERTEX_TYPE,
        "faces": page_models.FACE_TYPE,
    }.items():
        assert written == np.dtype(types[name]).newbyteorder("<")
        described = re.search(rf"{name}, base64 of \(\w, 3\) (\w+)", documented)
        assert described and described[1] == types[name]


def test_the_curve_of_success_falls_at_each_return() -> None:
    x, share = charts.success([1.0, 0.5, 0.5, 0.75])
    assert x == [0, 0.5, 0.5, 0.75, 1.0, 1.0]
    assert share == [100, 100, 75, 50, 25, 0]


def test_plots_are_whole_svg_in_the_colours_of_the_page(runs) -> None:
    drawn = (
        charts.rewards(runs.played),
        charts.returns(runs.played),
        charts.learning(runs.learned),
    )
    for svg in drawn:
        root = ElementTree.fromstring(svg)
        assert root.tag.endswith("svg") and "var(--ink)" in svg and "var(--data-0)" in svg
        assert not set(re.findall("#[0-9a-f]{6}", svg)) - {"#ffffff"}
        assert " id=" not in re.sub("<(defs|clipPath|path)[^>]*>", "", svg)
    said = ["".join(ElementTree.fromstring(svg).itertext()) for svg in drawn]
    assert all(GOOD in text and BAD in text for text in said[:2])
    assert "first" in said[2] and "second" in said[2]


def test_a_page_is_the_same_again_and_asks_nothing_from_outside(runs) -> None:
    made = [page("R <&>", runs, gallery(runs, everyday(), 1), "packit report") for _ in range(2)]
    assert made[0] == made[1]
    text = made[0]
    shell = re.sub(r"<script.*?</script>|<svg.*?</svg>", "", text, flags=re.DOTALL)
    links = re.findall(r"(?:src|href|url)\s*[=(]\s*[\"']?([^\"')>\s]*)", shell)
    assert links and all(link.startswith(("#", "data:")) for link in links)
    assert "<title>R &lt;&amp;&gt;</title>" in text and "<b>&random" not in text
    assert len(text.encode()) < 5e6
    models = re.search(r'<script type="application/json" id="models"[^>]*>(.*?)</script>', text)
    assert models and json.loads(models[1])["boxes"]


def test_a_page_of_trainings_alone_has_no_gallery(tmp_path) -> None:
    folder = training(tmp_path / "run", [0.5])
    packit("report", folder, "-o", tmp_path / "out" / "r.html")
    text = (tmp_path / "out" / "r.html").read_text()
    assert "Learning curves" in text and "THREE" not in text and 'id="scores"' not in text


def test_the_command_writes_one_file(tmp_path) -> None:
    file = results(tmp_path / "played.jsonl", {GOOD: [3, 4], BAD: [2, 4]})
    out = tmp_path / "report.html"
    output = packit("report", file, "--dataset", "starter", "--gallery", 1, "-o", out)
    assert "MB" in output
    text = out.read_text()
    assert SOLUTION in text and text.count('<figure class="card">') == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "played.jsonl",
        "played.jsonl.manifest.json",
        "report.html",
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["absent.jsonl"], r"absent.jsonl: there is no such file.*packit evaluate --out"),
        (["broken.jsonl"], r"broken.jsonl, line 1: not JSON"),
        (["foreign.bin"], r"foreign.bin, line 1"),
        (["truth.jsonl"], r"truth.jsonl, pack 1: .*packit evaluate --out"),
        (["twice.jsonl"], r"twice.jsonl holds two results of 'a/b/c' on task 0"),
        (["empty"], r"empty is not the folder of a training: settings.json"),
        (["begun"], r"begun is not the folder of a training: curve.json.*first validation"),
        (["cut"], r"cut/curve.json is damaged"),
        (["odd"], r"odd/curve.json is damaged: field .*validation. is 3"),
        (["good.jsonl", "--agent", "x/y/z"], r"'x/y/z'.*choose from a/b/c"),
        (
            ["good.jsonl", "--dataset", "everyday-v1", "--split", "test"],
            r"no task of these results.*v1",
        ),
    ],
)
def test_bad_runs_are_refused_by_name_and_nothing_is_written(
    arguments, message, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("broken.jsonl").write_text('{"format":1,\n')
    Path("foreign.bin").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    Path("truth.jsonl").write_text(tasks()[0].pack.to_json() + "\n")
    write_results("twice.jsonl", [rollout("a/b/c", 0, 2)] * 2)
    write_results("good.jsonl", [rollout("a/b/c", 0, 2)])
    Path("empty").mkdir()
    training(Path("begun"), [0.5])
    (Path("begun") / "curve.json").unlink()
    training(Path("cut"), [0.5])
    (Path("cut") / "curve.json").write_text('[{"steps": 0')
    training(Path("odd"), [0.5])
    (Path("odd") / "curve.json").write_text('[{"steps": 0, "reward": null, "validation": 3}]')
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(PackItError, match=message):
        packit("report", *arguments, "-o", "r.html")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("out", ["played.jsonl", "folder.html", "report"])
def test_an_output_that_is_no_page_is_refused(out, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    results(Path("played.jsonl"), {GOOD: [3]})
    Path("folder.html").mkdir()
    before = Path("played.jsonl").read_bytes()
    with pytest.raises(ReportError, match=f"{out} is not an HTML file.*html"):
        packit("report", "played.jsonl", "-o", out)
    assert Path("played.jsonl").read_bytes() == before


@pytest.mark.slow
def test_a_folder_that_is_read_only_is_named_and_what_is_there_stays(tmp_path) -> None:
    run = training(tmp_path / "run", [0.5])
    out = tmp_path / "out"
    out.mkdir()
    packit("report", run, "-o", out / "r.html")
    before = (out / "r.html").read_bytes()
    out.chmod(0o555)
    as_any_user = ("setpriv", "--bounding-set", "-dac_override") if os.geteuid() == 0 else ()
    done = subprocess.run(
        [*as_any_user, sys.executable, "-m", "packit_sim", "report", run, "-o", out / "r.html"],
        capture_output=True,
        text=True,
        timeout=280,
    )
    out.chmod(0o755)
    assert done.returncode == 2, done.stderr
    assert f"{out / 'r.html'} can't be written: no permission for {out}" in done.stderr
    assert done.stderr.count("\n") == 1
    assert [p.name for p in out.iterdir()] == ["r.html"]
    assert (out / "r.html").read_bytes() == before


def test_a_missing_package_is_reported_before_any_work(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(PackItError, match=re.escape("pip install 'packit-sim[report]'")):
        packit("report", tmp_path / "absent.jsonl", "-o", tmp_path / "r.html")


def test_a_training_reads_back_as_it_was_written(tmp_path) -> None:
    run = TrainingRecord.read(training(tmp_path / "run", [0.2, 0.8, 0.8]))
    assert [point.steps for point in run.curve] == [0, 1000, 2000]
    assert run.best is run.curve[1]
    assert run.settings["network.width"] == 64
    (tmp_path / "run" / "settings.json").write_text("[]")
    with pytest.raises(CurveError, match=r"settings\.json is damaged: the settings must be"):
        TrainingRecord.read(tmp_path / "run")
