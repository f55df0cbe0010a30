"""In-hand segmentation and events on a hand-made scene."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.curation.events import find_events
from prbench.curation.in_hand import Departure, contact_distance, placed_in_gap
from prbench.errors import RecordingUnusable
from prbench.protocol.manifests import InHandRule
from prbench.recording import AnnotatedEvent, HandStream, Recording
from tests.curation.scenes import (
    DURATION,
    HALF,
    MANIFEST,
    PICK,
    PLACE_A,
    PLACE_B,
    PUT,
    RULE,
    clock,
    cup_centre,
    elsewhere,
    finger_path,
    hand,
    minimum_jerk,
    scene,
    stranger,
    track,
)

SLOW, FAST = clock(30), clock(120)


def events(recording: Recording, rule: InHandRule = RULE) -> list:
    return find_events(recording, rule)[0]


def visit(path: np.ndarray, until: float = PUT + 1) -> HandStream:
    """A left hand that comes to a moving object shortly before PICK, goes with it, and leaves at ``until``."""
    along = np.column_stack([np.interp(FAST, SLOW, path[:, axis]) for axis in range(3)]) - [0, 0, HALF[2] + 0.01]
    away = minimum_jerk(1 - (FAST - PICK + 1) / 0.5) + minimum_jerk((FAST - until) / 0.5)
    return hand("left", FAST, along - away[:, None] * [0, 0, 0.8])


def slide(distance: float, duration: float) -> np.ndarray:
    """The cup slides along its shelf, at PICK."""
    return PLACE_A + minimum_jerk((SLOW - PICK) / duration)[:, None] * [distance, 0, 0]


def test_one_holding_gives_a_pick_and_a_put_at_the_instants_of_departure_and_rest() -> None:
    pick, put = events(scene())
    assert (pick.action, put.action) == ("pick", "put")
    assert (pick.hand, put.hand) == ("left", "left")
    # The instants at which this smooth path is 1 mm from its ends, on a fine grid; samples are 33 ms apart.
    fine = np.linspace(PICK, PUT, 40_001)
    path = cup_centre(fine)
    left = fine[np.linalg.norm(path - PLACE_A, axis=1) > 0.001][0]
    rested = fine[np.linalg.norm(path - PLACE_B, axis=1) > 0.001][-1]
    assert pick.event_time == pytest.approx(left, abs=0.01)
    assert put.event_time == pytest.approx(rested, abs=0.01)


def test_a_steady_departure_is_timed_exactly() -> None:
    path = PLACE_A + np.clip(SLOW - PICK, 0, 2)[:, None] * [0.0, 0.1, 0.0]
    pick, put = events(scene(objects=(track(SLOW, path),), hands=(visit(path),)))
    assert pick.event_time == pytest.approx(PICK + 0.01, abs=1e-6), "1 mm away at 0.1 m/s"
    assert put.event_time == pytest.approx(PICK + 2 - 0.01, abs=1e-6)


def test_a_pick_lies_where_the_object_rested_and_a_put_where_it_will_rest() -> None:
    pick, put = events(scene())
    np.testing.assert_allclose(pick.place.location, PLACE_A, atol=1e-9)
    np.testing.assert_allclose(put.place.location, PLACE_B, atol=2e-4)
    np.testing.assert_allclose(pick.place.box_max - pick.place.box_min, 2 * HALF, atol=1e-9)


def test_noise_of_a_tracking_system_moves_instants_and_places_little() -> None:
    quiet = events(scene())
    noisy = events(scene(objects=(track(SLOW, cup_centre(SLOW), noise=0.0006),)))
    assert [event.action for event in noisy] == ["pick", "put"]
    for one, other in zip(quiet, noisy, strict=True):
        assert other.event_time == pytest.approx(one.event_time, abs=0.08), "this cup takes 0.06 s from 1 to 2.5 mm"
        np.testing.assert_allclose(other.place.location, one.place.location, atol=0.002)


def rubbed(size: float) -> np.ndarray:
    """The cup goes to and fro by so many metres for three seconds."""
    rubbing = size * np.sin(2 * np.pi * 2.0 * (SLOW - PICK)) * ((SLOW > PICK) & (SLOW < PICK + 3))
    return PLACE_A + rubbing[:, None] * [1.0, 0, 0]


RESTING = np.repeat(PLACE_A[None], len(SLOW), axis=0)


@pytest.mark.parametrize(
    ("path", "hands", "noise", "found"),
    [
        pytest.param(RESTING, None, 0.0, 0, id="touched, but it rests"),
        pytest.param(cup_centre(SLOW) + np.array([0, 0, 1.0]), None, 0.0, 0, id="moves with nobody near"),
        pytest.param(slide(0.018, 0.35), visit(RESTING), 0.0003, 0, id="a nudge"),
        pytest.param(slide(0.06, 0.35), visit(RESTING), 0.0003, 2, id="a slide"),
        pytest.param(rubbed(0.009), visit(rubbed(0.009)), 0.0, 0, id="rubbed to and fro"),
        pytest.param(rubbed(0.027), visit(rubbed(0.027)), 0.0, 2, id="rubbed more widely"),
    ],
)
def test_a_movement_is_a_pick_and_a_put_where_it_is_held_and_large_enough(path, hands, noise, found) -> None:
    streams = {} if hands is None else {"hands": (hands,)}
    assert len(events(scene(objects=(track(SLOW, path, noise=noise),), **streams))) == found


def test_an_object_held_still_in_the_air_stays_one_holding() -> None:
    first, second = (minimum_jerk((SLOW - start) / 1.0)[:, None] for start in (PICK, PICK + 3.0))
    up = PLACE_A + first * [0, 0.25, 0] + second * (PLACE_B - PLACE_A - [0, 0.25, 0])
    found = events(scene(objects=(track(SLOW, up),), hands=(visit(up, until=PICK + 4.3),)))
    assert [event.action for event in found] == ["pick", "put"]
    np.testing.assert_allclose(found[1].place.location, PLACE_B, atol=1e-6)


PAUSE = 15.0  # seconds; from here the cup is held in the air, swaying by a centimetre, for 1.5 s
PAUSED = np.where(SLOW < PAUSE, SLOW, np.where(SLOW < PAUSE + 1.5, PAUSE, SLOW - 1.5))
SWAYING = cup_centre(PAUSED, put=PUT - 1.5) + 0.01 * minimum_jerk((SLOW - PAUSE) / 1.5)[:, None] * [1, 0, 0]


@pytest.mark.parametrize(
    ("unseen", "gap"),
    [
        pytest.param((16.0, DURATION), (9, 9), id="the hand leaves the sight during the pause"),
        pytest.param((0.0, 16.0), (9, 9), id="the hand comes into sight during the pause"),
        pytest.param((16.6, DURATION), (16.22, 16.47), id="tracking is lost for a quarter of a second as it goes on"),
    ],
)
def test_what_is_held_in_the_air_is_not_put_down_there(unseen, gap) -> None:
    follower = visit(SWAYING)
    follower = dataclasses.replace(follower, valid=(unseen[0] > FAST) | (unseen[1] <= FAST))
    cup = track(SLOW, SWAYING, noise=0.0005)
    cup = dataclasses.replace(cup, valid=(gap[0] > SLOW) | (gap[1] <= SLOW))
    pick, put = events(scene(hands=(follower,), objects=(cup,)))
    assert (pick.action, put.action) == ("pick", "put")
    assert put.place.location == pytest.approx(SWAYING[-1], abs=0.003)
    assert (pick.event_time, put.event_time) == pytest.approx((PICK + 0.2, PUT - 0.2), abs=0.3)


def test_an_object_that_is_still_in_hand_when_the_recording_ends_was_not_put_down() -> None:
    up = PLACE_A + minimum_jerk((SLOW - PICK) / 1.0)[:, None] * [0, 0.25, 0]
    found = events(scene(objects=(track(SLOW, up),), hands=(visit(up, until=DURATION + 1),)))
    assert [event.action for event in found] == ["pick"]


def test_changing_hands_in_the_air_is_no_event() -> None:
    middle = (PICK + PUT) / 2
    path = finger_path(FAST)
    far = np.array([0.3, 0.9, -0.3])
    left = np.where((middle > FAST)[:, None], path, far)
    right = np.where((middle - 0.3 < FAST)[:, None], path, far)
    pick, put = events(scene(hands=(hand("left", FAST, left), hand("right", FAST, right))))
    assert (pick.hand, put.hand) == ("left", "right")


def test_an_object_moved_by_somebody_else_is_the_other_wearers() -> None:
    far = np.tile([0.3, 0.9, -0.3], (len(FAST), 1))
    found = events(scene(hands=(hand("left", FAST, far),), other_people=(stranger(FAST, finger_path(FAST)),)))
    assert [event.rejected.outcome for event in found] == ["other_wearer", "other_wearer"]


def test_a_door_is_excluded_by_category_and_kept_by_option() -> None:
    door = scene(hinged_objects=frozenset({"1"}))
    assert [event.rejected.outcome for event in events(door)] == ["excluded_category", "excluded_category"]
    kept = msgspec.structs.replace(RULE, drop_hinged=False)
    assert [event.rejected for event in events(door, kept)] == [None, None]


def test_where_the_contact_points_were_lost_the_wrists_tell_the_hand() -> None:
    """The other hand is still measured, half a metre away: it is not the one that put the cup down."""
    fingers = finger_path(FAST)
    away = np.tile([0.6, 0.9, 0.1], (len(FAST), 1))
    lost = (FAST > PUT - 0.7) & (FAST < PUT + 0.7)
    right = dataclasses.replace(hand("right", FAST, fingers), valid=~lost)
    wrists = (hand("left", FAST, away, "wrist"), hand("right", FAST, fingers - [0, 0, 0.08], "wrist"))
    pick, put = events(scene(hands=(hand("left", FAST, away), right, *wrists)))
    assert (pick.hand, pick.hand_source) == ("right", "contact")
    assert (put.hand, put.hand_source) == ("right", "tracked")


def test_an_object_already_in_hand_has_no_pick_and_one_still_in_hand_no_put() -> None:
    late = scene(objects=(track(SLOW[SLOW > PICK + 1], cup_centre(SLOW)[SLOW > PICK + 1]),))
    early = scene(objects=(track(SLOW[SLOW < PUT - 1], cup_centre(SLOW)[SLOW < PUT - 1]),))
    assert [event.action for event in events(late)] == ["put"]
    assert [event.action for event in events(early)] == ["pick"]


def test_an_object_that_is_held_still_when_the_recording_begins_has_no_pick() -> None:
    """It rests in the hand before it moves, which is no place to be picked from."""
    holding = cup_centre(FAST) - [0, 0, HALF[2] + 0.01]
    leaving = minimum_jerk((FAST - PUT - 1) / 0.5)[:, None] * [0, 0, 0.8]
    assert [event.action for event in events(scene(hands=(hand("left", FAST, holding - leaving),)))] == ["put"]


def test_an_event_in_a_short_tracking_gap_is_placed_at_120_instants_a_second() -> None:
    """The hand takes the object with it 0.1 s into a gap of 0.15 s: the seventh of 19 instants, from the end."""
    path = 2.0 * np.clip(FAST[:61] - 0.1, 0, None)[:, None] * [1.0, 0, 0]
    gap = Departure(
        time=0.0, gap=(0.0, 0.15), first_away=np.array([0.1, 0, 0]),
        centre=np.zeros(3), position=np.zeros(3), rotation=np.array([1.0, 0, 0, 0]),
    )  # fmt: skip
    found = placed_in_gap(gap, (hand("left", FAST[:61], path),), 0.05)
    assert found.placed
    assert found.time == pytest.approx(0.1)


@pytest.mark.parametrize("event", ["pick", "put"])
def test_an_event_in_a_tracking_gap_is_placed_by_the_hand(event: str) -> None:
    index, middle = (0, PICK + 0.3) if event == "pick" else (1, PUT - 0.3)
    tracked = np.abs(SLOW - middle) > 0.6
    whole = events(scene())[index]
    found = events(scene(objects=(track(SLOW[tracked], cup_centre(SLOW)[tracked]),)))[index]
    assert found.rejected is None
    assert found.tracking_gap == pytest.approx(1.2, abs=0.07)
    assert whole.tracking_gap is None
    assert found.event_time == pytest.approx(whole.event_time, abs=0.1)


def test_an_event_in_a_tracking_gap_without_a_hand_is_lost() -> None:
    tracked = np.abs(SLOW - PICK - 0.3) > 0.6
    plain = scene(objects=(track(SLOW[tracked], cup_centre(SLOW)[tracked]),))
    unseen = np.abs(FAST - PICK) > 0.3
    hands = tuple(dataclasses.replace(item, valid=unseen) for item in plain.hands)
    pick, put = events(dataclasses.replace(plain, hands=hands))
    assert (pick.rejected.outcome, pick.rejected.value) == ("tracking_lost", pytest.approx(1.2, abs=0.07))
    assert pick.event_time == pytest.approx(PICK + 0.3, abs=0.05), "the middle of the gap"
    assert put.rejected is None


def test_the_wrist_rule_of_the_paper_is_an_option() -> None:
    wrist = dataclasses.replace(hand("left", FAST, finger_path(FAST) - [0, 0, 0.07]), contact="wrist")
    rule = MANIFEST.in_hand_rule("wrist")
    assert [event.action for event in events(scene(hands=(wrist,)), rule)] == ["pick", "put"]
    assert events(scene(hands=(wrist,))) == [], "without finger bases the default rule says nothing"


def test_contact_distance_of_a_turned_box_by_hand() -> None:
    turned = np.array([np.cos(np.pi / 8), 0.0, np.sin(np.pi / 8), 0.0])  # 45 degrees about Y
    point = hand("left", np.array([0.48, 0.52]), np.tile([0.3, 0.0, 0.0], (2, 1)))
    cup = track(np.array([0.0]), np.zeros((1, 3)))
    plank = dataclasses.replace(cup, box_min=np.full(3, -0.1), box_max=np.array([0.1, 0.1, 0.15]))
    found = contact_distance(point, plank, RULE, np.array([0.5]), np.zeros((1, 3)), turned[None])
    # World +X is (1, 0, 1) / sqrt(2) in the frame of a box that is turned by 45 degrees about Y: x to -z, z to +x.
    local = 0.3 / np.sqrt(2)
    assert found[0] == pytest.approx(np.hypot(local - 0.1, local - 0.15))


def test_the_place_is_the_centre_of_the_box_wherever_the_objects_origin_lies() -> None:
    plain, (cup, table) = events(scene()), scene().objects
    turn = Rotation.from_euler("y", 90, degrees=True)
    corner = np.array([0.5, 0.2, 0.0])  # from the origin to the centre, in the object's frame
    moved = dataclasses.replace(
        cup,
        position=cup.position - turn.apply(corner),
        rotation=np.tile(turn.as_quat(scalar_first=True), (len(cup.times), 1)),
        box_min=corner - HALF,
        box_max=corner + HALF,
    )
    for one, other in zip(plain, events(scene(objects=(moved, table))), strict=True):
        np.testing.assert_allclose(other.place.location, one.place.location, atol=1e-9)
        assert other.event_time == pytest.approx(one.event_time, abs=1e-6)


def test_a_lid_that_is_turned_about_its_far_origin_moves() -> None:
    """Its origin stays where it is; the centre of its box goes up by 40 cm."""
    angle = np.deg2rad(60) * minimum_jerk((SLOW - PICK) / 2.0)
    turn = Rotation.from_rotvec(angle[:, None] * [-1.0, 0.0, 0.0])
    lid = dataclasses.replace(
        track(SLOW, np.tile(PLACE_A, (len(SLOW), 1))),
        rotation=turn.as_quat(scalar_first=True),
        box_min=np.array([-0.04, -0.01, 0.4]),
        box_max=np.array([0.04, 0.01, 0.5]),
    )
    centre = PLACE_A + turn.apply([0.0, 0.0, 0.45])
    assert [event.action for event in events(scene(objects=(lid,), hands=(visit(centre),)))] == ["pick", "put"]


def test_moving_and_turning_the_world_changes_neither_times_nor_hands() -> None:
    turn, shift = Rotation.from_euler("y", 70, degrees=True), np.array([3.0, 0.2, -5.0])
    for one, other in zip(events(scene()), events(elsewhere(scene(), turn, shift)), strict=True):
        assert other.event_time == pytest.approx(one.event_time, abs=1e-6)
        assert other.hand == one.hand
        np.testing.assert_allclose(other.place.location, turn.apply(one.place.location) + shift, atol=1e-6)


def test_annotated_events_are_taken_as_they_are_and_repetitions_are_reported() -> None:
    listed = AnnotatedEvent("a1", "pick", "cup_1", "cup", 12.5, PLACE_A, None, None, "right")
    nowhere = dataclasses.replace(listed, native_key="a2", action="put", event_time=13.5, location=None)
    again = dataclasses.replace(listed, native_key="a3")
    found, remarks = find_events(scene(annotated_events=(listed, nowhere, again)), RULE)
    assert [event.event_id for event in found] == [
        "adt/kitchen_1/cup_1/pick/12500000",
        "adt/kitchen_1/cup_1/put/13500000",
    ]
    assert found[1].rejected.outcome == "no_location"
    assert "listed twice" in remarks[0]
    np.testing.assert_array_equal(found[0].place.box_min, PLACE_A)


def test_two_annotated_events_of_one_id_are_refused() -> None:
    listed = AnnotatedEvent("a1", "pick", "cup_1", "cup", 12.5, PLACE_A, None, None, "right")
    with pytest.raises(RecordingUnusable, match=r"events: expected different ids, found 'a1 \(pick\)' twice"):
        scene(annotated_events=(listed, dataclasses.replace(listed, event_time=13.5)))


def test_events_do_not_depend_on_the_order_of_objects_or_on_other_objects() -> None:
    other = track(SLOW, np.tile([0.0, 1.0, 2.0], (len(SLOW), 1)), object_id="9", name="jar")
    plain = scene()
    mixed = dataclasses.replace(plain, objects=(other, *plain.objects[::-1]))
    assert [event.event_id for event in events(mixed)] == [event.event_id for event in events(plain)]
