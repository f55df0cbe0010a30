"""MoGaze's segments as motion prediction uses them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.protocol.manifests import load_manifest
from prbench.readers.mogaze.format import LINKS, MogazeReadings, Segment
from prbench.readers.mogaze.to_recording import published_tracks, recording_from_mogaze
from prbench.recording.streams import PublishedTrack
from tests.recording.mogaze_scene import STANDING_HEIGHT, N, still_life


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
