"""Converts the content of one HD-EPIC video to a :class:`Recording` (docs/specification/hd-epic.md).

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
The recording's clock is the device clock of the glasses, in seconds.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, transform_points
from prbench.geometry.timelines import covered, interpolate, require_overlap, slerp, stream_ranges
from prbench.protocol.manifests import Manifest
from prbench.readers.aria_mps.format import LONGEST_POSE_STEP, MpsReadings
from prbench.readers.aria_mps.to_recording import ASSUMED_SIZE, MpsStreams, head_and_camera, mps_streams, size_remark
from prbench.readers.egoallo.to_recording import body_stream
from prbench.readers.hd_epic import format as hd_epic
from prbench.recording.streams import (
    AnnotatedEvent,
    BodyStream,
    GazeStream,
    PoseStream,
    PublishedPriming,
    Recording,
    reaching_hand,
    wrists_at,
)


def recording_from_hd_epic(
    readings: hd_epic.HdEpicReadings, manifest: Manifest, *, dataset: str, boxes: BoxKind = "point"
) -> Recording:
    """Streams in the world, and the annotated events, from native readings.

    Gaze before the first and after the last video frame is masked: priming windows end where the video does.

    Args:
        readings: Content of the native files.
        manifest: Pose source and head tilt.
        dataset: Name that the recording carries: the manifest's, or ``synthetic-`` before it.
        boxes: Zero-size boxes at the annotated points, or cubes as large as the 2D boxes say.

    Raises:
        StreamsDoNotOverlap: if video, glasses, gaze and body share no instant.
        InputFileError: if there is no pose of the glasses at all.
    """
    world = Y_UP_FROM_Z_UP
    thresholds = hd_epic.Thresholds(**manifest.thresholds)
    streams = glasses_streams(readings.glasses, thresholds, world_from_source=world)
    body = None if readings.body is None else body_stream(readings.body, world_from_source=world)
    times = {"glasses": streams.device.times, "gaze": streams.gaze.times, "body": None if body is None else body.times}
    ranges = {"video": readings.clock.span} | stream_ranges(times)
    require_overlap(ranges, recording=readings.video)
    events, remarks = annotated_events(readings, streams, body, thresholds, boxes=boxes)
    gaze = streams.gaze
    inside = (gaze.times >= readings.clock.span[0]) & (gaze.times <= readings.clock.span[1] + 1 / hd_epic.FPS)
    return Recording(
        dataset=dataset,
        recording_id=readings.video,
        participant_id=readings.participant_id,
        pose_source="none" if body is None else manifest.body.pose_source,
        head_tilt_deg=manifest.body.head_tilt_deg,
        span=ranges["glasses"],
        gaze=dataclasses.replace(gaze, valid=gaze.valid & inside),
        camera=streams.camera,
        head=streams.head,
        body=body,
        hands=streams.wrists,
        objects=(),
        annotated_events=events,
        world_from_source=world,
        messages=(
            *readings.messages,
            *streams.messages,
            *(() if readings.body is None else readings.body.messages),
            *remarks,
        ),
    )


def glasses_streams(
    glasses: MpsReadings | hd_epic.FrameReadings,
    thresholds: hd_epic.Thresholds,
    *,
    world_from_source: Float[np.ndarray, "4 4"],
) -> MpsStreams:
    """Poses, gaze and wrists on the device clock, from MPS files or from the intermediate data.

    Wrists are valid where they are surely tracked; the intermediate data know none.

    Raises:
        InputFileError: if there is no pose of the glasses at all.
    """
    if isinstance(glasses, MpsReadings):
        return mps_streams(glasses, world_from_source=world_from_source, least_confidence=thresholds.sure_wrist)
    return _frame_streams(glasses, thresholds, world_from_source)


def source_head(glasses: MpsReadings | hd_epic.FrameReadings) -> PoseStream:
    """Poses of the central pupil frame in the source world (Z up), on the device clock.

    Raises:
        InputFileError: if there is no pose of the glasses at all.
    """
    if isinstance(glasses, MpsReadings):
        return mps_streams(dataclasses.replace(glasses, wrists=None), world_from_source=np.eye(4)).head
    return head_and_camera(_frame_poses(glasses, np.eye(4)), glasses.glasses_size or ASSUMED_SIZE, None)[0]


def _frame_streams(
    frames: hd_epic.FrameReadings, thresholds: hd_epic.Thresholds, world_from_source: Float[np.ndarray, "4 4"]
) -> MpsStreams:
    device = _frame_poses(frames, world_from_source)
    head, camera = head_and_camera(device, frames.glasses_size or ASSUMED_SIZE, frames.device_from_rgb)
    remarks = ["camera and gaze are those of the intermediate data: gaze at 5 to 10 Hz, no hands"]
    remarks += size_remark(frames.glasses_size, ASSUMED_SIZE)
    lost = int((~np.isfinite(frames.world_from_device).all(axis=(1, 2))).sum())
    if lost:
        remarks.append(f"{lost} of {len(frames.tracking_ns)} video frames have no pose of the glasses")
    # One ray a distinct gaze time, which several frames repeat.
    looking = np.flatnonzero((frames.gaze_ns >= 0) & (frames.slam_ns >= 0) & _finite(frames))
    away = np.abs(frames.gaze_ns - frames.slam_ns)[looking]
    # lexsort sorts by its last key first: by gaze time, and within one time by nearness.
    nearest_first = looking[np.lexsort((away, frames.gaze_ns[looking]))]
    gaze_ns, first = np.unique(frames.gaze_ns[nearest_first], return_index=True)
    rows = nearest_first[first]
    times = gaze_ns / 1e9
    turn = Rotation.from_matrix(world_from_source[:3, :3])
    of_frame = turn * Rotation.from_matrix(frames.world_from_device[rows][:, :, :3])
    direction = of_frame.inv().apply(turn.apply(frames.gaze_direction[rows]))
    at_gaze = Rotation.from_quat(slerp(device.times, device.rotation, times), scalar_first=True)
    fresh = np.abs(gaze_ns - frames.tracking_ns[rows]) <= thresholds.stale_gaze_s * 1e9
    posed = covered(device.times, device.valid, times, max_gap=LONGEST_POSE_STEP)
    direction = at_gaze.apply(direction)
    gaze = GazeStream(
        times,
        interpolate(head.times, head.position, times),
        direction / np.linalg.norm(direction, axis=1, keepdims=True),
        fresh & posed,
    )
    return MpsStreams(device, head, camera, gaze, (), tuple(remarks))


def _frame_poses(frames: hd_epic.FrameReadings, world_from_source: Float[np.ndarray, "4 4"]) -> PoseStream:
    """One pose a distinct SLAM time; frames without pose leave a gap."""
    posed = np.isfinite(frames.world_from_device).all(axis=(1, 2)) & (frames.slam_ns >= 0)
    times, rows = np.unique(frames.slam_ns[posed], return_index=True)
    if len(times) == 0:
        raise InputFileError(
            hd_epic.FRAMES_FILE, "T_world_device", expected="poses of the glasses", found="null in every frame"
        )
    poses = frames.world_from_device[posed][rows]
    turn = Rotation.from_matrix(world_from_source[:3, :3])
    return PoseStream(
        times / 1e9,
        poses[:, :, 3] @ world_from_source[:3, :3].T + world_from_source[:3, 3],
        (turn * Rotation.from_matrix(poses[:, :, :3])).as_quat(scalar_first=True),
        np.ones(len(times), dtype=bool),
    )


def _finite(frames: hd_epic.FrameReadings) -> np.ndarray:
    length = np.linalg.norm(frames.gaze_direction, axis=1)
    return np.isfinite(length) & (length > 0) & np.isfinite(frames.world_from_device).all(axis=(1, 2))


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
class MovementSide:
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
    published: list[PublishedPriming | None] = [None] * len(sides)
    remarks: tuple[str, ...] = ()
    if readings.priming is not None:
        published, remarks = published_priming(sides, readings.priming, readings.clock, thresholds)
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


def _sides(track: hd_epic.ObjectTrack, clock: hd_epic.VideoClock, thresholds: hd_epic.Thresholds) -> list[MovementSide]:
    """Both sides of a movement, without a mask that does not show them, and with the reason."""
    frames = np.array([track.start, track.end]) * hd_epic.FPS
    sides = []
    for is_start, frame, mask, inside in zip(
        (True, False), frames, masks_of_sides(track), clock.covers(frames), strict=True
    ):
        unplaced = ""
        if not inside or (mask is not None and mask.frame >= len(clock.device_ns)):
            mask = None
            unplaced = _OUTSIDE
        elif mask is None:
            unplaced = _NO_MASK
        elif abs(mask.frame - frame) > thresholds.farthest_mask_frames:
            mask = None
            unplaced = _FAR_MASK
        elif mask.location is None:
            unplaced = _NO_POINT
        sides.append(MovementSide(track, is_start, float(frame), mask, unplaced))
    return sides


def published_priming(
    sides: Sequence[MovementSide],
    entries: Sequence[hd_epic.PublishedSide],
    clock: hd_epic.VideoClock,
    thresholds: hd_epic.Thresholds,
) -> tuple[list[PublishedPriming | None], tuple[str, ...]]:
    """What the dataset publishes about each event, and remarks on what found no partner.

    An entry belongs to an event of the same side whose frame (annotated time or mask) is within 1 and whose location
    within 1 mm; each entry serves one event, nearest first.
    """
    result: list[PublishedPriming | None] = [None] * len(sides)
    at_frame: dict[int, list[int]] = {}
    for index, entry in enumerate(entries):
        at_frame.setdefault(entry.frame, []).append(index)
    candidates: set[tuple[float, float, int, int]] = set()
    located = 0
    for number, side in enumerate(sides):
        if side.mask is None or side.mask.location is None:
            continue
        located += 1
        around = (side.frame, float(side.mask.frame))
        reach = thresholds.same_frame
        near = {frame for base in around for frame in range(math.ceil(base - reach), math.floor(base + reach) + 1)}
        for index in itertools.chain.from_iterable(at_frame.get(frame, ()) for frame in near):
            entry = entries[index]
            if entry.is_start != side.is_start or entry.location is None:
                continue
            frames = float(min(abs(base - entry.frame) for base in around))
            metres = float(np.linalg.norm(side.mask.location - entry.location))
            if frames <= reach and metres <= thresholds.same_place_m:
                candidates.add((frames, metres, number, index))

    # Nearest first: by frames, among equals by metres.
    partner: dict[int, int] = {}
    taken: set[int] = set()
    for _, _, number, index in sorted(candidates):
        if number not in partner and index not in taken:
            partner[number] = index
            taken.add(index)
    for number, index in partner.items():
        result[number] = _priming(entries[index], clock)

    remarks = []
    if len(partner) < len(entries):
        remarks.append(f"published priming: {len(entries) - len(partner)} of {len(entries)} entries belong to no event")
    if len(partner) < located:
        remarks.append(f"published priming: nothing about {located - len(partner)} of {located} located events")
    behind = sum(result[number] is None for number in partner)
    if behind:
        remarks.append(
            f"published priming: {behind} primed frames lie beyond the rows of the time file; taken as unknown"
        )
    return result, tuple(remarks)


def _priming(entry: hd_epic.PublishedSide, clock: hd_epic.VideoClock) -> PublishedPriming | None:
    """None for a primed frame beyond the rows of the time file."""
    frame = entry.frame_primed
    if frame < 0:
        return PublishedPriming("excluded" if frame == hd_epic.EXCLUDED else "not_primed", None)
    if not clock.covers(np.array([float(frame)]))[0]:
        return None
    time = clock.device_seconds(np.array([float(frame)]))[0]
    return PublishedPriming("primed", float(time), uncertainty=1 / hd_epic.FPS)


def _event(
    side: MovementSide,
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
    side: MovementSide, location: Float[np.ndarray, "3"], readings: hd_epic.HdEpicReadings, streams: MpsStreams
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


def _unplaced_remarks(sides: Sequence[MovementSide]) -> tuple[str, ...]:
    counts = Counter(side.unplaced for side in sides if side.unplaced)
    if not counts:
        return ()
    reasons = ", ".join(f"{counts[why]} {text}" for why, text in _WHY_UNPLACED.items() if counts[why])
    return (f"{counts.total()} of {len(sides)} events have no place: {reasons}",)


def _box_remark(boxes: BoxKind) -> str:
    if boxes == "point":
        return "boxes: zero-size, at the annotated points"
    return "boxes: cubes as large as the 2D boxes say at the distance of the point"
