"""Converts the content of one HOT3D recording to a :class:`Recording` (docs/specification/hot3d.md).

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
Recording clock: seconds of the ground truth (TIME_CODE), to which the device times of MPS and EgoAllo are moved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linprog
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from prbench.errors import RecordingUnusable
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, y_up
from prbench.geometry.timelines import nearest_index, require_overlap, stream_ranges
from prbench.protocol.manifests import Manifest
from prbench.readers.aria_mps.format import MpsReadings, thinned
from prbench.readers.aria_mps.to_recording import mps_streams
from prbench.readers.egoallo.to_recording import body_stream
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import hands as umetrack
from prbench.recording import GazeStream, HandStream, ObjectTrack, PoseStream, Recording

_Stream = TypeVar("_Stream", GazeStream, PoseStream)
_SAME_POSITION = 1e-6
# Metres and radians within which a row is found again; rounding alone turns it by up to 0.004 degree.
_SAME_ROTATION = np.deg2rad(0.01)
_NEAREST = 4
_LARGEST_RESIDUAL = 1e-3  # metres, median over the rows
_LARGEST_WIDTH_NS = 1e6
_FEWEST_ROWS = 3
_STRAY_NS = 5e6  # A match whose offset is so far from the median belongs to another moment at the same place.
_SMALLEST_AGREEING = 0.5
_LARGEST_DRIFT_PPM = 50.0


@dataclass(frozen=True)
class ClockMatch:
    """``device = truth + offset + drift * (truth - origin)``, nanoseconds.

    Attributes:
        offset_ns: Offset of the clocks at ``origin_ns``, nanoseconds.
        half_width_ns: Largest error of the offset.
        drift: 0 unless one constant cannot hold for all rows.
        origin_ns: An instant on the clock of the ground truth.
        matched: Rows that told the offset.
    """

    offset_ns: float
    half_width_ns: float
    drift: float
    origin_ns: int
    matched: int
    rows: int

    def truth_ns(self, device_ns: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Return times of the ground truth's clock, in integers: device times may exceed what a float holds."""
        since = device_ns - (round(self.offset_ns) + self.origin_ns)
        if self.drift == 0.0:
            return since + self.origin_ns
        # The equation above, solved for truth: since = (1 + drift) * (truth - origin).
        return since + self.origin_ns - np.rint(since * (self.drift / (1 + self.drift))).astype(np.int64)

    @property
    def remark(self) -> str:
        """Return messages for the user."""
        drift = f", drift {self.drift * 1e6:+.2f} ppm" if self.drift else ""
        said = f"clocks aligned by {self.matched} of {self.rows} headset rows:"
        return f"{said} device - ground truth = {self.offset_ns / 1e9:.6f} s ± {self.half_width_ns / 1e6:.2f} ms{drift}"


def match_clocks(headset: hot3d.PoseRows, device: hot3d.PoseRows, *, recording: str) -> ClockMatch:
    """Find the offset of two clocks from poses that are rows of a denser trajectory.

    Args:
        headset: The sparse rows on the ground truth's clock.
        device: The dense rows on the other clock, in the same world.
        recording: Name for the message.

    Raises:
        RecordingUnusable: if the rows are none of the trajectory's (median distance above 1 mm, or too few found), if
            no offset (and drift) fits all of them, or if it stays uncertain by more than 1 ms.
    """
    # Rows that are found exactly once, where they are found, and every row's distance to the nearest one.
    count = min(_NEAREST, len(device.position))
    distance, index = KDTree(device.position).query(headset.position, k=count)
    distance = distance.reshape(len(headset.position), count)
    index = index.reshape(len(headset.position), count)
    turned = Rotation.from_quat(np.repeat(headset.rotation, count, axis=0), scalar_first=True)
    turned = Rotation.from_quat(device.rotation[index.ravel()], scalar_first=True).inv() * turned
    near = (distance < _SAME_POSITION) & (turned.magnitude().reshape(distance.shape) < _SAME_ROTATION)
    exact = near & (distance == 0.0)
    candidates = np.where(exact.any(axis=1, keepdims=True), exact, near)
    found = np.flatnonzero(candidates.sum(axis=1) == 1)
    found, row, nearest = found, index[found, candidates[found].argmax(axis=1)], distance[:, 0]
    residual = float(np.median(nearest)) if len(nearest) else np.inf
    if residual > _LARGEST_RESIDUAL:
        said = f"{recording}: headset rows and MPS trajectory lie {residual * 1e3:.1f} mm apart (median):"
        said += " not one world, or not one recording."
        raise RecordingUnusable(f"{said} Gaze cannot be brought to the ground truth; download both again.")
    if len(found) < _FEWEST_ROWS:
        said = f"{recording}: {len(found)} of {len(headset.time_ns)} headset rows are found in the MPS trajectory,"
        said += f" at least {_FEWEST_ROWS} are needed to align the clocks."
        raise RecordingUnusable(f"{said} Download both files again.")
    # The nearest row of the trajectory was taken, so an offset may be half a step off to either side.
    offset = device.time_ns[row] - headset.time_ns[found]
    half_step = np.diff(device.time_ns) // 2
    low = offset - np.append(half_step[:1], half_step)[row]
    high = offset + np.append(half_step, half_step[-1:])[row]
    # Relative to one offset the bounds are small enough for floats to hold them exactly.
    reference = int(np.median(low + high) / 2)
    agreeing = np.abs((low + high) / 2 - reference) <= _STRAY_NS
    if agreeing.mean() < _SMALLEST_AGREEING:
        said = f"{recording}: only {int(agreeing.sum())} of {len(found)} headset rows that are found in the MPS"
        said += " trajectory agree about the offset of the clocks within 5 ms."
        raise RecordingUnusable(f"{said} Download both files again.")
    times = headset.time_ns[found][agreeing]
    low = (low[agreeing] - reference).astype(np.float64)
    high = (high[agreeing] - reference).astype(np.float64)
    # The middle of the offsets that all rows allow; with a drift if no constant fits.
    origin = int(times[0])
    lowest = float(low.max())
    highest = float(high.min())
    slope = 0.0
    if lowest > highest:
        middle, slope, half = _with_drift((times - origin) / 1e9, low, high)
        if half < 0 or abs(slope) * 1e-3 > _LARGEST_DRIFT_PPM:
            said = f"{recording}: no offset and no drift of the clocks fits all {len(times)} headset rows that are"
            said += f" found in the MPS trajectory (short by {(lowest - highest) / 1e6:.2f} ms)."
            raise RecordingUnusable(f"{said} Download both files again.")
    else:
        middle = (lowest + highest) / 2
        half = (highest - lowest) / 2
    if 2 * half > _LARGEST_WIDTH_NS:
        said = f"the offset of the clocks stays uncertain by {2 * half / 1e6:.2f} ms, 1 ms is needed."
        raise RecordingUnusable(f"{recording}: {said}")
    return ClockMatch(reference + middle, half, slope * 1e-9, origin, len(times), len(headset.time_ns))


def _with_drift(
    seconds: Float[np.ndarray, " k"], low: Float[np.ndarray, " k"], high: Float[np.ndarray, " k"]
) -> tuple[float, float, float]:
    """Return offset (ns), drift (ns a second), margin (ns) of the line that stays furthest inside of all intervals."""
    ones = np.ones_like(seconds)
    above = np.column_stack([-ones, -seconds, ones])
    rows = np.concatenate([above, np.column_stack([ones, seconds, ones])])
    solved = linprog([0.0, 0.0, -1.0], A_ub=rows, b_ub=np.concatenate([-low, high]), bounds=[(None, None)] * 3)
    if not solved.success:
        return 0.0, 0.0, -1.0
    offset, slope, margin = solved.x
    return float(offset), float(slope), float(margin)


def recording_from_hot3d(
    readings: hot3d.Hot3dReadings, manifest: Manifest, *, dataset: str, meshes: bool = False
) -> Recording:
    """Return the streams in the world from native readings.

    Args:
        readings: Content of the native files.
        manifest: Pose source, head tilt, thresholds.
        dataset: Name that the recording carries: the manifest's, or ``synthetic-`` before it.
        meshes: Whether objects carry their surfaces.

    Raises:
        RecordingUnusable: if the clocks cannot be aligned.
        StreamsDoNotOverlap: if ground truth, glasses and gaze share no instant.
    """
    headset = readings.headset
    device = readings.mps.trajectory
    glasses = hot3d.PoseRows(device.time_us * 1000, device.position, device.rotation)
    clock = match_clocks(headset, glasses, recording=readings.recording_id)
    # All poses were needed to align the clocks; from here on those around the gaze times suffice.
    streams = mps_streams(_on_truth_clock(thinned(readings.mps), clock), world_from_source=Y_UP_FROM_Z_UP)
    checked = len(readings.masks.get("qa_pass", ((),))[0]) > 0
    skipped_start = 0.0 if checked else manifest.thresholds["skipped_start_without_qa"]
    # Seconds without use at the start, where no mask tells that the hands are right from the first frame.
    first_ns = int(headset.time_ns[0]) + round(skipped_start * 1e9)

    def flag(time_ns: Int[np.ndarray, " n"], name: hot3d.MaskName) -> Bool[np.ndarray, " n"]:
        times, good = readings.masks.get(name, (time_ns[:0], time_ns[:0] > 0))
        if len(times) == 0:  # an absent mask is taken as all true
            return np.ones(len(time_ns), dtype=bool)
        start = times[0]  # from there on floats hold nanoseconds exactly
        return good[nearest_index((times - start).astype(np.float64), (time_ns - start).astype(np.float64))]

    def usable(time_ns: Int[np.ndarray, " n"], mask: hot3d.MaskName) -> Bool[np.ndarray, " n"]:
        return flag(time_ns, mask) & flag(time_ns, "qa_pass") & (time_ns >= first_ns)

    def posed(stream: _Stream) -> _Stream:
        # Hands do not matter to the glasses' poses.
        time_ns = np.rint(stream.times * 1e9).astype(np.int64)
        return replace(stream, valid=stream.valid & flag(time_ns, "headset_pose_available"))

    body = None
    if readings.body is not None:
        retimed = replace(readings.body, time_ns=clock.truth_ns(readings.body.time_ns))
        body = body_stream(retimed, world_from_source=Y_UP_FROM_Z_UP)
    hands, hand_remarks = hand_streams(readings, lambda time_ns: usable(time_ns, "hand_pose_available"))
    longest_gap = manifest.thresholds["longest_interpolated_object_gap"]
    objects = tuple(
        object_track(entry, usable(entry.rows.time_ns, "object_pose_available"), longest_gap, meshes=meshes)
        for entry in readings.objects
    )
    span = float(readings.headset.time_ns[0] / 1e9), float(readings.headset.time_ns[-1] / 1e9)
    ranges = {"ground truth": span} | stream_ranges({"glasses": streams.head.times, "gaze": streams.gaze.times})
    starts, ends = zip(*((entry.rows.time_ns[0], entry.rows.time_ns[-1]) for entry in readings.objects), strict=True)
    ranges["objects"] = float(min(starts) / 1e9), float(max(ends) / 1e9)
    require_overlap(ranges, recording=readings.recording_id)
    source = manifest.body
    # Tell the user what is unusual about these readings.
    remarks = []
    if not checked:
        remarks.append(f"no mask_qa_pass: the first {skipped_start} s of objects and hands are not used")
    elif not (passed := readings.masks["qa_pass"][1]).all():
        remarks.append(f"{int((~passed).sum())} of {len(passed)} frames fail the quality check and are invalid")
    if without := [entry.name for entry in readings.objects if entry.mesh is None]:
        remarks.append(f"objects without a model, whose box is their origin as a point: {', '.join(sorted(without))}")
    most = max(int(hot3d.first_of_pairs(entry.rows.time_ns).sum()) for entry in readings.objects)
    for entry in readings.objects:
        share = 1 - int(hot3d.first_of_pairs(entry.rows.time_ns).sum()) / most
        if share > 0.2:
            remarks.append(f"{entry.name} lacks {share:.0%} of its poses")
    return Recording(
        dataset=dataset,
        recording_id=readings.recording_id,
        participant_id=readings.participant_id,
        pose_source=source.pose_source if body is not None else "none",
        head_tilt_deg=source.head_tilt_deg,
        span=span,
        gaze=posed(streams.gaze),
        camera=posed(streams.camera),
        head=posed(streams.head),
        body=body,
        hands=hands,
        objects=objects,
        split_group=readings.recording_id,
        world_from_source=Y_UP_FROM_Z_UP,
        messages=(
            *readings.messages,
            *streams.messages,
            *(readings.body.messages if readings.body is not None else ()),
            clock.remark,
            *hand_remarks,
            *remarks,
        ),
        unreadable=readings.unreadable,
    )


def _on_truth_clock(mps: MpsReadings, clock: ClockMatch) -> MpsReadings:
    """Return the readings stamped by the clock of the ground truth, in whole microseconds."""

    def moved(time_us: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        shifted = np.rint(clock.truth_ns(time_us * 1000) / 1000).astype(np.int64)
        number = np.arange(len(shifted))
        return np.maximum.accumulate(shifted - number) + number  # rounding must not make two times equal

    trajectory = replace(mps.trajectory, time_us=moved(mps.trajectory.time_us))
    gaze = replace(mps.gaze, time_us=moved(mps.gaze.time_us))
    return replace(mps, trajectory=trajectory, gaze=gaze, wrists=None)  # hands come from the ground truth


def hand_streams(
    readings: hot3d.Hot3dReadings, good: Callable[[Int[np.ndarray, " n"]], Bool[np.ndarray, " n"]]
) -> tuple[tuple[HandStream, ...], tuple[str, ...]]:
    """Return the wrists and vertices of both hands at the instants where they are tracked, and remarks.

    Vertices are kept as float32 (a tenth of a micrometre within the room): they are the bulk of a recording.

    Args:
        readings: The recording.
        good: Tells which times can be used.
    """
    streams = []
    remarks = []
    for rows in readings.hands:
        time_ns, wrist, vertices = umetrack_points(rows, readings.hand_model)
        if len(time_ns) == 0:
            remarks.append(f"the {rows.side} hand is never tracked")
            continue
        times = time_ns / 1e9
        valid = good(time_ns)
        streams.append(HandStream(rows.side, "wrist", times, y_up(wrist)[:, None], valid))
        if vertices.shape[1]:
            streams.append(HandStream(rows.side, "hand_vertex", times, y_up(vertices).astype(np.float32), valid))
    if streams and readings.hand_model is None:
        remarks.append(f"no {hot3d.PROFILE_FILE}: hands are wrists only; the in-hand rule `wrist` needs no more")
    return tuple(streams), tuple(remarks)


def umetrack_points(
    rows: hot3d.HandRows, model: hot3d.HandModel | None
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n v 3"]]:
    """Return times, wrist and vertices (none without a model) of one hand, one row an instant; source world, metres."""
    kept = hot3d.first_of_pairs(rows.time_ns)
    position = rows.position[kept]
    vertices = np.empty((int(kept.sum()), 0, 3))
    if model is not None and kept.any():
        bones = umetrack.bone_transforms(model, rows.angles[kept])
        vertices = umetrack.pose_points(
            model.vertices, model.weights, bones, position, rows.rotation[kept], mirrored=rows.side == "right"
        )
    return rows.time_ns[kept], position, vertices


def object_track(
    entry: hot3d.Hot3dObject, good: Bool[np.ndarray, " n"], longest_gap: float, *, meshes: bool = False
) -> ObjectTrack:
    """Return the track of one object: one row an instant, gaps longer than ``longest_gap`` seconds marked as such.

    Rows are missing in real recordings, and a missing row is a gap: nothing is held. Short ones are interpolated by
    whoever asks for a pose. Without a model the box is the object's origin.
    """
    kept = hot3d.first_of_pairs(entry.rows.time_ns)
    times = entry.rows.time_ns[kept] / 1e9
    position = y_up(entry.rows.position[kept])
    turned = Rotation.from_matrix(Y_UP_FROM_Z_UP[:3, :3])
    rotation = (turned * Rotation.from_quat(entry.rows.rotation[kept], scalar_first=True)).as_quat(scalar_first=True)
    # An invalid sample in the middle of a gap keeps everybody from interpolating across it.
    gaps = np.flatnonzero(np.diff(times) > longest_gap)
    vertices = np.zeros((1, 3)) if entry.mesh is None else entry.mesh[0]
    times = np.insert(times, gaps + 1, (times[gaps] + times[gaps + 1]) / 2 if len(gaps) else [])
    position, rotation = (np.insert(rows, gaps + 1, rows[gaps], axis=0) for rows in (position, rotation))
    poses = (times, position, rotation, np.insert(good[kept], gaps + 1, False))
    box = (vertices.min(axis=0), vertices.max(axis=0))
    surface = entry.mesh if meshes else None
    return ObjectTrack(entry.object_id, entry.name, entry.name, *poses, *box, movable=True, surface=surface)
