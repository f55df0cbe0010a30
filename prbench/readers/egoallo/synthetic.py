"""EgoAllo as a sensor of synthetic people: a body model with SMPL-H's keys, estimates in its terms, and their files.

Sixteen shape directions are the sixteen lengths in which people of all presets differ, so that rest joints are exact
(docs/specification/synthetic-recordings.md#native-layouts). Nothing of the licensed model is in it.

The head is exact, since it is what the estimate is made from. Elbows and knees wander, feet slip, wrists stay within
2 cm (the real estimate is aligned to tracked wrists), and every window stands a little too high or too low. Bones keep
their lengths, as in any output of a body model.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.files.storage import atomic_path, write_text
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.geometry.timelines import interpolate, slerp
from prbench.protocol.manifests import read_toml
from prbench.readers.aria_mps.format import AriaTrajectory, GlassesSize, device_from_cpf
from prbench.readers.egoallo import format as ego
from prbench.representation.converters import RestJoints
from prbench.representation.converters.smpl import REGRESSOR, SHAPES, TEMPLATE
from prbench.synthetic.people.kinematics import soft_limit, two_bone, wobble
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Sensing, Switches

_STATURE = 1.70  # of the template person, metres
_UNIT = 0.05  # a shape number of 1 is this share of the template's length

# Bones by the joint that they end at, a group a shape direction; the file says in which units.
_BODY = read_toml("prbench.readers.egoallo", "template_body.toml", dict[str, list[dict[str, list[float]]]])
_GROUPS = [{Joint[name.upper()]: bone for name, bone in group.items()} for group in _BODY["groups"]]
_NECK_LENGTH = 0.0593
_NECK_TILT = np.deg2rad(38.3)
_HEAD_BONE = _NECK_LENGTH * np.array([0.0, np.cos(_NECK_TILT), np.sin(_NECK_TILT)])
_EXACT = 1e-7  # metres; people are made of these lengths


@cache
def synthetic_smplh() -> RestJoints:
    """Return the synthetic model: rest joints of a mean person, and what each of the 16 shape numbers adds to them."""
    bones = np.zeros((N_JOINTS, 3, len(_GROUPS)))
    for number, group in enumerate(_GROUPS):
        for joint, bone in group.items():
            bones[joint, :, number] = bone
            if joint.name.startswith("LEFT_"):
                bones[joint + 1, :, number] = np.multiply(bone, (-1.0, 1.0, 1.0))
    bones *= _STATURE
    joints = np.zeros_like(bones)
    for child in range(1, N_JOINTS):
        joints[child] = joints[PARENTS[child]] + bones[child]
    return RestJoints(joints.sum(axis=-1), joints * _UNIT)


def shape_of(performance: Performance) -> Float[np.ndarray, "16"]:
    """Return the shape numbers that give the person's own rest joints, but for the head.

    Whoever is seen, a body model puts the head joint where *it* has one: the neck-head bone leans by 38.3 degrees,
    also in people whose own suit says 7.4 (the head tilts of the manifests).

    Raises:
        ValueError: if the model cannot express the person: a preset whose bodies differ in other lengths.
    """
    rest = synthetic_smplh()
    # The person's bones in the model's rest pose: measured in the parents' frames, where they never change.
    bones = np.zeros((N_JOINTS, 3))
    rotations = model_rotations(performance.rotations[:1])
    for child in range(1, N_JOINTS):
        parent = PARENTS[child]
        bone = performance.joints[0, child] - performance.joints[0, parent]
        bones[child] = Rotation.from_quat(rotations[0, parent], scalar_first=True).inv().apply(bone)
    wanted = bones
    wanted[Joint.HEAD] = _HEAD_BONE * performance.person.body.stature
    directions = np.stack([_bones_of(rest.directions[..., k]) for k in range(ego.N_BETAS)], axis=-1)
    missing = (wanted - _bones_of(rest.template)).reshape(-1)
    betas, *_ = np.linalg.lstsq(directions.reshape(-1, ego.N_BETAS), missing, rcond=None)
    left_over = np.abs(directions.reshape(-1, ego.N_BETAS) @ betas - missing).max()
    if left_over > _EXACT:
        raise ValueError(f"{performance.preset}: a bone differs by {left_over:.6f} m from what the model can express")
    return betas


def _bones_of(joints: Float[np.ndarray, "22 3"]) -> Float[np.ndarray, "22 3"]:
    """Return each joint minus its parent; zero for the pelvis."""
    return joints - joints[np.maximum(np.array(PARENTS), 0)]


def model_rotations(segments: Float[np.ndarray, "n 22 4"]) -> Float[np.ndarray, "n 22 4"]:
    """Return the world rotations of the model's joints from those of a performance's segments.

    The two differ in the limbs: a segment has y along its bone, the model's rest pose has legs downwards and arms
    sideways.
    """
    turned = segments.copy()
    for joints, segment_from_rest in _LIMB_FRAMES:
        for joint in joints:
            rotation = Rotation.from_quat(segments[:, joint], scalar_first=True) * segment_from_rest
            turned[:, joint] = rotation.as_quat(scalar_first=True)
    return turned


_LIMB_FRAMES: tuple[tuple[tuple[Joint, ...], Rotation], ...] = (
    ((Joint.LEFT_HIP, Joint.LEFT_KNEE, Joint.RIGHT_HIP, Joint.RIGHT_KNEE), Rotation.from_euler("x", np.pi)),
    ((Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST), Rotation.from_euler("z", np.pi / 2)),
    ((Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST), Rotation.from_euler("z", -np.pi / 2)),
)


# The performance's Y up to the Z up of native worlds: (x, y, z) becomes (x, -z, y).
NATIVE_FROM_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])

_LIMB_WOBBLE = 0.02
_LIMB_HZ = (0.1, 0.5)
_WRIST_WOBBLE = 0.008  # metres an axis; never further from the true wrist
_WRIST_LIMIT = 0.02
_FOOT_SLIP = 0.015
_FOOT_HZ = (0.3, 0.8)
_ROOT_HEIGHT = 0.01
_STRETCH = (0.9985, 0.9999)  # of a limb that a shifted trunk pulls away from its hand or foot
_SHORTEST_WINDOW = 2  # frames
_DAY = "20000101-000000"


def sense_egoallo(
    performance: Performance,
    trajectory: AriaTrajectory,
    *,
    noise: float = 1.0,
    switches: Switches | None = None,
    start_us: int | None = None,
    size: GlassesSize = "DVT-S",
    native_from_world: Float[np.ndarray, "4 4"] = NATIVE_FROM_WORLD,
) -> tuple[ego.EgoAlloOutput, ...]:
    """Return what EgoAllo would write for a performance: several overlapping windows of every 33rd pose.

    Args:
        performance: The truth.
        trajectory: All 1 kHz poses of the glasses in the native (Z up) world.
        noise: Multiplies every error; 0 for an ideal estimate.
        switches: Which errors are on; all if None.
        start_us: Device time of the performance's first instant; that of the first pose by default.
        size: Size of the glasses.
        native_from_world: Transform from the performance's world to the trajectory's.
    """
    sensing = Sensing(performance, noise, switches or Switches())
    every = np.arange(ego.INPUT_STEP, len(trajectory.time_us), ego.INPUT_STEP)  # the first has no predecessor
    # The first and last frame of each window, in output frames; the last one ends with the recording.
    n_frames = len(every)
    starts = range(0, max(n_frames - ego.WINDOW_OVERLAP, 1), ego.WINDOW_FRAMES - ego.WINDOW_OVERLAP)
    windows = [(first, min(first + ego.WINDOW_FRAMES, n_frames)) for first in starts]
    windows = [(first, last) for first, last in windows if last - first >= _SHORTEST_WINDOW]
    frames = np.concatenate([np.arange(*window) for window in windows]) if windows else np.zeros(0, dtype=np.int64)
    rows = every[frames]
    since_start = (trajectory.time_us[rows] - (trajectory.time_us[0] if start_us is None else start_us)) / 1e6
    times = performance.times[0] + since_start
    number = np.repeat(np.arange(len(windows)), [last - first for first, last in windows])
    # The truth at some times; rotations are interpolated, so that bones keep their lengths.
    segments = np.stack(
        [slerp(performance.times, performance.rotations[:, joint], times) for joint in Joint], axis=1
    ).reshape(len(times), len(Joint), 4)
    rotations = model_rotations(segments)
    pelvis = interpolate(performance.times, performance.joints[:, Joint.PELVIS], times)
    rest = synthetic_smplh().of(shape_of(performance))
    # SciPy's own products along the tree: their last bits are those of the files.
    local = _local(rotations)
    world = [Rotation.from_quat(rotations[:, Joint.PELVIS], scalar_first=True)]
    joints = np.repeat(pelvis[:, None], len(Joint), axis=1)
    for child in range(1, len(Joint)):
        parent = PARENTS[child]
        joints[:, child] = joints[:, parent] + world[parent].apply(rest[child] - rest[parent])
        world.append(world[parent] * Rotation.from_quat(local[:, child - 1], scalar_first=True))
    joints, rotations = _estimate(sensing, joints, rotations, times, number)
    # The root pose in the native world, and local rotations; float32, as the files hold them.
    turn = Rotation.from_matrix(native_from_world[:3, :3])
    root = turn * Rotation.from_quat(rotations[:, Joint.PELVIS], scalar_first=True)
    position = turn.apply(joints[:, Joint.PELVIS]) + native_from_world[:3, 3]
    poses = np.hstack([root.as_quat(scalar_first=True), position])
    root, body = poses.astype(np.float32), _local(rotations).astype(np.float32)
    device = Rotation.from_quat(trajectory.rotation[rows], scalar_first=True)
    device_cpf = device_from_cpf(size)
    position = trajectory.position[rows] + device.apply(device_cpf[:3, 3])
    rotation = device * Rotation.from_matrix(device_cpf[:3, :3])
    cpf = np.hstack([rotation.as_quat(scalar_first=True), position]).astype(np.float32)
    betas = shape_of(performance).astype(np.float32)
    outputs = []
    for window, (first, last) in enumerate(windows):
        own = number == window
        poses = (cpf[own], root[None, own], body[None, own], np.tile(betas, (1, int(own.sum()), 1)))
        outputs.append(ego.EgoAlloOutput(f"{_DAY}_{first}-{last}.npz", trajectory.time_us[rows[own]] * 1000, *poses))
    return tuple(outputs)


def _estimate(
    sensing: Sensing,
    true: Float[np.ndarray, "n 22 3"],
    rotations: Float[np.ndarray, "n 22 4"],
    times: Float[np.ndarray, " n"],
    window: Int[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, "n 22 3"], Float[np.ndarray, "n 22 4"]]:
    """Return joints and rotations as they would be guessed: shifted as a whole, limbs bent so that ends stay near.

    Rotations are those of the model's joints, in the performance's world.
    """
    height = sensing.strength("root_height") * _ROOT_HEIGHT
    limbs = sensing.strength("limb_wobble")
    slip = sensing.strength("foot_slip")
    if height == limbs == slip == 0.0:
        return true, rotations
    draws = sensing.generator("egoallo-height").normal(0.0, height, int(window.max(initial=0)) + 1)
    joints = true.copy()
    joints[..., 1] += draws[window, None]
    rotations = rotations.copy()

    def wander(rms: float, band: tuple[float, float], rng: np.random.Generator) -> np.ndarray:
        return np.column_stack([wobble(times, rms, *band, rng) for _ in range(3)])

    def move(upper: int, middle: int, end: int, bend: np.ndarray, shift: np.ndarray) -> None:
        """Bring the end of a limb to its true place plus ``shift``, its middle joint wandering by ``bend``."""
        bones = true[:, middle] - true[:, upper], true[:, end] - true[:, middle]
        lengths = float(np.linalg.norm(bones[0][0])), float(np.linalg.norm(bones[1][0]))
        pole = true[:, middle] - (true[:, upper] + true[:, end]) / 2 + bend
        joint, tip = two_bone(joints[:, upper], true[:, end] + shift, lengths, pole, _STRETCH)
        for at, bone, new in ((upper, bones[0], joint - joints[:, upper]), (middle, bones[1], tip - joint)):
            # The rotation about the common normal that takes each direction to the new one.
            cross = np.cross(bone, new)
            sine = np.linalg.norm(cross, axis=1)
            angle = np.arctan2(sine, np.einsum("ni,ni->n", bone, new))
            turn = Rotation.from_rotvec(cross * (angle / np.maximum(sine, 1e-15))[:, None])
            turned = turn * Rotation.from_quat(rotations[:, at], scalar_first=True)
            rotations[:, at] = turned.as_quat(scalar_first=True)
        joints[:, middle], joints[:, end] = joint, tip

    rng_limbs = sensing.generator("egoallo-limbs")
    rng_feet = sensing.generator("egoallo-feet")
    for side in (0, 1):
        bend, reach = (wander(rms, _LIMB_HZ, rng_limbs) * limbs for rms in (_LIMB_WOBBLE, _WRIST_WOBBLE))
        length = np.linalg.norm(reach, axis=1, keepdims=True)
        reach *= soft_limit(length / _WRIST_LIMIT, 0.5, 0.95) * _WRIST_LIMIT / np.maximum(length, 1e-12)
        move(Joint.LEFT_SHOULDER + side, Joint.LEFT_ELBOW + side, Joint.LEFT_WRIST + side, bend, reach)
        bend = wander(_LIMB_WOBBLE, _LIMB_HZ, rng_limbs) * limbs
        step = wander(_FOOT_SLIP, _FOOT_HZ, rng_feet) * (slip, 0.0, slip)
        move(Joint.LEFT_HIP + side, Joint.LEFT_KNEE + side, Joint.LEFT_ANKLE + side, bend, step)
    return joints, rotations


def _local(rotations: Float[np.ndarray, "n 22 4"]) -> Float[np.ndarray, "n 21 4"]:
    """Return the rotations of the joints 1 to 21 in their parents."""
    world = [Rotation.from_quat(rotations[:, joint], scalar_first=True) for joint in Joint]
    local = [(world[PARENTS[child]].inv() * world[child]).as_quat(scalar_first=True) for child in range(1, len(Joint))]
    return np.stack(local, axis=1)


_NO_PARENT = 2**32 - 1


def write_outputs(outputs: Sequence[ego.EgoAlloOutput], folder: Path) -> None:
    """Write output files, each with its ``_args.yaml``, into ``folder`` (a recording's ``egoallo_outputs``).

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    for output in outputs:
        start, end = (int(part) for part in Path(output.name).stem.rpartition("_")[2].split("-"))
        samples, frames = output.world_from_root.shape[:2]
        straight = np.zeros((samples, frames, ego.N_HAND_QUATS, 4), dtype=np.float32)
        straight[..., 0] = 1.0
        with atomic_path(folder / output.name) as temporary:
            arrays = {
                ego.WORLD_FROM_CPF: output.world_from_cpf,
                ego.WORLD_FROM_ROOT: output.world_from_root,
                ego.BODY_QUATS: output.body_quats,
                ego.LEFT_HAND_QUATS: straight,
                ego.RIGHT_HAND_QUATS: straight,
                ego.CONTACTS: np.zeros((samples, frames, ego.N_BODY_QUATS), dtype=np.float32),
                ego.BETAS: output.betas,
                ego.FRAME_NUMS: np.arange(start, start + frames),
                ego.TIMES: output.time_ns,
            }
            np.savez(temporary, **arrays)
        arguments = f"start_index: {start}\ntraj_length: {end - start}\nnum_samples: {samples}\n"
        write_text(folder / f"{Path(output.name).stem}{ego.ARGUMENTS_SUFFIX}", arguments)


def write_smplh_model(path: Path) -> None:
    """Write the synthetic body model with the keys of an SMPL-H file: 52 points, one a joint; fingers at the wrists.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    rest = synthetic_smplh()
    n = ego.N_MODEL_JOINTS
    hands = np.repeat([20, 21], ego.N_HAND_QUATS)
    owner = np.concatenate([np.arange(22), hands])
    parents = np.concatenate([[_NO_PARENT], np.array(PARENTS[1:]), hands])
    with atomic_path(path) as temporary:
        arrays = {
            "f": np.array([[0, 1, 2]], dtype=np.int32),
            REGRESSOR: np.eye(n),
            "kintree_table": np.stack([parents, np.arange(n)]).astype(np.uint32),
            "weights": np.eye(n),
            "posedirs": np.zeros((n, 3, 9 * (n - 1))),
            TEMPLATE: rest.template[owner],
            SHAPES: rest.directions[owner],
        }
        np.savez(temporary, **arrays)
