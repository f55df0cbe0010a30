"""Converts the content of one Aria Digital Twin recording to a :class:`Recording` (docs/specification/adt.md).

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench import recording as streams
from prbench.files.bounded import require
from prbench.geometry.skeleton import invert_rigid
from prbench.geometry.timelines import require_overlap, stream_ranges
from prbench.protocol.manifests import Manifest
from prbench.readers.adt import format as adt
from prbench.readers.aria_mps.format import LONGEST_POSE_STEP, AriaTrajectory, GlassesSize
from prbench.readers.aria_mps.to_recording import gaze_in_world, head_and_camera, size_remark
from prbench.readers.egoallo.to_recording import NO_OUTPUTS, body_stream

ASSUMED_SIZE: GlassesSize = "DVT-L"  # Size of glasses where no file tells it (choice: the public sample's).
_CONTACTS: tuple[tuple[streams.ContactPoint, tuple[int, int]], ...] = (
    ("wrist", adt.WRIST_JOINTS),
    ("middle_finger_base", adt.MIDDLE_FINGER_BASES),
)


Poses = Literal["native", "egoallo", "three-point"]


def recording_from_adt(
    readings: adt.AdtReadings, manifest: Manifest, *, dataset: str, poses: Poses = "native"
) -> streams.Recording:
    """Return the streams in the world from native readings.

    Args:
        readings: Content of the native files.
        manifest: Joint mapping, pose source and head tilt.
        dataset: Name that the recording carries: the manifest's, or ``synthetic-`` before it.
        poses: Whose body: the suit's, or the one that EgoAllo estimated. Hands, and with them events, stay the suit's.

    Raises:
        StreamsDoNotOverlap: if glasses, gaze, objects and the wearer's body share no instant.
        InputFileError: if there is no pose of the glasses at all.
    """
    remedy = "Copy or download the recording again."
    require(readings.recording_id, (len(readings.glasses.time_us) != 0, "", "poses of the glasses", "none", remedy))
    device = glasses_stream(readings.glasses)
    span = float(device.times[0]), float(device.times[-1])
    head, camera = head_and_camera(device, readings.glasses_size or ASSUMED_SIZE, readings.device_from_rgb)
    gaze = gaze_in_world(head, readings.gaze, same_instant=adt.SAME_INSTANT)
    wearer = next((p for p in readings.skeletons if readings.serial and p.serial == readings.serial), None)
    suit, hands = (None, ()) if wearer is None else _body_and_hands(wearer, manifest, span)
    body = suit
    source = manifest.body
    estimate = readings.estimated_body
    told = ()
    if poses == "egoallo":
        source = manifest.other_bodies[poses]
        body, told = None, (NO_OUTPUTS,)
        if estimate is not None:
            # Frames over gaps of the glasses are guesses from nothing, and invalid.
            body = body_stream(estimate, world_from_source=invert_rigid(adt.Z_UP_FROM_SCENE), head=head)
            told = (*_counted(~body.valid, "frames of the estimated body are invalid"), *estimate.messages)
    others = [person for person in readings.skeletons if person is not wearer]
    tracks = []
    rooms = set()
    for entry in readings.objects:
        # One that never moves has a single sample.
        times = entry.time_ns / 1e9 if entry.time_ns[0] != adt.STATIC_TIME else device.times[:1]
        rotation = entry.rotation / np.linalg.norm(entry.rotation, axis=1, keepdims=True)
        names = (str(entry.object_id), entry.name, entry.category)
        samples = (times, entry.position, rotation, np.ones(len(times), dtype=bool))
        track = streams.ObjectTrack(*names, *samples, entry.box_min, entry.box_max, entry.dynamic)
        tracks.append(track)
        # Every ray would hit a box that encloses the room: ``ApartmentEnv``, and any with a side above 3 m that holds
        # a ray's origin.
        large = (entry.box_max - entry.box_min).max() > adt.ROOM_SIZE and gaze.valid.any()
        if large and entry.object_id != adt.SCENE_BOX_ID:
            position, rotation = track.pose_at(gaze.times[gaze.valid])
            local = Rotation.from_quat(rotation, scalar_first=True).inv().apply(gaze.origin[gaze.valid] - position)
            large = ((local >= entry.box_min) & (local <= entry.box_max)).all(axis=1).any()
        if large or entry.object_id == adt.SCENE_BOX_ID:
            rooms.add(track.object_id)
    # The suit in either case: an estimated body was held against the glasses when it was read.
    tolerance = adt.SAME_INSTANT
    ranges = {"glasses": (span[0] - tolerance, span[1] + tolerance)}
    ranges |= stream_ranges({"gaze": gaze.times, "body": None if suit is None else suit.times})
    moving = [track for track, each in zip(tracks, readings.objects, strict=True) if each.time_ns[0] != adt.STATIC_TIME]
    if moving:
        starts = [track.times[0] for track in moving]
        ends = [track.times[-1] for track in moving]
        ranges["objects"] = float(min(starts)), float(max(ends))
    require_overlap(ranges, recording=readings.recording_id)
    return streams.Recording(
        dataset=dataset,
        recording_id=readings.recording_id,
        participant_id="unknown" if wearer is None else wearer.name.removeprefix("Skeleton_"),
        pose_source="none" if body is None else source.pose_source,
        head_tilt_deg=source.head_tilt_deg,
        span=span,
        gaze=gaze,
        camera=camera,
        head=head,
        body=body,
        hands=hands,
        objects=tuple(track for track in tracks if track.object_id not in rooms),
        other_people=tuple(
            streams.OtherPerson(person.name, _body_and_hands(person, manifest, span)[1]) for person in others
        ),
        # Twins name each other; the smaller of both names is the same seen from either.
        split_group=min(filter(None, (readings.recording_id, readings.concurrent))),
        hinged_objects=frozenset(
            str(entry.object_id) for entry in readings.objects if adt.is_hinged(entry.name, entry.category)
        ),
        messages=(*readings.messages, *_remarks(readings, span, gaze, suit), *told),
        unreadable=readings.unreadable,
    )


def _body_and_hands(
    person: adt.AdtSkeleton, manifest: Manifest, span: tuple[float, float]
) -> tuple[streams.BodyStream, tuple[streams.HandStream, ...]]:
    """Return the 22 joints, and wrists and middle-finger bases; implausible frames are masked and filled.

    So are frames outside ``span``, the time in which the glasses were tracked: there is no ground truth.
    """
    times = person.time_ns / 1e9
    native = person.joints
    joints = adt.body_joints(native, manifest.body.joint_mapping)
    valid = streams.plausible_body_frames(times, joints) & _within(times, span)
    hands = []
    for contact, pair in _CONTACTS:
        for side, index in zip(streams.SIDES, pair, strict=True):
            point = native[:, index]
            measured = valid & np.isfinite(point).all(axis=1) & (point != 0).any(axis=1)
            points = streams.hold_neighbours(native[:, index, None], measured)
            hands.append(streams.HandStream(side, contact, times, points, measured))
    return streams.BodyStream(times, streams.hold_neighbours(joints, valid), valid), tuple(hands)


def glasses_stream(poses: AriaTrajectory) -> streams.PoseStream:
    """Return the poses of the device in the scene; quality 0 is invalid."""
    rotation = poses.rotation / np.linalg.norm(poses.rotation, axis=1, keepdims=True)
    return streams.PoseStream(poses.time_us / 1e6, poses.position, rotation, poses.quality > 0)


def _within(times: Float[np.ndarray, " n"], span: tuple[float, float]) -> Bool[np.ndarray, " n"]:
    return (times >= span[0] - adt.SAME_INSTANT) & (times <= span[1] + adt.SAME_INSTANT)


def _counted(mask: Bool[np.ndarray, " n"], said: str) -> list[str]:
    return [f"{int(mask.sum())} of {len(mask)} {said}"] if mask.any() else []


def _gaps(times: Float[np.ndarray, " n"], longest: float, where: str) -> list[str]:
    gaps = int((np.diff(times) > longest).sum())
    return [f"{gaps} gaps of more than {longest * 1e3:.0f} ms in {where}"] if gaps else []


def _remarks(
    readings: adt.AdtReadings, span: tuple[float, float], gaze: streams.GazeStream, body: streams.BodyStream | None
) -> list[str]:
    """Tell the user what is unusual about these readings."""
    glasses = readings.glasses
    remarks = size_remark(readings.glasses_size, ASSUMED_SIZE)
    remarks += _counted(~_within(gaze.times, span), "gaze rows lie outside the tracked time and are invalid")
    remarks += _gaps(glasses.time_us / 1e6, LONGEST_POSE_STEP, "the poses of the glasses")
    remarks += _counted(~(glasses.quality > 0), "poses of the glasses have quality 0 and are invalid")
    if body is None:
        remarks.append("no skeleton belongs to the wearer's glasses: no body, no hands")
    else:
        tracked = _within(body.times, span)
        remarks += _counted(~body.valid & tracked, "body frames are implausible and invalid")
        remarks += _counted(~tracked, "body frames lie outside the tracked time and are invalid")
        remarks += _gaps(body.times, adt.LONGEST_BODY_STEP, "the body")
    return remarks


_STEP_US = 1_000
_GRAPH_UID = "adt-scene-z-up"


def prepared_trajectory(glasses: AriaTrajectory) -> AriaTrajectory:
    """Return the poses of the device in the scene turned to Z up, every millisecond from the first to the last one.

    Gaps are bridged, since EgoAllo counts poses instead of reading clocks; bodies within them are taken for invalid
    when they are read.
    """
    device = turned_to_z_up(glasses)
    usable = device.valid if device.valid.any() else np.ones_like(device.valid)
    first, last = (int(glasses.time_us[usable][end]) for end in (0, -1))
    time_us = np.arange(first, last + 1, _STEP_US)
    position, rotation = device.pose_at(time_us / 1e6)
    return AriaTrajectory(time_us, position, rotation, np.ones(len(time_us)), np.array([0.0, 0.0, 1.0]), (_GRAPH_UID,))


def turned_to_z_up(glasses: AriaTrajectory) -> streams.PoseStream:
    """Return the poses of the device in the scene turned to Z up, device seconds."""
    device = glasses_stream(glasses)
    turn = Rotation.from_matrix(adt.Z_UP_FROM_SCENE[:3, :3])
    rotation = turn * Rotation.from_quat(device.rotation, scalar_first=True)
    quaternion = rotation.as_quat(scalar_first=True)
    return streams.PoseStream(device.times, turn.apply(device.position), quaternion, device.valid)
