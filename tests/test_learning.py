"""PackNN: invariances of its layers, weights as data, and exactly resumable training."""

import hashlib
import json
import pickle
import re
import resource
import signal
import struct
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("sb3_contrib", reason="sb3-contrib comes with the extra learn")

import torch
from msgspec import structs
from safetensors import safe_open
from safetensors.torch import save
from sb3_contrib.common.maskable.distributions import MaskableCategoricalDistribution
from stable_baselines3.common.logger import KVWriter
from trimesh import creation

from campaigns import injector
from packit_agents.learning import loggers, training
from packit_agents.learning.augmentation import AugmentedEnv, transformed
from packit_agents.learning.heads import LocationHead, RotationHead
from packit_agents.learning.imitation import IMPOSSIBLE, LABEL, SMALLER, ImitationPPO, LabellingEnv
from packit_agents.learning.learned_policies import FIELDS, LearnedShape, log_probabilities, masked
from packit_agents.learning.mixing import Mixture
from packit_agents.learning.networks import NETWORKS, AllPolicies, NetworkSettings, network
from packit_agents.learning.run_folder import TrainingError
from packit_agents.learning.training import Training
from packit_agents.learning.training_settings import TrainingSettings, read_settings
from packit_agents.learning.weights import WeightsError, read_weights, weights_digest, write_weights
from packit_sim import placement
from packit_sim.core.errors import ArgumentError
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.pack_files import load_tasks, write_packs
from packit_sim.game.datasets.packs import ItemRecord, LibraryRef, Pack
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.features import CubeMeans
from packit_sim.game.envs.observations import PLACEMENT_FEATURES
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Episode, Stage
from packit_sim.game.episodes.policy_registry import UnknownPolicyError, load_policy
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.game.evaluation.learning_curves import TrainingRecord
from packit_sim.game.evaluation.results import ResultsError, Rollout, read_results, write_results
from packit_sim.geometry import rotations
from packit_sim.geometry.lattice import BOX_CELLS, Triple
from packit_sim.geometry.rotations import turn_array
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary
from packit_sim.physics.settings import PhysicsSettings
from packit_sim.rules import End, Rules
from tests.zoo import cube_of

SMALL = NetworkSettings(width=16, encoder_blocks=1, trunk_blocks=2)


def seen(
    batch: int, slots: int, seed: int = 0, placement_features: bool = True
) -> dict[str, torch.Tensor]:
    drawn = torch.Generator().manual_seed(seed)
    outside = torch.rand(batch, slots, generator=drawn) < 0.6
    outside[:, 0] = True
    fields = {
        "shapes": torch.rand(batch, slots, 8, 8, 8, generator=drawn),
        "box": torch.rand(batch, 10, 10, 10, generator=drawn),
        "outside": outside,
    }
    if placement_features:
        fields["placement_features"] = torch.rand(batch, slots, PLACEMENT_FEATURES, generator=drawn)
    return fields


def build(
    name: str, *, value: bool = False, placement_features: int = PLACEMENT_FEATURES
) -> torch.nn.Module:
    torch.manual_seed(3)
    settings = NetworkSettings(name, *(16, 1, 2))  # type: ignore[arg-type]
    return network(settings, placement_features, value=value).double()


def doubled(fields: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {
        name: field if field.dtype == torch.bool else field.double()
        for name, field in fields.items()
    }


@pytest.mark.parametrize("name", NETWORKS)
def test_the_order_of_shapes_changes_nothing(name) -> None:
    fields = doubled(seen(3, 7))
    order = torch.randperm(7, generator=torch.Generator().manual_seed(1))
    turned = {key: field if key == "box" else field[:, order] for key, field in fields.items()}
    logits, again = (masked(build(name)(f), f["outside"]) for f in (fields, turned))
    torch.testing.assert_close(again, logits[:, order])
    torch.testing.assert_close(build(name, value=True)(turned), build(name, value=True)(fields))


@pytest.mark.parametrize("name", NETWORKS)
def test_padding_and_shapes_that_are_inside_change_nothing(name) -> None:
    fields = doubled(seen(2, 5))
    wider = doubled(seen(2, 9, seed=8))
    for key, field in fields.items():
        if key == "box":
            wider[key] = field
        else:
            wider[key][:, :5] = field
    wider["outside"][:, 5:] = False
    inside = ~fields["outside"]
    other = {key: field.clone() for key, field in fields.items()}
    other["shapes"][inside] = 0.123
    expected = masked(build(name)(fields), fields["outside"])
    found = masked(build(name)(wider), wider["outside"])
    torch.testing.assert_close(found[:, :5], expected)
    assert torch.isneginf(found[:, 5:]).all()
    torch.testing.assert_close(masked(build(name)(other), other["outside"]), expected)
    value = build(name, value=True)
    assert value(fields).shape == (2, 1)
    torch.testing.assert_close(value(wider), value(fields))


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("value", [False, True])
def test_a_gradient_reaches_every_parameter(name, value) -> None:
    net = build(name, value=value)
    fields = doubled(seen(4, 6))
    found = net(fields) if value else net(fields)[fields["outside"]]
    (found**2).sum().backward()
    for key, parameter in net.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, key


def test_masked_shapes_have_probability_0() -> None:
    fields = seen(5, 6)
    arrays = {name: field.numpy() for name, field in fields.items()}
    found = np.exp(log_probabilities(build("packnn").float(), arrays, arrays["outside"]))
    assert (found[~fields["outside"].numpy()] == 0).all()
    assert np.allclose(found.sum(1), 1)


def test_networks_see_placement_features_only_where_they_are_observed() -> None:
    plain = build("packnn", placement_features=0)
    assert plain(doubled(seen(1, 4, placement_features=False))).shape == (1, 4)


def everything(batch: int, slots: int) -> dict[str, torch.Tensor]:
    """What networks see that choose rotations and locations too, at all three stages."""
    drawn = torch.Generator().manual_seed(5)
    return {
        **seen(batch, slots, placement_features=False),
        "stage": torch.arange(batch) % len(Stage),
        "chosen": torch.zeros(batch, dtype=torch.int64),
        "item": torch.rand(batch, 8, 8, 8, generator=drawn),
    }


def test_heads_for_all_policies_answer_at_their_stage_alone() -> None:
    torch.manual_seed(3)
    net = network(replace(SMALL, policies="all"), 0)
    assert isinstance(net, AllPolicies)
    fields = everything(6, 5)
    logits = net(fields)
    assert logits.shape == (6, 25**3)
    for row, (stage, actions) in enumerate([(0, 5), (1, 24), (2, 25**3)] * 2):
        assert fields["stage"][row] == stage
        chosen = logits[row].abs() > 0
        assert not chosen[actions:].any() and chosen[:actions].sum() > actions / 3
        alone = net({name: field[row : row + 1] for name, field in fields.items()})
        torch.testing.assert_close(alone[0], logits[row])
    (logits**2).sum().backward()
    for key, parameter in net.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0, key


def test_the_head_for_rotations_sees_the_shape_turned(library) -> None:
    """Exactly, where it is in the middle of all cubes, which are of 13 cells an axis here."""
    items = (Item(library[name], 0.3) for name in library)
    item = next(each for each in items if not any(count % 2 for count in each.cells))
    means = CubeMeans((104, 104, 104), 8)
    head = RotationHead(16, 1, 1)
    upright = torch.from_numpy(means.of_item(item).copy())
    for rotation in range(24):
        turned = means.of_item(item.turned(rotation))
        np.testing.assert_allclose(upright.flatten()[head.rotated[rotation]], turned.ravel())
    box = torch.rand(1, 10, 10, 10)
    plain = head(upright[None], box)[0]
    again = torch.from_numpy(turn_array(upright.numpy(), 7).copy())
    assert sorted(head(again[None], box)[0].tolist()) == pytest.approx(sorted(plain.tolist()))


def test_the_head_for_locations_can_say_bottom_left_back_fill() -> None:
    """Its functions of x, y and z alone suffice for the order by z, then x, then y."""
    head = LocationHead(25, 16, 1, 1)
    wanted = torch.zeros(3, 9, 25)
    wanted[:, 0] = -torch.arange(25) * torch.tensor([[25.0], [1.0], [625.0]])
    with torch.no_grad():
        head.head.weight.zero_()
        head.head.bias.copy_(wanted.flatten())
    logits = head(torch.rand(2, 8, 8, 8), torch.rand(2, 10, 10, 10))[1].reshape(25, 25, 25)
    rng = np.random.default_rng(0)
    for _ in range(20):
        mask = rng.random((25, 25, 25)) < 0.001
        best = np.where(mask, logits.detach().numpy(), -np.inf).argmax()
        assert np.unravel_index(best, mask.shape) == placement.first(mask)


@pytest.mark.parametrize(
    "wrong",
    [
        {"network": "packer"},
        {"network": "packnn-attention"},
        {"policies": "location"},
        {"width": 0},
        {"trunk_blocks": -1},
    ],
)
def test_network_settings_out_of_range_are_named(wrong) -> None:
    with pytest.raises(ValueError, match="network setting"):
        NetworkSettings(**wrong)


@pytest.fixture(scope="module")
def library() -> ShapeLibrary:
    return ShapeLibrary.open("everyday")


@pytest.mark.parametrize(
    ("rule", "count"),
    [
        (None, 1),
        pytest.param(None, 2, marks=pytest.mark.slow),
        pytest.param("kinematic", 1, marks=pytest.mark.slow),
        pytest.param("easy", 1, marks=pytest.mark.slow),
        pytest.param("kinematic", 2, marks=pytest.mark.slow),
        pytest.param("easy", 2, marks=pytest.mark.slow),
    ],
)
def test_placement_features_are_what_the_box_says(library, rule, count) -> None:
    tasks = load_tasks("starter", library)[:count]
    env = PackItEnv(
        tasks,
        rotation="aligned",
        location="blbf",
        observation="placement-features",
        max_shapes=40,
        **({rule: True} if rule else {}),
    )
    rng = np.random.default_rng(4)
    fits: set[bool] = set()
    for task in range(count):
        observed, _ = env.reset(options={"task": task})
        states = []
        for step in range(40):
            if env.episode.end is not None:
                break
            states.append(env.get_state())
            if step == 5:  # back to where the box was emptier, and on another way
                observed, _ = env.set_state(states[2])
            assert observed in env.observation_space
            for n, values in enumerate(observed["placement_features"]):
                if rule and n % 4:
                    continue  # masks take long there
                if not observed["outside"][n]:
                    assert not values.any()
                    continue
                item, box = env.episode.task.items[n], env.episode.box
                in_turn = [item.turned(r) for r in rotations.by_alignment(item.extents)]
                if rule != "easy":
                    in_turn = in_turn[:1]
                elif not box.feasible_in_any(item).any():
                    assert not values[0]
                found = ((turned, box.blbf(turned)) for turned in in_turn)
                item, location = next((pair for pair in found if pair[1]), (in_turn[0], None))
                fits.add(location is not None)
                assert values[0] == (location is not None)
                assert np.allclose(values[1:4] * 25, location or (0, 0, 0))
                assert np.allclose(values[4:7], item.extents)
                assert values[7] == pytest.approx(item.volume, rel=1e-5)
            outside = np.flatnonzero(observed["outside"])
            smallest = min(outside, key=lambda n: env.episode.task.items[n].volume)
            observed, *_ = env.step(smallest if rule == "easy" else rng.choice(outside))
    assert fits == {False, True}


def weights(path: Path, placement_features: int = 0) -> Path:
    torch.manual_seed(1)
    write_weights(path, network(SMALL, placement_features), SMALL, placement_features, {"seed": 1})
    return path


@pytest.mark.parametrize("placement_features", [0, PLACEMENT_FEATURES])
def test_an_agent_plays_with_weights_from_a_file(library, tmp_path, placement_features) -> None:
    file = weights(tmp_path / "w.safetensors", placement_features)
    net, read, how = read_weights(file)
    assert (read, how) == (placement_features, {"seed": 1})
    expected = network(SMALL, placement_features)
    torch.manual_seed(1)
    for a, b in zip(net.parameters(), network(SMALL, placement_features).parameters(), strict=True):
        assert torch.equal(a, b)
    assert [p.shape for p in net.parameters()] == [p.shape for p in expected.parameters()]
    tasks = load_tasks("starter", library)[:2]
    agent = Agent.from_name(f"learned@{file}/aligned/blbf")
    beams = Agent.from_name(f"learned@{file}/aligned/blbf+beam=2")
    found = evaluate([agent, beams], tasks, seed=0)
    other_seed = evaluate([agent, beams], tasks, seed=9)
    assert [r.total for r in found] == [r.total for r in other_seed]
    again = pickle.loads(pickle.dumps(agent))
    assert evaluate([again], tasks, seed=0) == found[:2]


@pytest.mark.slow
def test_results_tell_the_weights_and_are_not_taken_for_those_of_others(library, tmp_path) -> None:
    """The file of weights is written anew: between two evaluations, and during one."""
    file, results = weights(tmp_path / "w.safetensors"), tmp_path / "results.jsonl"
    name = f"learned@{file}/aligned/blbf"
    tasks = load_tasks("starter", library)[:2]
    found = evaluate([Agent.from_name(name)], tasks[:1], seed=0, file=results)
    digest = weights_digest(read_weights(file)[0])
    assert found[0].weights == read_results(results)[0].weights == digest
    assert Agent.from_name("random/aligned/blbf").weights is None
    before = results.read_bytes()
    older = Agent.from_name(name)
    write_weights(file, network(SMALL, 0), SMALL, 0, {"seed": 2})
    with pytest.raises(ResultsError, match=f"with weights of {re.escape(name)} {digest}, not"):
        evaluate([Agent.from_name(name)], tasks, seed=0, file=results)
    with pytest.raises(ResultsError, match="changed during the evaluation"):
        evaluate([older], tasks, seed=0, workers=Workers(2), file=results)
    assert results.read_bytes() == before


def test_the_same_tensors_are_the_same_weights(library, tmp_path) -> None:
    """Whatever the order of a file's metadata; former versions recorded the digest of the file."""
    file, results = weights(tmp_path / "w.safetensors"), tmp_path / "results.jsonl"
    name = f"learned@{file}/aligned/blbf"
    tasks = load_tasks("starter", library)[:2]
    found = evaluate([Agent.from_name(name)], tasks[:1], seed=0, file=results)
    of_file = hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    former = replace(found[0].pack, provenance=structs.replace(found[0].played, weights=of_file))
    write_results(results, [Rollout(former)])
    both = evaluate([Agent.from_name(name)], tasks, seed=0, file=results)
    assert [rollout.weights for rollout in both] == [of_file, found[0].weights]
    with safe_open(file, framework="pt") as opened:
        metadata = opened.metadata()
        tensors = {key: opened.get_tensor(key) for key in opened.keys()}  # noqa: SIM118
    file.write_bytes(save(tensors, {**metadata, "provenance": '{"seed": 2}'}))
    results.unlink()
    assert evaluate([Agent.from_name(name)], tasks[:1], seed=0, file=results) == found


@pytest.mark.slow
def test_an_agent_whose_policies_are_all_learned_plays_by_its_weights(library, tmp_path) -> None:
    settings = replace(SMALL, policies="all")
    torch.manual_seed(1)
    net, file = network(settings, 0), tmp_path / "w.safetensors"
    write_weights(file, net, settings, 0, {})
    agent = Agent.from_name("/".join([f"learned@{file}"] * 3))
    (task,) = load_tasks("starter", library)[:1]
    for easy in (False, True):
        episode = Episode(task, Rules(easy=easy))
        agent.play(episode, np.random.default_rng(0))
        assert episode.end is not End.INVALID_ACTION and episode.box.placed
        env = PackItEnv([task], observation="features", easy=easy)
        observed, _ = env.reset()
        while env.episode.end is None:
            tensors = {name: torch.as_tensor(observed[name])[None] for name in FIELDS[:3]}
            tensors |= {name: torch.as_tensor(observed[name])[None] for name in FIELDS[4:]}
            valid = torch.as_tensor(observed["action_mask"])
            observed, *_ = env.step(int(masked(net(tensors), valid[None]).argmax()))
        assert env.episode.box.placed == episode.box.placed
    small = Episode(replace(task, pack=replace(task.pack, cells=(80, 80, 80))))
    with pytest.raises(WeightsError, match=r"plays in boxes of \(100, 100, 100\) cells, not \(80"):
        agent.play(small, np.random.default_rng(0))
    shapes_only = weights(tmp_path / "shapes.safetensors")
    with pytest.raises(WeightsError, match=r"shapes\.safetensors chooses shapes, not rotations"):
        Agent.from_name(f"learned@{shapes_only}/learned@{shapes_only}/blbf")


def header(file: Path, **changes: str) -> None:
    """Write other metadata into a file of weights."""
    data = file.read_bytes()
    (size,) = struct.unpack("<Q", data[:8])
    entries = json.loads(data[8 : 8 + size])
    entries["__metadata__"].update(changes)
    text = json.dumps(entries).encode()
    file.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + size :])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: f.unlink(), "no weights at"),
        (lambda f: f.write_bytes(b""), "holds no weights, or is damaged"),
        (lambda f: f.write_bytes(f.read_bytes()[:-7]), "holds no weights, or is damaged"),
        (lambda f: f.write_bytes(b"\x80\x04cos\nsystem\n"), "holds no weights, or is damaged"),
        (lambda f: header(f, version="3"), "version '3'"),
        (lambda f: header(f, format="other"), "of format 'other'"),
        (lambda f: header(f, network='{"width": 32}'), "contradicts its own metadata"),
        (lambda f: header(f, network='{"depth": 3}'), "contradicts its own metadata"),
        (lambda f: header(f, placement_features="8"), "contradicts its own metadata"),
        (lambda f: header(f, placement_features="9" * 30), "contradicts its own metadata"),
        (
            lambda f: header(f, network=json.dumps(asdict(SMALL) | {"width": 20000})),
            "has the shape .*, not .*20000",
        ),
        (lambda f: header(f, network='{"width": 1' + "0" * 400 + "}"), "contradicts its own"),
        (lambda f: header(f, network='{"trunk_blocks": 1e9}'), "blocks have more than .* tensors"),
        (lambda f: header(f, network='{"trunk_blocks": 5}'), "tensor .* is missing"),
        (lambda f: header(f, network="[" * 10**5), "contradicts its own metadata"),
    ],
)
def test_weights_that_are_wrong_or_damaged_are_named(tmp_path, damage, message) -> None:
    file = weights(tmp_path / "w.safetensors")
    damage(file)
    with pytest.raises(WeightsError, match=rf"w\.safetensors.*{message}|{message}.*w\.safetensors"):
        LearnedShape(file)


def test_weights_of_version_1_are_read(tmp_path) -> None:
    old, new = weights(tmp_path / "old.safetensors"), weights(tmp_path / "new.safetensors")
    made = {
        "version": "0.1.0",
        "settings": {"observation": "prospects", "easy": True, "regrets": True, "steps": 7},
    }
    header(old, version="1", made=json.dumps(made), prospects="0")
    data = old.read_bytes()
    for name in (b"provenance", b"placement_features"):  # unknown to version 1
        data = data.replace(b'"' + name + b'"', b'"' + b"_" * len(name) + b'"')
    old.write_bytes(data)
    (net, features, provenance), (same, *_) = read_weights(old), read_weights(new)
    assert features == 0 and provenance["version"] == "0.1.0"
    assert provenance["settings"] == {
        "observation": "placement-features",
        "rules": asdict(Rules(easy=True)),
        "costs": True,
        "steps": 7,
    }
    for ours, theirs in zip(net.parameters(), same.parameters(), strict=True):
        assert torch.equal(ours, theirs)


def test_weights_that_are_not_finite_are_named(tmp_path) -> None:
    net = network(SMALL, 0)
    with torch.no_grad():
        next(net.parameters())[0, 0] = torch.nan
    write_weights(tmp_path / "w.safetensors", net, SMALL, 0, {})
    with pytest.raises(WeightsError, match="not finite"):
        LearnedShape(tmp_path / "w.safetensors")


def test_policies_say_whether_they_take_a_value() -> None:
    with pytest.raises(UnknownPolicyError, match="'learned' is not of the form learned@VALUE"):
        Agent.from_name("learned/aligned/blbf")
    with pytest.raises(UnknownPolicyError, match="'largest-first@3' is not of the form largest-fi"):
        Agent.from_name("largest-first@3/aligned/blbf")


def test_settings_from_a_file_and_from_the_command_line(tmp_path) -> None:
    file = tmp_path / "run.toml"
    file.write_text('steps = 500\nsplit = "test"\ngamma = 1\n[network]\nwidth = 64\n')
    found = read_settings(
        file, ["steps=600", "network.trunk_blocks=2", "split=none", "annealed=false"]
    )
    assert found == TrainingSettings(
        steps=600, split=None, annealed=False, network=NetworkSettings(width=64, trunk_blocks=2)
    )
    file.write_text("[rules]\ncells = [80, 80, 60]\n[rules.physics]\nfriction = 0.7\n")
    expected = Rules(easy=True, physics=PhysicsSettings(friction=0.7), cells=(80, 80, 60))
    assert read_settings(file, ["rules.easy=true"]).rules == expected
    assert read_settings(None, ["rules.physics=true"]).rules == Rules(physics=PhysicsSettings())
    for change, message in (
        ("stps=3", "no setting 'stps': choose from network, observation, augmented, mixed"),
        ("steps", "'steps' is not a setting: give NAME=VALUE"),
        ("steps=1.5", "field 'steps' is 1.5: expected int, got float"),
        ("steps=0", "training setting steps = 0 is not possible: at least 1"),
        ("gamma=2", "training setting gamma = 2.0 is not possible: 0 to 1"),
        ("network.width=0", "network setting width = 0 is not possible: at least 1"),
        ("rules.easy=1", "field 'easy' is 1: expected bool, got int"),
        (
            "observation=voxels",
            "field 'observation' is 'voxels': choose from features, placement-features",
        ),
        (
            "network.network=mlp",
            "field 'network.network' is 'mlp': choose from packnn",
        ),
        ("packs=fresh", "validation_packs = None is not possible: fresh tasks need it"),
    ):
        with pytest.raises(ArgumentError, match=message):
            read_settings(None, [change])
    file.write_text("steps = \n")
    with pytest.raises(ArgumentError, match=r"can't be read from .*run\.toml"):
        read_settings(file, [])


TINY = TrainingSettings(
    network=SMALL,
    packs="starter",
    split=None,
    validation=None,
    steps=192,
    envs=2,
    rollout_steps=16,
    minibatch=16,
    epochs=2,
    validate_every=64,
    validation_tasks=2,
)


@pytest.fixture(scope="module")
def short_packs(library, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write three tasks of four items each, so that episodes are short."""
    path = tmp_path_factory.mktemp("short") / "packs.jsonl"
    ids, ref = library.ids, LibraryRef.of(library)
    scales = (0.02, 0.05, 0.1, 0.2)
    items = [ItemRecord(shape, scales[n % 4]) for n, shape in enumerate(ids[:: len(ids) // 12])]
    write_packs(
        path, [Pack(ref, BOX_CELLS, (), 0.0, outside=tuple(items[n : n + 4])) for n in (0, 4, 8)]
    )
    return path


class Killed(Exception):
    """What ends a training at once."""


def weights_of(folder: Path) -> dict[str, torch.Tensor]:
    return dict(read_weights(folder / "last.safetensors")[0].state_dict())


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"observation": "features"}, marks=pytest.mark.slow),
        pytest.param(
            {"observation": "placement-features", "augmented": True}, marks=pytest.mark.slow
        ),
        pytest.param(
            {"teacher": "largest-fitting-first/aligned/blbf", "imitation": 64},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"teacher": "largest-fitting-first/aligned/blbf", "imitation": 128},
            marks=pytest.mark.slow,
        ),
        {
            "teacher": "largest-fitting-first/aligned/blbf",
            "imitation": 128,
            "costs": True,
            "mixed": 0.5,
        },
        {"network": replace(SMALL, policies="all")},
    ],
)
def test_a_training_that_was_killed_resumes_exactly(
    short_packs, tmp_path, monkeypatch, change
) -> None:
    settings = replace(TINY, packs=str(short_packs), **change)
    whole = Training(settings, tmp_path / "whole", "cpu")
    whole.run()
    assert [point.steps for point in whole.curve] == [0, 64, 128, 192]
    monkeypatch.setattr(training, "CHECKPOINT_SECONDS", 0.0)

    def kill(at: training.Progress) -> None:
        if at.steps >= 96 and not killed:
            killed.append(at.steps)
            raise Killed

    killed: list[int] = []
    with pytest.raises(Killed):
        Training(settings, tmp_path / "parts", "cpu").run(kill)
    torch.manual_seed(99)  # as in a new process
    np.random.seed(99)  # noqa: NPY002
    parts = Training(settings, tmp_path / "parts", "cpu")
    assert parts.steps == 96
    parts.run()
    assert parts.curve == whole.curve
    read = TrainingRecord.read(tmp_path / "parts")
    assert read.curve == tuple(whole.curve) and read.settings["network.width"] == SMALL.width
    ours, theirs = weights_of(tmp_path / "whole"), weights_of(tmp_path / "parts")
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[key], theirs[key]) for key in ours)
    again = Training(settings, tmp_path / "parts", "cpu")
    before = (tmp_path / "parts" / "checkpoint.pt").read_bytes()
    again.run()
    assert (tmp_path / "parts" / "checkpoint.pt").read_bytes() == before
    changed = replace(settings, entropy=0.5, network=NetworkSettings())
    with pytest.raises(TrainingError, match=r"network\.width, .*, settings\.entropy"):
        Training(changed, tmp_path / "parts", "cpu")
    (tmp_path / "parts" / "checkpoint.pt").write_bytes(b"torn")
    with pytest.raises(ValueError, match=r"checkpoint\.pt is not a checkpoint, or is damaged"):
        Training(settings, tmp_path / "parts", "cpu")


@pytest.mark.slow
def test_labelled_states_are_kept_until_a_checkpoint_needs_none(
    short_packs, tmp_path, monkeypatch
) -> None:
    settings = replace(
        TINY, packs=str(short_packs), teacher="largest-fitting-first/aligned/blbf", imitation=96
    )
    whole = Training(settings, tmp_path / "whole", "cpu")
    whole.run()
    write = Training.write

    def kill(self: Training) -> None:
        if self.steps >= 128:
            raise Killed
        write(self)

    monkeypatch.setattr(Training, "write", kill)
    with pytest.raises(Killed):
        Training(settings, tmp_path / "parts", "cpu").run()
    monkeypatch.setattr(Training, "write", write)
    parts = Training(settings, tmp_path / "parts", "cpu")
    assert parts.steps == 64
    parts.run()
    assert parts.curve == whole.curve and not (tmp_path / "parts" / "dagger_dataset").exists()
    ours, theirs = weights_of(tmp_path / "whole"), weights_of(tmp_path / "parts")
    assert all(torch.equal(ours[key], theirs[key]) for key in ours)


class Noted(KVWriter):
    """A logger that notes what it gets."""

    def __init__(self, folder: Path, settings: dict) -> None:
        self.seen, self.closed, self.settings = [], False, settings
        NOTED.append(self)

    def write(self, key_values, key_excluded, step=0) -> None:
        self.seen.append((step, dict(key_values)))

    def close(self) -> None:
        self.closed = True


NOTED: list[Noted] = []


@pytest.mark.slow
def test_loggers_of_other_packages_get_what_tensorboard_gets(
    short_packs, tmp_path, monkeypatch
) -> None:
    found = {"noted": SimpleNamespace(load=lambda: Noted)}
    monkeypatch.setattr(loggers, "announced", lambda group: found)
    settings = replace(TINY, packs=str(short_packs), steps=32, validate_every=32)
    training = Training(settings, tmp_path / "run", "cpu", loggers=["noted"])
    training.run()
    training.close()
    (noted,) = NOTED
    assert noted.closed and noted.settings["network"]["width"] == SMALL.width
    step, last = noted.seen[-1]
    assert (step, last["validation/return"]) == (32, training.curve[-1].validation.mean)
    with pytest.raises(ArgumentError, match="there is no logger 'wandb': installed are noted"):
        Training(settings, tmp_path / "other", "cpu", loggers=["wandb"])
    assert not (tmp_path / "other").exists()


def test_a_checkpoint_that_does_not_fit_on_the_disk_is_an_error_of_the_system(
    short_packs, tmp_path
) -> None:
    done = Training(replace(TINY, packs=str(short_packs)), tmp_path / "run", "cpu")

    def write() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        with pytest.raises(OSError, match="File too large"):
            done.write()

    assert injector.fork(write, tmp_path, fault="none") == 0


def cubes(folder: Path, sides: Sequence[int], cells: Triple) -> TrainingSettings:
    """Settings of a short training on a single task of cubes."""
    creation.box((1, 1, 1)).export(folder / "cube.stl")
    items = tuple(ItemRecord("cube", cube_of(side).scale) for side in sides)
    pack = Pack(LibraryRef.of(ShapeLibrary.open(folder)), cells, (), 0.0, outside=items)
    write_packs(folder / "cubes.jsonl", [pack])
    return replace(
        TINY,
        packs=str(folder / "cubes.jsonl"),
        library=str(folder),
        learning_rate=3e-3,
        envs=8,
        rollout_steps=16,
        minibatch=32,
        epochs=4,
        steps=1024,
        validate_every=1024,
    )


@pytest.mark.parametrize("name", NETWORKS)
def test_a_toy_task_is_learned_to_the_optimum(tmp_path, name) -> None:
    """The trap of the searches: the largest cube must wait, or the other two do not fit."""
    settings = cubes(tmp_path, (60, 52, 48), (100, 60, 60))
    settings = replace(settings, network=replace(SMALL, network=name))
    done = Training(settings, tmp_path / "run", "cpu")
    done.run()
    both_others = (52**3 + 48**3) / (60**3 + 52**3 + 48**3)
    assert done.curve[-1].validation.mean == pytest.approx(both_others)


@pytest.mark.slow
def test_a_teacher_is_imitated_against_the_reward(tmp_path) -> None:
    """The box has space for the largest cube alone, or for a smaller one alone."""
    settings = cubes(tmp_path, (20, 44, 60), (60, 60, 60))
    taught = replace(settings, teacher="smallest-first/aligned/blbf", imitation=1024)
    for how, first in ((taught, 0), (settings, 2)):
        folder = tmp_path / f"run-{first}"
        done = Training(how, folder, "cpu")
        done.run()
        (task,) = load_tasks(how.packs, ShapeLibrary.open(how.library))
        policy = LearnedShape(folder / "last.safetensors")
        assert policy(Episode(task), np.random.default_rng(0)) == first


@pytest.mark.slow
def test_an_agent_for_all_policies_imitates_the_heuristic(tmp_path) -> None:
    """Three cubes that fill the box to 3/4, where they are put side by side in the corners."""
    settings = cubes(tmp_path, (48, 48, 48), BOX_CELLS)
    settings = replace(
        settings,
        network=replace(SMALL, policies="all"),
        teacher="largest-first/aligned/blbf",
        imitation=4096,
        steps=4096,
        validate_every=4096,
    )
    done = Training(settings, tmp_path / "run", "cpu")
    done.run()
    assert done.curve[-1].validation.mean == pytest.approx(1)
    agent = Agent.from_name("/".join([f"learned@{tmp_path / 'run' / 'last.safetensors'}"] * 3))
    (task,) = load_tasks(settings.packs, ShapeLibrary.open(settings.library))
    episode = Episode(task)
    agent.play(episode, np.random.default_rng(0))
    assert [placed.location for placed in episode.box.placed] == [(0, 0, 0), (0, 12, 0), (12, 0, 0)]


def test_labels_are_the_choices_of_the_teacher(library) -> None:
    teacher = load_policy(Stage.SHAPE, "largest-first")
    plain = PackItEnv("starter", rotation="aligned", location="blbf", observation="features")
    env = LabellingEnv(plain, "largest-first/aligned/blbf")
    seen, _ = env.reset(seed=0)
    chosen = []
    for number in range(8):
        assert seen in env.observation_space
        chosen.append(teacher(plain.episode, np.random.default_rng(0)))
        assert seen[LABEL] == [chosen[-1]]
        seen, *_ = env.step(int(np.flatnonzero(seen["outside"])[number % 2]))
    assert len(set(chosen)) > 1
    env.labelling = False
    seen, _ = env.reset(seed=0)
    assert seen[LABEL] == [0] != chosen[:1]


def test_the_learning_rate_falls_to_that_of_ppo_and_then_to_0() -> None:
    settings = TrainingSettings(
        steps=100,
        teacher="largest-first/aligned/blbf",
        imitation=20,
        imitation_rate=0.5,
        learning_rate=0.1,
    )
    rates = [settings.rate(left) for left in (1.0, 0.9, 0.8, 0.4, 0.0)]
    assert rates == pytest.approx([0.5, 0.3, 0.1, 0.05, 0.0])
    kept = replace(settings, annealed=False)
    assert [kept.rate(left) for left in (0.8, 0.4, 0.0)] == pytest.approx([0.1] * 3)
    alone = replace(settings, teacher=None, imitation=0)
    assert [alone.rate(left) for left in (1.0, 0.25)] == pytest.approx([0.1, 0.025])
    assert replace(settings, imitation=100).rate(0.0) == pytest.approx(0.1)


def test_each_pose_is_another_and_the_first_is_its_own() -> None:
    cubes = np.random.default_rng(0).random((2, 2, 2), dtype=np.float32)
    poses = [transformed(cubes, pose) for pose in range(48)]
    np.testing.assert_array_equal(poses[0], cubes)
    assert len({pose.tobytes() for pose in poses}) == 48
    assert all(sorted(pose.ravel()) == sorted(cubes.ravel()) for pose in poses)


def test_augmented_shapes_are_turned_once_an_episode_and_nothing_else_is(library) -> None:
    rules = {"rotation": "aligned", "location": "blbf", "observation": "features"}
    plain, env = PackItEnv("starter", **rules), AugmentedEnv(PackItEnv("starter", **rules))
    kept = []
    for seed in (0, 0, 1):
        seen, _ = env.reset(seed=seed, options={"task": 0})
        own, _ = plain.reset(options={"task": 0})
        shape = own["shapes"][0]
        shown = seen["shapes"][0]
        kept.append(next(k for k in range(48) if (transformed(shape, k) == shown).all()))
        later, *_ = env.step(int(np.flatnonzero(seen["outside"])[0]))
        np.testing.assert_array_equal(later["shapes"], seen["shapes"])
        assert all(np.array_equal(seen[name], own[name]) for name in seen if name != "shapes")
        assert seen in env.observation_space
    assert kept[0] == kept[1] != kept[2]


def test_mixed_tasks_are_of_two(library) -> None:
    tasks = load_tasks("starter", library)
    mixture = Mixture(tasks, library, share=0.5)
    rng = np.random.default_rng(0)
    mixed_tasks = [mixture(rng) for _ in range(40)]
    known = {task.digest: task for task in tasks}
    mixed = [task for task in mixed_tasks if task.digest not in known]
    assert 8 < len(mixed) < 32
    of = {(item.shape.id, item.scale) for task in tasks for item in task.items}
    for task in mixed:
        assert {(item.shape.id, item.scale) for item in task.items} <= of
        assert task.cells == tasks[0].cells and not task.solution
    assert np.mean([len(t.items) for t in mixed_tasks]) == pytest.approx(
        np.mean([len(t.items) for t in tasks]), rel=0.2
    )
    again = np.random.default_rng(0)
    assert [mixture(again).digest for _ in mixed_tasks] == [task.digest for task in mixed_tasks]


def test_shapes_are_not_turned_where_rotations_are_learned() -> None:
    with pytest.raises(
        ArgumentError, match="training setting augmented = True is not possible: only"
    ):
        read_settings(None, ["augmented=true", "network.policies=all"])


@pytest.mark.parametrize("easy", [False, True])
def test_costs_are_lowest_for_the_teachers_choice_and_highest_for_what_does_not_fit(
    easy,
) -> None:
    rules = {"rotation": "aligned", "location": "blbf", "easy": easy}
    rules["observation"] = "placement-features"
    plain = PackItEnv("starter", **rules)
    env = LabellingEnv(plain, "largest-fitting-first/aligned/blbf", costs=True)
    teacher = load_policy(Stage.SHAPE, "largest-fitting-first")
    seen, _ = env.reset(seed=0)
    over, without_room = False, 0
    while not over:
        assert seen in env.observation_space
        label, outside = seen[LABEL], seen["outside"] > 0
        fitting = seen["placement_features"][:, 0] > 0
        volumes = np.array([item.volume for item in plain.episode.task.items])
        best = teacher(plain.episode, np.random.default_rng(0))
        assert label[best] == 0 and (label[~outside] == IMPOSSIBLE).all()
        without = outside & ~fitting
        without[best] = False
        assert (label[without] == 1).all() and (label[outside & fitting] <= SMALLER).all()
        fits = np.flatnonzero(outside & fitting)
        if fitting[best]:
            expected = SMALLER * (1 - volumes[fits] / volumes[best])
            np.testing.assert_allclose(label[fits], expected, atol=1e-6)
        without_room += int(without.sum())
        smallest = min(np.flatnonzero(outside), key=volumes.__getitem__)
        seen, _, over, *_ = env.step(smallest if easy else best)
    assert without_room > 0 and not seen[LABEL].any()


def test_with_costs_a_safe_choice_is_preferred_to_a_gamble() -> None:
    """Two shapes fit one time in two, a small one always: learning choices alone would gamble."""
    model = ImitationPPO.__new__(ImitationPPO)
    model.imitation, model.num_timesteps = 100, 100
    logits = torch.zeros(1, 3, requires_grad=True)
    dataset = torch.tensor([[0.0, 1.0, 0.1], [1.0, 0.0, 0.1]])
    for _ in range(300):
        loss = model.imitation_loss(_distribution(logits.expand(2, 3)), dataset)
        (gradient,) = torch.autograd.grad(loss, logits)
        logits = (logits - gradient).detach().requires_grad_()
    assert logits.argmax() == 2
    model.num_timesteps = 0
    choices = torch.nn.functional.cross_entropy(logits.expand(2, 3), torch.tensor([0, 1]))
    assert model.imitation_loss(_distribution(logits.expand(2, 3)), dataset) == choices


def _distribution(logits: torch.Tensor) -> MaskableCategoricalDistribution:
    distribution = MaskableCategoricalDistribution(logits.shape[1])
    return distribution.proba_distribution(logits)


@pytest.mark.parametrize("change", ["network.policies=all", "teacher=none imitation=0"])
def test_costs_need_shapes_and_a_teacher(change) -> None:
    taught = "teacher=largest-first/aligned/blbf imitation=64 costs=true"
    with pytest.raises(ArgumentError, match="training setting costs = True is not possible: only"):
        read_settings(None, f"{taught} {change}".split())


@pytest.mark.parametrize(
    "wrong", ["teacher=largest-first", "imitation=64", "teacher=largest-first imitation=999999"]
)
def test_a_teacher_and_how_long_it_teaches_belong_together(wrong) -> None:
    with pytest.raises(ArgumentError, match=r"training setting (teacher|imitation) = .* is not"):
        read_settings(None, wrong.split())


@pytest.mark.slow
def test_a_short_training_beats_chance(library, tmp_path) -> None:
    settings = TrainingSettings(
        packs="everyday-v1", validation_packs="starter", validation=None, steps=8192
    )
    done = Training(settings, tmp_path / "run", "cpu")
    done.run()
    tasks = load_tasks("starter", library)
    names = (f"learned@{tmp_path / 'run' / 'last.safetensors'}", "random")
    agents = [Agent.from_name(f"{name}/aligned/blbf") for name in names]
    rollouts = evaluate(agents, tasks, seed=0)
    ours, chance = rollouts[: len(tasks)], rollouts[len(tasks) :]
    assert np.mean([r.total for r in ours]) > np.mean([r.total for r in chance])
