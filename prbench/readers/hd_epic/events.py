"""Movements of objects in an HD-EPIC video → its pick and put events.

Sources: docs/specification/hd-epic.md#annotations and docs/specification/hd-epic.md#events-and-priming.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.geometry.axes import Y_UP_FROM_Z_UP
from prbench.geometry.skeleton import transform_points
from prbench.readers.aria_mps.to_recording import MpsStreams
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.priming import MaskedEvent, published_priming
from prbench.recording.reaching_hand import reaching_hand, wrists_at
from prbench.recording.streams import AnnotatedEvent, BodyStream, PublishedPriming

BoxKind = Literal["point", "cube"]

_NO_MASK = "no mask"
_FAR_MASK = "mask too far"
_NO_POINT = "no point"
_OUTSIDE = "outside"
_WHY_UNPLACED = {
    _NO_MASK: "have no mask",
    _FAR_MASK: "have a mask that is too many frames away",
    _NO_POINT: "have a mask without 3d_location",
    _OUTSIDE: "lie beyond the rows of the time file",
}


@dataclass(frozen=True)
class _Side:
    """Start or end of one movement."""

    track: hd_epic.ObjectTrack
    is_start: bool
    frame: float
    """Frame of the annotated time, not on the grid."""
    mask: hd_epic.ObjectMask | None
    unplaced: str
    """Reason why it has no place; empty if it has one."""


def annotated_events(
    readings: hd_epic.HdEpicReadings,
    streams: MpsStreams,
    body: BodyStream | None,
    thresholds: hd_epic.Thresholds,
    *,
    boxes: BoxKind,
) -> tuple[tuple[AnnotatedEvent, ...], tuple[str, ...]]:
    """Pick (lift) and put (release) of every movement, in the order of time, and remarks.

    Args:
        readings: Tracks with masks, the video's clock, and the published priming.
        streams: Of the same video, in the recording's world.
        body: Of the same video: its wrists tell the hand where tracked ones do not.
        thresholds: Of the dataset.
        boxes: Zero-size boxes at the annotated points, or cubes as large as the 2D boxes say.
    """
    sides = [side for track in readings.tracks for side in _sides(track, readings.clock, thresholds)]
    times = readings.clock.device_seconds(np.array([side.frame for side in sides], dtype=np.float64))
    published, remarks = _published(readings, sides, thresholds)
    events = [
        _event(side, float(time), priming, readings, streams, body, boxes)
        for side, time, priming in zip(sides, times, published, strict=True)
    ]
    events.sort(key=lambda event: (event.event_time, event.native_key))
    return tuple(events), (*_unplaced_remarks(sides), _box_remark(boxes), *remarks)


def masks_of_sides(
    track: hd_epic.ObjectTrack,
) -> tuple[hd_epic.ObjectMask | None, hd_epic.ObjectMask | None]:
    """The masks that show a movement's start and its end, by nearest frame and whatever their order in the list.

    A single mask serves the nearer side. Of two or more, each side gets one of its own, with the least total distance.
    How far a mask may lie is decided elsewhere.
    """
    start = track.start * hd_epic.FPS
    end = track.end * hd_epic.FPS
    if not track.masks:
        return None, None
    if len(track.masks) == 1:
        mask = track.masks[0]
        return (mask, None) if abs(mask.frame - start) <= abs(mask.frame - end) else (None, mask)
    # By pairs, since the mask nearest to the start may be nearest to the end, too.
    return min(
        itertools.permutations(track.masks, 2),
        key=lambda pair: (abs(pair[0].frame - start) + abs(pair[1].frame - end), pair[0].frame),
    )


def _sides(track: hd_epic.ObjectTrack, clock: hd_epic.VideoClock, thresholds: hd_epic.Thresholds) -> list[_Side]:
    frames = np.array([track.start, track.end]) * hd_epic.FPS
    inside = clock.covers(frames)
    return [
        _placed(_Side(track, is_start, float(frame), mask, ""), bool(known), clock, thresholds)
        for is_start, frame, mask, known in zip((True, False), frames, masks_of_sides(track), inside, strict=True)
    ]


def _placed(side: _Side, inside: bool, clock: hd_epic.VideoClock, thresholds: hd_epic.Thresholds) -> _Side:
    """The side without a mask that does not show it, and with the reason."""
    mask = side.mask
    if not inside or (mask is not None and mask.frame >= len(clock.device_ns)):
        return dataclasses.replace(side, mask=None, unplaced=_OUTSIDE)
    if mask is None:
        return dataclasses.replace(side, unplaced=_NO_MASK)
    if abs(mask.frame - side.frame) > thresholds.farthest_mask_frames:
        return dataclasses.replace(side, mask=None, unplaced=_FAR_MASK)
    return dataclasses.replace(side, unplaced="" if mask.location is not None else _NO_POINT)


def _published(
    readings: hd_epic.HdEpicReadings, sides: Sequence[_Side], thresholds: hd_epic.Thresholds
) -> tuple[list[PublishedPriming | None], tuple[str, ...]]:
    if readings.priming is None:
        return [None] * len(sides), ()
    masked = [
        MaskedEvent(side.is_start, side.frame, side.mask.frame, side.mask.location)
        if side.mask is not None and side.mask.location is not None
        else None
        for side in sides
    ]
    return published_priming(masked, readings.priming, readings.clock, thresholds)


def _event(
    side: _Side,
    time: float,
    priming: PublishedPriming | None,
    readings: hd_epic.HdEpicReadings,
    streams: MpsStreams,
    body: BodyStream | None,
    boxes: BoxKind,
) -> AnnotatedEvent:
    location = None
    if side.mask is not None and side.mask.location is not None:
        location = transform_points(Y_UP_FROM_Z_UP, side.mask.location)
    edge = None if location is None or boxes == "point" else _cube_edge(side, location, readings, streams)
    half = None if edge is None else np.full(3, edge / 2)
    hand = None if location is None else reaching_hand(wrists_at(streams.wrists, body, time), location)
    return AnnotatedEvent(
        native_key=f"{side.track.object_id}/{side.track.track_id}/{'start' if side.is_start else 'end'}",
        action="pick" if side.is_start else "put",
        object_id=side.track.object_id,
        object_name=side.track.name,
        event_time=time,
        location=location,
        box_min=None if location is None or half is None else location - half,
        box_max=None if location is None or half is None else location + half,
        hand=None if hand is None else hand.side,
        hand_source=None if hand is None else hand.source,
        published_priming=priming,
    )


def _cube_edge(
    side: _Side, location: Float[np.ndarray, "3"], readings: hd_epic.HdEpicReadings, streams: MpsStreams
) -> float | None:
    """Mean side of the 2D box × distance from the camera / focal length; None without a box or a camera pose."""
    camera = streams.camera
    if side.mask is None or side.mask.box_px is None or not camera.valid.any():
        return None
    time = readings.clock.device_seconds(np.array([side.mask.frame], dtype=np.float64))
    eye = camera.pose_at(time)[0][0]
    low_x, low_y, high_x, high_y = side.mask.box_px
    mean_side = (abs(high_x - low_x) + abs(high_y - low_y)) / 2
    focal = hd_epic.FOCAL_LENGTH
    if isinstance(readings.glasses, hd_epic.FrameReadings) and readings.glasses.rgb_focal_length is not None:
        focal = readings.glasses.rgb_focal_length
    # Pinhole camera: metres = pixels * distance / focal length.
    return float(mean_side * np.linalg.norm(location - eye) / focal)


def _unplaced_remarks(sides: Sequence[_Side]) -> tuple[str, ...]:
    counts = Counter(side.unplaced for side in sides if side.unplaced)
    if not counts:
        return ()
    reasons = ", ".join(f"{counts[why]} {text}" for why, text in _WHY_UNPLACED.items() if counts[why])
    return (f"{counts.total()} of {len(sides)} events have no place: {reasons}",)


def _box_remark(boxes: BoxKind) -> str:
    if boxes == "point":
        return "boxes: zero-size, at the annotated points"
    return "boxes: cubes as large as the 2D boxes say at the distance of the point"
