"""A DART model: frames of motion as it describes them, sizes, options, networks and weights.

Source: docs/specification/dart.md. A frame is 276 numbers, seen from the frame of reference of its primitive. Options
are those of ``--option key=value``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import msgspec
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from prbench.errors import InputFileError
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.text import text_encoder
from prbench_adapters.diffusion.denoiser import TransformerLayer, pooled, sinusoid_table
from prbench_adapters.diffusion.generation import choice, number, whole_number
from prbench_adapters.diffusion.model import TextVectors, torch_device
from prbench_adapters.diffusion.noise_optimisation import Hand
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.finishing import FINISHING_OPTIONS, Finishing
from prbench_adapters.kinematics import fitted_rotations, matrices_of, rows_of, unit
from prbench_adapters.tensors import TensorRecord
from prbench_adapters.training.configuration import require_within
from prbench_adapters.training.weights import Weights, read_weights

Latents = Float[Tensor, "batch 1 latent"]
Joints = Float[Tensor, "batch frames *joints 3"]  # metres
History = Float[Tensor, "batch history 276"]
Embedded = Float[Tensor, "batch dimension"]

N_FEATURES = 276
# Numbers of each field of :class:`Frames`, in their order.
_SIZES = (3, 6, 6 * (N_JOINTS - 1), 3, 6, 3 * N_JOINTS, 3 * N_JOINTS)


@dataclass(frozen=True)
class Placement(TensorRecord):
    """Placement of a primitive's frame of reference in another: points there are ``rotation @ p + origin``."""

    rotation: Float[Tensor, "batch 3 3"]
    origin: Float[Tensor, "batch 3"]

    def points(self, points: Joints) -> Joints:
        """Points given here, there."""
        return _turned(self.rotation, points) + _broadcast(self.origin, points)

    def first(self, n: int) -> Placement:
        """Placements of the first motions."""
        return self.each(lambda values: values[:n])

    def then(self, inner: Placement) -> Placement:
        """Return the placement of a frame of reference that is placed here by ``inner``."""
        return Placement(
            self.rotation @ inner.rotation, self.origin + (self.rotation @ inner.origin[..., None])[..., 0]
        )


@dataclass(frozen=True)
class Frames(TensorRecord):
    """Frames of B motions in one frame of reference each; deltas lead to the next frame.

    Attributes:
        orientation: Orientation of the root.
        body: Each other joint's rotation relative to the bone before: the first two rows, as they are; predicted ones
            need not be those of a rotation, and go on to the next history as predicted (as in the original).
        orientation_delta: Next orientation · this one, transposed.
    """

    translation: Float[Tensor, "batch frames 3"]
    orientation: Float[Tensor, "batch frames 3 3"]
    body: Float[Tensor, "batch frames 21 6"]
    translation_delta: Float[Tensor, "batch frames 3"]
    orientation_delta: Float[Tensor, "batch frames 3 3"]
    joints: Float[Tensor, "batch frames 22 3"]
    joints_delta: Float[Tensor, "batch frames 22 3"]

    @classmethod
    def of_joints(cls, joints: Float[Tensor, "batch frames_and_one 22 3"]) -> Frames:
        """All frames but the last, which is where the last delta leads to."""
        rotations = fitted_rotations(joints)
        orientation = rotations[:, :, 0]
        pelvis = joints[:, :, Joint.PELVIS]
        moves = (pelvis.diff(dim=1), orientation[:, 1:] @ orientation[:, :-1].mT, joints[:, :-1], joints.diff(dim=1))
        return cls(pelvis[:, :-1], orientation[:, :-1], rows_of(rotations[:, :-1, 1:]), *moves)

    @classmethod
    def unpack(cls, features: Float[Tensor, "batch frames 276"]) -> Frames:
        """Read features in metres; orientations that are no rotation become one (Gram-Schmidt)."""
        # In the order of the fields, which is that of the original's 276 numbers.
        translation, orientation, body, step, turn, joints, moves = features.split(_SIZES, dim=-1)
        body = body.unflatten(-1, (N_JOINTS - 1, 6))
        places = (each.unflatten(-1, (N_JOINTS, 3)) for each in (joints, moves))
        return cls(translation, matrices_of(orientation), body, step, matrices_of(turn), *places)

    def pack(self) -> Float[Tensor, "batch frames 276"]:
        """Write features, metres: translation 3, rotations 132, delta 3, orientation's delta 6, joints 66, deltas 66.

        Rotations are the first two *rows* of their matrices.
        """
        before = (self.translation, rows_of(self.orientation), self.body.flatten(2))
        moves = (self.translation_delta, rows_of(self.orientation_delta))
        return torch.cat((*before, *moves, self.joints.flatten(2), self.joints_delta.flatten(2)), dim=-1)

    def rotations(self) -> Float[Tensor, "batch frames 22 3 3"]:
        """Return the root's orientation and the joints' rotations, for forward kinematics."""
        return torch.cat((self.orientation[:, :, None], matrices_of(self.body)), dim=2)

    def part(self, start: int, stop: int) -> Frames:
        """Return some of the frames."""
        return self.each(lambda values: values[:, start:stop])

    def canonical(self) -> tuple[Frames, Placement]:
        """Return the frames in the frame of reference of the first one, and where that stands."""
        placement = canonical_placement(self.joints[:, 0])
        back = placement.rotation.mT
        translation, joints = (
            _turned(back, points - _broadcast(placement.origin, points)) for points in (self.translation, self.joints)
        )
        # A turn between two world orientations is changed on both sides; an orientation on the left alone.
        orientation = back[:, None] @ self.orientation
        turn = back[:, None] @ self.orientation_delta @ placement.rotation[:, None]
        step, moves = (_turned(back, vectors) for vectors in (self.translation_delta, self.joints_delta))
        return Frames(translation, orientation, self.body, step, turn, joints, moves), placement


def canonical_placement(joints: Float[Tensor, "batch 22 3"]) -> Placement:
    """Return a pose's own frame: origin in its pelvis, x to the right along the ground, z up, y to the front."""
    across = joints[:, Joint.RIGHT_HIP] - joints[:, Joint.LEFT_HIP]
    up = torch.zeros_like(across)
    up[:, 2] = 1.0
    # Along the ground, so that the frame of reference stays upright however the body leans.
    right = unit(across * (1.0 - up))
    return Placement(torch.stack((right, torch.linalg.cross(up, right), up), dim=-1), joints[:, Joint.PELVIS])


def _turned(rotation: Float[Tensor, "batch 3 3"], vectors: Joints) -> Joints:
    return (vectors.flatten(1, -2) @ rotation.mT).reshape(vectors.shape)


def _broadcast(origin: Float[Tensor, "batch 3"], points: Tensor) -> Tensor:
    return origin.reshape(len(origin), *(1,) * (points.ndim - 2), 3)


# H: the last frames of one primitive, which the next begins with; the first has those of the initial state.
HISTORY_FRAMES = 2

_OF_OPTIMISATION = ("iterations", "learning-rate", "noise-scale", "ddim-steps", "hand")
OPTIONS = ("optimise", *_OF_OPTIMISATION, "guidance", *FINISHING_OPTIONS, "text-path")
_MOST_ITERATIONS = 100_000


class DartConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The networks of one model; the defaults are the original's sizes (docs/specification/dart.md#networks).

    Raises:
        ValueError: for sizes that do not fit together.

    Attributes:
        future_frames: F: frames that a primitive adds.
        latent: Numbers of the latent vector of a primitive.
        vae_layers: Layers of encoder and decoder each; odd: as many in front of the middle one as behind it.
        uniform_skeleton: True for a model that has learnt bodies that were rescaled to HumanML3D's skeleton
            (docs/specification/pr-model.md#data-and-features); conditions are then put onto it, and motions scaled
            back.
    """

    future_frames: int = 8
    latent: int = 256
    vae_width: int = 256
    vae_heads: int = 4
    vae_layers: int = 7
    vae_feed_forward: int = 1024
    width: int = 512
    heads: int = 4
    layers: int = 8
    feed_forward: int = 1024
    dropout: float = 0.1
    text_encoder: str = "distilbert"
    text_dimension: int = 768
    diffusion_steps: int = 10
    fps: float = 20.0
    uniform_skeleton: bool = False

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "future_frames", "latent", "vae_width", "vae_heads", "vae_layers")
        require_within(self, "at least 1", "vae_feed_forward", "width", "heads", "layers", "feed_forward")
        require_within(self, "at least 1", "text_dimension", "diffusion_steps")
        # Skips join each layer in front of the middle one to a layer behind it.
        if self.vae_layers % 2 == 0:
            raise ValueError(f"'vae_layers' must be odd, found {self.vae_layers}")
        if self.future_frames < HISTORY_FRAMES:
            raise ValueError(f"'future_frames' must be at least {HISTORY_FRAMES}, found {self.future_frames}")
        for width, heads in (("vae_width", "vae_heads"), ("width", "heads")):
            # Even, because the table of sinusoids pairs sines with cosines.
            if getattr(self, width) % getattr(self, heads) or getattr(self, width) % 2:
                raise ValueError(f"'{width}' must be even and a multiple of '{heads}', found {getattr(self, width)}")
        require_within(self, "at least 0 and below 1", "dropout")
        require_within(self, "above 0", "fps")

    @property
    def primitive_frames(self) -> int:
        """H + F."""
        return HISTORY_FRAMES + self.future_frames

    def primitives_for(self, n_frames: int) -> int:
        """Count the primitives of a motion of ``n_frames``, history included; the last may be longer than needed."""
        return max(1, -(-(n_frames - HISTORY_FRAMES) // self.future_frames))


_AS_PREDICTED = Finishing(bones=False, feet=False)


@dataclass(frozen=True, kw_only=True)
class DartSettings:
    """Settings of generation; the defaults are those of the study's comparison.

    Source: docs/specification/dart.md#conditions-in-the-study.

    Attributes:
        optimised: Optimise the noise towards the goal; otherwise the goal is not looked at.
        iterations: *Prime and Reach*, section 5.3.
        learning_rate: Learning rate of Adam in the first iteration; falls linearly, to a hundredth of it in the last of
            100.
        noise_scale: Standard deviation of the noise that optimisation starts from (the original's setting for
            in-betweening).
        ddim_steps: Steps of the chain from noise to latent; None for all of the training's, as in the original.
        hand: Wrist that a goal location is meant for; ``nearest`` leaves the choice to the motion.
        finishing: What is kept in the roll-out and finished at the end; nothing in the original.
    """

    optimised: bool = True
    iterations: int = 100
    learning_rate: float = 0.05
    noise_scale: float = 0.1
    ddim_steps: int | None = None
    guidance: float = 5.0
    hand: Hand = "right"
    finishing: Finishing = _AS_PREDICTED


# Ours, for a sixth of the time (docs/methods/dart.md#input-and-options).
_FAST = DartSettings(iterations=40, learning_rate=0.1, ddim_steps=4, guidance=2.5)


def dart_settings(options: Mapping[str, str], *, diffusion_steps: int) -> DartSettings:
    """Return the settings that options ask for.

    Args:
        options: The options that were given.
        diffusion_steps: Steps that the model was trained with.

    Raises:
        ValueError: naming an option that has an impossible value, or does not go with another.
    """
    mode = choice(options, "optimise", ("fast", "paper", "off"))
    optimised = mode != "off"
    default = _FAST if mode == "fast" else DartSettings()
    steps = default.ddim_steps and min(default.ddim_steps, diffusion_steps)
    # An option that changes nothing is a mistake of the user, who must hear of it.
    idle = [] if optimised else [key for key in _OF_OPTIMISATION if key in options]
    if idle:
        raise ValueError(f"option '{idle[0]}' belongs to noise optimisation; choose optimise=fast or paper.")
    return DartSettings(
        optimised=optimised,
        iterations=whole_number(options, "iterations", most=_MOST_ITERATIONS) or default.iterations,
        learning_rate=number(options, "learning-rate", default.learning_rate),
        noise_scale=number(options, "noise-scale", default.noise_scale),
        ddim_steps=whole_number(options, "ddim-steps", most=diffusion_steps) or steps,
        guidance=number(options, "guidance", default.guidance),
        hand=cast(Hand, choice(options, "hand", ("right", "nearest", "left"))),
        finishing=Finishing.of(options),
    )


_LARGEST_LOG_VARIANCE = 10.0
_SPREAD = 0.02  # of learned tokens and positions before the first step


class _SkipTransformer(nn.Module):
    """A transformer encoder whose later layers also see what the earlier ones gave, as in a U-Net."""

    def __init__(self, width: int, heads: int, feed_forward: int, layers: int, dropout: float) -> None:
        super().__init__()
        around = range(layers // 2)

        def layer() -> TransformerLayer:
            return TransformerLayer(width, heads, feed_forward, dropout, cross_attention=False)

        self.input_layers = nn.ModuleList(layer() for _ in around)
        self.middle_layer = layer()
        self.output_layers = nn.ModuleList(layer() for _ in around)
        self.joins = nn.ModuleList(nn.Linear(2 * width, width) for _ in around)
        self.norm = nn.LayerNorm(width)

    def forward(self, stream: Float[Tensor, "batch tokens width"]) -> Float[Tensor, "batch tokens width"]:
        """All tokens look at all."""
        seen = []
        for layer in self.input_layers:
            stream = layer(stream, None, None, None)
            seen.append(stream)
        stream = self.middle_layer(stream, None, None, None)
        for layer, join in zip(self.output_layers, self.joins, strict=True):
            stream = layer(join(torch.cat((stream, seen.pop()), dim=-1)), None, None, None)
        return self.norm(stream)


class PrimitiveVAE(nn.Module):
    """A latent vector from the frames of a primitive, and its future frames from latent and history."""

    def __init__(self, configuration: DartConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width = configuration.vae_width
        frames = configuration.primitive_frames
        sizes = (width, configuration.vae_heads, configuration.vae_feed_forward, configuration.vae_layers)
        self.frame_embedding = nn.Linear(N_FEATURES, width)
        self.distribution_tokens = nn.Parameter(torch.randn(2, width) * _SPREAD)
        self.encoder_positions = nn.Parameter(torch.randn(2 + frames, width) * _SPREAD)
        self.encoder = _SkipTransformer(*sizes, configuration.dropout)
        self.encoder_head = nn.Linear(width, configuration.latent)
        self.latent_embedding = nn.Linear(configuration.latent, width)
        self.decoder_positions = nn.Parameter(torch.randn(1 + frames, width) * _SPREAD)
        self.decoder = _SkipTransformer(*sizes, configuration.dropout)
        self.decoder_head = nn.Linear(width, N_FEATURES)

    def encode(self, history: History, future: Float[Tensor, "batch future 276"]) -> tuple[Latents, Latents]:
        """Mean and logarithm of the variance of the latent; features are standardised."""
        frames = self.frame_embedding(torch.cat((history, future), dim=1))
        tokens = torch.cat((self.distribution_tokens.expand(len(frames), -1, -1), frames), dim=1)
        # The two tokens in front are read, one for the mean and one for the variance.
        found = self.encoder_head(self.encoder(tokens + self.encoder_positions)[:, :2])
        return found[:, :1], found[:, 1:].clamp(-_LARGEST_LOG_VARIANCE, _LARGEST_LOG_VARIANCE)

    def decode(self, latent: Latents, history: History) -> Float[Tensor, "batch future 276"]:
        """Standardised features of the future frames; the latent as :meth:`encode` gives it, not divided by its std."""
        embedded = (self.latent_embedding(latent), self.frame_embedding(history))
        # Frames to come have no content of their own: their position says which one each query asks for.
        queries = embedded[0].new_zeros(len(latent), self.configuration.future_frames, self.configuration.vae_width)
        stream = self.decoder(torch.cat((*embedded, queries), dim=1) + self.decoder_positions)
        return self.decoder_head(stream[:, -self.configuration.future_frames :])


class LatentDenoiser(nn.Module):
    """The clean latent from a noisy one, its diffusion step, a text and the history."""

    def __init__(self, configuration: DartConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width = configuration.width
        self.time_embedding = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.text_embedding = nn.Linear(configuration.text_dimension, width)
        self.history_embedding = nn.Linear(N_FEATURES, width)
        self.latent_embedding = nn.Linear(configuration.latent, width)
        sizes = (width, configuration.heads, configuration.feed_forward, configuration.dropout)
        layers = range(configuration.layers)
        self.layers = nn.ModuleList(TransformerLayer(*sizes, cross_attention=False) for _ in layers)
        self.head = nn.Linear(width, configuration.latent)
        self.dropout = nn.Dropout(configuration.dropout)
        self.sinusoid: Tensor
        rows = max(configuration.diffusion_steps, 3 + HISTORY_FRAMES)
        self.register_buffer("sinusoid", sinusoid_table(rows, width), persistent=False)

    def forward(self, noisy: Latents, step: Int[Tensor, " batch"], text: Embedded, history: History) -> Latents:
        """Return the clean latent, divided by its std as the noisy one is.

        Args:
            noisy: Noisy latents.
            step: Index of the diffusion step of each.
            text: One vector each; zeros for no text.
            history: Standardised features.
        """
        tokens = (
            self.time_embedding(self.sinusoid[step])[:, None],
            self.text_embedding(text)[:, None],
            self.history_embedding(history),
            self.latent_embedding(noisy),
        )
        stream = torch.cat(tokens, dim=1)
        stream = self.dropout(stream + self.sinusoid[: stream.shape[1]])
        for layer in self.layers:
            stream = layer(stream, None, None, None)
        return self.head(stream[:, -1:])


KIND = "dart"
# Header entry: the 276 features, with rotations fitted to joints instead of those of a body model.
REPRESENTATION = f"dart-{N_FEATURES}/fitted"


class FeatureScaling:
    """Frames as standardised features and back.

    Args:
        mean: Mean of the features of training primitives, each in the frame of reference of its primitive.
        std: Their standard deviation, floored.
    """

    def __init__(self, mean: Float[Tensor, " 276"], std: Float[Tensor, " 276"]) -> None:
        self.mean, self.std = mean, std

    def standardised(self, frames: Frames) -> Float[Tensor, "batch frames 276"]:
        """Standardise frames, as the networks see them."""
        return (frames.pack() - self.mean) / self.std

    def frames(self, standardised: Float[Tensor, "batch frames 276"]) -> Frames:
        """Restore frames from what the networks put out."""
        return Frames.unpack(standardised * self.std + self.mean)


class DartModel:
    """Frozen: what rolling out and noise optimisation work with.

    Args:
        vae: The trained autoencoder; is put into evaluation mode, without gradients of its parameters.
        denoiser: The trained denoiser, treated alike.
        scaling: Scaling of the features.
        latent_std: Standard deviation of all numbers of the latents of training primitives.
        texts: Vectors of captions.
    """

    def __init__(
        self,
        vae: PrimitiveVAE,
        denoiser: LatentDenoiser,
        *,
        scaling: FeatureScaling,
        latent_std: float,
        texts: TextVectors,
    ) -> None:
        self.vae = vae.eval().requires_grad_(False)
        self.denoiser = denoiser.eval().requires_grad_(False)
        self.device = denoiser.head.weight.device
        self.scaling = FeatureScaling(scaling.mean.to(self.device), scaling.std.to(self.device))
        self.latent_std = latent_std
        self.texts = texts
        self.schedule = CosineSchedule(self.configuration.diffusion_steps)

    @property
    def configuration(self) -> DartConfiguration:
        """Sizes, text and diffusion."""
        return self.denoiser.configuration

    @classmethod
    def load(cls, path: Path, device: str = "cpu", *, text_path: str | None = None) -> DartModel:
        """Read a weights file (``prbench_adapters.training.weights``).

        Args:
            path: ``<name>.safetensors``.
            device: ``cpu``, ``cuda``, ``cuda:1`` …
            text_path: Folder of the text encoder's own files, if it has some.

        Raises:
            AdapterError: if there is no such device.
            InputFileError: if the file holds no weights of DART, misshaped ones, or those of a training that was
                stopped before its second phase.
            UsageError: if its text encoder is unknown or has no files.
        """
        where = torch_device(device)
        weights = read_weights(path, kind=KIND)
        configuration = weights.configuration(DartConfiguration)
        vae = PrimitiveVAE(configuration)
        denoiser = LatentDenoiser(configuration)
        weights.load_into(vae, "vae")
        weights.load_into(denoiser, "denoiser")
        latent_std = float(weights.require("latent.std", (1,)))
        if not latent_std > 0:
            remedy = "The training was stopped while it trained the VAE; go on with the same `prbench train` command."
            found = f"{latent_std:g}"
            raise InputFileError(path, "latent.std", expected="a positive number", found=found, remedy=remedy)
        texts = TextVectors(text_encoder(configuration.text_encoder, text_path))
        return cls(vae.to(where), denoiser.to(where), scaling=scaling_of(weights), latent_std=latent_std, texts=texts)

    def text_vectors(self, texts: tuple[str, ...]) -> Embedded:
        """One vector a text, on the model's device."""
        return pooled_texts(self.texts, texts).to(self.device)


def pooled_texts(vectors: TextVectors, texts: tuple[str, ...]) -> Embedded:
    """Return the mean of each text's token vectors; zeros for an empty text, which networks take for none."""
    # Text encoders give vectors for an empty text, too, and the networks know none by zeros.
    return pooled(*vectors(texts))[:, 0] * torch.tensor([bool(text.strip()) for text in texts])[:, None]


def scaling_of(weights: Weights) -> FeatureScaling:
    """Return the statistics of a weights file.

    Raises:
        InputFileError: if there are none.
    """
    shape = (N_FEATURES,)
    return FeatureScaling(weights.require("statistics.mean", shape), weights.require("statistics.std", shape))
