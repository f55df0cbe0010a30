"""The 276 numbers of a frame, frames of reference of primitives, and sizes of networks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench.geometry.skeleton import Joint, bone_lengths
from prbench_adapters import dart
from prbench_adapters.dart.adapter import generate, parts_of_similar_cost
from prbench_adapters.dart.model import (
    N_FEATURES,
    DartConfiguration,
    DartSettings,
    Frames,
    Placement,
    canonical_placement,
    dart_settings,
)
from prbench_adapters.dart.rollout import first_history, next_history
from prbench_adapters.finishing import Finishing
from prbench_adapters.kinematics import DART, forward_kinematics, rest_offsets
from tests.adapters.dart import tiny
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import STANDING


@pytest.fixture
def joints() -> torch.Tensor:
    """Two people who walk about and bend, 7 frames, Z up."""
    generator = torch.Generator().manual_seed(3)
    standing = DART.from_y_up(torch.as_tensor(STANDING, dtype=torch.float64))
    angles = torch.randn(2, 1, generator=generator) + torch.linspace(0.0, 0.5, 7)
    bent = standing + 0.03 * torch.randn(2, 7, 22, 3, generator=generator, dtype=torch.float64)
    walked = torch.randn(2, 1, 1, 3, generator=generator) + torch.linspace(0, 1, 7)[:, None, None]
    return torch.einsum("bnij,bnkj->bnki", _yaw(angles), bent) + walked


def _yaw(angles: torch.Tensor) -> torch.Tensor:
    cos, sin, zero, one = angles.cos(), angles.sin(), torch.zeros_like(angles), torch.ones_like(angles)
    return torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], -1).unflatten(-1, (3, 3)).double()


def test_features_hold_what_the_page_says_where_it_says(joints):
    frames = Frames.of_joints(joints)
    features = frames.pack()
    assert features.shape == (2, 6, N_FEATURES)
    assert torch.equal(features[..., :3], joints[:, :-1, Joint.PELVIS])
    assert torch.equal(features[..., 3:9], frames.orientation[..., :2, :].flatten(2))  # rows, not columns
    assert torch.equal(features[..., 135:138], joints.diff(dim=1)[:, :, Joint.PELVIS])
    assert torch.equal(features[..., 144:210].unflatten(-1, (22, 3)), joints[:, :-1])
    assert torch.equal(features[..., 210:].unflatten(-1, (22, 3)), joints.diff(dim=1))


def test_rotations_lead_to_the_joints(joints):
    frames, _ = Frames.of_joints(joints).canonical()
    moved = forward_kinematics(frames.rotations(), frames.translation, rest_offsets(frames.joints))
    torch.testing.assert_close(moved, frames.joints, rtol=0, atol=1e-9)


def test_deltas_lead_to_the_next_frame(joints):
    frames, _ = Frames.of_joints(joints).canonical()
    torch.testing.assert_close((frames.orientation_delta @ frames.orientation)[:, :-1], frames.orientation[:, 1:])
    torch.testing.assert_close((frames.joints + frames.joints_delta)[:, :-1], frames.joints[:, 1:])


def test_the_first_frame_stands_in_its_own_origin_and_looks_along_y():
    standing = torch.as_tensor(STANDING, dtype=torch.float64)
    walking = DART.from_y_up(torch.stack([standing, standing + torch.tensor([0.0, 0.0, 0.1])])[None] + 5.0)
    frames, placement = Frames.of_joints(walking).canonical()
    torch.testing.assert_close(frames.translation[0, 0], torch.zeros(3, dtype=torch.float64))
    torch.testing.assert_close(frames.translation_delta[0, 0], torch.tensor([0.0, 0.1, 0.0], dtype=torch.float64))
    assert frames.joints[0, 0, Joint.RIGHT_HIP, 0] > 0
    assert frames.joints[0, 0, Joint.HEAD, 2] > 0.5
    torch.testing.assert_close(placement.points(frames.joints), walking[:, :-1])


def test_a_primitive_does_not_know_where_in_the_world_it_is(joints):
    elsewhere = Placement(_yaw(torch.tensor([2.0, -1.0])), torch.randn(2, 3, dtype=torch.float64))
    here, _ = Frames.of_joints(joints).canonical()
    there, _ = Frames.of_joints(elsewhere.points(joints)).canonical()
    torch.testing.assert_close(there.pack(), here.pack())


def test_placements_are_put_together_from_the_outside_in(joints):
    outer = Placement(_yaw(torch.tensor([0.3, math.pi])), torch.ones(2, 3, dtype=torch.float64))
    inner = canonical_placement(joints[:, 3])
    torch.testing.assert_close(outer.then(inner).points(joints), outer.points(inner.points(joints)))


def test_the_next_history_is_the_end_of_the_primitive_seen_from_its_first_frame(joints):
    future, _ = Frames.of_joints(joints).canonical()
    history, placement = next_history(future)
    torch.testing.assert_close(placement.points(history.joints), future.joints[:, -2:])
    torch.testing.assert_close(history.joints[:, 0, Joint.PELVIS], torch.zeros(2, 3, dtype=torch.float64))


def test_a_motion_goes_on_from_its_first_frame_as_it_came(joints):
    history, placement = first_history(joints[:, 0], joints[:, 1])
    torch.testing.assert_close(placement.points(history.joints), joints[:, :2])
    for name in ("translation_delta", "orientation_delta", "joints_delta"):
        deltas = getattr(history, name)
        torch.testing.assert_close(deltas[:, 1], deltas[:, 0])
    torch.testing.assert_close(history.joints[:, 0] + history.joints_delta[:, 0], history.joints[:, 1])


def test_a_repeated_first_frame_is_a_body_at_rest(joints):
    history, _ = first_history(joints[:, 0], joints[:, 0])
    assert history.joints_delta.abs().max() == 0
    torch.testing.assert_close(history.orientation_delta, torch.eye(3, dtype=torch.float64).expand(2, 2, 3, 3))


QUICK = {"iterations": "2"}
BATCH = conditions(Condition.GOAL_LOCATION, 2, frames=(11, 9))
"""Two sequences of one part; the first takes two primitives, the second one."""


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return tiny.write(tmp_path_factory.mktemp("weights") / "dart.safetensors", diffusion_steps=2)


def _generated(weights, batch, **options):
    return dart.load(weights, options={**QUICK, **options}, device="cpu").generate(batch, seed=0)


@pytest.mark.parametrize("bones", [True, False])
@pytest.mark.parametrize("feet", [True, False])
def test_each_primitive_keeps_bones_and_floor_where_it_is_asked_to(bones, feet):
    settings = DartSettings(iterations=1, finishing=Finishing(bones=bones, feet=feet))
    joints = generate(tiny.model(diffusion_steps=2), BATCH, settings).joints[:, :9]
    toes = joints[:, :, [Joint.LEFT_FOOT, Joint.RIGHT_FOOT], 1].min(axis=-1)
    assert (np.abs(bone_lengths(joints) - bone_lengths(BATCH.initial_joints)[:, None]).max() < 1e-4) == bones
    assert (toes.min() > min(toes[:, 0].min(), 0.0) - 1e-5) == feet


def test_the_fast_mode_takes_a_fifth_of_the_papers_passes():
    fast, paper = (dart_settings({"optimise": mode}, diffusion_steps=10) for mode in ("fast", "paper"))
    assert (paper.iterations, paper.ddim_steps, paper.guidance, paper.learning_rate) == (100, None, 5.0, 0.05)
    assert 5 * (fast.iterations + 1) * (2 * fast.ddim_steps + 1) < 101 * 21
    assert dart_settings({}, diffusion_steps=2).ddim_steps == 2
    assert (fast.finishing, DartSettings().finishing) == (Finishing(), Finishing(bones=False, feet=False))


@pytest.mark.parametrize(("n_frames", "primitives"), [(1, 1), (2, 1), (10, 1), (11, 2), (18, 2), (242, 30)])
def test_a_motion_takes_as_many_primitives_as_cover_it(n_frames, primitives):
    assert DartConfiguration().primitives_for(n_frames) == primitives


@pytest.mark.parametrize("largest", [1, 7, 20, 1000])
def test_parts_hold_all_rows_once_the_longest_first_and_about_as_much(largest):
    primitives = np.array([3, 1, 5, 5, 2, 4])
    parts = parts_of_similar_cost(primitives, largest)
    assert sorted(np.concatenate(parts).tolist()) == list(range(6))
    assert (np.diff(primitives[np.concatenate(parts)]) <= 0).all()
    assert max(primitives[part].sum() for part in parts) < largest + 5
    assert len(parts) == min(6, -(-20 // largest))


@pytest.mark.parametrize("name", ["initial_joints", "previous_joints"])
@pytest.mark.parametrize(("value", "found"), [(np.nan, "not finite"), (0.0, "one vertical line")])
def test_an_initial_state_without_heading_is_refused(weights, name, value, found):
    poses = getattr(BATCH, name).copy()
    poses[1, 1:3] = value
    with pytest.raises(AdapterError, match=rf"(?s)row 1 .*{found}" if name == "previous_joints" else "row 1"):
        _generated(weights, replace(BATCH, **{name: poses}))


@pytest.mark.parametrize("change", [{"vae_layers": 4}, {"future_frames": 1}, {"width": 15}, {"layers": 0}])
def test_sizes_that_do_not_fit_together_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        DartConfiguration(**change)
