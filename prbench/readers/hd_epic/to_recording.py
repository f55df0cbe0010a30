"""Converts the content of one HD-EPIC video to a :class:`Recording` (docs/specification/hd-epic.md).

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
The recording's clock is the device clock of the glasses, in seconds.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from prbench import recording as recorded
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, transform_points
from prbench.geometry.timelines import require_overlap, stream_ranges
from prbench.protocol.manifests import Manifest
from prbench.readers.aria_mps.to_recording import MpsStreams, mps_streams
from prbench.readers.egoallo.to_recording import body_stream
from prbench.readers.hd_epic import format as hd_epic


def recording_from_hd_epic(readings: hd_epic.HdEpicReadings, manifest: Manifest, *, dataset: str) -> recorded.Recording:
    """Return the streams in the world, and the annotated events, from native readings.

    Gaze before the first and after the last video frame is masked: priming windows end where the video does.

    Args:
        readings: Content of the native files.
        manifest: Pose source, head tilt and thresholds.
        dataset: Name that the recording carries: the manifest's, or ``synthetic-`` before it.

    Raises:
        StreamsDoNotOverlap: if video, glasses, gaze and body share no instant.
        InputFileError: if there is no pose of the glasses at all.
    """
    world = Y_UP_FROM_Z_UP
    streams = _NO_STREAMS
    if readings.glasses is not None:
        # Wrists are valid where they are surely tracked.
        least = manifest.thresholds["sure_wrist"]
        streams = mps_streams(readings.glasses, world_from_source=world, least_confidence=least)
    body = None if readings.body is None else body_stream(readings.body, world_from_source=world)
    times = {"glasses": streams.device.times, "gaze": streams.gaze.times, "body": None if body is None else body.times}
    ranges = {"video": readings.clock.span} | stream_ranges(times)
    require_overlap(ranges, recording=readings.video)
    events, remarks = annotated_events(readings, streams.wrists, body, manifest.thresholds)
    # An image that is shown twice has the number of its first frame.
    frames = np.flatnonzero(np.append(True, np.diff(readings.clock.device_ns) > 0))
    gaze = streams.gaze
    inside = (gaze.times >= readings.clock.span[0]) & (gaze.times <= readings.clock.span[1] + 1 / hd_epic.FPS)
    return recorded.Recording(
        dataset=dataset,
        recording_id=readings.video,
        participant_id=readings.participant_id,
        pose_source="none" if body is None else manifest.body.pose_source,
        head_tilt_deg=manifest.body.head_tilt_deg,
        span=ranges.get("glasses", readings.clock.span),
        gaze=dataclasses.replace(gaze, valid=gaze.valid & inside),
        camera=streams.camera,
        head=streams.head,
        body=body,
        hands=streams.wrists,
        hands_from_glasses=True,
        objects=(),
        annotated_events=events,
        annotations_alone=readings.glasses is None,
        has_published_priming=readings.priming is not None,
        world_from_source=world,
        messages=(
            *readings.messages,
            *streams.messages,
            *(() if readings.body is None else readings.body.messages),
            *remarks,
        ),
        unreadable=readings.unreadable,
        video=recorded.Video(readings.clock.device_ns[frames] / 1e9, frames.astype(np.float64), hd_epic.FPS),
    )


# In the place of glasses, where the annotations are read alone.
_NO_STREAMS = MpsStreams(recorded.NO_POSES, recorded.NO_POSES, recorded.NO_POSES, recorded.NO_GAZE, (), ())

_WHY_UNPLACED = {
    "no mask": "have no mask",
    "mask too far": "have a mask that is too many frames away",
    "no point": "have a mask without 3d_location",
    "outside": "lie beyond the rows of the time file",
}


@dataclass(frozen=True)
class MovementSide:
    """Start or end of one movement.

    Attributes:
        frame: Frame of the annotated time, not on the grid.
        unplaced: Reason why it has no place; empty if it has one.
    """

    track: hd_epic.ObjectTrack
    is_start: bool
    frame: float
    mask: hd_epic.ObjectMask | None
    unplaced: str


def annotated_events(
    readings: hd_epic.HdEpicReadings,
    wrists: Sequence[recorded.HandStream],
    body: recorded.BodyStream | None,
    thresholds: Mapping[str, float],
) -> tuple[tuple[recorded.AnnotatedEvent, ...], tuple[str, ...]]:
    """Return the pick (lift) and put (release) of every movement, in the order of time, and remarks.

    Args:
        readings: Tracks with masks, the video's clock, and the published priming.
        wrists: Tracked wrists of the same video, in the recording's world.
        body: Body in the same video; its wrists tell the hand where tracked ones do not.
        thresholds: Thresholds of the dataset's manifest.
    """
    farthest = thresholds["farthest_mask_frames"]
    sides = [side for track in readings.tracks for side in _sides(track, readings.clock, farthest)]
    times = readings.clock.device_seconds(np.array([side.frame for side in sides], dtype=np.float64))
    published: list[recorded.PublishedPriming | None] = [None] * len(sides)
    remarks: tuple[str, ...] = ()
    if readings.priming is not None:
        published, remarks = published_priming(sides, readings.priming, readings.clock, thresholds)
    events = []
    for side, time, priming in zip(sides, times.tolist(), published, strict=True):
        location = hand = source = None
        if side.mask is not None and side.mask.location is not None:
            location = transform_points(Y_UP_FROM_Z_UP, side.mask.location)
            hand, source = recorded.reaching_hand(recorded.wrists_at(wrists, body, time), location)
        track = side.track
        key = f"{track.object_id}/{track.track_id}/{'start' if side.is_start else 'end'}"
        about = (key, "pick" if side.is_start else "put", track.object_id, track.name, time, location)
        events.append(recorded.AnnotatedEvent(*about, None, None, hand, priming, source))
    events.sort(key=lambda event: (event.event_time, event.native_key))
    counts = Counter(side.unplaced for side in sides if side.unplaced)
    unplaced = ()
    if counts:
        reasons = ", ".join(f"{counts[why]} {text}" for why, text in _WHY_UNPLACED.items() if counts[why])
        unplaced = (f"{counts.total()} of {len(sides)} events have no place: {reasons}",)
    return tuple(events), (*unplaced, "boxes: zero-size, at the annotated points", *remarks)


def masks_of_sides(track: hd_epic.ObjectTrack) -> tuple[hd_epic.ObjectMask | None, hd_epic.ObjectMask | None]:
    """Return the masks that show a movement's start and its end, by nearest frame and whatever their order in the list.

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
    pairs = itertools.permutations(track.masks, 2)
    return min(pairs, key=lambda pair: (abs(pair[0].frame - start) + abs(pair[1].frame - end), pair[0].frame))


def _sides(track: hd_epic.ObjectTrack, clock: hd_epic.VideoClock, farthest: float) -> list[MovementSide]:
    """Return both sides of a movement, without a mask that does not show them, and with the reason."""
    frames = np.array([track.start, track.end]) * hd_epic.FPS
    sides = []
    masks = masks_of_sides(track)
    for is_start, frame, mask, inside in zip((True, False), frames, masks, clock.covers(frames), strict=True):
        unplaced = ""
        if not inside or (mask is not None and mask.frame >= len(clock.device_ns)):
            mask = None
            unplaced = "outside"
        elif mask is None:
            unplaced = "no mask"
        elif abs(mask.frame - frame) > farthest:
            mask = None
            unplaced = "mask too far"
        elif mask.location is None:
            unplaced = "no point"
        sides.append(MovementSide(track, is_start, float(frame), mask, unplaced))
    return sides


def published_priming(
    sides: Sequence[MovementSide],
    entries: Sequence[hd_epic.PublishedSide],
    clock: hd_epic.VideoClock,
    thresholds: Mapping[str, float],
) -> tuple[list[recorded.PublishedPriming | None], tuple[str, ...]]:
    """Return what the dataset publishes about each event, and remarks on what found no partner.

    An entry belongs to an event of the same side whose frame (annotated time or mask) is within 1 and whose location
    within 1 mm; each entry serves one event, nearest first.
    """
    result: list[recorded.PublishedPriming | None] = [None] * len(sides)
    at_frame: dict[int, list[int]] = {}
    for index, entry in enumerate(entries):
        at_frame.setdefault(entry.frame, []).append(index)
    reach = thresholds["same_frame"]
    candidates: set[tuple[float, float, int, int]] = set()
    located = 0
    for number, side in enumerate(sides):
        if side.mask is None or side.mask.location is None:
            continue
        located += 1
        around = (side.frame, float(side.mask.frame))
        near = {frame for base in around for frame in range(math.ceil(base - reach), math.floor(base + reach) + 1)}
        for index in itertools.chain.from_iterable(at_frame.get(frame, ()) for frame in near):
            entry = entries[index]
            if entry.is_start != side.is_start or entry.location is None:
                continue
            frames = float(min(abs(base - entry.frame) for base in around))
            metres = float(np.linalg.norm(side.mask.location - entry.location))
            if frames <= reach and metres <= thresholds["same_place_m"]:
                candidates.add((frames, metres, number, index))

    # Nearest first: by frames, among equals by metres.
    partner: dict[int, int] = {}
    for _, _, number, index in sorted(candidates):
        if number not in partner and index not in partner.values():
            partner[number] = index
    behind = 0
    for number, index in partner.items():
        frame = entries[index].frame_primed
        if frame < 0:
            result[number] = recorded.PublishedPriming("excluded" if frame == hd_epic.EXCLUDED else "not_primed", None)
        elif clock.covers(np.array([float(frame)]))[0]:
            time = float(clock.device_seconds(np.array([float(frame)]))[0])
            result[number] = recorded.PublishedPriming("primed", time, uncertainty=1 / hd_epic.FPS)
        else:
            behind += 1
    lonely = len(entries) - len(partner)
    untold = located - len(partner)
    said = {
        f"{lonely} of {len(entries)} entries belong to no event": lonely,
        f"nothing about {untold} of {located} located events": untold,
        f"{behind} primed frames lie beyond the rows of the time file; taken as unknown": behind,
    }
    return result, tuple(f"published priming: {text}" for text, count in said.items() if count)
