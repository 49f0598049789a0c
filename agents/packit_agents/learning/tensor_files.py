"""Files of float32 tensors with metadata, as safetensors: numbers and text, no code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from packit_sim.core.errors import PackItError
from packit_sim.core.files import replacing


class TensorFileError(PackItError, ValueError):
    """A file that does not hold the weights that are read."""


Tensors = dict[str, npt.NDArray[np.float32]]


def write_tensors(
    path: Path, format: str, tensors: Mapping[str, npt.NDArray[np.float32]], **metadata: Any
) -> None:
    """Write tensors to a file, atomically.

    Parameters
    ----------
    format : str
        The name of what they are, by which `read_tensors` knows them.
    **metadata
        Values in JSON's types.
    """
    texts = {name: json.dumps(value) for name, value in metadata.items()}
    with replacing(path) as file:
        file.write(save(dict(tensors), {"format": format, **texts}))


def read_tensors(path: Path, format: str) -> tuple[Tensors, dict[str, str]]:
    """Read the tensors of a file.

    Returns
    -------
    tensors : dict of str to ndarray
        The tensors.
    metadata : dict of str to str
        The metadata, as JSON.

    Raises
    ------
    TensorFileError
        If the file is missing, damaged or of another format, or holds anything but finite float32
        numbers.
    """
    if not path.is_file():
        raise TensorFileError(f"there are no weights at {path}")
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            kinds = {name: file.get_slice(name).get_dtype() for name in file.keys()}  # noqa: SIM118
            found = {name: file.get_tensor(name) for name, kind in kinds.items() if kind == "F32"}
    except (SafetensorError, OSError) as problem:
        raise TensorFileError(f"{path} holds no weights, or is damaged: {problem}") from None
    if metadata.get("format") != format:
        raise TensorFileError(
            f"{path} is of format {metadata.get('format')!r}: this agent reads {format!r}"
        )
    for name in kinds:
        if name not in found or not np.isfinite(found[name]).all():
            raise TensorFileError(f"{path}: {name!r} holds no finite float32 numbers")
    return found, metadata


def tensors_digest(tensors: Mapping[str, npt.NDArray[np.float32]]) -> str:
    """Return 16 hex digits, equal for equal tensors."""
    sha = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        sha.update(f"{name} {tensor.shape}\n".encode())
        sha.update(np.ascontiguousarray(tensor, dtype="<f4").tobytes())
    return sha.hexdigest()[:16]
