"""The subset of Minari's format that recordings use, and checks before Minari reads a file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from packit_sim.core import typed_json
from packit_sim.core.errors import PackItError
from packit_sim.core.extras import needed_for
from packit_sim.core.files import read_whole
from packit_sim.game.datasets.provenance import Count

MAX_COMPRESSION = 1032
"""Maximum bytes of an array per byte of its file: deflate can't compress more."""

MAX_EPISODES = 10**7
"""Maximum number of episodes of a recording: Minari lists their numbers."""

CHUNK_BYTES = 1_000_000
"""Approximate bytes of an array that are compressed together; at least one step."""

GZIP_LEVEL = 4
"""Compression level. For features, level 1 takes 40% more space and 20% less time, level 9 12% less
space and 2.5 times as long."""

_METADATA, _DATA = "metadata.json", "main_data.hdf5"


class RecordingError(PackItError, ValueError):
    """A recording that can't be written or read, or does not replay."""


class _Metadata(Struct):
    """The fields of a recording's metadata on which reading depends."""

    observation_space: str
    action_space: str
    data_format: Literal["hdf5"]
    total_episodes: Annotated[int, Meta(ge=0, le=MAX_EPISODES)]
    total_steps: Count


@contextmanager
def readable(where: object) -> Iterator[None]:
    """Raise RecordingError for any error that a damaged recording makes its readers raise."""
    try:
        yield
    except PackItError:
        raise
    except Exception as error:  # Minari, Gymnasium and h5py raise any error for a damaged file
        problem = str(error) or type(error).__name__
        raise RecordingError(f"{where} can't be read as a recording: {problem}") from error


class Minari:
    """The parts of Minari and h5py that are used.

    Raises
    ------
    MissingPackageError
        If one of them is not installed.
    """

    def __init__(self) -> None:
        with needed_for("recordings"):
            import h5py
            import minari
            from minari.data_collector.episode_buffer import EpisodeBuffer
            from minari.dataset.minari_storage import MinariStorage
        self.version: str = minari.__version__
        self._dataset = minari.MinariDataset
        self.buffer = EpisodeBuffer
        self.storage = MinariStorage
        self._h5py = h5py

    def opened(self, folder: Path) -> Any:
        """Open a recording, after checks that it is one that Minari can read without harm.

        Parameters
        ----------
        folder : Path
            The folder of the recording.

        Returns
        -------
        minari.MinariDataset
            The recording.

        Raises
        ------
        RecordingError
            If it is damaged, refers to other files, or needs more memory than its size allows; or
            if its spaces are missing: Minari would then create the environment that it names,
            which may run any function.
        """
        with readable(folder):
            data = read_whole(folder / _METADATA)
            typed_json.decode(data, _Metadata, RecordingError, "the metadata")
            file = folder / _DATA
            with self._h5py.File(file, "r") as content:
                self._check(content, MAX_COMPRESSION * file.stat().st_size, {content})
            return self._dataset(folder)

    def _check(self, group: Any, max_bytes: int, known: set[Any]) -> None:
        """Raise RecordingError if arrays are larger than `max_bytes` bytes or not in this file.

        A group that is linked twice may contain itself, and reading would not end.
        """
        for name in group:
            where = f"{group.name}/{name}"
            if not isinstance(group.get(name, getlink=True), self._h5py.HardLink):
                raise RecordingError(f"{where!r} is a link")
            part = group[name]
            if part in known:
                raise RecordingError(f"{where!r} is linked twice")
            known.add(part)
            if isinstance(part, self._h5py.Group):
                self._check(part, max_bytes, known)
            elif not isinstance(part, self._h5py.Dataset):
                raise RecordingError(f"{where!r} is not an array")
            elif part.external or part.is_virtual:
                raise RecordingError(f"{where!r} is in another file")
            elif part.dtype.hasobject or part.nbytes > max_bytes:
                raise RecordingError(f"{where!r} would take {part.nbytes:,} bytes")

    def allocate(self, folder: Path, episode: int, observation: Any, count: int) -> None:
        """Create compressed arrays for a number of observations, to which Minari appends."""
        (path,) = folder.glob("*.hdf5")
        with self._h5py.File(path, "a", track_order=True) as file:
            self._create(
                file.create_group(f"episode_{episode}"), "observations", observation, count
            )

    def _create(self, group: Any, name: str, part: Any, count: int) -> None:
        if isinstance(part, dict):
            inside = group.create_group(name)
            for key, value in part.items():
                self._create(inside, key, value, count)
            return
        array = np.asarray(part)
        group.create_dataset(
            name,
            shape=(0, *array.shape),
            maxshape=(None, *array.shape),
            dtype=array.dtype,
            chunks=(min(max(1, CHUNK_BYTES // max(1, array.nbytes)), count), *array.shape),
            compression="gzip",
            compression_opts=GZIP_LEVEL,
            shuffle=True,
        )
