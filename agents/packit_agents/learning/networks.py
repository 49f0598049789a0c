"""Networks that score the shapes outside a box: PackNN (paper, section 4.2), and better ones.

b is a batch of observations, n the room for shapes in each, w the width of features. A network
works on the shapes that are outside alone: what fills the room for others changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from packit_sim.envs.observations import BOX_CUBES, SHAPE_CUBES

Seen = Mapping[str, Tensor]
"""An observation's fields as tensors, each with b for its first axis."""

NetworkName = Literal["packnn", "packnn-attention"]

NETWORKS: tuple[str, ...] = get_args(NetworkName)


@dataclass(frozen=True)
class NetworkSettings:
    """The paper's numbers are the defaults.

    network: which of `NETWORKS`. width: of features. encoder_blocks, trunk_blocks: residual blocks
    before and after the shapes are seen together. heads: of attention, where there is any.
    """

    network: NetworkName = "packnn"
    width: int = 128
    encoder_blocks: int = 3
    trunk_blocks: int = 4
    heads: int = 4

    def __post_init__(self) -> None:
        """Raises ValueError that names the setting that is out of range."""
        checks = {
            "network": self.network in NETWORKS,
            "width": self.width >= 1 and self.width % max(self.heads, 1) == 0,
            "encoder_blocks": self.encoder_blocks >= 0,
            "trunk_blocks": self.trunk_blocks >= 0,
            "heads": self.heads >= 1,
        }
        for name, holds in checks.items():
            if not holds:
                raise ValueError(
                    f"network setting {name} = {getattr(self, name)!r} is not possible"
                )


class ResidualBlock(nn.Module):
    """Two fully connected layers around which the input goes by: (..., w) to (..., w)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Linear(width, width)
        self.second = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(torch.relu(self.first(x))))


def _blocks(inputs: int, width: int, count: int) -> nn.Sequential:
    """(..., inputs) to (..., w): a layer that fits the width, and residual blocks."""
    fit = nn.Sequential(nn.Linear(inputs, width), nn.ReLU())
    return nn.Sequential(fit, *(ResidualBlock(width) for _ in range(count)))


class Encoder(nn.Module):
    """Each shape outside by itself, and the box: (b, n, w) and (b, w).

    What is inside gets features of 0. `prospects` is looked at where the observations have it.
    """

    def __init__(self, settings: NetworkSettings, prospects: int) -> None:
        super().__init__()
        width, count = settings.width, settings.encoder_blocks
        self._prospects = prospects > 0
        self.shapes = _blocks(SHAPE_CUBES**3 + prospects, width, count)
        self.box = _blocks(BOX_CUBES**3, width, count)

    def forward(self, seen: Seen) -> tuple[Tensor, Tensor]:
        outside = seen["outside"].bool()
        inputs = seen["shapes"][outside].flatten(1)  # (all shapes outside, cubes)
        if self._prospects:
            inputs = torch.cat([inputs, seen["prospects"][outside]], 1)
        encoded = self.shapes(inputs)
        shapes = encoded.new_zeros(*outside.shape, encoded.shape[-1])
        shapes[outside] = encoded
        return shapes, self.box(seen["box"].flatten(1))


class PackNN(nn.Module):
    """The paper's network for Shape-Selection (section 4.2 and its appendix), or for the value.

    A shape's features stand beside the maximum over all that are outside, and the box's. forward:
    (b, n) logits, of no meaning for shapes that are not outside; as a value network, (b, 1).
    """

    def __init__(self, settings: NetworkSettings, prospects: int, *, value: bool = False) -> None:
        super().__init__()
        width = settings.width
        self._value = value
        self.encoder = Encoder(settings, prospects)
        self.trunk = _blocks((2 if value else 3) * width, width, settings.trunk_blocks)
        self.head = nn.Linear(width, 1)

    def forward(self, seen: Seen) -> Tensor:
        outside = seen["outside"].bool()
        shapes, box = self.encoder(seen)
        pooled = shapes.amax(1)  # features are not negative, those of what is inside 0
        if self._value:
            return self.head(self.trunk(torch.cat([pooled, box], 1)))
        rows, _ = outside.nonzero(as_tuple=True)
        seen_together = torch.cat([shapes[outside], pooled[rows], box[rows]], 1)
        logits = shapes.new_zeros(outside.shape)
        logits[outside] = self.head(self.trunk(seen_together)).squeeze(1)
        return logits


class AttentionPackNN(nn.Module):
    """PackNN with attention between the shapes and the box in the place of the maximum.

    forward: as of `PackNN`; the value is read from the box's token.
    """

    def __init__(self, settings: NetworkSettings, prospects: int, *, value: bool = False) -> None:
        super().__init__()
        self._value = value
        self.encoder = Encoder(settings, prospects)
        layer = nn.TransformerEncoderLayer(
            settings.width,
            settings.heads,
            2 * settings.width,
            dropout=0.0,
            batch_first=True,
            norm_first=True,
        )
        self.trunk = nn.TransformerEncoder(
            layer, max(settings.trunk_blocks // 2, 1), enable_nested_tensor=False
        )
        self.head = nn.Linear(settings.width, 1)

    def forward(self, seen: Seen) -> Tensor:
        shapes, box = self.encoder(seen)
        tokens = torch.cat([box.unsqueeze(1), shapes], 1)
        outside = seen["outside"].bool()
        hidden = torch.cat([torch.zeros_like(outside[:, :1]), ~outside], 1)
        together = self.head(self.trunk(tokens, src_key_padding_mask=hidden)).squeeze(2)
        return together[:, :1] if self._value else together[:, 1:]


def network(settings: NetworkSettings, prospects: int, *, value: bool = False) -> nn.Module:
    """A new network. prospects: how many numbers tell of each shape, 0 where none do."""
    kinds: dict[str, type[PackNN] | type[AttentionPackNN]] = {
        "packnn": PackNN,
        "packnn-attention": AttentionPackNN,
    }
    return kinds[settings.network](settings, prospects, value=value)
