"""The pretrained networks play by their names, and their card describes them."""

import hashlib
import json
import pickle
import re
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.learned_model import AGENTS
from packit_agents.learned_model.contact_network import ContactNetwork
from packit_agents.learning import pretrained
from packit_agents.learning.networks import PackNN
from packit_agents.learning.training_settings import read_settings
from packit_agents.learning.weights import read_weights
from packit_agents.online.value_tables import ValueTables
from packit_agents.online.value_training import ValueTrainingSettings
from packit_agents.placements.champion_training import PlacementTrainingSettings
from packit_agents.placements.network import PlacementNetwork
from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.game.datasets.pack_files import load_tasks
from packit_sim.game.datasets.packs import Task
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode
from packit_sim.game.evaluation.transitions import tasks_digest
from packit_sim.game.generation.sequences import ItemSampler
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.rules import Rules

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "assets" / "weights"
FILES = sorted(FOLDER.glob("*.safetensors"))
MEASURED = json.loads((ROOT / "benchmarks" / "results" / "learned.json").read_text())


def on_the_card() -> list[list[str]]:
    """The rows of all tables of the card."""
    lines = (FOLDER / "README.md").read_text(encoding="utf-8").splitlines()
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in lines if line[:1] == "|"]


def test_the_card_names_each_file_and_no_other() -> None:
    named = {
        row[0].strip("`"): row[-1].strip("`") for row in on_the_card() if "safetensors" in row[0]
    }
    digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in FILES}
    assert named == {name: digest[:16] for name, digest in digests.items()}
    assert "packnn.safetensors" in named


@pytest.mark.parametrize(
    "file", [file for file in FILES if file.stem.startswith("packnn")], ids=lambda file: file.stem
)
def test_a_network_is_of_a_training_that_can_be_done_again(file) -> None:
    _, placement_features, provenance = read_weights(file)
    config = ROOT / "benchmarks" / "trainings" / f"{file.stem}.toml"
    settings = read_settings(config, [f"seed={provenance['settings']['seed']}"])
    rules = asdict(Rules()) | provenance["settings"]["rules"]  # older ones lack newer rules
    assert provenance["settings"] | {"rules": rules} == asdict(settings)
    assert (placement_features > 0) == (settings.observation == "placement-features")
    assert (settings.packs, settings.split) == ("everyday-v1", "train")
    assert settings.validation == "validation"


def test_the_model_of_contacts_is_of_a_training_that_can_be_done_again() -> None:
    provenance = ContactNetwork.read(FOLDER / "contacts.safetensors").provenance
    for name in ("train", "validation"):
        own = provenance[name]
        assert own["agents"] == list(AGENTS)
        tasks = load_tasks("everyday-v1", ShapeLibrary.open("everyday"), name)
        assert own["tasks"] == tasks_digest(tasks)


def test_the_champion_is_of_a_training_that_can_be_done_again() -> None:
    provenance = PlacementNetwork.read(FOLDER / "champion.safetensors").provenance
    settings = json.loads(json.dumps(asdict(PlacementTrainingSettings())))
    newer = {name: settings[name] for name in ("rules", "start")}
    assert provenance["settings"] | newer == settings
    library = ShapeLibrary.open("everyday")
    for packs, digests in provenance["tasks"].items():
        assert [task.digest for task in load_tasks(packs, library, "train")] == digests


def test_the_online_champion_is_of_a_training_that_can_be_done_again() -> None:
    provenance = PlacementNetwork.read(FOLDER / "online-champion.safetensors").provenance
    settings = PlacementTrainingSettings(
        packs=("everyday-online",), rules=Rules(kinematic=True, buffer=5), drawn=10, rounds=30
    )
    assert provenance["settings"] == json.loads(json.dumps(asdict(settings)))
    library = ShapeLibrary.open("everyday")
    digests = {"train": provenance["tasks"]["everyday-online"]}
    digests["validation"] = provenance["validation"]
    for split, first in (("train", 0), ("validation", 10_000)):
        sampler = ItemSampler(library, load_tasks("everyday-v1", library, split), 40)
        count = len(digests[split])
        assert count == (300 if split == "train" else settings.validation_tasks)
        for n in (0, count // 2, count - 1):
            assert sampler.pack(first + n).task(library).digest == digests[split][n]


def test_values_of_columns_are_of_a_training_that_can_be_done_again() -> None:
    provenance = ValueTables.read(FOLDER / "blockout.safetensors").provenance
    settings = ValueTrainingSettings()
    assert provenance["settings"] == json.loads(json.dumps(asdict(settings)))
    assert provenance["library"] == ShapeLibrary.open("blockout").digest
    assert provenance["rounds"] == settings.rounds


def test_the_champion_plays_by_its_name_without_torch() -> None:
    code = """
import sys, numpy as np
from packit_sim import Agent, load_tasks, play
agent = Agent.from_name("champion+ruin-recreate=1")
print(play(load_tasks("starter")[8], agent, np.random.default_rng(0)).total)
print(*{"torch", "stable_baselines3"} & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    total, *loaded = done.stdout.split()
    assert float(total) > 0.8 and not loaded


@pytest.mark.parametrize("name", ["packnn", "packnn-easy", "packnn-placement"])
def test_a_network_plays_by_its_name(name) -> None:
    agent = Agent.from_name(f"{name}/aligned/blbf")
    whole = load_tasks("starter", ShapeLibrary.open("everyday"))[0]
    task = Task(whole.items[:12], whole.pack, ())
    returns = []
    for player in (agent, pickle.loads(pickle.dumps(agent))):
        episode = Episode(task)
        player.play(episode, np.random.default_rng(0))
        returns.append(episode.total)
    assert returns[0] == returns[1] > 0.3


def test_the_papers_network_sees_what_the_papers_does() -> None:
    network, placement_features, provenance = read_weights(FOLDER / "packnn.safetensors")
    assert placement_features == 0 and provenance["settings"]["network"]["network"] == "packnn"
    assert isinstance(network, PackNN)
    assert pretrained.PACKNN().provenance == provenance


def test_the_card_quotes_the_last_measurement() -> None:
    rows = {row["name"]: row for row in MEASURED["rows"]}
    quoted = 0
    for row in on_the_card():
        found = rows.get(row[0].strip("`"))
        if found is None:
            continue
        reward, success, ratio = (
            format_estimate(Estimate(**found["reward"]), ".3f"),
            format_estimate(Estimate(**found["success"]), ".1f"),
            format_estimate(Estimate(**found["comparison"]["ratio"]), ".3f"),
        )
        assert row[1:4] == [reward, success, ratio], row[0]
        quoted += 1
    assert quoted >= 8 and MEASURED["tasks"] == 150
    assert not re.search(r"/tmp|/home|/work", json.dumps(MEASURED))
