"""Movements → events: masks by nearest frame, places, hands, published priming.

Sources: docs/specification/hd-epic.md#annotations and docs/specification/hd-epic.md#events-and-priming.
"""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import StreamsDoNotOverlap
from prbench.geometry.skeleton import N_JOINTS, WRISTS
from prbench.protocol.manifests import load_manifest
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.format import ObjectMask, ObjectTrack, PublishedSide
from prbench.readers.hd_epic.to_recording import (
    MovementSide,
    annotated_events,
    masks_of_sides,
    published_priming,
    recording_from_hd_epic,
)
from prbench.recording import BodyStream, HandStream
from tests.readers.hd_epic_copies import GLASSES_START_NS, still_glasses

THRESHOLDS = load_manifest("hd-epic").thresholds
GLASSES = still_glasses()
CLOCK = hd_epic.VideoClock(50_000_000_000 + np.rint(np.arange(600) * 1e9 / 30).astype(np.int64))  # 20 s from 50 s on


def mask(frame: int, place: tuple[float, float, float] | None = (1.0, 2.0, 3.0), name: str = "") -> ObjectMask:
    location = None if place is None else np.array(place)
    return ObjectMask(name or f"m{frame}", frame, location, np.array([600.0, 600.0, 700.0, 680.0]), None)


def track(start: float, end: float, *masks: ObjectMask, key: str = "cup", name: str = "t") -> ObjectTrack:
    return ObjectTrack(name, key, key, start, end, masks)


def located(frame: float, mask_frame: int, place: np.ndarray) -> MovementSide:
    shown = mask(mask_frame, tuple(place))
    return MovementSide(track(frame / 30, frame / 30 + 1, shown), True, frame, shown, "")


@pytest.mark.parametrize(
    ("start", "end", "frames", "served"),
    [
        (7.0, 9.4, (282, 210), (210, 282)),  # by frame, not by the order in the file
        (1.0, 5.0, (40,), (40, None)),  # a single mask serves the nearer side
        (1.0, 5.0, (140,), (None, 140)),
        (1.0, 5.0, (90, 149, 31, 60), (31, 149)),
        (1.0, 1.04, (32, 30), (30, 32)),  # both sides of a short movement have a mask of their own
        (1.0, 2.0, (), (None, None)),
    ],
)
def test_each_side_of_a_movement_has_the_mask_nearest_to_it(start, end, frames, served) -> None:
    masks = masks_of_sides(track(start, end, *map(mask, frames)))
    assert tuple(each and each.frame for each in masks) == served


def _readings(*tracks: ObjectTrack, priming=None, clock=CLOCK) -> hd_epic.HdEpicReadings:
    return hd_epic.HdEpicReadings("P09-x", "P09", clock, tracks, priming, GLASSES, None)


def _events(*tracks: ObjectTrack, wrists=(), body=None, **readings):
    return annotated_events(_readings(*tracks, **readings), wrists, body, THRESHOLDS)


def test_pick_is_the_start_and_put_the_end_on_the_device_clock() -> None:
    (pick, put), _ = _events(track(2.01, 4.5, mask(60), mask(135, (4.0, 5.0, 6.0))))
    assert (pick.action, put.action) == ("pick", "put")
    assert (pick.event_time, put.event_time) == pytest.approx((52.01, 54.5), abs=1e-8)
    assert pick.location == pytest.approx([1.0, 3.0, -2.0])
    assert put.location == pytest.approx([4.0, 6.0, -5.0]), "the future resting place"
    assert pick.box_min is None, "a point"
    assert (pick.native_key, put.native_key) == ("cup/t/start", "cup/t/end")


def test_events_are_sorted_and_overlapping_movements_of_one_object_stay_apart() -> None:
    events, _ = _events(track(8.8, 9.2, name="late"), track(3.0, 5.0, name="one"), track(4.0, 6.0, name="two"))
    keys = [event.native_key for event in events]
    assert keys == ["cup/one/start", "cup/two/start", "cup/one/end", "cup/two/end", "cup/late/start", "cup/late/end"]


def test_why_an_event_has_no_place_is_counted() -> None:
    short = hd_epic.VideoClock(CLOCK.device_ns[:300])
    events, remarks = _events(
        track(1.0, 2.0, mask(30), mask(60)),  # both placed
        track(3.0, 4.0, mask(90), mask(151)),  # 31 frames after the put
        track(5.0, 6.0, mask(150, None), mask(180)),  # no point at the pick
        track(7.0, 8.0),  # no mask
        track(9.0, 11.0, mask(270), mask(330)),  # the put lies beyond the rows
        track(9.5, 9.9, mask(285), mask(303)),  # the put lies within, its mask beyond
        clock=short,
    )
    assert len(events) == 12
    assert sum(event.location is not None for event in events) == 6
    assert remarks[0] == (
        "6 of 12 events have no place: 2 have no mask, 1 have a mask that is too many frames away,"
        " 1 have a mask without 3d_location, 2 lie beyond the rows of the time file"
    )


def test_a_mask_of_thirty_frames_away_still_shows_the_event() -> None:
    (_, put), _ = _events(track(3.0, 4.0, mask(90), mask(150)))
    assert put.location is not None


def _wrist(side: str, place) -> HandStream:
    times = 50 + np.arange(0, 20, 0.1)
    points = np.tile(np.array(place, dtype=np.float64), (len(times), 1, 1))
    return HandStream(side, "wrist", times, points, np.ones(len(times), dtype=bool))  # type: ignore[arg-type]


def _body(left, right) -> BodyStream:
    times = 50 + np.arange(0, 20, 0.033)
    joints = np.zeros((len(times), N_JOINTS, 3))
    joints[:, WRISTS] = [left, right]
    return BodyStream(times, joints, np.ones(len(times), dtype=bool))


def test_the_hand_that_the_glasses_lost_is_told_by_the_body() -> None:
    """The issue's event: the left wrist, 0.476 m away, was tracked, and the right one, 0.094 m away, was not."""
    only_left = (_wrist("left", (1.0, 3.0, -1.524)),)
    body = _body((1.0, 3.0, -1.524), (1.0, 3.0, -1.906))
    (pick, _), _ = _events(track(2.0, 4.5, mask(60), mask(135)), wrists=only_left, body=body)
    assert (pick.hand, pick.hand_source) == ("right", "body")


def test_a_far_wrist_alone_tells_no_hand() -> None:
    only_left = (_wrist("left", (1.0, 3.0, -1.524)),)
    (pick, _), _ = _events(track(2.0, 4.5, mask(60), mask(135)), wrists=only_left)
    assert (pick.hand, pick.hand_source) == (None, None)


def side(frame: int, place, primed: int, *, is_start=True, key="0/start") -> PublishedSide:
    return PublishedSide(key, is_start, frame, np.array(place), primed)


HERE = (1.0, 2.0, 3.0)


def _match(entries, events=None):
    events = [located(210.3, 212, np.array(HERE))] if events is None else events
    return published_priming(events, entries, CLOCK, THRESHOLDS)


@pytest.mark.parametrize(
    ("frame", "place", "is_start", "found"),
    [
        (212, HERE, True, True),  # the mask's frame
        (210, HERE, True, True),  # the annotated one, rounded
        (214, HERE, True, False),  # two frames off
        (212, (1.0, 2.0, 3.0009), True, True),  # 0.9 mm
        (212, (1.0, 2.0, 3.0011), True, False),  # 1.1 mm
        (212, HERE, False, False),  # the other side of a movement
    ],
)
def test_an_entry_belongs_by_frame_place_and_side(frame, place, is_start, found) -> None:
    (priming,), remarks = _match([side(frame, place, 135, is_start=is_start)])
    assert (priming is not None) is found
    assert bool(remarks) is not found


def test_what_the_values_mean() -> None:
    entries = [side(100, (float(i), 0.0, 0.0), value) for i, value in enumerate((45, -1, -2))]
    events = [located(100.0, 100, np.array([float(i), 0.0, 0.0])) for i in range(3)]
    primings, _ = _match(entries, events)
    assert [p.outcome for p in primings if p] == ["primed", "not_primed", "excluded"]
    assert [p.prime_time for p in primings if p] == [pytest.approx(51.5), None, None]


def test_an_entry_serves_one_event_and_the_nearer_one() -> None:
    events = [located(210.9, 211, np.array(HERE)), located(210.0, 210, np.array(HERE))]
    primings, remarks = _match([side(210, HERE, 135)], events)
    assert [priming is not None for priming in primings] == [False, True]
    assert remarks == ("published priming: nothing about 1 of 2 located events",)
    _, remarks = _match([side(212, HERE, 135), side(500, HERE, 400)])
    assert remarks == ("published priming: 1 of 2 entries belong to no event",)
    assert _match([side(212, HERE, 5000)])[0] == [None], "a primed frame beyond the time file tells nothing"


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
