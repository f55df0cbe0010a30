"""The sensors of MoGaze (docs/specification/synthetic-recordings.md#sensors, rows "mogaze").

The native files hold float64, so nothing is rounded and files and memory agree bit for bit. The readings have Z up.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.geometry.axes import Y_UP_FROM_Z_UP
from prbench.geometry.timelines import interpolate, slerp
from prbench.protocol.manifests import load_manifest
from prbench.readers.aria_mps.format import gaze_directions_cpf
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.synthetic_body import solve_body
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent
from prbench.synthetic.sensors import (
    Sensing,
    Switches,
    closed_eyes,
    fixation_depth,
    gaze_bias_of,
    measured_gaze,
    sensor_generator,
    tracked,
    untracked,
)

GOGGLES_ID = 1

_GAZE_BIAS = np.deg2rad(0.8) / np.sqrt(2)
_GAZE_JITTER = np.deg2rad(0.5)
_DEPTH = (0.4, 2.0)  # m
_MIRRORED = 0.01  # share of the gaze points that the tracker writes behind itself
_CONFIDENT = (0.8, 1.0)
_BLINKING = (0.0, 0.3)
_BODY_TURN = np.deg2rad(0.1)
_ROOT_NOISE = 1e-3
_OBJECT_NOISE = (0.5e-3, np.deg2rad(0.1))  # m, rad

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
    sensing = Sensing(performance, noise, switches or Switches())
    times = sensing.times(mogaze.RATE)
    state, fixed = _sense_body(sensing, times)
    tracker = _calibration(performance)
    points, confidence = _sense_gaze(sensing, times)
    names = body_names(performance)
    bodies = [_sense_goggles(sensing, times, tracker)]
    bodies += [_sense_object(sensing, motion, names[motion.object_id], times) for motion in performance.objects]
    return mogaze.MogazeReadings(
        recording_id=performance.recording_id,
        participant_id=performance.person.participant_id,
        state=state,
        fixed=fixed,
        bodies=tuple(sorted(bodies, key=lambda body: body.body_id)),
        gaze_points=points,
        gaze_confidence=confidence,
        calibration=tracker.as_quat(canonical=True),
        segments=_segments(performance, names, len(times)),
    )


def events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return events as the annotators of this dataset would know them: nobody annotates doors."""
    return tuple(event for event in performance.events if event.tag != "hinge")


def gaze_bias(performance: Performance, *, noise: float, switches: Switches) -> tuple[float, float]:
    """Return the recording's constant gaze error, yaw and pitch, radians."""
    return gaze_bias_of(Sensing(performance, noise, switches), _GAZE_BIAS)


def body_names(performance: Performance) -> dict[str, str]:
    """Map each object's id to a name: its own, with a number where another object has it already."""
    names: dict[str, str] = {}
    used = Counter[str]()
    for motion in performance.objects:
        used[motion.name] += 1
        number = used[motion.name]
        names[motion.object_id] = motion.name if number == 1 else f"{motion.name}_{number}"
    return names


def _sense_body(sensing: Sensing, times: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 66"], dict[str, float]]:
    performance = sensing.performance
    joints = interpolate(performance.times, performance.joints, times)
    turned = [_turned(performance, performance.rotations[:, joint], times) for joint in range(joints.shape[1])]
    solved = solve_body(joints, np.stack(turned, axis=1))
    rng = sensing.generator("body-noise-0")
    shift = rng.normal(0.0, _ROOT_NOISE, (len(times), 3))
    tremble = rng.normal(0.0, _BODY_TURN, (len(times), solved.state.shape[1] - 3))
    return solved.state + np.hstack([shift, tremble]) * sensing.strength("body_noise"), solved.fixed


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


def _head(performance: Performance, times: Float[np.ndarray, " n"]) -> Rotation:
    return Rotation.from_quat(_turned(performance, performance.head_rotation, times), scalar_first=True)


def _sense_goggles(sensing: Sensing, times: Float[np.ndarray, " n"], tracker: Rotation) -> mogaze.MogazeBody:
    turned = _TO_NATIVE * _head(sensing.performance, times) * _FACE_FROM_TRACKER * tracker.inv()
    position = _TO_NATIVE.apply(sensing.eye(times))
    scale = sensing.strength("object_noise")
    position, rotation = tracked(sensing, "goggles", position, turned, size=_OBJECT_NOISE, scale=scale)
    quaternion = rotation.as_quat(canonical=True)
    return mogaze.MogazeBody(GOGGLES_ID, mogaze.GOGGLES, position, quaternion, np.zeros(3), np.zeros(3))


def _sense_gaze(
    sensing: Sensing, times: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Return the gaze points in the eye tracker's camera, millimetres, and confidence."""
    head = _head(sensing.performance, times)
    angles = measured_gaze(sensing, head, sensing.gaze(times), bias=_GAZE_BIAS, jitter=_GAZE_JITTER)
    depth = np.clip(fixation_depth(sensing, times, _DEPTH[1]), *_DEPTH)  # as far as the tracker tells distances
    points = _FACE_FROM_TRACKER.inv().apply(gaze_directions_cpf(*angles.T)) * depth[:, None] * 1e3
    rng = sensing.generator("gaze-quality")
    points[rng.random(len(times)) < _MIRRORED] *= -1.0
    confidence = rng.uniform(*_CONFIDENT, len(times))
    doubt = rng.uniform(*_BLINKING, len(times))
    garbage = rng.normal(0.0, 300.0, points.shape)
    closed = closed_eyes(sensing, times)
    return np.where(closed[:, None], garbage, points), np.where(closed, doubt, confidence)


def _sense_object(
    sensing: Sensing, motion: ObjectMotion, name: str, times: Float[np.ndarray, " n"]
) -> mogaze.MogazeBody:
    performance = sensing.performance
    low, high, upright_from_body = _shape(motion, name)
    track = performance.times[: len(motion.position)]
    turned = Rotation.from_quat(_turned(performance, motion.rotation, times), scalar_first=True) * upright_from_body
    origin = interpolate(track, motion.position, times) - turned.apply((low + high) / 2)
    position, rotation = tracked(
        sensing,
        motion.object_id,
        _TO_NATIVE.apply(origin),
        _TO_NATIVE * turned,
        size=_OBJECT_NOISE,
        scale=sensing.strength("object_noise") if motion.movable else 0.0,
    )
    quaternion = rotation.as_quat(canonical=True)
    # A body out of sight: the release has NaN for its place and zeros for its rotation.
    lost = untracked(performance, motion, times)
    position[lost] = np.nan
    quaternion[lost] = 0.0
    return mogaze.MogazeBody(int(motion.object_id), name, position, quaternion, low, high)


def _shape(motion: ObjectMotion, name: str) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], Rotation]:
    """Return the box in the body's own frame, and that frame's axes in the performance's."""
    kind = mogaze.kind_of_body(name)
    upright = Rotation.identity()
    if kind != motion.category or kind not in load_manifest("mogaze").object_extents or mogaze.is_furniture(name):
        return -motion.half_extents, motion.half_extents, upright
    low, high = np.array(load_manifest("mogaze").object_extents[kind]).T
    return low, high, _UPRIGHT_FROM_Z_UP if kind in _Z_UP_KINDS else upright


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
