"""Architecture of a denoiser, stored as JSON beside its weights, and conditions as the denoiser takes them.

Conditions are encoded text and the vector p of initial pose, initial velocity and goal
(docs/specification/pr-model.md#task-and-conditions and docs/specification/pr-model.md#network; *Prime and Reach*,
section 4.1). Everything is given in the canonical frame of the first pose, in metres; velocities are in metres per
second. :attr:`DenoiserConfiguration.condition_parts` tells where each part stands in the vector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import msgspec
import torch
from jaxtyping import Bool, Float

from prbench.contract import ConditionBatch
from prbench.representation.features import N_FEATURES
from prbench_adapters.diffusion.goal_frame import N_GOAL_FRAME_FEATURES, seen_condition, seen_size
from prbench_adapters.tensors import TensorRecord
from prbench_adapters.training.configuration import require_within

_ConditionPart = Literal["initial_pose", "initial_velocity", "goal", "text"]

_POSE = 66  # 22 joints with x, y, z
_GOAL_SIZE = {"none": 0, "pose": _POSE, "location": 3}


class DenoiserConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Architecture, conditions and data of a denoiser.

    Sources: docs/specification/mdm.md#network, docs/specification/pr-model.md#network.

    The defaults are the sizes of the paper: decoder, DistilBERT's word tokens, T = 50, conditions added to the memory.

    Raises:
        ValueError: for sizes that do not fit together.

    Attributes:
        architecture: ``frames`` is ours, for small models with a goal (:mod:`prbench_adapters.diffusion.denoiser`).
        features: What the network sees of a motion: HumanML3D's 263 numbers a frame, or ours
            (:mod:`prbench_adapters.diffusion.goal_frame`), which the architecture ``frames`` is made for.
        frames_per_token: Neighbouring frames that share a token; 1 as in the paper. More make small models quicker, in
            training and in noise optimisation alike.
        text_tokens: One memory token per word piece, or their mean; the encoder architecture always takes the mean.
        dropped: Conditions that the model never sees, in training and later (*Prime and Reach*, table 3).
        noise_schedule: One of :data:`.sampling.SCHEDULES`. Few steps of the published ``cosine`` leave out the noise in
            which the pace of a whole motion is drawn, and the little noise in which the way of a wrist is.
        smoothed: Average neighbouring frames with weights 1, 2, 1 when HumanML3D's features are decoded, in training as
            well. That leaves a fifth of the jerk of independent errors; not in the study. Goal-frame features are
            always averaged.
        time_in_frames: Put the time token also in front of the frames of a decoder. Source:
            docs/specification/mdm.md#network.
        uniform_skeleton: True if the features are those of bodies rescaled to HumanML3D's skeleton. Source:
            docs/specification/pr-model.md#data-and-features.
    """

    architecture: Literal["decoder", "encoder", "frames"] = "decoder"
    features: Literal["humanml3d", "goal-frame"] = "humanml3d"
    width: int = 512
    heads: int = 4
    layers: int = 8
    feed_forward: int = 1024
    dropout: float = 0.1
    frames_per_token: int = 1
    text_encoder: str = "distilbert"
    text_dimension: int = 768
    text_tokens: Literal["all", "pooled"] = "all"
    goal: Literal["none", "pose", "location"] = "none"
    injection: Literal["addition", "cross-attention"] = "addition"
    dropped: tuple[_ConditionPart, ...] = ()
    condition_scaling: Literal["standardised", "none"] = "standardised"
    diffusion_steps: int = 50
    noise_schedule: Literal["cosine", "geometric"] = "cosine"
    representation: Literal["continuous", "reference"] = "continuous"
    fps: float = 20.0
    max_frames: int = 241
    smoothed: bool = False
    time_in_frames: bool = False
    uniform_skeleton: bool = False

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "width", "heads", "layers", "feed_forward", "frames_per_token")
        require_within(self, "at least 1", "text_dimension", "diffusion_steps", "max_frames")
        # Even, because the table of sinusoids pairs sines with cosines.
        if self.width % self.heads or self.width % 2:
            raise ValueError(f"'width' must be even and a multiple of 'heads' ({self.heads}), found {self.width}")
        require_within(self, "at least 0 and below 1", "dropout")
        require_within(self, "above 0", "fps")
        if (self.architecture == "frames") is not (self.features == "goal-frame"):
            problem = f"expected frames with goal-frame, or neither, found {self.architecture} with {self.features}"
            raise ValueError(f"'architecture' and 'features': {problem}")
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

    def raw_condition(self, batch: ConditionBatch) -> Float[torch.Tensor, "batch size"] | None:
        """:func:`raw_condition` of what a method is given; None for a model without a goal.

        Raises:
            ValueError: if the batch holds no goal of the model's kind.
        """
        if self.goal == "none":
            return None
        goal = batch.goal_joints if self.goal == "pose" else batch.goal_location
        if goal is None or batch.initial_joints is None or batch.previous_joints is None:
            raise ValueError(f"a model of goals of kind '{self.goal}' cannot use '{batch.condition.value}'")
        given = (batch.initial_joints, batch.previous_joints, goal)
        return raw_condition(*(torch.as_tensor(part, dtype=torch.float32) for part in given), fps=batch.fps)


@dataclass(frozen=True)
class EncodedCondition(TensorRecord):
    """Conditions of B motions.

    Attributes:
        text: Vectors of the frozen text encoder, one per word piece.
        padding: True where a row has no word piece. The first token of a row always counts, so that no row is without
            any.
        vector: Initial pose, initial velocity and goal, scaled (docs/specification/pr-model.md#network); None without a
            goal.
        given: The same as it was given (:func:`raw_condition`): what goal-frame features are measured from.
    """

    text: Float[torch.Tensor, "batch tokens dimension"]
    padding: Bool[torch.Tensor, "batch tokens"]
    vector: Float[torch.Tensor, "batch size"] | None = None
    given: Float[torch.Tensor, "batch raw"] | None = None

    def __len__(self) -> int:
        return len(self.text)

    def without_text(self) -> EncodedCondition:
        """Return the unconditional half of guidance: zeros for the text vectors; its padding and the vector stay."""
        return replace(self, text=torch.zeros_like(self.text))

    def then(self, other: EncodedCondition) -> EncodedCondition:
        """Return these motions and those of ``other`` as one batch; both have the same number of tokens.

        Raises:
            ValueError: if only one of the two has a vector.
        """
        if (self.vector is None) is not (other.vector is None):
            raise ValueError("conditions with and without a vector cannot share a batch")
        theirs = iter(other.tensors().values())
        return self.each(lambda ours: torch.cat([ours, next(theirs)]))


def raw_condition(
    initial_joints: Float[torch.Tensor, "batch 22 3"],
    previous_joints: Float[torch.Tensor, "batch 22 3"],
    goal: Float[torch.Tensor, "batch 22 3"] | Float[torch.Tensor, "batch 3"],
    fps: float,
) -> Float[torch.Tensor, "batch size"]:
    """Return initial pose (m), initial velocity (m/s) and goal (m) of each sequence, flattened and joined, unscaled.

    Args:
        initial_joints: The first frame, canonical, metres.
        previous_joints: The frame before it, same frame.
        goal: The last frame, or the location to reach.
        fps: Frames per second.
    """
    # Per second, so that tables of another frame rate mean the same by the same number.
    velocity = (initial_joints - previous_joints) * fps
    return torch.cat([part.flatten(1) for part in (initial_joints, velocity, goal)], dim=1).float()


@dataclass(frozen=True)
class ConditionScaling:
    """Scales a raw vector for the network: ``(raw - mean) / std``, dropped conditions zero.

    With goal-frame features the raw vector is first seen from the goal (:func:`.goal_frame.seen_condition`).

    Attributes:
        kept: 0 for conditions that the model never sees, in training and test alike (table 3), else 1.
        from_goal: True with goal-frame features.
    """

    mean: Float[torch.Tensor, " size"]
    std: Float[torch.Tensor, " size"]
    kept: Float[torch.Tensor, " size"]
    from_goal: bool = False

    @classmethod
    def of(
        cls, configuration: DenoiserConfiguration, mean: Float[torch.Tensor, " size"], std: Float[torch.Tensor, " size"]
    ) -> ConditionScaling:
        """Scale by the statistics of a training split, or by none if the configuration says so.

        ``condition_scaling = "none"`` is the literal reading of the study: metres, and metres per frame for the
        velocity (docs/specification/pr-model.md#gaps-in-the-study, gap 8).
        """
        if configuration.features == "goal-frame":
            return cls(mean, std, torch.ones_like(mean), from_goal=True)
        parts = configuration.condition_parts
        kept = torch.ones_like(mean)
        if configuration.condition_scaling == "none":
            mean = torch.zeros_like(mean)
            std = torch.ones_like(std)
            # Dividing metres per second by frames per second gives metres per frame.
            std[parts["initial_velocity"]] = configuration.fps
        for name, part in parts.items():
            if name in configuration.dropped:
                kept[part] = 0.0
        return cls(mean, std, kept)

    def __call__(self, raw: Float[torch.Tensor, "batch raw"]) -> Float[torch.Tensor, "batch size"]:
        """Scale a batch, on its own device."""
        mean, std, kept = (values.to(raw.device) for values in (self.mean, self.std, self.kept))
        return ((seen_condition(raw) if self.from_goal else raw) - mean) / std * kept
