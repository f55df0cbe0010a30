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
from prbench_adapters.diffusion import generation
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


def test_motions_do_not_depend_on_how_rows_are_put_together(model, monkeypatch):
    batch = tiny.text_batch(LENGTHS)
    as_planned = generate(model, batch, SETTINGS["ddpm"])
    monkeypatch.setattr(generation, "parts_of_similar_length", lambda n_frames, largest: [np.arange(len(n_frames))])
    in_one = generate(model, batch, SETTINGS["ddpm"])
    np.testing.assert_allclose(as_planned.ragged(), in_one.ragged(), rtol=0, atol=1e-4)


def test_the_text_matters_only_where_it_is_heard(model):
    batch = tiny.text_batch([12, 12])
    swapped = dataclasses.replace(batch, text=tuple(reversed(tiny.TEXTS)))
    for guidance, heard in ((2.5, True), (1.0, True), (0.0, False)):
        settings = SamplingSettings(guidance=guidance, sampler="ddim")
        difference = generate(model, batch, settings).joints - generate(model, swapped, settings).joints
        assert bool(np.abs(difference).max() > 1e-3) is heard


def test_motions_start_over_the_origin_and_face_forward(model):
    joints = generate(model, tiny.text_batch([10]), SETTINGS["ddim"]).joints
    np.testing.assert_allclose(joints[0, 0, 0, [0, 2]], 0.0, atol=1e-6)
    assert joints.dtype == np.float32


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


def test_the_unconditional_half_keeps_the_vector_and_the_padding():
    condition = _condition()
    silent = condition.without_text()
    assert not silent.text.any()
    assert silent.vector is condition.vector
    assert silent.padding is condition.padding


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


def test_a_part_ends_where_the_shortest_would_be_padded_by_more_than_a_quarter():
    assert _lists([50, 40, 51, 100], 8) == [[1, 0], [2], [3]]


def test_a_part_ends_when_it_is_full():
    assert _lists([10, 10, 10, 10, 10], 2) == [[0, 1], [2, 3], [4]]


def test_every_row_is_in_one_part():
    n_frames = np.random.default_rng(0).integers(20, 240, 50)
    parts = parts_of_similar_length(n_frames, 7)
    assert sorted(np.concatenate(parts).tolist()) == list(range(50))
    assert all(n_frames[part].max() <= 1.25 * n_frames[part].min() for part in parts)


def test_the_noise_of_a_sequence_depends_on_its_seed_alone():
    alone = start_noise([7], np.array([5]))[0]
    first, second = start_noise([9, 7], np.array([8, 5])), start_noise([7, 9], np.array([5, 8]))
    assert torch.equal(first[1, :5], alone)
    assert torch.equal(second[0, :5], alone)
    assert torch.equal(second[1], first[0])
    assert not torch.equal(first[0, :5], alone)


def test_the_noise_is_that_of_the_sequences_generator_and_padding_is_zero():
    noise = SequenceNoise([3, 4], np.array([2, 4]))
    first, second = noise.draw(), noise.draw()
    generator = sequence_generator(3)
    for drawn in (first, second):
        expected = generator.standard_normal((2, 263), dtype=np.float32)
        assert np.array_equal(drawn[0, :2].numpy(), expected)
        assert not drawn[0, 2:].any()


def test_a_longer_sequence_of_the_same_seed_begins_alike():
    assert torch.equal(start_noise([5], np.array([9]))[0, :4], start_noise([5], np.array([4]))[0])


def test_the_noise_is_standard_normal():
    noise = start_noise([1, 2], np.array([200, 200]))
    assert abs(float(noise.mean())) < 0.01
    assert abs(float(noise.std()) - 1) < 0.01
    assert abs(float((noise[0] * noise[1]).mean())) < 0.01


SIZES = np.array([0.8, 1.1], dtype=np.float32)


@pytest.fixture
def batch() -> ConditionBatch:
    """Two bodies of different sizes in the same pose, each with a goal at its own scale."""
    joints = (STANDING[None] * SIZES[:, None, None]).astype(np.float32)
    goals = {"goal_location": (np.array([[0.5, 1.0, 2.0]]) * SIZES[:, None]).astype(np.float32)}
    common = {"n_frames": np.array([5, 5]), "fps": 20.0, "opaque_id": ("a", "b"), "noise_seed": (1, 2)}
    return ConditionBatch(
        condition=Condition.GOAL_LOCATION,
        text=tiny.TEXTS,
        initial_joints=joints,
        previous_joints=joints,
        **common,
        **goals,
    )


def test_a_model_of_bodies_with_their_own_bones_changes_nothing(batch):
    bodies = ModelBodies.of(batch, tiny.configuration(goal="location"))
    assert bodies.batch is batch
    joints = np.zeros((2, 5, 22, 3), dtype=np.float32)
    assert bodies.own(joints) is joints


def test_a_model_of_one_skeleton_is_given_that_skeleton_and_scaled_goals(batch):
    bodies = ModelBodies.of(batch, tiny.configuration(goal="location", uniform_skeleton=True))
    wanted = np.linalg.norm(REST_OFFSETS[1:], axis=1)
    np.testing.assert_allclose(skeleton.bone_lengths(bodies.batch.initial_joints[0]), wanted, atol=1e-5)
    np.testing.assert_allclose(skeleton.bone_lengths(bodies.batch.previous_joints[1]), wanted, atol=1e-5)
    goals = bodies.batch.goal_location  # the bodies differ by their size alone, so on one skeleton the goals agree
    np.testing.assert_allclose(goals[0], goals[1], atol=1e-5)


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


def _settings(**options: str) -> SamplingSettings:
    return sampling_settings(options, guidance=2.5, diffusion_steps=50)


def test_the_methods_own_values_stand_unless_others_are_given():
    assert _settings() == SamplingSettings(guidance=2.5, sampler="ddpm", steps=None)
    assert _settings(guidance="1", sampler="ddim", steps="10") == SamplingSettings(1.0, "ddim", 10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"guidance": "-1"}, "option 'guidance': expected a number of 0 or more, found '-1'"),
        ({"guidance": "nan"}, "option 'guidance'"),
        ({"guidance": "much"}, "option 'guidance'"),
        ({"sampler": "euler"}, "option 'sampler': expected ddpm or ddim, found 'euler'"),
        ({"steps": "0"}, "option 'steps': expected a whole number from 1 to 50, found '0'"),
        ({"steps": "51"}, "option 'steps'"),
        ({"steps": "2.5"}, "option 'steps'"),
        ({"steps": "-3"}, "option 'steps'"),
    ],
)
def test_impossible_values_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        _settings(**options)
