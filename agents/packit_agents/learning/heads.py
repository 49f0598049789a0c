"""Networks that choose rotations and locations too: what the paper leaves for the future.

b is a batch of observations, w the width of features, n the grid's nodes an axis.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from packit_agents.learning.blocks import blocks
from packit_sim.envs.observations import BOX_CUBES, SHAPE_CUBES
from packit_sim.geometry import rotations

_RANK = 8
"""Products of a function of x, one of y and one of z that a `LocationHead` adds up."""


class RotationHead(nn.Module):
    """Looks at the chosen shape in each of the 24 rotations, beside the box.

    forward: the shape's cubes, upright (b, 8, 8, 8), and the box's (b, 10, 10, 10), to logits
    (b, 24). Which rotation has which number is nothing it learns: it sees the shape turned, but
    for the cubes' being of 12 cells or 13.
    """

    turned: Tensor

    def __init__(self, width: int, encoder_blocks: int, trunk_blocks: int) -> None:
        super().__init__()
        numbers = np.arange(SHAPE_CUBES**3).reshape([SHAPE_CUBES] * 3)
        turned = [rotations.turn_array(numbers, r).ravel() for r in range(rotations.COUNT)]
        self.register_buffer("turned", torch.from_numpy(np.stack(turned)), persistent=False)
        self.shape = blocks(SHAPE_CUBES**3, width, encoder_blocks)
        self.box = blocks(BOX_CUBES**3, width, encoder_blocks)
        self.trunk = blocks(2 * width, width, trunk_blocks)
        self.head = nn.Linear(width, 1)

    def forward(self, shape: Tensor, box: Tensor) -> Tensor:
        shapes = self.shape(shape.flatten(1)[:, self.turned])  # (b, 24, w)
        boxes = self.box(box.flatten(1)).unsqueeze(1).expand_as(shapes)
        logits: Tensor = self.head(self.trunk(torch.cat([shapes, boxes], 2))).squeeze(2)
        return logits


class LocationHead(nn.Module):
    """Logits of the n^3 nodes as sums and products of functions of x, of y and of z.

    Enough for orders such as bottom-left-back fill, and for what depends on the item and the box,
    at a thousandth of a convolution's price. forward: the item's cubes in its rotation (b, 8, 8, 8)
    and the box's (b, 10, 10, 10), to logits (b, n^3) in C order.
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
