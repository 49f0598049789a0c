"""Aims, tables and the picture of the benchmark of placement."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from benchmarks.pools import DENSITY

DENSITIES = (0.0, 0.2, 0.3, 0.4)
"""The densities at which queries are measured."""


def check_aims(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Compare a run with the aims: milliseconds, or ratios."""
    at = result["density"][str(DENSITY)]
    fft = min(at[f"voxels by FFT, {name}"]["median"] for name in ("scipy", "torch"))
    rows = [
        ("BLBF query", at["BLBF"]["median"], "<=", 0.25),
        ("mask, cold", at["mask, cold"]["median"], "<=", 3),
        ("prepare, first", result["prepare"]["prepare, first"]["median"], "<=", 15),
        ("prepare, further turn", result["prepare"]["prepare, further turn"]["median"], "<=", 0.5),
        ("mask, warm", at["mask, warm"]["median"], "<=", 0.2),
        ("chromosome", result["chromosome"]["chromosome, as it comes"]["median"], "<=", 10),
        ("Easy union, warm", result["easy"]["Easy union, warm"]["median"], "<=", 10),
        ("oracle / cold mask", result["slow ways"]["oracle / cold mask"]["median"], ">=", 500),
        ("FFT / cold mask", fft / at["mask, cold"]["median"], ">=", 1),
    ]
    return [
        {
            "what": what,
            "measured": value,
            "aim": f"{sign} {aim:g}",
            "met": bool(value <= aim if sign == "<=" else value >= aim),
        }
        for what, value, sign, aim in rows
    ]


def show(console: Console, result: dict[str, Any]) -> None:
    """Print the tables of a result."""
    table = Table("density 0.3", "measured", "aim", "met", title="aims: ms, or ratios")
    for row in result["bars"]:
        table.add_row(
            row["what"], f"{row['measured']:.3g}", row["aim"], "yes" if row["met"] else "NO"
        )
    console.print(table)
    table = Table("", "density", "median", "10%", "90%", "n", title="milliseconds, or counts")
    sections = [("", result["prepare"])]
    sections += [(density, times) for density, times in result["density"].items()]
    sections += [("0.3", result["easy"]), ("0.3", result["slow ways"]), ("", result["chromosome"])]
    for density, times in sections:
        for name, row in times.items():
            if "median" in row:
                cells = [f"{row[key]:.3g}" for key in ("median", "p10", "p90")]
                table.add_row(name, density, *cells, str(row["n"]))
    console.print(table)
    for name in ("items", "triangles", "tables"):
        series = result["growth"][name]
        table = Table(name, *next(iter(series.values())), title=f"growth with {name}: medians")
        for size, times in series.items():
            table.add_row(size, *(f"{row['median']:.3g}" for row in times.values()))
        console.print(table)


def draw(result: dict[str, Any], file: Path) -> None:
    """Draw masks by alternative, by density, by items and by triangles."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    axes = figure.subplots(2, 2)
    methods = {}
    at = result["density"][str(DENSITY)]
    for name in ("mask, warm", "mask, cold", "voxels by FFT, torch", "voxels by FFT, scipy"):
        methods[name] = at[name]
    for name in ("trimesh CollisionManager", "oracle"):
        methods[name] = result["slow ways"][name]
    medians = [row["median"] for row in methods.values()]
    spread = [
        [row["median"] - row["p10"] for row in methods.values()],
        [row["p90"] - row["median"] for row in methods.values()],
    ]
    own = ["tab:blue" if name.startswith("mask") else "tab:gray" for name in methods]
    axes[0, 0].barh(list(methods), medians, xerr=spread, color=own)
    axes[0, 0].set(xscale="log", xlabel="ms", title="a whole mask at density 0.3 (10% to 90%)")
    for name in ("BLBF", "mask, warm", "mask, cold"):
        rows = [result["density"][str(density)][name] for density in DENSITIES]
        _line(axes[0, 1], list(DENSITIES), rows, name)
    axes[0, 1].set(yscale="log", xlabel="density", ylabel="ms", title="by density")
    for axis, series, label in (
        (axes[1, 0], "items", "items placed"),
        (axes[1, 1], "triangles", "triangles an item"),
    ):
        growth = result["growth"][series]
        for name in next(iter(growth.values())):
            _line(axis, [int(n) for n in growth], [times[name] for times in growth.values()], name)
        axis.set(yscale="log", xlabel=label, ylabel="ms", title=f"by {label}")
    axes[1, 1].set_xscale("log")
    for axis in (axes[0, 1], axes[1, 0], axes[1, 1]):
        axis.legend()
        axis.grid(alpha=0.3)
    figure.savefig(file, dpi=100)


def _line(axis: Any, at: list[float], rows: list[dict[str, float]], name: str) -> None:
    axis.plot(at, [row["median"] for row in rows], marker="o", label=name)
    axis.fill_between(at, [row["p10"] for row in rows], [row["p90"] for row in rows], alpha=0.15)
