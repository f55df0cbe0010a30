"""Proposed picks: what reaching looks like, and what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from prbench.curation.propose_events import propose_pick
from prbench.geometry.skeleton import Joint
from prbench.recording import BodyStream, GazeStream, Recording
from tests.curation.scenes import minimum_jerk
from tests.fakes import STANDING
from tests.readers import gimo_sample

REACH, FALSE_REACH = 4.0, 7.0
"""When the right wrist arrives at a shelf with gaze on it, and when it does so unseen, seconds."""
PLACE = STANDING[Joint.RIGHT_SHOULDER] + np.array([-0.05, 0.05, 0.5])


def scene(*, looks: bool = True, moves: bool = True) -> Recording:
    times = np.arange(300) / 30
    joints = np.tile(STANDING, (len(times), 1, 1))
    joints += 0.001 * np.sin(7 * times)[:, None, None]
    for arrival in (REACH, FALSE_REACH) if moves else ():
        share = minimum_jerk((times - arrival + 0.8) / 0.8) * (1 - minimum_jerk((times - arrival - 0.1) / 0.8))
        there = PLACE + (0.0 if arrival == REACH else np.array([0.0, -0.3, -0.2]))
        joints[:, Joint.RIGHT_WRIST] += share[:, None] * (there - STANDING[Joint.RIGHT_WRIST])
        elbow = (there + STANDING[Joint.RIGHT_SHOULDER]) / 2 - STANDING[Joint.RIGHT_ELBOW]
        joints[:, Joint.RIGHT_ELBOW] += share[:, None] * elbow
    head = joints[:, Joint.HEAD]
    target = np.where((np.abs(times - REACH) < 1.0)[:, None], PLACE, [2.0, 0.0, 0.5])
    apart = target - head
    valid = np.full(len(times), looks)
    base = gimo_sample.recording(gimo_sample.readings())
    return replace(
        base,
        body=BodyStream(times, joints, np.ones(len(times), dtype=bool)),
        gaze=GazeStream(times, head, apart / np.linalg.norm(apart, axis=1, keepdims=True), valid),
    )


def test_the_stop_of_a_stretched_arm_under_gaze_is_proposed() -> None:
    found = propose_pick(scene())
    assert found is not None
    assert abs(found.time - REACH) < 0.15
    assert found.hand == "right"
    assert found.confidence > 0.8
    assert "right wrist slows from" in found.reason
    assert "gaze 0 cm from the wrist" in found.reason


def test_gaze_makes_the_difference() -> None:
    with_gaze, without = propose_pick(scene()), propose_pick(scene(looks=False))
    assert with_gaze is not None
    assert without is not None
    assert without.confidence < with_gaze.confidence
    assert "no gaze" in without.reason


def test_a_hint_chooses_the_stop_beside_it() -> None:
    found = propose_pick(scene(), hint=FALSE_REACH + 0.2)
    assert found is not None
    assert abs(found.time - FALSE_REACH) < 0.15
    assert found.reason.startswith("hint -0.")


def test_a_hint_counts_even_where_nothing_stops() -> None:
    found = propose_pick(scene(moves=False), hint=5.0)
    assert found is not None
    assert found.time == 5.0
    assert found.confidence < 0.8


def test_who_only_stands_gets_no_proposal() -> None:
    assert propose_pick(scene(moves=False)) is None
    assert propose_pick(replace(scene(), body=None)) is None
