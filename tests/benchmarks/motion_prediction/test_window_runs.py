from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.recording.streams import BodyStream, GazeStream, PoseStream, PublishedTrack, Recording
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.windows import latest_gaze, runs_of_recording, runs_of_tracks, window_starts
from tests.fakes import STANDING

RULES = load_prediction_protocol().windows


def recording(rate: float, seconds: float, *, gaze_rate: float = 10.0, lost: tuple[float, float] = (9e9, 9e9)):
    """A person who glides along +X at 1 m/s and whose gaze turns; the body is lost for a while."""
    times = np.arange(round(seconds * rate) + 1) / rate
    joints = STANDING + np.stack([times, 0 * times, 0 * times], axis=1)[:, None]
    looks = np.arange(round(seconds * gaze_rate) + 1) / gaze_rate
    direction = np.stack([np.sin(looks), 0 * looks, np.cos(looks)], axis=1)
    head = PoseStream(times, joints[:, 15], np.tile([1.0, 0, 0, 0], (len(times), 1)), np.ones(len(times), bool))
    return Recording(
        dataset="adt",
        recording_id="r",
        participant_id="p",
        pose_source="adt-optitrack",
        head_tilt_deg=0.0,
        span=(0.0, seconds),
        gaze=GazeStream(looks, np.zeros((len(looks), 3)), direction, np.ones(len(looks), bool)),
        camera=head,
        head=head,
        body=BodyStream(times, joints, (times < lost[0]) | (times > lost[1])),
        hands=(),
        objects=(),
    )


@pytest.mark.parametrize(("n", "windows"), [(0, 0), (75, 0), (76, 1), (90, 1), (91, 2), (300, 15)])
def test_the_number_of_windows_is_the_published_one(n, windows):
    assert len(window_starts(n, RULES)) == windows


@pytest.mark.parametrize("rate", [30.0, 120.0, 240.0, 29.97, 30.3])
def test_bodies_of_any_rate_come_to_thirty_frames_a_second(rate):
    (cut,) = runs_of_recording(recording(rate, 4.0), RULES, split="test")
    assert len(cut) == (120 if rate == 30.3 else 121)  # 4 s hold no whole number of 1/30.3 s
    np.testing.assert_allclose(np.diff(cut.joints[:, 0, 0]), 1 / 30, atol=0.5 / rate + 1e-9)
    assert {window.exclusion for window in cut.windows} == {""}


def test_a_multiple_of_the_rate_is_sampled_not_averaged():
    (cut,) = runs_of_recording(recording(120.0, 4.0), RULES, split="test")
    np.testing.assert_array_equal(cut.joints[7], STANDING + np.array([28 / 120, 0.0, 0.0]))


def test_a_long_gap_of_the_body_cuts_and_a_short_one_is_filled():
    runs = list(runs_of_recording(recording(30.0, 12.0, lost=(5.99, 6.21)), RULES, split="test"))
    assert [len(cut) for cut in runs] == [180, 174]
    (cut,) = runs_of_recording(recording(30.0, 12.0, lost=(5.99, 6.05)), RULES, split="test")
    assert len(cut) == 361
    np.testing.assert_allclose(np.diff(cut.joints[:, 0, 0]), 1 / 30, atol=1e-9)


def test_no_window_ends_its_observation_inside_a_gap():
    # Frame 14 is the last observed one of the first window.
    (cut,) = runs_of_recording(recording(30.0, 5.0, lost=(0.46, 0.47)), RULES, split="test")
    assert [window.exclusion for window in cut.windows] == ["gap_at_border", "", "", "", "", ""]


def test_a_stretch_as_long_as_a_window_gives_none():
    assert list(runs_of_recording(recording(30.0, 74 / 30), RULES, split="test")) == []


def test_gaze_is_never_later_than_its_frame_and_at_most_0_12_s_old():
    times = np.array([0.0, 0.1, 0.3])
    directions = np.eye(3)
    frames = np.array([-0.01, 0.0, 0.05, 0.0999, 0.1, 0.2199, 0.2201, 0.31])
    held, valid = latest_gaze(times, directions, np.ones(3, bool), frames, oldest=0.12)
    assert held.argmax(axis=1).tolist() == [2, 0, 0, 0, 1, 1, 1, 2]
    assert valid.tolist() == [False, True, True, True, True, True, False, True]


def test_a_recording_without_body_gives_nothing():
    assert list(runs_of_recording(replace(recording(30.0, 4.0), body=None), RULES, split="test")) == []


def test_a_published_segment_stays_whole_and_says_which_windows_are_not_scored():
    source = recording(30.0, 4.0)
    assert source.body is not None
    n = len(source.body.times)
    valid = np.ones(n, bool)
    valid[100] = False
    track = PublishedTrack(
        name="pick_001",
        published_split="",
        times=source.body.times,
        joints=source.body.joints[:, :21],
        valid=valid,
        filled=np.zeros(n, bool),
        body=source.body.joints,
        gaze=np.tile([0.0, 0.0, 1.0], (n, 1)),
        gaze_measured=np.arange(n) % 5 == 0,
    )
    (cut,) = runs_of_tracks(source, (track,), RULES, split="train", published_split="test")
    assert (cut.run_id, cut.published_split, len(cut)) == ("r/pick_001", "test", n)
    assert [window.exclusion for window in cut.windows] == ["", "", "invalid_body", "invalid_body"]
    assert [window.n_gaze_valid for window in cut.windows] == [12] * 4  # of five frames the fifth is older than 0.12 s
