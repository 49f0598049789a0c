"""Statistics of datasets, split by split."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from packit_sim.core.confidence import Estimate
from packit_sim.core.errors import PackFormatError
from packit_sim.game.datasets.pack_files import dataset_files, read_packs
from packit_sim.game.datasets.packs import Pack
from packit_sim.game.datasets.provenance import Evolved, Sampled
from packit_sim.geometry import rotations
from packit_sim.geometry.arrays import Floats, Ints
from packit_sim.geometry.lattice import CELLS_PER_UNIT
from packit_sim.libraries.library import ShapeLibrary

MAX_CATEGORIES = 5
"""Number of categories that `DatasetStatistics.rows` names."""

MAX_SCALES = 8
"""Number of scales that `DatasetStatistics.rows` lists one by one."""

DIGITS = 6
"""Significant digits to which scales must agree to count as one: rounding of products."""

UPRIGHT_ROTATIONS = rotations.COUNT // 6
"""Number of rotations, the first ones, that keep the canonical shape upright."""


@dataclass(frozen=True)
class Summary:
    """The distribution of a number over packs.

    Attributes
    ----------
    mean : Estimate
        The mean, with its 95% interval.
    minimum : float
        The smallest value.
    maximum : float
        The largest value.
    """

    mean: Estimate
    median: float
    minimum: float
    maximum: float

    @classmethod
    def of(cls, values: npt.NDArray[Any]) -> Summary:
        """Summarise one value or more."""
        return cls(
            Estimate.of(values), float(np.median(values)), float(values.min()), float(values.max())
        )


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """The statistics of all packs of a split, even if some share an evolution.

    Attributes
    ----------
    split : str
        The name of the split.
    items : ndarray of int64, shape (packs,)
        The number of items of each pack.
    densities : ndarray of float64, shape (packs,)
        The density of each pack.
    generations : ndarray of int64
        The generation in which each pack was found, of the packs that record it.
    sizes : ndarray of float64
        The linear size factor of each pack, of the packs that record it.
    volumes : ndarray of float64, shape (items,)
        The volume of each item, as a share of the box.
    scales : Counter of float
        Items by their scale before the size factor, most frequent first.
    shapes : Counter of str
        Items by the id of their shape, most frequent first.
    categories : Counter of str
        Items by category, most frequent first.
    rotations : ndarray of int64, shape (24,)
        The number of items in each rotation.
    """

    split: str
    items: Ints
    densities: Floats
    generations: Ints
    sizes: Floats
    volumes: Floats
    scales: Counter[float]
    shapes: Counter[str]
    categories: Counter[str]
    rotations: Ints

    @classmethod
    def of(cls, split: str, packs: Sequence[Pack], library: ShapeLibrary) -> DatasetStatistics:
        """Compute the statistics of packs.

        Parameters
        ----------
        split : str
            The name of the split.

        Returns
        -------
        DatasetStatistics
            The statistics.

        Raises
        ------
        PackFormatError
            If the packs are of another library, or all of them are empty.
        UnknownShapeError
            If the library does not have a shape.
        """
        volumes = [
            placed.item.volume / (math.prod(pack.cells) / CELLS_PER_UNIT**3)
            for pack in packs
            for placed in pack.placed(library)
        ]
        if not volumes:
            raise PackFormatError(f"the packs of {split!r} hold no items: nothing can be counted")
        items = [(pack, item) for pack in packs for item in pack.items]
        turned = np.bincount([item.rotation for _, item in items], minlength=rotations.COUNT)
        categories = library.source.categories
        evolved = [pack.provenance for pack in packs if isinstance(pack.provenance, Evolved)]
        sizes = [_size(pack) for pack in packs]
        return cls(
            split,
            items=np.array([len(pack.items) for pack in packs]),
            densities=np.array([pack.density for pack in packs]),
            generations=np.array([e.generation for e in evolved], dtype=np.int64),
            sizes=np.array([s for s in sizes if s is not None], dtype=np.float64),
            volumes=np.array(volumes),
            scales=_ranked(
                _rounded(item.scale / (_size(pack) or 1.0) ** 3) for pack, item in items
            ),
            shapes=_ranked(item.shape for _, item in items),
            categories=_ranked(categories[item.shape] for _, item in items),
            rotations=turned,
        )

    @property
    def packs(self) -> int:
        """The number of packs."""
        return len(self.items)

    def spreads(self) -> dict[str, Summary]:
        """Summarise the numbers that the packs record, by name."""
        values = {
            "items a pack": self.items,
            "density": self.densities,
            "generation": self.generations,
            "size factor": self.sizes,
        }
        return {name: Summary.of(found) for name, found in values.items() if len(found)}

    def volume_quantiles(self) -> dict[str, float]:
        """Compute quantiles of the items' shares of the box: 0, 10, 50, 90 and 100%."""
        shares = {"least": 0.0, "10%": 0.1, "median": 0.5, "90%": 0.9, "most": 1.0}
        return {name: float(np.quantile(self.volumes, q)) for name, q in shares.items()}

    def rows(self) -> dict[str, str]:
        """Return a column of a dataset's table: text by the heading of its row."""
        total = len(self.volumes)
        rows = {"packs": f"{self.packs:,}", "items": f"{total:,}"}
        for name, spread in self.spreads().items():
            counted = name in ("items a pack", "generation")
            mean, other = (".1f", "g") if counted else (".3f", ".3f")
            rows[f"{name}: mean"] = format(spread.mean.mean, mean)
            if spread.mean.low is not None and spread.mean.high is not None:
                ends = f"{spread.mean.low:{mean}} to {spread.mean.high:{mean}}"
                rows[f"{name}: 95% interval"] = ends
            rows[f"{name}: median"] = format(spread.median, other)
            rows[f"{name}: range"] = f"{spread.minimum:{other}} to {spread.maximum:{other}}"
        shares = {name: _percent(share) for name, share in self.volume_quantiles().items()}
        rows["item volume: median"] = shares["median"]
        rows["item volume: 10% to 90%"] = f"{shares['10%']} to {shares['90%']}"
        rows["item volume: range"] = f"{shares['least']} to {shares['most']}"
        if len(self.scales) <= MAX_SCALES:
            for scale in sorted(self.scales):
                rows[f"items of scale {scale:g}"] = f"{self.scales[scale] / total:.0%}"
        else:
            ends = f"{min(self.scales):g} to {max(self.scales):g}"
            rows["scales"] = f"{len(self.scales)}: {ends}"
        rows["different shapes"] = str(len(self.shapes))
        rows["categories"] = str(len(self.categories))
        rows["most frequent"] = "\n".join(
            f"{name} {count / total:.1%}"
            for name, count in self.categories.most_common(MAX_CATEGORIES)
        )
        rows["rotations in use"] = f"{np.count_nonzero(self.rotations)} of {rotations.COUNT}"
        rows["items upright"] = f"{self.rotations[:UPRIGHT_ROTATIONS].sum() / total:.0%}"
        return rows

    def to_json(self) -> dict[str, Any]:
        """Return the content of `rows` and the whole counts, in JSON's types."""
        return {
            "packs": self.packs,
            "items": len(self.volumes),
            **{name: asdict(spread) for name, spread in self.spreads().items()},
            "item volume, share of the box": self.volume_quantiles(),
            "items by scale": {f"{scale:g}": self.scales[scale] for scale in sorted(self.scales)},
            "items by category": dict(self.categories),
            "items by shape": dict(self.shapes),
            "items by rotation": self.rotations.tolist(),
        }


def take(
    source: Path | str, library: ShapeLibrary, split: str | None = None
) -> tuple[DatasetStatistics, ...]:
    """Compute the statistics of each split of a dataset, or of one (see `dataset_files`)."""
    return tuple(
        DatasetStatistics.of(file.stem, read_packs(file), library)
        for file in dataset_files(source, split)
    )


def _size(pack: Pack) -> float | None:
    """Return the linear size factor on all items of a pack, if it is recorded."""
    return pack.provenance.size if isinstance(pack.provenance, Evolved | Sampled) else None


def _rounded(scale: float) -> float:
    return float(f"{scale:.{DIGITS}g}")


def _ranked(things: Any) -> Counter[Any]:
    """Count values, the most frequent first, ties by name."""
    return Counter(dict(sorted(Counter(things).items(), key=lambda entry: (-entry[1], entry[0]))))


def _percent(share: float) -> str:
    """Format a share in percent, with two significant digits."""
    return f"{100 * share:.0f}%" if share >= 0.1 else f"{100 * share:.2g}%"
