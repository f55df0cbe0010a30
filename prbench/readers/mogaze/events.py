"""MoGaze's segments as picks and puts (docs/specification/mogaze.md#pick-and-put-events)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.readers.mogaze.format import NULL_LABEL, RATE, Segment
from prbench.recording.reaching_hand import reaching_hand, wrists_at
from prbench.recording.streams import Action, AnnotatedEvent, BodyStream, ObjectTrack


def annotated_events(
    segments: Sequence[Segment], tracks: Sequence[ObjectTrack], body: BodyStream, rest_window: int
) -> tuple[tuple[AnnotatedEvent, ...], tuple[str, ...]]:
    """Picks at the start, puts at the end of every segment in which an object moves.

    The place of a pick is the object's last pose before it, that of a put the median pose over the ``rest_window``
    frames after it, clipped to the next movement.

    Args:
        segments: In the order of the file.
        tracks: Every object, one sample a frame.
        body: The wearer, one sample a frame, whose wrists tell the hand of an event.
        rest_window: Frames.

    Returns:
        The events in the order of time, and what was left out.
    """
    by_name = {track.name: track for track in tracks}
    carries, remarks = _carries_of(segments, by_name, len(body.times))
    last = len(body.times) - 1
    events = []
    for number, carry in enumerate(carries):
        track = by_name[carry.label]
        if carry.start > 0:
            place = _resting_before(track, carry.start)
            events.append(_event(f"{number}/pick", "pick", track, carry.start, place, body))
        if carry.end < last:
            later = carries[number + 1 :]
            next_movement = min((other.start for other in later), default=last + 1)
            moved_again = min((other.start for other in later if other.label == carry.label), default=last + 1)
            place = _resting_after(track, carry.end, min(carry.end + rest_window, next_movement), moved_again)
            events.append(_event(f"{number}/put", "put", track, carry.end, place, body))
    return tuple(events), remarks


def _carries_of(
    segments: Sequence[Segment], labels: dict[str, ObjectTrack], n_frames: int
) -> tuple[list[Segment], tuple[str, ...]]:
    """The movements of objects: in order, equal neighbours merged, impossible segments left out with a remark."""
    remarks = []
    if not segments:
        remarks.append("no segments, so no events")
    ordered = sorted(segments, key=lambda segment: segment.start)
    if ordered != list(segments):
        remarks.append("the segments are not in the order of time and are sorted")
    kept: list[Segment] = []
    previous = ""
    merged = 0
    for segment in ordered:
        reason = _why_bad(segment, labels, n_frames)
        if reason:
            remarks.append(f"segment {segment.start} to {segment.end} ({segment.label}) is left out: {reason}")
        elif segment.label == previous:
            merged += 1
            if segment.label != NULL_LABEL:
                kept[-1] = Segment(kept[-1].start, max(kept[-1].end, segment.end), segment.label)
        elif segment.label != NULL_LABEL:
            kept.append(segment)
        if segment.end > segment.start:  # an empty one separates nothing
            previous = segment.label if not reason else ""
    if merged:
        remarks.append(f"{merged} segments with the label of the one before them are merged with it")
    if kept and kept[0].start <= 0:
        remarks.append(f"{kept[0].label} is in hand when the recording begins: no pick")
    if kept and kept[-1].end >= n_frames - 1:
        remarks.append(f"{kept[-1].label} is in hand when the recording ends: no put")
    return kept, tuple(remarks)


def _why_bad(segment: Segment, labels: dict[str, ObjectTrack], n_frames: int) -> str:
    if segment.end <= segment.start:
        return "it ends before it begins"
    if segment.start < 0 or segment.start >= n_frames:
        return f"it begins outside of the {n_frames} frames"
    if segment.label == NULL_LABEL:
        return ""
    if segment.label not in labels:
        return "no such object is tracked"
    return "" if labels[segment.label].valid.any() else "the object is never seen"


def _resting_before(track: ObjectTrack, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """The last pose seen up to a frame, else the first one after it."""
    seen = np.flatnonzero(track.valid)
    index = seen[max(int(np.searchsorted(seen, frame, side="right")) - 1, 0)]
    return track.position[index], track.rotation[index]


def _resting_after(track: ObjectTrack, frame: int, stop: int, moved_again: int) -> tuple[np.ndarray, np.ndarray]:
    """The median pose over ``[frame, stop]``; where the object is not seen then, its next pose at rest or its last."""
    window = np.arange(frame, min(stop, len(track.valid) - 1) + 1)
    window = window[track.valid[window]]
    if len(window) == 0:
        later = np.flatnonzero(track.valid[frame:moved_again])
        if len(later) == 0:
            return _resting_before(track, frame)
        window = later[:1] + frame
    turned = Rotation.from_quat(track.rotation[window], scalar_first=True).mean()
    return np.median(track.position[window], axis=0), turned.as_quat(canonical=True, scalar_first=True)


def _event(
    key: str,
    action: Action,
    track: ObjectTrack,
    frame: int,
    place: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]],
    body: BodyStream,
) -> AnnotatedEvent:
    low, high = track.world_box(place[0][None], place[1][None])
    centre = (low[0] + high[0]) / 2
    hand = reaching_hand(wrists_at((), body, frame / RATE), centre)
    return AnnotatedEvent(
        native_key=key,
        action=action,
        object_id=track.object_id,
        object_name=track.name,
        event_time=frame / RATE,
        location=centre,
        box_min=low[0],
        box_max=high[0],
        hand=None if hand is None else hand.side,
        hand_source=None if hand is None else hand.source,
    )
