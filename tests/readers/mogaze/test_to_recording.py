"""What MoGaze's numbers mean: frames, gaze validity, the floor, and segments as picks and puts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import Joint
from prbench.protocol.manifests import load_manifest
from prbench.readers.mogaze.format import LINKS, STATE_COLUMNS, MogazeReadings, Segment
from prbench.readers.mogaze.to_recording import published_tracks, recording_from_mogaze
from prbench.recording import PublishedTrack, Recording
from tests.recording.mogaze_scene import CUP, GOGGLES, PICK, PUT, STANDING_HEIGHT, N, still_life

CUP_TRACK = next(body for body in still_life().bodies if body.body_id == CUP).position


def _recording(readings: MogazeReadings, **options) -> Recording:
    return recording_from_mogaze(readings, load_manifest("mogaze"), dataset="mogaze", **options)


def _with_body(readings: MogazeReadings, key: int, **columns) -> MogazeReadings:
    bodies = tuple(replace(body, **columns) if body.body_id == key else body for body in readings.bodies)
    return replace(readings, bodies=bodies)


def _events(*segments: tuple[int, int, str], readings: MogazeReadings | None = None) -> Recording:
    return _recording(replace(readings or still_life(), segments=tuple(Segment(*entry) for entry in segments)))


def test_z_up_becomes_y_up_with_the_person_facing_forward() -> None:
    recording = _recording(still_life())
    assert recording.body is not None
    assert recording.body.valid.all()
    assert recording.body.joints[0, Joint.PELVIS] == pytest.approx([0.0, STANDING_HEIGHT + 0.0741, 0.0])
    assert recording.body.joints[0, Joint.LEFT_HIP, 0] == pytest.approx(0.0903)
    assert recording.head.position[0] == pytest.approx([0.0, 1.6, 0.1])
    assert recording.head.rotation[0] == pytest.approx([1.0, 0.0, 0.0, 0.0])
    assert recording.gaze.direction[0] == pytest.approx([0.0, 0.0, 1.0])
    assert recording.object(str(CUP)).position[0] == pytest.approx([0.0, 0.8, 0.5])
    assert recording.span == (0.0, (N - 1) / 120)
    assert recording.messages == ()
    point = recording.world_from_source @ (0.5, -0.5, 0.8, 1.0)
    assert point[:3] == pytest.approx(recording.object(str(CUP)).position[-1])


def test_a_box_is_world_aligned_after_turning_all_corners() -> None:
    turned = np.tile(Rotation.from_euler("x", 90, degrees=True).as_quat(), (N, 1))  # its z lies along the old y
    pick, _ = _recording(_with_body(still_life(), CUP, rotation=turned)).annotated_events
    assert pick.box_min is not None
    assert pick.box_max - pick.box_min == pytest.approx([0.08, 0.06, 0.10])


def test_the_goggles_are_no_object_and_furniture_does_not_move() -> None:
    tracks = {track.name: track for track in _recording(still_life()).objects}
    assert tracks.keys() == {"table", "plate_red", "cup_red"}
    assert [name for name, track in tracks.items() if not track.movable] == ["table"]
    assert tracks["plate_red"].category == "plate"


def test_pick_at_the_start_and_put_at_the_end_of_a_segment() -> None:
    pick, put = _recording(still_life()).annotated_events
    assert (pick.action, pick.event_time, pick.object_name) == ("pick", PICK / 120, "cup_red")
    assert (put.action, put.event_time, put.object_id) == ("put", PUT / 120, str(CUP))
    assert pick.location == pytest.approx([0.0, 0.8, 0.5])
    assert put.location == pytest.approx([0.5, 0.8, 0.5]), "where it will rest, not where it is"
    assert (pick.hand, put.hand) == (None, None), "the person stands still, half a metre away"


def test_the_body_tells_the_hand_of_an_object_that_it_holds() -> None:
    body = _recording(still_life()).body
    assert body is not None
    beside = np.linalg.inv(_recording(still_life()).world_from_source) @ [
        *(body.joints[0, Joint.RIGHT_WRIST] + (0.0, 0.0, 0.1)),
        1.0,
    ]
    held = _with_body(still_life(), CUP, position=np.tile(beside[:3], (N, 1)))
    for event in _recording(held).annotated_events:
        assert (event.hand, event.hand_source) == ("right", "body")


def test_a_put_takes_the_median_place_of_the_next_twelve_frames() -> None:
    readings, position = still_life(), CUP_TRACK.copy()
    position[PUT : PUT + 3, 2] += 0.02  # still settling at the end of the segment
    position[PUT + 13 :, 2] += 0.5  # and pushed away later
    _, put = _recording(_with_body(readings, CUP, position=position)).annotated_events
    assert put.location == pytest.approx([0.5, 0.8, 0.5])


def test_the_place_of_a_put_ends_where_the_next_movement_begins() -> None:
    readings, position = still_life(), CUP_TRACK.copy()
    position[PUT + 5 :] += (0.0, 0.0, 0.3)
    moved = _with_body(readings, CUP, position=position)
    segments = (0, PICK, "null"), (PICK, PUT, "cup_red"), (PUT, PUT + 4, "null"), (PUT + 4, PUT + 60, "cup_red")
    _, put, again, _ = _events(*segments, readings=moved).annotated_events
    assert put.location == pytest.approx([0.5, 0.8, 0.5])
    assert again.location == pytest.approx([0.5, 0.8, 0.5])


# Segments, the events that they stand for as (action, object, frame), and a part of the reader's messages.
SEGMENTS = {
    "one object after another": (
        [(0, 99, "null"), (100, 200, "cup_red"), (201, 300, "plate_red"), (301, 479, "null")],
        [("pick", "cup_red", 100), ("put", "cup_red", 200), ("pick", "plate_red", 201), ("put", "plate_red", 300)],
        "",
    ),
    "neighbours with one label": (
        [(0, 99, "null"), (99, 150, "null"), (150, 200, "cup_red"), (200, 240, "cup_red"), (240, 479, "null")],
        [("pick", "cup_red", 150), ("put", "cup_red", 240)],
        "2 segments with the label",
    ),
    "an unknown thing between two movements": (
        [(10, 50, "cup_red"), (50, 90, "spoon"), (90, 130, "cup_red")],
        [("pick", "cup_red", 10), ("put", "cup_red", 50), ("pick", "cup_red", 90), ("put", "cup_red", 130)],
        "no such object",
    ),
    "in hand at either end": (
        [(0, 100, "plate_red"), (100, 200, "null"), (200, N, "cup_red")],
        [("put", "plate_red", 100), ("pick", "cup_red", 200)],
        "is in hand when the recording begins: no pick",
    ),
    "no segments": ([], [], "no segments, so no events"),
}


@pytest.mark.parametrize("name", SEGMENTS)
def test_segments_become_events(name) -> None:
    segments, events, says = SEGMENTS[name]
    recording = _events(*segments)
    found = [(event.action, event.object_name, round(event.event_time * 120)) for event in recording.annotated_events]
    assert found == events
    assert says in " ".join(recording.remarks)


def test_bad_segments_are_left_out_with_a_word_each() -> None:
    bad = (-5, 20, "cup_red"), (50, 50, "cup_red"), (60, 90, "spoon"), (N + 5, N + 50, "cup_red")
    recording = _events(bad[3], *bad[:3], (PICK, PUT, "cup_red"))
    assert [event.action for event in recording.annotated_events] == ["pick", "put"]
    assert len(recording.unreadable) == 4
    assert any("spoon" in entry.key and "no such object" in entry.found for entry in recording.unreadable)
    assert any("sorted" in message for message in recording.messages)


def test_an_object_that_is_lost_around_its_events_is_placed_where_it_was_seen_at_rest() -> None:
    readings = still_life()
    cup = next(body for body in readings.bodies if body.body_id == CUP)
    position, rotation = cup.position.copy(), cup.rotation.copy()
    position[PICK - 20 : PICK + 30] = np.nan
    rotation[PUT - 30 : PUT + 40] = 0.0
    pick, put = _recording(_with_body(readings, CUP, position=position, rotation=rotation)).annotated_events
    assert pick.location == pytest.approx([0.0, 0.8, 0.5])
    assert put.location == pytest.approx([0.5, 0.8, 0.5])


def test_an_object_that_is_never_seen_has_no_events() -> None:
    recording = _recording(_with_body(still_life(), CUP, rotation=np.zeros((N, 4))))
    assert recording.annotated_events == ()
    assert any("never seen" in entry.found for entry in recording.unreadable)


def test_low_confidence_is_bridged_for_a_quarter_of_a_second() -> None:
    confidence = np.ones(N)
    confidence[200:260] = 0.59
    points = np.tile((0.0, 0.0, 1000.0), (N, 1))
    points[200:260] = (1000.0, 0.0, 10.0)
    gaze = _recording(replace(still_life(), gaze_confidence=confidence, gaze_points=points)).gaze
    assert np.flatnonzero(~gaze.valid).tolist() == list(range(230, 260)), "30 frames are held"
    assert gaze.direction[200:230] == pytest.approx(np.tile((0.0, 0.0, 1.0), (30, 1)))


def test_confidence_at_the_threshold_counts_and_nothing_is_held_before_the_first_look() -> None:
    confidence = np.full(N, 0.6)
    confidence[:50] = 0.0
    gaze = _recording(replace(still_life(), gaze_confidence=confidence)).gaze
    assert np.flatnonzero(~gaze.valid).tolist() == list(range(50))


@pytest.mark.parametrize("loss", [np.nan, 0.0], ids=["NaN", "zero quaternion"])
def test_lost_goggles_are_invalid_and_never_upright(loss) -> None:
    rotation = np.tile((0.0, 0.0, 0.0, 1.0), (N, 1))
    rotation[100:110] = loss
    recording = _recording(_with_body(still_life(), GOGGLES, rotation=rotation))
    for stream in (recording.gaze, recording.head, recording.camera):
        assert np.flatnonzero(~stream.valid).tolist() == list(range(100, 110))
    assert any("goggles" in message for message in recording.messages)


def test_a_body_frame_with_nan_is_invalid_and_filled() -> None:
    state = still_life().state
    state[100:110, 7] = np.nan
    recording = _recording(replace(still_life(), state=state))
    assert recording.body is not None
    assert np.flatnonzero(~recording.body.valid).tolist() == list(range(100, 110))
    assert not recording.head.valid[100:110].any(), "the head's orientation comes from the body"
    assert recording.gaze.valid.all(), "gaze does not"
    assert recording.gaze.origin[105] == pytest.approx([0.0, 1.6, 0.1])


def test_a_floor_elsewhere_is_moved_to_zero() -> None:
    readings = still_life()
    readings.state[:, STATE_COLUMNS.index("baseTransZ")] += 0.5
    bodies = tuple(replace(body, position=np.add(body.position, (0.0, 0.0, 0.5))) for body in readings.bodies)
    recording = _recording(replace(readings, bodies=bodies))
    assert recording.body is not None
    assert recording.body.joints[:, [Joint.LEFT_FOOT, Joint.RIGHT_FOOT], 1].min() == pytest.approx(0.0, abs=1e-9)
    assert recording.object(str(CUP)).position[0] == pytest.approx([0.0, 0.79, 0.5]), "everything moves together"
    assert recording.world_from_source[1, 3] == pytest.approx(-0.51)
    assert recording.messages == ("the lowest toes are at 0.51 m: the floor is moved there",)


def test_metres_give_the_same_gaze_and_a_word() -> None:
    points = np.tile((0.1, 0.2, 1.0), (N, 1))
    metres = _recording(replace(still_life(), gaze_points=points))
    millimetres = _recording(replace(still_life(), gaze_points=points * 1000))
    assert metres.gaze.direction == pytest.approx(millimetres.gaze.direction)
    assert any("metres" in message for message in metres.messages)


def test_moving_and_turning_the_world_moves_and_turns_the_events() -> None:
    readings, about = still_life(), Rotation.from_euler("z", 90, degrees=True)
    state = readings.state.copy()
    state[:, STATE_COLUMNS.index("baseRotZ")] += np.pi / 2
    state[:, 0] += 2.0
    bodies = tuple(
        replace(
            body,
            position=np.add(about.apply(body.position), (2.0, 0.0, 0.0)),
            rotation=(about * Rotation.from_quat(body.rotation)).as_quat(),
        )
        for body in readings.bodies
    )
    turned, plain = _recording(replace(readings, state=state, bodies=bodies)), _recording(readings)
    for one, other in zip(turned.annotated_events, plain.annotated_events, strict=True):
        assert one.location is not None
        assert other.location is not None
        x, y, z = other.location
        assert one.location == pytest.approx([z + 2.0, y, -x])
        assert one.hand == other.hand
    assert turned.gaze.direction[0] == pytest.approx([1.0, 0.0, 0.0])


def tracks(readings: MogazeReadings) -> tuple[PublishedTrack, ...]:
    recording = recording_from_mogaze(readings, load_manifest("mogaze"), dataset="mogaze")
    return published_tracks(readings, recording, least_confidence=0.6)


def test_rows_are_picks_and_places_at_every_fourth_frame():
    pick, place, last = tracks(still_life())
    assert [pick.name, place.name, last.name] == ["pick_001", "place_002", "pick_003"]
    np.testing.assert_allclose(pick.times, np.arange(0, 121, 4) / 120)
    assert place.times[0] == 1.0
    assert pick.joints.shape == (31, 21, 3)


def test_native_joints_stand_in_the_same_world_as_the_22():
    pick = tracks(still_life())[0]
    np.testing.assert_allclose(pick.joints[0, LINKS.index("base")], [0.0, STANDING_HEIGHT, 0.0], atol=1e-9)
    np.testing.assert_allclose(pick.joints[:, LINKS.index("lWrist")], pick.body[:, Joint.LEFT_WRIST], atol=1e-9)


def test_a_segment_is_cut_to_its_confident_gaze_and_holds_are_no_measurements():
    confidence = np.ones(N)
    confidence[:8] = 0.5
    confidence[40:48] = 0.5
    pick = tracks(replace(still_life(), gaze_confidence=confidence))[0]
    assert pick.times[0] == pytest.approx(8 / 120)
    assert np.flatnonzero(~pick.gaze_measured).tolist() == [8, 9]


def test_a_segment_with_little_confident_gaze_is_left_out():
    confidence = np.ones(N)
    confidence[:28] = 0.0  # 7 of 31
    assert [track.name for track in tracks(replace(still_life(), gaze_confidence=confidence))] == [
        "place_002",
        "pick_003",
    ]


def test_repeated_empty_and_reversed_rows_are_left_out():
    segments = (
        Segment(0, 120, "null"),
        Segment(120, 200, "null"),
        Segment(200, 200, "cup_red"),
        Segment(210, 240, "cup_red"),
    )
    found = tracks(replace(still_life(), segments=segments))
    assert [(track.name, len(track.times)) for track in found] == [("pick_001", 31), ("place_002", 8)]
