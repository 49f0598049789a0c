"""The network that compares placements; it plays without torch (see `policy_gradient`)."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from packit_agents.placements.network_kernels import score
from packit_agents.placements.placement_features import FEATURES
from packit_sim.core import typed_json
from packit_sim.core.errors import PackItError, located
from packit_sim.core.files import replacing

FORMAT = "packit-placements"

LAYERS = ("first", "second")

Scores = npt.NDArray[np.float32]


class PlacementWeightsError(PackItError, ValueError):
    """A file that holds no weights of a network for placements."""


class PlacementNetwork:
    """A score for each of some placements, of any number of items in any box.

    The score is linear in the features, plus what a network with two hidden layers adds to it.

    Parameters
    ----------
    tensors : mapping of str to ndarray
        float32, see `shapes`.
    provenance : mapping
        The record of its training, in JSON's types.
    """

    format: ClassVar[str] = FORMAT
    features: ClassVar[tuple[str, ...]] = FEATURES

    def __init__(
        self, tensors: Mapping[str, npt.NDArray[np.float32]], provenance: Mapping[str, Any]
    ) -> None:
        self.tensors = dict(tensors)
        self.provenance = provenance
        layers = [
            (np.ascontiguousarray(tensors[f"{layer}.weight"].T), tensors[f"{layer}.bias"])
            for layer in LAYERS
        ]
        first = tensors["mean"], tensors["scale"], tensors["linear.weight"][0]
        self._arrays = *first, *layers, tensors["score.weight"][0]

    @classmethod
    def shapes(cls, width: int) -> dict[str, tuple[int, ...]]:
        """Return the shapes of the tensors of a network with layers of some width."""
        features = len(cls.features)
        return {
            "mean": (features,),
            "scale": (features,),
            "first.weight": (width, features),
            "first.bias": (width,),
            "second.weight": (width, width),
            "second.bias": (width,),
            "score.weight": (1, width),
            "linear.weight": (1, features),
        }

    @property
    def digest(self) -> str:
        """16 hex digits, equal for equal tensors."""
        sha = hashlib.sha256()
        for name, tensor in sorted(self.tensors.items()):
            sha.update(f"{name} {tensor.shape}\n".encode())
            sha.update(np.ascontiguousarray(tensor, dtype="<f4").tobytes())
        return sha.hexdigest()[:16]

    def __call__(self, features: npt.NDArray[np.float32]) -> Scores:
        """Score placements of one state.

        Parameters
        ----------
        features : ndarray
            float32 (n, features), see `features.FEATURES`.

        Returns
        -------
        ndarray
            float32 (n,): the placement with the highest score is the best.
        """
        scores: Scores = score(features, *self._arrays)
        return scores

    def write(self, path: Path) -> None:
        """Write the network to a file of safetensors, atomically."""
        metadata = {
            "format": self.format,
            "features": json.dumps(self.features),
            "provenance": json.dumps(self.provenance),
        }
        with replacing(path) as file:
            file.write(save(self.tensors, metadata))

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a network.

        Returns
        -------
        PlacementNetwork
            The network.

        Raises
        ------
        PlacementWeightsError
            If the file holds no such weights, weights for other features, or is damaged.
        """
        if not path.is_file():
            raise PlacementWeightsError(f"there are no weights at {path}")
        try:
            with safe_open(path, framework="numpy") as file:
                metadata = file.metadata() or {}
                slices = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118
                found = {name: tuple(each.get_shape()) for name, each in slices.items()}
                kinds = {name: each.get_dtype() for name, each in slices.items()}
                tensors = {name: file.get_tensor(name) for name in found if kinds[name] == "F32"}
        except (SafetensorError, OSError) as error:
            raise PlacementWeightsError(
                f"{path} holds no weights, or is damaged: {error}"
            ) from None
        if metadata.get("format") != cls.format:
            raise PlacementWeightsError(
                f"{path} is of format {metadata.get('format')!r}: this agent reads {cls.format!r}"
            )
        with located(f"{path} has metadata that are damaged", PlacementWeightsError):
            features = typed_json.decode(
                metadata.get("features", ""), list[str], PlacementWeightsError, "features"
            )
            provenance = typed_json.decode(
                metadata.get("provenance", ""), dict[str, Any], PlacementWeightsError, "provenance"
            )
        if features != list(cls.features):
            raise PlacementWeightsError(f"{path} was trained with other features than these")
        width = math.prod(found.get("first.bias", ()))
        if found != cls.shapes(width):
            raise PlacementWeightsError(f"{path} holds other tensors than those of such a network")
        for name in found:
            if name not in tensors or not np.isfinite(tensors[name]).all():
                raise PlacementWeightsError(f"{path}: {name!r} holds no finite float32 numbers")
        if not tensors["scale"].all():
            raise PlacementWeightsError(f"{path}: 'scale' has a 0, by which features are divided")
        return cls(tensors, provenance)
