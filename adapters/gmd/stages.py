"""Both stages of sampling: the root's trajectory towards its keyframes, then the body that follows it.

docs/specification/gmd.md#sampling. Limits that the page gives as steps of 1000 are fractions of the schedule here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from prbench_adapters.diffusion.batches import SequenceNoise
from prbench_adapters.diffusion.generation import Guidance
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.gmd.features import N_ROOT, ROOT_XZ, FeatureSpace
from prbench_adapters.gmd.sampling import (
    MOST_DEVIATIONS,
    Ends,
    GoalLoss,
    Keyframes,
    RootGoal,
    RowLoss,
    clean_of_noise,
    guided_mean,
    imputed_by_noising,
    imputed_in_mean,
    imputed_root,
    noised,
)
from prbench_adapters.gmd.unet import TemporalUNet

Imputation = Literal["end", "demo", "evaluation"]
"""Steps that impute: ``end`` are all steps of both stages, so that the root meets its keyframes exactly. The original
imputes the trajectory while t ≥ 20 of 1000, the motion while t ≥ 1 (``demo``) or t ≥ 20 (``evaluation``)."""

_THOUSAND = 1000
_GUIDED_FROM = 20
_LINE_FROM = 100
_IMPUTED_FROM: dict[Imputation, tuple[int, int]] = {"end": (0, 0), "demo": (20, 1), "evaluation": (20, 20)}
"""First steps of the imputation in stage 1 and in stage 2."""


@dataclass(frozen=True)
class GMDSettings:
    """Settings of sampling; the defaults are those of the evaluation, but for the end of the imputation."""

    guidance: float = 2.5
    """Weight s of the text; 1 takes one network pass a step, anything else two."""
    goal_scale: float = 100.0
    """Weight of the gradient of the goal; 0 computes none."""
    goal_loss: GoalLoss = "absolute"
    """``squared`` is the demo's."""
    imputation: Imputation = "end"
    keyframes: Keyframes = "root"
    steps: int | None = None
    """Steps of the training schedule that each stage takes; None for all of them."""
    clamp: float = MOST_DEVIATIONS
    """Limit of the clean estimate of the trajectory, in standard deviations of the data: farther goals are met by
    the imputed frame alone."""
    bones: Literal["predicted", "initial"] = "predicted"
    """Lengths of the bones: those that the network gives them, or those of the initial pose."""


class GuidedNetwork(Guidance):
    """A network with its text: what a sampler calls, step by step.

    Args:
        network: In evaluation mode.
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

    def __call__(
        self, noisy: Float[Tensor, "batch frames columns"], step: int
    ) -> Float[Tensor, "batch frames columns"]:
        """The guided prediction at ``step`` of the training schedule."""

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
    imputed_from = _step(schedule, _IMPUTED_FROM[settings.imputation][0])
    state = noise.draw(N_ROOT)
    for i in range(len(chain) - 1, -1, -1):
        index = int(chain.indices[i])
        mean = guided_mean(
            lambda noisy, step, i=i: clean_of_noise(chain, i, noisy, predict_noise(noisy, step), settings.clamp),
            chain,
            i,
            state,
            _root_loss(keyframes, settings, space.restored) if index >= guided_from else None,
            settings.goal_scale,
        )
        # No noise is drawn for the last step; the order of draws is part of the result.
        state = noised(chain, i, mean, noise.draw(N_ROOT)) if i else mean
        if index >= imputed_from:
            # Early on the whole straight line is imputed, which leads the trajectory; later its keyframes alone, so
            # that it may bend.
            imputed = on_line if index >= line_from else at_keyframes
            state = imputed_by_noising(chain, i, state, imputed, noise.draw(N_ROOT))
    return space.restored(state)


def sample_motion(
    predict_clean: GuidedNetwork,
    schedule: CosineSchedule,
    space: FeatureSpace,
    trajectory: Float[Tensor, "batch frames 4"],
    ends: Ends,
    noise: SequenceNoise,
    settings: GMDSettings,
) -> Float[Tensor, "batch frames 263"]:
    """Stage 2: raw features of motions whose pelvis follows the trajectory of stage 1."""
    chain = schedule.chain(settings.steps or len(schedule))
    goal = RootGoal(trajectory[..., ROOT_XZ], ends.valid())
    imputed = imputed_root(goal, space, len(space.mean))
    if settings.keyframes == "pose":
        imputed = ends.impute_poses(imputed, space)
    guided_from = _step(schedule, _GUIDED_FROM)
    imputed_from = _step(schedule, _IMPUTED_FROM[settings.imputation][1])
    loss = _root_loss(goal, settings, lambda clean: space.restored(space.unprojected(clean)))
    state = noise.draw()
    for i in range(len(chain) - 1, -1, -1):
        index = int(chain.indices[i])
        mean = guided_mean(predict_clean, chain, i, state, loss if index >= guided_from else None, settings.goal_scale)
        if index >= imputed_from:
            mean = imputed_in_mean(space, chain, i, state, mean, imputed)
        state = noised(chain, i, mean, noise.draw()) if i else mean
    return space.restored(space.unprojected(state))


def _root_loss(goal: RootGoal, settings: GMDSettings, restored: Callable[[Tensor], Tensor]) -> RowLoss | None:
    """The loss of the goal on a clean estimate; None if its gradient has no weight."""
    if not settings.goal_scale:
        return None
    return lambda clean: goal.loss(restored(clean)[..., ROOT_XZ], settings.goal_loss)


def _step(schedule: CosineSchedule, of_thousand: int) -> int:
    """A limit of a schedule of 1000 steps in this one."""
    return -(-of_thousand * len(schedule) // _THOUSAND)
