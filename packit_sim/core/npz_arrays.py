"""Arrays in NumPy archives (.npz) of strangers: types, shapes and sizes are known beforehand."""

from __future__ import annotations

import math
from typing import Any
from zipfile import ZipFile

import numpy as np
import numpy.typing as npt


def read_array(
    archive: ZipFile,
    name: str,
    kinds: tuple[str, ...],
    shape: tuple[int | None, ...],
    max_bytes: int,
) -> npt.NDArray[Any]:
    """Read an array of an archive, without pickles.

    Parameters
    ----------
    kinds : tuple of str
        The types that it may have, such as "<f8".
    shape : tuple of int or None
        Its shape; None is any length.
    max_bytes : int
        The largest size: no more memory is taken, whatever the file says.

    Returns
    -------
    ndarray
        The array, read-only.

    Raises
    ------
    Exception
        If there is no such array; numpy and zipfile raise any error for a damaged file.
    """
    with archive.open(f"{name}.npy") as member:
        if np.lib.format.read_magic(member) != (1, 0):
            raise ValueError(f"{name!r} has another version of numpy's format")
        lengths, by_columns, kind = np.lib.format.read_array_header_1_0(member)
        fits = len(lengths) == len(shape) and all(
            length >= 0 and known in (None, length)  # a negative one would read all
            for known, length in zip(shape, lengths, strict=True)
        )
        if kind.str not in kinds or not fits or by_columns:
            raise ValueError(f"{name!r} is {kind} of shape {lengths}")
        size = math.prod(lengths) * kind.itemsize
        if size > max_bytes:
            raise ValueError(
                f"{name!r} would take {size:,} bytes: at most {max_bytes:,} are possible"
            )
        data = member.read(size + 1)  # to the end, where the checksum is compared
    if len(data) != size:
        raise ValueError(f"{name!r} does not have the {size:,} bytes of its shape {lengths}")
    return np.frombuffer(data, kind).reshape(lengths)
