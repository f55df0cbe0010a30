"""Streams of a video: where gaze counts, clocks that do not meet, and wrists."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import StreamsDoNotOverlap
from prbench.protocol.manifests import load_manifest
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.to_recording import recording_from_hd_epic
from tests.readers.hd_epic_copies import GLASSES_START_NS, still_glasses

MANIFEST = load_manifest("hd-epic")


def _recording(first_ns: int, n_frames: int = 30, *, confidence: float = 1.0):
    clock = hd_epic.VideoClock(first_ns + np.rint(np.arange(n_frames) * 1e9 / 30).astype(np.int64))
    readings = hd_epic.HdEpicReadings("P09-x", "P09", clock, (), None, still_glasses(confidence), None)
    return recording_from_hd_epic(readings, MANIFEST, dataset="hd-epic")


def test_gaze_outside_of_the_video_primes_nothing() -> None:
    gaze = _recording(GLASSES_START_NS + 10**9).gaze
    inside = (gaze.times >= 8.0) & (gaze.times <= 8 + 29 / 30 + 1 / 30)
    assert 0 < inside.sum() < len(inside)
    assert gaze.valid.tolist() == inside.tolist()


def test_clocks_that_do_not_meet_are_refused() -> None:
    with pytest.raises(StreamsDoNotOverlap, match="video"):
        _recording(GLASSES_START_NS // 1000)


@pytest.mark.parametrize(("confidence", "counts"), [(0.69, False), (0.71, True)])
def test_only_surely_tracked_wrists_count(confidence, counts) -> None:
    recording = _recording(GLASSES_START_NS, 90, confidence=confidence)
    left, right = recording.hands
    assert not left.valid.any()
    assert right.valid[1:-1].all() == counts
    assert any("general gaze" in message for message in recording.messages)
