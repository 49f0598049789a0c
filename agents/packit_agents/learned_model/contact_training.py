"""Training of a `ContactNetwork` on recorded transitions, with torch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from packit_agents.learned_model.contact_kernels import contact_features
from packit_agents.learned_model.contact_network import ContactNetwork
from packit_agents.learned_model.learned_box import LearnedBox
from packit_agents.placements.network import LAYERS
from packit_sim.box import Box
from packit_sim.game.evaluation.transitions import Transitions
from packit_sim.geometry.items import BoxState, PlacedItem
from packit_sim.geometry.shapes import Item
from packit_sim.libraries.library import ShapeLibrary

BATCH = 1024


class Contacts(NamedTuple):
    """The open locations of some steps.

    Attributes
    ----------
    features : ndarray
        float32 (n, features).
    feasible : ndarray
        Bool (n,), the exact answers.
    step : ndarray
        int64 (n,), the number of the step.
    location : ndarray
        int64 (n, 3).
    """

    features: npt.NDArray[np.float32]
    feasible: npt.NDArray[np.bool_]
    step: npt.NDArray[np.int64]
    location: npt.NDArray[np.int64]

    @classmethod
    def joined(cls, parts: Iterable[Contacts]) -> Contacts:
        """Join several, one after the other."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


def placed_items(shard: Transitions, library: ShapeLibrary) -> list[PlacedItem]:
    """Return the item that each step of a shard places, in its rotation at its location."""
    shapes = [library[name] for name in shard.shapes.tolist()]
    rows = zip(shard.shape.tolist(), shard.scale.tolist(), shard.rotation.tolist(), strict=True)
    items = (Item(shapes[shape], scale, rotation) for shape, scale, rotation in rows)
    return [
        PlacedItem(item, (i, j, k))
        for item, (i, j, k) in zip(items, shard.location.tolist(), strict=True)
    ]


def contacts(shard: Transitions, library: ShapeLibrary) -> Contacts:
    """Find the open locations of all steps of a shard.

    Parameters
    ----------
    library : ShapeLibrary
        The library of its shapes.

    Returns
    -------
    Contacts
        Their features, and the exact answers of the recorded masks.
    """
    found: list[Contacts] = []
    step = 0

    def keep(box: Box, item: Item, at: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        exact = shard.feasible(step)[tuple(at.T)]
        features = contact_features(box.arrays, item.voxels.arrays, at)
        found.append(Contacts(features, exact, np.full(len(at), step), at))
        return exact

    nx, ny, nz = shard.occupancy.shape[1:]
    box = LearnedBox(keep, (4 * nx, 4 * ny, 4 * nz))
    placed = placed_items(shard, library)
    for first, end in zip(shard.first[:-1].tolist(), shard.first[1:].tolist(), strict=True):
        for step in range(first, end):
            box.restore(BoxState(box.cells, tuple(placed[first:step])))
            box.feasible(placed[step].item)
    return Contacts.joined(found)


def train(
    train: Contacts,
    validation: Contacts,
    provenance: Mapping[str, Any],
    *,
    width: int = 48,
    epochs: int = 30,
    seed: int = 0,
) -> ContactNetwork:
    """Train a network, and calibrate it.

    Parameters
    ----------
    train : Contacts
        The locations to learn from.
    validation : Contacts
        Those that select the best epoch, and the factor of the log-odds (Guo et al., 2017).
    provenance : mapping
        The record of the training, in JSON's types.
    width : int
        Units in each of the two hidden layers.
    epochs : int
        Number of passes over the locations.

    Returns
    -------
    ContactNetwork
        The network.
    """
    rng = np.random.default_rng(seed)
    features, labels = _tensors(train)
    tensors = {
        name: torch.tensor(
            rng.normal(0, (2 / shape[-1]) ** 0.5 if len(shape) > 1 else 0.0, shape),
            dtype=features.dtype,
        )
        for name, shape in ContactNetwork.shapes(width).items()
    }
    tensors |= {"mean": features.mean(0), "scale": features.std(0).clamp_min(0.01)}
    tensors["linear.weight"].zero_()
    learned = [t.requires_grad_() for name, t in tensors.items() if name not in ("mean", "scale")]
    steps = epochs * -(-len(labels) // BATCH)
    optimizer = torch.optim.AdamW(learned, 3e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    held_out, exact = _tensors(validation)
    best, least = tensors, float("inf")
    for _ in range(epochs):
        for part in torch.split(torch.tensor(rng.permutation(len(labels))), BATCH):
            loss = binary_cross_entropy_with_logits(_odds(tensors, features[part]), labels[part])
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
        with torch.no_grad():
            now = float(binary_cross_entropy_with_logits(_odds(tensors, held_out), exact))
        if now < least:
            best, least = {name: t.detach().clone() for name, t in tensors.items()}, now
    factor = _calibration(_odds(best, held_out), exact)
    for name in ("linear.weight", "score.weight"):
        best[name] = best[name] * factor
    return ContactNetwork({name: t.numpy() for name, t in best.items()}, provenance)


def _tensors(found: Contacts) -> tuple[Tensor, Tensor]:
    return torch.tensor(found.features), torch.tensor(found.feasible, dtype=torch.float32)


def _odds(tensors: Mapping[str, Tensor], features: Tensor) -> Tensor:
    """Compute the log-odds (n,) of features (n, features), as the kernel `score` does."""
    hidden = scaled = (features - tensors["mean"]) / tensors["scale"]
    for layer in LAYERS:
        hidden = torch.relu(hidden @ tensors[f"{layer}.weight"].T + tensors[f"{layer}.bias"])
    found = hidden @ tensors["score.weight"].T + scaled @ tensors["linear.weight"].T
    return found[:, 0]


def _calibration(odds: Tensor, exact: Tensor) -> float:
    """Find the factor of the log-odds with which the likelihood of the answers is largest."""
    factors = torch.linspace(0.3, 2.0, 171)
    losses = [float(binary_cross_entropy_with_logits(factor * odds, exact)) for factor in factors]
    return float(factors[int(np.argmin(losses))])
