"""Foot Skating, contact, bone lengths and jerk: worked cases, golden values, slow references."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prbench.geometry.skeleton import BONES, TOES, Joint
from prbench.metrics.batch import odd_window
from prbench.metrics.bone_length_change import bone_length_change
from prbench.metrics.foot_skating import contact_share, foot_skating, toe_steps
from prbench.metrics.plausible import largest_jerk
from tests.metrics.motions import CONSTANTS, FPS, STANDING, batch, random_motion, standing


def sliding(n_frames: int, *, step: float = 0.03, height: float = 0.02, toes=TOES) -> np.ndarray:
    motion = standing(n_frames)
    motion[:, list(TOES), 1] = height
    motion[:, list(toes), 0] += step * np.arange(n_frames)[:, None]
    return motion


@pytest.mark.parametrize("toes", [TOES, TOES[:1], TOES[1:]])
@pytest.mark.parametrize(("n_frames", "ratio"), [(8, 3 / 7), (12, 7 / 11), (2, 0.0)])
def test_worked_ratios(n_frames: int, ratio: float, toes: tuple[int, ...]) -> None:
    assert foot_skating(batch(sliding(n_frames, toes=toes)), FPS, CONSTANTS) == pytest.approx(ratio)


def test_the_average_is_damped_at_both_ends() -> None:
    motion = batch(sliding(8), sliding(2))
    steps = toe_steps(motion, FPS, CONSTANTS)
    expected = [0.36, 0.48, 0.6, 0.6, 0.6, 0.48, 0.36]
    np.testing.assert_allclose(steps.averaged_speed[:, :7], [expected, expected])
    np.testing.assert_allclose(steps.averaged_speed[:, 8], 0.6 / 5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_thresholds_are_strict(dtype) -> None:
    def ratio(**how: float) -> float:
        return float(foot_skating(batch(sliding(12, **how).astype(dtype)), FPS, CONSTANTS)[0])

    if dtype == np.float64:  # float32 resolves no step of exactly 2.5 cm
        assert ratio(step=0.025) == 0.0
    assert ratio(step=0.02499) == 0.0
    assert ratio(step=0.0250001) > 0.0
    assert ratio(height=0.05) == 0.0
    assert ratio(height=0.0499999) == pytest.approx(7 / 11)


def test_a_motionless_body_does_not_skate_but_touches_the_floor() -> None:
    motion = batch(standing(10), standing(10) + np.array([0, 0.05, 0]))
    assert foot_skating(motion, FPS, CONSTANTS).tolist() == [0, 0]
    assert contact_share(motion, CONSTANTS).tolist() == [1, 0]


def test_contact_needs_a_low_toe_before_and_after_a_step() -> None:
    motion = standing(5)
    motion[2, list(TOES), 1] = 0.2
    assert contact_share(batch(motion), CONSTANTS) == 0.5


@pytest.mark.parametrize(("fps", "window"), [(20.0, 5), (30.0, 9), (25.0, 7), (60.0, 15), (10.0, 3), (4.0, 1)])
def test_the_window_at_other_frame_rates_is_odd(fps: float, window: int) -> None:
    assert odd_window(0.25, fps) == window


def test_sequences_of_several_frame_rates_score_as_they_do_alone() -> None:
    rng = np.random.default_rng(0)
    motions = [random_motion(rng, n) * (1, 0.5, 1) for n in (40, 7, 90, 2)]
    fps = np.array([20.0, 30.0, 60.0, 30.0])
    together = foot_skating(batch(*motions), fps, CONSTANTS)
    alone = [foot_skating(batch(motion), float(rate), CONSTANTS)[0] for motion, rate in zip(motions, fps, strict=True)]
    assert together.tolist() == alone


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_golden_values_of_the_reference_programs(samples: Path, dtype) -> None:
    golden = np.load(samples / "metrics" / "foot_skating_jitter_jerk.npz", allow_pickle=False)
    names = [f"m{i}" for i in range(11)]
    motion = batch(*(golden[f"{name}_joints"].astype(dtype) for name in names))
    ratio = foot_skating(motion, FPS, CONSTANTS)
    jerk = largest_jerk(motion, FPS) / FPS**3
    steps = toe_steps(motion, FPS, CONSTANTS)
    for i, name in enumerate(names):
        assert ratio[i] == golden[f"{name}_skating_ratio"]
        velocity = (steps.contact * steps.averaged_speed)[:, motion.first[i] : motion.last[i]]
        np.testing.assert_allclose(velocity, golden[f"{name}_skate_velocity"], atol=1e-6)
        assert jerk[i] == pytest.approx(golden[f"{name}_max_jerk"], abs=1e-7)


def test_a_bone_that_grows_by_a_tenth_in_one_frame() -> None:
    motion = standing(4)
    hand = STANDING[Joint.LEFT_WRIST] - STANDING[Joint.LEFT_ELBOW]
    motion[2, Joint.LEFT_WRIST] = STANDING[Joint.LEFT_ELBOW] + 1.1 * hand
    shrunk = standing(4)
    shrunk[3, Joint.LEFT_WRIST] = STANDING[Joint.LEFT_ELBOW] + 0.8 * hand
    change, missing = bone_length_change(batch(motion, shrunk, standing(2)))
    assert change == pytest.approx([0.1, 0.2, 0.0])
    assert not missing.any()


def test_a_bone_without_length_is_left_out_and_reported() -> None:
    motion = standing(4)
    motion[0, Joint.LEFT_WRIST] = motion[0, Joint.LEFT_ELBOW]
    change, missing = bone_length_change(batch(standing(3), motion))
    assert change.tolist() == [0, 0]
    assert missing.tolist() == [False, True]


@pytest.mark.parametrize("seed", range(3))
def test_agree_with_slow_references(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motions = [random_motion(rng, int(n)) for n in rng.integers(2, 200, 40)]
    motion = batch(*motions)
    ratio, contact, (change, _) = (
        foot_skating(motion, FPS, CONSTANTS),
        contact_share(motion, CONSTANTS),
        bone_length_change(motion),
    )
    for i, joints in enumerate(motions):
        slides, touches = slow_slides_and_contacts(joints)
        assert (ratio[i], contact[i]) == (np.mean(slides), np.mean(touches))
        lengths = [[np.linalg.norm(frame[c] - frame[p]) for p, c in BONES] for frame in joints]
        assert change[i] == pytest.approx(
            max(abs(x / y - 1) for row in lengths for x, y in zip(row, lengths[0], strict=True))
        )
    assert 0 < ratio.sum() < 40


def slow_slides_and_contacts(joints: np.ndarray) -> tuple[list[bool], list[bool]]:
    """The definition of docs/specification/metrics.md#foot-skating, transition by transition."""
    steps = range(len(joints) - 1)
    speed = [[FPS * np.hypot(*(joints[t + 1, j] - joints[t, j])[[0, 2]]) for t in steps] for j in TOES]
    low = [[joints[t, j, 1] < 0.05 and joints[t + 1, j, 1] < 0.05 for t in steps] for j in TOES]
    average = [[sum(v[max(t - 2, 0) : t + 3]) / 5 for t in steps] for v in speed]
    slides = [any(low[k][t] and speed[k][t] > 0.5 and average[k][t] > 0.5 for k in (0, 1)) for t in steps]
    return slides, [low[0][t] or low[1][t] for t in steps]
