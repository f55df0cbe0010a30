"""From a recording to sequences: grid, canonical frame, filters, audit trail, and the boxes around the person."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.curation import CurationOptions, curate_recording
from prbench.curation.curate import CuratedRecording, scene_boxes
from prbench.errors import UsageError
from prbench.geometry.skeleton import Joint, transform_points
from prbench.recording import BodyStream, ObjectTrack, Recording, UnreadableEntry
from prbench.sequences.sequence import sequence_batch
from tests.curation.scenes import (
    DURATION,
    LOOK_A,
    LOOK_B,
    MANIFEST,
    PLACE_A,
    PROTOCOL,
    UPRIGHT,
    body,
    clock,
    elsewhere,
    gaze,
    scene,
)

SLOW, FAST = clock(30), clock(120)


def curate(recording: Recording, **options: str) -> CuratedRecording:
    return curate_recording(recording, MANIFEST, PROTOCOL, CurationOptions(**options))  # type: ignore[arg-type]


def outcomes(result: CuratedRecording) -> list[str]:
    return [event.outcome for event in result.events]


def test_pick_and_put_become_two_sequences() -> None:
    result = curate(scene())
    assert outcomes(result) == ["sequence", "sequence"]
    assert [row.sequence_id for row in result.sequences] == [event.sequence_id for event in result.events]
    assert [row.prime_time for row in result.sequences] == [pytest.approx(LOOK_A), pytest.approx(LOOK_B)]
    assert [row.text for row in result.sequences] == [PROTOCOL.text["pick"], PROTOCOL.text["put"]]
    assert result.record.outcomes == {"sequence": 2}
    assert sequence_batch(result.sequences).num_rows == 2


def test_an_entry_that_cannot_be_read_is_in_the_audit_trail_beside_the_events() -> None:
    odd = UnreadableEntry("mask_info.json", "m1", "a mask", "`null` instead of `object`")
    result = curate(dataclasses.replace(scene(), unreadable=(odd,)))
    assert sorted(outcomes(result)) == ["sequence", "sequence", "unreadable_entry"]
    (row,) = (event for event in result.events if event.outcome == "unreadable_entry")
    assert row.unreadable == "mask_info.json, m1: expected a mask, found `null` instead of `object`"
    assert result.record.outcomes["unreadable_entry"] == 1
    assert "cannot be read and are left out: 1: mask_info.json, m1" in result.record.message


def test_the_grid_ends_at_the_event_and_covers_the_lead() -> None:
    for row in curate(scene()).sequences:
        assert row.n_frames == int(np.floor((row.event_time - row.prime_time + 2.0) * 20 + 1e-6)) + 1
        assert row.start_time + (row.n_frames - 1) / 20 == pytest.approx(row.event_time)
        assert row.preroll == pytest.approx(row.prime_time - row.start_time)
        assert 1.95 < row.preroll <= 2.0 + 1e-9
        assert row.prime_frame == round(row.preroll * 20)
        assert row.joints.shape == (row.n_frames, 22, 3)


def test_the_first_frame_stands_over_the_origin_facing_z_and_the_floor_is_at_zero() -> None:
    row = curate(scene()).sequences[0]
    np.testing.assert_allclose(row.joints[0, Joint.PELVIS, [0, 2]], 0, atol=1e-12)
    assert row.joints[..., 1].min() == pytest.approx(0)
    across = row.joints[0, Joint.LEFT_HIP] - row.joints[0, Joint.RIGHT_HIP]
    assert across[0] > 0
    assert across[2] == pytest.approx(0, abs=1e-12)


def test_everything_canonical_leads_back_to_the_world() -> None:
    recording = scene()
    row = curate(recording).sequences[0]
    goal = transform_points(row.world_from_canonical, row.goal_location)
    np.testing.assert_allclose(goal, PLACE_A, atol=1e-9)
    np.testing.assert_allclose((row.goal_box_world_min + row.goal_box_world_max) / 2, goal, atol=1e-9)
    last = np.array([np.interp(row.event_time, recording.body.times, axis) for axis in recording.body.joints[:, 0].T])
    np.testing.assert_allclose(transform_points(row.world_from_canonical, row.joints[-1, 0]), last, atol=1e-9)
    # At the prime frame gaze points at the goal.
    frame = int(np.ceil(row.preroll * 20))
    to_goal = row.goal_location - row.gaze_origin[frame]
    assert row.gaze_direction[frame] @ to_goal / np.linalg.norm(to_goal) == pytest.approx(1.0)


def test_moving_and_turning_the_world_leaves_everything_canonical_alone() -> None:
    plain = scene()
    moved = elsewhere(plain, Rotation.from_euler("y", 70, degrees=True), np.array([10.0, 0.0, -4.0]))
    for one, other in zip(curate(plain).sequences, curate(moved).sequences, strict=True):
        for name in ("joints", "goal_location", "gaze_origin", "gaze_direction", "head_position"):
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), atol=1e-5, err_msg=name)
        np.testing.assert_allclose(np.abs((one.head_rotation * other.head_rotation).sum(axis=1)), 1.0)
        assert other.prime_time == one.prime_time


def test_frames_around_the_clip_are_recorded_where_the_recording_has_them() -> None:
    row = curate(scene()).sequences[0]
    assert (row.previous_source, row.next_source) == ("recorded", "recorded")
    step = row.joints[0, 0] - row.previous_joints[0]
    assert np.linalg.norm(step[[0, 2]]) == pytest.approx(0.02 / 20, rel=0.15)


def test_a_body_that_starts_with_the_clip_has_its_previous_frame_extrapolated() -> None:
    start = curate(scene()).sequences[0].start_time
    late = FAST[start - 0.02 < FAST]
    row = curate(scene(body=body(late))).sequences[0]
    assert row.previous_source == "extrapolated"
    np.testing.assert_allclose(row.previous_joints, 2 * row.joints[0] - row.joints[1])


def test_a_look_that_comes_too_early_in_the_recording_is_too_short() -> None:
    early = scene(span=(LOOK_A - 1.5, DURATION))
    event = curate(early).events[0]
    assert (event.outcome, event.stage) == ("too_short", "clipping")
    assert event.value is not None
    assert event.threshold - event.value == pytest.approx(0.5, abs=0.05)
    assert event.prime_time == pytest.approx(LOOK_A)


def test_a_gap_in_the_body_is_too_short_and_a_small_one_is_bridged() -> None:
    for gap, outcome in ((0.08, "sequence"), (0.3, "too_short")):
        stream = body(FAST)
        valid = np.abs(FAST - 12.0) > gap / 2
        event = curate(scene(body=dataclasses.replace(stream, valid=valid))).events[0]
        assert event.outcome == outcome
    assert (event.stage, event.threshold) == ("body", 0.1)
    assert event.value == pytest.approx(0.3, abs=0.02)


def test_a_body_that_begins_after_the_sequence_should_is_told_as_missing_time_and_not_as_a_gap() -> None:
    start = curate(scene()).sequences[0].start_time
    event = curate(scene(body=body(FAST[start + 0.02 < FAST]))).events[0]
    assert (event.outcome, event.stage) == ("too_short", "clipping")
    assert event.value is not None
    assert event.threshold - event.value == pytest.approx(0.02, abs=1 / 120), "less than the gap that is bridged"


def test_without_a_body_events_are_kept_as_no_body() -> None:
    assert outcomes(curate(scene(body=None))) == ["no_body", "no_body"]


def test_without_hands_there_are_no_events_and_the_recording_says_why() -> None:
    result = curate(scene(body=None, hands=()))
    assert result.events == ()
    assert "no_body" in result.record.message
    assert "no events can be found" in result.record.message


def test_never_looking_there_is_not_primed() -> None:
    result = curate(scene(gaze=gaze(SLOW, [])))
    assert outcomes(result) == ["not_primed", "not_primed"]
    assert result.sequences == ()


def test_a_wrist_beside_the_goal_from_the_start_is_minimum_movement() -> None:
    stream = body(FAST)
    joints = stream.joints.copy()
    joints[:, Joint.RIGHT_WRIST] = PLACE_A - [0, 0, 0.15]
    event = curate(scene(body=BodyStream(FAST, joints, stream.valid))).events[0]
    assert (event.outcome, event.stage, event.threshold) == ("minimum_movement", "filters", 0.2)
    assert event.value == pytest.approx(0.15, abs=1e-6)


def test_other_measures_of_minimum_movement() -> None:
    assert outcomes(curate(scene(), minimum_movement="pelvis_displacement")) == ["minimum_movement"] * 2
    assert outcomes(curate(scene(), minimum_movement="object_displacement")) == ["sequence"] * 2
    with pytest.raises(UsageError, match="wrist_to_goal"):
        CurationOptions(minimum_movement="elbow")  # type: ignore[arg-type]


def test_gaze_is_invalid_in_a_blink_and_valid_across_one_lost_sample() -> None:
    stream = scene().gaze
    row = curate(scene()).sequences[0]
    for lost, invalid in ((0.02, False), (0.1, True)):
        kept = np.abs(SLOW - 13.0) > lost
        blinked = curate(scene(gaze=dataclasses.replace(stream, valid=kept))).sequences[0]
        frame = round((13.0 - row.start_time) * 20)
        assert bool(~blinked.gaze_valid[frame]) is invalid
        assert blinked.gaze_valid[frame - 6]
        np.testing.assert_allclose(np.linalg.norm(blinked.gaze_direction, axis=1), 1)


def test_body_and_hand_movement_by_hand() -> None:
    stream = body(FAST)
    joints = np.repeat(stream.joints[:1], len(FAST), axis=0)
    joints[:, :] += np.clip((FAST - 12.0), 0, 1)[:, None, None] * np.array([0.3, 0.0, 0.4])
    joints[:, Joint.LEFT_WRIST] += np.clip((FAST - 13.0), 0, 0.5)[:, None] * np.array([0.0, 0.4, 0.0])
    row = curate(scene(body=BodyStream(FAST, joints, stream.valid))).sequences[0]
    assert row.hand == "left"
    assert row.body_movement == pytest.approx(0.5, abs=1e-6)
    assert row.hand_movement == pytest.approx(0.2, abs=1e-6)


def test_a_synthetic_tree_brings_its_own_split() -> None:
    result = curate_recording(scene(), MANIFEST, PROTOCOL, split="test")
    assert {row.split for row in result.sequences} == {"test"}
    assert result.record.split == "test"


def piece(object_id: str, centre, half, **changes) -> ObjectTrack:
    """Something that stands in its place."""
    still = ObjectTrack(
        object_id, f"piece {object_id}", "table", np.zeros(1), np.array([centre], dtype=float), UPRIGHT[None],
        np.ones(1, dtype=bool), -np.array(half, dtype=float), np.array(half, dtype=float), False,
    )  # fmt: skip
    return dataclasses.replace(still, **changes)


def test_only_what_stands_still_is_kept():
    recording = scene()
    moving = piece(
        "13",
        (0, 0, 5),
        (1, 1, 1),
        times=np.array([0.0, 9.0]),
        position=np.array([[0, 0, 5.0], [0, 0, 6.0]]),
        rotation=np.repeat(UPRIGHT[None], 2, axis=0),
        valid=np.ones(2, dtype=bool),
    )
    others = (
        piece("12", (0, 0.4, 3), (0.5, 0.4, 0.3)),
        moving,
        piece("14", (0, 1, 5), (1, 0, 1)),
        piece("15", (2, 1, 5), (1, 1, 0.02)),
    )
    recording = dataclasses.replace(recording, objects=(*recording.objects, *others), hinged_objects=frozenset({"15"}))
    assert [box.object_id for box in scene_boxes(recording)] == ["12"], "cup, mover, flat box and door are left out"


def test_a_box_tells_how_deep_the_person_came_into_it():
    recording = scene()
    pelvis = recording.body.joints[0, Joint.PELVIS]
    around = piece("12", pelvis, (0.08, 0.08, 0.08))
    apart = piece("13", pelvis + np.array([0.0, 0.0, 9.0]), (0.5, 0.5, 0.5))
    boxes = scene_boxes(dataclasses.replace(recording, furniture=(around, apart)))
    assert [box.entered for box in boxes] == [pytest.approx(0.08), 0.0]
    bodiless = dataclasses.replace(recording, body=None, furniture=(around,))
    assert scene_boxes(bodiless)[0].entered is None


def test_a_box_beside_its_own_origin_gets_its_middle():
    chest = piece("12", (1.0, 0.0, 2.0), (0.4, 0.3, 0.2), box_min=np.array([-0.4, 0.0, -0.2]))
    box = scene_boxes(dataclasses.replace(scene(), furniture=(chest,)))[0]
    assert box.centre == pytest.approx([1.0, 0.15, 2.0])
    assert box.half_extents == pytest.approx([0.4, 0.15, 0.2])
