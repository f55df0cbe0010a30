"""GazeMoDiff's encoder: what was observed of pose and gaze, joined by graph attention into one condition.

Source: docs/specification/gazemodiff.md#network.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from prbench_adapters.prediction.configuration import DiffusionConfiguration
from prbench_adapters.prediction.graph_attention import GraphEncoder

_GAZE_CHANNELS = 32
_KERNEL = 3


class GazeEncoder(nn.Sequential):
    """Convolutions over the coefficients of a direction: (batch, 3, L) to (batch, 3, L), within ±1."""

    def __init__(self, coefficients: int) -> None:
        layers: list[nn.Module] = []
        inputs = 3
        for _ in range(3):
            layers += [_convolution(inputs, _GAZE_CHANNELS), nn.LayerNorm([_GAZE_CHANNELS, coefficients]), nn.Tanh()]
            inputs = _GAZE_CHANNELS
        super().__init__(*layers, _convolution(inputs, 3), nn.Tanh())


class ConditionEncoder(nn.Module):
    """Encodes the coefficients of a padded observation, once a window.

    Args:
        configuration: Which parts there are, and their sizes.
    """

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        steps, width, heads = configuration.coefficients, configuration.encoder_width, configuration.encoder_heads
        joints, nodes = configuration.n_joints, configuration.nodes
        self.pose: nn.Module = nn.Identity()
        if configuration.pose_encoder:
            self.pose = GraphEncoder(joints, steps, width, heads, 1, configuration.encoder_dropout)
        self.gaze: nn.Module = nn.Identity()
        if configuration.gaze and configuration.gaze_encoder:
            self.gaze = GazeEncoder(steps)
        self.fusion: nn.Module = nn.Identity()
        if configuration.fusion == "graph-attention":
            blocks = configuration.fusion_blocks
            self.fusion = GraphEncoder(nodes, steps, width, heads, blocks, configuration.fusion_dropout)

    def forward(
        self, coefficients: Float[Tensor, "windows coefficients values"]
    ) -> Float[Tensor, "windows coefficients values"]:
        """Encode the coefficients of padded observations; values are 3 · node + coordinate, gaze the last node."""
        nodes = self.nodes(coefficients)
        joints = self.configuration.n_joints
        features = self.pose(nodes[:, :, :joints])
        if self.configuration.gaze:
            features = torch.cat([features, self.gaze(nodes[:, :, joints])[:, :, None]], dim=2)
        return self.flat(self.fusion(features))

    def nodes(
        self, coefficients: Float[Tensor, "windows coefficients values"]
    ) -> Float[Tensor, "windows 3 nodes steps"]:
        """Coordinates, nodes and coefficients as axes.

        The legacy layout takes the same numbers in the order in which they lie in memory, so that axes are mixed.
        """
        shape = self.configuration
        if shape.legacy_layout:
            return coefficients.reshape(len(coefficients), 3, shape.nodes, shape.coefficients)
        return coefficients.unflatten(-1, (shape.nodes, 3)).permute(0, 3, 2, 1)

    def flat(self, nodes: Float[Tensor, "windows 3 nodes steps"]) -> Float[Tensor, "windows steps values"]:
        """The way back from :meth:`nodes`."""
        if self.configuration.legacy_layout:
            return nodes.reshape(len(nodes), self.configuration.coefficients, self.configuration.values)
        return nodes.permute(0, 3, 2, 1).flatten(2)


def _convolution(inputs: int, outputs: int) -> nn.Conv1d:
    return nn.Conv1d(inputs, outputs, _KERNEL, padding=_KERNEL // 2, padding_mode="replicate")
