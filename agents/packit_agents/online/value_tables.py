"""Values of states: the sum of tables of the heights of a few neighbouring columns.

Such sums of tables, *n-tuple networks*, learn by temporal differences within minutes: they play
2048 (Szubert and Jaskowski, 2014).
"""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from packit_agents.learning.tensor_files import (
    TensorFileError,
    read_tensors,
    tensors_digest,
    write_tensors,
)
from packit_agents.online.columns import ColumnGame
from packit_sim.core import typed_json
from packit_sim.core.caches import cached_property
from packit_sim.core.errors import located
from packit_sim.geometry.lattice import Triple

FORMAT = "packit-column-values"

_LINE_ENTRIES = 10_000
"""Entries of the table of a line of columns, at most, which determine its length."""

_NAME = re.compile(r"buffer ([1-9][0-9]{0,3})")
"""The name of a tensor, with the size of the buffer."""

Table = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Patterns:
    """The columns that are looked up together: squares of 2 x 2, and lines along x and y.

    Patterns that a turn of the box makes equal share a table.

    Attributes
    ----------
    columns : ndarray
        int64 (patterns, size), the columns of each; -1 after the last.
    starts : ndarray
        int64 (patterns,), the first entry of its table.
    entries : int
        Entries of all tables.
    levels : int
        Heights that a column may have.
    """

    columns: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    entries: int
    levels: int

    @cached_property
    def users(self) -> npt.NDArray[np.int64]:
        """The patterns of each column, and by how much its height moves their entry.

        int64 (columns, n, 2); -1 after the last.
        """
        found = defaultdict(list)
        for pattern, own in enumerate(self.columns.tolist()):
            members = [column for column in own if column >= 0]
            for place, column in enumerate(reversed(members)):
                found[column].append((pattern, self.levels**place))
        most = max(map(len, found.values()))
        return np.array(
            [found[column] + [(-1, 0)] * (most - len(found[column])) for column in sorted(found)]
        )

    def arrays(self, entries: npt.NDArray[np.float64]) -> tuple[npt.NDArray[Any], ...]:
        """Return the patterns as kernels take them, with the entries of their tables."""
        return self.columns, self.users, self.starts, entries

    @classmethod
    def of(cls, sides: Triple) -> Self:
        """List the patterns of a box."""
        x, y, levels = sides[0], sides[1], sides[2] + 1
        length = max(n for n in range(1, 6) if levels**n <= _LINE_ENTRIES)
        blocks = ((2, 2), (1, min(length, y)), (min(length, x), 1))
        columns, starts, entries = [], [], 0
        known = set()
        for along_x, along_y in blocks:
            for left, front in itertools.product(range(x - along_x + 1), range(y - along_y + 1)):
                pattern = [(left + i, front + j) for i in range(along_x) for j in range(along_y)]
                if frozenset(pattern) in known:
                    continue
                for _ in range(4 if x == y else 2):
                    known.add(frozenset(pattern))
                    columns.append([i * y + j for i, j in pattern])
                    starts.append(entries)
                    if x == y:
                        pattern = [(j, x - 1 - i) for i, j in pattern]
                    else:
                        pattern = [(x - 1 - i, y - 1 - j) for i, j in pattern]
                entries += levels ** len(pattern)
        size = max(map(len, columns))
        padded = [own + [-1] * (size - len(own)) for own in columns]
        return cls(np.array(padded), np.array(starts), entries, levels)


@dataclass(frozen=True, eq=False)
class ValueTables:
    """The value of each state of a game, for buffers of several sizes.

    Attributes
    ----------
    game : ColumnGame
        The game.
    buffers : mapping of int to ndarray
        float32 (entries,) by the size of the buffer.
    provenance : mapping
        The record of their training, in JSON's types.
    """

    game: ColumnGame
    buffers: Mapping[int, Table]
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def patterns(self) -> Patterns:
        """The patterns whose tables are summed."""
        return Patterns.of(self.game.sides)

    @property
    def digest(self) -> str:
        """16 hex digits, equal for equal tables."""
        return tensors_digest(self._tensors)

    def arrays(self, buffer: int) -> tuple[npt.NDArray[Any], ...]:
        """Return the tables for a buffer as kernels take them.

        They are those of the largest buffer that is not larger, or else of the smallest.
        """
        known = max((one for one in self.buffers if one <= buffer), default=min(self.buffers))
        return self.patterns.arrays(self.buffers[known].astype(np.float64))

    def write(self, path: Path) -> None:
        """Write the tables to a file of safetensors, atomically."""
        write_tensors(
            path, FORMAT, self._tensors, game=asdict(self.game), provenance=self.provenance
        )

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read tables.

        Returns
        -------
        ValueTables
            The tables.

        Raises
        ------
        TensorFileError
            If the file holds no such tables, or is damaged.
        """
        tensors, metadata = read_tensors(path, FORMAT)
        with located(f"{path} has metadata that are damaged", TensorFileError):
            game = typed_json.decode(metadata.get("game", ""), ColumnGame, TensorFileError, "game")
            provenance = typed_json.decode(
                metadata.get("provenance", ""), dict[str, Any], TensorFileError, "provenance"
            )
        entries = cls(game, {}).patterns.entries
        buffers = {}
        for name, tensor in tensors.items():
            size = _NAME.fullmatch(name)
            if size is None or tensor.shape != (entries,):
                raise TensorFileError(
                    f"{path} holds {name!r} of shape {tensor.shape}: tables are named 'buffer N' "
                    f"and have {entries} entries"
                )
            buffers[int(size[1])] = tensor
        if not buffers:
            raise TensorFileError(f"{path} holds no tables")
        return cls(game, buffers, provenance)

    @property
    def _tensors(self) -> dict[str, Table]:
        return {f"buffer {size}": own for size, own in self.buffers.items()}
