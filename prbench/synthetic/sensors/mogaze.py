"""The sensors of MoGaze (docs/specification/synthetic-recordings.md#sensors, rows "mogaze").

The native files hold float64, so nothing is rounded and files and memory agree bit for bit. The readings have Z up.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.axes import Y_UP_FROM_Z_UP
from prbench.manifests import load_manifest
from prbench.readers.aria_mps.format import gaze_angles, gaze_directions_cpf
from prbench.readers.mogaze import format as mogaze
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent
from prbench.synthetic.sensors.errors import Switches, sensor_generator, strength
from prbench.synthetic.sensors.mogaze_body import solve_body
from prbench.timelines import interpolate, slerp

GOGGLES_ID = 1

_GAZE_BIAS = np.deg2rad(0.8) / np.sqrt(2)
_GAZE_JITTER = np.deg2rad(0.5)
_BLINKS_A_MINUTE = 15.0  # s
_BLINK = 0.15
_DEPTH = (0.4, 2.0)  # m
_MIRRORED = 0.01  # share of the gaze points that the tracker writes behind itself
_CONFIDENT = (0.8, 1.0)
_BLINKING = (0.0, 0.3)
_BODY_TURN = np.deg2rad(0.1)
_ROOT_NOISE = 1e-3
_OBJECT_NOISE = 0.5e-3
_OBJECT_TURN = np.deg2rad(0.1)

_TO_NATIVE = Rotation.from_matrix(Y_UP_FROM_Z_UP[:3, :3].T)
_FACE_FROM_TRACKER = Rotation.from_matrix(np.diag([-1.0, -1.0, 1.0]))
"""The eye tracker's camera: x right, y down, z forward; the face: x left, y up, z forward."""
_UPRIGHT_FROM_Z_UP = Rotation.from_matrix(np.transpose([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)]))
_Z_UP_KINDS = ("plate", "jug")


def sense(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> mogaze.MogazeReadings:
    """Return what the sensors of a MoGaze recording say about a performance.

    Args:
        performance: The truth; any rate, usually 120 Hz.
        noise: Multiplies every error: its size, or how often it happens; 0 for ideal sensors.
        switches: Which errors are on; all if None.
    """
    switches = switches or Switches()
    n = int((performance.duration + 1e-9) * mogaze.RATE) + 1
    times = performance.times[0] + np.arange(n) / mogaze.RATE
    state, fixed = _sense_body(performance, times, noise, switches)
    tracker = _calibration(performance)
    points, confidence = _sense_gaze(performance, times, noise, switches)
    names = body_names(performance)
    bodies = [_sense_object(performance, motion, names[motion.object_id], times, noise, switches) for motion in
              performance.objects]  # fmt: skip
    goggles = _sense_goggles(performance, times, tracker, noise, switches)
    return mogaze.MogazeReadings(
        recording_id=performance.recording_id,
        participant_id=performance.person.participant_id,
        state=state,
        fixed=fixed,
        bodies=tuple(sorted((goggles, *bodies), key=lambda body: body.body_id)),
        gaze_points=points,
        gaze_confidence=confidence,
        calibration=tracker.as_quat(canonical=True),
        segments=_segments(performance, names, n),
    )


def events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return events as the annotators of this dataset would know them: nobody annotates doors."""
    return tuple(event for event in performance.events if event.tag != "hinge")


def gaze_bias(performance: Performance, *, noise: float, switches: Switches) -> tuple[float, float]:
    """Return the recording's constant gaze error, yaw and pitch, radians."""
    bias = sensor_generator(performance, "gaze-bias").normal(0.0, _GAZE_BIAS, 2)
    yaw, pitch = bias * strength(switches.gaze_bias, noise)
    return float(yaw), float(pitch)


def body_names(performance: Performance) -> dict[str, str]:
    """Map each object's id to a name: its own, with a number where another object has it already."""
    names: dict[str, str] = {}
    used = Counter[str]()
    for motion in performance.objects:
        used[motion.name] += 1
        number = used[motion.name]
        names[motion.object_id] = motion.name if number == 1 else f"{motion.name}_{number}"
    return names


def _sense_body(
    performance: Performance, times: Float[np.ndarray, " n"], noise: float, switches: Switches
) -> tuple[Float[np.ndarray, "n 66"], dict[str, float]]:
    joints = interpolate(performance.times, performance.joints, times)
    turned = [_turned(performance, performance.rotations[:, joint], times) for joint in range(joints.shape[1])]
    solved = solve_body(joints, np.stack(turned, axis=1))
    rng = sensor_generator(performance, "body-noise-0")
    scale = strength(switches.body_noise, noise)
    shift = rng.normal(0.0, _ROOT_NOISE, (len(times), 3))
    tremble = rng.normal(0.0, _BODY_TURN, (len(times), solved.state.shape[1] - 3))
    return solved.state + np.hstack([shift, tremble]) * scale, solved.fixed


def _turned(
    performance: Performance, rotation: Float[np.ndarray, "m 4"], times: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 4"]:
    """Interpolate rotations at the sensors' times; at the performance's own, the usual case, take them as they are."""
    if len(rotation) == len(times) and np.array_equal(performance.times, times):
        return rotation
    return slerp(performance.times[: len(rotation)], rotation, times)


def _calibration(performance: Performance) -> Rotation:
    """Draw the rotation from the eye tracker's camera to the goggles, another one in every recording."""
    return Rotation.from_quat(sensor_generator(performance, "calibration").normal(size=4))


def _sense_goggles(
    performance: Performance, times: Float[np.ndarray, " n"], tracker: Rotation, noise: float, switches: Switches
) -> mogaze.MogazeBody:
    head = Rotation.from_quat(_turned(performance, performance.head_rotation, times), scalar_first=True)
    turned = _TO_NATIVE * head * _FACE_FROM_TRACKER * tracker.inv()
    position = _TO_NATIVE.apply(interpolate(performance.times, performance.eye, times))
    position, rotation = _tracked(performance, "goggles", position, turned, strength(switches.object_noise, noise))
    return mogaze.MogazeBody(GOGGLES_ID, mogaze.GOGGLES, position, rotation, np.zeros(3), np.zeros(3))


def _sense_gaze(
    performance: Performance, times: Float[np.ndarray, " n"], noise: float, switches: Switches
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Return the gaze points in the eye tracker's camera, millimetres, and confidence."""
    head = Rotation.from_quat(_turned(performance, performance.head_rotation, times), scalar_first=True)
    angles = np.column_stack(gaze_angles(head.inv().apply(interpolate(performance.times, performance.gaze, times))))
    angles += gaze_bias(performance, noise=noise, switches=switches)
    jitter = sensor_generator(performance, "gaze-jitter").normal(0.0, _GAZE_JITTER, angles.shape)
    angles += jitter * strength(switches.gaze_jitter, noise)
    points = _FACE_FROM_TRACKER.inv().apply(gaze_directions_cpf(*angles.T)) * _depth(performance, times)[:, None] * 1e3
    rng = sensor_generator(performance, "gaze-quality")
    points[rng.random(len(times)) < _MIRRORED] *= -1.0
    confidence = rng.uniform(*_CONFIDENT, len(times))
    doubt = rng.uniform(*_BLINKING, len(times))
    garbage = rng.normal(0.0, 300.0, points.shape)
    closed = _blinks(performance, times, strength(switches.blinks, noise))
    return np.where(closed[:, None], garbage, points), np.where(closed, doubt, confidence)


def _blinks(performance: Performance, times: Float[np.ndarray, " n"], scale: float) -> Bool[np.ndarray, " n"]:
    rng = sensor_generator(performance, "blinks")
    count = rng.poisson(_BLINKS_A_MINUTE / 60.0 * performance.duration)
    starts = rng.uniform(times[0], times[-1], count)
    closed = np.minimum(_BLINK * scale, 1.0)
    return ((times >= starts[:, None]) & (times < starts[:, None] + closed)).any(axis=0)


def _depth(performance: Performance, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the distance from the eyes to the point fixated, as far as the tracker tells distances."""
    depth = np.full(len(times), _DEPTH[1])
    eye = interpolate(performance.times, performance.eye, times)
    for look in performance.fixations:
        rows = slice(*np.searchsorted(times, (look.start, look.end)))
        depth[rows] = np.linalg.norm(look.target - eye[rows], axis=1)
    return np.clip(depth, *_DEPTH)


def _sense_object(
    performance: Performance,
    motion: ObjectMotion,
    name: str,
    times: Float[np.ndarray, " n"],
    noise: float,
    switches: Switches,
) -> mogaze.MogazeBody:
    low, high, upright_from_body = _shape(motion, name)
    track = performance.times[: len(motion.position)]
    turned = Rotation.from_quat(_turned(performance, motion.rotation, times), scalar_first=True) * upright_from_body
    origin = interpolate(track, motion.position, times) - turned.apply((low + high) / 2)
    scale = strength(switches.object_noise, noise) if motion.movable else 0.0
    position, rotation = _tracked(performance, motion.object_id, _TO_NATIVE.apply(origin), _TO_NATIVE * turned, scale)
    lost = _untracked(performance, motion, times)
    position[lost], rotation[lost] = np.nan, 0.0
    return mogaze.MogazeBody(int(motion.object_id), name, position, rotation, low, high)


def _shape(motion: ObjectMotion, name: str) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], Rotation]:
    """Return the box in the body's own frame, and that frame's axes in the performance's."""
    kind = mogaze.kind_of_body(name)
    upright = Rotation.identity()
    if kind != motion.category or kind not in load_manifest("mogaze").object_extents or mogaze.is_furniture(name):
        return -motion.half_extents, motion.half_extents, upright
    low, high = np.array(load_manifest("mogaze").object_extents[kind]).T
    return low, high, _UPRIGHT_FROM_Z_UP if kind in _Z_UP_KINDS else upright


def _tracked(
    performance: Performance, name: str, position: Float[np.ndarray, "n 3"], rotation: Rotation, scale: float
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]:
    """Return the poses with the noise of marker tracking; quaternions x y z w."""
    rng = sensor_generator(performance, f"object-noise-{name}")
    moved = position + rng.normal(0.0, _OBJECT_NOISE, position.shape) * scale
    turned = rotation * Rotation.from_rotvec(rng.normal(0.0, _OBJECT_TURN, position.shape) * scale)
    return moved, turned.as_quat(canonical=True)


def _untracked(
    performance: Performance, motion: ObjectMotion, times: Float[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return the instants of ``lost`` events, at which nobody sees the object."""
    spans = [event.lost_span for event in performance.events if event.object_id == motion.object_id and event.lost_span]
    hidden = [(times >= start) & (times <= end) for start, end in spans]
    return np.any(hidden, axis=0) if hidden else np.zeros(len(times), dtype=bool)


def _segments(performance: Performance, names: dict[str, str], n_frames: int) -> tuple[mogaze.Segment, ...]:
    """Alternate nothing and an object; a segment begins with the last frame of the one before it, or one later."""
    rng = sensor_generator(performance, "segment-borders")
    segments: list[mogaze.Segment] = []
    free_from = 0
    for start, end, label in _carries(performance, names, n_frames):
        segments.append(mogaze.Segment(free_from, start - int(rng.integers(2)), mogaze.NULL_LABEL))
        segments.append(mogaze.Segment(start, end, label))
        free_from = end + int(rng.integers(2))
    if free_from < n_frames - 1:
        segments.append(mogaze.Segment(free_from, n_frames - 1, mogaze.NULL_LABEL))
    return tuple(segments)


def _carries(performance: Performance, names: dict[str, str], n_frames: int) -> list[tuple[int, int, str]]:
    """Return first and last frame of every movement, in order; an object never put down moves until the end."""
    carries = []
    held = dict[str, int]()
    for event in sorted(events(performance), key=lambda event: event.event_time):
        frame = round((event.event_time - float(performance.times[0])) * mogaze.RATE)
        if event.expected == "not_an_event":
            continue
        if event.action == "pick":
            held[event.object_id] = frame
        elif event.object_id in held:
            carries.append((held.pop(event.object_id), frame, names[event.object_id]))
    carries += [(frame, n_frames - 1, names[object_id]) for object_id, frame in held.items()]
    return sorted(carries)
