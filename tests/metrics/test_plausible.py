"""Plausibility: every number by hand, every limit from both sides, and what breaks it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from prbench.geometry.skeleton import TOES, Joint
from prbench.metrics import MotionBatch, score
from prbench.metrics.batch import ScoringPair
from prbench.metrics.foot_skating import foot_skating, slow_slides
from prbench.metrics.plausible import (
    body_numbers,
    broken_limits,
    floating,
    largest_acceleration,
    largest_jerk,
    largest_speed,
    largest_trunk_tilt,
    lowest_pelvis,
    penetration,
)
from prbench.metrics.pose_errors import first_frame_error, first_step
from prbench.protocol.manifests import Limit
from tests.metrics.motions import CONSTANTS, FPS, STANDING, batch, random_motion, standing, targets


def measured(motion: MotionBatch, fps: float = FPS) -> dict[str, np.ndarray]:
    return body_numbers(ScoringPair(motion, motion, targets(motion.n_sequences, fps=fps)), CONSTANTS)


def broken(motion: np.ndarray, limits: Mapping[str, Limit] = CONSTANTS.plausible_3) -> set[str]:
    found = broken_limits(measured(batch(motion)), limits, CONSTANTS.threshold_tolerance)
    return {name for name, mask in found.items() if mask[0]}


def test_a_body_that_stands_is_plausible() -> None:
    assert broken(standing(10)) == set()


def test_the_first_frame_error_is_the_mean_over_the_joints_of_frame_0() -> None:
    moved = standing(4)
    moved[0] += (0.03, 0.04, 0.0)  # 3, 4, 5
    moved[1:] += 1.0  # later frames do not count
    one = standing(3)
    one[0, Joint.HEAD] += (0.0, 0.0, 0.22)  # one joint of 22
    found = first_frame_error(batch(standing(2), moved, one), batch(standing(2), standing(4), standing(3)))
    assert found == pytest.approx([0.0, 0.05, 0.01])


def test_the_first_step_is_the_largest_of_a_joint() -> None:
    jump = standing(4)
    jump[1:, Joint.PELVIS] += (0.03, 0.04, 0.0)
    jump[1:, Joint.HEAD] += (0.0, 0.3, 0.4)
    jump[2:] += 2.0  # a later step does not count
    assert first_step(batch(standing(2), jump)) == pytest.approx([0.0, 0.5])
    with pytest.raises(ValueError, match="sequence 0: expected 2 frames or more, found 1"):
        first_step(batch(standing(1)))


def test_heights_of_the_feet_and_depths_of_all_joints() -> None:
    hop = standing(5)
    hop[2, :, 1] += 0.3  # the toes, at 2 cm, are the lowest
    one_foot = standing(5)
    one_foot[:, [Joint.LEFT_ANKLE, Joint.LEFT_FOOT], 1] += 0.3  # the other foot stays
    sunk = standing(3)
    sunk[1, Joint.RIGHT_WRIST, 1] = -0.07
    on_a_hand = np.add(standing(4), (0.0, 0.5, 0.0))  # a hand on the floor does not keep the feet there
    on_a_hand[:, Joint.LEFT_WRIST, 1] = 0.0
    motions = batch(standing(2), hop, one_foot, sunk, on_a_hand)
    assert floating(motions) == pytest.approx([0.02, 0.32, 0.02, 0.02, 0.52])
    assert penetration(motions) == pytest.approx([0.0, 0.0, 0.0, 0.07, 0.0])


def test_pelvis_and_trunk_are_taken_at_their_worst_frame() -> None:
    motion = standing(6)
    motion[3, Joint.PELVIS, 1] = 0.15
    bent = standing(6)
    bent[:, Joint.PELVIS] = (0, 0.9, 0)
    bent[2, Joint.NECK] = (0.3, 0.9, 0.4)  # level
    bent[4, Joint.NECK] = (0.0, 0.4, 0.5)  # 45 degrees below the level
    pelvis = float(STANDING[Joint.PELVIS, 1])
    assert lowest_pelvis(batch(motion, standing(3))) == pytest.approx([0.15, pelvis])
    assert largest_trunk_tilt(batch(bent, bent[:3], standing(2))) == pytest.approx([135.0, 90.0, 0.0])


def glide(speed: float, *, n: int = 11, height: float = 0.02, moving: int = 10) -> np.ndarray:
    """A standing body of which both toes slide in the first ``moving`` transitions."""
    motion = standing(n)
    motion[:, list(TOES), 1] = height
    motion[:, list(TOES), 0] += (np.minimum(np.arange(n), moving) * speed / FPS)[:, None]
    return motion


def test_slow_slides_count_what_foot_skating_lets_pass() -> None:
    slow = batch(glide(0.3))
    assert foot_skating(slow, FPS, CONSTANTS) == 0
    assert slow_slides(slow, FPS, CONSTANTS) == 1
    assert slow_slides(batch(glide(0.3, moving=4), glide(0.3, moving=1)), FPS, CONSTANTS) == pytest.approx([0.4, 0.1])


def test_slow_slides_are_strict_in_speed_and_height() -> None:
    assert slow_slides(batch(glide(0.2)), FPS, CONSTANTS) == 0
    assert slow_slides(batch(glide(0.200001)), FPS, CONSTANTS) == 1
    assert slow_slides(batch(glide(0.3, height=0.05)), FPS, CONSTANTS) == 0
    assert slow_slides(batch(glide(0.3, height=0.04999)), FPS, CONSTANTS) == 1


def test_one_sliding_toe_is_enough_and_steps_up_and_down_are_no_slides() -> None:
    motion = standing(11)
    motion[:, Joint.LEFT_FOOT, 0] += 0.02 * np.arange(11)
    assert slow_slides(batch(motion), FPS, CONSTANTS) == 1
    lifted = standing(11)
    lifted[::2, Joint.LEFT_FOOT] += (0.1, 0.2, 0.0)
    assert slow_slides(batch(lifted), FPS, CONSTANTS) == 0


def test_speed_is_the_largest_of_a_joint_and_no_step_between_sequences() -> None:
    motion = standing(5)
    motion[3:, Joint.LEFT_WRIST] += (0.03, 0.04, 0.0)
    assert largest_speed(batch(motion, standing(2) + 50.0, motion), FPS) == pytest.approx([1.0, 0.0, 1.0])
    assert largest_speed(batch(motion, motion), np.array([20.0, 30.0])) == pytest.approx([1.0, 1.5])


def test_jerk_of_a_cubic_in_metres_a_second_cubed() -> None:
    cubic = standing(9) + np.arange(9)[:, None, None] ** 3 * np.array([0.001, 0, 0])
    assert largest_jerk(batch(standing(2), cubic, standing(3)), 20.0) == pytest.approx([0, 48, 0])
    assert largest_jerk(batch(cubic), 30.0) == pytest.approx([0.006 * 30**3])
    assert largest_acceleration(batch(standing(2), cubic), 20.0) == pytest.approx([0, 6 * 7 * 0.001 * 400])
    reach = standing(5)
    reach[-1, Joint.LEFT_WRIST, 2] += 0.1
    assert measured(batch(reach))["wrist_acceleration"] == pytest.approx([40.0]), "a hand that leaps in the last frame"
    nod = standing(5)
    nod[2, Joint.HEAD] += 0.1
    assert measured(batch(nod, cubic))["trunk_acceleration"] == pytest.approx([0, 6 * 7 * 0.001 * 400])


def crouched(height: float) -> np.ndarray:
    motion = standing(6)
    motion[:, Joint.PELVIS, 1] = height
    return motion


def bent(degrees: float) -> np.ndarray:
    motion = standing(6)
    angle = np.deg2rad(degrees)
    motion[:, Joint.NECK] = motion[:, Joint.PELVIS] + 0.6 * np.array([0.0, np.cos(angle), np.sin(angle)])
    return motion


def raised(height: float) -> np.ndarray:
    return np.add(standing(6), (0.0, height - 0.02, 0.0))  # the toes stand at 2 cm


def stretched(change: float) -> np.ndarray:
    motion = standing(6)
    arm = STANDING[Joint.LEFT_WRIST] - STANDING[Joint.LEFT_ELBOW]
    motion[3:, Joint.LEFT_WRIST] += change * arm
    return motion


def jerked(jerk: float) -> np.ndarray:
    """A cubic of all joints: no bone changes, and every third difference is the same."""
    return standing(6) + np.arange(6)[:, None, None] ** 3 * np.array([0.0, 0.0, jerk / FPS**3 / 6])


def dashed(speed: float) -> np.ndarray:
    return standing(6) + np.arange(6)[:, None, None] * np.array([0.0, 0.0, speed / FPS])


@pytest.mark.parametrize(
    ("made", "measure", "step", "flag"),
    [
        pytest.param(crouched, "lowest_pelvis", -1, "not_upright", id="pelvis"),
        pytest.param(bent, "trunk_tilt", 1, "not_upright", id="trunk"),
        pytest.param(raised, "floating", 1, "floating", id="floating"),
        pytest.param(lambda depth: raised(-depth), "penetration", 1, "below_the_floor", id="floor"),
        pytest.param(stretched, "bone_change", 1, "changing_bones", id="longer bone"),
        pytest.param(lambda change: stretched(-change), "bone_change", 1, "changing_bones", id="shorter"),
        pytest.param(jerked, "jerk", 1, "jerky", id="jerk"),
        pytest.param(dashed, "speed", 1, "too_fast", id="speed"),
    ],
)
def test_every_limit_holds_on_one_side_and_breaks_on_the_other(made, measure: str, step: int, flag: str) -> None:
    limit = CONSTANTS.plausible_3[measure].value
    assert flag not in broken(made(limit)), "the limit itself is kept"
    assert flag not in broken(made(limit + step * 5e-7))
    assert flag in broken(made(limit + step * 3e-6))
    assert flag in broken(made(limit + step * 0.1 * limit))
    assert flag not in broken(made(limit - step * 0.1 * limit))


def test_the_share_of_slides_holds_at_its_limit() -> None:
    half = glide(0.3, moving=5)
    assert broken(half) - {"changing_bones"} == set()
    assert "sliding_feet" in broken(glide(0.3, moving=6))


def test_a_bone_that_begins_without_length_is_implausible() -> None:
    motion = standing(5)
    motion[:, Joint.LEFT_WRIST] = motion[:, Joint.LEFT_ELBOW]
    assert broken(motion) == {"changing_bones"}


@pytest.mark.parametrize(
    ("motion", "flags"),
    [
        pytest.param(standing(8) * (1, 0.05, 1), {"not_upright"}, id="collapsed"),
        pytest.param(np.add(standing(8), (0, 1.0, 0)), {"floating"}, id="floats"),
        pytest.param(standing(8) - (0, 0.5, 0), {"below_the_floor"}, id="sunk"),
        pytest.param(standing(8) * (1, -1, 1) + (0, 1.6, 0), {"not_upright", "floating"}, id="upside down"),
        pytest.param(glide(0.3), {"sliding_feet"}, id="glides"),
    ],
)
def test_bodies_that_no_person_has(motion: np.ndarray, flags: set[str]) -> None:
    assert broken(motion) - {"changing_bones"} == flags


def with_arms_of(times: float) -> np.ndarray:
    motion = standing(6)
    for shoulder, elbow, wrist in ((16, 18, 20), (17, 19, 21)):
        motion[:, elbow] = motion[:, shoulder] + times * (STANDING[elbow] - STANDING[shoulder])
        motion[:, wrist] = motion[:, elbow] + times * (STANDING[wrist] - STANDING[elbow])
    return motion


@pytest.mark.parametrize(
    ("motion", "given", "own"),
    [
        pytest.param(standing(6), set(), set(), id="the given body"),
        pytest.param(1.07 * standing(6), {"other_start"}, set(), id="a tall one"),
        pytest.param(1.12 * standing(6), {"changing_bones", "other_start"}, set(), id="a giant"),
        pytest.param(1.6 * standing(6), {"changing_bones", "other_start", "no_adult"}, {"no_adult"}, id="a tree"),
        pytest.param(0.26 * standing(6), {"changing_bones", "other_start", "no_adult"}, {"no_adult"}, id="a doll"),
        pytest.param(with_arms_of(2), {"changing_bones", "other_start", "no_adult"}, {"no_adult"}, id="long arms"),
        pytest.param(with_arms_of(0.5), {"changing_bones", "other_start", "no_adult"}, {"no_adult"}, id="short arms"),
        pytest.param(np.add(standing(6), (0.049, 0, 0)), set(), set(), id="4.9 cm beside"),
        pytest.param(np.add(standing(6), (0.051, 0, 0)), {"other_start"}, set(), id="5.1 cm beside"),
    ],
)
def test_a_body_is_the_given_one_from_the_first_frame_on_and_an_adult_where_none_is_given(motion, given, own) -> None:
    checked = {"changing_bones", "other_start", "no_adult", "own_first_frame"}
    for pose_given, expected in ((True, given), (False, own | {"own_first_frame"})):
        where = dataclasses.replace(targets(), pose_given=pose_given)
        found = score(batch(motion), batch(standing(6)), where, CONSTANTS, metrics=["plausible", "plausible_3"])
        assert set((found["plausible"].flag[0] or "").split(";")) & checked == expected
        assert found["plausible_3"].flag == [None] or not set(found["plausible_3"].flag[0].split(";")) & checked


def test_what_a_body_was_not_given_is_no_fault_of_it() -> None:
    where = dataclasses.replace(targets(), pose_given=False)
    still = batch(standing(6))
    own = score(still, still, where, CONSTANTS, metrics=["plausible"])["plausible"]
    assert own.value == score(still, still, targets(), CONSTANTS, metrics=["plausible"])["plausible"].value
    assert own.flag[0].split(";")[-1] == "own_first_frame"


def test_a_teleport_is_too_fast_is_jerky_and_is_counted() -> None:
    motion = standing(8)
    motion[4:] += (0.0, 0.0, 1.01)  # 20.2 m/s
    found = score(batch(motion, standing(8)), batch(standing(8), standing(8)), targets(2), CONSTANTS)
    assert found["plausible"].value.tolist() == [0, 1]
    assert found["plausible_3"].flag == ["jerky;too_fast", None]
    assert found["largest_speed"].value == pytest.approx([20.2, 0])
    assert found["mpjpe"].value[0] == pytest.approx(1.01 / 2), "it is scored all the same"


def test_sequences_are_measured_as_they_are_alone_and_as_defined() -> None:
    rng = np.random.default_rng(0)
    motions = [random_motion(rng, int(n)) for n in rng.integers(2, 80, 30)]
    together = measured(batch(*motions))
    for i, motion in enumerate(motions):
        for name, value in measured(batch(motion)).items():
            assert together[name][i] == value[0], name
        step = np.linalg.norm(np.diff(motion, axis=0), axis=-1)
        assert together["speed"][i] == pytest.approx(FPS * step.max())
        assert together["floating"][i] == pytest.approx(max(motion[:, [7, 8, 10, 11], 1].min(axis=1).max(), 0))
        assert together["penetration"][i] == pytest.approx(max(-motion[..., 1].min(), 0))
        low = motion[:, list(TOES), 1] < 0.05
        speed = FPS * np.linalg.norm(np.diff(motion[:, list(TOES)], axis=0)[..., [0, 2]], axis=-1)
        assert together["slow_slides"][i] == pytest.approx(np.mean((low[1:] & low[:-1] & (speed > 0.2)).any(axis=1)))
