"""Alternative computations of a mask, none of them exact: what a user might try first."""

from __future__ import annotations

import numpy as np
import scipy.fft
import torch
import trimesh

from packit_sim import Box, Item
from packit_sim.geometry.lattice import CELL, STEP
from packit_sim.geometry.motions import Motion
from packit_sim.placement import Mask, location_counts


def scipy_mask(box: Box, item: Item) -> Mask:
    """Correlate outer cells by FFT: not exact, and blind to containment."""
    own = np.zeros(box.cells, np.float32)
    x, y, z = item.cells
    own[:x, :y, :z] = item.outer
    shared = scipy.fft.irfftn(
        scipy.fft.rfftn(box.outer.astype(np.float32)) * np.conj(scipy.fft.rfftn(own)), s=box.cells
    )
    return _mask(shared < 0.5, box, item)


def torch_mask(box: Box, item: Item) -> Mask:
    """Correlate outer cells by FFT, as `scipy_mask` does."""
    own = torch.zeros(box.cells)
    x, y, z = item.cells
    own[:x, :y, :z] = torch.from_numpy(item.outer.copy())
    taken = torch.from_numpy(box.outer.astype(np.float32))
    shared = torch.fft.irfftn(torch.fft.rfftn(taken) * torch.fft.rfftn(own).conj(), s=box.cells)
    return _mask((shared < 0.5).numpy(), box, item)


def _mask(free: Mask, box: Box, item: Item) -> Mask:
    mask = np.zeros(box.nodes, dtype=bool)
    window = tuple(slice(size) for size in location_counts(box.cells, item))
    mask[window] = free[::STEP, ::STEP, ::STEP][window]
    return mask


def collision_manager_mask(box: Box, item: Item) -> Mask:
    """Query trimesh's CollisionManager at each location: no containment, no tolerance."""
    placed, moving = trimesh.collision.CollisionManager(), trimesh.collision.CollisionManager()
    for n, other in enumerate(box.placed):
        placed.add_object(str(n), other.item.mesh, Motion.shift(other.center).matrix)
    moving.add_object("item", item.mesh)
    mask = np.zeros(box.nodes, dtype=bool)
    for location in np.ndindex(location_counts(box.cells, item)):
        center = (np.array(location) * STEP + np.array(item.cells) / 2) * CELL
        moving.set_transform("item", Motion.shift(center).matrix)
        mask[location] = not placed.in_collision_other(moving)
    return mask
