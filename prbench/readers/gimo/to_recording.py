"""Converts the content of one GIMO segment to a :class:`Recording` (docs/specification/gimo.md).

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
The world is the canonical room: Y up, floor near y = 0, metres of the body
(docs/specification/gimo.md#coordinate-chain).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.errors import InputFileError
from prbench.geometry.skeleton import WRISTS, Joint, transform_points
from prbench.geometry.timelines import covered, interpolate
from prbench.protocol.manifests import Manifest
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.bvh import place_skeleton
from prbench.readers.gimo.gaze import glasses_streams
from prbench.recording.streams import (
    SIDES,
    AnnotatedEvent,
    BodyStream,
    GazeStream,
    HandStream,
    Occluder,
    PoseStream,
    PublishedTrack,
    Recording,
    Side,
    hold_neighbours,
)

Target = Literal["point", "cube"]
GazeOrigin = Literal["head", "hololens"]

_UNKNOWN = "unknown"
_SHORTEST_LOOK = 0.01  # metres; nearer to the eyes a point gives no direction


def recording_from_gimo(
    readings: gimo.GimoReadings,
    manifest: Manifest,
    *,
    dataset: str,
    target: Target = "point",
    gaze_origin: GazeOrigin = "head",
) -> Recording:
    """Streams in the canonical room from native readings.

    Args:
        readings: Content of the native files.
        manifest: Pose source, head tilt and thresholds.
        dataset: Name that the recording carries: the manifest's, or ``synthetic-`` before it.
        target: Box of an event: the wrist itself, or a cube around it.
        gaze_origin: Where gaze rays begin: the head joint, or the eyes as HoloLens 2 saw them.

    Raises:
        InputFileError: if the suit's skeleton does not fit the pelvis track, or the HoloLens files that were asked for
            are missing or do not fit the body.
    """
    body, route, body_remarks = _body(readings, manifest)
    room_from_scan = readings.transform.room_from_scan()
    head = PoseStream(body.times, body.joints[:, Joint.HEAD], _no_rotation(len(body.times)), body.valid)
    glasses = glasses_streams(
        readings, head, limit=manifest.thresholds["largest_head_distance"], required=gaze_origin == "hololens"
    )
    events, event_remarks = _events(readings, body, manifest, target)
    # Rays from the head (or the eyes) to the points on the scan; short gaps between points interpolated.
    points, seen = _gaze_points(readings, manifest.thresholds["longest_gaze_gap"])
    origin = body.joints[:, Joint.HEAD]
    posed = body.valid
    if gaze_origin == "hololens" and glasses.eye is not None:
        origin = glasses.eye.position
        posed = glasses.eye.valid
    apart = np.where(seen[:, None], points - origin, 0.0)
    distance = np.linalg.norm(apart, axis=1)
    valid = seen & posed & (distance > _SHORTEST_LOOK)
    # Some unit vector stands where nothing was measured; the mask says so.
    direction = np.where(valid[:, None], apart / np.where(valid, distance, 1.0)[:, None], [0.0, 0.0, 1.0])
    measured = len(readings.gaze.frames)
    total = len(body.times)
    remarks = [f"gaze on {measured} of {total} frames, {int(seen.sum()) - measured} interpolated"]
    gaze, gaze_remarks = GazeStream(body.times, origin, direction, valid), remarks
    source = manifest.other_bodies.get(route, manifest.body)
    return Recording(
        dataset=dataset,
        recording_id=readings.recording_id,
        participant_id=_UNKNOWN,
        pose_source=source.pose_source,
        head_tilt_deg=source.head_tilt_deg,
        span=(float(body.times[0]), float(body.times[-1])),
        gaze=gaze,
        camera=glasses.camera,
        head=glasses.head,
        body=body,
        hands=tuple(
            HandStream(side, "wrist", body.times, body.joints[:, wrist, None], body.valid)
            for side, wrist in zip(SIDES, WRISTS, strict=True)
        ),
        objects=(),
        annotated_events=events,
        split_group=readings.segment.group,
        occluders=tuple(
            Occluder(mesh.name, transform_points(room_from_scan, mesh.vertices), mesh.faces) for mesh in readings.meshes
        ),
        world_from_source=room_from_scan,
        messages=(*readings.messages, *body_remarks, *gaze_remarks, *glasses.messages, *event_remarks),
    )


def frame_times(frames: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Seconds of video frames on the recording's clock."""
    return frames / gimo.FRAME_RATE


def _body(readings: gimo.GimoReadings, manifest: Manifest) -> tuple[BodyStream, str, list[str]]:
    """The 22 joints on every frame of the segment; short gaps interpolated, long ones invalid."""
    remarks = []
    if isinstance(readings.body, gimo.LocalJoints):
        frames = readings.body.frames
        local = readings.body.joints
        route = readings.body.route
    else:
        poses = readings.body.poses
        laid = place_skeleton(
            readings.body.motion,
            frame_times(poses.frames),
            poses.pelvis(),
            name=f"{readings.segment.scene}/{readings.segment.sequence}/{gimo.SKELETON_FILE}",
            largest_error=manifest.thresholds["largest_track_error"],
        )
        frames = poses.frames
        local = laid.joints
        route = "bvh"
        remarks.append(
            f"limbs from {gimo.SKELETON_FILE}, which begins {laid.start:.3f} s before the segment and follows the"
            f" fitted pelvis within {laid.error * 1000:.0f} mm"
        )
        if not laid.is_sure:
            remarks.append("the pelvis hardly moves, so the skeleton's start is a guess")
    wanted = readings.segment.frames
    joints, valid = filled(frames, local, wanted, longest=round(manifest.thresholds["longest_filled_gap"]))
    missing = len(wanted) - len(frames)
    if missing:
        remarks.append(
            f"{missing} of {len(wanted)} frames have no pose, {int((~valid).sum())} in gaps too long to fill"
        )
    in_room = transform_points(readings.transform.room_from_body(), joints)
    return BodyStream(frame_times(wanted), in_room, valid), route, remarks


def filled(
    frames: Int[np.ndarray, " n"],
    joints: Float[np.ndarray, "n joints 3"],
    wanted: Int[np.ndarray, " m"],
    *,
    longest: int,
) -> tuple[Float[np.ndarray, "m joints 3"], Bool[np.ndarray, " m"]]:
    """Joints on the wanted frames: interpolated across at most ``longest`` missing ones, else held and invalid."""
    # Between two frames that are n + 1 apart n are missing.
    known = frames.astype(np.float64)
    asked = wanted.astype(np.float64)
    valid = covered(known, np.ones(len(known), dtype=bool), asked, max_gap=longest + 1.0)
    values = interpolate(known, joints, asked)
    return hold_neighbours(values, valid), valid


def _gaze_points(
    readings: gimo.GimoReadings, longest_gap: float
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Gaze points in the room on every frame, and where there is one."""
    wanted = readings.segment.frames
    gaze = readings.gaze
    if len(gaze.frames) == 0:
        return np.zeros((len(wanted), 3)), np.zeros(len(wanted), dtype=bool)
    points = transform_points(readings.transform.room_from_scan(), gaze.points)
    # 0.1 s at 30 frames a second is 3 frames, also where the product is 2.9999.
    longest = float(int(longest_gap * gimo.FRAME_RATE + 1e-9))
    known = gaze.frames.astype(np.float64)
    asked = wanted.astype(np.float64)
    seen = covered(known, np.ones(len(known), dtype=bool), asked, max_gap=longest)
    return interpolate(known, points, asked), seen


def _events(
    readings: gimo.GimoReadings, body: BodyStream, manifest: Manifest, target: Target
) -> tuple[tuple[AnnotatedEvent, ...], list[str]]:
    """Picks with the wrist as their place: the dataset knows no objects.

    Source: docs/specification/gimo.md#objects-and-events.
    """
    half = manifest.thresholds["cube_side"] / 2 if target == "cube" else 0.0
    remarks: list[str] = []
    events = []
    for event in readings.events:
        row = event.frame - readings.segment.start_frame
        hand = event.hand or _moving_hand(body, row, manifest.thresholds["hand_window"])
        place = body.joints[row, WRISTS[SIDES.index(hand)]] if body.valid[row] else None
        if place is None:
            remarks.append(f"no pose on frame {event.frame}, so its event has no place")
        if event.hand is None:
            remarks.append(f"hand of frame {event.frame} not annotated: the {hand} one moves more before it")
        if event.source == "hint":
            remarks.append(f"event frame {event.frame} is the table's hint, nobody has confirmed it")
        events.append(
            AnnotatedEvent(
                native_key=str(event.frame),
                action="pick",
                object_id=gimo.OBJECT_ID,
                object_name=readings.segment.activity or gimo.OBJECT_ID,
                event_time=float(frame_times(np.array([event.frame]))[0]),
                location=place,
                box_min=None if place is None else place - half,
                box_max=None if place is None else place + half,
                hand=hand,
                hand_source="annotated" if event.hand is not None else "movement",
            )
        )
    return tuple(events), remarks


def _moving_hand(body: BodyStream, row: int, window: float) -> Side:
    """The wrist with the longer path in the last moments before a frame."""
    first = max(row - round(window * gimo.FRAME_RATE), 0)
    wrists = body.joints[first : row + 1][:, WRISTS]
    paths = np.linalg.norm(np.diff(wrists, axis=0), axis=2).sum(axis=0)
    return SIDES[int(paths.argmax())]


def _no_rotation(n: int) -> Float[np.ndarray, "n 4"]:
    return np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))


def published_track(
    readings: gimo.GimoReadings, recording: Recording, manifest: Manifest, *, with_jaw: bool
) -> PublishedTrack:
    """The one row of ``dataset.csv`` that a recording is, every frame of it.

    Args:
        readings: Of the segment.
        recording: Of the same.
        manifest: The longest gap of poses that is filled.
        with_jaw: Whether the joints are the study's 23 or the 22 of every dataset.

    Raises:
        InputFileError: if the jaw is asked for, and no body model tells where it is.
    """
    assert recording.body is not None
    body = recording.body
    posed = readings.body.frames if isinstance(readings.body, gimo.LocalJoints) else readings.body.poses.frames
    frames = readings.segment.frames
    has_pose = np.isin(frames, posed)
    return PublishedTrack(
        name=readings.segment.name,
        published_split=gimo.PUBLISHED_SPLITS[readings.segment.training],
        times=body.times,
        joints=_and_jaw(readings, body, manifest) if with_jaw else body.joints,
        valid=body.valid,
        filled=body.valid & ~has_pose,
        body=body.joints,
        gaze=recording.gaze.direction,
        # A direction needs both ends of its own frame: a gaze point, and the head that it is seen from.
        gaze_measured=recording.gaze.valid & np.isin(frames, readings.gaze.frames) & has_pose,
    )


def _and_jaw(readings: gimo.GimoReadings, body: BodyStream, manifest: Manifest) -> Float[np.ndarray, "n 23 3"]:
    if not isinstance(readings.body, gimo.LocalJoints) or readings.body.jaw is None:
        raise InputFileError(
            readings.recording_id,
            "",
            expected="a jaw: fitted parameters or meshes, and an SMPL-X model with its 23rd joint",
            found="a body without one",
            remedy="Build the windows on the 22 joints (--joints smpl22).",
        )
    longest = round(manifest.thresholds["longest_filled_gap"])
    wanted, _ = filled(readings.body.frames, readings.body.jaw[:, None], readings.segment.frames, longest=longest)
    return np.concatenate([body.joints, transform_points(readings.transform.room_from_body(), wanted)], axis=1)
