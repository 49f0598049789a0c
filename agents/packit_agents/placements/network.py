"""The network that compares placements; it plays without torch (see `policy_gradient`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from packit_agents.learning.tensor_files import (
    TensorFileError,
    read_tensors,
    tensors_digest,
    write_tensors,
)
from packit_agents.placements.network_kernels import score
from packit_agents.placements.placement_features import FEATURES
from packit_sim.core import typed_json
from packit_sim.core.errors import located

FORMAT = "packit-placements"

LAYERS = ("first", "second")

Scores = npt.NDArray[np.float32]


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
        return tensors_digest(self.tensors)

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
        write_tensors(
            path,
            self.format,
            self.tensors,
            features=self.features,
            provenance=self.provenance,
        )

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a network.

        Returns
        -------
        PlacementNetwork
            The network.

        Raises
        ------
        TensorFileError
            If the file holds no such weights, weights for other features, or is damaged.
        """
        tensors, metadata = read_tensors(path, cls.format)
        with located(f"{path} has metadata that are damaged", TensorFileError):
            features = typed_json.decode(
                metadata.get("features", ""), list[str], TensorFileError, "features"
            )
            provenance = typed_json.decode(
                metadata.get("provenance", ""), dict[str, Any], TensorFileError, "provenance"
            )
        if features != list(cls.features):
            raise TensorFileError(f"{path} was trained with other features than this version has")
        width = math.prod(tensors["first.bias"].shape) if "first.bias" in tensors else 1
        if {name: tensor.shape for name, tensor in tensors.items()} != cls.shapes(width):
            raise TensorFileError(f"{path} holds other tensors than a network for placements")
        if not tensors["scale"].all():
            raise TensorFileError(f"{path}: 'scale' has a 0, but features are divided by it")
        return cls(tensors, provenance)
