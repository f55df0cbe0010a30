"""Hand-made recordings: a standing person, one cup that is lifted, carried and put, and gaze that sweeps over it."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.recording import BodyStream, GazeStream, HandStream, ObjectTrack, OtherPerson, PoseStream, Recording
from tests.fakes import STANDING

MANIFEST, PROTOCOL = load_manifest("adt"), load_protocol()
RULE = MANIFEST.in_hand
DURATION, PICK, PUT = 30.0, 14.0, 18.0
"""The cup starts to move at PICK and comes to rest at PUT, seconds."""
PLACE_A, PLACE_B = np.array([0.5, 0.9, 1.5]), np.array([-0.7, 1.1, 1.4])
"""Centre of the cup before and after."""
HALF = np.array([0.04, 0.05, 0.04])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
LOOK_A, LOOK_B = 11.0, 15.5
"""When gaze first meets the two places."""


def minimum_jerk(x: np.ndarray) -> np.ndarray:
    """From 0 to 1, at rest at both ends."""
    x = np.clip(x, 0, 1)
    return 10 * x**3 - 15 * x**4 + 6 * x**5


def clock(rate: float, start: float = 0.0, end: float = DURATION) -> np.ndarray:
    return start + np.arange(round((end - start) * rate) + 1) / rate


def cup_centre(times: np.ndarray, pick: float = PICK, put: float = PUT) -> np.ndarray:
    share = minimum_jerk((times - pick) / (put - pick))[:, None]
    lift = 0.2 * np.sin(np.pi * share)
    return PLACE_A + share * (PLACE_B - PLACE_A) + lift * [0, 1, 0]


def track(
    times: np.ndarray, centre: np.ndarray, *, name: str = "cup", object_id: str = "1", noise: float = 0.0
) -> ObjectTrack:
    shaken = centre + np.random.default_rng(1).normal(size=centre.shape) * noise
    return ObjectTrack(
        object_id, name, "cup", times, shaken, np.tile(UPRIGHT, (len(times), 1)), np.ones(len(times), dtype=bool),
        -HALF, HALF, True,
    )  # fmt: skip


def finger_path(times: np.ndarray, pick: float = PICK, put: float = PUT) -> np.ndarray:
    """Comes to the cup within half a second, goes with it, and leaves 0.2 s after it was put down."""
    hold = cup_centre(times, pick, put) - np.array([0, 0, HALF[2] + 0.015])
    rest = np.array([0.25, 0.9, 0.1])
    near = np.minimum(minimum_jerk((times - (pick - 0.7)) / 0.6), 1 - minimum_jerk((times - (put + 0.2)) / 0.6))
    return rest + near[:, None] * (hold - rest)


def hand(side: str, times: np.ndarray, points: np.ndarray, contact: str = "middle_finger_base") -> HandStream:
    return HandStream(side, contact, times, points[:, None], np.ones(len(times), dtype=bool))  # type: ignore[arg-type]


def body(times: np.ndarray) -> BodyStream:
    """Sways and steps slowly to its left; the right wrist hangs."""
    joints = np.repeat(STANDING[None], len(times), axis=0)
    joints = joints + np.stack([0.02 * times, 0 * times, 0.01 * np.sin(times)], axis=1)[:, None]
    return BodyStream(times, joints, np.ones(len(times), dtype=bool))


EYE = np.array([0.0, 1.6, 0.05])


def gaze(times: np.ndarray, looks: list[tuple[float, float, np.ndarray]]) -> GazeStream:
    """Looks far to the side, and at each point from its start to its end."""
    direction = np.tile([-0.8, 0.0, -0.6], (len(times), 1))
    for start, end, point in looks:
        to_point = (point - EYE) / np.linalg.norm(point - EYE)
        direction[(times >= start - 1e-9) & (times < end)] = to_point
    return GazeStream(times, np.tile(EYE, (len(times), 1)), direction, np.ones(len(times), dtype=bool))


def scene(**changes: object) -> Recording:
    """The recording of this module, with streams replaced by ``changes``."""
    slow, fast = clock(30), clock(120)
    pose = PoseStream(slow, np.tile(EYE, (len(slow), 1)), np.tile(UPRIGHT, (len(slow), 1)), np.ones(len(slow), bool))
    far = np.tile([0.3, 0.9, -0.3], (len(fast), 1))
    recording = Recording(
        dataset="adt", recording_id="kitchen_1", participant_id="P1", pose_source="adt-optitrack", head_tilt_deg=7.4,
        span=(0.0, DURATION),
        gaze=gaze(slow, [(LOOK_A, LOOK_A + 0.5, PLACE_A), (LOOK_B, LOOK_B + 0.5, PLACE_B)]),
        camera=pose, head=pose, body=body(fast),
        hands=(hand("left", fast, finger_path(fast)), hand("right", fast, far)),
        objects=(
            track(slow, cup_centre(slow)),
            track(slow[:1], np.array([[0.0, 0.5, 2.0]]), name="table", object_id="2"),
        ),
        split_group="kitchen_1",
    )  # fmt: skip
    return dataclasses.replace(recording, **changes)


def elsewhere(recording: Recording, turn: Rotation, shift: np.ndarray) -> Recording:
    """The same recording in a world that is turned and moved."""

    def moved(points: np.ndarray) -> np.ndarray:
        return turn.apply(points.reshape(-1, 3)).reshape(points.shape) + shift

    def placed(stream):
        rotation = (turn * Rotation.from_quat(stream.rotation, scalar_first=True)).as_quat(scalar_first=True)
        return dataclasses.replace(stream, position=moved(stream.position), rotation=rotation)

    gaze = recording.gaze
    return dataclasses.replace(
        recording,
        body=dataclasses.replace(recording.body, joints=moved(recording.body.joints)),
        gaze=dataclasses.replace(gaze, origin=moved(gaze.origin), direction=turn.apply(gaze.direction)),
        head=placed(recording.head),
        hands=tuple(dataclasses.replace(hand, points=moved(hand.points)) for hand in recording.hands),
        objects=tuple(map(placed, recording.objects)),
    )


def stranger(times: np.ndarray, points: np.ndarray) -> OtherPerson:
    return OtherPerson("T", (hand("right", times, points),))
