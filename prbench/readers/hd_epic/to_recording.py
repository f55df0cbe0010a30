"""Converts the content of one HD-EPIC video to a :class:`Recording` (docs/specification/hd-epic.md).

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
The recording's clock is the device clock of the glasses, in seconds.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.geometry.axes import Y_UP_FROM_Z_UP
from prbench.geometry.timelines import covered, interpolate, require_overlap, slerp, stream_ranges
from prbench.protocol.manifests import Manifest
from prbench.readers.aria_mps.format import LONGEST_POSE_STEP, MpsReadings
from prbench.readers.aria_mps.to_recording import (
    ASSUMED_SIZE,
    MpsStreams,
    head_and_camera,
    mps_streams,
    size_remark,
)
from prbench.readers.egoallo.to_recording import body_stream
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.events import BoxKind, annotated_events
from prbench.recording.streams import GazeStream, PoseStream, Recording


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
    return Recording(
        dataset=dataset,
        recording_id=readings.video,
        participant_id=readings.participant_id,
        pose_source="none" if body is None else manifest.body.pose_source,
        head_tilt_deg=manifest.body.head_tilt_deg,
        span=ranges["glasses"],
        gaze=_during(streams.gaze, readings.clock.span),
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
    gaze = _frame_gaze(frames, device, head, thresholds.stale_gaze_s, world_from_source)
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


def _frame_gaze(
    frames: hd_epic.FrameReadings,
    device: PoseStream,
    head: PoseStream,
    stale: float,
    world_from_source: Float[np.ndarray, "4 4"],
) -> GazeStream:
    """One ray a distinct gaze time, which several frames repeat.

    The files turn a gaze into the world with the pose of each frame. Of the frames that repeat it the one nearest in
    time counts; its direction is taken back into the device frame, and out again with the pose at the gaze's own time.
    """
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
    fresh = np.abs(gaze_ns - frames.tracking_ns[rows]) <= stale * 1e9
    posed = covered(device.times, device.valid, times, max_gap=LONGEST_POSE_STEP)
    direction = at_gaze.apply(direction)
    return GazeStream(
        times,
        interpolate(head.times, head.position, times),
        direction / np.linalg.norm(direction, axis=1, keepdims=True),
        fresh & posed,
    )


def _finite(frames: hd_epic.FrameReadings) -> np.ndarray:
    length = np.linalg.norm(frames.gaze_direction, axis=1)
    return np.isfinite(length) & (length > 0) & np.isfinite(frames.world_from_device).all(axis=(1, 2))


def _during(gaze: GazeStream, span: tuple[float, float]) -> GazeStream:
    inside = (gaze.times >= span[0]) & (gaze.times <= span[1] + 1 / hd_epic.FPS)
    return dataclasses.replace(gaze, valid=gaze.valid & inside)
