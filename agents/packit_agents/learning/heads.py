"""Networks that choose rotations and locations, which the paper leaves for future work.

Shapes of tensors: b observations in a batch, w features, n grid nodes along an axis.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from packit_agents.learning.blocks import blocks
from packit_sim.game.envs.observations import BOX_CUBES, SHAPE_CUBES
from packit_sim.geometry import rotations

_RANK = 8
"""Number of products of functions of x, y and z in a `LocationHead`."""


class RotationHead(nn.Module):
    """A network that scores the 24 rotations of the chosen shape, next to the box.

    It maps the features of the shape (b, 8, 8, 8), upright, and of the box (b, 10, 10, 10) to
    logits (b, 24). It sees the shape in each rotation, so it need not learn their numbering.
    """

    rotated: Tensor

    def __init__(self, width: int, encoder_blocks: int, trunk_blocks: int) -> None:
        super().__init__()
        numbers = np.arange(SHAPE_CUBES**3).reshape([SHAPE_CUBES] * 3)
        rotated = [rotations.turn_array(numbers, r).ravel() for r in range(rotations.COUNT)]
        self.register_buffer("rotated", torch.from_numpy(np.stack(rotated)), persistent=False)
        self.shape = blocks(SHAPE_CUBES**3, width, encoder_blocks)
        self.box = blocks(BOX_CUBES**3, width, encoder_blocks)
        self.trunk = blocks(2 * width, width, trunk_blocks)
        self.head = nn.Linear(width, 1)

    def forward(self, shape: Tensor, box: Tensor) -> Tensor:
        shapes = self.shape(shape.flatten(1)[:, self.rotated])  # (b, 24, w)
        boxes = self.box(box.flatten(1)).unsqueeze(1).expand_as(shapes)
        logits: Tensor = self.head(self.trunk(torch.cat([shapes, boxes], 2))).squeeze(2)
        return logits


class LocationHead(nn.Module):
    """A network that scores the n^3 nodes by sums and products of functions of x, y and z.

    That can express orders such as bottom-left-back fill, and dependence on the item and the box,
    at a thousandth of the cost of a convolution. It maps the features of the item in its rotation
    (b, 8, 8, 8) and of the box (b, 10, 10, 10) to logits (b, n^3) in C order.
    """

    def __init__(self, nodes: int, width: int, encoder_blocks: int, trunk_blocks: int) -> None:
        super().__init__()
        self._nodes = nodes
        self.item = blocks(SHAPE_CUBES**3, width, encoder_blocks)
        self.box = blocks(BOX_CUBES**3, width, encoder_blocks)
        self.trunk = blocks(2 * width, width, trunk_blocks)
        self.head = nn.Linear(width, 3 * (1 + _RANK) * nodes)

    def forward(self, item: Tensor, box: Tensor) -> Tensor:
        both = torch.cat([self.item(item.flatten(1)), self.box(box.flatten(1))], 1)
        functions = self.head(self.trunk(both)).unflatten(1, (3, 1 + _RANK, self._nodes))
        x, y, z = functions.unbind(1)  # (b, 1 + rank, n) each
        added = x[:, 0, :, None, None] + y[:, 0, None, :, None] + z[:, 0, None, None, :]
        multiplied = torch.einsum("brx,bry,brz->bxyz", x[:, 1:], y[:, 1:], z[:, 1:])
        return (added + multiplied).flatten(1)
