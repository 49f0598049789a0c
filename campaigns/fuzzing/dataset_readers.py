"""Readers of datasets: packs, results, manifests, and the packs and packings of other tools."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from trimesh import creation

from campaigns.fuzzing import file_changes, world
from campaigns.fuzzing.json_changes import json_tree
from campaigns.fuzzing.reader import Reader
from packit_sim.core.errors import PackItError
from packit_sim.game.datasets.dataset_checks import verify_dataset
from packit_sim.game.datasets.manifests import Manifest, manifest_path
from packit_sim.game.datasets.original import read_original
from packit_sim.game.datasets.pack_files import dataset_library, read_packs, write_packs
from packit_sim.game.evaluation.results import check_results, read_results
from packit_sim.geometry.items import PlacedItem, PosedItem
from packit_sim.geometry.motions import Motion
from packit_sim.geometry.shapes import Item
from packit_sim.parts.packings.instances import ITEM_ORIGINS, read_instance, read_solution
from packit_sim.parts.packings.packing_files import verify_packing
from packit_sim.robot.cell import RobotCell
from packit_sim.robot.executed_item import Outcome
from packit_sim.robot.measures import measures
from packit_sim.robot.recording import Recording
from packit_sim.robot.trajectory import Attempt, Trajectory
from packit_sim.rules import Rules
from packit_sim.selftest.cases import Case
from packit_sim.selftest.replays import read_replay, replay_text
from tests import bad_meshes


def _lines(packs: Any) -> list[bytes]:
    lines = [pack.to_json().encode() + b"\n" for pack in packs]
    return [*lines, b"".join(lines)]


def _former(folder: str) -> list[bytes]:
    """Return lines of format 1, which the test of the former format keeps."""
    records = Path(bad_meshes.__file__).parent / "references" / "format-1" / folder
    lines = [
        line + b"\n"
        for file in sorted(records.glob("*.jsonl"))
        for line in file.read_bytes().splitlines()[:1]
    ]
    return [line for line in lines if len(line) < world.MAX_SEED]


def _read_packs(data: bytes) -> None:
    for pack in read_packs(world.written("packs/packs.jsonl", data)):
        with suppress(PackItError):
            pack.task(world.library())
            pack.contents(world.library())
        pack.to_json()


def _results() -> list[bytes]:
    rules = (Rules(), Rules(buffer=1, rotations="yaw"), Rules(support=0.2, boxes=2))
    return _lines([*map(world.played, rules), world.valued()])


def _read_results(data: bytes) -> None:
    file = world.written("results/results.jsonl", data)
    rollouts = read_results(file)
    check_results(file, rollouts)
    check_results(file, rollouts, world.library())


def _verify(data: bytes) -> None:
    for problem in verify_dataset(
        world.written("verify/packs.jsonl", data), world.library()
    ).problems:
        world.require_clean(str(problem))


def _read_manifest(data: bytes) -> None:
    file = world.written("manifests/packs.jsonl", _lines([world.pack()])[0])
    data = data.replace(b"@SHA256@", hashlib.sha256(file.read_bytes()).hexdigest().encode())
    data = data.replace(world.COMPUTED, world.library().digest.encode())
    manifest = manifest_path(file)
    manifest.write_bytes(data.replace(b"@LIBRARY@", str(world.library().path).encode()))
    read_packs(file)
    dataset_library(file)
    Manifest.read(manifest).to_json()


def _manifests() -> list[bytes]:
    file = world.folder() / "seeds" / "packs.jsonl"
    write_packs(file, [world.pack()])
    data = manifest_path(file).read_bytes()
    data = data.replace(hashlib.sha256(file.read_bytes()).hexdigest().encode(), b"@SHA256@")
    data = data.replace(world.library().digest.encode(), world.COMPUTED)
    return [data.replace(str(world.library().path).encode(), b"@LIBRARY@")]


def _originals() -> list[bytes]:
    sources = [f"Shapes_te/{id}/model.obj" for id in world.SHAPES]
    pack = {
        "efficiency": 0.4,
        "sources": sources,
        "positions": [{"x": 0.0, "y": -0.1, "z": 0.1} for _ in sources],
        "scales": [dict.fromkeys("xyz", 0.5) for _ in sources],
        "rotations": [dict(zip("xyzw", (0.0, 0.0, 0.0, 1.0), strict=True)) for _ in sources],
        "shapeScale": 0.8,
    }
    return [json.dumps({"data": packs}).encode() for packs in ([pack], [pack, pack])]


def _read_original(data: bytes) -> None:
    file = world.written("original/2_tr", data)
    for partial in (False, True):
        found = read_original(file, world.library(), partial=partial)
        world.require_clean(found.report(), lines=True)


def _packings() -> list[bytes]:
    pose = Motion.shift((2, 2, 2)).matrix
    other = pose.copy()
    other[0, 3] = 5.0
    items = [{"mesh": "parts/box.stl", "pose": one.tolist()} for one in (pose, other)]
    content = {"box": [9, 8, 7], "unit": "mm", "items": items}
    middle = Motion.shift((4.5, 4.5, 4.5)).matrix.tolist()
    case = {"form": "mesh", "mesh": "parts/case.stl", "pose": middle}
    round_box = {"box": [9, 9, 7], "container": {"form": "cylinder"}}
    several = {"boxes": [[9, 8, 7], [9, 9, 9]], "containers": [None, case]}
    return [json.dumps(content | more).encode() for more in ({}, round_box, several)]


def _read_packing(data: bytes) -> None:
    world.written("packing/parts/box.stl", world.exported(creation.box((1, 2, 3)), "stl"))
    world.written("packing/parts/case.stl", world.exported(creation.box((9, 9, 9)), "stl"))
    for problem in verify_packing(world.written("packing/packing.json", data)).problems:
        world.require_clean(str(problem))


def _instance(folder: str) -> None:
    """Write an instance and its meshes, which solutions refer to."""
    for name, mesh in (("box.stl", creation.box((1, 2, 3))), ("cone.stl", creation.cone(1, 2))):
        world.written(f"{folder}/parts/{name}", world.exported(mesh, "stl"))
    world.written(f"{folder}/given.json", _instances()[0])


def _instances() -> list[bytes]:
    types = [{"path": f"parts/{name}.stl", "demand": 2} for name in ("box", "cone")]
    content = {"name": "two", "container": {"size-x": 9, "size-y": 8.5}, "item-types": types}
    return [json.dumps(content).encode()]


def _read_instance(data: bytes) -> None:
    _instance("instance")
    read_instance(world.written("instance/changed.json", data))


def _solutions() -> list[bytes]:
    matrix = np.eye(4)
    matrix[3, :3] = 2.0
    pose = {"position": [2, 2, 2], "yaw": 0, "pitch": 0, "roll": 0, "matrix": matrix.tolist()}
    items = [{"name": "box.stl", "transformation": pose}] * 2
    content = {"instancePath": "given.json", "totalHeight": 3.5, "items": items}
    return [json.dumps(content | {"itemOrigin": origin}).encode() for origin in ITEM_ORIGINS]


def _read_solution(data: bytes) -> None:
    _instance("solution")
    packing = read_solution(world.written("solution/changed.json", data))
    for problem in packing.problems():
        world.require_clean(problem)


def _replays() -> list[bytes]:
    first, second = world.pack().placed(world.library())
    assert isinstance(first, PlacedItem)
    return [replay_text("masks", Case(world.CELLS, (first,), second.item)).encode()]


def _read_replay(data: bytes) -> None:
    _, case = read_replay(world.written("replay.json", data))
    case.box()


def _trajectories() -> list[bytes]:
    """Return an item that a cup of a gantry holds, and one for which there was no grasp."""
    item = PosedItem.at(Item(world.library()["box/model0"], 0.0002), Motion.shift((0.5, 0.5, 0.2)))
    poses = np.array([[0.5, 0.5, 0.2, 1.0, 0, 0, 0]] * 2)
    held = Recording(np.zeros((5, 4)), (1, 3), 0.004, np.array([[0, 0], [2, 0]]), poses)
    tried = ((Outcome.PLACED, held), (Outcome.NO_GRASP, Recording()))
    attempts = tuple(Attempt(item, item, outcome, own) for outcome, own in tried)
    return [Trajectory(RobotCell(), (100, 100, 100), attempts).to_bytes()]


def _read_trajectory(data: bytes) -> None:
    found = Trajectory.from_bytes(data, lambda id: world.library()[id])
    if found.attempts and len(found.attempts) < 5:
        measures(found, [one.chosen.item for one in found.attempts])


READERS = (
    Reader("packs", "packs of format 2", lambda: _lines(world.packs()), _read_packs, json_tree),
    Reader("packs-1", "packs of format 1", lambda: _former("packs"), _read_packs, json_tree),
    Reader("results", "results", _results, _read_results, json_tree),
    Reader(
        "results-1", "results of format 1", lambda: _former("results"), _read_results, json_tree
    ),
    Reader("verify", "packs, verified", lambda: _lines(world.packs()), _verify, json_tree, 20.0),
    Reader("manifests", "manifests", _manifests, _read_manifest, json_tree),
    Reader("original", "packs of the original PackIt", _originals, _read_original, json_tree),
    Reader("packings", "packings of other tools", _packings, _read_packing, json_tree),
    Reader("instances", "strip-packing instances", _instances, _read_instance, json_tree),
    Reader("solutions", "solutions of instances", _solutions, _read_solution, json_tree),
    Reader("replays", "replays of `packit selftest`", _replays, _read_replay, json_tree),
    Reader(
        "trajectories",
        "trajectories of an arm",
        _trajectories,
        _read_trajectory,
        file_changes.archive(file_changes.npy),
        20.0,
    ),
)
"""The readers of this module."""
