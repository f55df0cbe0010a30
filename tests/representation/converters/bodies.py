"""Known motions, and what other skeletons, suits and body models would say of them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.readers.egoallo.synthetic import model_rotations, synthetic_smplh
from prbench.representation import canonicalise
from prbench.synthetic.people.perform import perform

SKELETON_FPS = 60.0


@cache
def person(n_frames: int = 240, start: int = 300) -> np.ndarray:
    """A procedural person (n_frames, 22, 3) of a kitchen, canonical frame, float32: turns, walks, reaches, bends."""
    performance = perform("hd-epic", seed=11, index=3, n_events=2, provocations={})
    return canonicalise(performance.joints[start : start + n_frames].astype(np.float32))


@cache
def person_rotations(n_frames: int = 240, start: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Joints (n, 22, 3) of an invented body in its own world, and rotations (n, 22, 3, 3) in the parents' frames."""
    performance = perform("hd-epic", seed=11, index=3, n_events=2, provocations={})
    part = slice(start, start + n_frames)
    world = model_rotations(performance.rotations[part])
    world = Rotation.from_quat(world.reshape(-1, 4), scalar_first=True).as_matrix().reshape(-1, N_JOINTS, 3, 3)
    local = world.copy()
    for joint in range(1, N_JOINTS):
        local[:, joint] = np.swapaxes(world[:, PARENTS[joint]], -1, -2) @ world[:, joint]
    rest = synthetic_smplh().template
    joints = np.empty((n_frames, N_JOINTS, 3))
    joints[:, 0] = performance.joints[part, 0]
    for joint in range(1, N_JOINTS):
        bone = rest[joint] - rest[PARENTS[joint]]
        joints[:, joint] = joints[:, PARENTS[joint]] + world[:, PARENTS[joint]] @ bone
    return joints, local


def write_body_model(path: Path, *, joints: int, points: int = 60, shapes: int = 10, seed: int = 0) -> np.ndarray:
    """An ``.npz`` in the layout of SMPL (24 joints), SMPL-H (52) or SMPL-X (55): invented points, random shapes.

    Returns:
        The first 22 rest joints, metres.
    """
    rng = np.random.default_rng(seed)
    rest = synthetic_smplh().template
    template = rng.normal(size=(points, 3)) * 0.3
    template[:N_JOINTS] = rest
    hands = [20 + index % 2 for index in range(joints - N_JOINTS)]
    arrays = {
        "J_regressor": np.eye(joints, points),
        "v_template": template,
        "shapedirs": rng.normal(size=(points, 3, shapes)) * 0.01,
        "posedirs": (rng.normal(size=(points, 3, (joints - 1) * 9)) * 0.001).astype(np.float32),
        "weights": np.eye(points, joints),
        "f": np.zeros((4, 3), dtype=np.int64),
        "kintree_table": np.array([[*PARENTS, *hands], range(joints)]),
    }
    if joints > 24:
        for side in "lr":
            arrays[f"hands_components{side}"], arrays[f"hands_mean{side}"] = np.eye(45), rng.normal(size=45)
    if joints == 55:
        arrays["lmk_faces_idx"], arrays["lmk_bary_coords"] = np.zeros(51, dtype=np.int64), np.full((51, 3), 1 / 3)
        arrays["joint2num"] = np.array({"Pelvis": 0}, dtype=object)  # the official file holds such dictionaries
    np.savez(path, **arrays)
    return rest


def mean_error(joints: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance of all joints, metres."""
    return float(np.linalg.norm(joints - truth, axis=-1).mean())


def joint_errors(joints: np.ndarray, truth: np.ndarray) -> dict[Joint, float]:
    """Mean distance of each joint, metres."""
    return dict(zip(Joint, np.linalg.norm(joints - truth, axis=-1).mean(axis=0), strict=True))
