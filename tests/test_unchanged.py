"""Golden records of version 0.1.0: the same packs are generated, the same episodes played.

`references/format-1/README.md` says how each record was written.
"""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from packit_sim.core.assets import assets_folder
from packit_sim.game.datasets.evolution_settings import EvolutionSettings
from packit_sim.game.datasets.pack_files import load_tasks, read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.episodes.agents import Agent
from packit_sim.game.evaluation.evaluation import evaluate
from packit_sim.game.evaluation.judging import is_judged
from packit_sim.game.evaluation.results import Rollout, read_results
from packit_sim.game.generation.evolution import Evolution
from packit_sim.libraries.library import ShapeLibrary

RECORDS = Path(__file__).parent / "references" / "format-1"

RESULTS = sorted(file.stem for file in (RECORDS / "results").glob("*.jsonl"))

QUICK_SECONDS = 1.0
"""An agent is replayed among the quick tests if it once took no longer for its tasks."""


@pytest.fixture(scope="module")
def everyday() -> ShapeLibrary:
    return ShapeLibrary.open("everyday")


def agents_of(name: str) -> dict[str, list[Rollout]]:
    """The rollouts of a record by agent."""
    found: dict[str, list[Rollout]] = {}
    for rollout in read_results(RECORDS / "results" / f"{name}.jsonl"):
        found.setdefault(rollout.agent, []).append(rollout)
    return found


def recorded_agents() -> list[Any]:
    """A parameter for each agent of each record, marked by the time that it takes."""
    return [
        pytest.param(
            name,
            agent,
            id=f"{name}-{agent}",
            marks=[pytest.mark.slow] if sum(r.seconds for r in rollouts) > QUICK_SECONDS else [],
        )
        for name in RESULTS
        if name != "judged"
        for agent, rollouts in agents_of(name).items()
    ]


def provenance(name: str) -> list[dict[str, Any]]:
    """What format 1 stores of how each pack of a record was evolved."""
    lines = (RECORDS / "packs" / f"{name}.jsonl").read_text().splitlines()
    return [json.loads(line)["made"] for line in lines]


def evolution_of(made: dict[str, Any], library: ShapeLibrary) -> Evolution:
    settings = {k: tuple(v) if isinstance(v, list) else v for k, v in made["settings"].items()}
    return Evolution(library, made["seed"], EvolutionSettings(**settings))


def content(pack: Pack) -> tuple[Any, ...]:
    """A pack without its provenance and what is outside: old results did not record that."""
    return pack.library, pack.cells, pack.items, pack.density


@pytest.mark.parametrize(("name", "agent"), recorded_agents())
def test_agents_play_as_recorded(everyday, name, agent) -> None:
    if "packnn" in agent:
        pytest.importorskip("torch", reason="pip install packit-sim[learn]")
    recorded = agents_of(name)[agent]
    tasks = load_tasks("starter", everyday)[: len(recorded)]
    (seed,) = {rollout.seed for rollout in recorded}
    (rules,) = {rollout.rules for rollout in recorded}
    assert rules.easy == ("easy" in name) and rules.kinematic == ("kinematic" in name)
    played = evaluate([Agent.from_name(agent)], tasks, seed, rules=rules)
    for old, new in zip(recorded, played, strict=True):
        assert (new.task, new.task_digest) == (old.task, old.task_digest)
        assert (new.total, new.end) == (old.total, old.end)
        assert content(new.pack) == content(old.pack)


@pytest.mark.parametrize("name", RESULTS)
def test_recorded_results_are_read_and_replayed(everyday, name) -> None:
    tasks = load_tasks("starter", everyday)
    for rollouts in agents_of(name).values():
        for rollout in rollouts:
            pack, task = rollout.pack, tasks[rollout.task]
            assert rollout.task_digest == task.digest
            assert is_judged(rollout, "bisection") == (name == "judged")
            volume = sum(placed.item.volume for placed in pack.placed(everyday))
            assert volume == pytest.approx(pack.density) == rollout.total * task.volume
            assert pack.replay(everyday).density == pack.density


@pytest.mark.parametrize("split", ["train", "validation", "test"])
def test_packs_evolve_as_recorded(everyday, split) -> None:
    recorded = read_packs(RECORDS / "packs" / f"{split}.jsonl")
    evolution = evolution_of(provenance(split)[0], everyday.split(split))
    while not evolution.is_over:
        evolution.step()
    evolved = evolution.kept if len(recorded) > 1 else [evolution.best]
    assert [content(pack) for pack in evolved] == [content(pack) for pack in recorded]
    assert [pack.replay(everyday).density for pack in recorded] == [p.density for p in recorded]


@pytest.mark.slow
@pytest.mark.parametrize("split", ["train", "validation", "test"])
@pytest.mark.timeout(900)  # seconds on a machine with nothing else to do
def test_shipped_packs_evolve_as_recorded(everyday, split) -> None:
    (recorded,) = read_packs(RECORDS / "packs" / f"everyday-v1-{split}.jsonl")
    (made,) = provenance(f"everyday-v1-{split}")
    evolution = evolution_of(made, everyday.split(split))
    while len(evolution.densities) <= made["generation"]:
        evolution.step()
    assert content(evolution.best) == content(recorded)


def test_shipped_packs_are_those_recorded() -> None:
    folder = assets_folder() / "packs"
    for name, recorded in json.loads((RECORDS / "shipped.json").read_text()).items():
        digest = hashlib.sha256()
        for pack in read_packs(folder / name):
            items = [(i.shape, i.scale, i.rotation, i.location) for i in pack.items]
            outside = [(item.shape, item.scale) for item in pack.outside]
            facts = (pack.library.digest, pack.cells, pack.density, items, outside)
            digest.update(repr(facts).encode())
        assert digest.hexdigest() == recorded, name
