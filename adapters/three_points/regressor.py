"""AvatarPoser's network: the values of some frames in, the local rotations of the last one's 22 joints out.

Source: docs/specification/three-points.md#avatarposer. Parameters have the names of the public program. Ours differs
from it where ``time`` is ``sinusoidal``: a row knows how long ago it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, cast

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from prbench.geometry.skeleton import N_JOINTS
from prbench_adapters.diffusion.denoiser import sinusoid_table
from prbench_adapters.three_points import features
from prbench_adapters.training.configuration import require_within

_TOGETHER = 256  # windows that go through the network together: they fit a processor's cache


class RegressorConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the network, the frames that it sees, and a weight of its losses; as published by default.

    Attributes:
        hidden: Width between the two layers of each head.
        window: Frames that it sees.
        time: What is added to the rows; ``none`` as published.
        root_weight: Weight of the root's rotation; the other rotations and the joints have 1.
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

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "width", "heads", "layers", "feed_forward", "hidden", "window", "fps")
        require_within(self, "at least 0 and below 1", "dropout")
        if self.width % self.heads or self.width % 2:
            raise ValueError(f"'width' must be even and a multiple of 'heads', found {self.width} and {self.heads}")


class Regressor(nn.Module):
    """Post-norm encoder, of whose last layer one row is computed, and two heads: the root, and the 21 other joints."""

    def __init__(self, configuration: RegressorConfiguration) -> None:
        super().__init__()
        shape = self.configuration = configuration
        self.linear_embedding = nn.Linear(features.N_VALUES, shape.width)
        sizes = (shape.width, shape.heads, shape.feed_forward, shape.dropout)
        layer = nn.TransformerEncoderLayer(*sizes, batch_first=True)
        self.transformer_encoder = nn.TransformerEncoder(layer, shape.layers, enable_nested_tensor=False)
        self.stabilizer = _head(shape, 6)
        self.joint_rotation_decoder = _head(shape, 6 * (N_JOINTS - 1))
        for module in self.modules():
            if isinstance(module, nn.Linear):  # the attention's input is none
                nn.init.kaiming_normal_(module.weight)
                module.weight.data.clamp_(-1.0, 1.0).mul_(0.2)

    def forward(self, windows: features.Windows) -> Float[Tensor, "windows 132"]:
        """Return two columns of the local rotations of each window's last frame, the root's in the window's frame.

        Args:
            windows: Values in the frame that the root's rotation is wanted in; fewer rows than ``window`` are the
                last ones.
        """
        stream = self.linear_embedding(windows)
        if self.configuration.time == "sinusoidal":
            stream = stream + sinusoid_table(windows.shape[1], self.configuration.width).flip(0).to(stream)
        for layer in cast("Any", self.transformer_encoder.layers):
            # Nothing reads other rows of the last layer.
            rows = stream[:, -1:] if layer is self.transformer_encoder.layers[-1] else stream
            rows = layer.norm1(rows + layer.dropout1(layer.self_attn(rows, stream, stream, need_weights=False)[0]))
            inner = layer.dropout(functional.relu(layer.linear1(rows)))
            stream = layer.norm2(rows + layer.dropout2(layer.linear2(inner)))
        last = stream[:, -1]
        return torch.cat([self.stabilizer(last), self.joint_rotation_decoder(last)], dim=1)

    def losses(self, batch: features.TrackWindows, generator: torch.Generator) -> dict[str, Tensor]:  # noqa: ARG002
        """Return the losses of windows by name, and the mean error of the joints; nothing is drawn."""
        columns = (self(batch.features).unflatten(1, (N_JOINTS, 6)), batch.rotations[:, -1])
        local = [features.matrices_of_columns(each) for each in columns]
        joints = [features.joints_under_head(each, batch.offsets, batch.head[:, -1]) for each in local]
        mpjpe = (joints[0] - joints[1]).norm(dim=-1).mean().detach()
        return self.loss_parts(columns, joints) | {"mpjpe": mpjpe}

    def loss_parts(self, columns: Sequence[Tensor], joints: Sequence[Tensor]) -> dict[str, Tensor]:
        """Mean absolute errors of the root's rotation, the other rotations and the joints, and their weighted sum.

        Args:
            columns: Two columns of each local rotation (windows, 22, 6), predicted and recorded.
            joints: Joints (windows, any, 3), predicted and recorded, metres.
        """
        predicted, recorded = columns
        root = functional.l1_loss(predicted[:, 0], recorded[:, 0])
        rotations = functional.l1_loss(predicted[:, 1:], recorded[:, 1:])
        positions = functional.l1_loss(joints[0], joints[1])
        loss = self.configuration.root_weight * root + rotations + positions
        return {"loss": loss, "root": root, "rotations": rotations, "positions": positions}

    @torch.no_grad()
    def rotations(self, rows: features.Rows, seed: int) -> Float[Tensor, "frames 22 3 3"]:  # noqa: ARG002
        """Return the local rotations of every frame of a track, the root's in the world; nothing is drawn.

        Args:
            rows: Values of the track (:func:`~prbench_adapters.three_points.features.track_values`).
            seed: Seed of those networks that draw something.
        """
        parts = []
        for ends in torch.arange(len(rows)).split(_TOGETHER):
            windows, turn, _ = features.in_head_frame(features.windows_ending_at(rows, ends, self.configuration.window))
            local = features.matrices_of_columns(self(windows).unflatten(1, (N_JOINTS, 6)))
            local[:, 0] = turn @ local[:, 0]
            parts.append(local)
        return torch.cat(parts)


def _head(shape: RegressorConfiguration, values: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(shape.width, shape.hidden), nn.ReLU(), nn.Linear(shape.hidden, values))
