"""The commands that the campaign of faults disturbs: small settings, and what each may leave."""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import torch
from PIL import Image
from trimesh import creation

from campaigns.disturbed import OUT, Command
from campaigns.fault_pages import FOLDERS, PageCommand
from packit_agents.learning import training
from packit_agents.learning.checkpoints import read_checkpoint
from packit_agents.learning.weights import read_weights
from packit_agents.placements import champion_training
from packit_agents.placements.network import PlacementNetwork
from packit_sim.game.datasets.builtin import DEFAULT_LIBRARY
from packit_sim.game.datasets.pack_files import dataset_file, read_packs
from packit_sim.game.evaluation import results_store
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.game.evaluation.results import read_results
from packit_sim.game.generation import jobs
from packit_sim.libraries import importer
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.parts.packings.instances import read_instance, read_solution
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.parts.results import instructions, pictures
from packit_sim.parts.results.verification import verify_record
from packit_sim.render.renderers import RENDERER_VARIABLE

FOREIGN = {
    "notes.txt": "mine",
    ".notes.lock": "mine",
    "res.jsonl.bak": "{}",
    ".res.jsonl.mine": "mine",
    "lib.old/library.json": "{}",
    ".lib.mine/new/library.json": "{}",
    "run.old/checkpoint.pt": "mine",
    "packs.manifest.json": "mine",
    "packed.old/packing.json": "{}",
    "packed/notes.txt": "mine",
    "packed/packing-7.png": "mine",
    "packed/meshes/box-0.stl": "mine",
}
"""Files of the user next to the output, some with names like those of the product."""


def prepare_inputs(workspace: Path) -> None:
    """Write the meshes and tasks that the commands read."""
    for folder, meshes in (("meshes", 3), ("fewer", 2)):
        (workspace / folder).mkdir()
        for n in range(meshes):
            creation.box((1, 1 + 0.3 * n, 2)).export(workspace / folder / f"box-{n}.stl")
    lines = dataset_file("starter").read_text().splitlines(keepends=True)
    few = "".join(sorted(lines, key=len)[:2])  # few items
    (workspace / "tasks.jsonl").write_text(few)
    packs = read_packs(workspace / "tasks.jsonl")
    tasks = [pack.task(ShapeLibrary.open(DEFAULT_LIBRARY)) for pack in packs]
    evaluate(["random/aligned/blbf"], tasks, 0, file=workspace / "results.jsonl")
    (workspace / "changed").mkdir()
    for n in range(2):
        creation.box((1, 1, 1.5 + n)).export(workspace / "changed" / f"box-{n}.stl")
    items = [{"path": f"meshes/box-{n}.stl", "demand": 2} for n in range(2)]
    instance = {"container": {"size-x": 4, "size-y": 4}, "item-types": items}
    (workspace / "instance.json").write_text(json.dumps(instance))
    (workspace / "splits").mkdir()
    for split in ("train", "validation"):
        (workspace / "splits" / f"{split}.jsonl").write_text(few)
    history = dataset_file("everyday-v1-history", "test").read_text().splitlines(keepends=True)
    (workspace / "history.jsonl").write_text("".join(history[:2]))


def make_quick() -> None:
    """Let this process and its forked children write after each step, and import by forking.

    New processes for the meshes would take seconds to start.
    """
    os.environ[RENDERER_VARIABLE] = "software"  # forked processes can't use EGL
    torch.set_num_threads(1)
    for module in (jobs, results_store, training):
        vars(module)["CHECKPOINT_SECONDS"] = -1.0
    vars(pictures)["SIZE"] = 40, 30
    vars(instructions).update(SMALL=(20, 15), LARGE=(40, 30))
    vars(champion_training)["PlacementTrainingSettings"] = partial(
        champion_training.PlacementTrainingSettings, drawn=2, plays=2, width=2, validate_every=1
    )
    fork = multiprocessing.get_context("fork")
    forking = SimpleNamespace(get_context=lambda method: fork)
    vars(importer)["multiprocessing"] = forking


def _check_packs(folder: Path, whole: Path) -> None:
    """Packs: one or both."""
    found, wanted = (read_packs(each / "packs" / "packs.jsonl") for each in (folder, whole))
    assert found in (wanted[:1], wanted), "packs are lost"


def _check_results(folder: Path, whole: Path) -> None:
    """Results: the first two, which were there before, or more."""
    found, wanted = (read_results(each / "res.jsonl") for each in (folder, whole))
    lost = [rollout for rollout in wanted[:2] if rollout not in found]
    assert not lost and all(rollout in wanted for rollout in found), "results are lost"


def _check_training(folder: Path, whole: Path) -> None:
    """Any of the files of a training."""
    run = _check_run(folder, whole, "run", read_weights)
    read_checkpoint(run / "checkpoint.pt", torch.device("cpu"))
    _check_pictures(run)


def _check_champion(folder: Path, whole: Path) -> None:
    """Any of the files of a training of the champion."""
    _check_run(folder, whole, "champion", PlacementNetwork.read)


def _check_run(folder: Path, whole: Path, name: str, read: Callable[[Path], object]) -> Path:
    """Check what all trainings write: a curve, settings and weights; return the run's folder."""
    run = folder / name
    curves = [each / name / "curve.json" for each in (folder, whole)]
    found, wanted = (json.loads(file.read_text()) if file.exists() else [] for file in curves)
    assert found == wanted[: len(found)], "the curve is another"
    if (run / "settings.json").exists():
        assert json.loads((run / "settings.json").read_text())
    for file in run.glob("*.safetensors"):
        read(file)
    return run


def _check_library(folder: Path, whole: Path) -> None:
    """Read the library, the former or the new one, with all its meshes."""
    library = ShapeLibrary.open(folder / "lib")
    assert [library.source.load(id).digest for id in library.ids]
    assert len(library) in (2, 3), "shapes are lost"
    report = folder / "lib.report.json"
    assert len(json.loads(report.read_text())["shapes"]) in (2, 3)


def _check_reproduction(folder: Path, whole: Path) -> None:
    """Any of the files of a reproduction."""
    made = folder / "rep"
    file = made / "evolution.jsonl"
    if file.exists():
        wanted = read_results(whole / "rep" / "evolution.jsonl")
        assert all(rollout in wanted for rollout in read_results(file))
    for file in made.glob("*.json"):
        assert json.loads(file.read_text())
    for file in made.glob("*.md"):
        assert file.read_text().endswith(".\n")
    _check_pictures(made)


def _check_packing(folder: Path, whole: Path) -> None:
    """A packing that holds: of two parts, which was there before, or of all three."""
    file = folder / "packed" / "packing.json"
    report = verify_record(file)
    assert report.is_valid, report.problems[0]
    assert len(json.loads(file.read_text())["items"]) in (2, 3), "parts are lost"


def _check_nest(folder: Path, whole: Path) -> None:
    """A packing, a solution and an instance that can be read, of the search before or this one."""
    file = folder / "nested" / "packing.json"
    report = verify_packing(file)
    assert report.is_valid, report.problems[0]
    read_solution(folder / "nested" / "solution.json")
    read_instance(folder / "nested" / "instance.json")


def _check_page(folder: Path, whole: Path) -> None:
    page = folder / "page.html"
    assert page.read_text().rstrip().endswith("</html>")


def _check_export(folder: Path, whole: Path) -> None:
    """A packing that holds, of one pack or the other."""
    assert verify_packing(folder / "exported" / "box.json").is_valid


def _check_nothing(folder: Path, whole: Path) -> None:
    """Nothing but the temporary folder of a workbench that was killed."""
    allowed = {name.partition("/")[0] for name in FOREIGN}
    left = [each.name for each in folder.iterdir() if not each.match(FOLDERS)]
    assert set(left) <= allowed, f"{left} are left"


def _check_pictures(folder: Path) -> None:
    for file in folder.glob("*.png"):
        with Image.open(file) as picture:
            picture.load()


_SETTINGS = (
    *("packs=tasks.jsonl", "split=none", "validation_packs=tasks.jsonl", "validation=none"),
    *("teacher=largest-first/aligned/blbf", "imitation=8", "steps=16", "envs=2"),
    *("rollout_steps=4", "minibatch=4", "epochs=1", "imitation_epochs=1", "validate_every=8"),
    *("validation_tasks=2", "network.width=8", "network.encoder_blocks=1"),
    "network.trunk_blocks=1",
)

_EVOLVE = (
    *("--out", f"{OUT}/packs", "--pool", "3", "--population", "51", "--generations", "2"),
    *("--size-range", "0.5", "0.6", "--packs"),
)
_PLAY = ("tasks.jsonl", "--out", f"{OUT}/res.jsonl", "--agent", "random/aligned/blbf")
_IMPORT = ("--out", f"{OUT}/lib", "--all")
_PACK = (
    *("--box", "4x4x4mm", "--out", f"{OUT}/packed"),
    *("--iterations", "20", "--workers", "1"),
)

_NEST = (
    *("instance.json", "--iterations", "1", "--workers", "1"),
    *("--instance-out", f"{OUT}/nested/instance.json", "--out", f"{OUT}/nested/solution.json"),
    *("--packing", f"{OUT}/nested/packing.json"),
)
_REPORT = ("results.jsonl", "--out", f"{OUT}/page.html")
_EXPORT = ("tasks.jsonl", "--out", f"{OUT}/exported/box.json")

COMMANDS = {
    each.title: each
    for each in (
        Command("generate", (*_EVOLVE, "2"), (*_EVOLVE, "1"), _check_packs, cluster=True),
        Command(
            "evaluate",
            (*_PLAY, "--agent", "largest-first/aligned/blbf"),
            _PLAY,
            _check_results,
            cluster=True,
        ),
        Command(
            "train",
            ("--out", f"{OUT}/run", *(word for each in _SETTINGS for word in ("--set", each))),
            (),
            _check_training,
            workers=False,
        ),
        Command(
            "train-champion",
            ("--train-on", "splits", "--tasks", "2", "--rounds", "2", "--out", f"{OUT}/champion"),
            (),
            _check_champion,
        ),
        Command(
            "shapes import",
            ("folder:meshes", *_IMPORT, "--overwrite"),
            ("folder:fewer", *_IMPORT),
            _check_library,
        ),
        Command(
            "reproduce",
            (
                *("evolution", "--quick", "--history-dataset", "history.jsonl"),
                *("--out", f"{OUT}/rep"),
            ),
            (),
            _check_reproduction,
        ),
        Command(
            "pack",
            ("meshes", *_PACK),
            ("fewer", *_PACK),
            _check_packing,
            workers=False,
            repeats=False,
        ),
        Command(
            "pack",
            ("changed", *_PACK),
            ("fewer", *_PACK),
            _check_packing,
            workers=False,
            repeats=False,
            change="changed parts",
        ),
        Command(
            "pack",
            ("meshes", "--box", "5x4x4mm", *_PACK[2:], "--instructions"),
            ("meshes", *_PACK),
            _check_packing,
            workers=False,
            repeats=False,
            change="changed box",
        ),
        Command(
            "nest",
            (*_NEST, "--seed", "1"),
            (*_NEST, "--seed", "2"),
            _check_nest,
            workers=False,
        ),
        Command("report", _REPORT, (*_REPORT, "--title", "x"), _check_page, workers=False),
        Command("export", (*_EXPORT, "--pack", "1"), _EXPORT, _check_export, workers=False),
        PageCommand("workbench", (), (), _check_nothing, workers=False),
    )
}
"""The commands by name and change. Only `train`, `train-champion` and `reproduce` have no output to
lose."""
