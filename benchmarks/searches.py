"""Compare the densities that three searches find: the paper's, an elitist one, and DEAP's.

    .venv/bin/python -m benchmarks.searches    (hours on two cores; a stopped run resumes)

All start from the same pools, sizes and first hundred chromosomes, which the seeds determine, and
pack equally many chromosomes. Finished runs are kept in `benchmarks/results/searches.json`; at the
end `docs/images/benchmark-searches.png` is drawn, and tables are printed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from benchmarks.common import argument_parser, plot_file
from benchmarks.tournaments import Tournaments
from packit_sim import EvolutionSettings, ShapeLibrary
from packit_sim.core import caches
from packit_sim.core.files import replace_text
from packit_sim.core.parallel import Workers
from packit_sim.game.generation.evolution import densities
from packit_sim.game.generation.pack_creator import Recipe
from packit_sim.game.generation.strategies import Elitist, EvolutionStrategy, Generational

PAPERS = "generational (the paper's)"

KINDS: dict[str, Callable[[EvolutionSettings], EvolutionStrategy]] = {
    PAPERS: Generational,
    "elitist": Elitist,
    "tournaments (DEAP)": Tournaments,
}

STYLES = {
    PAPERS: ("#000000", "-"),
    "elitist": ("#0072B2", "--"),
    "tournaments (DEAP)": ("#009E73", ":"),
}
"""Colours of Okabe and Ito, safe for the colour-blind, and different line styles."""

SIZE_RANGE = (0.62, 0.76)
"""Size factors of the bundled datasets: more items fit than with the default."""

RESAMPLES = 10_000


def run(
    library: ShapeLibrary, kind: str, seed: int, settings: EvolutionSettings
) -> tuple[str, int, list[float]]:
    """Run a search; return its name, the seed, and the best density after each generation."""
    caches.clear()
    rng = np.random.default_rng(seed)
    recipe = Recipe.drawn(library, settings, rng)
    search = KINDS[kind](settings)
    best: list[float] = []
    for _ in range(settings.generations + 1):
        chromosomes = search.ask(rng)
        found = densities(recipe, chromosomes, search.threshold)
        search.tell(chromosomes, found)
        best.append(max(found if not best else [best[-1], *found]))
    return kind, seed, best


def evaluations(settings: EvolutionSettings) -> npt.NDArray[np.int64]:
    """Count the chromosomes packed after each generation, (generations + 1,), in any search."""
    return settings.population + settings.children * np.arange(settings.generations + 1)


def interval(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Compute means over the first axis and their 95% bootstrap intervals, (3, ...)."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(values), size=(RESAMPLES, len(values)))
    weights = np.apply_along_axis(np.bincount, 1, drawn, minlength=len(values)) / len(values)
    low, high = np.percentile(np.tensordot(weights, values, 1), (2.5, 97.5), axis=0)
    return np.stack([values.mean(axis=0), low, high])


def curves(runs: dict[str, Any], seeds: Sequence[int]) -> dict[str, npt.NDArray[np.float64]]:
    """Collect the densities of each search, (seeds, generations + 1)."""
    return {kind: np.array([runs[kind][str(seed)] for seed in seeds]) for kind in KINDS}


def compare(result: dict[str, Any], settings: EvolutionSettings) -> dict[str, Any]:
    """Compute each search's density, and its paired difference from the paper's search."""
    found = curves(result["runs"], result["seeds"])
    counts = evaluations(settings)
    aim = found[PAPERS].mean(axis=0)[-1]
    rows: dict[str, Any] = {}
    for kind, density in found.items():
        rows[kind] = {
            "evaluations until the paper's last mean": (
                int(counts[np.argmax(density.mean(axis=0) >= aim)])
                if density.mean(axis=0)[-1] >= aim
                else None
            ),
        }
        for share in (2, 1):
            at = settings.generations // share
            difference = density[:, at] - found[PAPERS][:, at]
            rows[kind][f"after {counts[at]}"] = {
                "density": interval(density[:, at]).tolist(),
                "difference": interval(difference).tolist(),
                "pools won": int((difference > 0).sum()),
            }
    return rows


def show(console: Console, result: dict[str, Any]) -> None:
    rows = result["compared"]
    for at in [name for name in rows[PAPERS] if name.startswith("after")]:
        table = Table(
            "search", "mean density", "95%", "difference from the paper's", "95%", "pools won",
            title=f"{at} evaluations, {len(result['seeds'])} pools",
        )  # fmt: skip
        for kind, row in rows.items():
            mean, low, high = row[at]["density"]
            more, least, most = row[at]["difference"]
            table.add_row(
                kind,
                f"{mean:.3f}",
                f"{low:.3f} to {high:.3f}",
                f"{more:+.3f}",
                f"{least:+.3f} to {most:+.3f}",
                f"{row[at]['pools won']}",
            )
        console.print(table)
    table = Table("search", "evaluations until the paper's last mean")
    for kind, row in rows.items():
        reached = row["evaluations until the paper's last mean"]
        table.add_row(kind, f"{reached or 'never'}")
    console.print(table)


def draw(result: dict[str, Any], settings: EvolutionSettings, file: Path) -> None:
    figure = Figure(figsize=(13, 5.5), layout="constrained")
    counts = evaluations(settings)
    found = curves(result["runs"], result["seeds"])
    differences = {kind: density - found[PAPERS] for kind, density in found.items()}
    for axis, lines, title, label in zip(
        figure.subplots(1, 2),
        (found, differences),
        ("density of the best pack", "difference from the paper's search, pool by pool"),
        ("density", "difference of densities"),
        strict=True,
    ):
        for kind, values in lines.items():
            mean, low, high = interval(values)
            colour, line = STYLES[kind]
            axis.plot(counts, mean, color=colour, linestyle=line, linewidth=2, label=kind)
            axis.fill_between(counts, low, high, color=colour, alpha=0.12, linewidth=0)
        axis.set_title(title, fontsize=14)
        axis.set_xlabel("chromosomes packed", fontsize=13)
        axis.set_ylabel(label, fontsize=13)
        axis.set_xlim(0, counts[-1])
        axis.tick_params(labelsize=12)
        axis.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=12, loc="lower right")
    figure.suptitle(
        f"Three searches on the same {len(result['seeds'])} pools: means and 95% intervals",
        fontsize=15,
    )
    figure.savefig(file, dpi=100)


def resume(file: Path, job: dict[str, Any]) -> dict[str, Any]:
    """Read finished runs; exit if they had other settings or another library."""
    if not file.exists():
        return {**job, "runs": {kind: {} for kind in KINDS}}
    result: dict[str, Any] = json.loads(file.read_text())
    for name in ("settings", "library"):
        if result[name] != job[name]:
            raise SystemExit(
                f"{file} has runs with other {name}: move it away, or choose another folder"
            )
    return {**job, "runs": {kind: result["runs"].get(kind, {}) for kind in KINDS}}


def main() -> None:
    parser = argument_parser(__doc__, "JSON and picture")
    parser.add_argument("--seeds", type=int, default=8, help="number of pools, from seed 0 on")
    parser.add_argument("--generations", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2, help="runs at once")
    arguments = parser.parse_args()
    library = ShapeLibrary.open("everyday").split("train")
    settings = EvolutionSettings(generations=arguments.generations, size_range=SIZE_RANGE)
    job = {
        "command": "python -m benchmarks.searches",
        "library": {"name": library.name, "split": "train", "digest": library.digest},
        "settings": settings.to_json(),
        "seeds": list(range(arguments.seeds)),
    }
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "searches.json"
    result = resume(file, job)
    runs = result["runs"]
    console = Console(width=100)
    jobs = [
        (library, kind, seed, settings)
        for seed in result["seeds"]
        for kind in KINDS
        if str(seed) not in runs[kind]
    ]
    for kind, seed, found in Workers(arguments.workers).as_done(run, jobs):
        runs[kind][str(seed)] = found
        replace_text(file, json.dumps(result) + "\n")
        console.print(f"seed {seed}, {kind}: {found[-1]:.3f}")
    result["compared"] = compare(result, settings)
    replace_text(file, json.dumps(result) + "\n")
    draw(result, settings, plot_file(arguments.out, "searches"))
    show(console, result)


if __name__ == "__main__":
    main()
