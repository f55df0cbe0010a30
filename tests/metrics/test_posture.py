"""Postures by hand: bends, turns, and how a body stands at its goal."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.metrics.batch import ScoringPair
from prbench.metrics.plausible import posture_numbers
from tests.metrics.motions import FPS, batch, looking, standing, targets


def numbers(motion: np.ndarray, goal=(0.0, 1.0, 0.3)) -> dict[str, float]:
    motions = batch(motion)
    found = posture_numbers(ScoringPair(motions, motions, targets(goal=goal)))
    return {name: float(value[0]) for name, value in found.items()}


def bent(middle: Joint, end: Joint, before: Joint, degrees: float) -> np.ndarray:
    """A body of which a bone leaves the direction of the one before it in one frame."""
    motion = standing(5)
    bone = motion[2, middle] - motion[2, before]
    across = np.cross(bone, (1.0, 0.0, 0.0))
    across *= np.linalg.norm(bone) / np.linalg.norm(across)
    angle = np.deg2rad(degrees)
    motion[2, end] = motion[2, middle] + np.cos(angle) * bone + np.sin(angle) * across
    return motion


@pytest.mark.parametrize(
    ("name", "before", "middle", "end"),
    [
        ("knee", Joint.LEFT_HIP, Joint.LEFT_KNEE, Joint.LEFT_ANKLE),
        ("knee", Joint.RIGHT_HIP, Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE),
        ("elbow", Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST),
        ("elbow", Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST),
        ("ankle", Joint.LEFT_KNEE, Joint.LEFT_ANKLE, Joint.LEFT_FOOT),
    ],
)
def test_a_bend_is_the_largest_angle_between_two_bones(name: str, before: Joint, middle: Joint, end: Joint) -> None:
    assert numbers(bent(middle, end, before, 130.0))[name] == pytest.approx(130.0)


def test_hips_and_spine_bend_against_the_trunk() -> None:
    motion = standing(4)
    motion[:, Joint.PELVIS] = (0, 0.9, 0)
    motion[:, Joint.SPINE1] = (0, 1.0, 0)
    motion[:, Joint.SPINE3] = (0, 1.3, 0)
    motion[2, Joint.LEFT_KNEE] = motion[2, Joint.LEFT_HIP] + (0.0, 0.0, 0.4)
    motion[3, Joint.NECK] = (0.0, 1.5, 0.2)
    found = numbers(motion)
    assert found["hip"] == pytest.approx(90.0)
    assert found["spine"] == pytest.approx(45.0)


def test_shoulders_twist_against_hips_and_turn_in_time() -> None:
    twisted = looking([0, 10, 30, 30])
    assert numbers(twisted)["twist"] == pytest.approx(30.0)
    assert numbers(twisted)["turning"] == pytest.approx(20.0 * FPS)
    across_the_border = looking([170, 180, 190])
    assert numbers(across_the_border)["turning"] == pytest.approx(10.0 * FPS)
    assert numbers(twisted)["twisting"] == pytest.approx(20.0 * FPS)


def test_hips_turn_no_farther_than_the_feet_let_them() -> None:
    motion = standing(4)
    assert numbers(motion)["toe_out"] == pytest.approx(0.0)
    for degrees in (60.0, 170.0, -120.0):
        angle = np.deg2rad(degrees)
        motion[2, Joint.LEFT_HIP] = (0.1 * np.cos(angle), 0.85, -0.1 * np.sin(angle))
        motion[2, Joint.RIGHT_HIP] = (-0.1 * np.cos(angle), 0.85, 0.1 * np.sin(angle))
        assert numbers(motion)["toe_out"] == pytest.approx(abs(degrees))


def test_neck_and_trunk_bend_from_rest_and_turn_in_time() -> None:
    nods = bent(Joint.NECK, Joint.HEAD, Joint.SPINE3, 50.0)
    motions = batch(nods)
    rest = posture_numbers(ScoringPair(motions, motions, targets(tilt=38.3)))
    assert rest["neck"] == pytest.approx(50.0 - 38.3)
    assert numbers(nods)["nodding"] == pytest.approx(numbers(nods)["neck"] * FPS, rel=0.5)
    bows = standing(4)
    bows[:, Joint.PELVIS] = (0, 0.9, 0)
    bows[2:, Joint.NECK] = (0.0, 0.9 + 0.6 * np.cos(0.1), 0.6 * np.sin(0.1))
    assert numbers(bows)["bowing"] == pytest.approx(np.rad2deg(0.1) * FPS)


def test_the_body_at_its_goal_is_that_of_the_nearest_wrist() -> None:
    motion = standing(6)
    motion[:, Joint.PELVIS] = (0, 0.9, 0)
    motion[1, Joint.NECK] = (0.0, 0.9, 0.6)  # level, while the hand is elsewhere
    motion[3, Joint.LEFT_WRIST] = (0.0, 1.0, 0.25)
    motion[3, Joint.NECK] = (0.0, 0.9 + 0.6 * np.cos(np.pi / 6), 0.3)
    motion[3, Joint.HEAD] = (0.0, 1.3, 0.5)
    found = numbers(motion)
    assert found["tilt_at_goal"] == pytest.approx(30.0)
    assert found["head_under_goal"] == pytest.approx(-0.3)
    assert numbers(motion, (0.0, 0.4, 0.3))["tilt_at_goal"] == 0, "whoever picks from the floor may bend"


def test_sequences_do_not_influence_one_another() -> None:
    first = looking([0, 10, 30, 30])
    second = looking([90, 90, 80])
    goals = targets(2, goal=[(0.0, 1.0, 0.3), (1.0, 0.7, 0.0)])
    motions = batch(first, second)
    together = posture_numbers(ScoringPair(motions, motions, goals))
    for row, (motion, goal) in enumerate([(first, (0.0, 1.0, 0.3)), (second, (1.0, 0.7, 0.0))]):
        assert {name: value[row] for name, value in together.items()} == numbers(motion, goal)
