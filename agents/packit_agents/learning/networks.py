"""PackNN, which scores the shapes outside a box (paper, section 4.2), and all policies at once.

b is a batch of observations, n the room for shapes in each, w the width of features. A network
works on the shapes that are outside alone: what fills the room for others changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from packit_agents.learning.blocks import blocks
from packit_agents.learning.heads import LocationHead, RotationHead
from packit_sim.core.errors import ArgumentError
from packit_sim.envs.observations import BOX_CUBES, SHAPE_CUBES
from packit_sim.game.episode import Stage
from packit_sim.geometry.lattice import BOX_CELLS, grid_nodes

Seen = Mapping[str, Tensor]
"""An observation's fields as tensors, each with b for its first axis."""

NetworkName = Literal["packnn"]

NETWORKS: tuple[str, ...] = get_args(NetworkName)

Policies = Literal["shape", "all"]


@dataclass(frozen=True)
class NetworkSettings:
    """The paper's numbers are the defaults.

    network: which of `NETWORKS`. width: of features. encoder_blocks, trunk_blocks: residual blocks
    before and after the shapes are seen together.
    policies: "shape", the paper's, or "all": heads for rotations and locations beside it, in boxes
    of the benchmark's size.
    """

    network: NetworkName = "packnn"
    width: int = 128
    encoder_blocks: int = 3
    trunk_blocks: int = 4
    policies: Policies = "shape"

    def __post_init__(self) -> None:
        """Raises ValueError that names the setting that is out of range."""
        checks = {
            "network": self.network in NETWORKS,
            "policies": self.policies in get_args(Policies),
            "width": self.width >= 1,
            "encoder_blocks": self.encoder_blocks >= 0,
            "trunk_blocks": self.trunk_blocks >= 0,
        }
        if self.network == "packnn-attention":  # type: ignore[comparison-overlap]
            raise ArgumentError(
                "network setting network = 'packnn-attention': this network was removed, since it "
                f"was no better than packnn; choose from {', '.join(NETWORKS)}"
            )
        for name, holds in checks.items():
            if not holds:
                raise ArgumentError(
                    f"network setting {name} = {getattr(self, name)!r} is not possible"
                )


class Encoder(nn.Module):
    """Each shape outside by itself, and the box: (b, n, w) and (b, w).

    What is inside gets features of 0. `placement_features` are used if the observations have them.
    """

    def __init__(self, settings: NetworkSettings, placement_features: int) -> None:
        super().__init__()
        width, count = settings.width, settings.encoder_blocks
        self._placement_features = placement_features > 0
        self.shapes = blocks(SHAPE_CUBES**3 + placement_features, width, count)
        self.box = blocks(BOX_CUBES**3, width, count)

    def forward(self, seen: Seen) -> tuple[Tensor, Tensor]:
        outside = seen["outside"].bool()
        inputs = seen["shapes"][outside].flatten(1)  # (all shapes outside, cubes)
        if self._placement_features:
            inputs = torch.cat([inputs, seen["placement_features"][outside]], 1)
        encoded = self.shapes(inputs)
        shapes = encoded.new_zeros(*outside.shape, encoded.shape[-1])
        shapes[outside] = encoded
        return shapes, self.box(seen["box"].flatten(1))


class PackNN(nn.Module):
    """The paper's network for Shape-Selection (section 4.2 and its appendix), or for the value.

    A shape's features stand beside the maximum over all that are outside, and the box's. forward:
    (b, n) logits, of no meaning for shapes that are not outside; as a value network, (b, 1).
    """

    def __init__(
        self, settings: NetworkSettings, placement_features: int, *, value: bool = False
    ) -> None:
        super().__init__()
        width = settings.width
        self._value = value
        self.encoder = Encoder(settings, placement_features)
        self.trunk = blocks((2 if value else 3) * width, width, settings.trunk_blocks)
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


class AllPolicies(nn.Module):
    """A network for shapes, and heads for rotations and for locations, which share nothing.

    forward: (b, actions) logits of the stages at which the observations are; those that are not
    among a stage's actions are 0. Sees "stage" and "chosen" (b,) and "item" (b, 8, 8, 8) besides.
    """

    def __init__(self, shape: nn.Module, settings: NetworkSettings) -> None:
        super().__init__()
        (nodes,) = set(grid_nodes(BOX_CELLS))
        size = settings.width, settings.encoder_blocks, settings.trunk_blocks
        self.actions = nodes**3
        self.shape = shape
        self.rotation = RotationHead(*size)
        self.location = LocationHead(nodes, *size)

    def forward(self, seen: Seen) -> Tensor:
        stages = seen["stage"]
        logits = seen["box"].new_zeros(len(stages), self.actions)
        for stage in sorted(set(stages.tolist())):
            rows = stages == stage
            found = self._logits(Stage(stage), {name: field[rows] for name, field in seen.items()})
            logits[rows, : found.shape[1]] = found
        return logits

    def _logits(self, stage: Stage, seen: Seen) -> Tensor:
        if stage is Stage.SHAPE:
            logits: Tensor = self.shape(seen)
            return logits
        item, box = seen["item"], seen["box"]
        upright = seen["shapes"][torch.arange(len(box)), seen["chosen"]]
        if stage is Stage.ROTATION:
            logits = self.rotation(upright, box)
        else:
            is_turned = item.flatten(1).any(1)[:, None, None, None]
            logits = self.location(torch.where(is_turned, item, upright), box)
        return logits


def network(
    settings: NetworkSettings, placement_features: int, *, value: bool = False
) -> nn.Module:
    """A new network. placement_features: how many there are of each shape, 0 for none."""
    shape = PackNN(settings, placement_features, value=value)
    return AllPolicies(shape, settings) if settings.policies == "all" and not value else shape
