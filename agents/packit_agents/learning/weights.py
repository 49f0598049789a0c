"""Weights of networks as safetensors, with what it takes to build the network: data, never code."""

from __future__ import annotations

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
VERSION = 1


class WeightsError(PackItError, ValueError):
    """A file that holds no weights that this version can load."""


def write_weights(
    path: Path,
    net: nn.Module,
    settings: NetworkSettings,
    placement_features: int,
    made: Mapping[str, Any],
) -> None:
    """Writes a network, whole or not at all. made: how it came to be, in JSON's types."""
    told = {
        "format": FORMAT,
        "version": str(VERSION),
        "network": json.dumps(asdict(settings)),
        "placement_features": str(placement_features),
        "made": json.dumps(made),
    }
    tensors = {name: tensor.cpu().contiguous() for name, tensor in net.state_dict().items()}
    with replacing(path) as file:
        file.write(save(tensors, told))


def read_weights(path: Path) -> tuple[nn.Module, int, dict[str, Any]]:
    """A network, ready to be asked, its number of placement features, and how it was made.

    Raises WeightsError that names the file and what is wrong with it.
    """
    try:
        with safe_open(path, framework="pt") as file:
            told = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError:
        raise WeightsError(f"there are no weights at {path}") from None
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} holds no weights, or is damaged: {error}") from None
    if told.get("format") != FORMAT or told.get("version") != str(VERSION):
        raise WeightsError(
            f"{path} is of format {told.get('format')!r}, version {told.get('version')!r}: "
            f"this one reads {FORMAT!r}, version '{VERSION}'"
        )
    try:
        fields, made = json.loads(told["network"]), _upgraded(json.loads(told["made"]))
        for stored in (fields, made.get("settings", {}).get("network", {})):
            stored.pop("heads", None)  # of the attention network, which was removed
        settings = NetworkSettings(**fields)
        placement_features = int(told.get("placement_features", told.get("prospects", "none")))
        net = network(settings, placement_features)
        net.load_state_dict(tensors)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise WeightsError(f"{path} does not hold what it says: {error}") from None
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise WeightsError(f"{path}: tensor {name!r} holds numbers that are not finite")
    return net.eval().requires_grad_(False), placement_features, made


def _upgraded(made: dict[str, Any]) -> dict[str, Any]:
    """Provenance as it is now, from what an earlier version wrote."""
    settings = made.get("settings")
    if settings and "easy" in settings:
        settings = {**settings, "rules": asdict(Rules(easy=settings["easy"]))}
        del settings["easy"]
        if settings["observation"] == "prospects":
            settings["observation"] = "placement-features"
        made = {**made, "settings": settings}
    return made
