"""Training of the network that chooses placements."""

import json
from dataclasses import replace

import numpy as np
import pytest

from packit_agents.learning.run_folder import TrainingError
from packit_agents.learning.tensor_files import TensorFileError
from packit_agents.placements.champion_training import (
    PlacementTraining,
    PlacementTrainingSettings,
    first_network,
)
from packit_agents.placements.network import PlacementNetwork
from packit_agents.placements.placement_features import FEATURES
from packit_agents.placements.playing import (
    MAX_PLACEMENTS,
    Decision,
    Play,
    best_return,
    new_layout,
    play,
    plays,
)
from packit_agents.placements.policy_gradient import StepSettings, improve
from packit_sim.core.errors import ArgumentError
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_files import dataset_file, load_tasks
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.rules import PACKIT, Rules


@pytest.fixture(scope="module")
def tasks():
    return load_tasks("everyday-v1", ShapeLibrary.open("everyday"), "train")[:2]


@pytest.fixture(scope="module")
def packs(tmp_path_factory):
    """A dataset of two train packs and one for validation, with few items each."""
    folder = tmp_path_factory.mktemp("packs")
    for split, numbers in (("train", (70, 290)), ("validation", (35,))):
        lines = dataset_file("everyday-v1", split).read_text().splitlines(keepends=True)
        (folder / f"{split}.jsonl").write_text("".join(lines[n] for n in numbers))
    return str(folder)


def settings_of(packs: str, **changed) -> PlacementTrainingSettings:
    small = PlacementTrainingSettings(
        (packs,), tasks=2, drawn=1, plays=2, rounds=2, width=4, validate_every=2, validation_tasks=1
    )
    return replace(small, **changed)


@pytest.mark.slow
def test_decisions_of_better_plays_become_more_probable() -> None:
    rng = np.random.default_rng(0)
    shapes = PlacementNetwork.shapes(4)
    tensors = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    tensors["scale"] = np.ones_like(tensors["scale"])
    before = PlacementNetwork(tensors, {"of": "before"})
    features = rng.normal(size=(3, len(FEATURES))).astype(np.float32)
    group = [Play(total, [Decision(features, n)]) for n, total in enumerate((0.2, 0.9, 0.4))]

    def probabilities(network):
        weights = np.exp(network(features) - network(features).max())
        return weights / weights.sum()

    after = improve(before, [group], StepSettings(), 0)
    assert probabilities(after)[1] > probabilities(before)[1]
    assert after.provenance == before.provenance
    assert (after.tensors["mean"] == before.tensors["mean"]).all()
    unchanged = improve(before, [[replace(each, total=0.5) for each in group]], StepSettings(), 0)
    assert unchanged.digest == before.digest


@pytest.mark.slow
def test_plays_of_a_task_begin_with_the_same_items(tasks) -> None:
    network = first_network(tasks[:1], PACKIT, 4, 0)
    first, second = plays(tasks[0], PACKIT, network, 2, (0, 7))
    layout, rng = new_layout(tasks[0]), np.random.default_rng((0, 7))
    whole = play(layout, network, rng)
    assert layout.volume / tasks[0].volume == first.total
    common = len(whole) - len(first.decisions)
    assert 0 < common == rng.integers(len(whole))
    assert [d.chosen for d in whole[common:]] == [d.chosen for d in first.decisions]
    again = play(layout.restart(layout.placed[:common]), network, rng)
    assert layout.volume / tasks[0].volume == second.total
    chosen = [d.chosen for d in second.decisions]
    assert [d.chosen for d in again] == chosen != [d.chosen for d in first.decisions]
    assert (again[0].features == first.decisions[0].features).all()
    for decision in again:
        count, width = decision.features.shape
        assert decision.chosen < count <= MAX_PLACEMENTS and width == len(FEATURES)


def test_hidden_layers_add_nothing_at_first(tasks) -> None:
    network = first_network(tasks[:1], PACKIT, 4, 0)
    features = np.random.default_rng(1).normal(size=(5, len(FEATURES))).astype(np.float32)
    scores = network(features)
    rule = {"log volume": 48.0, "contact": 24.0, "top": -6.0}
    expected = sum(weight * features[:, FEATURES.index(name)] for name, weight in rule.items())
    assert scores - scores[0] == pytest.approx(expected - expected[0], abs=1e-3)


@pytest.mark.slow
def test_a_training_resumes_with_the_same_weights_whatever_the_workers(
    packs, tmp_path, caplog
) -> None:
    caplog.set_level("INFO", "packit_agents")
    whole = PlacementTraining(settings_of(packs), tmp_path / "whole")
    seen = []
    with Workers(2) as two:
        whole.run(two, seen.append)
    assert [result.rounds for result in seen] == [1, 2]
    assert [point.steps for point in whole.curve] == [0, 2]
    assert "0 of 2 rounds are done" in caplog.text and "finished in" in caplog.text
    assert f"round 2: validation reward {whole.curve[-1].validation.mean:.3f}" in caplog.text

    class Killed(Exception):
        pass

    def kill(result):
        raise Killed

    with Workers(1) as one:
        with pytest.raises(Killed):
            PlacementTraining(settings_of(packs), tmp_path / "parts").run(one, kill)
        parts = PlacementTraining(settings_of(packs), tmp_path / "parts")
        parts.run(one)
    assert "1 of 2 rounds are done" in caplog.text
    assert parts.curve == whole.curve and parts.best == whole.best
    for name in ("last.safetensors", "best.safetensors"):
        network, other = (PlacementNetwork.read(tmp_path / n / name) for n in ("whole", "parts"))
        assert network.digest == other.digest and network.provenance == other.provenance
    assert network.provenance["rounds"] == whole.best.steps
    assert len(network.provenance["tasks"][packs]) == 2
    task = load_tasks(packs, ShapeLibrary.open("everyday"), "validation")[0]
    assert best_return(task, PACKIT, network) == whole.best.validation.mean
    with pytest.raises(TrainingError, match=r"another settings\.seed"):
        PlacementTraining(settings_of(packs, seed=1), tmp_path / "whole")


@pytest.mark.slow
def test_a_training_by_other_rules_begins_with_weights(packs, tmp_path) -> None:
    file, rules = tmp_path / "first.safetensors", Rules(kinematic=True, buffer=2)
    held_out = load_tasks(packs, ShapeLibrary.open("everyday"), "validation")
    first = first_network(held_out, rules, 4, 3)
    first.write(file)
    settings = settings_of(packs, rules=rules, start=str(file), rounds=1)
    training = PlacementTraining(settings, tmp_path / "online")
    with Workers(1) as one:
        training.run(one)
    assert training.curve[0].validation.mean == best_return(held_out[0], rules, first)
    assert best_return(held_out[0], PACKIT, first) != training.curve[0].validation.mean
    trained = PlacementNetwork.read(tmp_path / "online" / "last.safetensors")
    assert trained.provenance["start"] == first.digest
    assert trained.provenance["settings"]["rules"]["buffer"] == 2
    with pytest.raises(TensorFileError, match="absent"):
        PlacementTraining(replace(settings, start=str(tmp_path / "absent")), tmp_path / "other")


def test_settings_that_are_not_possible_are_named() -> None:
    for wrong, named in (
        ({"packs": ()}, "packs"),
        ({"plays": 1}, "plays = 1"),
        ({"mixed": 2.0}, "mixed = 2"),
        ({"step": StepSettings(epochs=0)}, "epochs = 0"),
        ({"rules": Rules(values=True)}, "by the rules PackIt, values"),
        ({"rules": Rules(physics=PhysicsSettings())}, "by the rules PackIt, physics"),
    ):
        with pytest.raises(ArgumentError, match=named):
            PlacementTrainingSettings(**wrong)


def test_settings_are_recorded_as_json(packs, tmp_path) -> None:
    PlacementTraining(settings_of(packs), tmp_path)
    recorded = json.loads((tmp_path / "settings.json").read_text())
    assert recorded["settings"]["step"]["clip"] == 0.2 and recorded["settings"]["packs"] == [packs]
