import multiprocessing
import os
import sys
import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from packit_sim.core.errors import PackItError
from packit_sim.core.extras import MissingPackageError
from packit_sim.game.datasets.pack_files import load_tasks, write_packs
from packit_sim.game.datasets.packs import Task
from packit_sim.game.envs.env import PackItEnv
from packit_sim.game.envs.recording import (
    CUT_SHORT,
    Recorder,
    RecordingError,
    record,
    stage_steps,
)
from packit_sim.game.envs.wrappers import flattened
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.episodes.episode import Stage
from packit_sim.libraries.library import ShapeLibrary

minari = pytest.importorskip("minari", reason="Minari comes with the extra learn")

SHAPE_ONLY = {"rotation": "aligned", "location": "blbf", "max_shapes": 40}
ORDERS = {"PackIt-v0": (0, 1, 2), "PackItEasy-v0": (0, 2, 1)}
not_recreatable = pytest.mark.filterwarnings("ignore:the environment can't be recreated")


@pytest.fixture(scope="module")
def tasks() -> tuple[Task, ...]:
    return load_tasks("starter", ShapeLibrary.open("everyday"))


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """A home and an environment that nothing may touch."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)
    before = dict(os.environ)
    yield
    assert list(home.iterdir()) == []
    assert {k: v for k, v in os.environ.items() if k != "PYTEST_CURRENT_TEST"} == {
        k: v for k, v in before.items() if k != "PYTEST_CURRENT_TEST"
    }


class Watched(gym.Wrapper):
    """Keeps what it saw, an episode at a time: observations, actions, rewards, infos."""

    def __init__(self, env) -> None:
        super().__init__(env)
        self.episodes = []

    def reset(self, **options):
        seen, info = super().reset(**options)
        self.episodes.append(([seen], [], [], [info]))
        return seen, info

    def step(self, action):
        seen, reward, terminated, truncated, info = super().step(action)
        for kept, new in zip(self.episodes[-1], (seen, action, reward, info), strict=True):
            kept.append(new)
        return seen, reward, terminated, truncated, info


def play(env, rng: np.random.Generator, steps: int = 1000) -> None:
    """Plays valid actions at random, to the episode's end or so many of them."""
    for _ in range(steps):
        valid = np.flatnonzero(env.get_wrapper_attr("action_masks")())
        _, _, terminated, truncated, _ = env.step(int(rng.choice(valid)))
        if terminated or truncated:
            return


def assert_equal_observations(seen, expected) -> None:
    assert seen.keys() == expected.keys()
    for key in expected:
        assert np.array_equal(seen[key], expected[key]), key
        if isinstance(expected[key], np.ndarray):
            assert seen[key].dtype == expected[key].dtype, key


@pytest.mark.parametrize("name", ["PackIt-v0", "PackItEasy-v0"])
@pytest.mark.parametrize("observation", ["features", "none"])
def test_a_recording_equals_what_was_played(tmp_path, name, observation) -> None:
    env = Watched(gym.make(name, observation=observation, max_shapes=40))
    rng = np.random.default_rng(0)
    with pytest.warns(UserWarning, match=r"do not record their settings: Watched"):
        recorder = Recorder(env, tmp_path / "played", description="chance", algorithm="random")
    with recorder:
        recorder.reset(seed=6)
        play(recorder, rng)
        recorder.reset(options={"task": 2})
        play(recorder, rng)
    assert {path.name for path in tmp_path.iterdir()} == {"home", "played"}

    dataset = minari.MinariDataset(tmp_path / "played")
    assert (dataset.total_episodes, dataset.total_steps) == (
        2,
        sum(len(e.actions) for e in dataset),
    )
    assert dataset.storage.metadata["description"] == "chance"
    assert dataset.storage.metadata["algorithm_name"] == "random"
    assert dataset.action_space == env.action_space
    all_metadata = dataset.storage.get_episode_metadata([0, 1])
    for kept, metadata, (seen, actions, rewards, infos) in zip(
        dataset, all_metadata, env.episodes, strict=True
    ):
        assert len(kept) == len(actions) == metadata["total_steps"]
        for step, expected in enumerate(seen):
            row = {key: column[step] for key, column in kept.observations.items()}
            assert row in dataset.observation_space
            assert_equal_observations(row, expected)
        assert kept.actions.tolist() == actions
        assert kept.rewards.tolist() == rewards
        assert kept.terminations.tolist() == [False] * (len(actions) - 1) + [True]
        assert not kept.truncations.any()
        assert kept.infos["density"].tolist() == [info["density"] for info in infos]
        assert metadata["task"] == infos[0]["task"]
        assert metadata["end"] == infos[-1]["end"]
        assert metadata["return"] == pytest.approx(sum(rewards))


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("PackIt-v0", 4),
        pytest.param("PackItEasy-v0", 4, marks=pytest.mark.slow),
        pytest.param("PackIt-v0", 10, marks=pytest.mark.slow),
        pytest.param("PackItEasy-v0", 10, marks=pytest.mark.slow),
    ],
)
def test_ground_truth_demonstrations_have_return_1_and_split_into_sub_tasks(
    tmp_path, tasks, name, count
) -> None:
    tasks = tasks[:count]
    write_packs(tmp_path / "packs.jsonl", [task.pack for task in tasks])
    env = gym.make(name, tasks=str(tmp_path / "packs.jsonl"), observation="none", max_shapes=40)
    dataset = record(env, tmp_path / "demonstrations")
    assert dataset.total_episodes == len(tasks)
    for episode, metadata in zip(
        dataset, dataset.storage.get_episode_metadata(range(len(tasks))), strict=True
    ):
        assert episode.rewards.sum() == pytest.approx(1)
        assert metadata["end"] == "all placed" and metadata["task"] == episode.id
        assert episode.observations["stage"][:3].tolist() == list(ORDERS[name])

    solved = [step for task in tasks for step in task.solution]
    shapes, rotations, locations = zip(*solved, strict=True)
    flat = np.ravel_multi_index(np.transpose(locations), (25, 25, 25))
    for stage, expected in zip(Stage, (shapes, rotations, flat), strict=True):
        pairs = list(stage_steps(tmp_path / "demonstrations", stage))
        assert [action for _, action in pairs] == list(expected)
        assert all(seen["stage"] == stage and seen["action_mask"][a] for seen, a in pairs)
    some = minari.MinariDataset(dataset.storage, episode_indices=np.array([3, 1]))
    expected = [shape for n in (3, 1) for shape, _, _ in tasks[n].solution]
    assert [action for _, action in stage_steps(some, Stage.SHAPE)] == expected


def test_the_environment_is_recreated_from_a_recording(tmp_path) -> None:
    settings = {"tasks": "starter", "order": "cycle", "observation": "none"}
    env = gym.make("PackItEasy-v0", shape="largest-first", max_shapes=40, **settings)
    dataset = record(env, tmp_path / "r", Agent.from_name("random/random/random"), episodes=2)
    again = dataset.recover_environment()
    assert again.spec == env.spec
    assert again.observation_space == env.observation_space
    metadata, _ = dataset.storage.get_episode_metadata([0, 1])
    seen, _ = again.reset(seed=metadata["seed"])
    row = {key: column[0] for key, column in dataset[0].observations.items()}
    assert_equal_observations(row, {key: np.asarray(value) for key, value in seen.items()})
    rewards = [again.step(action)[1] for action in dataset[0].actions]
    assert rewards == dataset[0].rewards.tolist()


@pytest.mark.parametrize("order", ["random", "cycle"])
@pytest.mark.parametrize("fixed", [{}, {"shape": "random"}, {"rotation": "random"}])
def test_episodes_are_played_again_in_an_environment_that_observes_more(
    tmp_path, order, fixed
) -> None:
    settings = {"order": order, "max_shapes": 40, **fixed}
    agent = Agent.from_name("random/random/blbf")
    with gym.make("PackIt-v0", observation="none", **settings) as env:
        dataset = record(env, tmp_path / "r", agent, episodes=2, seed=5)
    finer = gym.make("PackIt-v0", observation="features", **settings)
    finer.reset(seed=0)  # leaves tasks in turn elsewhere
    recorded = list(stage_steps(dataset, Stage.LOCATION))
    finest = list(stage_steps(dataset, Stage.LOCATION, finer))
    assert len(recorded) == len(finest) > 10
    for (seen, action), (more, same) in zip(recorded, finest, strict=True):
        assert action == same and more in finer.observation_space
        assert_equal_observations(
            {key: np.asarray(more[key]) for key in seen},
            {key: np.asarray(seen[key]) for key in seen},
        )


def test_an_environment_with_other_tasks_does_not_replay(tmp_path, tasks) -> None:
    settings = {"observation": "none", "max_shapes": 40}
    dataset = record(gym.make("PackIt-v0", **settings), tmp_path / "r", episodes=1)
    other = PackItEnv(tasks[::-1], **settings)
    with pytest.raises(RecordingError, match=r"episode 0 does not replay: step \d+ gives reward"):
        list(stage_steps(dataset, Stage.SHAPE, other))


def test_recording_is_reproducible_though_resets_have_no_seeds(tmp_path) -> None:
    agent = Agent.from_name("random/random/random")
    first, again = (
        record(
            gym.make("PackIt-v0", observation="none", **SHAPE_ONLY),
            tmp_path / name,
            agent,
            episodes=3,
            seed=11,
        )
        for name in ("first", "again")
    )
    seeds = [[m["seed"] for m in d.storage.get_episode_metadata(range(3))] for d in (first, again)]
    assert seeds[0] == seeds[1] and len(set(seeds[0])) == 3 and seeds[0][0] == 11
    assert [e.actions.tolist() for e in first] == [e.actions.tolist() for e in again]


def test_episodes_cut_short_are_kept_as_truncated(tmp_path) -> None:
    env = gym.make("PackIt-v0", observation="none", **SHAPE_ONLY)
    rng = np.random.default_rng(0)
    with Recorder(env, tmp_path / "r") as recorder:
        with pytest.raises(RuntimeError, match=r"call reset\(\)"):
            recorder.step(0)
        recorder.reset(seed=0)  # of which nothing is played
        recorder.reset(seed=1)
        play(recorder, rng, steps=3)
        recorder.reset(seed=2)
        play(recorder, rng, steps=2)
    dataset = minari.MinariDataset(tmp_path / "r")
    assert [len(episode) for episode in dataset] == [3, 2]
    assert [episode.truncations.tolist() for episode in dataset] == [
        [False, False, True],
        [False, True],
    ]
    assert not any(episode.terminations.any() for episode in dataset)
    all_metadata = list(dataset.storage.get_episode_metadata([0, 1]))
    assert [(metadata["end"], metadata["seed"]) for metadata in all_metadata] == [
        (CUT_SHORT, 1),
        (CUT_SHORT, 2),
    ]


def test_a_time_limit_truncates_and_what_was_not_valid_is_no_step_of_a_stage(tmp_path) -> None:
    env = gym.make("PackIt-v0", observation="none", max_episode_steps=2, **SHAPE_ONLY)
    with Recorder(env, tmp_path / "r") as recorder:
        recorder.reset(seed=0)
        play(recorder, np.random.default_rng(0))
        with pytest.raises(RuntimeError, match=r"call reset\(\)"):
            recorder.step(0)
        recorder.reset()
        recorder.step(39)
    dataset = minari.MinariDataset(tmp_path / "r")
    assert dataset[0].truncations.tolist() == [False, True]
    assert dataset[1].actions.tolist() == [39]
    assert len(list(stage_steps(dataset, Stage.SHAPE))) == 2


def test_voxels_are_compressed_and_come_back(tmp_path, tasks) -> None:
    task = replace(tasks[0], items=tasks[0].items[:8], solution=())
    env = Watched(PackItEnv([task], observation="voxels", max_shapes=8))
    with pytest.warns(UserWarning, match=r"was not created by gymnasium\.make"):
        recorder = Recorder(env, tmp_path / "r")
    with recorder:
        recorder.reset(seed=0)
        play(recorder, np.random.default_rng(0), steps=4)
    (episode,) = minari.MinariDataset(tmp_path / "r")
    for step, expected in enumerate(env.episodes[0][0]):
        row = {key: column[step] for key, column in episode.observations.items()}
        assert_equal_observations(row, expected)
    raw = sum(column.nbytes for column in episode.observations.values())
    size = sum(path.stat().st_size for path in (tmp_path / "r").iterdir())
    assert raw > 40_000_000 and size < 1_000_000


@pytest.mark.parametrize("generated", [False, True])
def test_tasks_that_are_objects_are_recorded_with_a_warning(tmp_path, tasks, generated) -> None:
    source = (lambda rng: tasks[int(rng.integers(3))]) if generated else tasks[:3]
    settings = {"tasks": source, "observation": "none", "max_shapes": 40}
    env = gym.make("PackIt-v0", **settings)
    if generated:
        with pytest.raises(RecordingError, match="pass `episodes`"):
            record(env, tmp_path / "r")
    with pytest.warns(UserWarning, match="has settings that are objects: tasks"):
        dataset = record(env, tmp_path / "r", episodes=2)
    assert [episode.rewards.sum() for episode in dataset] == pytest.approx([1, 1])
    all_metadata = dataset.storage.get_episode_metadata([0, 1])
    assert [metadata["task"] == -1 for metadata in all_metadata] == [generated, generated]
    steps = stage_steps(dataset, Stage.SHAPE, PackItEnv(**settings))
    assert sum(1 for _ in steps) == dataset.total_steps // 3
    with pytest.raises(ValueError, match="cannot be recovered"):
        dataset.recover_environment()


@not_recreatable
def test_a_task_that_only_a_reset_is_given_is_refused(tmp_path, tasks) -> None:
    env = PackItEnv(tasks, observation="none", max_shapes=40)
    with (
        pytest.raises(RecordingError, match="a task object can't be recorded"),
        Recorder(env, tmp_path / "r") as recorder,
    ):
        recorder.reset(options={"task": tasks[0]})
    with pytest.raises(PackItError, match="no solution"):
        record(PackItEnv([Task(tasks[0].items, tasks[0].pack, ())]), tmp_path / "r")
    assert not (tmp_path / "r").exists()


def test_vectors_are_recorded_and_sub_tasks_taken_from_a_replay(tmp_path) -> None:
    bare = gym.make("PackIt-v0", observation="features", **SHAPE_ONLY)
    dataset = record(flattened(bare), tmp_path / "r", episodes=1)
    assert dataset[0].observations.shape == (len(dataset[0]) + 1, *flattened(bare).reset()[0].shape)
    assert dataset.recover_environment().observation_space == dataset.observation_space
    with pytest.raises(RecordingError, match="do not contain both"):
        next(stage_steps(dataset, Stage.SHAPE))
    pairs = list(stage_steps(dataset, Stage.SHAPE, bare))
    assert [action for _, action in pairs] == dataset[0].actions.tolist()


@not_recreatable
def test_a_path_that_exists_is_refused(tmp_path) -> None:
    env = PackItEnv(observation="none", **SHAPE_ONLY)
    (tmp_path / "taken").mkdir()
    with pytest.raises(RecordingError, match="taken exists"):
        Recorder(env, tmp_path / "taken")
    with Recorder(env, tmp_path / "new" / "r") as recorder:
        recorder.reset(seed=0)
    assert list((tmp_path / "new").iterdir()) == [], "nothing was played"
    recorder.close()


@not_recreatable
def test_an_exception_leaves_nothing(tmp_path) -> None:
    def interrupted() -> None:
        with Recorder(PackItEnv(observation="none", **SHAPE_ONLY), tmp_path / "r") as recorder:
            recorder.reset(seed=0)
            play(recorder, np.random.default_rng(0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


def test_a_process_that_dies_leaves_nothing_at_the_path(tmp_path) -> None:
    def die() -> None:
        with warnings.catch_warnings(action="ignore"):
            recorder = Recorder(PackItEnv(observation="none", **SHAPE_ONLY), tmp_path / "r")
        recorder.reset(seed=0)
        play(recorder, np.random.default_rng(0))
        assert recorder.count == 1
        os._exit(9)

    process = multiprocessing.get_context("fork").Process(target=die)
    with warnings.catch_warnings(action="ignore"):  # of threads, which only wait
        process.start()
    process.join(100)
    assert process.exitcode == 9
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("missing", ["minari", "h5py"])
def test_without_minari_the_extra_is_named(tmp_path, monkeypatch, missing) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    env = PackItEnv(observation="none", **SHAPE_ONLY)
    with pytest.raises(MissingPackageError, match=r"pip install 'packit-sim\[learn\]'"):
        Recorder(env, tmp_path / "r")
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


@not_recreatable
def test_minari_finds_a_recording_by_its_id(tmp_path, monkeypatch) -> None:
    path = tmp_path / "all" / "packit" / "shapes-v2" / "data"
    env = PackItEnv(observation="none", **SHAPE_ONLY)
    with Recorder(env, path, dataset_id="packit/shapes-v2") as recorder:
        recorder.reset(seed=0)
        play(recorder, np.random.default_rng(0), steps=2)
    with monkeypatch.context() as patched:
        patched.setenv("MINARI_DATASETS_PATH", str(tmp_path / "all"))
        assert minari.load_dataset("packit/shapes-v2").total_steps == 2
        assert "packit/shapes-v2" in minari.list_local_datasets()


@not_recreatable
def test_two_recorders_cannot_write_to_one_path(tasks, tmp_path) -> None:
    path = tmp_path / "twice"
    with Recorder(PackItEnv(tasks[:1], **SHAPE_ONLY), path) as first:
        with pytest.raises(PackItError, match=f"{path}: process {os.getpid()} is at work there"):
            Recorder(PackItEnv(tasks[:1], **SHAPE_ONLY), path)
        _, info = first.reset(seed=0)
        first.step(int(np.flatnonzero(info["action_mask"])[0]))
    assert minari.MinariDataset(path).total_episodes == 1
    with pytest.raises(RecordingError, match=f"{path} exists: choose another path"):
        record(PackItEnv(tasks[:1], **SHAPE_ONLY), path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["home", "twice"]
