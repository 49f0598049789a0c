"""Uploads: the mesh files that a page has sent, in a dedicated folder."""

from __future__ import annotations

import itertools
import shutil
from dataclasses import dataclass
from io import BufferedIOBase
from pathlib import Path, PurePosixPath, PureWindowsPath

from packit_sim.core.errors import ArgumentError
from packit_sim.core.files import replacing
from packit_sim.core.length_units import Unit
from packit_sim.core.plain_text import plain_line
from packit_sim.libraries.mesh_files import SUFFIXES
from packit_sim.parts.reading.files import ReadSettings, find_parts, with_own_names
from packit_sim.parts.reading.part import Part

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
        self.files: dict[int, Upload] = {}

    def add(self, name: str, body: BufferedIOBase, length: int, unit: Unit) -> Upload:
        """Keep a file, if parts can be read from it.

        Parameters
        ----------
        name : str
            Its name; folders in it are dropped.
        body : binary file
            Its content.
        length : int
            How many bytes it has.
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
        if len(self.files) >= MAX_FILES:
            raise ArgumentError(f"{name}: there are {MAX_FILES} files already")
        together = sum(each.file.stat().st_size for each in self.files.values())
        if length > MAX_BYTES or together + length > MAX_BYTES_TOGETHER:
            raise ArgumentError(
                f"{name}: too large: at most {MAX_BYTES:,} bytes, and {MAX_BYTES_TOGETHER:,} "
                "of all files together"
            )
        number = next(self._numbers)
        file = self._folder / str(number) / name
        try:
            file.parent.mkdir(parents=True)
            with replacing(file) as target:
                left = length
                while left and (data := body.read(min(left, _CHUNK))):
                    target.write(data)
                    left -= len(data)
                if left:
                    raise ArgumentError(f"{name}: it was not sent completely")
            parts = find_parts([file], ReadSettings(unit)).parts
            others = [part.name for each in list(self.files.values()) for part in each.parts]
            upload = Upload(number, file, unit, tuple(with_own_names(parts, others)))
            self.files[number] = upload
            return upload
        except ArgumentError as error:
            sentence = str(error).replace(str(file), name)
            raise ArgumentError(sentence.removeprefix("no part can be read: ")) from None
        finally:
            if number not in self.files:
                shutil.rmtree(file.parent, ignore_errors=True)

    def remove(self, number: int) -> None:
        """Forget a file; raise ArgumentError if there is none with this number."""
        upload = self.files.pop(number, None)
        if upload is None:
            raise ArgumentError(f"there is no file {number}")
        shutil.rmtree(upload.file.parent, ignore_errors=True)
