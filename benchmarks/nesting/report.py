"""The page and the picture of the results."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import RESULTS, plot_file
from benchmarks.nesting import ablations
from benchmarks.nesting.builtin_report import PICTURE, builtin, draw_builtin
from benchmarks.nesting.cases import MORE_ROTATIONS, heights_of_others
from benchmarks.nesting.runs import Results, Search
from packit_sim.core.files import replace_text
from packit_sim.parts.results import pictures

PAGE = Path(__file__).parents[2] / "docs" / "benchmarks" / "nesting.md"

SHORT, LONG = 60.0, 600.0
"""The times, in seconds, that the tables have."""

BELOW = 0.005
"""How far a height must be below one that is published with two decimals."""

KNAPSACKS_OF_OTHERS = {
    "largest-first/lowest/maximal-contact": 0.688,
    "spectral packing": 0.691,
    "best agent with 30 s of LNS": 0.709,
}
"""Mean densities of the same six boxes, measured once with the agents and `benchmarks.peers`."""

PICTURED = (
    ("literature", "Egeblad et al. 2009/Merged5", "axis-4"),
    ("literature", "Stoyan et al. 2005/Example3", "axis-4"),
    ("strips", "0", "cube"),
)
"""Kind, name and rotation set of the strips that the page shows."""

CONVERGENCE = (
    "Egeblad et al. 2009/Merged3",
    "Egeblad et al. 2009/Merged5",
    "Liu et al. 2015/Experiment1",
    "Stoyan et al. 2004/Example3",
    "Stoyan et al. 2005/Example3",
)
"""The instances whose heights the picture shows over time."""

POINTS = 200

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Of Okabe and Ito, safe for the colour-blind."""

BOTH = "fixed and axis-n"
"""The rotation sets with which others published heights."""

Runs = Sequence[dict[str, Any]]

HEAD = """# Nesting

Written by `python -m benchmarks.nesting --table` from `benchmarks/results/nesting.json`. The
packings are in `benchmarks/results/nesting/`, and `python -m benchmarks.nesting --verify --data
FOLDER` checks all of them again by their meshes. FOLDER has
[the literature's](../reference/instances.md). The [guide](../guides/nesting.md) explains the
rotation sets.

Two searches run side by side, on two cores. Times are processor seconds of each search, so that
other work on the machine does not count. The results of `fixed` and `axis-n` after 60 s are of one
version, but for Merged2, Merged4, and Example4 and Example5 of Stoyan et al. 2004 with `axis-4`.
Those, and the results of bins, of many library shapes, of built-in strips, of clearances and
without parts of the search are of later ones, on a machine that is 2.5 times slower than others. So
are most results of the first seed after 600 s. Only those of Merged1, Merged3, Experiment1 with
`fixed`, Example1 and Example2 of Stoyan et al. 2005, and Example1 and Example2 of Stoyan et al.
2004 with `axis-4` are older: such searches neither began again each minute then nor persevered.
Those of Example2 and Example3 of Stoyan et al. 2004 and of Example3 of Stoyan et al. 2005 with
`fixed` began again each minute, where the present search perseveres. The present search, in which
the second 300 s resume from the strip of the first, has the second seeds after 600 s, but for
Example1 and Example3 of Stoyan et al. 2004, and two tasks in a strip with `cube`, both on one of
the faster machines.

Of 35 published rows four are missing: their two instances (Lamas-Fernandez et al. 2022) are under
other licences. Packings below the best that was published are in `benchmarks/records/`, in ESICUP's
format; `python -m benchmarks.nesting.records --data FOLDER --check` checks them by arithmetic, FCL
and winding numbers, without the nester.
"""


def write_report(runs: dict[str, dict[str, Any]], out: Path, data: Path | None = None) -> None:
    """Write the page and its pictures.

    Parameters
    ----------
    runs : dict
        The results by their keys.
    out : Path
        The folder of the results; with the default folder, the page is the documentation's.
    data : Path, optional
        The folder of the literature's instances. Without it, the pictures of their packings stay
        as they are.
    """
    results = Results(out, data)
    by_kind = defaultdict(list)
    for run in runs.values():
        by_kind[run["kind"]].append(run)
    picture = plot_file(out, "nesting")
    literature = by_kind["literature"]
    by_items = picture.with_name("benchmark-nesting-by-items.png")
    if literature:
        shown = [run for run in literature if _is_of(run, SHORT) or _is_of(run, LONG)]
        draw(shown, picture)
        draw_ratios(shown, by_items)
    if by_kind["builtin"]:
        draw_builtin(results, picture.with_name(PICTURE))
    parts = [
        HEAD,
        *_literature(literature),
        f"![Heights by the number of items](../images/{by_items.name})\n" if literature else "",
        f"![Heights over time](../images/{picture.name})\n" if literature else "",
        *_pictures(results, picture.parent),
        *builtin(by_kind["builtin"]),
        *_tasks("Two tasks in a strip", by_kind["strips"], {}),
        *_tasks("Two tasks in a box", by_kind["knapsacks"], KNAPSACKS_OF_OTHERS),
        *_bins(by_kind["bins"]),
        *_library(by_kind["library"]),
        *_clearance(by_kind["clearance"]),
        *_ablations(list(ablations.read(out).values())),
    ]
    page = PAGE if out == RESULTS else out / "nesting.md"
    replace_text(page, "\n".join(parts))
    print(f"wrote {page} and {picture}")


def _pictures(results: Results, folder: Path) -> Iterator[str]:
    """Draw the best packing of some strips, and yield where the page shows them."""
    for kind, name, rotations in PICTURED:
        own = [
            run
            for run in results.read().values()
            if (run["kind"], run["name"], run["rotations"]) == (kind, name, rotations)
        ]
        if not own:
            continue
        best = min(own, key=lambda run: float(run["score"]))
        file = folder / f"nesting-{kind}-{name.rpartition('/')[2]}.png".lower()
        if results.is_readable(Search.of(best)):
            pictures.draw(results.packing(Search.of(best)), file)
        elif not file.exists():
            continue
        title = f"{name if kind == 'literature' else f'{kind} {name}'}, {rotations}"
        yield f"![{title}](../images/{file.name})\n\n*{title}: height {best['score']:.2f}*\n"


def draw(runs: Runs, file: Path) -> None:
    """Plot the mean height over time of some strips, relative to sparrow-3d's after 60 s."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.add_subplot()
    shown = [run for run in runs if run["others"].get("sparrow-3d, 60 s", math.nan) > 0]
    names = [name for name in CONVERGENCE if any(run["name"] == name for run in shown)]
    colors = dict(zip(names or sorted({run["name"] for run in shown}), COLORS, strict=False))
    for (name, rotations), own in _grouped(shown, "name", "rotations"):
        if name not in colors or rotations == "cube":
            continue
        least = own[0]["others"]["sparrow-3d, 60 s"]
        times = np.geomspace(0.5, max(run["seconds"] for run in own), POINTS)
        reached = [[_reached(run["curve"], time) / least for run in own] for time in times]
        means = np.mean(reached, axis=1)
        style = {"fixed": "--", "free": "-."}.get(rotations, "-")
        axes.plot(times, means, style, color=colors[name], label=f"{name}, {rotations}")
    axes.axhline(1, color="black", linestyle=":", label="sparrow-3d, 60 s")
    axes.set(xscale="log", xlabel="seconds", ylabel="mean height / sparrow-3d's after 60 s")
    axes.set_ylim(top=1.6)
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", fontsize="small")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)


def _is_of(run: dict[str, Any], seconds: float) -> bool:
    """Return whether a search had so many seconds, and resumed from no other one."""
    return bool(run["seconds"] == seconds) and "resumed from" not in run


def _reached(curve: Sequence[tuple[float, float]], seconds: float) -> float:
    """Return the best height until then; NaN before the first."""
    return min((height for at, height in curve if at <= seconds), default=math.nan)


def _literature(runs: Runs) -> Iterator[str]:
    """Yield the table of the literature's instances, and the mean ratios."""
    if not runs:
        return
    yield "## Strips of the literature\n"
    rows = []
    ratios: dict[tuple[float, str], list[float]] = defaultdict(list)
    below: dict[tuple[float, str], int] = defaultdict(int)
    records = 0
    for (name, rotations), own in _grouped(runs, "name", "rotations"):
        others = _others(own)
        published, best = others.get("sparrow-3d, 10 min"), others.get("sparrow-3d, best of 15", 0)
        best = 0 if rotations in MORE_ROTATIONS else best
        cells = []
        for seconds in (SHORT, LONG):
            heights = [run["score"] for run in own if _is_of(run, seconds)]
            ratio = _ratio(heights, published)
            cells += [f"{_mean(heights)} ({len(heights)})" if heights else "-", _number(ratio, 3)]
            if not math.isnan(ratio):
                own_set = _set(rotations)
                for kind in (own_set,) if rotations in MORE_ROTATIONS else (own_set, BOTH):
                    ratios[seconds, kind].append(ratio)
                    below[seconds, kind] += min(heights) < best - BELOW
        lowest = min(run["score"] for run in own)
        is_record = lowest < best - BELOW
        records += is_record
        rows.append(
            [
                f"`{name}`",
                str(own[0]["items"]),
                rotations,
                *cells,
                f"**{_number(lowest)}**" if is_record else _number(lowest),
                _number(published),
                _number(best or None),
                _number(others.get("sparrow-3d, 60 s")),
                _number(others.get("record before")),
                _yes(own),
            ]
        )
    yield _table(
        "instance, items, rotations, mean after 60 s (seeds), ratio, mean after 600 s (seeds), "
        "ratio, our lowest, published mean after 10 min, published best of 15, "
        "sparrow-3d after 60 s here, record before, valid",
        rows,
    )
    yield (
        "Heights; lower is better. Ratios are to the published means of 15 runs of 10 minutes with "
        "4 workers on an Apple M5; our lowest is bold where it is below the best of these runs by "
        "more than rounding. For `cube` and `free`, the means of others are those with `axis-4` "
        "(Liu: `axis-8`; only `fixed` where nothing else was published).\n"
    )
    means = [
        [f"{seconds:g} s", rotations, str(len(values)), f"{statistics.geometric_mean(values):.3f}",
         str(sum(value <= 1 for value in values)), str(below[seconds, rotations])]
        for (seconds, rotations), values in sorted(ratios.items())
    ]  # fmt: skip
    if means:
        yield _table(
            "time, rotations, rows, geometric mean of the ratios, means no higher, "
            "rows with a height below the best of 15",
            means,
        )
    longest = max(run["seconds"] for run in runs)
    if longest > LONG:
        yield (
            f"Our lowest heights are also those of longer searches, of up to {longest:g} s, which "
            "begin once (`--beginnings 1`) or resume from the best packing of a row (`--resume`). "
            f"The published runs of a row took 9000 s together. Of all rows, {records} have a "
            "height below the best of these runs.\n"
        )


def _others(own: Runs) -> dict[str, float]:
    """Return the heights that others reached, also those that were unknown when a run was made."""
    return {**heights_of_others(own[0]["name"], own[0]["rotations"]), **own[0]["others"]}


def draw_ratios(runs: Runs, file: Path) -> None:
    """Plot mean heights relative to the published ten-minute means, by the number of items."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.add_subplot()
    points: dict[tuple[float, str], list[tuple[int, float]]] = defaultdict(list)
    for (_, rotations, seconds), own in _grouped(runs, "name", "rotations", "seconds"):
        ratio = _ratio([run["score"] for run in own], _others(own).get("sparrow-3d, 10 min"))
        if rotations not in MORE_ROTATIONS and not math.isnan(ratio):
            points[seconds, _set(rotations)].append((own[0]["items"], ratio))
    for ((seconds, kind), own_points), color in zip(sorted(points.items()), COLORS, strict=False):
        marker = "o" if kind == "fixed" else "^"
        items, values = zip(*sorted(own_points), strict=True)
        axes.plot(items, values, marker, color=color, label=f"{kind}, {seconds:g} s")
    axes.axhline(1, color="black", linestyle=":", label="published mean, 10 min")
    axes.set(xlabel="items", ylabel="mean height / published mean after 10 min")
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right center", fontsize="small")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)


def _tasks(title: str, runs: Runs, others: dict[str, float]) -> Iterator[str]:
    """Yield the table of the densities of two tasks in a strip or a box."""
    if not runs:
        return
    yield f"## {title}\n"
    rows = []
    for (rotations, seconds), own in _grouped(runs, "rotations", "seconds"):
        name = f"`nest`, {rotations}, {seconds:g} s"
        rows.append([name, *_densities(run["density"] for run in own), _yes(own)])
    for name in runs[0]["others"]:
        known = {run["name"]: run["others"][name] for run in runs}
        rows.append([name, *_densities(known.values()), ""])
    rows += [[f"`{name}`" if "/" in name else name, f"{value:.3f}", "", "", ""]
             for name, value in others.items()]  # fmt: skip
    yield _table("packer, mean density, least to largest, searches, valid", rows)


def _bins(runs: Runs) -> Iterator[str]:
    """Yield the table of the boxes that sets of items need."""
    if not runs:
        return
    yield "## Bins: 60 items into unit boxes\n"
    rows = []
    for (rotations, seconds), own in _grouped(runs, "rotations", "seconds"):
        ours = [run["score"] for run in own]
        greedy = [run["others"]["greedy"] for run in own]
        fewer = sum(one < other for one, other in zip(ours, greedy, strict=True))
        more = sum(one > other for one, other in zip(ours, greedy, strict=True))
        rows.append([f"{rotations}, {seconds:g} s", _mean(ours), _mean(greedy), str(fewer),
                     str(more), str(len(own)), _yes(own)])  # fmt: skip
    yield _table("rotations, mean boxes, first-fit decreasing, fewer, more, searches, valid", rows)


def _library(runs: Runs) -> Iterator[str]:
    """Yield the table of how soon there is a packing of many shapes, and how it improves."""
    if not runs:
        return
    yield "## Many library shapes in a strip\n"
    rows = []
    for run in runs:
        curve = run["curve"]
        first = [f"{curve[0][0]:.1f} s", _number(curve[0][1])]
        last = [f"{run['seconds']:g} s", _number(run["score"])]
        rows.append([run["name"], run["rotations"], *first, *last, _yes([run])])
    yield _table(
        "shapes, rotations, first packing after, its height, time, height then, valid", rows
    )


def _clearance(runs: Runs) -> Iterator[str]:
    """Yield the table of distances between items that must keep a clearance."""
    if not runs:
        return
    yield "## Clearance: 1% of the base\n"
    rows = [
        [f"`{run['name']}`", run["rotations"], f"{run['clearance']:g}",
         f"{run['smallest distance']:.6g}", _number(run["score"]), f"{run['seconds']:g} s",
         "yes" if run["smallest distance"] >= run["clearance"] else "NO", _yes([run])]
        for run in runs
    ]  # fmt: skip
    yield _table(
        "instance, rotations, clearance, smallest distance by FCL, height, time, kept, valid", rows
    )


def _ablations(runs: Runs) -> Iterator[str]:
    """Yield the table of what the parts of the search give."""
    if not runs:
        return
    yield "## What the parts of the search give\n"
    scores: dict[tuple[str, str, str], dict[int, float]] = defaultdict(dict)
    for run in runs:
        scores[run["variant"], run["name"], run["rotations"]][run["seed"]] = run["score"]
    strips = list(dict.fromkeys((run["name"], run["rotations"]) for run in runs))
    rows = []
    for variant in dict.fromkeys(run["variant"] for run in runs):
        cells, ratios = [], []
        for strip in strips:
            own, whole = scores[variant, *strip], scores[ablations.WHOLE, *strip]
            cells.append(f"{_mean(list(own.values()))} ({len(own)})")
            ratios += [own[seed] / whole[seed] for seed in own.keys() & whole.keys()]
        mean = _number(statistics.mean(ratios), 3)
        if len(ratios) > 1:
            mean += f" ({statistics.stdev(ratios) / len(ratios) ** 0.5:.3f})"
        rows.append([variant, *cells, mean])
    names = ", ".join(f"{name} {rotations}" for name, rotations in strips)
    yield _table(f"variant, {names}, mean ratio (standard error)", rows)
    yield (
        "Mean heights (searches) after so many processor seconds of each of two searches: "
        f"{', '.join(sorted({format(run['seconds'], 'g') for run in runs}))}. By "
        "`python -m benchmarks.nesting.ablations`. Within two standard errors nothing is shown.\n"
    )


def _grouped(runs: Runs, *fields: str) -> Iterator[tuple[tuple[Any, ...], Runs]]:
    found = defaultdict(list)
    for run in runs:
        found[tuple(run[field] for field in fields)].append(run)
    yield from sorted(found.items())


def _set(rotations: str) -> str:
    """Return the name under which ratios are averaged."""
    return "axis-n" if rotations.startswith("axis") else rotations


def _ratio(values: Sequence[float], other: float | None) -> float:
    return statistics.mean(values) / other if values and other else math.nan


def _mean(values: Sequence[float]) -> str:
    return _number(statistics.mean(values)) if values else "-"


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}f}"


def _densities(values: Iterable[float]) -> list[str]:
    known = list(values)
    spread = f"{min(known):.3f} to {max(known):.3f}"
    return [f"{statistics.mean(known):.3f}", spread, str(len(known))]


def _yes(runs: Runs) -> str:
    return "yes" if all(run["valid"] for run in runs) else "NO"


def _table(head: str, rows: Iterable[Sequence[str]]) -> str:
    """Write a table in Markdown."""
    columns = head.split(", ")
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
