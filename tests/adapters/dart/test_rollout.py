"""Roll-outs and optimisation of primitives: the published program, NumPy written from the page, goals that are met."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench.geometry.skeleton import Joint
from prbench_adapters.dart.adapter import generate
from prbench_adapters.dart.model import DartModel, DartSettings, FeatureScaling, Frames, Placement
from prbench_adapters.dart.rollout import (
    GuidedDenoiser,
    Primitive,
    by_ddim,
    by_ddpm,
    first_history,
    goal_loss,
    optimise,
    roll_out,
)
from prbench_adapters.dart.training import delta_loss, divergence
from prbench_adapters.diffusion.noise_optimisation import Targets
from prbench_adapters.kinematics import DART, root_orientation
from tests.adapters.dart import golden, page, tiny
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import STANDING

TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def arrays(samples):
    return golden.load(samples)


@pytest.fixture(scope="module")
def primitives(arrays) -> list[Primitive]:
    model, history = golden.model(arrays), golden.tensor(arrays, "history")
    text = golden.tensor(arrays, "text").expand(len(history), -1)
    denoiser = GuidedDenoiser(model.denoiser, text, float(arrays["guidance"]))
    identity = Placement(torch.eye(3).expand(2, 3, 3), torch.zeros(2, 3))
    return roll_out(model, history, identity, by_ddim(denoiser, model.schedule, golden.tensor(arrays, "noise")), 3)


def _equal(actual, expected):
    torch.testing.assert_close(actual, expected, rtol=0, atol=TOLERANCE)


def test_primitives_are_those_of_the_reference(arrays, primitives):
    """History, latent by guided DDIM, features, frame of reference, joints in the world."""

    def of_all(name: str) -> torch.Tensor:
        return torch.stack([getattr(each, name) for each in primitives])

    _equal(of_all("history"), golden.tensor(arrays, "primitive_history"))
    _equal(of_all("latent"), golden.tensor(arrays, "primitive_latents"))
    features = of_all("features") * golden.tensor(arrays, "std") + golden.tensor(arrays, "mean")
    _equal(features, golden.tensor(arrays, "primitive_features"))
    placements = [each.placement for each in primitives]
    _equal(torch.stack([each.rotation for each in placements]), golden.tensor(arrays, "primitive_rotation"))
    _equal(torch.stack([each.origin for each in placements]), golden.tensor(arrays, "primitive_origin")[:, :, 0])
    first = placements[0].points(golden.model(arrays).scaling.frames(primitives[0].history).joints)
    joints = torch.cat([first, *(each.joints for each in primitives)], dim=1)
    _equal(joints, golden.tensor(arrays, "world_joints"))


def test_a_pass_of_the_denoiser_gives_the_clean_latent_of_the_reference(arrays):
    model = golden.model(arrays)
    x_t, step, history = (golden.tensor(arrays, name) for name in ("x_t", "t", "history"))
    text = golden.tensor(arrays, "text").expand(len(x_t), -1)
    _equal(model.denoiser(x_t, step, text, history), golden.tensor(arrays, "x0"))


POSE = torch.zeros(1, 22, 3)


def _targets(goal: torch.Tensor | None = None, location: torch.Tensor | None = None, n: int = 1) -> Targets:
    pose = POSE.expand(n, 22, 3)
    return Targets(initial_joints=pose, goal_joints=goal, goal_location=location)


def test_the_loss_of_a_goal_location_by_hand():
    """Huber of 0.6, 0 and 3 m with δ = 1: 0.18, 0 and 2.5; their mean."""
    joints = torch.zeros(1, 4, 22, 3)
    joints[0, 2, Joint.RIGHT_WRIST] = torch.tensor([0.6, 0.0, 3.0])
    joints[0, 3] = 100.0  # padding
    loss = goal_loss(joints, torch.tensor([3]), _targets(location=torch.zeros(1, 3)), DartSettings())
    assert loss.item() == pytest.approx((0.18 + 2.5) / 3)


def test_the_other_wrist_counts_where_it_is_asked_for():
    joints = torch.zeros(1, 1, 22, 3)
    joints[0, 0, Joint.RIGHT_WRIST, 0] = 0.6
    given = (joints, torch.tensor([1]), _targets(location=torch.zeros(1, 3)))
    assert goal_loss(*given, DartSettings(hand="left")).item() == 0
    assert goal_loss(*given, DartSettings(hand="nearest")).item() == 0
    assert goal_loss(*given, DartSettings()).item() > 0


@pytest.fixture(scope="module")
def optimised_model():
    return tiny.model(seed=1, diffusion_steps=2)


@pytest.mark.parametrize("condition", [Condition.GOAL_POSE, Condition.GOAL_LOCATION])
def test_the_last_frame_comes_to_a_goal_that_the_model_can_reach(optimised_model, condition):
    """The goals are the last frames of free motions, so a noise exists that meets them."""
    given = conditions(condition, 2, frames=(12,))
    free = generate(optimised_model, replace(given, noise_seed=(7, 8)), DartSettings(optimised=False)).joints
    last = free[np.arange(2), given.n_frames - 1]
    if condition is Condition.GOAL_POSE:
        given, asked = replace(given, goal_joints=last), np.arange(22)
    else:
        given, asked = replace(given, goal_location=last[:, Joint.RIGHT_WRIST]), np.array([Joint.RIGHT_WRIST])

    def error(iterations: int) -> np.ndarray:
        joints = generate(optimised_model, given, DartSettings(iterations=iterations)).joints
        reached = joints[np.arange(2), given.n_frames - 1]
        return np.linalg.norm(reached[:, asked] - last[:, asked], axis=-1).mean(axis=1)

    before, after = error(1), error(100)
    assert (after < 0.25 * before).all(), (before, after)
    assert (after < 0.02).all(), (before, after)


TEXT = torch.randn(2, 64, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
EYE = torch.eye(3, dtype=torch.float64).expand(2, 3, 3)


@pytest.fixture(scope="module")
def model() -> DartModel:
    """Networks of random weights in float64."""
    single = tiny.model(seed=3)
    scaling = FeatureScaling(single.scaling.mean.double(), single.scaling.std.double())
    single.vae.double()
    single.denoiser.double()
    return DartModel(single.vae, single.denoiser, scaling=scaling, latent_std=0.8, texts=single.texts)


@pytest.fixture(scope="module")
def start() -> tuple[Frames, Placement]:
    """Two people in the course of turning and walking, somewhere in the world."""
    standing = DART.from_y_up(torch.as_tensor(STANDING, dtype=torch.float64))
    previous = standing @ _yaw(0.7).mT + torch.tensor([[[1.0, 2.0, 0.0]], [[-0.5, 0.3, 0.1]]])
    return first_history(previous, standing @ _yaw(0.8).mT + torch.tensor([[[1.0, 2.05, 0.01]], [[-0.55, 0.3, 0.1]]]))


def _yaw(angle: float) -> torch.Tensor:
    c, s = np.cos(angle), np.sin(angle)
    return torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)


def _normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def _close(actual: torch.Tensor, expected: np.ndarray, atol: float = 1e-6) -> None:
    np.testing.assert_allclose(actual.detach().numpy(), expected, rtol=0, atol=atol)


def test_the_encoder_gives_mean_and_clamped_variance_of_its_distribution_tokens(model):
    history, future = 3.0 * _normal(2, 2, 276), 3.0 * _normal(2, 8, 276, seed=1)
    with torch.no_grad():
        model.vae.encoder_head.bias[0] = 30.0  # one variance at its upper limit
    expected = page.encode(page.parameters(model.vae), history.numpy(), future.numpy(), **page.Model(model).vae_sizes)
    assert expected[1].max() == 10.0
    for found, each in zip(model.vae.encode(history, future), expected, strict=True):
        _close(found, each)


@pytest.mark.parametrize("scale", [0.0, 1.0, 2.5])
def test_a_long_roll_out_under_any_guidance(model, start, scale):
    """Seven primitives; the golden values have three and guidance 5."""
    frames, placement = start
    noise = _normal(7, 2, 1, 16)
    denoiser = GuidedDenoiser(model.denoiser, TEXT, scale)
    history = model.scaling.standardised(frames)
    done = roll_out(model, history, placement, by_ddim(denoiser, model.schedule, noise), 7)
    state = [each.numpy() for each in (frames.pack(), placement.rotation, placement.origin, TEXT)]
    expected = page.Model(model).roll_out(noise.numpy(), *state, scale=scale)
    _close(torch.cat([each.joints for each in done], dim=1), expected)


def test_a_motion_that_ends_leaves_the_others_as_they_are(model, start):
    frames, placement = start
    given = (model, model.scaling.standardised(frames), placement)
    sample = by_ddim(GuidedDenoiser(model.denoiser, TEXT, 5.0), model.schedule, _normal(3, 2, 1, 16))
    whole = roll_out(*given, sample, 3)
    cut = roll_out(*given, sample, 3, going_on=[2, 2, 1])
    assert [len(each.joints) for each in cut] == [2, 2, 1]
    for one, other in zip(cut, whole, strict=True):
        torch.testing.assert_close(one.joints, other.joints[: len(one.joints)], rtol=0, atol=1e-12)


def test_free_generation_is_ancestral_with_the_small_variance(model, start):
    draws = [_normal(2, 1, 16, seed=place) for place in range(4)]
    history = model.scaling.standardised(start[0])
    left = iter(draws)
    latent = by_ddpm(GuidedDenoiser(model.denoiser, TEXT, 5.0), model.schedule, lambda: next(left))(0, history)
    assert next(left, None) is None
    oracle = page.Model(model)

    def clean_of(x: np.ndarray, t: int) -> np.ndarray:
        return page.guided(oracle.denoiser, x, t, TEXT.numpy(), history.numpy(), 5.0, **oracle.sizes)

    _close(latent, page.ddpm(clean_of, [draw.numpy() for draw in draws], 4))


@pytest.mark.parametrize("asked", ["pose", "location"])
def test_optimisation_is_adam_along_the_gradient_through_all_primitives(model, start, asked):
    """Three iterations, of which the gradients are differences of the page's roll-out: two primitives, two lengths."""
    frames, placement = start
    n_frames, place, goal = torch.tensor([17, 12]), np.array([16, 11]), DART.from_y_up(_normal(2, 22, 3, seed=7))
    pose = torch.zeros(2, 22, 3, dtype=torch.float64)
    if asked == "pose":
        joint, target = slice(None), goal.numpy()
        targets = Targets(initial_joints=pose, goal_joints=goal)
    else:
        joint, target = slice(21, 22), goal[:, Joint.RIGHT_WRIST].numpy()
        targets = Targets(initial_joints=pose, goal_location=goal[:, Joint.RIGHT_WRIST])
    denoiser, history = GuidedDenoiser(model.denoiser, TEXT, 5.0), model.scaling.standardised(frames)

    def motion(noise: torch.Tensor) -> torch.Tensor:
        done = roll_out(model, history, placement, by_ddim(denoiser, model.schedule, noise), 2)
        return torch.cat([pose[:, None], *(each.joints for each in done)], dim=1)

    first = 0.1 * _normal(2, 2, 1, 16, seed=2)
    noise, joints = optimise(motion, first, targets, n_frames, DartSettings(iterations=3))
    oracle, step = page.Model(model), 1e-5
    state = [each.numpy() for each in (frames.pack(), placement.rotation, placement.origin, TEXT)]

    def gradient_of(noise: np.ndarray) -> np.ndarray:
        moves = step * np.eye(32).reshape(32, 2, 1, 1, 16)
        tried = np.concatenate([noise + moves, noise - moves]).swapaxes(0, 1).reshape(2, 128, 1, 16)
        pasts = [np.tile(each, (64, *(1,) * (each.ndim - 1))) for each in state]
        joints = oracle.roll_out(tried, *pasts, scale=5.0)[np.arange(128), np.tile(place - 1, 64), joint]
        loss = page.huber(joints - np.tile(target.reshape(2, -1, 3), (64, 1, 1))).reshape(2, 32, 2)
        return ((loss[0] - loss[1]) / (2 * step)).reshape(2, 16, 2).swapaxes(1, 2)[:, :, None]

    expected = page.adam(gradient_of, first.numpy(), iterations=3)
    _close(noise, expected, atol=1e-5)
    _close(joints[:, 1:], oracle.roll_out(expected, *state, scale=5.0), atol=1e-4)


def test_the_first_history_is_two_frames_and_their_velocity_in_the_frame_of_the_first():
    standing = torch.as_tensor(STANDING, dtype=torch.float64)
    previous = DART.from_y_up(standing + 0.02 * _normal(2, 22, 3))
    initial = DART.from_y_up(standing + 0.02 * _normal(2, 22, 3, seed=1) + torch.tensor([0.1, 0.0, 0.3]))
    frames, placement = first_history(previous, initial)
    joints = torch.stack([previous, initial], dim=1)
    turned = root_orientation(joints).numpy()
    turn = page.rows6(np.stack([turned[:, 1] @ turned[:, 0].swapaxes(1, 2)] * 2, axis=1))
    moves = np.stack([(initial - previous).numpy()] * 2, axis=1)
    flat, poses = joints.numpy(), np.concatenate([page.rows6(turned), frames.body.flatten(2).numpy()], axis=-1)
    parts = (flat[:, :, 0], poses, moves[:, :, 0], turn, flat.reshape(2, 2, 66), moves.reshape(2, 2, 66))
    expected, rotation, origin = page.canonical(np.concatenate(parts, axis=-1))
    _close(frames.pack(), expected)
    _close(placement.rotation, rotation)
    _close(placement.origin, origin)


def test_a_motion_is_the_roll_out_without_its_first_frame_with_y_up():
    """Whole, from conditions to motions: noise of a tenth, text for all primitives, axes, cut, x⁰ dropped."""
    single, batch = tiny.model(seed=3), conditions(Condition.GOAL_LOCATION, 2, frames=(21, 18))
    settings = DartSettings(iterations=1, learning_rate=0.0)
    motions = generate(single, batch, settings).joints
    assert batch.initial_joints is not None
    assert batch.previous_joints is not None
    assert batch.text is not None
    first = batch.initial_joints
    previous = batch.previous_joints
    to_z_up = ([0, 2, 1], np.array([-1.0, 1.0, 1.0]))
    frames, placement = first_history(*(torch.as_tensor(x[..., to_z_up[0]] * to_z_up[1]) for x in (previous, first)))
    draws = [np.random.default_rng(np.random.SeedSequence([seed])) for seed in batch.noise_seed]
    normal = [[draw.standard_normal((1, 16), dtype=np.float32) for draw in draws] for _ in range(3)]
    world = page.Model(single).roll_out(
        0.1 * np.array(normal, dtype=np.float64),
        frames.pack().numpy(),
        placement.rotation.numpy(),
        placement.origin.numpy(),
        single.text_vectors(batch.text).double().numpy(),
        5.0,
    )
    future = np.stack([-world[..., 0], world[..., 2], world[..., 1]], axis=-1)
    for row, n in enumerate((21, 18)):
        np.testing.assert_allclose(motions[row, 0], first[row], rtol=0, atol=1e-7)
        np.testing.assert_allclose(motions[row, 1:n], future[row, : n - 1], rtol=0, atol=2e-4)


def test_the_losses_of_training_by_hand(model, start):
    """Huber's terms of deltas from the last frame of the history on, and the divergence as a mean over dimensions."""
    history = start[0]
    future = model.scaling.frames(_normal(2, 8, 276, seed=9))
    rows = np.concatenate([history.pack().numpy()[:, -1:], future.pack().numpy()], axis=1)
    transl, poses, step, turn, joints, moves = np.split(rows, np.cumsum(page.PARTS)[:-1], axis=-1)
    turned = page.matrix(poses[..., :6])
    expected = (
        page.huber(step[:, :-1] - np.diff(transl, axis=1))
        + page.huber(page.matrix(turn)[:, :-1] - turned[:, 1:] @ turned[:, :-1].swapaxes(2, 3))
        + page.huber(moves[:, :-1] - np.diff(joints, axis=1))
    )
    _close(delta_loss(future, history), expected)
    mean, log_variance = _normal(2, 1, 16), _normal(2, 1, 16, seed=1)
    m, v = mean.numpy(), np.exp(log_variance.numpy())
    _close(divergence(mean, log_variance), (0.5 * (m**2 + v - 1.0 - np.log(v))).mean(axis=(1, 2)))


def test_a_clamped_gradient():
    first = torch.zeros(1, 2, 1, 1, dtype=torch.float64)
    pose = torch.zeros(2, 22, 3, dtype=torch.float64)
    targets = Targets(initial_joints=pose, goal_joints=pose + 0.5)

    def motion(noise: torch.Tensor) -> torch.Tensor:
        slope = torch.tensor([1.0, 1e-9], dtype=torch.float64)[:, None, None, None]
        return (slope * noise[0, :, :, :, None]).expand(2, 1, 22, 3)

    own, _ = optimise(motion, first, targets, torch.tensor([1, 1]), DartSettings(iterations=1))
    # gradients -0.5 and -0.5e-9: lengths 1 and 5e-4 by the clamp, of which Adam's first step makes the rate
    _close(own.flatten(), 0.05 * np.array([1.0, 5e-4 / (5e-4 + 1e-8)]), atol=1e-9)
