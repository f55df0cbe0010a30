"""Clips, features, joints, SMPL parameters and files that cannot be meant."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from prbench.errors import UsageError
from prbench.geometry.skeleton import Joint, z_up
from prbench.representation import StatisticsAccumulator, UniformSkeleton, canonicalise, check_joints, encode, retarget
from prbench.representation.converters import (
    JointMap,
    SmplParameters,
    at_rate,
    at_times,
    check_limbs,
    check_sides,
    feature_rows,
    joint_map,
    joint_map_by_names,
    joints_from_features,
    motions_from_features,
    placed_on,
    quaternions_of,
    read_amass,
    read_feature_statistics,
    read_rest_joints,
    to_canonical,
    to_y_up,
)
from prbench.representation.converters.named_skeletons import LIMBS, parse_expression
from prbench.representation.converters.smpl import numbers_of
from prbench.representation.encoding import MIRRORED_JOINTS
from tests.fakes import STANDING, smooth_motion
from tests.laws.cases import BadInput
from tests.representation.converters.bodies import person, write_body_model


class Bomb:
    def __reduce__(self):
        return (RuntimeError, ("was unpickled",))


def clip(n_frames: int = 6, **joints: object) -> np.ndarray:
    """A motion with other positions of some joints: ``frame_2=(Joint.HEAD, value)``."""
    motion = smooth_motion("checks", n_frames)
    for frame, (joint, value) in joints.items():
        motion[int(frame.removeprefix("frame_")), joint] = value
    return motion


BONELESS = clip()
BONELESS[2, Joint.HEAD] = BONELESS[2, Joint.NECK]
FACING_NOWHERE = clip()
FACING_NOWHERE[0, [1, 2, 16, 17]] *= (0, 1, 0)
LEGLESS = np.stack([STANDING, STANDING])
LEGLESS[1, Joint.RIGHT_ANKLE] = LEGLESS[1, Joint.RIGHT_KNEE]
FOLDED = STANDING.astype(np.float32)
FOLDED[:, [0, 2]] = 0.0
CLIPS = {
    "frame 4, left_wrist: expected a finite position": clip(frame_4=(Joint.LEFT_WRIST, -np.inf)),
    "expected joint positions of the shape (frames, 22, 3), found (6, 24, 3)": np.zeros((6, 24, 3)),
    "expected a body in metres": clip() * 1000,
    "nearest to z. Turn the axes": clip()[..., [0, 2, 1]],
    "nearest to x. Turn the axes": clip()[..., [1, 0, 2]],
    "frame 2, head: expected a distance from neck": BONELESS,
}
FEATURES = encode(person())
HOLED = FEATURES.copy()
HOLED[7, 30] = np.nan
LIMB_NAMES = [joint.name.lower() for joint in LIMBS]
IDENTITY = {name: name for name in LIMB_NAMES}
CHAINS = [0, 2, 5, 8, 11, 1, 4, 7, 10, 3, 6, 9, 12, 15, 14, 17, 19, 21, 13, 16, 18, 20]
SWAPPED = person(start=600)[:, MIRRORED_JOINTS]
LYING = np.array([[1.0, 0, 0, 2.0, 0, 0]])


def given_to(_: Path, *, door: Callable[..., object], motion: np.ndarray) -> object:
    return door(motion, source="clip")


def expression(text: str) -> object:
    return parse_expression(text, ("Hips", "Left Hand", "neck", "head", "j1"), where="map")


def own_map(**given: str) -> object:
    return JointMap.of("own", LIMB_NAMES, IDENTITY | given)


def statistics(folder: Path, std: np.ndarray) -> object:
    np.save(folder / "Mean.npy", np.zeros(263))
    np.save(folder / "Std.npy", std, allow_pickle=True)
    return read_feature_statistics(folder / "Mean.npy", folder / "Std.npy")


def model(folder: Path, **arrays: np.ndarray) -> object:
    np.savez(folder / "model.npz", **arrays)
    return read_rest_joints(folder / "model.npz")


def pickled(folder: Path, name: str) -> object:
    (folder / name).write_bytes(pickle.dumps(Bomb()))
    return read_rest_joints(folder / name)


def shaped(folder: Path) -> object:
    write_body_model(folder / "model.npz", joints=55, shapes=20)  # ten of shape, ten of the face
    return read_rest_joints(folder / "model.npz").of(np.ones(16))


def amass(folder: Path) -> object:
    np.savez(folder / "clip.npz", trans=np.zeros((3, 3)))
    return read_amass(folder / "clip.npz")


BOMB = np.empty(1, dtype=object)
BOMB[0] = Bomb()
MODEL = {"v_template": np.zeros((60, 3)), "shapedirs": np.zeros((60, 3, 10))}
POSES, ARRAYS = SmplParameters.from_poses, SmplParameters.from_arrays
STILL = np.zeros((5, 3))

# From a part of the message to what is refused with it.
Refused = dict[str, Callable[[Path], object]]
REFUSED: Refused = {
    "nearest to -y": lambda _: check_joints(clip() * (1, -1, 1)),
    "expected 2 frames or more, found 1": lambda _: encode(clip(1)),
    "expected 2 frames or more, found 0": lambda _: encode(clip(1)[:0]),
    "frame 6, pelvis": lambda _: encode(clip(), next_joints=np.full((22, 3), np.nan)),
    "clip, frame 0: expected a pose with a heading": lambda _: canonicalise(FACING_NOWHERE, source="clip"),
    "initial_joints, frame 1, right_ankle": lambda _: UniformSkeleton.of(LEGLESS),
    # features
    f"for 0 frames, found {len(FEATURES)}": lambda _: joints_from_features(FEATURES, 0),
    f"for {len(FEATURES) + 2} frames, found {len(FEATURES)}": lambda _: joints_from_features(
        FEATURES, len(FEATURES) + 2
    ),
    "KIT skeleton of 21 joints": lambda _: feature_rows(np.zeros((10, 251))),
    "expected (batch, rows, 263)": lambda _: feature_rows(np.zeros((10, 66))),
    "features, row 7, column 30": lambda _: joints_from_features(HOLED),
    "glide, row 1 (sequence b): expected 99 rows": lambda _: motions_from_features(
        [FEATURES, FEATURES[:50]], [99, 99], source="glide", sequences="ab"
    ),
    "expected features of 2 motions": lambda _: motions_from_features([FEATURES], [9, 9]),
    "263 numbers, found shape (251,)": lambda folder: statistics(folder, np.ones(251)),
    "column 0: expected a finite number": lambda folder: statistics(folder, np.full(263, np.nan)),
    "0 or more, found -1. Is this Mean.npy": lambda folder: statistics(folder, -np.ones(263)),
    "Std.npy: expected numbers or text": lambda folder: statistics(folder, np.array([None] * 263)),
    "Mean.npy: expected this file": lambda folder: read_feature_statistics(folder / "Mean.npy", folder / "Std.npy"),
    # axes, units, rates
    "expected a frame rate above 0, found 0": lambda _: at_rate(np.zeros((3, 3)), 0.0),
    "expected a frame rate above 0, found -1": lambda _: at_rate(np.zeros((3, 3)), -1.0),
    "expected a frame rate above 0, found nan": lambda _: at_rate(np.zeros((3, 3)), np.nan),
    "frame 2: expected increasing times, after 0.1 s, found 0.1 s": lambda _: at_times(
        np.array([0.0, 0.1, 0.1]), np.zeros((3, 3))
    ),
    "at least one": lambda _: at_times(np.zeros(0), np.zeros((0, 3))),
    # bodies
    "axis that points up": lambda _: to_canonical(z_up(person()), 20.0),
    "initial_joints, frame 0: expected a pose with a heading": lambda _: placed_on(person(), FOLDED),
    "a mean cosine of -0.9": lambda _: check_sides(SWAPPED),
    "feet and knees that point to the body's front": lambda _: check_sides(SWAPPED, feet=False),
    "then say left_handed=True": lambda _: to_canonical(person() * np.float32([1, 1, -1]), 20.0),
    "This looks like cm: say unit='cm'": lambda _: to_canonical(person() * np.float32(100), 20.0),
    "This looks like mm: say unit='mm'": lambda _: to_canonical(person() * np.float32(1000), 20.0),
    "This looks like inch: say unit='inch'": lambda _: to_canonical(person() / np.float32(0.0254), 20.0),
    "The order of the joints is another one": lambda _: check_limbs(person()[:, CHAINS]),
    "frame 3, left_wrist: expected a finite position": lambda _: check_limbs(clip(frame_3=(20, np.nan))),
    "one frame or more": lambda _: to_canonical(person()[:0], 20.0),
    "joints that lie on one another": lambda _: to_canonical(np.zeros((5, 22, 3)), 20.0),
    "(frames, 17, 3) for the skeleton 'coco-17', found (5, 18, 3)": lambda _: joint_map("coco-17").to_22(
        np.zeros((5, 18, 3))
    ),
    # SMPL
    "look like degrees": lambda _: quaternions_of(np.full((2, 3), 120.0), "axis-angle"),
    "unit quaternions, found one of the length 4": lambda _: quaternions_of(np.full((2, 4), 2.0), "quaternion-wxyz"),
    "determinant is -1": lambda _: quaternions_of(np.diag([1.0, 1.0, -1.0]).reshape(1, 9), "matrix"),
    "a multiple of 6": lambda _: quaternions_of(np.zeros((2, 7)), "6d-rows"),
    "two directions that lie along one another": lambda _: quaternions_of(LYING, "6d-columns"),
    "frame 1: expected finite": lambda _: quaternions_of(np.array([[0.0, 0, 0], [0, np.nan, 0]]), "axis-angle"),
    "22 or more rotations of 3 numbers": lambda _: POSES(np.zeros((5, 63)), STILL),
    "transl: expected finite (frames, 3)": lambda _: POSES(np.zeros((5, 66)), np.full((5, 3), np.inf)),
    "betas: expected finite": lambda _: POSES(np.zeros((5, 66)), STILL, betas=np.full(10, np.nan)),
    "body_pose: expected 5 frames": lambda _: ARRAYS(global_orient=STILL, body_pose=np.zeros((4, 63)), transl=STILL),
    "at most the 10 shape numbers": shaped,
    "opens no pickles. Convert the licensed file once": lambda folder: pickled(folder, "SMPL.pkl"),
    "a readable .npz file": lambda folder: pickled(folder, "SMPL.npz"),
    "expected numbers or text, found Python objects": lambda folder: model(
        folder, **MODEL, J_regressor=BOMB, other=BOMB
    ),
    "an array 'J_regressor'": lambda folder: model(folder, v_template=np.zeros((60, 3))),
    "the model of another body": lambda folder: model(folder, **MODEL, J_regressor=np.zeros((16, 60))),
    "prbench ships none": lambda folder: read_rest_joints(folder / "SMPLX_NEUTRAL.npz"),
    "an array 'poses'": amass,
}
MISUSED: Refused = {
    "found none": lambda _: StatisticsAccumulator().result(),
    "unknown up axis 'Z'": lambda _: to_y_up(np.ones((1, 3)), up="Z"),
    "unknown unit 'cms'. Did you mean 'cm'": lambda _: to_y_up(np.ones((1, 3)), unit="cms"),
    "above 0, found 0": lambda _: to_y_up(np.ones((1, 3)), unit=0.0),
    "Did you mean 'h36m-17'": lambda _: joint_map("h36m_17"),
    "joint map 'bvh': expected the twelve limb joints": lambda _: joint_map_by_names(["Hips", "Spine", "Head"]),
    "Did you mean '6d-rows'": lambda _: numbers_of("6d_rows"),
    "map: unknown joint 'nek'. Did you mean 'neck'": lambda _: expression("nek"),
    "unknown joint '@upp'. Did you mean '@up'": lambda _: expression("neck + 0.1 @upp"),
    "add up to 1, or of none, found '0.5 neck + 0.6 head' (1.1 in all)": lambda _: expression("0.5 neck + 0.6 head"),
    "weights of all joints, which add up to 1, or of none": lambda _: expression("0.5 neck + head"),
    "found 'neck - head'": lambda _: expression("neck - head"),
    "found '0.4 @up'": lambda _: expression("0.4 @up"),
    "expected joints and numbers such as '0.6 neck + 0.4 head', found ''": lambda _: expression(""),
    "expected joints and numbers such as '0.6 neck + 0.4 head', found '3'": lambda _: expression("3"),
    "'haed' is none of the 22 joints. Did you mean 'head'": lambda _: own_map(haed="left_hip"),
    "head: unknown joint 'left_hipp'. Did you mean 'left_hip'": lambda _: own_map(head="left_hipp"),
    "missing: right_hip, left_knee": lambda _: JointMap.of("own", LIMB_NAMES, {"left_hip": "left_hip"}),
    "named more than once: left_hip": lambda _: JointMap.of("own", [*LIMB_NAMES, "left_hip"], IDENTITY),
    "cannot themselves be offset": lambda _: own_map(left_hip="left_hip + 0.1 @up"),
}
BAD_INPUT = [
    *(
        BadInput(f"{door.__name__}: {told}", partial(given_to, door=door, motion=motion), (told,))
        for door in (encode, canonicalise, retarget)
        for told, motion in CLIPS.items()
    ),
    *(BadInput(f"representation: {told}", act, (told,)) for told, act in REFUSED.items()),
    *(BadInput(f"representation: {told}", act, (told,), UsageError) for told, act in MISUSED.items()),
]
