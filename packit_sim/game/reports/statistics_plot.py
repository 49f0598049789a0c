"""The picture of a dataset: histograms of its packs, and frequencies of categories."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.choices import SPLITS
from packit_sim.game.datasets.statistics import DatasetStatistics
from packit_sim.render import plots

MIN_BINS, MAX_BINS = 7, 24
"""Range of the number of bins of a histogram, which grows with the number of packs."""

FILL = 0.45
"""Total opacity of the bars of a histogram, shared by the splits."""

MAX_CATEGORIES = 30
"""Number of categories that are shown, the most frequent."""

MARKERS = "osD^v"
"""Markers of splits, for readers who see no colours."""

Numbers = npt.NDArray[Any]


def save(splits: Sequence[DatasetStatistics], path: Path | str) -> None:
    """Draw the splits of a dataset over each other: histograms, and frequencies of categories.

    Parameters
    ----------
    path : Path or str
        The picture to write.

    Raises
    ------
    MissingPackageError
        If matplotlib is not installed.
    RenderError
        If the path can't be written.
    """
    layout = [["items", "categories"], ["density", "categories"], ["volume", "categories"]]
    with plots.drawn(path, layout, 10, 9) as (figure, axes):
        _histogram(axes["items"], splits, [split.items for split in splits])
        axes["items"].set(title="Items a pack", xlabel="items", ylabel="% of packs")
        axes["items"].xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)

        _histogram(axes["density"], splits, [split.densities for split in splits])
        axes["density"].set(title="Density", xlabel="placed volume / box", ylabel="% of packs")

        axes["volume"].set_xscale("log")
        plots.label_between_powers(axes["volume"].xaxis)
        _histogram(axes["volume"], splits, [100 * split.volumes for split in splits])
        axes["volume"].set(title="Volume of an item", xlabel="% of the box", ylabel="% of items")

        _categories(axes["categories"], splits)
        axes["categories"].plot([], [], color=plots.INK, linestyle=":", label="median")
        legend = axes["categories"].get_legend_handles_labels()
        figure.legend(*legend, loc="outside upper center", ncols=len(splits) + 1)


def _styles(splits: Sequence[DatasetStatistics]) -> list[tuple[str, str]]:
    """Return the color and marker of each; those of the three usual splits are fixed."""
    others = [split.split for split in splits if split.split not in SPLITS]
    names = others if len(others) == len(splits) else [*SPLITS, *others]
    places = [names.index(split.split) for split in splits]
    return [(plots.COLORS[n % len(plots.COLORS)], MARKERS[n % len(MARKERS)]) for n in places]


def _histogram(axes: Any, splits: Sequence[DatasetStatistics], samples: Sequence[Numbers]) -> None:
    """Draw relative frequencies, so that splits of different size compare."""
    edges = _edges(samples, log=axes.get_xscale() == "log")
    for (color, _), sample in zip(_styles(splits), samples, strict=True):
        shares = 100 * np.histogram(sample, edges)[0] / len(sample)
        axes.stairs(shares, edges, fill=True, color=color, alpha=FILL / len(splits))
        axes.stairs(shares, edges, color=color, linewidth=1.6)
        axes.axvline(np.median(sample), color=color, linestyle=":", linewidth=1.8)
    axes.set_ylim(bottom=0)


def _edges(samples: Sequence[Numbers], log: bool) -> Numbers:
    """Return the edges of bins for all values: between whole numbers, or evenly spaced."""
    values = np.concatenate(samples)
    low, high = values.min(), values.max()
    bins = int(np.clip(2 * np.sqrt(min(map(len, samples))), MIN_BINS, MAX_BINS))
    if values.dtype.kind == "i":
        width = int(np.ceil((high - low + 1) / bins))
        return low - 0.5 + width * np.arange(int(np.ceil((high - low + 1) / width)) + 1)
    if log:
        return np.geomspace(0.95 * low, 1.05 * high, bins + 1)
    margin = max(0.02 * (high - low), 0.005)
    return np.linspace(low - margin, high + margin, bins + 1)


def _categories(axes: Any, splits: Sequence[DatasetStatistics]) -> None:
    """Draw a dot for each split and category."""
    total: Counter[str] = Counter()
    for split in splits:
        total.update({k: n / len(split.volumes) for k, n in split.categories.items()})
    names = [name for name, _ in total.most_common(MAX_CATEGORIES)]
    rows = np.arange(len(names))
    shares = np.array(
        [[100 * c.categories[name] / len(c.volumes) for name in names] for c in splits]
    )
    ends = shares.min(axis=0), shares.max(axis=0)
    axes.hlines(rows, *ends, color=plots.INK, linewidth=1, alpha=0.5)
    for split, row, (color, marker) in zip(splits, shares, _styles(splits), strict=True):
        label = f"{split.split}: {split.packs:,} pack{'s' * (split.packs != 1)}"
        axes.plot(row, rows, marker, color=color, markersize=6, label=label)
    shown = f"the {len(names)} most frequent of " if len(names) < len(total) else "all "
    axes.set(
        yticks=rows,
        yticklabels=names,
        ylim=(len(names) - 0.4, -0.6),
        xlim=(-0.02 * shares.max(), 1.05 * shares.max()),
        xlabel="% of items",
        title=f"Categories: {shown}{len(total)}",
    )
