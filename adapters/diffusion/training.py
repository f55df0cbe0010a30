"""Losses of what the benchmark looks at: where the head points, whether planted feet stay, where the wrists end.

Ours (docs/methods/pr.md): beside the features of a whole body these have so small a share of the study's loss that a
small network does not learn them. All are squared metres, averaged over frames. At the end the task of ``prbench
train`` for MDM and P&R: a denoiser in its state before the first step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import msgspec
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from prbench.errors import UsageError
from prbench.geometry.skeleton import TOES, WRISTS, Joint
from prbench.protocol.manifests import load_protocol
from prbench.representation.tensors import decode
from prbench_adapters.diffusion import configuration as encoding
from prbench_adapters.diffusion import goal_frame as goals
from prbench_adapters.diffusion.configuration import ConditionScaling, DenoiserConfiguration, EncodedCondition
from prbench_adapters.diffusion.denoiser import Counts, Denoiser, FrameDenoiser
from prbench_adapters.diffusion.goal_frame import Joints
from prbench_adapters.diffusion.model import KIND, TextVectors, goal_frame, network, stored_scaling, stored_statistics
from prbench_adapters.diffusion.sampling import SCHEDULES
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.configuration import require_within
from prbench_adapters.training.dataset import Goal, collate
from prbench_adapters.training.task import TrainingData, TrainingModule, split_model_table
from prbench_adapters.training.weights import Weights, origin_of, read_weights, representation_entry, weights_header

Values = Float[torch.Tensor, "batch frames *value"]

Features = Float[torch.Tensor, "batch frames features"]
Kept = Bool[Tensor, "batch frames"]
Shares = Float[Tensor, "batch 1"] | float

_NEAREST = 0.3
# Metres: the goal's distance counts as at least and at most this, so that near and far goals are both learnt.
_FARTHEST = 2.5
# Seconds around the prime time within which the head counts in full: most of the benchmark's window of one second.
_PRIMING_WIDTH = 0.75
_OTHER_TIMES = 0.2
# Seconds before the end in which wrists count: the last part of a reach.
_ENDING = 0.3


def ray_loss(
    predicted: Joints,
    recorded: Joints,
    goal: Float[Tensor, "batch 3"],
    valid: Kept,
    prime: Float[Tensor, "*batch frames"],
    shares: Shares = 1.0,
) -> Float[Tensor, ""]:
    """How far the head's axes miss the recorded ones at the distance of the goal.

    Args:
        predicted: Metres.
        recorded: Same frame.
        goal: Same frame; motions whose goal is NaN have no ray and a loss of 0.
        valid: False for padding.
        prime: Seconds of each frame after the prime time.
        shares: Factors of the sequences' losses.
    """
    distance = (goal[:, None] - recorded[:, :, Joint.HEAD]).norm(dim=-1).clamp(_NEAREST, _FARTHEST).nan_to_num()
    axes = zip(goals.head_axes(predicted), goals.head_axes(recorded), strict=True)
    missed = shares * sum((ours - theirs).square().sum(dim=-1) for ours, theirs in axes) * distance.square()
    weight = (_OTHER_TIMES + torch.exp(-(prime / _PRIMING_WIDTH).square())) * valid
    return (missed * weight).sum() / weight.sum().clamp_min(_OTHER_TIMES)


def foot_loss(predicted: Joints, recorded: Joints, valid: Kept, fps: float, shares: Shares = 1.0) -> Float[Tensor, ""]:
    """Squared steps of the toes between frames in which the recorded ones are planted."""
    stays = goals.still_steps(recorded, fps) & valid[:, 1:, None]
    slid = predicted[:, :, TOES].diff(dim=1).square().sum(dim=-1) * stays
    return (shares * slid.sum(dim=-1)).sum() / stays.sum().clamp_min(1)


def wrist_loss(
    predicted: Joints, recorded: Joints, valid: Kept, n_frames: Counts, fps: float, shares: Shares = 1.0
) -> Float[Tensor, ""]:
    """Squared distance of the wrists from the recorded ones at the end of the reach."""
    ending = valid & (torch.arange(predicted.shape[1], device=predicted.device) >= (n_frames[:, None] - _ENDING * fps))
    missed = shares * (predicted - recorded)[:, :, WRISTS].square().sum(dim=-1).mean(dim=-1)
    return (missed * ending).sum() / ending.sum()


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The losses, which diffusion steps are trained, and how often the text is hidden.

    Raises:
        ValueError: for a negative number.

    Attributes:
        joint_loss_weight: Weight of L_joint in square metres; 0 trains on features alone (table S5).
        velocity_loss_weight: Weight of the squared error of joint displacements between neighbouring frames, m²; not in
            the study.
        bone_loss_weight: Weight of the squared error of the 21 bone vectors, m²; not in the study. It teaches small
            models to keep lengths, and where the head points.
        ray_loss_weight: Weight of the miss of the head's axes at the goal's distance, m², most of all around the prime
            time; not in the study, where the neck-head bone has a thousandth of the loss.
        foot_loss_weight: Weight of the squared steps of planted toes, m²; not in the study.
        wrist_loss_weight: Weight of the squared error of the wrists at the end of the reach, m²; not in the study.
        noisiest_share: Share of the sequences that are trained on the noisiest sixth of the diffusion steps, beyond the
            uniform draw of the study. There alone the condition decides where a motion goes: afterwards the noisy
            motion shows it already.
        noise_floor: Above 0, the losses of a sequence count 1 / (its share of noise + this): little noise leaves little
            to miss, and would not be learnt. Not in the study.
        text_drop: Share of sequences whose text is replaced by the null text (*Prime and Reach*, section 5.1).
    """

    joint_loss_weight: float = 1.0
    velocity_loss_weight: float = 0.0
    bone_loss_weight: float = 0.0
    ray_loss_weight: float = 0.0
    foot_loss_weight: float = 0.0
    wrist_loss_weight: float = 0.0
    noisiest_share: float = 0.0
    noise_floor: float = 0.0
    text_drop: float = 0.2

    def __post_init__(self) -> None:
        require_within(self, "at least 0", *self.__struct_fields__)


def losses(
    objective: Objective,
    predicted: Features,
    clean: Features,
    predicted_joints: Joints,
    joints: Joints,
    padding: Kept,
    shares: Shares = 1.0,
) -> dict[str, torch.Tensor]:
    """Return weighted sum ``loss`` and its parts ``features``, ``joints``, ``velocities`` and ``bones``, unweighted.

    Sums of squares are divided by the number of features (the study's 263) and of valid frames.

    Args:
        objective: The weights.
        predicted: The network's clean features, standardised.
        clean: The recorded ones.
        predicted_joints: Decoded from the prediction, metres.
        joints: The recorded ones, same frame.
        padding: True where there is no frame; whatever stands there leaves no trace.
        shares: Factors of the sequences' losses.
    """
    valid = ~padding
    error = predicted_joints - joints
    sums = {
        "features": _squared(predicted - clean, valid),
        "joints": _squared(error, valid),
        "velocities": _squared(error.diff(dim=1), valid[:, 1:]),
        "bones": _squared(goals.bones(error), valid),
    }
    # The divisor of the features for joints as well, which keeps the study's ratio of the two losses.
    count = clean.shape[-1] * valid.sum(dim=1).sum()
    parts = {name: (shares * summed).sum() / count for name, summed in sums.items()}
    total = (
        parts["features"]
        + objective.joint_loss_weight * parts["joints"]
        + objective.velocity_loss_weight * parts["velocities"]
        + objective.bone_loss_weight * parts["bones"]
    )
    return {"loss": total, **{name: part.detach() for name, part in parts.items()}}


def _squared(error: Values, valid: Bool[torch.Tensor, "batch frames"]) -> Float[torch.Tensor, "batch 1"]:
    """Sum of the squares of each sequence over its valid frames."""
    return torch.where(valid, error.square().flatten(2).sum(dim=2), 0.0).sum(dim=1, keepdim=True)


def scored_losses(
    objective: Objective, predicted: Joints, batch: MotionBatch, shares: Shares = 1.0
) -> dict[str, torch.Tensor]:
    """Return the weighted sum ``loss`` of those of :mod:`.scored_losses` that have a weight, and these, unweighted.

    Args:
        objective: The weights.
        predicted: Decoded joints, canonical frame, metres.
        batch: The recorded motion.
        shares: Factors of the sequences' losses.
    """
    valid = ~batch.padding
    parts: dict[str, tuple[float, torch.Tensor]] = {}
    if objective.ray_loss_weight:
        frame = torch.arange(predicted.shape[1], device=predicted.device)
        # Sequences begin a fixed time before the prime time (docs/specification/constants.md, `lead`).
        after_prime = frame / batch.fps - load_protocol().curation.lead
        missed = ray_loss(predicted, batch.joints, batch.goal_location, valid, after_prime, shares)
        parts["ray"] = (objective.ray_loss_weight, missed)
    if objective.foot_loss_weight:
        slid = foot_loss(predicted, batch.joints, valid, batch.fps, shares)
        parts["feet"] = (objective.foot_loss_weight, slid)
    if objective.wrist_loss_weight:
        missed = wrist_loss(predicted, batch.joints, valid, batch.n_frames, batch.fps, shares)
        parts["wrists"] = (objective.wrist_loss_weight, missed)
    total = sum((weight * part for weight, part in parts.values()), predicted.new_zeros(()))
    return {"loss": total, **{name: part.detach() for name, (_, part) in parts.items()}}


def raw_condition_of_items(batch: MotionBatch, goal: Goal) -> Float[torch.Tensor, "batch size"]:
    """:func:`raw_condition` of motions that are trained on.

    Args:
        batch: The motions.
        goal: ``pose`` or ``location``.
    """
    target = batch.goal_joints if goal == "pose" else batch.goal_location
    return encoding.raw_condition(batch.initial_joints, batch.previous_joints, target, batch.fps)


@dataclass(frozen=True)
class Draw:
    """Random numbers of one training step of one network.

    Attributes:
        step: Index t of the diffusion step of each sequence, uniform unless the objective asks for more noise.
        without_text: True where the text is hidden, so that guidance has an unconditional model; the condition vector
            never is.
        noise: Standard normal, as many columns as the network sees.
    """

    step: Int[torch.Tensor, " batch"]
    without_text: Bool[torch.Tensor, " batch"]
    noise: Float[torch.Tensor, "batch frames columns"]


class DiffusionTraining(TrainingModule):
    """A denoiser with its losses.

    Args:
        denoiser: The denoiser before the first step.
        statistics: Mean and standard deviation that features are standardised with.
        scaling: Scaling of the condition vector; None for a model without a goal.
        texts: Vectors of the captions.
        objective: Weights of the losses.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        denoiser: Denoiser | FrameDenoiser,
        *,
        statistics: tuple[Float[torch.Tensor, " features"], Float[torch.Tensor, " features"]],
        scaling: ConditionScaling | None,
        texts: TextVectors,
        objective: Objective,
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.denoiser, self.scaling, self.texts = denoiser, scaling, texts
        self.objective, self.origin = objective, origin
        shape = denoiser.configuration
        alphas_cumprod = torch.as_tensor(SCHEDULES[shape.noise_schedule](shape.diffusion_steps).alphas_cumprod)
        self.mean: torch.Tensor
        self.std: torch.Tensor
        self.signal: torch.Tensor
        self.noise: torch.Tensor
        levels = (alphas_cumprod.sqrt().float(), (1 - alphas_cumprod).sqrt().float())
        # A resumed run makes them anew, so they are no part of its checkpoints.
        for name, values in zip(("mean", "std", "signal", "noise"), (*statistics, *levels), strict=True):
            self.register_buffer(name, values, persistent=False)

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Return the loss of one batch with noise of a random strength, and its parts.

        Returns:
            ``loss`` and its parts (:func:`prbench_adapters.diffusion.training.losses`).
        """
        draw = self.draw(batch, step)
        condition = self.condition(batch, draw.without_text)
        clean = self.standardised(batch, condition)
        predicted = self.denoiser(self.noisy(clean, draw), draw.step, condition, batch.n_frames)
        with torch.autocast(clean.device.type, enabled=False):  # joints are cumulative sums: float32 only
            features = predicted.float() * self.std + self.mean
            configuration = self.denoiser.configuration
            if configuration.features == "humanml3d":
                joints = decode(goals.smoothed(features, batch.n_frames) if configuration.smoothed else features)
            else:
                joints = goal_frame(condition, features).decode(features, batch.n_frames, batch.fps)
            floor = self.objective.noise_floor
            shares = 1.0 if floor == 0 else 1.0 / (self.noise[draw.step].square()[:, None] + floor)
            found = losses(self.objective, predicted.float(), clean, joints, batch.joints, batch.padding, shares)
            scored = scored_losses(self.objective, joints, batch, shares)
            return {**found, **scored, "loss": found["loss"] + scored["loss"]}

    def standardised(self, batch: MotionBatch, condition: EncodedCondition) -> Features:
        """Return the features of the recorded motions as the network sees them; zeros in padding."""
        if self.denoiser.configuration.features == "humanml3d":
            features = batch.features
        else:
            features = goal_frame(condition, batch.joints).encode(batch.joints, batch.fps)
        return ((features - self.mean) / self.std).masked_fill(batch.padding[..., None], 0.0)

    def noisy(self, clean: Features, draw: Draw) -> Features:
        """Standardised features with noise of the strength of each sequence's step."""
        return self.signal[draw.step][:, None, None] * clean + self.noise[draw.step][:, None, None] * draw.noise

    def draw(self, batch: MotionBatch, step: int) -> Draw:
        """Draw the random numbers of a step for a batch of this shape: a function of seed, step and rank."""
        generator = self.generator(step)
        device = batch.features.device
        n = len(batch.features)
        t = torch.randint(len(self.signal), (n,), generator=generator)
        without_text = torch.rand(n, generator=generator) < self.objective.text_drop
        noise = torch.randn((*batch.padding.shape, self.denoiser.configuration.n_features), generator=generator)
        # Drawn last, so that the numbers above are the same with and without it.
        if self.objective.noisiest_share:
            noisiest = len(self.signal) - 1 - torch.randint(-(-len(self.signal) // 6), (n,), generator=generator)
            t = torch.where(torch.rand(n, generator=generator) < self.objective.noisiest_share, noisiest, t)
        return Draw(*(values.to(device, non_blocking=True) for values in (t, without_text, noise)))

    def condition(self, batch: MotionBatch, without_text: Bool[torch.Tensor, " batch"]) -> EncodedCondition:
        """Encode what the network is told about a batch: the text unless hidden, the scaled condition vector always."""
        text, padding = (values.to(batch.features.device, non_blocking=True) for values in self.texts(batch.text))
        text = text.masked_fill(without_text[:, None, None], 0.0)
        if self.scaling is None:
            return EncodedCondition(text, padding)
        raw = raw_condition_of_items(batch, cast(Goal, self.denoiser.configuration.goal))
        return EncodedCondition(text, padding, self.scaling(raw), raw)

    def hidden_matrices(self) -> tuple[nn.Parameter, ...]:
        """Return the matrices of the layers; weights of neighbours are no matrix."""
        named = self.denoiser.layers.named_parameters()
        return tuple(matrix for name, matrix in named if matrix.ndim == 2 and not name.endswith("neighbours"))

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """Return the denoiser with its statistics, and its file's header."""
        configuration = self.denoiser.configuration
        tensors = {f"denoiser.{name}": tensor for name, tensor in self.denoiser.state_dict().items()}
        tensors |= {"statistics.mean": self.mean, "statistics.std": self.std}
        if self.scaling is not None:
            tensors |= {"condition.mean": self.scaling.mean, "condition.std": self.scaling.std}
        standard = configuration.features == "humanml3d"
        representation = representation_entry(configuration.representation) if standard else configuration.features
        return tensors, weights_header(KIND, configuration, representation)


# Keys that fine-tuning may set otherwise than the weights that it starts from.
FREE_TO_CHANGE = frozenset(
    {"goal", "injection", "dropped", "condition_scaling", "dropout", "max_frames", "smoothed", "uniform_skeleton"}
)
_TOGETHER = 64  # sequences whose features are measured at once
# Metres, or of a unit vector: bones that hardly turn are not blown up.
_LEAST_FEATURE_STD = 0.05
_LEAST_CONDITION_STD = 0.01


@dataclass(frozen=True)
class DiffusionTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`).

    Attributes:
        goals: Kinds of goal that its models may have once they are fine-tuned.
        configurations: Import name of the package with the method's ``<name>-<configuration>.toml``.
    """

    name: str
    goals: tuple[str, ...]
    configurations: str

    def build(
        self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str
    ) -> TrainingModule:
        """Make the denoiser in its state before the first step.

        Statistics of features, and of the condition vector, come from the initial weights where these have them, else
        from the training split (docs/specification/pr-model.md#data-and-features).

        Args:
            model: Keys of :class:`DenoiserConfiguration` and of :class:`Objective`.
            data: The training split.
            initial: Weights to start from; parameters that they lack start as the network makes them.
            stage: ``pretrain`` or ``finetune``.

        Raises:
            UsageError: if the table does not describe such a model, or the data do not fit it.
            InputFileError: if the initial weights do not fit it.
        """
        configuration, objective = split_model_table(model, DenoiserConfiguration, Objective)
        allowed = ("none", *self.goals) if stage == "pretrain" or not self.goals else self.goals
        if configuration.goal not in allowed:
            problem = f"expected model.goal to be {' or '.join(allowed)}, found '{configuration.goal}'."
            raise UsageError(f"--method {self.name} --stage {stage}: {problem}")
        data.require_fit("the model", configuration)
        # Prime-and-reach tables keep everybody's own bones; HumanML3D alone comes on one skeleton, and has no goals.
        if configuration.uniform_skeleton and configuration.goal != "none":
            for table in data.train.tables:
                if not table.info.dataset.endswith("humanml3d"):
                    raise UsageError(
                        f"model.uniform_skeleton: expected bodies on HumanML3D's skeleton, found {table.info.dataset},"
                        " whose people have bones of their own. Leave the key out, or train on a HumanML3D corpus"
                        " alone."
                    )
        texts = TextVectors.of_model(configuration.text_encoder, configuration.text_dimension)
        start = read_weights(initial, kind=KIND) if initial is not None else None
        if start is not None:
            # Pre-training without a goal leaves its kind open; afterwards the condition's layers are sized for it.
            old = start.configuration(DenoiserConfiguration)
            fixed_by_goal = frozenset() if old.goal == "none" else {"goal", "injection"}
            start.require_same(configuration, apart_from=FREE_TO_CHANGE - fixed_by_goal)
        statistics, scaling = _scales(configuration, start, data)
        denoiser = network(configuration)
        if start is not None:
            # Fill a denoiser with trained weights; the parts that only the new configuration has keep their own start.
            trained = network(start.configuration(DenoiserConfiguration))
            start.load_into(trained, "denoiser")
            # Layers of a new condition are missing in the file and keep their start at zero.
            denoiser.load_state_dict(trained.state_dict(), strict=False)
        about: dict[str, Any] = {"texts": texts, "objective": objective, "origin": (texts.origin, *origin_of(start))}
        return DiffusionTraining(denoiser, statistics=statistics, scaling=scaling, **about)


def _scales(
    configuration: DenoiserConfiguration, start: Weights | None, data: TrainingData
) -> tuple[tuple[torch.Tensor, torch.Tensor], ConditionScaling | None]:
    """Scales of features and of the condition vector: those of the initial weights where they have them."""
    # Asked first, because it refuses data without goals, whatever we start from.
    own = None if configuration.goal == "none" else data.train.condition_statistics(configuration.goal)
    if start is not None and (configuration.goal == "none" or start.part("condition")):
        return stored_statistics(start, configuration), stored_scaling(start, configuration)
    if configuration.features == "goal-frame":
        # Scales of goal-frame features; no deviation is below 0.05.
        features = []
        conditions = []
        for first in range(0, len(data.train), _TOGETHER):
            batch = collate([data.train[index] for index in range(first, min(first + _TOGETHER, len(data.train)))])
            raw = raw_condition_of_items(batch, cast(Goal, configuration.goal))
            features.append(goals.GoalFrame.of(raw).encode(batch.joints, batch.fps)[~batch.padding])
            conditions.append(goals.seen_condition(raw))
        stacked = torch.cat(features)
        seen = torch.cat(conditions)
        scaling = ConditionScaling.of(configuration, seen.mean(dim=0), seen.std(dim=0).clamp_min(_LEAST_CONDITION_STD))
        return (stacked.mean(dim=0), stacked.std(dim=0).clamp_min(_LEAST_FEATURE_STD)), scaling
    if start is not None:
        features = stored_statistics(start, configuration)
    else:
        found = data.train.statistics()
        features = torch.as_tensor(found.mean), torch.as_tensor(found.std)
    if own is None:
        return features, None
    return features, ConditionScaling.of(configuration, torch.as_tensor(own[0]), torch.as_tensor(own[1]))
