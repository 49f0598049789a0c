"""Weights of networks as safetensors, with the settings that rebuild the network; no code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import nn

from packit_agents.learning.networks import NetworkSettings, network
from packit_sim.core.errors import PackItError
from packit_sim.core.files import replacing
from packit_sim.rules import Rules

FORMAT = "packit-network"
VERSION = 2

SB3_FORMAT = "packit-sb3-policy"
"""The format of policies of stable-baselines3 (see `sb3_weights`)."""

_CONTRADICTIONS = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""Errors raised by foreign metadata."""


class WeightsError(PackItError, ValueError):
    """A file that holds no weights that this version can load."""


def write_weights(
    path: Path,
    net: nn.Module,
    settings: NetworkSettings,
    placement_features: int,
    provenance: Mapping[str, Any],
) -> None:
    """Write a network atomically.

    Parameters
    ----------
    net : torch.nn.Module
        The network.
    placement_features : int
        Number of placement features that it observes.
    provenance : mapping
        The record of its training, in JSON's types.
    """
    metadata = {
        "format": FORMAT,
        "version": str(VERSION),
        "network": json.dumps(asdict(settings)),
        "placement_features": str(placement_features),
        "provenance": json.dumps(provenance),
    }
    tensors = {name: tensor.cpu().contiguous() for name, tensor in net.state_dict().items()}
    with replacing(path) as file:
        file.write(save(tensors, metadata))


def weights_digest(net: nn.Module) -> str:
    """Compute the digest of a network's tensors: their names, types, shapes and values.

    Parameters
    ----------
    net : torch.nn.Module
        The network.

    Returns
    -------
    str
        16 hex digits, the same for every file with these tensors.
    """
    sha = hashlib.sha256()
    for name, tensor in sorted(net.state_dict().items()):
        sha.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        sha.update(tensor.cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes())
    return sha.hexdigest()[:16]


def read_weights(path: Path) -> tuple[nn.Module, int, dict[str, Any]]:
    """Read a network.

    Parameters
    ----------
    path : Path
        The file, of this version or of version 1.

    Returns
    -------
    net : torch.nn.Module
        The network, in evaluation mode, without gradients.
    placement_features : int
        Number of placement features that it observes.
    provenance : dict
        The record of its training.

    Raises
    ------
    WeightsError
        If the file holds no weights of these versions, or is damaged.
    """
    metadata, tensors = read_tensors(path)
    return network_of(path, metadata, tensors)


def read_tensors(path: Path) -> tuple[dict[str, str], dict[str, torch.Tensor]]:
    """Read the metadata and the tensors of a file; errors are those of `read_weights`."""
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError:
        raise WeightsError(f"there are no weights at {path}") from None
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} holds no weights, or is damaged: {error}") from None
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise WeightsError(f"{path}: tensor {name!r} holds numbers that are not finite")
    return metadata, tensors


def network_of(
    path: Path, metadata: Mapping[str, str], tensors: Mapping[str, torch.Tensor]
) -> tuple[nn.Module, int, dict[str, Any]]:
    """Build the network of a file's metadata and tensors, as `read_weights` returns it."""
    if metadata.get("format") != FORMAT or metadata.get("version") not in ("1", str(VERSION)):
        raise WeightsError(
            f"{path} is of format {metadata.get('format')!r}, version {metadata.get('version')!r}: "
            f"this one reads {FORMAT!r}, versions '1' and '{VERSION}'"
        )
    try:
        if metadata["version"] == "1":
            metadata = _from_version_1(metadata)
        provenance = json.loads(metadata["provenance"])
        placement_features = int(metadata["placement_features"])
        settings = NetworkSettings(**json.loads(metadata["network"]))
        blocks = settings.encoder_blocks + settings.trunk_blocks
        if blocks > len(tensors):
            raise ValueError(f"{blocks} blocks have more than {len(tensors)} tensors")
        with torch.device("meta"):  # shapes without memory
            expected = network(settings, placement_features).state_dict()
        check_shapes(tensors, expected, ValueError)
        net = network(settings, placement_features)
        net.load_state_dict(tensors)
    except _CONTRADICTIONS as error:
        raise WeightsError(f"{path} contradicts its own metadata: {error}") from None
    return net.eval().requires_grad_(False), placement_features, provenance


def check_shapes(
    tensors: Mapping[str, torch.Tensor],
    expected: Mapping[str, torch.Tensor],
    error: type[Exception],
) -> None:
    """Raise an error of the given type if tensors differ from the expected ones in a shape."""
    if expected.keys() != tensors.keys():
        name = min(expected.keys() ^ tensors.keys())
        raise error(f"tensor {name!r} is {'missing' if name in expected else 'unknown'}")
    for name, tensor in tensors.items():
        if tensor.shape != expected[name].shape:
            shapes = tuple(tensor.shape), tuple(expected[name].shape)
            raise error(f"tensor {name!r} has the shape {shapes[0]}, not {shapes[1]}")


def _from_version_1(metadata: Mapping[str, str]) -> dict[str, str]:
    """Metadata of version 2 from that of version 1."""
    fields, provenance = json.loads(metadata["network"]), json.loads(metadata["made"])
    settings = provenance.get("settings")
    if settings:
        if "easy" in settings:
            settings["rules"] = asdict(Rules(easy=settings.pop("easy")))
        if "regrets" in settings:
            settings["costs"] = settings.pop("regrets")
        if settings.get("observation") == "prospects":
            settings["observation"] = "placement-features"
    for stored in (fields, (settings or {}).get("network", {})):
        stored.pop("heads", None)  # of a network that was removed
    return {
        "network": json.dumps(fields),
        "placement_features": metadata.get("placement_features", metadata.get("prospects", "none")),
        "provenance": json.dumps(provenance),
    }
