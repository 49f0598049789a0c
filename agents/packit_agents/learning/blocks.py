"""Fully connected residual blocks, which all networks consist of (paper, section 4.2)."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class ResidualBlock(nn.Module):
    """Two fully connected layers with a skip connection, from (..., w) to (..., w)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Linear(width, width)
        self.second = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(torch.relu(self.first(x))))


def blocks(inputs: int, width: int, count: int) -> nn.Sequential:
    """Build an input layer and residual blocks, from (..., inputs) to (..., width)."""
    fit = nn.Sequential(nn.Linear(inputs, width), nn.ReLU())
    return nn.Sequential(fit, *(ResidualBlock(width) for _ in range(count)))
