"""What the arguments of a performance decide; each provocation does what its name says, and truth says what follows.

Equal arguments give equal bytes: tests/laws/synthetic_cases.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.geometry.skeleton import WRISTS, rotation_matrices
from prbench.synthetic.people import PRESETS, perform
from prbench.synthetic.people.plan import shares_for
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent


def provoke(tag: str, index: int = 0, preset: str = "adt") -> tuple[Performance, list[tuple[TrueEvent, ObjectMotion]]]:
    """A recording in which the provocation happens wherever it can, and its events with their objects."""
    performance = perform(preset, seed=1, index=index, n_events=4, rate=60.0, provocations={tag: 1.0})
    objects = {item.object_id: item for item in performance.objects}
    found = [(event, objects[event.object_id]) for event in performance.events if event.tag == tag]
    assert found, f"no event with the tag {tag}"
    return performance, found


def frames(performance: Performance, start: float, end: float) -> slice:
    first, last = np.searchsorted(performance.times, [start, end])
    return slice(int(first), int(last))


def finger_clearance(performance: Performance, event: TrueEvent, item: ObjectMotion, span: slice) -> np.ndarray:
    """Distance of the acting finger base from the oriented box, metres."""
    finger = performance.finger_bases[span, int(event.hand == "right")]
    in_box = (finger - item.position[0]) @ rotation_matrices(item.rotation[0])
    return np.linalg.norm(np.maximum(np.abs(in_box) - item.half_extents, 0.0), axis=1)


@pytest.mark.parametrize(("tag", "begin", "end"), [("pass_by", -0.5, 0.5), ("touch", 0.0, 0.48)])
def test_a_hand_that_passes_or_touches_comes_near_and_moves_nothing(tag: str, begin: float, end: float) -> None:
    performance, found = provoke(tag)
    for event, item in found:
        assert event.expected == "not_an_event"
        assert len(item.position) == 1
        clearance = finger_clearance(
            performance, event, item, frames(performance, event.event_time + begin, event.event_time + end)
        )
        if tag == "touch":  # for half a second
            assert clearance.max() < 0.021
        else:
            assert 0.02 < clearance.min() < 0.055


def test_nudge_slides_less_than_two_centimetres_in_a_moment() -> None:
    performance, found = provoke("nudge")
    for event, item in found:
        assert event.expected == "not_an_event"
        moved = np.linalg.norm(item.position - item.position[0], axis=1)
        assert 0.008 <= moved[-1] <= 0.018
        assert np.ptp(performance.times[(moved > 1e-6) & (moved < moved[-1] - 1e-6)]) < 0.15


def test_two_hands_carry_one_object_side_by_side() -> None:
    performance, found = provoke("two_handed")
    assert {event.expected for event, _ in found} <= {"sequence", "too_short", "not_primed", "minimum_movement"}
    (pick, item), (put, _) = found[:2]
    span = frames(performance, pick.event_time + 1.0, put.reach_start - 0.1)
    apart = np.linalg.norm(np.diff(performance.joints[span, WRISTS], axis=1), axis=-1)
    assert 0.09 < apart.min() <= apart.max() < 0.17
    nearer = np.linalg.norm(performance.joints[span, WRISTS] - item.position[span, None], axis=-1).argmin(axis=1)
    assert np.mean(nearer == int(pick.hand == "right")) > 0.9


def test_an_object_changes_hands_without_resting() -> None:
    performance, found = provoke("hand_over")
    (pick, item), (put, _) = found[:2]
    assert pick.hand != put.hand
    span = frames(performance, pick.event_time + 0.05, put.event_time - 0.1)
    assert set(np.unique(item.held_by[span])) == {0, 1}
    speed = np.linalg.norm(np.diff(item.position[span], axis=0), axis=1) * performance.rate
    assert speed.max() < 3.0  # no jump between the hands


def test_same_place_puts_back_within_three_centimetres() -> None:
    _, found = provoke("same_place")
    (pick, _), (put, _) = found[:2]
    assert 0.0 < np.linalg.norm(pick.goal - put.goal) < 0.03


def test_a_hand_that_waits_at_the_goal_moves_too_little() -> None:
    expected = [event.expected for index in range(4) for event, _ in provoke("too_near", index)[1]]
    assert expected.count("minimum_movement") > len(expected) / 2


def test_an_early_look_leaves_no_room_for_two_seconds() -> None:
    _, found = provoke("early")
    assert [event.expected for event, _ in found] == ["too_short"]


def test_a_sweeping_saccade_does_not_prime() -> None:
    swept = [event for index in range(4) for event, _ in provoke("swept", index)[1]]
    unprimed = [event for event in swept if event.expected == "not_primed"]
    assert len(unprimed) > len(swept) / 2


def test_a_door_turns_about_its_hinge_and_is_excluded() -> None:
    _, found = provoke("hinge")
    for event, item in found:
        assert event.expected == "excluded_category"
        assert item.hinged
        axis = item.position + rotation_matrices(item.rotation) @ (item.half_extents * [1.0, 0.0, 0.0])
        assert np.ptp(axis, axis=0).max() < 1e-9
        assert np.linalg.norm(item.position[-1] - item.position[0]) > 0.05


def test_what_stands_on_a_tray_moves_with_it_and_has_no_event() -> None:
    performance, found = provoke("contained")
    tray = found[0][1]
    named = {event.object_id for event in performance.events}
    loads = [
        item for item in performance.objects if len(item.position) > 1 and item.object_id not in named and item.movable
    ]
    assert loads
    frames_of_tray = rotation_matrices(tray.rotation)
    for load in loads:
        in_tray = np.einsum("nji,nj->ni", frames_of_tray, load.position - tray.position)
        if np.linalg.norm(in_tray[0]) < 0.2:  # the load of this tray, not of the second one
            assert np.ptp(in_tray, axis=0).max() < 1e-9
            return
    pytest.fail("nothing stands on the tray")


def test_tracking_is_lost_around_the_event() -> None:
    _, found = provoke("lost")
    for event, _ in found:
        assert event.lost_span is not None
        assert event.lost_span[0] - 0.1 < event.event_time < event.lost_span[1] + 0.1
        assert 0.3 <= event.lost_span[1] - event.lost_span[0] <= 1.0


def test_a_bystander_moves_an_object_that_the_wearer_never_touches() -> None:
    performance, found = provoke("bystander")
    assert len(performance.other_people) == 1
    assert [event.action for event, _ in found] == ["pick", "put"]
    for event, item in found:
        assert event.expected == "other_wearer"
        assert set(np.unique(item.held_by)) == {-1, 2}
        frame = int(np.searchsorted(performance.times, event.event_time))
        theirs = np.linalg.norm(performance.other_people[0].finger_bases[frame] - event.goal, axis=1).min()
        own = np.linalg.norm(performance.finger_bases[frame] - event.goal, axis=1).min()
        assert theirs < own


def test_a_tenth_of_the_movements_is_provoked_by_default() -> None:
    events = [
        event for index in range(7) for event in perform("adt", seed=2, index=index, n_events=10, rate=15.0).events
    ]
    tags = set(shares_for(PRESETS["adt"], None))
    assert 0.04 < sum(event.tag in tags for event in events) / len(events) < 0.25


def test_no_provocations_when_none_are_wanted() -> None:
    performance = perform("adt", seed=2, index=3, n_events=6, rate=20.0, provocations={})
    assert {event.tag for event in performance.events} <= {"plain", "near", "unprimed"}


@pytest.mark.parametrize("wanted", [{"nudged": 0.1}, {"nudge": 1.5}])
def test_unknown_provocations_and_shares_are_refused(wanted: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        perform("adt", seed=0, index=0, provocations=wanted)


def act(index: int, **changes: object) -> Performance:
    arguments: dict = {"seed": 11, "index": index, "n_events": 4, "rate": 30.0} | changes
    return perform("adt", **arguments)


def test_the_rate_changes_how_often_a_recording_is_sampled_not_what_happens() -> None:
    slow, fast = act(4), act(4, rate=60.0)
    assert [e.event_id for e in slow.events] == [e.event_id for e in fast.events]
    joints = fast.joints[::2][: len(slow.joints)]
    assert np.abs(joints - slow.joints[: len(joints)]).max() < 0.05


def test_ids_are_sixteen_digits_and_distinct_within_a_recording() -> None:
    ids = [item.object_id for item in act(4).objects]
    assert len(set(ids)) == len(ids)
    assert all(len(number) == 16 and number.isdecimal() for number in ids)


def test_as_many_bystander_objects_as_asked_for() -> None:
    untouched = [item for item in act(4, bystander_objects=40).objects if item.movable and len(item.position) == 1]
    assert len(untouched) >= 40


def test_unknown_presets_are_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match="hd-epic"):
        perform("adtt", seed=0, index=0)
