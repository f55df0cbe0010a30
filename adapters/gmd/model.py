"""The networks of GMD: its features, the U-Net over time of both stages, and weights files.

Sources: docs/specification/gmd.md#networks; the features are HumanML3D's with an absolute root, and the random
projection that emphasises it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import pad

from prbench.geometry.skeleton import Joint
from prbench.randomness import named_generator
from prbench.representation.features import JOINT_POSITIONS, N_FEATURES, ROOT_HEIGHT
from prbench.text import text_encoder
from prbench_adapters.diffusion.denoiser import Counts, from_zero, pooled, sinusoid_table
from prbench_adapters.diffusion.model import TextVectors, torch_device
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.tensors import TensorRecord
from prbench_adapters.training.configuration import require_within
from prbench_adapters.training.weights import Weights, read_weights

Matrix = Float[Tensor, "263 263"]
Channels = Float[Tensor, "batch channels frames"]
Hidden = Float[Tensor, "batch width frames"]
Signal = Float[Tensor, "batch frames channels"]
Texts = Float[Tensor, "batch dimension"]
Condition = Float[Tensor, "batch size"]

# Half the turn of the heading since the first frame, radians.
HEADING = slice(0, 1)
# Pelvis on the ground, canonical frame, metres.
ROOT_XZ = slice(1, 3)
# Columns of the root, which are all that the trajectory network sees.
N_ROOT = ROOT_HEIGHT.stop
# Columns that decide the joints of a frame: root and joint positions.
N_POSE = JOINT_POSITIONS.stop
_EMPHASISED = 3
# Number of the draw of A: of the first forty the one that is best to invert, condition number 1108.
_DRAW = 13


def with_absolute_root(features: Float[Tensor, "*batch frames 263"]) -> Float[Tensor, "*batch frames 263"]:
    """Replace the steps of the root, columns 0 to 2, by where they lead from the origin."""
    steps = pad(features[..., :-1, : ROOT_XZ.stop].movedim(-1, 0), (1, 0))  # each frame's step from the one before
    # The column holds half of each frame's turn, and sums of halves are half of the sum.
    half_turn = steps[0].cumsum(-1)
    cos = (2 * half_turn).cos()
    sin = (2 * half_turn).sin()
    x = (cos * steps[1] - sin * steps[2]).cumsum(-1)
    z = (sin * steps[1] + cos * steps[2]).cumsum(-1)
    return torch.cat((torch.stack((half_turn, x, z), -1), features[..., ROOT_HEIGHT.start :]), -1)


def decode_absolute(features: Float[Tensor, "*batch frames columns"]) -> Float[Tensor, "*batch frames 22 3"]:
    """Joints of every row, from its first 67 columns alone; canonical frame, metres."""
    half_turn, root_x, root_z = features[..., : ROOT_XZ.stop].unbind(-1)
    pelvis = torch.stack((root_x, features[..., ROOT_HEIGHT.start], root_z), -1)
    cos = (2 * half_turn).cos()[..., None]
    sin = (2 * half_turn).sin()[..., None]
    x, y, z = features[..., JOINT_POSITIONS].unflatten(-1, (21, 3)).unbind(-1)
    joints = torch.stack((cos * x - sin * z + root_x[..., None], y, sin * x + cos * z + root_z[..., None]), -1)
    return torch.cat((pelvis[..., None, :], joints), -2)


def pose_columns(joints: Float[Tensor, "batch 22 3"], half_turn: Float[Tensor, " batch"]) -> Float[Tensor, "batch 67"]:
    """Return the columns that decode to a pose, given its heading: any heading leads back to the same joints.

    Args:
        joints: Canonical frame, metres.
        half_turn: Half the turn of the heading, radians; 0 for the first frame of a motion.
    """
    pelvis = joints[:, Joint.PELVIS]
    # Heights stay: only x and z are relative to the pelvis.
    local = joints[:, 1:] - pelvis[:, None] * pelvis.new_tensor((1.0, 0.0, 1.0))
    cos = (2 * half_turn).cos()[:, None]
    sin = (2 * half_turn).sin()[:, None]
    x, y, z = local.unbind(-1)
    turned = torch.stack((cos * x + sin * z, y, cos * z - sin * x), -1)
    return torch.cat((half_turn[:, None], pelvis[:, ::2], pelvis[:, 1:2], turned.flatten(1)), dim=1)


def half_turn_of(joints: Float[Tensor, "batch 22 3"]) -> Float[Tensor, " batch"]:
    """Half the turn of a single pose's heading, by hips and shoulders as the representation takes them, unsmoothed."""
    hips = joints[:, Joint.LEFT_HIP] - joints[:, Joint.RIGHT_HIP]
    across = hips + joints[:, Joint.RIGHT_SHOULDER] - joints[:, Joint.LEFT_SHOULDER]
    return 0.5 * torch.atan2(-across[:, 2], -across[:, 0])


@dataclass(frozen=True)
class FeatureSpace(TensorRecord):
    """Leads from raw features to what the networks see and back: statistics, projection and its inverse.

    Attributes:
        projection: A: the motion network sees standardised features times A.
    """

    mean: Float[Tensor, " 263"]
    std: Float[Tensor, " 263"]
    projection: Matrix
    inverse: Matrix

    @classmethod
    def of(cls, mean: Float[Tensor, " 263"], std: Float[Tensor, " 263"], projection: Matrix) -> FeatureSpace:
        """Compute the inverse in float64, because A is badly conditioned."""
        inverse = torch.linalg.inv(projection.double().cpu()).to(projection)
        return cls(mean.to(projection), std.to(projection), projection, inverse)

    def standardised(self, raw: Float[Tensor, "*batch columns"]) -> Float[Tensor, "*batch columns"]:
        """Standardise the first columns, as many as there are."""
        columns = raw.shape[-1]
        return (raw - self.mean[:columns]) / self.std[:columns]

    def restored(self, standardised: Float[Tensor, "*batch columns"]) -> Float[Tensor, "*batch columns"]:
        """Return the inverse of :meth:`standardised`."""
        columns = standardised.shape[-1]
        return standardised * self.std[:columns] + self.mean[:columns]

    def projected(self, standardised: Float[Tensor, "*batch 263"]) -> Float[Tensor, "*batch 263"]:
        """Project features, as the motion network sees them."""
        return standardised @ self.projection

    def unprojected(self, projected: Float[Tensor, "*batch 263"]) -> Float[Tensor, "*batch 263"]:
        """Return the inverse of :meth:`projected`."""
        return projected @ self.inverse


def emphasis_projection(emphasis: float) -> Matrix:
    """Return the fixed random matrix A: standard normal entries, rows 0 to 2 times c, all over √(263 - 3 + 3 c²).

    The numbers are rounded to half precision, in which weights may be stored.
    """
    # Fixed for ever: weights hold what was learnt in this very projection.
    drawn = named_generator("gmd-emphasis-projection", _DRAW).standard_normal((N_FEATURES, N_FEATURES))
    drawn[:_EMPHASISED] *= emphasis
    drawn /= (N_FEATURES - _EMPHASISED + _EMPHASISED * emphasis**2) ** 0.5
    return torch.from_numpy(drawn).half().float()


# Groups of every group normalisation; widths are multiples of it.
GROUPS = 8
_KERNEL = 5


class GMDConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes, conditions and data of the motion and the trajectory network (docs/specification/gmd.md#networks).

    The defaults are those of the released models, but for the text encoder, whose vectors are averaged over the word
    pieces to one vector a caption.

    Raises:
        ValueError: for sizes that do not fit together.

    Attributes:
        motion_widths: Channels of each level of the motion network; every further level halves the frames.
        condition_width: Numbers of the vector of step and text, in both networks.
        emphasis: Weight c of the three absolute root features in the random projection.
        padded_frames: Every motion is padded with zeros to this length before a network sees it: group normalisation
            takes its statistics over padding too, so the length must not depend on the batch.
        padding_step: Motions that are longer than ``padded_frames`` are padded to the next multiple of this.
        smoothed: Average neighbouring frames with weights 1, 2, 1 when motions are decoded, in training as well, which
            leaves a fifth of the jerk of independent errors. The first and the last frame stay.
        uniform_skeleton: True if the features are those of bodies rescaled to HumanML3D's skeleton. Source:
            docs/specification/pr-model.md#data-and-features.
    """

    motion_widths: tuple[int, ...] = (1024, 1024, 1024, 1024)
    trajectory_widths: tuple[int, ...] = (64, 128, 256)
    condition_width: int = 512
    emphasis: float = 10.0
    text_encoder: str = "distilbert"
    text_dimension: int = 768
    diffusion_steps: int = 1000
    representation: Literal["continuous", "reference"] = "continuous"
    fps: float = 20.0
    max_frames: int = 241
    padded_frames: int = 224
    padding_step: int = 8
    smoothed: bool = False
    uniform_skeleton: bool = False

    def __post_init__(self) -> None:
        for name in ("motion_widths", "trajectory_widths"):
            widths = getattr(self, name)
            if not widths or any(width < GROUPS or width % GROUPS for width in widths):
                raise ValueError(f"'{name}' must be one or more positive multiples of {GROUPS}, found {list(widths)}")
        require_within(self, "at least 1", "text_dimension", "diffusion_steps", "max_frames")
        if self.condition_width < 2 or self.condition_width % 2:
            raise ValueError(f"'condition_width' must be even and positive, found {self.condition_width}")
        require_within(self, "above 0", "emphasis", "fps")
        why = "because the levels of the networks halve the frames"
        for name in ("padded_frames", "padding_step"):
            if (found := getattr(self, name)) < 1 or found % self.stride:
                raise ValueError(f"'{name}' must be a multiple of {self.stride}, {why}, found {found}")

    @property
    def stride(self) -> int:
        """Divisor of the number of frames that lets it be halved between all levels."""
        return 2 ** (max(len(self.motion_widths), len(self.trajectory_widths)) - 1)

    def window(self, n_frames: int) -> int:
        """Frames with padding: ``padded_frames``, for longer motions the next multiple of ``padding_step``."""
        return max(self.padded_frames, -(-n_frames // self.padding_step) * self.padding_step)


class TemporalUNet(nn.Module):
    """Maps a noisy signal, the step and a text vector to what the network predicts: clean signal or noise.

    Args:
        channels: Channels of the signal: 263 for motions, 4 for trajectories.
        widths: Channels of each level, the finest first.
        configuration: Width of the condition, text and steps.
    """

    def __init__(self, channels: int, widths: Sequence[int], configuration: GMDConfiguration) -> None:
        super().__init__()
        self.channels, size = channels, configuration.condition_width
        self.time_embedding = nn.Sequential(nn.Linear(size, size), nn.SiLU(), nn.Linear(size, size))
        self.text_embedding = nn.Linear(configuration.text_dimension, size)
        self.condition = nn.Sequential(nn.Linear(size, 4 * size), nn.Mish(), nn.Linear(4 * size, size))
        levels = list(pairwise((channels, *widths)))
        # Going down a convolution of stride 2 halves the frames; going up its transpose doubles them.
        self.down = nn.ModuleList(
            _Level(before, width, size, nn.Conv1d(width, width, 3, stride=2, padding=1) if more else nn.Identity())
            for (before, width), more in zip(levels, (*levels[1:], None), strict=True)
        )
        self.middle = nn.ModuleList(_ResidualBlock(widths[-1], widths[-1], size) for _ in range(2))
        self.up = nn.ModuleList(
            _Level(2 * width, before, size, nn.ConvTranspose1d(before, before, 4, stride=2, padding=1))
            for before, width in reversed(levels[1:])
        )
        self.head = nn.Sequential(_ConvBlock(widths[0], widths[0]), nn.Conv1d(widths[0], channels, 1))
        self.register_buffer("sinusoid", sinusoid_table(configuration.diffusion_steps, size), persistent=False)
        self.sinusoid: Tensor

    def forward(self, noisy: Signal, step: Counts, text: Texts, n_frames: Counts, *, window: int) -> Signal:
        """Predict.

        Args:
            noisy: What stands behind ``n_frames`` leaves no trace in what stands before.
            step: Index t in the training schedule.
            text: One vector a caption; zeros for none.
            n_frames: Valid frames of each row.
            window: Frames with padding (:meth:`GMDConfiguration.window`); it changes the result.
        """
        frames = noisy.shape[1]
        valid = torch.arange(frames, device=noisy.device) < n_frames.to(noisy.device)[:, None]
        stream = noisy.masked_fill(~valid[..., None], 0.0).transpose(1, 2)
        # To a fixed length: group normalisation takes its statistics over padding, too.
        stream = nn.functional.pad(stream, (0, window - frames))
        condition = self.condition(self.time_embedding(self.sinusoid[step]) + self.text_embedding(text))
        skips = []
        for level in self.down:
            # The stream before the resolution changes is what the way up is given again.
            skip, stream = level(stream, condition)
            skips.append(skip)
        for block in self.middle:
            stream = block(stream, condition)
        for level in self.up:
            _, stream = level(torch.cat([stream, skips.pop()], dim=1), condition)
        return self.head(stream)[..., :frames].transpose(1, 2)


class _Level(nn.Module):
    """Two residual blocks, and a change of resolution after them."""

    def __init__(self, channels: int, width: int, condition_width: int, resample: nn.Module) -> None:
        super().__init__()
        inner = (channels, width)
        self.blocks = nn.ModuleList(_ResidualBlock(before, width, condition_width) for before in inner)
        self.resample = resample

    def forward(self, stream: Channels, condition: Condition) -> tuple[Hidden, Float[Tensor, "batch width others"]]:
        """Return the stream before and after the change of resolution."""
        for block in self.blocks:
            stream = block(stream, condition)
        return stream, self.resample(stream)


class _ResidualBlock(nn.Module):
    """Two convolution blocks beside a skip; the condition scales and shifts the first.

    The condition's layer and the second convolution start at zero.
    """

    def __init__(self, channels: int, width: int, condition_width: int) -> None:
        super().__init__()
        self.first = _ConvBlock(channels, width)
        self.condition = from_zero(nn.Linear(condition_width, 2 * width))
        self.second = _ConvBlock(width, width, starts_at_zero=True)
        self.skip = nn.Conv1d(channels, width, 1) if channels != width else nn.Identity()

    def forward(self, stream: Channels, condition: Condition) -> Hidden:
        """Apply the block; ``condition`` is the vector of step and text."""
        scale, shift = self.condition(nn.functional.mish(condition)).chunk(2, dim=1)
        return self.second(self.first(stream, (scale, shift))) + self.skip(stream)


class _ConvBlock(nn.Module):
    """Convolution, group normalisation, Mish; with a scale and shift before the last if they are given."""

    def __init__(self, channels: int, width: int, *, starts_at_zero: bool = False) -> None:
        super().__init__()
        self.convolution = nn.Conv1d(channels, width, _KERNEL, padding=_KERNEL // 2)
        self.norm = nn.GroupNorm(GROUPS, width)
        if starts_at_zero:
            from_zero(self.convolution)

    def forward(self, stream: Channels, scale_shift: tuple[Tensor, Tensor] | None = None) -> Hidden:
        """Apply the block; ``scale_shift`` are (batch, width) each."""
        stream = self.norm(self.convolution(stream))
        if scale_shift is not None:
            scale, shift = scale_shift
            stream = stream * (1 + scale[..., None]) + shift[..., None]
        return nn.functional.mish(stream)


KIND = "gmd"


class GMDNetworks(torch.nn.Module):
    """The motion network, which estimates clean projected features; the trajectory network, which estimates noise."""

    def __init__(self, configuration: GMDConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.motion = TemporalUNet(N_FEATURES, configuration.motion_widths, configuration)
        self.trajectory = TemporalUNet(N_ROOT, configuration.trajectory_widths, configuration)


class GMDModel:
    """Frozen: what sampling works with.

    Args:
        networks: The trained networks; they are put into evaluation mode, their parameters ask for no gradients.
        space: Statistics and projection that they have learnt with.
        texts: Vectors of captions.
    """

    def __init__(self, networks: GMDNetworks, *, space: FeatureSpace, texts: TextVectors) -> None:
        self.networks = networks.eval().requires_grad_(False)
        self.configuration = networks.configuration
        self.device = next(networks.parameters()).device
        self.space, self.texts = space.to(self.device), texts
        self.schedule = CosineSchedule(self.configuration.diffusion_steps)

    @classmethod
    def load(cls, path: Path, device: str = "cpu", *, text_path: str | None = None) -> GMDModel:
        """Read a weights file (``prbench_adapters.training.weights``).

        Args:
            path: ``<name>.safetensors``.
            device: ``cpu``, ``cuda``, ``cuda:1`` …
            text_path: Folder of the text encoder's own files, if it has some.

        Raises:
            AdapterError: if there is no such device.
            InputFileError: if the file holds no weights of GMD for this representation, or misshaped ones.
            UsageError: if its text encoder is unknown or has no files.
        """
        where = torch_device(device)
        weights = read_weights(path, kind=KIND)
        configuration = weights.configuration(GMDConfiguration)
        weights.require_representation(configuration.representation)
        networks = GMDNetworks(configuration)
        weights.load_into(networks, "networks")
        texts = TextVectors(text_encoder(configuration.text_encoder, text_path))
        return cls(networks.to(where), space=stored_space(weights), texts=texts)

    def encode(self, captions: tuple[str, ...]) -> Texts:
        """One vector a caption."""
        return caption_vectors(self.texts, captions).to(self.device)


def caption_vectors(texts: TextVectors, captions: tuple[str, ...]) -> Texts:
    """Return the mean over the word pieces of each caption."""
    return pooled(*texts(captions))[:, 0]


def stored_space(weights: Weights) -> FeatureSpace:
    """Statistics and projection of a weights file.

    Raises:
        InputFileError: if one is missing or misshaped.
    """
    shapes = {"statistics.mean": (N_FEATURES,), "statistics.std": (N_FEATURES,), "projection": (N_FEATURES, N_FEATURES)}
    return FeatureSpace.of(*(weights.require(name, shape) for name, shape in shapes.items()))
