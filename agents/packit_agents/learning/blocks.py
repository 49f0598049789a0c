"""What all networks are made of: fully connected residual blocks (paper, section 4.2)."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class ResidualBlock(nn.Module):
    """Two fully connected layers around which the input goes by: (..., w) to (..., w)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Linear(width, width)
        self.second = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(torch.relu(self.first(x))))


def blocks(inputs: int, width: int, count: int) -> nn.Sequential:
    """(..., inputs) to (..., w): a layer that fits the width, and residual blocks."""
    fit = nn.Sequential(nn.Linear(inputs, width), nn.ReLU())
    return nn.Sequential(fit, *(ResidualBlock(width) for _ in range(count)))
