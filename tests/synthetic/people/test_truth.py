"""The truth record against what can be seen in the motion itself."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import PARENTS, WRISTS, Joint
from prbench.synthetic.people import PRESETS
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent


def object_of(performance: Performance, event: TrueEvent) -> ObjectMotion:
    return next(item for item in performance.objects if item.object_id == event.object_id)


def moves(performance: Performance) -> list[tuple[TrueEvent, ObjectMotion]]:
    pairs = [(event, object_of(performance, event)) for event in performance.events]
    return [(event, item) for event, item in pairs if len(item.position) > 1]


def test_a_pick_is_when_the_object_has_moved_a_millimetre_and_a_put_when_it_last_had(adt_120: Performance) -> None:
    step = 1.0 / adt_120.rate
    for event, item in moves(adt_120):
        away = np.linalg.norm(item.position - event.goal, axis=1)
        before = away[(adt_120.times > event.event_time - 0.25) & (adt_120.times < event.event_time - step)]
        after = away[(adt_120.times < event.event_time + 0.25) & (adt_120.times > event.event_time + step)]
        resting, moving = (before, after) if event.action == "pick" else (after, before)
        assert resting.max() <= 0.001 < moving.min()


def test_picks_and_puts_take_turns_and_the_put_follows_its_pick(adt_120: Performance) -> None:
    actions = [event.action for event in adt_120.events]
    assert actions == ["pick", "put"] * (len(actions) // 2) + ["pick"] * (len(actions) % 2)
    for pick, put in zip(adt_120.events[::2], adt_120.events[1::2], strict=False):
        assert pick.object_id == put.object_id
        assert pick.event_time < put.event_time


def test_an_object_at_rest_keeps_every_bit_of_its_pose(adt_120: Performance) -> None:
    for event, item in moves(adt_120):
        if event.action == "put":
            rest = adt_120.times >= event.event_time + 0.2
            assert len(np.unique(item.position[rest], axis=0)) == 1
            assert len(np.unique(item.rotation[rest], axis=0)) == 1
        else:
            rest = adt_120.times < event.contact_time  # a short, slow lift takes long to its first millimetre
            assert len(np.unique(item.position[rest], axis=0)) == 1


def test_a_carried_object_stays_in_the_hand_and_level_at_both_ends(adt_120: Performance) -> None:
    for event, item in moves(adt_120):
        side = int(event.hand == "right")
        held = item.held_by == side
        distance = np.linalg.norm(item.position - adt_120.finger_bases[:, side], axis=1)[held]
        assert np.ptp(distance) < 0.04
        assert item.rotation[-1, [1, 3]] == pytest.approx(0.0, abs=1e-12)


def test_boxes_are_world_aligned_around_the_goal(adt_120: Performance) -> None:
    for event in adt_120.events:
        assert (event.box_min + event.box_max) / 2 == pytest.approx(event.goal)
        assert np.all(event.box_max > event.box_min)


def ray_meets_box(origin: np.ndarray, direction: np.ndarray, event: TrueEvent) -> bool:
    """The same question answered by walking along the ray in steps of two millimetres."""
    points = origin + np.arange(0.0, 8.0, 0.002)[:, None] * direction
    outside = np.maximum(np.maximum(event.box_min - points, points - event.box_max), 0.0)
    return bool(np.linalg.norm(outside, axis=1).min() < 0.002)


def test_a_hit_is_the_first_time_that_the_gaze_meets_the_box(adt_120: Performance) -> None:
    hits = [event for event in adt_120.events if event.prime_kind == "hit" and event.prime_first == event.prime_time]
    assert hits
    for event in hits:
        frame = int(np.searchsorted(adt_120.times, event.prime_time - 1e-9))
        look = range(frame, frame + 12)
        assert any(ray_meets_box(adt_120.eye[i], adt_120.gaze[i], event) for i in look)
        start = int(np.searchsorted(adt_120.times, event.event_time - 10.0))
        assert not any(ray_meets_box(adt_120.eye[i], adt_120.gaze[i], event) for i in range(start, frame, 6))


@pytest.mark.slow
def test_primes_lie_in_the_ten_seconds_before_the_event(crowds: dict[str, list[Performance]]) -> None:
    events = [event for crowd in crowds.values() for performance in crowd for event in performance.events]
    primed = [event for event in events if event.prime_time is not None and event.prime_first is not None]
    assert len(primed) > 0.8 * len(events)
    for event in primed:
        assert event.event_time - 10.0 <= event.prime_first <= event.prime_time <= event.event_time


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_unprimed_events_are_hardly_ever_seen_and_the_others_nearly_always(
    crowds: dict[str, list[Performance]], preset: str
) -> None:
    events = [event for performance in crowds[preset] for event in performance.events]
    seen = {
        tag: [event.prime_time is not None for event in events if event.tag == tag] for tag in ("plain", "unprimed")
    }
    assert np.mean(seen["plain"]) > 0.97
    assert np.mean(seen["unprimed"]) < 0.35


@pytest.mark.slow
def test_near_looks_are_near_misses(crowds: dict[str, list[Performance]]) -> None:
    near = [e for crowd in crowds.values() for p in crowd for e in p.events if e.tag == "near" and e.prime_kind]
    assert np.mean([event.prime_kind == "near_miss" for event in near]) > 0.7


def test_limb_rotations_turn_the_y_axis_along_the_bone(adt_120: Performance) -> None:
    from prbench.synthetic.people.kinematics import matrix_of

    for child in (Joint.LEFT_KNEE, Joint.RIGHT_ANKLE, Joint.LEFT_ELBOW, Joint.RIGHT_WRIST):
        parent = PARENTS[child]
        bone = adt_120.joints[:, child] - adt_120.joints[:, parent]
        along = matrix_of(adt_120.rotations[:, parent])[..., 1]
        assert along == pytest.approx(bone / np.linalg.norm(bone, axis=1, keepdims=True), abs=1e-9)
    hand = matrix_of(adt_120.rotations[:, WRISTS[0]])[..., 1]
    length = np.linalg.norm(adt_120.finger_bases[:, 0] - adt_120.joints[:, WRISTS[0]], axis=1, keepdims=True)
    assert adt_120.finger_bases[:, 0] == pytest.approx(adt_120.joints[:, WRISTS[0]] + length * hand)


def test_fixations_follow_one_another_without_gaps(adt_120: Performance) -> None:
    starts = np.array([fixation.start for fixation in adt_120.fixations])
    ends = np.array([fixation.end for fixation in adt_120.fixations])
    assert starts[0] == 0.0
    assert ends[:-1] == pytest.approx(starts[1:])


def test_gaze_stays_on_a_goal_while_it_is_fixated(adt_120: Performance) -> None:
    errors = []
    for fixation in adt_120.fixations:
        settled = (adt_120.times > fixation.start + 0.25) & (adt_120.times < fixation.end)
        if fixation.kind == "goal" and settled.any():
            offset = fixation.target - adt_120.eye[settled]
            cosine = (offset * adt_120.gaze[settled]).sum(axis=1) / np.linalg.norm(offset, axis=1)
            errors.extend(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    assert np.median(errors) < 1.0  # the drift is 0.3 deg on either axis
