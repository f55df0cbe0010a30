"""AvatarPoser's network: the values of some frames in, the local rotations of the last one's 22 joints out.

Source: docs/specification/three-points.md#avatarposer. Parameters have the names of the public program. Ours differs
from it where ``time`` is ``sinusoidal``: a row knows how long ago it was.
"""

from __future__ import annotations

from typing import Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from prbench.geometry.skeleton import N_JOINTS
from prbench_adapters.diffusion.denoiser import sinusoid_table
from prbench_adapters.three_points.features import (
    N_VALUES,
    Rows,
    TrackWindows,
    Windows,
    in_head_frame,
    joints_under_head,
    matrices_of_columns,
    windows_ending_at,
)
from prbench_adapters.training.configuration import require_within

_TOGETHER = 256  # windows that go through the network together: they fit a processor's cache


class RegressorConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the network, the frames that it sees, and the weights of its losses; as published by default.

    Attributes:
        hidden: Width between the two layers of each head.
        window: Frames that it sees.
        time: What is added to the rows; ``none`` as published.
        root_weight: Weight of the root's rotation.
    """

    width: int = 256
    heads: int = 8
    layers: int = 3
    feed_forward: int = 2048
    hidden: int = 256
    dropout: float = 0.1
    window: int = 40
    fps: float = 60.0
    time: Literal["sinusoidal", "none"] = "sinusoidal"
    root_weight: float = 0.02
    rotation_weight: float = 1.0
    position_weight: float = 1.0

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "width", "heads", "layers", "feed_forward", "hidden", "window", "fps")
        require_within(self, "at least 0 and below 1", "dropout")
        require_within(self, "at least 0", "root_weight", "rotation_weight", "position_weight")
        if self.width % self.heads or self.width % 2:
            raise ValueError(f"'width' must be even and a multiple of 'heads', found {self.width} and {self.heads}")


class Regressor(nn.Module):
    """Post-norm encoder, of whose last layer one row is computed, and two heads: the root, and the 21 other joints."""

    def __init__(self, configuration: RegressorConfiguration) -> None:
        super().__init__()
        shape = self.configuration = configuration
        self.linear_embedding = nn.Linear(N_VALUES, shape.width)
        layer = nn.TransformerEncoderLayer(
            shape.width, shape.heads, shape.feed_forward, shape.dropout, batch_first=True
        )
        self.transformer_encoder = nn.TransformerEncoder(layer, shape.layers, enable_nested_tensor=False)
        self.stabilizer = _head(shape, 6)
        self.joint_rotation_decoder = _head(shape, 6 * (N_JOINTS - 1))
        self.register_buffer("sinusoid", sinusoid_table(shape.window, shape.width).flip(0), persistent=False)
        self.sinusoid: Tensor
        for module in self.modules():
            if isinstance(module, nn.Linear):  # the attention's input is none
                nn.init.kaiming_normal_(module.weight)
                module.weight.data.clamp_(-1.0, 1.0).mul_(0.2)

    def forward(self, windows: Windows) -> Float[Tensor, "windows 132"]:
        """Return two columns of the local rotations of each window's last frame, the root's in the window's frame.

        Args:
            windows: Values in the frame that the root's rotation is wanted in; fewer rows than ``window`` are the
                last ones.
        """
        stream = self.linear_embedding(windows)
        if self.configuration.time == "sinusoidal":
            stream = stream + self.sinusoid[-windows.shape[1] :]
        for layer in self.transformer_encoder.layers:
            rows = stream
            if layer is self.transformer_encoder.layers[-1]:
                rows = stream[:, -1:]  # nothing reads the others
            rows = layer.norm1(rows + layer.dropout1(layer.self_attn(rows, stream, stream, need_weights=False)[0]))
            inner = layer.dropout(functional.relu(layer.linear1(rows)))
            stream = layer.norm2(rows + layer.dropout2(layer.linear2(inner)))
        last = stream[:, -1]
        return torch.cat([self.stabilizer(last), self.joint_rotation_decoder(last)], dim=1)

    def losses(self, batch: TrackWindows, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the losses of windows by name; nothing is drawn from the generator."""
        del generator
        predicted = self(batch.features)
        recorded = batch.rotations[:, -1]
        bodies = []
        for columns in (predicted.unflatten(1, (N_JOINTS, 6)), recorded):
            bodies.append(joints_under_head(matrices_of_columns(columns), batch.offsets, batch.head[:, -1]))
        return self.loss_parts(predicted, recorded.flatten(1), *bodies)

    @torch.no_grad()
    def rotations(self, rows: Rows, seed: int) -> Float[Tensor, "frames 22 3 3"]:
        """Return the local rotations of every frame of a track, the root's in the world; nothing is drawn.

        Args:
            rows: Values of the track (:func:`~prbench_adapters.three_points.features.track_values`).
            seed: Seed of those networks that draw something.
        """
        del seed
        parts = []
        for ends in torch.arange(len(rows)).split(_TOGETHER):
            windows, turn, _ = in_head_frame(windows_ending_at(rows, ends, self.configuration.window))
            local = matrices_of_columns(self(windows).unflatten(1, (N_JOINTS, 6)))
            local[:, 0] = turn @ local[:, 0]
            parts.append(local)
        return torch.cat(parts)

    def loss_parts(
        self,
        predicted: Float[Tensor, "windows 132"],
        recorded: Float[Tensor, "windows 132"],
        predicted_joints: Float[Tensor, "windows joints 3"],
        recorded_joints: Float[Tensor, "windows joints 3"],
    ) -> dict[str, Tensor]:
        """Mean absolute errors of the root's rotation, the other rotations (two columns each) and the joints."""
        root = functional.l1_loss(predicted[:, :6], recorded[:, :6])
        rotations = functional.l1_loss(predicted[:, 6:], recorded[:, 6:])
        positions = functional.l1_loss(predicted_joints, recorded_joints)
        shape = self.configuration
        loss = shape.root_weight * root + shape.rotation_weight * rotations + shape.position_weight * positions
        return {"loss": loss, "root": root, "rotations": rotations, "positions": positions}


def _head(shape: RegressorConfiguration, values: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(shape.width, shape.hidden), nn.ReLU(), nn.Linear(shape.hidden, values))
