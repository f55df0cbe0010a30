"""Architecture of a denoiser: one frozen record, stored as JSON beside its weights."""

from __future__ import annotations

from typing import Literal

import msgspec

from prbench.representation.features import N_FEATURES
from prbench_adapters.diffusion.goal_frame import N_GOAL_FRAME_FEATURES, seen_size

_ConditionPart = Literal["initial_pose", "initial_velocity", "goal", "text"]

_POSE = 66  # 22 joints with x, y, z
_COUNTS = (
    "width",
    "heads",
    "layers",
    "feed_forward",
    "frames_per_token",
    "text_dimension",
    "diffusion_steps",
    "max_frames",
)
_GOAL_SIZE = {"none": 0, "pose": _POSE, "location": 3}


class DenoiserConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Architecture, conditions and data of a denoiser.

    Sources: docs/specification/mdm.md#network, docs/specification/pr-model.md#network.

    The defaults are the sizes of the paper: decoder, DistilBERT's word tokens, T = 50, conditions added to the memory.

    Raises:
        ValueError: for sizes that do not fit together.
    """

    architecture: Literal["decoder", "encoder", "frames"] = "decoder"
    """``frames`` is ours, for small models with a goal (:mod:`prbench_adapters.diffusion.frame_denoiser`)."""
    features: Literal["humanml3d", "goal-frame"] = "humanml3d"
    """What the network sees of a motion: HumanML3D's 263 numbers a frame, or ours
    (:mod:`prbench_adapters.diffusion.goal_frame`), which the architecture ``frames`` is made for."""
    width: int = 512
    heads: int = 4
    layers: int = 8
    feed_forward: int = 1024
    dropout: float = 0.1
    frames_per_token: int = 1
    """Neighbouring frames that share a token; 1 as in the paper. More make small models quicker, in training and in
    noise optimisation alike."""
    text_encoder: str = "distilbert"
    text_dimension: int = 768
    text_tokens: Literal["all", "pooled"] = "all"
    """One memory token per word piece, or their mean; the encoder architecture always takes the mean."""
    goal: Literal["none", "pose", "location"] = "none"
    injection: Literal["addition", "cross-attention"] = "addition"
    dropped: tuple[_ConditionPart, ...] = ()
    """Conditions that the model never sees, in training and later (*Prime and Reach*, table 3)."""
    condition_scaling: Literal["standardised", "none"] = "standardised"
    diffusion_steps: int = 50
    representation: Literal["continuous", "reference"] = "continuous"
    fps: float = 20.0
    max_frames: int = 241
    smoothed: bool = False
    """Average neighbouring frames with weights 1, 2, 1 when HumanML3D's features are decoded, in training as well. That
    leaves a fifth of the jerk of independent errors; not in the study. Goal-frame features are always averaged."""
    time_in_frames: bool = False
    """Put the time token also in front of the frames of a decoder.

    Source: docs/specification/mdm.md#network.
    """
    uniform_skeleton: bool = False
    """True if the features are those of bodies rescaled to HumanML3D's skeleton.

    Source: docs/specification/pr-model.md#data-and-features.
    """

    def __post_init__(self) -> None:
        for name in _COUNTS:
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        # Even, because the table of sinusoids pairs sines with cosines.
        if self.width % self.heads or self.width % 2:
            raise ValueError(f"'width' must be even and a multiple of 'heads' ({self.heads}), found {self.width}")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"'dropout' must be in [0, 1), found {self.dropout}")
        if self.fps <= 0:
            raise ValueError(f"'fps' must be positive, found {self.fps}")
        self._require_fitting_features()

    def _require_fitting_features(self) -> None:
        if (self.architecture == "frames") is not (self.features == "goal-frame"):
            raise ValueError(
                f"'architecture' and 'features': expected frames with goal-frame, or neither, found"
                f" {self.architecture} with {self.features}"
            )
        if self.features == "goal-frame" and (self.goal == "none" or set(self.dropped) - {"text"}):
            raise ValueError("'features': goal-frame needs 'goal' and the initial state; only text can be dropped")
        if self.features == "goal-frame" and self.uniform_skeleton:
            raise ValueError("'uniform_skeleton': goal-frame keeps everybody's own bones; leave the key out")

    @property
    def n_features(self) -> int:
        """Numbers of a frame."""
        return N_FEATURES if self.features == "humanml3d" else N_GOAL_FRAME_FEATURES

    @property
    def condition_parts(self) -> dict[_ConditionPart, slice]:
        """Places of the initial pose, the initial velocity and the goal in the condition vector."""
        if self.goal == "none":
            return {}
        return {
            "initial_pose": slice(0, _POSE),
            "initial_velocity": slice(_POSE, 2 * _POSE),
            "goal": slice(2 * _POSE, self.condition_size),
        }

    @property
    def condition_size(self) -> int:
        """Numbers in the condition vector: in the study 0 without a goal, 135 with a location, 198 with a pose."""
        if self.features == "goal-frame":
            return seen_size(self.goal)
        return 0 if self.goal == "none" else 2 * _POSE + _GOAL_SIZE[self.goal]
