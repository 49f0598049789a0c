"""PackNN, which scores the shapes outside a box (paper, section 4.2), and networks for all choices.

Shapes of tensors: b observations in a batch, n slots for shapes in each, w features. Networks work
only on the shapes outside; the content of the other slots has no effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from packit_agents.learning.blocks import blocks
from packit_agents.learning.heads import LocationHead, RotationHead
from packit_sim.core.checks import Range, check_settings
from packit_sim.core.errors import ArgumentError
from packit_sim.game.envs.observations import BOX_CUBES, SHAPE_CUBES
from packit_sim.game.episodes.episode import Stage
from packit_sim.geometry.lattice import BOX_CELLS, grid_nodes

Fields = Mapping[str, Tensor]
"""Observation fields as tensors (b, ...)."""

NetworkName = Literal["packnn"]

NETWORKS: tuple[str, ...] = get_args(NetworkName)

Policies = Literal["shape", "all"]

POLICIES: tuple[str, ...] = get_args(Policies)


@dataclass(frozen=True)
class NetworkSettings:
    """Settings of a network; the defaults are the paper's.

    Attributes
    ----------
    network : {"packnn"}
        The architecture.
    width : int
        Number of features of each layer.
    encoder_blocks, trunk_blocks : int
        Residual blocks before and after the features of all shapes are combined.
    policies : {"shape", "all"}
        The choices of the network: shapes, as in the paper, or also rotations and locations, in
        boxes of the benchmark's size.

    Raises
    ------
    ArgumentError
        If a setting is out of range; the message names it.
    """

    network: NetworkName = "packnn"
    width: int = 128
    encoder_blocks: int = 3
    trunk_blocks: int = 4
    policies: Policies = "shape"

    def __post_init__(self) -> None:
        if self.network == "packnn-attention":  # type: ignore[comparison-overlap]
            raise ArgumentError(
                "network setting network = 'packnn-attention': this network was removed, since it "
                f"was no better than packnn; choose from {', '.join(NETWORKS)}"
            )
        check_settings(
            self,
            "network setting",
            network=(self.network in NETWORKS, f"choose from {', '.join(NETWORKS)}"),
            policies=(self.policies in POLICIES, f"choose from {', '.join(POLICIES)}"),
            width=Range(1),
            encoder_blocks=Range(0),
            trunk_blocks=Range(0),
        )


class Encoder(nn.Module):
    """The encoders of the shapes outside (b, n, w) and of the box (b, w).

    The features of shapes that are in the box are 0.

    Parameters
    ----------
    placement_features : int
        Number of placement features of each shape, 0 for none.
    """

    def __init__(self, settings: NetworkSettings, placement_features: int) -> None:
        super().__init__()
        width, count = settings.width, settings.encoder_blocks
        self._placement_features = placement_features > 0
        self.shapes = blocks(SHAPE_CUBES**3 + placement_features, width, count)
        self.box = blocks(BOX_CUBES**3, width, count)

    def forward(self, fields: Fields) -> tuple[Tensor, Tensor]:
        outside = fields["outside"].bool()
        inputs = fields["shapes"][outside].flatten(1)  # (all shapes outside, cubes)
        if self._placement_features:
            inputs = torch.cat([inputs, fields["placement_features"][outside]], 1)
        encoded = self.shapes(inputs)
        shapes = encoded.new_zeros(*outside.shape, encoded.shape[-1])
        shapes[outside] = encoded
        return shapes, self.box(fields["box"].flatten(1))


class PackNN(nn.Module):
    """The paper's network for Shape-Selection (section 4.2 and its appendix), or for the value.

    The features of a shape are concatenated with their maximum over all shapes outside and the
    features of the box. The output is logits (b, n), meaningless for shapes that are not outside;
    as a value network (b, 1).

    Parameters
    ----------
    placement_features : int
        Number of placement features of each shape, 0 for none.
    value : bool
        Whether it is a value network.
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

    def forward(self, fields: Fields) -> Tensor:
        outside = fields["outside"].bool()
        shapes, box = self.encoder(fields)
        pooled = shapes.amax(1)  # features are at least 0, and 0 for shapes in the box
        if self._value:
            return self.head(self.trunk(torch.cat([pooled, box], 1)))
        rows, _ = outside.nonzero(as_tuple=True)
        combined = torch.cat([shapes[outside], pooled[rows], box[rows]], 1)
        logits = shapes.new_zeros(outside.shape)
        logits[outside] = self.head(self.trunk(combined)).squeeze(1)
        return logits


class AllPolicies(nn.Module):
    """A network for shapes, and heads for rotations and locations, which share no parameters.

    The output is logits (b, actions) for the stage of each observation, 0 beyond the actions of
    that stage. It also needs the fields "stage" (b,), "chosen" (b,) and "item" (b, 8, 8, 8).

    Parameters
    ----------
    shape : torch.nn.Module
        The network for shapes.
    settings : NetworkSettings
        Settings of the heads.
    """

    def __init__(self, shape: nn.Module, settings: NetworkSettings) -> None:
        super().__init__()
        (nodes,) = set(grid_nodes(BOX_CELLS))
        size = settings.width, settings.encoder_blocks, settings.trunk_blocks
        self.actions = nodes**3
        self.shape = shape
        self.rotation = RotationHead(*size)
        self.location = LocationHead(nodes, *size)

    def forward(self, fields: Fields) -> Tensor:
        stages = fields["stage"]
        logits = fields["box"].new_zeros(len(stages), self.actions)
        for stage in sorted(set(stages.tolist())):
            rows = stages == stage
            found = self._logits(
                Stage(stage), {name: field[rows] for name, field in fields.items()}
            )
            logits[rows, : found.shape[1]] = found
        return logits

    def _logits(self, stage: Stage, fields: Fields) -> Tensor:
        if stage is Stage.SHAPE:
            logits: Tensor = self.shape(fields)
            return logits
        item, box = fields["item"], fields["box"]
        upright = fields["shapes"][torch.arange(len(box)), fields["chosen"]]
        if stage is Stage.ROTATION:
            logits = self.rotation(upright, box)
        else:
            is_rotated = item.flatten(1).any(1)[:, None, None, None]
            logits = self.location(torch.where(is_rotated, item, upright), box)
        return logits


def network(
    settings: NetworkSettings, placement_features: int, *, value: bool = False
) -> nn.Module:
    """Build a network.

    Parameters
    ----------
    placement_features : int
        Number of placement features of each shape, 0 for none.
    value : bool
        Whether it is a value network.

    Returns
    -------
    torch.nn.Module
        A `PackNN` or an `AllPolicies` with random parameters.
    """
    shape = PackNN(settings, placement_features, value=value)
    return AllPolicies(shape, settings) if settings.policies == "all" and not value else shape
