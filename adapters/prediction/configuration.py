"""What a motion-prediction diffusion is made of: one frozen record, and the published ones by name.

Source: docs/specification/prediction-networks.md#configuration.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from prbench.protocol.manifests import read_toml
from prbench_adapters.training.configuration import require_within


class DiffusionConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """GazeMoDiff, HumanMAC and what lies between them.

    The defaults are those of GazeMoDiff's public program with the decisions of
    docs/specification/gazemodiff.md#where-paper-and-code-differ.

    Attributes:
        gaze: A unit direction as the last node: gaze, or the head's direction in its place.
        coefficients: DCT coefficients L that a window is described by; all else of its motion is lost.
        cross_attention: Whether the denoiser looks at each coefficient of the condition besides the condition vector.
        encoder: Whether the condition is encoded; else it is the DCT of the padded observation, as in HumanMAC.
        end_block: The last block of an encoder: a bare layer with the encoder's input added, as in the public program,
            or a layer with normalisation, tanh and dropout, as in the paper.
        leaky_features: LeakyReLU on what graph attention has aggregated, as in the paper.
        queries: What asks in cross-attention: the motion, as in the public program, or the condition, whose values are
            then weighed by softmax(Q) softmax(Kᵀ) with keys from the motion, as in the paper.
        legacy_layout: Scramble the encoder's axes as the public program does, to load or to compare its weights.
        predicts: What the denoiser's output stands for. Noise is published, and needs a network much wider than a pose
            has numbers: at the noisiest step an error of 0.01 in the noise is one of 0.75 in the clean coefficients.
            The velocity √ᾱ ε - √(1 - ᾱ) x0 is for small networks.
        residual: Diffuse the difference to the padded observation in place of the coefficients themselves.
        whitened: Diffuse residuals as uncorrelated numbers of equal spread (:mod:`.whitening`); for small networks,
            too.
        condition_kept: Share of training windows that keep their condition.
        condition_kept_sampling: Share of samples that keep it when motions are predicted.
        dropped: What a window without condition loses: the vector and what cross-attention sees, or the vector alone.
        guidance: Weight s of the condition, ε = ε_without + s (ε_with - ε_without); any but 1 takes two passes a step.

    Raises:
        ValueError: for sizes that do not fit together.
    """

    n_joints: int
    gaze: bool = True
    observed: int = 15
    predicted: int = 60
    coefficients: int = 10

    width: int = 512
    heads: int = 8
    layers: int = 4
    feed_forward: int = 1024
    dropout: float = 0.2
    cross_attention: bool = True

    encoder: bool = True
    pose_encoder: bool = True
    gaze_encoder: bool = True
    fusion: Literal["graph-attention", "concatenation"] = "graph-attention"
    encoder_width: int = 128
    encoder_heads: int = 4
    fusion_blocks: int = 4
    encoder_dropout: float = 0.3
    fusion_dropout: float = 0.2
    end_block: Literal["residual", "normalised"] = "residual"
    leaky_features: bool = False
    queries: Literal["motion", "condition"] = "motion"
    legacy_layout: bool = False

    predicts: Literal["noise", "velocity"] = "noise"
    residual: bool = False
    whitened: bool = False
    diffusion_steps: int = 1500
    sampling_steps: int = 100
    condition_kept: float = 0.9
    condition_kept_sampling: float = 1.0
    dropped: Literal["both", "vector"] = "both"
    guidance: float = 1.0

    def __post_init__(self) -> None:
        sizes = ("n_joints", "observed", "predicted", "coefficients", "width", "heads", "feed_forward")
        require_within(self, "at least 1", *sizes, "diffusion_steps", "sampling_steps")
        require_within(self, "at least 1", "encoder_width", "encoder_heads", "fusion_blocks")
        require_within(self, "at least 0 and below 1", "dropout", "encoder_dropout", "fusion_dropout")
        require_within(self, "from 0 to 1", "condition_kept", "condition_kept_sampling")
        if self.layers < 2 or self.layers % 2:
            raise ValueError(f"'layers' must be even and at least 2, as halves are joined, found {self.layers}")
        if self.width % 2 or self.width % self.heads:
            raise ValueError(f"'width' must be even and divisible by 'heads' ({self.heads}), found {self.width}")
        if self.coefficients > self.frames:
            raise ValueError(f"'coefficients' must be at most the {self.frames} frames, found {self.coefficients}")
        if self.diffusion_steps % self.sampling_steps or self.diffusion_steps == self.sampling_steps:
            raise ValueError(
                f"'sampling_steps' must divide the {self.diffusion_steps} diffusion steps and be fewer,"
                f" found {self.sampling_steps}: with a remainder the noisiest steps would be left out"
            )
        if self.whitened and not self.residual:
            raise ValueError("'whitened' needs 'residual' true: only differences to the observation are whitened")
        if self.guidance != 1.0 and self.condition_kept_sampling != 1.0:
            raise ValueError("'guidance' other than 1 needs 'condition_kept_sampling' 1: both drop the condition")

    @property
    def frames(self) -> int:
        """Frames of a window, N = observed + predicted."""
        return self.observed + self.predicted

    @property
    def nodes(self) -> int:
        """Joints, and the direction if there is one."""
        return self.n_joints + self.gaze

    @property
    def values(self) -> int:
        """Numbers of one coefficient or frame: 3 a node."""
        return 3 * self.nodes


# Configurations of the tables, the ablations, and the published programs by name: what differs from the defaults.
PRESETS = read_toml("prbench_adapters.prediction", "presets.toml", dict[str, dict[str, Any]])


def preset(name: str, *, n_joints: int, **changes: Any) -> DiffusionConfiguration:
    """Return a configuration by name.

    Args:
        name: One of ``PRESETS``.
        n_joints: Joints of the body.
        changes: Keys that differ from the preset.

    Raises:
        ValueError: for other names, and for sizes that do not fit together.
    """
    if name not in PRESETS:
        raise ValueError(f"no configuration is named {name!r}; there are {', '.join(PRESETS)}")
    return DiffusionConfiguration(**{"n_joints": n_joints, **PRESETS[name], **changes})
