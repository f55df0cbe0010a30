"""Do twenty recordings of every preset move, look and act as people do, and resemble the datasets?

Limits: ``plausibility`` and ``behaviour`` beside this folder; docs/specification/synthetic-recordings.md#statistics.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.synthetic.people import PRESETS, perform
from prbench.synthetic.performance import Performance
from tests.synthetic.behaviour import TARGETS, measure_behaviour, out_of_range, sequence_statistics
from tests.synthetic.plausibility import implausible, measure, recorded_bone_change, truth_scores
from tests.synthetic.true_clips import clips_of

TRIAL = {
    "hd-epic": (0.75, 0.61),
    "mogaze": (0.80, 0.64),
    "hot3d": (0.82, 0.62),
    "adt": (0.59, 0.49),
    "gimo": (0.69, 0.59),
}
"""Prime Success of the people's own motion, `equation` and `onset`."""
REACH = {"hd-epic": (0.6, 1.0), "mogaze": (0.6, 1.0), "hot3d": (0.6, 1.0), "adt": (0.0, 1.0), "gimo": (1.0, 1.0)}
"""Reach Success: people of adt hold boxes by the fingertips, the goal of gimo is the wrist."""


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_people_move_look_and_act_as_they_should(crowd, preset: str) -> None:
    people = crowd(preset)
    assert implausible(measure(people)) == {}
    assert out_of_range(preset, measure_behaviour(people)) == {}
    clips = clips_of(people)
    deviations = sequence_statistics(clips).deviations(TARGETS[preset])
    assert {name: value for name, value in deviations.items() if abs(value) > 1 / 3} == {}
    scores = truth_scores(clips)
    assert (scores["prime_equation"], scores["prime_onset"]) == pytest.approx(TRIAL[preset], abs=0.15)
    assert REACH[preset][0] <= scores["reach_any"] <= REACH[preset][1]
    if preset in ("adt", "gimo"):
        assert scores["reach_final"] == REACH[preset][0]


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_few_goals_are_given_up_and_truth_says_which_are_seen(crowd, preset: str) -> None:
    events = [event for performance in crowd(preset) for event in performance.events]
    assert len(events) > 0.75 * 6 * len(crowd(preset))
    seen = {tag: [each.prime_time is not None for each in events if each.tag == tag] for tag in ("plain", "unprimed")}
    assert np.mean(seen["plain"]) > 0.97
    assert np.mean(seen["unprimed"]) < 0.35
    primed = [event for event in events if event.prime_time is not None]
    assert len(primed) > 0.75 * len(events)  # adt leaves .15 unprimed
    for event in primed:
        assert event.event_time - 10.0 <= event.prime_first <= event.prime_time <= event.event_time


@pytest.mark.slow
def test_near_looks_are_near_misses(crowd) -> None:
    people = [performance for preset in PRESETS for performance in crowd(preset)]
    near = [event for each in people for event in each.events if event.tag == "near" and event.prime_kind]
    assert np.mean([event.prime_kind == "near_miss" for event in near]) > 0.65


def test_people_in_a_kitchen_seldom_walk_sideways() -> None:
    some = [perform("hd-epic", seed=3, index=index, n_events=6, rate=60.0, provocations={}) for index in range(5)]
    assert measure_behaviour(some)["off_the_way"] < 0.22  # five recordings are few


def mirrored_knee(joints: np.ndarray) -> None:
    """Mirror the left knee in the line from hip to ankle."""
    hip, ankle = joints[:, Joint.LEFT_HIP], joints[:, Joint.LEFT_ANKLE]
    along = (ankle - hip) / np.linalg.norm(ankle - hip, axis=1, keepdims=True)
    offset = joints[:, Joint.LEFT_KNEE] - hip
    joints[:, Joint.LEFT_KNEE] = hip + 2 * (offset * along).sum(axis=1, keepdims=True) * along - offset


def slipping_floor(joints: np.ndarray) -> None:
    joints[..., [0, 2]] += 0.8 * (joints[:, :1, [0, 2]] - joints[:1, :1, [0, 2]])


def drifting_foot(joints: np.ndarray) -> None:
    joints[:, Joint.LEFT_FOOT, 0] += 0.002 / 120 * np.arange(len(joints))  # 2 mm a second


def growing_neck(joints: np.ndarray) -> None:
    joints[-1, Joint.HEAD, 1] += 1e-6


@pytest.mark.parametrize(
    ("damage", "noticed"),
    [
        (drifting_foot, {"planted_slide"}),
        (mirrored_knee, {"knees_bent_backwards"}),
        (slipping_floor, {"foot_skating_mean", "planted_slide"}),
        (growing_neck, {"bone_length_change"}),
    ],
)
def test_what_no_body_does_is_noticed(adt_120: Performance, damage, noticed) -> None:
    joints = adt_120.joints.copy()
    damage(joints)
    assert noticed <= implausible(measure([replace(adt_120, joints=joints)])).keys()


def test_a_stretching_bone_is_measured(adt_120: Performance) -> None:
    clip = adt_120.joints[:20].copy()
    clip[-1] *= 1.1
    assert recorded_bone_change([clip]) == pytest.approx(0.1, abs=0.01)
