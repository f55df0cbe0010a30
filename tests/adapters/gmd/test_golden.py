"""Both networks and one guided, imputed sampling step of each stage, as the original computes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.gmd.model import ROOT_XZ, FeatureSpace
from prbench_adapters.gmd.sampling import (
    GuidedNetwork,
    RootGoal,
    clean_of_noise,
    guided_mean,
    imputed_by_noising,
    imputed_in_mean,
    imputed_root,
    noised,
)
from tests.adapters.gmd import golden

STEP = 250
SCHEDULE = CosineSchedule(golden.STEPS)


@dataclass(frozen=True)
class Case:
    """One file as our objects."""

    arrays: dict[str, np.ndarray]
    space: FeatureSpace
    goal: RootGoal

    @property
    def state(self) -> Tensor:
        return golden.features(self.arrays["x_t"])

    def network(self, scale: float) -> GuidedNetwork:
        text, frames = torch.from_numpy(self.arrays["text"]), self.arrays["x_t"].shape[2]
        n_frames = torch.full((len(text),), frames)
        return GuidedNetwork(golden.network(self.arrays), text, n_frames, window=golden.WINDOW, scale=scale)


def _case(samples, name: str) -> Case:
    arrays = golden.load(samples, name)
    projection = arrays.get("projection", np.eye(263)).astype(np.float32)
    space = FeatureSpace.of(*(torch.from_numpy(array) for array in (arrays["mean"], arrays["std"], projection)))
    wanted = torch.zeros(arrays["target_xz"].shape[:2], dtype=torch.bool)
    wanted[:, arrays["target_frames"]] = True
    return Case(arrays, space, RootGoal(torch.from_numpy(arrays["target_xz"]), wanted))


@pytest.fixture(scope="module")
def motion(samples) -> Case:
    return _case(samples, "gmd_motion_step")


@pytest.fixture(scope="module")
def trajectory(samples) -> Case:
    return _case(samples, "gmd_trajectory_step")


@pytest.mark.parametrize("name", ["gmd_motion_step", "gmd_trajectory_step"])
@pytest.mark.parametrize(("output", "scale"), [("network_output", 1.0), ("network_output_guided", 2.5)])
def test_networks_predict_what_the_original_ones_do(samples, name, output, scale):
    case = _case(samples, name)
    found = case.network(scale)(case.state, STEP)
    assert (found - golden.features(case.arrays[output])).abs().max() < 1e-5


def _trajectory_step(case: Case, *, scale: float = 100.0, impute: bool = True) -> Tensor:
    network, state = case.network(2.5), case.state
    mean = guided_mean(
        lambda noisy, step: clean_of_noise(SCHEDULE, step, noisy, network(noisy, step)),
        SCHEDULE,
        STEP,
        state,
        lambda clean: case.goal.loss(case.space.restored(clean)[..., ROOT_XZ]),
        scale,
    )
    after = noised(SCHEDULE, STEP, mean, golden.features(case.arrays["noise"]))
    if not impute:
        return after
    imputed, noise = imputed_root(case.goal, case.space, 4), golden.features(case.arrays["imputation_noise"])
    return imputed_by_noising(SCHEDULE, STEP, after, imputed, noise)


def _motion_step(case: Case, *, scale: float = 100.0, impute: bool = True) -> Tensor:
    mean = guided_mean(
        case.network(2.5),
        SCHEDULE,
        STEP,
        case.state,
        lambda clean: case.goal.loss(case.space.restored(case.space.unprojected(clean))[..., ROOT_XZ]),
        scale,
    )
    if impute:
        imputed = imputed_root(case.goal, case.space, 263)
        mean = imputed_in_mean(case.space, SCHEDULE, STEP, case.state, mean, imputed)
    return noised(SCHEDULE, STEP, mean, golden.features(case.arrays["noise"]))


def test_a_step_of_the_trajectory_is_the_original_one(trajectory):
    expected = golden.features(trajectory.arrays["x_prev"])
    assert (_trajectory_step(trajectory) - expected).abs().max() < 1e-5


def test_a_step_of_the_motion_is_the_original_one(motion):
    """The original inverts the projection in float32; a tenth of the tolerance that this asks for is enough."""
    expected = golden.features(motion.arrays["x_prev"])
    assert (_motion_step(motion) - expected).abs().max() < 1e-4


@pytest.mark.parametrize("change", [{"scale": 0.0}, {"scale": 50.0}, {"impute": False}])
def test_guidance_and_imputation_matter_more_than_the_tolerances(motion, trajectory, change):
    for step, case, tolerance in ((_trajectory_step, trajectory, 1e-5), (_motion_step, motion, 1e-4)):
        assert (step(case, **change) - golden.features(case.arrays["x_prev"])).abs().max() > 2 * tolerance


def test_a_goal_of_two_frames_moves_the_frames_between_them(trajectory):
    """The gradient goes through the network, so that it is dense."""
    with_goal, without = (_trajectory_step(trajectory, scale=scale, impute=False) for scale in (100.0, 0.0))
    moved = (with_goal - without).abs().sum(dim=2)
    assert bool((moved[:, 1:-1] > 1e-4).all())
