"""The guided, imputed sampling steps of GMD and its two stages (docs/specification/gmd.md#sampling)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prbench.geometry.skeleton import Joint
from prbench_adapters.diffusion.generation import Guidance, SequenceNoise
from prbench_adapters.diffusion.noise_optimisation import smoothed_over_time
from prbench_adapters.diffusion.sampling import Chain, CosineSchedule, Denoise
from prbench_adapters.gmd.model import (
    HEADING,
    N_POSE,
    N_ROOT,
    ROOT_XZ,
    FeatureSpace,
    TemporalUNet,
    half_turn_of,
    pose_columns,
)

Columns = Float[Tensor, "batch frames columns"]
Features = Float[Tensor, "batch frames 263"]

# Maps the clean estimate (batch, frames, columns) to a loss a row (batch,).
RowLoss = Callable[[Tensor], Tensor]
# Limit at which the original cuts the clean estimate of the trajectory, in standard deviations.
_MOST_DEVIATIONS = 6.0
# Part of the first and last frame that is imputed: the pelvis on the ground, or in stage 2 the whole pose.
Keyframes = Literal["root", "pose"]


@dataclass(frozen=True)
class RootGoal:
    """Places wanted of the pelvis: canonical frame, metres."""

    xz: Float[Tensor, "batch frames 2"]
    wanted: Bool[Tensor, "batch frames"]

    def loss(self, root: Float[Tensor, "batch frames 2"]) -> Float[Tensor, " batch"]:
        """Mean error of each row over its own wanted coordinates, metres, of the pelvis on the ground."""
        error = torch.where(self.wanted[..., None], (root - self.xz).abs(), 0.0)
        return error.sum(dim=(1, 2)) / (2.0 * self.wanted.sum(dim=1)).clamp_min(1)

    def line(self) -> RootGoal:
        """Return way at constant speed from each wanted frame to the next, and to the first from the origin at frame 0.

        Nothing is wanted after the last of them.
        """
        frames = self.wanted.shape[1]
        frame = torch.arange(frames, device=self.wanted.device).expand_as(self.wanted)
        # For each frame the last anchor before it and the next wanted frame after it, without a loop over keyframes.
        before = torch.where(self.wanted | (frame == 0), frame, 0).cummax(dim=1).values
        after = torch.where(self.wanted, frame, frames).flip(1).cummin(dim=1).values.flip(1)
        reached = after.clamp_max(frames - 1)
        progress = ((frame - before) / (reached - before).clamp_min(1)).to(self.xz)
        anchors = torch.where(self.wanted[..., None], self.xz, 0.0)
        start, end = (anchors.gather(1, place[..., None].expand_as(anchors)) for place in (before, reached))
        return RootGoal(torch.lerp(start, end, progress[..., None]), after < frames)

    def bent(self, root: Float[Tensor, "batch frames 2"]) -> Float[Tensor, "batch frames 2"]:
        """Return a path that is moved to where it is wanted, and between two such frames by a share of both moves."""
        return root + RootGoal(self.xz - root, self.wanted).line().xz


# Standardised values, and the columns that sampling overwrites by them.
Imputed = tuple[Columns, Bool[Tensor, "batch frames columns"]]


def clean_of_noise(chain: Chain, i: int, state: Columns, noise: Columns) -> Columns:
    """Return the clean estimate that belongs to an estimate of the noise, cut at six standard deviations."""
    level = float(chain.alphas_cumprod[i])
    return ((state - math.sqrt(1 - level) * noise) / math.sqrt(level)).clamp(-_MOST_DEVIATIONS, _MOST_DEVIATIONS)


def guided_mean(
    clean_estimate: Denoise, chain: Chain, i: int, state: Columns, loss: RowLoss | None, scale: float
) -> Columns:
    """Return the posterior mean, moved by scale · β̃ · ∂loss/∂x_t; without a loss no gradient is taken.

    Args:
        clean_estimate: State and index in the training schedule, to the clean estimate.
        chain: The steps that are walked.
        i: Place in the chain.
        state: x_t.
        loss: Loss of the goal.
        scale: Weight of the gradient.
    """
    index = int(chain.indices[i])
    of_clean = float(chain.posterior_mean_clean[i])
    of_noisy = float(chain.posterior_mean_noisy[i])
    if loss is None:
        with torch.no_grad():
            return of_clean * clean_estimate(state, index) + of_noisy * state
    # Sampling itself runs without gradients; here the goal needs one, through the network.
    with torch.enable_grad():
        leaf = state.detach().requires_grad_()
        clean = clean_estimate(leaf, index)
        (gradient,) = torch.autograd.grad(loss(clean).sum(), leaf)
    return of_clean * clean.detach() + of_noisy * state - float(chain.posterior_variance[i]) * scale * gradient


def noised(chain: Chain, i: int, mean: Tensor, noise: Tensor) -> Tensor:
    """Return a draw from the posterior; at the last step the mean itself."""
    return mean + math.sqrt(chain.posterior_variance[i]) * noise if i else mean


def imputed_by_noising(chain: Chain, i: int, state: Columns, imputed: Imputed, noise: Tensor) -> Columns:
    """Overwrite x_{t-1} by the values, noised to its level: for a network that estimates the noise."""
    level = float(chain.alphas_cumprod_previous[i])
    # Values are clean, the state is noisy: they are noised to the state's level before they enter it.
    values, where = imputed
    return torch.where(where, math.sqrt(level) * values + math.sqrt(1 - level) * noise, state)


def imputed_in_mean(
    space: FeatureSpace, chain: Chain, i: int, state: Features, mean: Features, imputed: Imputed
) -> Features:
    """Overwrite columns of the mean by those of the posterior whose clean estimate holds the values.

    State and mean are projected; which columns are taken from which mean is decided in plain features. The posterior
    mean is linear, so only the columns in question are computed.
    """
    plain = space.unprojected(mean)
    noisy = space.unprojected(state)
    of_clean = float(chain.posterior_mean_clean[i])
    of_noisy = float(chain.posterior_mean_noisy[i])
    values, where = imputed
    return space.projected(torch.where(where, of_clean * values + of_noisy * noisy, plain))


@dataclass(frozen=True)
class Ends:
    """First and last frame of B motions, canonical frame, metres."""

    first: Float[Tensor, "batch 22 3"]
    last: Float[Tensor, "batch 22 3"]
    n_frames: Int[Tensor, " batch"]

    def valid(self) -> Bool[Tensor, "batch frames"]:
        """Return True for the frames that there are."""
        return torch.arange(int(self.n_frames.max()), device=self.first.device) < self.n_frames[:, None]

    def root_keyframes(self) -> RootGoal:
        """Return the pelvis on the ground in the first and in the last frame."""
        frame = torch.arange(int(self.n_frames.max()), device=self.first.device)
        is_last = frame == self.n_frames[:, None] - 1
        xz = torch.where(is_last[..., None], _ground(self.last), _ground(self.first))
        return RootGoal(xz, is_last | (frame == 0))

    def impute_poses(self, imputed: Imputed, space: FeatureSpace) -> Imputed:
        """Add root and joint positions of both frames; the goal's heading is that of its own joints."""
        values, where = (part.clone() for part in imputed)
        row = torch.arange(len(self.first), device=self.first.device)
        for pose, half_turn, frame in (
            # The first pose comes last and wins, should a motion have a single frame.
            (self.last, half_turn_of(self.last), self.n_frames - 1),
            (self.first, torch.zeros(len(self.first), device=self.first.device), torch.zeros_like(self.n_frames)),
        ):
            values[row, frame, :N_POSE] = space.standardised(pose_columns(pose, half_turn))
            where[row, frame, :N_POSE] = True
        return values, where


def imputed_root(goal: RootGoal, space: FeatureSpace, columns: int) -> Imputed:
    """Return the root of the wanted frames as standardised columns."""
    values = goal.xz.new_zeros(*goal.wanted.shape, columns)
    where = torch.zeros_like(values, dtype=torch.bool)
    values[..., ROOT_XZ] = (goal.xz - space.mean[ROOT_XZ]) / space.std[ROOT_XZ]
    where[..., ROOT_XZ] = goal.wanted[..., None]
    return values, where


def _ground(pose: Float[Tensor, "batch 22 3"]) -> Float[Tensor, "batch 1 2"]:
    return pose[:, None, Joint.PELVIS, ::2]


_THOUSAND = 1000
_GUIDED_FROM = 20
_LINE_FROM = 100
_PATH_DEVIATION = 3.0  # frames over which the jumps of a trajectory are spread; choice: they last three


@dataclass(frozen=True)
class GMDSettings:
    """Settings of sampling; the defaults are those of the original's evaluation.

    Attributes:
        guidance: Weight s of the text; 1 takes one network pass a step, anything else two.
        goal_scale: Weight of the gradient of the goal; 0 computes none.
        steps: Steps of the training schedule that each stage takes; None for all of them.
    """

    guidance: float = 2.5
    goal_scale: float = 100.0
    keyframes: Keyframes = "root"
    steps: int | None = None


class GuidedNetwork(Guidance):
    """A network with its text: what a sampler calls, step by step.

    Args:
        network: The network, in evaluation mode.
        text: One vector a row.
        n_frames: Valid frames of each row.
        window: Frames with padding, the same for all rows.
        scale: Guidance weight s.
    """

    def __init__(
        self,
        network: TemporalUNet,
        text: Float[Tensor, "batch dimension"],
        n_frames: Int[Tensor, " batch"],
        *,
        window: int,
        scale: float,
    ) -> None:
        super().__init__(scale)
        self.network, self.window = network, window
        self.text = self.both(text, torch.zeros_like(text))
        self.n_frames = self.both(n_frames, n_frames)

    def __call__(self, noisy: Columns, step: int) -> Columns:
        """Return the guided prediction at ``step`` of the training schedule."""

        def predict(rows: Tensor) -> Tensor:
            steps = torch.full((len(rows),), step, device=rows.device)
            return self.network(rows, steps, self.text, self.n_frames, window=self.window)

        return self.estimate(predict, noisy)


def sample_trajectory(
    predict_noise: GuidedNetwork,
    schedule: CosineSchedule,
    space: FeatureSpace,
    keyframes: RootGoal,
    noise: SequenceNoise,
    settings: GMDSettings,
) -> Float[Tensor, "batch frames 4"]:
    """Stage 1: the root's heading, x, z and height (raw) of motions that pass their keyframes, however many."""
    chain = schedule.chain(settings.steps or len(schedule))
    at_keyframes, on_line = (imputed_root(goal, space, N_ROOT) for goal in (keyframes, keyframes.line()))
    guided_from = _step(schedule, _GUIDED_FROM)
    line_from = _step(schedule, _LINE_FROM)
    loss = _root_loss(keyframes, settings, space.restored)
    state = noise.draw(N_ROOT)
    for i in range(len(chain) - 1, -1, -1):
        index = int(chain.indices[i])

        def clean(noisy: Columns, step: int, i: int = i) -> Columns:
            return clean_of_noise(chain, i, noisy, predict_noise(noisy, step))

        mean = guided_mean(clean, chain, i, state, loss if index >= guided_from else None, settings.goal_scale)
        # No noise is drawn for the last step; the order of draws is part of the result.
        state = noised(chain, i, mean, noise.draw(N_ROOT)) if i else mean
        # Early on the whole straight line is imputed, which leads the trajectory; later its keyframes alone, so that
        # it may bend. The original leaves the last steps free, and the root some centimetres beside its keyframes.
        imputed = on_line if index >= line_from else at_keyframes
        state = imputed_by_noising(chain, i, state, imputed, noise.draw(N_ROOT))
    return space.restored(state)


def without_jumps(
    trajectory: Float[Tensor, "batch frames 4"], keyframes: RootGoal, n_frames: Int[Tensor, " batch"]
) -> Float[Tensor, "batch frames 4"]:
    """Return a trajectory of stage 1 without the jump beside each keyframe, where the root was overwritten.

    Averaged over time the way is smooth and beside its keyframes, and then it is bent to them.
    """
    path = keyframes.bent(smoothed_over_time(trajectory[..., ROOT_XZ], n_frames, _PATH_DEVIATION))
    return torch.cat((trajectory[..., HEADING], path, trajectory[..., ROOT_XZ.stop :]), dim=-1)


def sample_motion(
    predict_clean: GuidedNetwork,
    schedule: CosineSchedule,
    space: FeatureSpace,
    trajectory: Float[Tensor, "batch frames 4"],
    ends: Ends,
    noise: SequenceNoise,
    settings: GMDSettings,
) -> Features:
    """Stage 2: raw features of motions whose pelvis follows the trajectory of stage 1."""
    chain = schedule.chain(settings.steps or len(schedule))
    goal = RootGoal(trajectory[..., ROOT_XZ], ends.valid())
    imputed = imputed_root(goal, space, len(space.mean))
    if settings.keyframes == "pose":
        imputed = ends.impute_poses(imputed, space)
    guided_from = _step(schedule, _GUIDED_FROM)
    loss = _root_loss(goal, settings, lambda clean: space.restored(space.unprojected(clean)))
    state = noise.draw()
    for i in range(len(chain) - 1, -1, -1):
        index = int(chain.indices[i])
        mean = guided_mean(predict_clean, chain, i, state, loss if index >= guided_from else None, settings.goal_scale)
        mean = imputed_in_mean(space, chain, i, state, mean, imputed)
        state = noised(chain, i, mean, noise.draw()) if i else mean
    return space.restored(space.unprojected(state))


def _root_loss(goal: RootGoal, settings: GMDSettings, restored: Callable[[Tensor], Tensor]) -> RowLoss | None:
    """Return the loss of the goal on a clean estimate; None if its gradient has no weight."""
    return (lambda clean: goal.loss(restored(clean)[..., ROOT_XZ])) if settings.goal_scale else None


def _step(schedule: CosineSchedule, of_thousand: int) -> int:
    """Return a limit of a schedule of 1000 steps in this one."""
    return -(-of_thousand * len(schedule) // _THOUSAND)
