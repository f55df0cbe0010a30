"""Curves under the figures: cases worked by hand, and agreement with the metrics."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.metrics import GazeRays, MotionBatch
from prbench.metrics.reach_success import reach_success
from prbench.protocol.manifests import load_protocol
from prbench.viewing.figures import flattened
from prbench.viewing.replay.scene import (
    RECORDED_COLOUR,
    Goal,
    ShownMotion,
    gaze_distance,
    known_scores,
    measure,
    phase,
    score_row,
)
from tests.fakes import STANDING, smooth_motion
from tests.viewing.replay.scenes import a_scene

_NO_BOX = np.zeros((8, 3))


def _upright() -> np.ndarray:
    """The standing body with the head exactly above the neck, so that with a tilt of 0 it faces +Z."""
    body = STANDING.copy()
    body[Joint.NECK], body[Joint.HEAD] = (0.0, 1.5, 0.0), (0.0, 1.6, 0.0)
    return body


def _goal(degrees: float, distance: float) -> Goal:
    angle = np.deg2rad(degrees)
    return Goal(np.array([distance * np.sin(angle), 1.6, distance * np.cos(angle)]), _NO_BOX)


@pytest.mark.parametrize(("degrees", "distance"), [(30, 1.0), (0, 0.0), (180, 2.0), (90, 2.0)])
def test_a_goal_two_metres_away_at_a_known_angle(degrees, distance):
    body = ShownMotion("x", RECORDED_COLOUR, _upright()[None])
    head, _ = measure(body, _goal(degrees, 2.0), head_tilt_deg=0.0)
    assert head[0] == pytest.approx(distance, abs=1e-9)  # 2 sin 30°; behind the head: the way to it


def test_the_nearer_wrist_counts_and_the_best_frame():
    joints = np.stack([STANDING, STANDING])
    joints[1, Joint.LEFT_WRIST] = (0.0, 1.6, 1.93)
    _, wrist = measure(ShownMotion("x", RECORDED_COLOUR, joints), _goal(0, 2.0), head_tilt_deg=0.0)
    assert wrist[1] == pytest.approx(0.07)
    assert wrist.min() == pytest.approx(0.07)


def test_reaching_by_the_curve_is_reaching_by_the_metric():
    constants = load_protocol().metrics
    for number in range(20):
        joints = smooth_motion(f"view-{number}", 60).astype(np.float64)
        goal = joints[30, Joint.RIGHT_WRIST] + [0.0, 0.1 + 0.004 * (number - 10), 0.0]
        _, wrist = measure(ShownMotion("x", RECORDED_COLOUR, joints), Goal(goal, _NO_BOX), 7.4)
        metric = reach_success(MotionBatch.from_motions([joints]), goal[None], constants)[0]
        assert (wrist.min() <= constants.reach_distance) == (metric == 1.0)


def test_invalid_gaze_leaves_a_gap():
    gaze = GazeRays(np.zeros((2, 3)), np.array([[0.0, 0, 1], [0, 0, 1]]), np.array([True, False]))
    goal = Goal(np.array([3.0, 0.0, 4.0]), _NO_BOX)
    assert gaze_distance(gaze, goal)[0] == pytest.approx(3.0)
    assert np.isnan(gaze_distance(gaze, goal)[1])


def test_scores_in_words_leave_out_what_compares_a_motion_with_itself():
    scene = a_scene("pr, goal-loc")
    own, method = (score_row(scene, motion) for motion in scene.motions)
    assert own[:2] == ("no", "yes")
    assert own[3:] == ("–", "–", "–")
    assert method[:2] == ("yes", "no")
    assert method[3:] == ("yes", "12 cm", "1.50 m")
    assert "Location Error" not in dict(known_scores(scene, scene.motions[0]))
    assert known_scores(scene, scene.motions[1])[3:5] == [("Location Error", "yes"), ("Goal MPJPE", "12 cm")]


def test_prime_and_event_are_named_when_they_happen():
    scene = a_scene()
    assert phase(scene, scene.prime_frame).strip() == "prime"
    assert phase(scene, scene.n_frames - 1).strip() == "pick"
    assert phase(scene, 10) == ""


def test_figures_keep_their_height_and_show_what_lies_in_the_picture_plane() -> None:
    points = np.array([[1.0, 1.7, 2.0], [1.0, 0.0, 2.5]])
    flat = flattened(points, np.array([1.0, 0.9, 2.0]), np.array([0.0, 0.0, 1.0]), 3.0)
    assert flat == pytest.approx(np.array([[3.0, 1.7], [3.5, 0.0]]))
