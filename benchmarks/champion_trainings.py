"""Compare trainings of the champion: seeds, and trainings that lack a part of it.

    .venv/bin/python -m benchmarks.champion_trainings    (two hours on two cores; resumes)

Two trainings have the default settings and different seeds. The others are shorter (`SHORT`): one
is complete, each other one lacks something or learns otherwise. Those that see less or look at less
play with that in validation too. All play the 200 validation tasks of everyday-v1 and everyday-hard
with their best weights; paired differences are to the first training of the same length. Each
training runs on one core. Trainings stay in `--folder`. Prints a table, and writes
`benchmarks/results/champion-trainings.json` and a plot of the learning curves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from itertools import cycle
from pathlib import Path
from typing import Any
from unittest import mock

from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, machine, plot_file, write_json
from packit_agents.placements import placement_features, policy_gradient, scored_layout
from packit_agents.placements.champion_training import PlacementTraining, PlacementTrainingSettings
from packit_agents.placements.network import PlacementNetwork
from packit_agents.placements.placement_features import FEATURES, Placements
from packit_agents.placements.playing import best_return
from packit_agents.placements.policy_gradient import relative
from packit_sim import load_tasks
from packit_sim.core.confidence import Comparison, Estimate, format_estimate
from packit_sim.core.parallel import Workers
from packit_sim.game.datasets.provenance import RETURN_SLACK
from packit_sim.game.evaluation.learning_curves import TrainingRecord
from packit_sim.geometry.arrays import Floats
from packit_sim.render import plots
from packit_sim.rules import PACKIT

SHORT = PlacementTrainingSettings(rounds=20, drawn=10)

SURROUNDINGS = ("contact", "filled", "free", "log free", "share of")
"""How the names of features begin that describe what is around a placement."""

DATASETS = ("everyday-v1", "everyday-hard")


@dataclass(frozen=True)
class Variant:
    """A training.

    Attributes
    ----------
    settings : PlacementTrainingSettings
        Its settings.
    against : str
        The training that it is compared with.
    hidden : tuple of str
        How the names of features begin that are always 0.
    constants : dict
        Constants of `placement_features` that have another value.
    advantages : callable
        The advantages of a group's plays.
    """

    settings: PlacementTrainingSettings
    against: str
    hidden: tuple[str, ...] = ()
    constants: Mapping[str, int] = field(default_factory=dict)
    advantages: Callable[[Floats], Floats] = relative


def imitated(totals: Floats) -> Floats:
    """Let the network imitate the best plays of each group, and nothing else."""
    return (totals == totals.max()).astype(float)


def absolute(totals: Floats) -> Floats:
    """Compare plays with nothing."""
    return totals


VARIANTS = {
    "seed 0": Variant(PlacementTrainingSettings(), "seed 0"),
    "seed 1": Variant(PlacementTrainingSettings(seed=1), "seed 0"),
    "short": Variant(SHORT, "short"),
    "short, without the look ahead": Variant(SHORT, "short", constants={"MAX_EXAMINED": 1}),
    "short, only the two largest items": Variant(SHORT, "short", constants={"MAX_ITEMS": 2}),
    "short, surroundings hidden": Variant(SHORT, "short", SURROUNDINGS),
    "short, hidden layers of 1 unit": Variant(replace(SHORT, width=1), "short"),
    "short, only everyday-v1": Variant(replace(SHORT, packs=DATASETS[:1], drawn=20), "short"),
    "short, imitates the best plays": Variant(SHORT, "short", advantages=imitated),
    "short, compares with nothing": Variant(SHORT, "short", advantages=absolute),
}


@contextmanager
def changed(variant: Variant) -> Iterator[None]:
    """Let this process play as a variant does."""
    columns = [n for n, name in enumerate(FEATURES) if name.startswith(variant.hidden or "-")]
    listed = placement_features.placements

    def without(*arguments: Any) -> Placements:
        found = listed(*arguments)
        found.features[:, columns] = 0
        return found

    with ExitStack() as stack:
        for name, value in variant.constants.items():
            stack.enter_context(mock.patch.object(placement_features, name, value))
        stack.enter_context(mock.patch.object(policy_gradient, "relative", variant.advantages))
        if columns:
            stack.enter_context(mock.patch.object(scored_layout, "placements", without))
        yield


def train(name: str, folder: Path) -> tuple[str, dict[str, list[float]]]:
    """Train a variant, and play validation tasks; return their returns for each dataset."""
    variant = VARIANTS[name]
    with changed(variant), Workers(1) as workers:
        PlacementTraining(variant.settings, folder).run(workers)
        network = PlacementNetwork.read(folder / "best.safetensors")
        totals = {
            dataset: [
                best_return(task, PACKIT, network)
                for task in load_tasks(dataset, split="validation")
            ]
            for dataset in DATASETS
        }
    return name, totals


def draw(records: Mapping[str, TrainingRecord], path: Path) -> None:
    """Draw the learning curves: those of the default settings thick."""
    with plots.drawn(path, [["curves"]], 9, 5) as (_, axes):
        ax = axes["curves"]
        for (name, record), color in zip(records.items(), cycle(plots.COLORS), strict=False):
            ax.plot(
                [point.steps for point in record.curve],
                [point.validation.mean for point in record.curve],
                color=color,
                label=name,
                linewidth=1 if name.startswith("short") else 3,
            )
        ax.set_xlabel("rounds")
        ax.set_ylabel("Average Reward in validation")
        ax.legend(loc="center left", bbox_to_anchor=(1, 0.5))


def main() -> None:
    parser = argument_parser(__doc__)
    parser.add_argument(
        "--only", nargs="+", choices=VARIANTS, help="only some, in the order of comparisons"
    )
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("champion-trainings"))
    arguments = parser.parse_args()
    names: Sequence[str] = arguments.only or list(VARIANTS)
    folders = {name: arguments.folder / name.replace(",", "").replace(" ", "-") for name in names}
    with Workers(arguments.workers) as workers:
        totals = dict(workers.as_done(train, list(folders.items())))
    records = {name: TrainingRecord.read(folder) for name, folder in folders.items()}
    table = Table("training", "best after", *(f"{each}, difference" for each in DATASETS))
    rows: dict[str, Any] = {}
    for name in names:
        against = totals.get(VARIANTS[name].against, totals[name])
        own, columns = {}, []
        for dataset, returns in totals[name].items():
            reward = Estimate.of(returns)
            comparison = Comparison.of(returns, against[dataset], RETURN_SLACK)
            own[dataset] = {"reward": asdict(reward), "difference": asdict(comparison.difference)}
            columns.append(f"{reward.mean:.3f}, {format_estimate(comparison.difference, '+.3f')}")
        rows[name] = {"best after": records[name].best.steps, **own}
        table.add_row(name, str(records[name].best.steps), *columns)
    Console().print(table)
    draw(records, plot_file(arguments.out, "champion-trainings"))
    head = {"command": "python -m benchmarks.champion_trainings", "machine": machine()}
    write_json(arguments.out / "champion-trainings.json", {**head, "trainings": rows})


if __name__ == "__main__":
    main()
