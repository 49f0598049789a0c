"""The hardness of packs by generation of their evolution (paper, figure 4).

A dataset of `packit generate --history` contains the packs that each evolution kept. An agent plays
all of them. The score at a generation is the mean over all evolutions. Each is represented by the
last pack that it had kept by then, even if it has ended. So all points have the same evolutions;
intervals are 95% bootstrap intervals over them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from packit_sim.core.confidence import Estimate, format_estimate
from packit_sim.core.errors import PackItError
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import RETURN_SLACK, Evolved
from packit_sim.render import plots

LEVELS = (1.0, 0.7)
"""The x of Success@x."""

LEGEND = (
    "Each row is over all evolutions, by the last pack that each had kept by that generation; "
    '"running" counts those that had not ended. Reward is the mean return, S@x the percentage of '
    "packs with a return of at least x, and density that of the evolved packs. Parentheses contain "
    "95% bootstrap intervals."
)
"""The first sentences of the table."""

Evolutions = Mapping[int, Mapping[int, Pack]]
"""The packs that each evolution kept, by its seed, then by generation."""


@dataclass(frozen=True)
class GenerationScore:
    """The score over all evolutions after a generation.

    Attributes
    ----------
    under_way : int
        The number of evolutions that had not ended before.
    reward : Estimate
        Average Reward.
    success : dict[float, Estimate]
        Success@x in percent, by x.
    density : Estimate
        The mean density of the packs.
    """

    generation: int
    under_way: int
    reward: Estimate
    success: dict[float, Estimate]
    density: Estimate


def by_evolution(packs: Sequence[Pack], file: Path) -> Evolutions:
    """Group packs by evolution and generation.

    Parameters
    ----------
    file : Path
        Their file, for the message of the error.

    Returns
    -------
    Evolutions
        The packs.

    Raises
    ------
    PackItError
        If a pack does not record its generation.
    """
    evolutions: dict[int, dict[int, Pack]] = defaultdict(dict)
    for number, pack in enumerate(packs):
        evolved = pack.provenance
        if not (isinstance(evolved, Evolved) and evolved.after is not None):
            raise PackItError(
                f"{file}, pack {number} records no generation (provenance.after): generate its "
                "dataset with `packit generate --history`"
            )
        evolutions[evolved.seed][evolved.after] = pack
    return evolutions


def distinct(evolutions: Evolutions) -> tuple[list[Pack], dict[tuple[int, int], int]]:
    """Remove packs that an evolution kept more than once.

    Parameters
    ----------
    evolutions : Evolutions
        The packs.

    Returns
    -------
    list[Pack]
        The distinct packs.
    dict[tuple[int, int], int]
        The index of each pack in that list, by evolution and generation.
    """
    packs: list[Pack] = []
    known: dict[tuple[object, ...], int] = {}
    at: dict[tuple[int, int], int] = {}
    for evolution, kept in evolutions.items():
        for after, pack in kept.items():
            key = evolution, pack.items
            if key not in known:
                known[key] = len(packs)
                packs.append(pack)
            at[evolution, after] = known[key]
    return packs, at


def curve(evolutions: Evolutions, totals: Mapping[tuple[int, int], float]) -> list[GenerationScore]:
    """Score each generation after which any evolution kept a pack.

    Parameters
    ----------
    evolutions : Evolutions
        The packs.
    totals : Mapping[tuple[int, int], float]
        The agent's return on each pack, by evolution and generation.

    Returns
    -------
    list[GenerationScore]
        The scores in the order of generations.
    """
    points = []
    for generation in sorted({after for packs in evolutions.values() for after in packs}):
        latest = {
            seed: max(after for after in packs if after <= generation)
            for seed, packs in evolutions.items()
        }
        reached = np.array([totals[seed, after] for seed, after in latest.items()])
        points.append(
            GenerationScore(
                generation,
                sum(generation in packs for packs in evolutions.values()),
                Estimate.of(reached),
                {x: Estimate.of(100.0 * (reached >= x - RETURN_SLACK)) for x in LEVELS},
                Estimate.of([evolutions[seed][after].density for seed, after in latest.items()]),
            )
        )
    return points


def draw(points: Sequence[GenerationScore], title: str, file: Path) -> None:
    """Plot reward, Success, density and the number of running evolutions over generations."""
    at = [point.generation for point in points]
    with plots.drawn(file, [["reward", "success"], ["density", "under way"]], 10, 7) as (
        figure,
        axes,
    ):
        figure.suptitle(title)
        reward, density = [p.reward for p in points], [p.density for p in points]
        plots.line(axes["reward"], at, reward, color=plots.COLORS[0], marker="o")
        axes["reward"].set(title="Average Reward", ylabel="return")
        for x, color, marker in zip(LEVELS, plots.COLORS[1:], "sD", strict=False):
            scores = [point.success[x] for point in points]
            label = f"Success@{x:g}"
            plots.line(axes["success"], at, scores, color=color, marker=marker, label=label)
        axes["success"].set(title="Success", ylabel="% of packs", ylim=(-3, 103))
        axes["success"].legend()
        plots.line(axes["density"], at, density, color=plots.COLORS[3], marker="^")
        axes["density"].set(title="Density of the packs", ylabel="placed volume / box")
        axes["under way"].plot(
            at, [point.under_way for point in points], color=plots.INK, marker="v"
        )
        axes["under way"].set(title="Evolutions under way", ylabel="evolutions")
        axes["under way"].set_ylim(bottom=0)
        for name in axes:
            axes[name].set_xlabel("generation")
            axes[name].xaxis.get_major_locator().set_params(integer=True)


def markdown(points: Sequence[GenerationScore]) -> str:
    """Write a table with a row for each generation, and its legend."""
    headings = ("generation", "running", "reward", *(f"S@{x:g}" for x in LEVELS), "density")
    lines = [LEGEND, "", f"| {' | '.join(headings)} |", "|---" * len(headings) + "|"]
    for point in points:
        estimates = (
            format_estimate(point.reward, ".3f"),
            *(format_estimate(point.success[x], ".1f") for x in LEVELS),
            format_estimate(point.density, ".3f"),
        )
        lines.append(f"| {point.generation} | {point.under_way} | {' | '.join(estimates)} |")
    return "\n".join(lines) + "\n"
