"""The command line as a whole: names, panels, lists, and messages that lead on."""

import json
import re
import shlex
import shutil
import sys
from collections import defaultdict
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
import typer.main
from trimesh import creation

from packit_sim.cli import terminal
from packit_sim.cli.app import COMMANDS, app
from packit_sim.cli.options import packing_file
from packit_sim.core.errors import PhysicsError
from packit_sim.core.version import DOCUMENTATION, __version__
from packit_sim.game.datasets.builtin import BUILTIN_DATASETS, builtin_datasets
from packit_sim.game.datasets.pack_files import write_packs
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.evaluation.results import read_results
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics import world
from packit_sim.physics.convex import decomposition, disk_cache
from tests.runs import Ran, rollout, tasks
from tests.runs import run_packit as packit

SMALL = ("--pool", "4", "--generations", "0", "--workers", "1")


def commands(group: Any = None, name: str = "") -> dict[str, Any]:
    """All commands by name, such as "shapes import"."""
    group = group or typer.main.get_command(app)
    found = {}
    for own, command in group.commands.items():
        if hasattr(command, "commands"):
            found |= commands(command, f"{name}{own} ")
        else:
            found[f"{name}{own}"] = command
    return found


def options(command: Any) -> dict[str, Any]:
    return {name: one for one in command.params for name in one.opts if name.startswith("-")}


DIFFERENT = {
    "--agent",  # one, or several
    "--backend",  # threads, or processes
    "--box",  # one, or several
    "--buffer",  # one, or several
    "--clearance",  # with a unit, or in that of an instance
    "--container",  # one, or several
    "--film",  # with the other files of a folder, or a file
    "--items",  # a number, or a range
    "--json",  # a file, or the output
    "--rotations",  # names of sets, of which the game has two
    "--size",  # one side, or two
    "--up",  # checked by the option, or with the part
}
"""Options whose values have another type in some command; what they mean is the same."""


def test_the_version_is_printed() -> None:
    assert packit("--version") == Ran(0, f"packit {__version__}\n", "")


def test_every_command_has_its_place_in_a_panel() -> None:
    shown = packit("--help").stdout
    names = [name for panel in COMMANDS.values() for name in panel]
    assert sorted(names) == sorted({name.partition(" ")[0] for name in commands()})
    places = [shown.index(f"\n{panel}:\n") for panel in COMMANDS]
    assert places == sorted(places)
    rows = re.findall(r"^  ([a-z][a-z-]*) ", shown, re.MULTILINE)
    assert rows == names


@pytest.mark.parametrize("name", commands())
def test_help_leads_to_the_documentation_and_not_to_a_checkout(name: str) -> None:
    help_ = packit(*name.split(), "--help").stdout
    assert not re.search(
        r"README|docs/|\.md\b(?!.*Markdown)|CONTRIBUTING", help_.replace("my-packs.md", "")
    )
    assert set(re.findall(r"https?://[\w.-]+", help_)) <= {DOCUMENTATION}


@pytest.mark.parametrize("name", commands())
def test_the_examples_in_help_are_command_lines(name: str) -> None:
    """Each is parsed with the options of its command; nothing runs."""
    epilog = commands()[name].epilog or ""
    for line in re.findall(r"\$ (packit .*)", epilog):
        words = shlex.split(line)[1:]
        assert words[: len(name.split())] == name.split()
        commands()[name].make_context(name, words[len(name.split()) :])


def test_commands_whose_arguments_are_not_obvious_have_an_example() -> None:
    without = {name for name, command in commands().items() if not command.epilog}
    assert without <= {"demo", "shapes stats"}


def test_one_word_has_one_meaning() -> None:
    kinds: dict[str, set[type]] = defaultdict(set)
    for name, command in commands().items():
        for option, one in options(command).items():
            kinds[option].add(one.type_descriptor.annotation)
            if option == "--out":
                assert "-o" in one.opts, f"{name} --out has no -o"
        assert "--side" not in options(command)
    assert {name for name, command in commands().items() if "--packs" in options(command)} == {
        "generate"
    }
    for count in ("--tasks", "--limit", "--packs"):
        assert kinds[count] == {int}
    assert {option for option, found in kinds.items() if len(found) > 1} <= DIFFERENT
    assert kinds["--dataset"] == kinds["--history-dataset"] == {str}
    sizes = {n: options(c)["--size"] for n, c in commands().items() if "--size" in options(c)}
    assert len(sizes) == 4 and all("pixels" in one.help for one in sizes.values())
    help_ = {
        options(command)["--workers"].help
        for command in commands().values()
        if "--workers" in options(command)
    }
    assert len(help_) == 1


def test_agents_are_listed_with_what_they_do() -> None:
    shown = packit("agents", "list").stdout
    for kind in ("shape_policies", "rotation_policies", "location_policies", "searches"):
        for point in entry_points(group=f"packit_sim.{kind}"):
            row = rf"^{point.name}(@VALUE|=VALUE)? +\w+"
            assert re.search(row, shown, re.MULTILINE), f"{point.name} has no description"
    assert "learned@VALUE" in shown and "beam=VALUE" in shown
    assert "packnn@VALUE" not in shown


def test_agents_are_listed_without_their_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.startswith("packit_agents.learning.")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "torch", None)
    listed = packit("agents", "list")
    assert listed.returncode == 0 and "packnn" in listed.stdout
    assert "packit_agents.learning.learned_policies" not in sys.modules


def test_datasets_are_listed() -> None:
    assert sorted(BUILTIN_DATASETS) == sorted(builtin_datasets())
    shown = packit("datasets", "list").stdout
    assert re.search(r"^starter +10 +everyday 2 +ten small packs", shown, re.MULTILINE)
    assert re.search(r"^ +test +150 +everyday 2", shown, re.MULTILINE)


@pytest.fixture
def meshes(tmp_path: Path) -> Path:
    folder = tmp_path / "meshes"
    folder.mkdir()
    creation.box((1, 2, 3)).export(folder / "brick.stl")
    creation.icosphere(subdivisions=1).export(folder / "ball.obj")
    return folder


@pytest.fixture
def own(meshes: Path, tmp_path: Path) -> Path:
    """A dataset of a folder of meshes."""
    done = packit("generate", "--library", meshes, *SMALL, "--out", tmp_path / "own")
    assert done.returncode == 0, done.stderr
    return tmp_path / "own"


def test_a_dataset_records_its_library(own: Path, meshes: Path, tmp_path: Path) -> None:
    manifest = json.loads((own / "packs.jsonl.manifest.json").read_text())
    (library,) = manifest["libraries"]
    assert library["source"] == f"folder:{meshes}"
    assert library["digest"] == ShapeLibrary.open(meshes).digest
    assert "source" not in (own / "packs.jsonl").read_text()

    assert packit("verify", own).returncode == 0
    results = tmp_path / "results.jsonl"
    agent = ("--agent", "largest-first/aligned/blbf", "--workers", "1")
    played = packit("evaluate", own, *agent, "--out", results)
    assert played.returncode == 0, played.stderr
    assert packit("verify", results).returncode == 0
    for number, command in enumerate((("export", own), ("export", results))):
        done = packit(*command, "--out", tmp_path / f"{number}.stl")
        assert done.returncode == 0, done.stderr
    again = packit("generate", "--library", meshes, *SMALL, "--out", own)
    assert (
        again.returncode == 0
        and json.loads((own / "packs.jsonl.manifest.json").read_text()) == manifest
    )


def test_a_library_that_moved_or_changed_is_named(own: Path, meshes: Path, tmp_path: Path) -> None:
    creation.box((1, 1, 1)).export(meshes / "brick.stl")
    changed = packit("verify", own)
    assert changed.returncode == 2
    assert f"at folder:{meshes} with the digest" in changed.stderr and "--library" in changed.stderr

    meshes.rename(tmp_path / "elsewhere")
    moved = packit("render", own, "--out", tmp_path / "x.png")
    assert moved.returncode == 2 and f"'meshes' at folder:{meshes}" in moved.stderr
    assert "if it has moved, choose it (--library)" in moved.stderr


def test_a_dataset_without_a_recorded_library_says_so(own: Path) -> None:
    manifest = own / "packs.jsonl.manifest.json"
    record = json.loads(manifest.read_text())
    del record["libraries"][0]["source"]
    manifest.write_text(json.dumps(record))
    failed = packit("verify", own)
    assert failed.returncode == 2
    assert "does not record where its library 'meshes' is: choose it (--library)" in failed.stderr


def test_packs_of_several_libraries_need_a_choice(tmp_path: Path, own: Path) -> None:
    lines = (own / "packs.jsonl").read_text()
    (tmp_path / "both.jsonl").write_text(lines)
    record = json.loads((own / "packs.jsonl.manifest.json").read_text())
    record["libraries"].append({**record["libraries"][0], "name": "other"})
    (tmp_path / "both.jsonl.manifest.json").write_text(json.dumps(record))
    failed = packit("verify", tmp_path / "both.jsonl")
    assert failed.returncode == 2 and "several libraries, 'meshes'" in failed.stderr


def test_the_demos_own_folder_is_a_dataset(tmp_path: Path) -> None:
    write_packs(tmp_path / "packs.jsonl", [rollout("a/b/c", 0, 9).pack])
    shutil.copy(tmp_path / "packs.jsonl", tmp_path / "results.jsonl")
    shutil.copy(tmp_path / "packs.jsonl.manifest.json", tmp_path / "results.jsonl.manifest.json")
    verified = packit("verify", tmp_path)
    assert verified.returncode == 0, verified.stdout
    assert "2 of 2 packs hold" in verified.stdout
    exported = packit("export", tmp_path, "--out", tmp_path / "box.stl")
    assert exported.returncode == 0, exported.stderr
    counted = packit("datasets", "stats", tmp_path)
    assert counted.returncode == 0 and "results" not in counted.stdout


def test_a_dataset_with_strange_files_is_still_refused(tmp_path: Path) -> None:
    pack = replace(tasks()[0].pack, items=tasks()[0].pack.items[:4])
    for name in ("train", "tests"):
        (tmp_path / f"{name}.jsonl").write_text(pack.to_json() + "\n")
    verified = packit("verify", tmp_path)
    assert verified.returncode == 1 and "can't have this name: train, test" in verified.stdout


def test_an_output_folder_that_is_a_file_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "taken").touch()
    failed = packit("generate", *SMALL, "--out", tmp_path / "taken")
    assert failed.returncode == 2
    assert (
        failed.stderr
        == f"error: --out {tmp_path / 'taken'} is a file: choose a folder for the dataset\n"
    )


@pytest.mark.parametrize("command", ["verify", "evaluate", "export"])
def test_a_mesh_file_is_not_a_dataset(command: str, meshes: Path, tmp_path: Path) -> None:
    more = ("--out", tmp_path / "x.stl") if command == "export" else ()
    failed = packit(command, meshes / "brick.stl", *more)
    assert failed.returncode == 2 and "brick.stl is a mesh file, not a dataset" in failed.stderr
    assert "codec" not in failed.stderr and failed.stderr.count("\n") == 1


def test_bytes_that_are_no_text_are_called_so(tmp_path: Path) -> None:
    (tmp_path / "packs.jsonl").write_bytes(b'{"format": "\xff"}\n')
    failed = packit("evaluate", tmp_path / "packs.jsonl")
    assert failed.returncode == 2 and "line 1: not JSON: it is not text in UTF-8" in failed.stderr


@pytest.mark.slow
def test_a_broken_mesh_of_a_folder_is_skipped_by_name(meshes: Path, tmp_path: Path) -> None:
    (meshes / "bad.stl").write_bytes(b"no mesh")
    out = tmp_path / "packs"
    done = packit("generate", "--library", meshes, *SMALL, "--out", out)
    assert done.returncode == 0, done.stderr
    assert f"skipped {meshes / 'bad.stl'}: " in done.stdout
    assert "2 of 3 shapes can be used" in done.stdout
    assert "drawn with replacement and rescaled" in done.stdout
    assert packit("verify", out).returncode == 0
    two = packit("generate", "--library", meshes, *SMALL[:-1], "2", "--packs", "3", "--out", out)
    assert two.returncode == 0, two.stderr
    played = packit("evaluate", out, "--agent", "random/random/random", "--workers", "1")
    assert played.returncode == 0, played.stderr


def test_a_task_with_a_broken_mesh_is_skipped_by_number(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the digest of a library does not cover the content of its files (ShapeNet)."""
    from packit_sim.core.errors import MeshError
    from packit_sim.game.datasets.packs import Pack

    whole = Pack.task
    tasks = iter(range(3))

    def task(pack: Pack, library: ShapeLibrary) -> Any:
        if next(tasks, 2) == 1:
            raise MeshError("bad.stl: the file is empty")
        return whole(pack, library)

    monkeypatch.setattr(Pack, "task", task)
    results = tmp_path / "results.jsonl"
    agent = ("--agent", "random/random/random", "--workers", "1")
    done = packit("evaluate", "starter", "--tasks", "3", *agent, "--out", results)
    assert done.returncode == 0, done.stderr
    assert "skipped task 1: bad.stl: the file is empty" in done.stdout
    assert [each.task for each in read_results(results)] == [0, 2]


@pytest.mark.slow
@pytest.mark.usefixtures("in_this_process")
def test_parts_of_a_file_are_joined_and_that_is_said(
    meshes: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    import trimesh

    scene = trimesh.Scene()
    for x in (0, 3):
        scene.add_geometry(
            creation.box((1, 1, 1)), transform=trimesh.transformations.translation_matrix((x, 0, 0))
        )
    scene.export(meshes / "pair.glb")
    ShapeLibrary.open(meshes)["pair"]
    assert "pair.glb: its 2 parts become one rigid shape" in caplog.text
    assert "brick" not in caplog.text
    done = packit(
        "shapes", "import", f"folder:{meshes}", "--out", tmp_path / "stored", "--workers", "2"
    )
    assert done.returncode == 0, done.stderr
    assert "2 parts joined" in " ".join(done.stdout.split())
    assert "Files with several parts: pair. The parts of a file become one rigid" in done.stdout
    report = json.loads((tmp_path / "stored.report.json").read_text())
    assert {one["id"]: one["parts"] for one in report["shapes"]} == {
        "ball": 1,
        "brick": 1,
        "pair": 2,
    }


@pytest.fixture
def few(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A pack of three items, whose shapes are not decomposed yet; by halving, which is fast."""
    monkeypatch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    write_packs(tmp_path / "few.jsonl", [rollout("a/b/c", 0, 3).pack])
    return tmp_path / "few.jsonl"


@pytest.mark.slow
def test_the_decomposition_of_shapes_has_its_own_bar(
    few: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "console", terminal.PlainConsole(force_terminal=True))
    pieces = ("--decomposition", "bisection")
    first, second = (packit("score", few, *pieces) for _ in range(2))
    assert first.returncode == second.returncode == 0, first.stderr
    shown = re.sub(r"\x1b\[[?\d;]*\w", "", first.stdout)
    bars = re.findall(r"(\w+) +━", shown)
    assert list(dict.fromkeys(bars)) == ["decomposing", "packs"]
    count = len({item.shape for item in rollout("a/b/c", 0, 3).pack.items})
    assert re.search(rf"decomposing .* {count}/{count}", shown)
    assert "decomposing" not in second.stdout


def test_an_error_is_not_glued_to_the_progress_bar(
    few: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from packit_sim.cli.app import main

    def broken(*arguments: object, **more: object) -> None:
        raise PhysicsError("nothing moves")

    monkeypatch.setattr("packit_sim.pack_quality", broken)
    monkeypatch.setattr(sys, "argv", ["packit", "score", str(few), "--decomposition", "bisection"])
    monkeypatch.setattr(sys, "stderr", sys.stdout)  # as a terminal shows both
    with pytest.raises(SystemExit):
        main()
    lines = capfd.readouterr().out.splitlines()
    assert "error: nothing moves" in lines and lines[-1] == "error: nothing moves"


def test_the_advice_without_coacd_names_the_option(
    few: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(name: str) -> str:
        raise decomposition.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(decomposition.metadata, "version", absent)
    failed = packit("score", few)
    assert failed.returncode == 2 and failed.stderr.count("\n") == 1
    assert "pip install 'packit-sim[physics]'" in failed.stderr
    (advice,) = re.findall(r"(--\w+) bisection", failed.stderr)
    assert advice in options(commands()["score"])


def test_environments_find_the_library_of_a_dataset(own: Path, meshes: Path) -> None:
    with_default = PackItEnv(own).tasks
    assert [task.digest for task in with_default] == [
        task.digest for task in PackItEnv(own, meshes).tasks
    ]
    assert {item.shape.id for task in with_default for item in task.items} <= {"ball", "brick"}


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        ("train --out x", "torch", "learn"),
        ("train --out x", "stable_baselines3", "learn"),
        ("evaluate starter --tasks 1 --agent packnn/aligned/blbf", "torch", "learn"),
        ("view starter --no-browser", "viser", "view"),
        ("film starter --out x.mp4", "imageio_ffmpeg", "view"),
        ("figures --out x", "matplotlib", "report"),
        ("datasets stats starter --out x.png", "matplotlib", "report"),
        ("datasets datasheet starter --out x.md", "matplotlib", "report"),
        ("reproduce table1 --quick", "matplotlib", "report"),
        ("report few.jsonl --out x.html", "matplotlib", "report"),
        ("generate --out x --backend ray", "ray", "cluster"),
        ("score few.jsonl --decomposition bisection", "pybullet", "physics"),
        ("evaluate few.jsonl --physics --decomposition bisection", "pybullet", "physics"),
    ],
)
def test_a_missing_package_names_its_extra_before_any_work(
    command: str, package: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(disk_cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    write_packs(tmp_path / "few.jsonl", [rollout("a/b/c", 0, 3).pack])
    before = sorted(tmp_path.iterdir())
    for name in list(sys.modules):
        if name.partition(".")[0] == package or name.startswith("packit_agents.learning."):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    world.pybullet_module.cache_clear()
    failed = packit(*command.split(), cwd=tmp_path)
    assert failed.returncode == 2, failed.stdout
    assert failed.stderr.count("\n") == 1
    assert f"pip install 'packit-sim[{extra}]'" in failed.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_is_a_packing_if_it_has_one_and_no_packs(tmp_path) -> None:
    assert packing_file(str(tmp_path)) is None
    (tmp_path / "packing.json").touch()
    assert packing_file(str(tmp_path)) == str(tmp_path / "packing.json")
    (tmp_path / "results.jsonl").touch()
    assert packing_file(str(tmp_path)) is None
    assert packing_file("absent.json") == "absent.json"
    assert packing_file("starter") is None
