"""Native files of Nymeria (docs/specification/nymeria.md): suit, narrations, metadata, and the glasses' trajectory."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.files.storage import atomic_path, write_bytes, write_json
from prbench.geometry import skeleton
from prbench.geometry.skeleton import Joint
from prbench.protocol.manifests import load_manifest
from prbench.randomness import named_generator
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.synthetic import write_csv
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.activities import NarratedMotion
from prbench.synthetic.people.kinematics import quaternion, rotation_quaternion, wobble
from prbench_adapters.corpora.nymeria import format as nymeria
from prbench_adapters.corpora.nymeria.format import SUIT_RATE, Narration, Suit

_DRIFT = (0.02, 0.005, 0.02)  # m r.m.s., Hz: the suit's world drifts slowly
_SLIP = (np.deg2rad(0.3), 0.01, 0.05)  # rad r.m.s., Hz: the glasses against the head
_WRIST_SLIP = (np.deg2rad(1.0), 0.05, 0.3)  # rad r.m.s., Hz: a band against the wrist
_WRIST_PLACE = 0.03  # m: deviation, an axis, of the band from the wrist joint
_OFFSET = (0.1, 0.3)  # s, suit clock minus glasses' clock
_DEVICE_START = (100.0, 60_000.0)  # s
_ROUNDED = 1e5  # 10 micrometres

_Z_UP_FROM_Y_UP = skeleton.Y_UP_FROM_Z_UP[:3, :3].T
# Segments: x forward, y left, z up; ours: x left, y up, z forward.
_OURS_FROM_SEGMENT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
# Whose position and rotation a segment takes; the Pelvis segment lies between the hips.
_JOINT_OF_SEGMENT = {
    "Pelvis": Joint.PELVIS,
    **dict(zip(load_manifest("nymeria").body.joint_mapping, Joint, strict=True)),
}


@dataclass(frozen=True)
class NymeriaReadings:
    """All that is written of one recording, and the offset that must be found again.

    Attributes:
        glasses: Poses of the glasses, device clock, Z up.
        offset: TIME_CODE minus device time, seconds.
        wristbands: Poses of the left and the right wristband, clock and world of the glasses.
    """

    name: str
    suit: Suit
    narrations: tuple[Narration, ...]
    glasses: mps.AriaTrajectory
    offset: float
    wristbands: tuple[mps.AriaTrajectory, ...]


def sense_nymeria(motion: NarratedMotion, *, seed: int, noise: float = 1.0) -> NymeriaReadings:
    """Put a motion into the suit's world and its texts onto the glasses' clock.

    Args:
        motion: The truth, at 240 Hz.
        seed: The corpus's seed.
        noise: Multiplies drift and slip; 0 for ideal sensors.
    """

    def generator(purpose: str) -> np.random.Generator:
        return named_generator("prbench-synth", GENERATOR_VERSION, seed, "corpus", motion.recording_id, purpose)

    clock = generator("clock")
    device_start_us, offset_us = (round(1e6 * float(clock.uniform(*span))) for span in (_DEVICE_START, _OFFSET))
    ticks = np.rint(np.arange(len(motion.joints)) * 1e6 / SUIT_RATE).astype(np.int64)
    rng = generator("drift")
    joints = motion.joints
    points = np.stack([joints[:, _JOINT_OF_SEGMENT[name]] for name in skeleton.XSENS_SEGMENTS], axis=1)
    points[:, 0] = 0.5 * (joints[:, Joint.LEFT_HIP] + joints[:, Joint.RIGHT_HIP])
    drift = np.stack([wobble(motion.times, noise * _DRIFT[0], *_DRIFT[1:], rng) for _ in range(2)], axis=-1)
    points[..., [0, 2]] += drift[:, None]
    joints = [int(_JOINT_OF_SEGMENT[name]) for name in skeleton.XSENS_SEGMENTS]
    turned = skeleton.rotation_matrices(motion.rotations[:, joints])
    position = (np.rint(skeleton.z_up(points) * _ROUNDED) / _ROUNDED).astype(np.float32)
    rotation = quaternion(_Z_UP_FROM_Y_UP @ turned @ _OURS_FROM_SEGMENT).astype(np.float32)
    suit = Suit(device_start_us + offset_us + ticks, position, rotation, _calibration_pose(motion))
    device_start = device_start_us / 1e6
    answers = {
        kind: [name[len(nymeria.ANSWER_PREFIX) :].strip() for name in names]
        for kind, names in nymeria.ANSWER_COLUMNS.items()
    }
    texts = []
    for row in motion.narrations:
        span = (round(device_start + row.start, 6), round(device_start + row.end, 6))
        texts.append(Narration(row.kind, *span, tuple(zip(answers[row.kind], row.texts, strict=True)), "annotator_1"))

    def device(carrier: np.ndarray, place: np.ndarray, slips: Any, rng: np.random.Generator) -> Any:
        """Poses of what slips on a carrier with these turns (n, 3, 3), at these places."""
        slip = [wobble(motion.times, noise * slips[0], slips[1], slips[2], rng) for _ in range(2)]
        worn = skeleton.rotation_matrices(rotation_quaternion(slip[0], slip[1]))
        rotation = np.round(quaternion(_Z_UP_FROM_Y_UP @ carrier @ worn), 8)
        position = np.rint(skeleton.z_up(place) * _ROUNDED) / _ROUNDED
        return mps.AriaTrajectory(device_start_us + ticks, position, rotation, np.ones(len(ticks)))

    # The eyes and head of the wearer; the frame of the glasses on the head is of no consequence here.
    glasses = device(skeleton.rotation_matrices(motion.head_rotation), motion.eye, _SLIP, generator("slip"))
    rng = generator("wristbands")
    wristbands = []
    for wrist in skeleton.WRISTS:
        # A band sits on the wrist at a place and a turn of its own.
        hand = skeleton.rotation_matrices(motion.rotations[:, wrist])
        place = motion.joints[:, wrist] + hand @ rng.normal(0.0, _WRIST_PLACE, 3)
        worn = Rotation.from_rotvec(rng.uniform(-1.0, 1.0, 3)).as_matrix()
        wristbands.append(device(hand @ worn, place, _WRIST_SLIP, rng))
    return NymeriaReadings(motion.recording_id, suit, tuple(texts), glasses, offset_us / 1e6, tuple(wristbands))


def calibration_rotations() -> Float[np.ndarray, "23 3 3"]:
    """Return segment to world in the T-pose of synthetic people, Z up: their limbs have y along the bone.

    Their files do not hold it, as the T-pose of a real suit turns all segments alike.
    """
    turned = np.tile(np.eye(3), (len(Joint), 1, 1))
    down = np.diag([1.0, -1.0, -1.0])  # y along the hanging limb, x the hinge, to the left
    for joint in Joint:
        side = 1.0 if joint.name.startswith("LEFT") else -1.0
        if joint.name.endswith(("HIP", "KNEE")):
            turned[joint] = down
        elif joint.name.endswith(("SHOULDER", "ELBOW", "WRIST")):
            # Lifted to the side by a quarter turn about the forward axis.
            turned[joint] = np.array([[0.0, -side, 0.0], [side, 0.0, 0.0], [0.0, 0.0, 1.0]]) @ down
    joints = [int(_JOINT_OF_SEGMENT[name]) for name in skeleton.XSENS_SEGMENTS]
    return _Z_UP_FROM_Y_UP @ turned[joints] @ _OURS_FROM_SEGMENT


def _calibration_pose(motion: NarratedMotion) -> Float[np.ndarray, "23 3"]:
    """Return the wearer in a T-pose: upright, arms out to the sides; Z up, metres."""
    lengths = dict(zip(range(1, len(skeleton.PARENTS)), skeleton.bone_lengths(motion.joints[0]), strict=True))
    tilt = np.deg2rad(motion.neck_tilt_deg)
    directions = {
        Joint.LEFT_HIP: (0.6, -0.8, 0.0),
        Joint.HEAD: (0.0, np.cos(tilt), np.sin(tilt)),
        Joint.LEFT_COLLAR: (0.7, 0.7141428, 0.0),
        Joint.LEFT_KNEE: (0.0, -1.0, 0.0),
        Joint.LEFT_ANKLE: (0.0, -1.0, 0.0),
        Joint.LEFT_FOOT: (0.0, -0.4, 0.9165151),
        **dict.fromkeys((Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST), (1.0, 0.0, 0.0)),
        **dict.fromkeys((Joint.SPINE1, Joint.SPINE2, Joint.SPINE3, Joint.NECK), (0.0, 1.0, 0.0)),
    }
    for joint, direction in tuple(directions.items()):
        if joint.name.startswith("LEFT"):
            directions[Joint[joint.name.replace("LEFT", "RIGHT")]] = (-direction[0], *direction[1:])
    joints = np.zeros((len(skeleton.PARENTS), 3))
    joints[0, 1] = 1.0
    for child in range(1, len(skeleton.PARENTS)):
        joints[child] = joints[skeleton.PARENTS[child]] + lengths[child] * np.array(directions[Joint(child)])
    points = np.stack([joints[_JOINT_OF_SEGMENT[name]] for name in skeleton.XSENS_SEGMENTS])
    points[0] = 0.5 * (joints[Joint.LEFT_HIP] + joints[Joint.RIGHT_HIP])
    return skeleton.z_up(points)


_NO_GRAPH = "00000000-0000-0000-0000-000000000000"
_GRAVITY = (0.0, 0.0, -9.81)
_CREATED = "2000-01-01T00:00:00"


def write_nymeria(readings: NymeriaReadings, root: Path, *, trajectory: bool) -> None:
    """Write one sequence folder.

    Args:
        readings: All that the files say.
        root: Folder of the dataset.
        trajectory: Whether the trajectories of glasses and wristbands were downloaded; without them, clocks can be
            aligned by starts only.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    folder = root / readings.name
    # Write ``xdata.npz``; equal readings give equal bytes.
    path = folder / "body" / nymeria.SUIT_FILE
    suit = readings.suit
    n = len(suit.time_us)
    arrays = {
        "timestamps_us": suit.time_us,
        "frameCount": np.array([n]),
        "frameRate": np.array([round(nymeria.SUIT_RATE)]),
        "segmentCount": np.array([nymeria.N_SEGMENTS]),
        "segment_tXYZ": suit.position.reshape(n, -1),
        "segment_qWXYZ": suit.rotation.reshape(n, -1),
    }
    if suit.tpose is not None:
        arrays["tpose_segment_tXYZ"] = suit.tpose.ravel()
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)
    for kind, name in nymeria.NARRATION_FILES.items():
        rows = [row for row in readings.narrations if row.kind == kind]
        if not rows:
            continue
        text = io.StringIO()
        writer = csv.writer(text, quoting=csv.QUOTE_ALL, lineterminator="\r\n")
        writer.writerow([*nymeria.NARRATION_HEADER, *nymeria.ANSWER_COLUMNS[kind]])
        for number, row in enumerate(rows):
            times = (f"{row.start:.6f}", f"{row.end:.6f}")
            writer.writerow([number, number, *times, row.annotator, _CREATED, *(answer for _, answer in row.texts)])
        # With the byte order mark that the release has.
        write_bytes(folder / "narration" / name, text.getvalue().encode("utf-8-sig"))
    parts = readings.name.split("_")
    named = {"date": parts[0], "session_id": parts[1], "act_id": parts[-2], "uid": parts[-1]}
    invented = {"fake_name": nymeria.participant_of(readings.name), "script": "invented", "location": "nowhere"}
    write_json(folder / nymeria.METADATA_FILE, named | invented)
    if trajectory:
        devices = (readings.glasses, *readings.wristbands)
        for name, poses in zip(nymeria.DEVICE_FOLDERS, devices, strict=True):
            path = folder / name / "mps" / "slam" / nymeria.TRAJECTORY_FILE
            write_csv(path, mps.trajectory_columns(poses, _NO_GRAPH, _GRAVITY, None))
