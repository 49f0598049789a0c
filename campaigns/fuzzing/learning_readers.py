"""Readers of what belongs to learning: weights, settings, learning curves and recordings."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import torch

from campaigns.fuzzing import file_changes, world
from campaigns.fuzzing.json_changes import json_tree
from campaigns.fuzzing.reader import Reader
from packit_agents.learned_model.contact_network import ContactNetwork
from packit_agents.learning.networks import NetworkSettings, network
from packit_agents.learning.training_settings import read_settings
from packit_agents.learning.weights import read_weights, write_weights
from packit_agents.online.column_kernels import plan
from packit_agents.online.columns import ColumnGame
from packit_agents.online.value_tables import Patterns, ValueTables
from packit_agents.placements.network import PlacementNetwork
from packit_agents.placements.placement_features import FEATURES
from packit_sim.game.envs.recording import record, stage_steps
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Stage
from packit_sim.game.evaluation.learning_curves import TrainingRecord
from packit_sim.game.evaluation.transitions import read_transitions, record_transitions
from tests import bad_meshes


def _weights() -> list[bytes]:
    torch.manual_seed(0)
    file = world.folder() / "seed.safetensors"
    files = []
    for blocks in (0, 1):
        settings = NetworkSettings(width=1, encoder_blocks=blocks, trunk_blocks=blocks)
        provenance = {"version": "0.1.0", "settings": {"steps": 5, "rules": {"easy": False}}}
        write_weights(file, network(settings, 0), settings, 0, provenance)
        files.append(file.read_bytes())
    former = files[0].replace(b'"version":"2"', b'"version":"1"')
    return [*files, former.replace(b'"provenance"', b'"made"      ')]


def _read_weights(data: bytes) -> None:
    read_weights(world.written("weights.safetensors", data))


def _placement_weights() -> list[bytes]:
    file = world.folder() / "placements.safetensors"
    files = []
    for width in (1, 3):
        tensors = {
            name: np.full(shape, 0.5, np.float32)
            for name, shape in PlacementNetwork.shapes(width).items()
        }
        PlacementNetwork(tensors, {"rounds": 3}).write(file)
        files.append(file.read_bytes())
    return files


def _read_placement_weights(data: bytes) -> None:
    network = PlacementNetwork.read(world.written("placements.safetensors", data))
    network(np.ones((2, len(FEATURES)), np.float32))
    network.digest  # noqa: B018


def _settings() -> list[bytes]:
    folder = Path(bad_meshes.__file__).parents[1] / "benchmarks" / "trainings"
    return [file.read_bytes() for file in sorted(folder.glob("*.toml"))]


def _read_toml(data: bytes) -> None:
    read_settings(world.written("settings.toml", data), [])


_TRAINING = {
    "settings": {"steps": 5000, "rules": {"easy": False}, "network": {"width": 64}, "teacher": None}
}
_CURVE = [
    {"steps": 0, "reward": None, "validation": {"mean": 0.5, "low": None, "high": None}},
    {"steps": 1000, "reward": 0.25, "validation": {"mean": 0.5, "low": 0.4, "high": 0.75}},
]


def _read_training(name: str) -> Callable[[bytes], None]:
    def read(data: bytes) -> None:
        world.written("training/settings.json", json.dumps(_TRAINING).encode())
        world.written("training/curve.json", json.dumps(_CURVE).encode())
        folder = world.written(f"training/{name}", data).parent
        TrainingRecord.read(folder).best  # noqa: B018

    return read


def recording_folder() -> Path:
    folder = world.folder() / "recording-seed"
    if not folder.exists():
        tasks = [world.pack().task(world.library())]
        env = gymnasium.make(
            "PackIt-v0", tasks=tasks, observation="none", rotation="aligned", location="blbf"
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the task is an object
            record(env, folder, episodes=1)
    return folder


def _recorded(name: str) -> Callable[[], list[bytes]]:
    return lambda: [(recording_folder() / name).read_bytes()]


def _read_recording(name: str) -> Callable[[bytes], None]:
    def read(data: bytes) -> None:
        for file in recording_folder().iterdir():
            world.written(f"recording/{file.name}", file.read_bytes())
        folder = world.written(f"recording/{name}", data).parent
        for _ in stage_steps(folder, Stage.SHAPE):
            pass

    return read


def transitions_folder() -> Path:
    folder = world.folder() / "transitions-seed"
    agent = Agent.from_name("largest-first/aligned/blbf")
    record_transitions(folder, [world.pack().task(world.library())], [agent], 1, episodes=1)
    return folder


def _read_manifest_of_transitions(data: bytes) -> None:
    shard = (transitions_folder() / _SHARD).read_bytes()
    world.written("transitions/manifest.json", data)
    for _ in read_transitions(world.written(f"transitions/{_SHARD}", shard).parent):
        pass


def _read_shard(data: bytes) -> None:
    shards = json.loads((transitions_folder() / "manifest.json").read_text())
    shards["shards"][0]["sha256"] = hashlib.sha256(data).hexdigest()
    folder = world.written(f"transitions/{_SHARD}", data).parent
    world.written("transitions/manifest.json", json.dumps(shards).encode())
    for shard in read_transitions(folder):
        for step in range(len(shard)):
            shard.feasible(step), shard.filled(shard.state(step) + 1)


def _contact_weights() -> list[bytes]:
    file = world.folder() / "contacts.safetensors"
    shapes = ContactNetwork.shapes(2)
    tensors = {name: np.full(shape, 0.5, np.float32) for name, shape in shapes.items()}
    ContactNetwork(tensors, {"rounds": 3}).write(file)
    return [file.read_bytes()]


def _read_contact_weights(data: bytes) -> None:
    network = ContactNetwork.read(world.written("contacts.safetensors", data))
    network(np.ones((2, len(ContactNetwork.features)), np.float32))


def _column_values() -> list[bytes]:
    file = world.folder() / "columns.safetensors"
    files = []
    for sides, shapes in (((2, 2, 2), (_BAR,)), ((3, 2, 4), (_BAR, (*_BAR, (1, 0, 0))))):
        game = ColumnGame(sides, shapes, "yaw")
        tables = np.full(Patterns.of(sides).entries, 0.5, np.float32)
        ValueTables(game, {1: tables, 3: tables}, {"rounds": 3}).write(file)
        files.append(file.read_bytes())
    return files


def _read_column_values(data: bytes) -> None:
    tables = ValueTables.read(world.written("columns.safetensors", data))
    game = tables.game
    counts = np.ones(len(game.shapes), np.int64)
    heights = np.zeros(game.sides[0] * game.sides[1], np.int64)
    plan(heights, counts, counts[:0], game.arrays, tables.arrays(2), 1, 2, 0)
    tables.digest  # noqa: B018


_BAR = ((0, 0, 0), (0, 1, 0))

_SHARD = "000000.npz"

READERS = (
    Reader(
        "weights",
        "weights",
        _weights,
        _read_weights,
        file_changes.safetensors,
    ),
    Reader(
        "placement-weights",
        "weights of networks for placements",
        _placement_weights,
        _read_placement_weights,
        file_changes.safetensors,
    ),
    Reader(
        "contact-weights",
        "weights of networks for contacts",
        _contact_weights,
        _read_contact_weights,
        file_changes.safetensors,
    ),
    Reader(
        "column-values",
        "values of columns",
        _column_values,
        _read_column_values,
        file_changes.safetensors,
    ),
    Reader(
        "transitions",
        "transitions: manifest",
        lambda: [(transitions_folder() / "manifest.json").read_bytes()],
        _read_manifest_of_transitions,
        json_tree,
    ),
    Reader(
        "transitions-shards",
        "transitions: shards",
        lambda: [(transitions_folder() / _SHARD).read_bytes()],
        _read_shard,
        file_changes.archive(file_changes.npy),
    ),
    Reader("settings", "settings (TOML)", _settings, _read_toml, file_changes.toml),
    Reader(
        "training-settings",
        "settings of a training (JSON)",
        lambda: [json.dumps(_TRAINING).encode()],
        _read_training("settings.json"),
        json_tree,
    ),
    Reader(
        "curves",
        "learning curves",
        lambda: [json.dumps(_CURVE).encode()],
        _read_training("curve.json"),
        json_tree,
    ),
    Reader(
        "recording-metadata",
        "recordings: metadata",
        _recorded("metadata.json"),
        _read_recording("metadata.json"),
        json_tree,
    ),
    Reader(
        "recording-data",
        "recordings: HDF5",
        _recorded("main_data.hdf5"),
        _read_recording("main_data.hdf5"),
    ),
)
"""The readers of this module."""
