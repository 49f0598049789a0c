"""Uploads: the mesh files that a page has sent, in a dedicated folder."""

from __future__ import annotations

import itertools
import shutil
import threading
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath

from packit_sim.core.caches import cached_property
from packit_sim.core.errors import ArgumentError
from packit_sim.core.length_units import Unit
from packit_sim.core.plain_text import plain_line
from packit_sim.geometry.shapes import Shape
from packit_sim.libraries.mesh_files import SUFFIXES
from packit_sim.parts.reading.files import (
    ReadSettings,
    defines_unit,
    find_parts,
    with_own_names,
)
from packit_sim.parts.reading.part import Part
from packit_sim.parts.workbench.preview import upright_shape
from packit_sim.web.http_server import RequestBody

MAX_BYTES = 256 * 2**20
"""The largest file."""

MAX_FILES = 500

MAX_BYTES_TOGETHER = 2 * 2**30

_MAX_NAME = 200
"""Most bytes of a file's name; file systems allow 255, with what temporary files add."""

_CHUNK = 2**20


@dataclass(frozen=True, eq=False)
class Upload:
    """A file that was sent.

    Attributes
    ----------
    file : Path
        Where it is.
    unit : str
        The unit of length in which it is read if it does not define one.
    """

    number: int
    file: Path
    unit: Unit
    parts: tuple[Part, ...]

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """The shapes of the parts, for the preview."""
        return tuple(upright_shape(part) for part in self.parts)

    @property
    def has_own_unit(self) -> bool:
        """True if the file defines its unit."""
        return defines_unit(self.file)


class Uploads:
    """The files that were sent and can be read.

    Parameters
    ----------
    folder : Path
        Where they are kept.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._numbers = itertools.count(1)
        self._reading = threading.Lock()  # one file at a time: their meshes need memory
        self._changing = threading.Lock()
        self._bytes: dict[int, int] = {}  # of files on the disk, also while they are being sent
        self._users: Counter[int] = Counter()
        self.files: dict[int, Upload] = {}

    def add(self, name: str, body: RequestBody, unit: Unit) -> Upload:
        """Keep a file, if parts can be read from it.

        Parameters
        ----------
        name : str
            Its name; folders in it are dropped.
        body : RequestBody
            Its content.
        unit : str
            The unit of length if it does not define one.

        Returns
        -------
        Upload
            The file.

        Raises
        ------
        ArgumentError
            If it is no mesh file, is too large, or can't be read.
        """
        name = PureWindowsPath(PurePosixPath(plain_line(name)).name).name
        if len(name.encode()) > _MAX_NAME:
            raise ArgumentError(f"{name:.40}: a name has at most {_MAX_NAME} bytes")
        suffix = PurePosixPath(name).suffix.lower()
        if suffix not in SUFFIXES:
            raise ArgumentError(f"{name}: choose a mesh file ({', '.join(SUFFIXES)})")
        number = self._reserve(name, body.left)
        file = self._folder / str(number) / name
        try:
            _receive(file, body)
            return self._read(number, file, unit)
        except BaseException as error:
            self._delete(number)
            if isinstance(error, ArgumentError):
                sentence = str(error).replace(str(file), name)
                raise ArgumentError(sentence.removeprefix("no part can be read: ")) from None
            raise

    def read_in(self, number: int, unit: Unit) -> None:
        """Read a file again, in another unit; raise ArgumentError if that is not possible."""
        with self.kept([number]) as (upload,), self._reading:
            parts = find_parts([upload.file], ReadSettings(unit)).parts
            own = [
                replace(new, name=old.name) for new, old in zip(parts, upload.parts, strict=True)
            ]
            with self._changing:
                if number in self.files:
                    self.files[number] = replace(upload, unit=unit, parts=tuple(own))

    def remove(self, number: int) -> None:
        """Forget a file; raise ArgumentError if there is none with this number."""
        with self._changing:
            if self.files.pop(number, None) is None:
                raise ArgumentError(f"there is no file {number}")
            is_used = self._users[number] > 0
        if not is_used:
            self._delete(number)

    @contextmanager
    def kept(self, numbers: Collection[int]) -> Iterator[list[Upload]]:
        """Keep files on the disk while the block runs, even those that are removed meanwhile.

        Parameters
        ----------
        numbers : collection of int
            Their numbers.

        Yields
        ------
        list of Upload
            The files.

        Raises
        ------
        ArgumentError
            If there is no file with one of the numbers.
        """
        with self._changing:
            for number in numbers:
                if number not in self.files:
                    raise ArgumentError(f"there is no file {number}")
            found = [self.files[number] for number in numbers]
            self._users.update(numbers)
        try:
            yield found
        finally:
            with self._changing:
                self._users.subtract(numbers)
                gone = {n for n in numbers if not self._users[n] and n not in self.files}
            for number in gone:
                self._delete(number)

    def _reserve(self, name: str, size: int) -> int:
        """Return the number of a file to come, for which there is space until it is deleted."""
        with self._changing:
            if len(self._bytes) >= MAX_FILES:
                raise ArgumentError(f"{name}: there are {MAX_FILES} files already")
            together = sum(self._bytes.values()) + size
            if size > MAX_BYTES or together > MAX_BYTES_TOGETHER:
                raise ArgumentError(
                    f"{name}: too large: at most {MAX_BYTES:,} bytes, and {MAX_BYTES_TOGETHER:,} "
                    "of all files together"
                )
            number = next(self._numbers)
            self._bytes[number] = size
            return number

    def _read(self, number: int, file: Path, unit: Unit) -> Upload:
        """Read the parts of a file, and keep it."""
        with self._reading:
            parts = find_parts([file], ReadSettings(unit)).parts
            with self._changing:
                others = [part.name for each in self.files.values() for part in each.parts]
                upload = Upload(number, file, unit, tuple(with_own_names(parts, others)))
                self.files[number] = upload
        return upload

    def _delete(self, number: int) -> None:
        """Delete a file, and free its space."""
        shutil.rmtree(self._folder / str(number), ignore_errors=True)
        with self._changing:
            self._bytes.pop(number, None)
            self._users.pop(number, None)


def _receive(file: Path, body: RequestBody) -> None:
    """Write a file that is being sent."""
    try:
        file.parent.mkdir()
        with open(file, "xb") as target:
            while data := body.read(_CHUNK):
                target.write(data)
    except (ConnectionError, TimeoutError):
        raise
    except OSError as error:
        raise ArgumentError(f"{file.name}: it can't be kept: {error.strerror}") from None
    if body.left:
        raise ArgumentError(f"{file.name}: it was not sent completely")
