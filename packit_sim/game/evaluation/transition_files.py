"""Files of transitions: their arrays and manifest, read exactly or refused.

A shard is a compressed file of NumPy. The manifest lists the shards with their digests, and says
what shapes their arrays have.
"""

from __future__ import annotations

import hashlib
import io
import math
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from msgspec import Meta, Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import ArgumentError, PackItError, located
from packit_sim.core.files import read_whole
from packit_sim.core.npz_arrays import read_array
from packit_sim.geometry.bits import Words
from packit_sim.geometry.lattice import Triple, box_cells, grid_nodes
from packit_sim.geometry.rotations import COUNT
from packit_sim.geometry.voxels import unpack
from packit_sim.placement import Mask

FORMAT = "packit-transitions"

VERSION = 1

MANIFEST = "manifest.json"

MAX_BYTES = 2**32
"""Most bytes of the arrays of a shard, unpacked."""

MAX_ID = 1024
"""Most characters of a shape's id."""


_Count = Annotated[int, Meta(ge=0)]


class TransitionsError(PackItError, ValueError):
    """A folder that holds no transitions, other ones, or damaged ones."""


@dataclass(frozen=True)
class Transitions:
    """The n steps of a shard, in the order in which they were played; a step places one item.

    Attributes
    ----------
    task, agent : ndarray
        int32 (episodes,), the number of each episode's task in the dataset, and of its agent.
    first : ndarray
        int32 (episodes + 1,), the number of each episode's first step, and n.
    shapes : ndarray
        The ids of all placed shapes.
    shape : ndarray
        int32 (n,), the index of the placed item's shape in `shapes`.
    scale, reward : ndarray
        float64 (n,), the item's scale, and the reward.
    rotation : ndarray
        uint8 (n,), 0 to 23.
    location : ndarray
        int16 (n, 3), the grid node.
    mask : ndarray
        uint8 (n, bytes), the feasible locations of the item in this rotation, see `feasible`.
    occupancy : ndarray
        uint64 (n + episodes, nx, ny, nz), the outer cells of the box in each state, as words.
    heights : ndarray
        int16 (n + episodes, cells x, cells y), the cells from the floor to the top of the highest
        one that is filled. An episode of m steps has m + 1 states, one after the other.
    """

    task: npt.NDArray[np.int32]
    agent: npt.NDArray[np.int32]
    first: npt.NDArray[np.int32]
    shapes: npt.NDArray[np.str_]
    shape: npt.NDArray[np.int32]
    scale: npt.NDArray[np.float64]
    reward: npt.NDArray[np.float64]
    rotation: npt.NDArray[np.uint8]
    location: npt.NDArray[np.int16]
    mask: npt.NDArray[np.uint8]
    occupancy: Words
    heights: npt.NDArray[np.int16]

    def __len__(self) -> int:
        return len(self.scale)

    def episode(self, step: int) -> int:
        """Return the number of a step's episode."""
        return int(np.searchsorted(self.first, step, "right")) - 1

    def state(self, step: int) -> int:
        """Return the index of the state before a step; the one after it is the next."""
        return step + self.episode(step)

    def feasible(self, step: int) -> Mask:
        """Return the exact mask of a step's item: bool over the grid nodes, [x, y, z]."""
        nodes = self.occupancy.shape[1:]
        return np.unpackbits(self.mask[step], count=math.prod(nodes)).astype(bool).reshape(nodes)

    def filled(self, state: int) -> npt.NDArray[np.bool_]:
        """Return the outer cells of the box in a state: bool over its cells."""
        return unpack(self.occupancy[state])


class Shard(Struct, frozen=True):
    """The entry of a shard in the manifest.

    Attributes
    ----------
    number : int
        Its number, which seeds it.
    file : str
        The name of its file in the folder, which follows from its number.
    sha256 : str
        The SHA-256 of the file, in hex.
    """

    number: _Count
    file: str
    sha256: str
    steps: _Count


class TransitionsManifest(Struct, frozen=True):
    """The record of the transitions in a folder.

    Attributes
    ----------
    packit : str
        The version of PackIt-Sim that began it.
    tasks : str
        The SHA-256 of the digests of the tasks, in hex.
    shards : tuple of Shard
        Those that are complete, by their numbers.
    """

    format: str
    version: int
    packit: str
    cells: Triple
    tasks: str
    agents: tuple[str, ...]
    seed: _Count
    episodes: Annotated[int, Meta(ge=1)]
    shards: tuple[Shard, ...] = ()

    @property
    def steps(self) -> int:
        """The number of steps in all shards."""
        return sum(shard.steps for shard in self.shards)

    @classmethod
    def read(cls, folder: Path) -> TransitionsManifest:
        """Read the manifest of a folder.

        Returns
        -------
        TransitionsManifest
            The record.

        Raises
        ------
        TransitionsError
            If there is none, or it is damaged or of another version.
        """
        path = folder / MANIFEST
        try:
            data = read_whole(path)
        except OSError as error:
            raise TransitionsError(f"{folder} holds no transitions: {error.strerror}") from None
        with located(str(path), TransitionsError):
            found = typed_json.decode(data, cls, TransitionsError, "a manifest")
        if (found.format, found.version) != (FORMAT, VERSION):
            raise TransitionsError(
                f"{path} is of format {found.format!r}, version {found.version}: "
                f"this one reads {FORMAT!r}, version {VERSION}"
            )
        try:
            box_cells(found.cells)
        except ArgumentError as error:
            raise TransitionsError(f"{path}: {error}") from None
        if any(shard.file != file_name(shard.number) for shard in found.shards) or any(
            one.number >= other.number for one, other in pairwise(found.shards)
        ):
            raise TransitionsError(f"{path}: its shards are not in order, each with its own name")
        return found


def read_transitions(folder: Path | str) -> Iterator[Transitions]:
    """Read the transitions in a folder, shard by shard.

    Yields
    ------
    Transitions
        A shard.

    Raises
    ------
    TransitionsError
        If the folder holds no transitions, or a file is missing, damaged or not the recorded one.
    """
    folder = Path(folder)
    manifest = TransitionsManifest.read(folder)
    for shard in manifest.shards:
        path = folder / shard.file
        try:
            data = read_whole(path)
        except OSError as error:
            raise TransitionsError(f"{path} can't be read: {error.strerror}") from None
        if hashlib.sha256(data).hexdigest() != shard.sha256:
            raise changed(path)
        with located(path, TransitionsError):
            yield _read(data, manifest, shard)


def _read(data: bytes, manifest: TransitionsManifest, shard: Shard) -> Transitions:
    """Read the file of a shard: its arrays are those that the manifest lets expect."""
    arrays, left = {}, MAX_BYTES
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name, (kinds, shape) in _arrays(manifest, shard.steps).items():
                arrays[name] = read_array(archive, name, kinds, shape, left)
                left -= arrays[name].nbytes
        transitions = Transitions(**arrays)
    except Exception as error:  # numpy and zipfile raise any error for a damaged file
        raise TransitionsError(f"no transitions: {error or type(error).__name__}") from None
    if fault := _fault(transitions):
        raise TransitionsError(fault)
    return transitions


def _fault(found: Transitions) -> str:
    """Return which number of a shard is not possible; empty if none is."""
    first = found.first
    if first[0] != 0 or first[-1] != len(found) or (np.diff(first) < 0).any():
        return "the first steps of its episodes are not in order"
    most = {"shape": len(found.shapes), "rotation": COUNT, "location": found.occupancy.shape[1:]}
    for name, end in {"task": np.inf, "agent": np.inf, **most}.items():
        if not ((numbers := getattr(found, name)) >= 0).all() or (numbers >= end).any():
            return f"{name!r} has a number that is not possible"
    if not (np.isfinite(found.reward) & np.isfinite(found.scale) & (found.scale > 0)).all():
        return "a scale or a reward is not possible"
    return ""


_Form = tuple[tuple[str, ...], tuple[int | None, ...]]
"""The types that an array may have, and its shape."""


def _arrays(manifest: TransitionsManifest, steps: int) -> dict[str, _Form]:
    """Return what the arrays of a shard are."""
    episodes, nodes = manifest.episodes, grid_nodes(manifest.cells)
    states = steps + episodes
    per_step = {"shape": "<i4", "scale": "<f8", "reward": "<f8", "rotation": "|u1"}
    return {
        **dict.fromkeys(("task", "agent"), (("<i4",), (episodes,))),
        "first": (("<i4",), (episodes + 1,)),
        "shapes": (tuple(f"<U{n}" for n in range(1, MAX_ID + 1)), (None,)),
        **{name: ((kind,), (steps,)) for name, kind in per_step.items()},
        "location": (("<i2",), (steps, 3)),
        "mask": (("|u1",), (steps, math.ceil(math.prod(nodes) / 8))),
        "occupancy": (("<u8",), (states, *nodes)),
        "heights": (("<i2",), (states, *manifest.cells[:2])),
    }


def changed(path: Path) -> TransitionsError:
    """Return the error of a shard that is not the recorded one."""
    return TransitionsError(f"{path} is not the file that the manifest records: its digest differs")


def file_name(number: int) -> str:
    """Return the name of the file of a shard."""
    return f"{number:06d}.npz"
