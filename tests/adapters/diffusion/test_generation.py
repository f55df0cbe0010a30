"""Motions for batches of conditions: parts, noise, bodies, guidance, sampling and its options."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.geometry import skeleton
from prbench.geometry.skeleton import BONES, Joint
from prbench.randomness import sequence_generator
from prbench.representation import REST_OFFSETS
from prbench_adapters.diffusion.configuration import EncodedCondition
from prbench_adapters.diffusion.generation import (
    Guided,
    ModelBodies,
    SamplingSettings,
    SequenceNoise,
    bone_lengths,
    generate,
    parts_of_similar_length,
    sampling_settings,
    start_noise,
    with_bone_lengths,
)
from tests.adapters.diffusion import tiny
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import STANDING, smooth_motion

LENGTHS = [21, 10, 20, 33, 9, 5, 20, 40]  # neither sorted, nor inside the parts that are computed together
SETTINGS = {
    "ddpm": SamplingSettings(guidance=2.5),
    "ddim": SamplingSettings(guidance=2.5, sampler="ddim", steps=4),
    "one-pass": SamplingSettings(guidance=1.0),
}


@pytest.fixture(scope="module")
def model():
    return tiny.model()


def _one(batch: ConditionBatch, row: int) -> ConditionBatch:
    return batch.rows(row, row + 1)


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS.keys())
def test_a_motion_does_not_depend_on_the_batch_around_it(model, settings):
    batch = tiny.text_batch(LENGTHS)
    together = generate(model, batch, settings)
    assert together.joints.shape == (8, 40, 22, 3)
    for row, n in enumerate(LENGTHS):
        alone = generate(model, _one(batch, row), settings).joints[0]
        np.testing.assert_allclose(together.joints[row, :n], alone, rtol=0, atol=1e-4)
    assert np.abs(together.joints[0, :20] - together.joints[2, :20]).max() > 1e-2  # other seeds, other motions


def test_the_text_matters_only_where_it_is_heard(model):
    batch = tiny.text_batch([12, 12])
    swapped = dataclasses.replace(batch, text=tuple(reversed(tiny.TEXTS)))
    for guidance, heard in ((2.5, True), (1.0, True), (0.0, False)):
        settings = SamplingSettings(guidance=guidance, sampler="ddim")
        difference = generate(model, batch, settings).joints - generate(model, swapped, settings).joints
        assert bool(np.abs(difference).max() > 1e-3) is heard


@pytest.fixture
def network():
    return tiny.denoiser(goal="location").double()


def _condition(rows: int = 2) -> EncodedCondition:
    generator = torch.Generator().manual_seed(1)
    text = torch.randn((rows, 3, 64), generator=generator, dtype=torch.float64)
    padding = torch.tensor([[False, False, True], [False, False, False]])[:rows]
    return EncodedCondition(text, padding, torch.randn((rows, 135), generator=generator, dtype=torch.float64))


NOISY = torch.randn((2, 6, 263), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
N_FRAMES = torch.tensor([6, 4])


def test_one_pass_of_twice_the_batch_is_two_passes_combined(network):
    condition, step = _condition(), torch.tensor([3, 3])
    conditional = network(NOISY, step, condition, N_FRAMES)
    unconditional = network(NOISY, step, condition.without_text(), N_FRAMES)
    expected = unconditional + 2.5 * (conditional - unconditional)
    denoise = Guided(network, condition, N_FRAMES, 2.5)
    torch.testing.assert_close(denoise(NOISY, 3), expected, rtol=0, atol=1e-12)
    assert (conditional - unconditional).abs().max() > 1e-3


def test_without_guidance_there_is_one_pass(network):
    condition, calls = _condition(), []
    network.register_forward_hook(lambda *_: calls.append(1))
    denoise = Guided(network, condition, N_FRAMES, 1.0)
    expected = network(NOISY, torch.tensor([3, 3]), condition, N_FRAMES)
    torch.testing.assert_close(denoise(NOISY, 3), expected, rtol=0, atol=1e-12)
    assert denoise.passes == 2


def test_what_is_reused_gives_the_same_bytes_and_is_made_once_a_step(network, monkeypatch):
    prepared, prepare = [], network.prepare
    monkeypatch.setattr(network, "prepare", lambda *given: prepared.append(given) or prepare(*given))
    anew = Guided(network, _condition(), N_FRAMES, 2.5)
    reusing = Guided(network, _condition(), N_FRAMES, 2.5, reuse=True)
    for step in (3, 5, 3, 5, 3):
        assert torch.equal(anew(NOISY, step), reusing(NOISY, step))
    assert len(prepared) == 5 + 2


def test_conditions_with_and_without_a_vector_do_not_mix():
    condition = _condition()
    with pytest.raises(ValueError, match="cannot share a batch"):
        condition.then(dataclasses.replace(condition, vector=None))


def test_rows_of_a_condition_by_slice_list_and_tensor():
    condition = _condition()
    for index in (slice(1, 2), [1], torch.tensor([1])):
        row = condition.rows(index)
        assert len(row) == 1
        assert torch.equal(row.text[0], condition.text[1])
        assert torch.equal(row.padding[0], condition.padding[1])
        assert torch.equal(row.vector[0], condition.vector[1])


def _lists(n_frames: list[int], largest: int) -> list[list[int]]:
    return [part.tolist() for part in parts_of_similar_length(np.array(n_frames), largest)]


def test_parts_end_when_full_or_where_the_shortest_would_be_padded_by_more_than_a_quarter():
    assert _lists([50, 40, 51, 100], 8) == [[1, 0], [2], [3]]
    assert _lists([10, 10, 10, 10, 10], 2) == [[0, 1], [2, 3], [4]]


def test_the_noise_is_that_of_the_sequences_generator_whatever_the_batch_and_padding_is_zero():
    for seeds, lengths in (([3, 4], [2, 4]), ([4, 3], [9, 2])):
        noise, generator = SequenceNoise(seeds, np.array(lengths)), sequence_generator(3)
        for drawn in (noise.draw(), noise.draw()):
            row = drawn[seeds.index(3)]
            assert np.array_equal(row[:2].numpy(), generator.standard_normal((2, 263), dtype=np.float32))
            assert not row[2:].any()
    assert torch.equal(start_noise([5], np.array([9]))[0, :4], start_noise([5], np.array([4]))[0])


def test_a_model_of_one_skeleton_is_given_that_skeleton_and_scaled_goals():
    """Two bodies in one pose that differ by their size alone, so that on one skeleton their goals agree."""
    given = conditions(Condition.GOAL_LOCATION, 2)
    sizes = np.float32([0.8, 1.1])[:, None, None]
    joints, goals = given.initial_joints * sizes, np.float32([[0.5, 1.0, 2.0]]) * sizes[:, 0]
    batch = dataclasses.replace(given, initial_joints=joints, previous_joints=joints, goal_location=goals)
    bodies = ModelBodies.of(batch, tiny.configuration(goal="location", uniform_skeleton=True))
    wanted = np.linalg.norm(REST_OFFSETS[1:], axis=1)
    for poses in (bodies.batch.initial_joints, bodies.batch.previous_joints):
        np.testing.assert_allclose(skeleton.bone_lengths(poses), [wanted, wanted], atol=1e-5)
    np.testing.assert_allclose(bodies.batch.goal_location[0], bodies.batch.goal_location[1], atol=1e-5)
    back = bodies.own(np.broadcast_to(bodies.batch.goal_location[:, None, None], (2, 5, 22, 3)).astype(np.float32))
    np.testing.assert_allclose(back[:, 3, 7], goals, atol=1e-5)
    plain = ModelBodies.of(batch, tiny.configuration(goal="location"))
    assert plain.batch is batch
    motion = np.zeros((2, 5, 22, 3), dtype=np.float32)
    assert plain.own(motion) is motion


WOBBLING = torch.as_tensor(np.stack([smooth_motion(name, 20) for name in "ab"]))
BONES_WANTED = bone_lengths(torch.as_tensor(np.stack([STANDING, STANDING * 1.1]), dtype=torch.float32))


def test_the_lengths_are_those_asked_for_in_every_frame():
    found = bone_lengths(with_bone_lengths(WOBBLING, BONES_WANTED))
    assert torch.allclose(found, BONES_WANTED[:, None].expand_as(found), atol=1e-6)


def test_directions_the_pelvis_over_the_floor_and_the_lowest_height_stay():
    relaid = with_bone_lengths(WOBBLING, BONES_WANTED)
    assert torch.equal(relaid[:, :, Joint.PELVIS, ::2], WOBBLING[:, :, Joint.PELVIS, ::2])
    torch.testing.assert_close(relaid[..., 1].amin(dim=-1), WOBBLING[..., 1].amin(dim=-1))
    parents, children = np.transpose(BONES)
    before, after = (motion[:, :, children] - motion[:, :, parents] for motion in (WOBBLING, relaid))
    cosine = torch.nn.functional.cosine_similarity(before, after, dim=-1)
    assert torch.allclose(cosine, torch.ones_like(cosine), atol=1e-5)


def test_gradients_reach_every_joint_and_are_finite_for_a_vanished_bone():
    joints = WOBBLING.clone()
    joints[0, 3, Joint.HEAD] = joints[0, 3, Joint.NECK]
    joints.requires_grad_()
    with_bone_lengths(joints, BONES_WANTED)[:, :, Joint.RIGHT_WRIST].square().sum().backward()
    assert joints.grad is not None
    assert torch.isfinite(joints.grad).all()
    moving = joints.grad.abs().amax(dim=(0, 1, 3)) > 0
    assert moving[Joint.RIGHT_ELBOW]
    assert moving[Joint.PELVIS]
    assert not moving[Joint.LEFT_WRIST]


@pytest.mark.parametrize(
    ("key", "value"),
    [*(("guidance", bad) for bad in ("-1", "nan", "much")), *(("steps", bad) for bad in ("0", "51", "2.5", "-3"))],
)
def test_impossible_values_are_named(key, value):
    given = {"guidance": "1", "sampler": "ddim", "steps": "10"}
    assert sampling_settings(given, guidance=2.5, diffusion_steps=50) == SamplingSettings(1.0, "ddim", 10)
    with pytest.raises(ValueError, match=f"option '{key}': expected a .*, found '{value}'"):
        sampling_settings({key: value}, guidance=2.5, diffusion_steps=50)
