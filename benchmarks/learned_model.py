"""Learn what fits where voxels leave it open, and search in the learned model.

    .venv/bin/packit record everyday-v1 --split train --transitions --shards 4 --out train AGENTS
    .venv/bin/packit record everyday-v1 --split validation --transitions --seed 7 --shards 1 \
        --out validation AGENTS
    .venv/bin/python -m benchmarks.learned_model train train validation --weights FILE
    .venv/bin/python -m benchmarks.learned_model accuracy TEST
    .venv/bin/python -m benchmarks.learned_model accuracy PUZZLES --library puzzles --name puzzles
    .venv/bin/python -m benchmarks.learned_model search everyday-v1 everyday-hard --tasks 30
    .venv/bin/python -m benchmarks.learned_model search puzzles --split '' --tasks 12 \
        --name puzzles

AGENTS are the six `--agent` of `AGENTS`; PUZZLES are 30 episodes of the dataset `puzzles`, recorded
with seed 11 as TEST, which are 60 of everyday-v1's test tasks. Own meshes are those that
`formula_shapes.write_shapes` writes (16 of each, seed 0), in six packs of `packit generate
--library FOLDER --packs 6 --generations 15`. `train` writes weights, `accuracy` measures the
bundled ones (or `--weights`) on recorded transitions and draws the errors by group, `search` plays
test tasks with searches in the voxels alone, in the learned model and in the exact engine. Writes
`learned_model_accuracy.json`, `learned_model_search.json` (with `--name` before the suffix) and,
without a name, `docs/images/benchmark-learned-model.png`; `search` can be resumed.
"""

from __future__ import annotations

import itertools
import time
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.common import argument_parser, machine, markdown_table, plot_file, write_json
from packit_agents.learned_model.contact_network import ContactNetwork, bundled_network
from packit_agents.learned_model.contact_training import Contacts, contacts, placed_items, train
from packit_agents.learned_model.imagined_search import ImaginedSearch
from packit_agents.learned_model.learned_box import LearnedBox
from packit_sim import Agent, Box, Rollout, ShapeLibrary, compare, evaluate, load_tasks
from packit_sim.core.confidence import Estimate
from packit_sim.game.episodes.policy_registry import load_search
from packit_sim.game.evaluation.transitions import (
    Transitions,
    TransitionsManifest,
    read_transitions,
)
from packit_sim.geometry.items import BoxState
from packit_sim.geometry.rotations import COUNT
from packit_sim.geometry.shapes import Item
from packit_sim.render import plots

AGENTS = (
    *("largest-first/aligned/blbf", "random/random/random", "random/first-fit/blbf"),
    *("largest-fitting-first/lowest/maximal-contact", "champion"),
    "largest-fitting-first/lowest/blbf",
)

BASE = "largest-first/aligned/blbf"

ALONE = (BASE, "largest-fitting-first/aligned/blbf", "champion")
"""Agents without a search: the first ends with a shape that does not fit, the second skips it."""

SEARCHES = (
    *((BASE, search) for search in ("lns=100", "lns=0.5s", "beam=4", "beam=8", "backtrack=8")),
    ("champion", "ruin-recreate=20"),
)
"""Agents, and how they search: budgets are rollouts, or processor seconds."""

DENSITIES = (0.0, 0.2, 0.4, 1.0)


def learn(train_folder: Path, validation_folder: Path, weights: Path, seed: int) -> None:
    """Train a network on recorded transitions, and write it."""
    library = ShapeLibrary.open("everyday")
    learned, held_out = (
        Contacts.joined(contacts(shard, library) for shard in read_transitions(folder))
        for folder in (train_folder, validation_folder)
    )
    manifests = map(TransitionsManifest.read, (train_folder, validation_folder))
    provenance: dict[str, Any] = {"seed": seed}
    for name, manifest, own in zip(
        ("train", "validation"), manifests, (learned, held_out), strict=True
    ):
        provenance[name] = {
            "agents": list(manifest.agents),
            "seed": manifest.seed,
            "shards": len(manifest.shards),
            "steps": manifest.steps,
            "tasks": manifest.tasks,
            "locations": len(own.feasible),
        }
    train(learned, held_out, provenance, seed=seed).write(weights)


def _groups(shard: Transitions, own: Contacts, library: ShapeLibrary) -> Iterator[tuple[str, Any]]:
    """Yield names of groups of a shard's open locations, and which those are."""
    items = [placed.item for placed in placed_items(shard, library)]
    volume = np.array([item.volume for item in items])
    before = np.cumsum(volume) - volume
    density = (
        before
        - before[shard.first[:-1]][np.searchsorted(shard.first, range(len(shard)), "right") - 1]
    )
    for low, high in itertools.pairwise(DENSITIES):
        yield (
            f"density {low:g} to {high:g}",
            (density[own.step] >= low) & (density[own.step] < high),
        )
    solidity = np.array([item.volume / np.prod(item.cells) * 1e6 for item in items])[own.step]
    for low, high in ((0, 0.2), (0.2, 0.5), (0.5, 1.01)):
        yield (
            f"fills {low:.0%} to {min(high, 1):.0%} of its box",
            (solidity >= low) & (solidity < high),
        )
    shared = np.expm1(own.features[:, ContactNetwork.features.index("fine cells shared")])
    for low, high in ((0, 10), (10, 100), (100, np.inf)):
        many = f"more than {low}" if high == np.inf else f"{low + 1} to {high:g}"
        yield f"{many} shared fine cells", (shared > low) & (shared <= high)


def measured(network: ContactNetwork, folder: Path, library: ShapeLibrary) -> dict[str, Any]:
    """Measure accuracy and calibration on recorded transitions of a library's shapes."""
    groups: dict[str, list[tuple[int, int]]] = {}
    odds, exact, inside = [], [], 0
    for shard in read_transitions(folder):
        own = contacts(shard, library)
        found = network(own.features)
        odds.append(found)
        exact.append(own.feasible)
        right = (found > 0) == own.feasible
        for name, chosen in _groups(shard, own, library):
            groups.setdefault(name, []).append((int(right[chosen].sum()), int(chosen.sum())))
        for placed in placed_items(shard, library):
            inside += int(np.prod([26 - -(-side // 4) for side in placed.item.cells]))
    logits, labels = np.concatenate(odds), np.concatenate(exact)
    predicted = 1 / (1 + np.exp(-logits))
    bins = np.minimum((predicted * 10).astype(int), 9)
    reliability = [
        [
            float(predicted[bins == n].mean()),
            float(labels[bins == n].mean()),
            int((bins == n).sum()),
        ]
        for n in range(10)
        if (bins == n).any()
    ]
    error = sum(abs(mean - share) * count for mean, share, count in reliability) / len(labels)
    return {
        "locations": inside,
        "open": len(labels),
        "open and feasible": int(labels.sum()),
        "wrong": int(((logits > 0) != labels).sum()),
        "accuracy": float(((logits > 0) == labels).mean()),
        "always the more frequent answer": float(max(labels.mean(), 1 - labels.mean())),
        "precision": float(labels[logits > 0].mean()),
        "recall": float((logits > 0)[labels].mean()),
        "expected calibration error": float(error),
        "reliability": reliability,
        "groups": {
            name: [
                sum(n for n, _ in each) / max(1, sum(n for _, n in each)),
                sum(n for _, n in each),
            ]
            for name, each in groups.items()
        },
    }


def speed(network: ContactNetwork, folder: Path, library: ShapeLibrary) -> dict[str, float]:
    """Measure processor milliseconds of the masks of 24 rotations, ours and the exact ones."""
    shard = next(read_transitions(folder))
    placed = placed_items(shard, library)
    times: dict[str, list[float]] = {"learned": [], "exact": []}

    for step in range(7, len(placed), 23):
        first = int(shard.first[shard.episode(step)])
        box = Box()
        state = BoxState(box.cells, tuple(placed[first:step]))
        box.restore(state)
        items = [placed[step].item.turned(n) for n in range(COUNT)]
        _ = [item.voxels for item in items]
        for name, masks in (
            ("learned", partial(network.probabilities, state, items)),
            ("exact", partial(_exact_masks, box, items)),
        ):
            started = time.process_time()
            masks()
            times[name].append(1000 * (time.process_time() - started))
    return {name: float(np.median(each)) for name, each in times.items()}


def _exact_masks(box: Box, items: list[Item]) -> npt.NDArray[np.bool_]:
    return np.stack([box.feasible(item) for item in items])


def example(network: ContactNetwork, folder: Path) -> npt.NDArray[np.int64]:
    """Return the layer of locations with the most open ones in a shard: int (nx, ny).

    0: blocked by voxels, 1: free by voxels, 2: open and predicted right, 3: open and wrong.
    """
    library = ShapeLibrary.open("everyday")
    shard = next(read_transitions(folder))
    placed, own = placed_items(shard, library), contacts(shard, library)
    step = int(np.bincount(own.step).argmax())
    first = int(shard.first[shard.episode(step)])
    state = BoxState(Box().cells, tuple(placed[first:step]))
    (probability,) = network.probabilities(state, [placed[step].item])
    mask = shard.feasible(step)
    found = mask.astype(np.int64)
    at = tuple(own.location[own.step == step].T)
    found[at] = 2 + ((probability[at] > 0.5) != mask[at])
    layer = int((found >= 2).sum((0, 1)).argmax())
    return found[:, :, layer]


def draw(result: dict[str, Any], layer: npt.NDArray[np.int64], path: Path) -> None:
    """Draw the reliability of probabilities, the accuracy of groups, and errors in a layer."""
    with plots.drawn(path, [["reliability", "groups", "example"]], 15, 4.5) as (_, axes):
        predicted, share, _ = zip(*result["reliability"], strict=True)
        ax = axes["reliability"]
        ax.plot([0, 1], [0, 1], color="0.7")
        ax.plot(predicted, share, marker="o", color=plots.COLORS[0])
        ax.set(xlabel="predicted probability", ylabel="share that is feasible", title="Calibration")
        ax = axes["groups"]
        names = list(result["groups"])[::-1]
        ax.barh(names, [result["groups"][name][0] for name in names], color=plots.COLORS[0])
        ax.set(xlabel="accuracy", xlim=(0.5, 1), title="Accuracy at open locations")
        ax = axes["example"]
        kinds = ("blocked by voxels", "free by voxels", "open, right", "open, wrong")
        colors = "0.85", "0.55", plots.COLORS[0], "tab:red"
        for n, (kind, color) in enumerate(zip(kinds, colors, strict=True)):
            x, y = np.nonzero(layer == n)
            ax.scatter(x, y, s=14, marker="s", color=color, label=kind)
        ax.set(xlabel="x", ylabel="y", title="One layer of locations", aspect="equal")
        ax.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False)


def arms(base: str, search: str) -> list[Agent]:
    """Return the agents that plan with voxels alone, the learned model and the exact engine."""
    agent = Agent.from_name(base)
    alone = partial(LearnedBox, lambda box, item, at: np.zeros(len(at), dtype=bool))
    planner = load_search(search)
    return [
        replace(agent, name=f"voxels alone: {search}", search=ImaginedSearch(planner, alone)),
        Agent.from_name(f"{base}+imagined={search}"),
        replace(agent, name=f"exact engine: {search}", search=ImaginedSearch(planner, Box)),
    ]


def search(dataset: str, split: str | None, tasks: int, file: Path) -> dict[str, Any]:
    """Let all agents play tasks, and compare them with the agent without a search."""
    agents = [Agent.from_name(name) for name in ALONE]
    agents += [agent for each in SEARCHES for agent in arms(*each)]
    played = evaluate(agents, load_tasks(dataset, split=split)[:tasks], seed=0, file=file)
    own = {agent.name: [each for each in played if each.agent == agent.name] for agent in agents}
    rows = {}
    for n, (name, rollouts) in enumerate(own.items()):
        rows[name] = {
            "return": _estimate(Estimate.of([each.total for each in rollouts])),
            "seconds": float(np.median([each.seconds for each in rollouts])),
            "to no search": [_difference(rollouts, own[each]) for each in ALONE],
        }
        if n >= len(ALONE):
            perfect = list(own)[n + 2 - (n - len(ALONE)) % 3]
            base = own[SEARCHES[(n - len(ALONE)) // 3][0]]
            rows[name]["to own"] = _difference(rollouts, base)
            rows[name]["to perfect"] = _difference(rollouts, own[perfect])
    return {"tasks": tasks, "split": split, "rows": rows}


def _difference(first: list[Rollout], second: list[Rollout]) -> list[float]:
    return _estimate(compare(first, second).difference)


def _estimate(estimate: Estimate) -> list[float]:
    assert estimate.low is not None and estimate.high is not None
    return [estimate.mean, estimate.low, estimate.high]


def _text(estimate: list[float], sign: str = "") -> str:
    mean, low, high = (format(value, f"{sign}.3f") for value in estimate)
    return f"{mean} ({low} to {high})"


def main() -> None:
    parser = argument_parser(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    learning = commands.add_parser("train")
    learning.add_argument("train", type=Path)
    learning.add_argument("validation", type=Path)
    learning.add_argument("--weights", type=Path, required=True)
    learning.add_argument("--seed", type=int, default=0)
    accuracy = commands.add_parser("accuracy")
    accuracy.add_argument("transitions", type=Path)
    accuracy.add_argument("--library", default="everyday", help="library of the shapes")
    accuracy.add_argument("--weights", type=Path, help="default: the bundled ones")
    searching = commands.add_parser("search")
    searching.add_argument("datasets", nargs="+")
    searching.add_argument("--split", default="test", help="empty: the whole dataset")
    searching.add_argument("--tasks", type=int, default=30)
    for command in (accuracy, searching):
        command.add_argument("--name", default="", help="part of the name of the results")
    settings = parser.parse_args()
    if settings.command == "train":
        learn(settings.train, settings.validation, settings.weights, settings.seed)
    elif settings.command == "accuracy":
        weights, library = settings.weights, ShapeLibrary.open(settings.library)
        network = ContactNetwork.read(weights) if weights else bundled_network()
        result = measured(network, settings.transitions, library)
        result["milliseconds of 24 masks"] = speed(network, settings.transitions, library)
        write_json(_results(settings, "accuracy"), machine() | result)
        if not settings.name:
            layer = example(network, settings.transitions)
            draw(result, layer, plot_file(settings.out, "learned-model"))
    else:
        found = {}
        for name in settings.datasets:
            file = settings.out / f"learned_model_{Path(name).name}.jsonl"
            found[name] = search(name, settings.split or None, settings.tasks, file)
            rows = [
                (
                    agent,
                    _text(row["return"]),
                    *(_text(each, "+") for each in row["to no search"]),
                    _text(row["to own"], "+") if "to own" in row else "",
                    _text(row["to perfect"], "+") if "to perfect" in row else "",
                    f"{row['seconds']:.2f}",
                )
                for agent, row in found[name]["rows"].items()
            ]
            own = "to its own agent"
            head = "agent", "return", *(f"to {each}" for each in ALONE), own, "to exact", "s"
            print(f"{name}\n{markdown_table(head, rows)}", flush=True)
        write_json(_results(settings, "search"), machine() | found)


def _results(settings: Namespace, kind: str) -> Path:
    name = f"_{settings.name}" if settings.name else ""
    path: Path = settings.out / f"learned_model_{kind}{name}.json"
    return path


if __name__ == "__main__":
    main()
