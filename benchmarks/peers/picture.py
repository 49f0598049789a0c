"""The picture: the volume that each peer packs, the valid part of it, and the time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.peers.rows import Summary
from packit_sim.core.confidence import Estimate
from packit_sim.render import plots

VALID, PACKED, SECONDS = plots.COLORS[:3]


def save(rows: Sequence[Summary], path: Path) -> None:
    """Draw a row of dots for each peer, the first peer on top, and a column for each measure."""
    one, *more = (
        [each for each in rows if each.together == n] for n in sorted({e.together for e in rows})
    )
    columns = ["share", *(f"density {n}" for n in range(len(more))), "pairs", "seconds"]
    height = 1.6 + 0.34 * len(one)
    with plots.drawn(path, [columns], 3.2 + 2.6 * len(columns), height) as (figure, axes):
        _pairs_of_dots(axes["share"], [each.share for each in one], [each.kept for each in one])
        axes["share"].set(title="One task", xlabel="share of the task's volume")
        for n, crowd in enumerate(more):
            _pairs_of_dots(
                axes[f"density {n}"],
                [each.density for each in crowd],
                [each.kept_density for each in crowd],
            )
            axes[f"density {n}"].set(
                title=f"Items of {crowd[0].together} tasks", xlabel="share of the box"
            )
        _dots(axes["pairs"], [each.pairs for each in one], PACKED, "o", filled=False)
        axes["pairs"].set(title="In conflict", xlabel="pairs of items per task")
        seconds = [Estimate(each.seconds, None, None) for each in one]
        _dots(axes["seconds"], seconds, SECONDS, "D", filled=True)
        axes["seconds"].set(title="Time", xlabel="CPU seconds per task", xscale="log")
        for column in columns:
            names = [each.peer for each in one]
            axes[column].set(yticks=range(len(names)), ylim=(len(names) - 0.5, -0.5))
            axes[column].set_yticklabels(names if column == columns[0] else [])
            axes[column].tick_params(axis="y", length=0)
        figure.legend(
            *axes["share"].get_legend_handles_labels(), loc="outside upper center", ncols=2
        )


def _pairs_of_dots(axes: Any, packed: Sequence[Estimate], valid: Sequence[Estimate]) -> None:
    _dots(axes, packed, PACKED, "o", filled=False, label="packed")
    _dots(axes, valid, VALID, "s", filled=True, label="valid part, checked by the meshes")


def _dots(
    axes: Any, estimates: Sequence[Estimate], color: str, marker: str, filled: bool, **named: Any
) -> None:
    """Draw means with their intervals, one a row, from the top."""
    rows = range(len(estimates))
    low = [e.mean if e.low is None else e.low for e in estimates]
    high = [e.mean if e.high is None else e.high for e in estimates]
    axes.hlines(rows, low, high, color=color, linewidth=1.6, alpha=0.6)
    face = color if filled else "none"
    size = 5 if filled else 8
    means = [estimate.mean for estimate in estimates]
    axes.plot(means, rows, marker, color=color, markerfacecolor=face, markersize=size, **named)
