"""The joint sets of motion prediction: the 22 joints of every dataset, and native ones of the published comparison.

Source: docs/specification/motion-prediction.md#joint-sets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from prbench.errors import UsageError
from prbench.geometry.skeleton import PARENTS, Joint, invert_rigid
from prbench.readers.mogaze.format import PARENT_LINKS


@dataclass(frozen=True)
class JointSet:
    """Names and parents of some joints, and which of them tell the heading and the wrists.

    Attributes:
        parents: Parent of each joint by name, in the order of the arrays; empty for the root.
    """

    name: str
    parents: Mapping[str, str]
    pelvis: str
    wrists: tuple[str, str]
    hips: tuple[str, str]
    shoulders: tuple[str, str]
    head: str = "head"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints in order."""
        return tuple(self.parents)

    def index(self, *names: str) -> list[int]:
        """Places of some joints."""
        return [self.names.index(name) for name in names]

    @property
    def bones(self) -> tuple[tuple[int, int], ...]:
        """(parent, child) of every bone, in the order of the child."""
        return tuple((self.names.index(parent), child) for child, parent in enumerate(self.parents.values()) if parent)

    @property
    def chains(self) -> tuple[tuple[int, ...], ...]:
        """Joints in a row from the root, or from where a limb leaves another one, to every end: lines of a drawing."""
        names = self.names
        parent = {name: each for name, each in self.parents.items() if each}
        seen: set[str] = set()
        found = []
        for end in reversed([name for name in names if name not in set(parent.values())]):
            chain = [end]
            while chain[-1] in parent and chain[-1] not in seen:
                seen.add(chain[-1])
                chain.append(parent[chain[-1]])
            found.append(tuple(names.index(name) for name in reversed(chain)))
        return tuple(reversed(found))

    def last_pose_frame(self, poses: Float[np.ndarray, "batch joints 3"]) -> Float[np.ndarray, "batch 4 4"]:
        """``room_from_batch`` of each pose: its pelvis over the origin, facing +Z; heights stay as they are.

        The heading is that of :func:`prbench.geometry.skeleton.facing_yaw`. A pose without a heading keeps the room's
        axes.

        Args:
            poses: Last observed poses, room, metres, Y up.
        """
        left_hip, right_hip = self.index(*self.hips)
        left_shoulder, right_shoulder = self.index(*self.shoulders)
        across = poses[:, right_hip] - poses[:, left_hip] + poses[:, right_shoulder] - poses[:, left_shoulder]
        across = across.astype(np.float64)
        length = np.hypot(across[:, 0], across[:, 2])
        known = length > 1e-9
        safe = np.where(known, length, 1.0)
        sine = np.where(known, across[:, 2] / safe, 0.0)  # forward is Y x across
        cosine = np.where(known, -across[:, 0] / safe, 1.0)
        frames = np.tile(np.eye(4), (len(poses), 1, 1))
        frames[:, 0, 0] = cosine
        frames[:, 0, 2] = sine
        frames[:, 2, 0] = -sine
        frames[:, 2, 2] = cosine
        frames[:, [0, 2], 3] = poses[:, self.index(self.pelvis)[0]][:, [0, 2]]
        return frames


_NAMES = tuple(joint.name.lower() for joint in Joint)
# The 22 joints of the sequence table, which every dataset has.
_PARENTS = {name: _NAMES[parent] if parent >= 0 else "" for name, parent in zip(_NAMES, PARENTS, strict=True)}
_WRISTS, _HIPS, _SHOULDERS = ((f"left_{part}", f"right_{part}") for part in ("wrist", "hip", "shoulder"))
SMPL22 = JointSet("smpl22", _PARENTS, "pelvis", _WRISTS, _HIPS, _SHOULDERS)

# The 21 links of MoGaze (docs/specification/mogaze.md#files).
MOGAZE21 = JointSet(
    name="mogaze21",
    parents=PARENT_LINKS,
    pelvis="base",
    wrists=("lWrist", "rWrist"),
    hips=("lHip", "rHip"),
    shoulders=("lShoulder", "rShoulder"),
)

# The 23 joints that GIMO's study scores: joints 0 to 22 of SMPL-X.
GIMO23 = replace(SMPL22, name="gimo23", parents={**SMPL22.parents, "jaw": "head"})

JOINT_SETS: Mapping[str, JointSet] = {each.name: each for each in (SMPL22, MOGAZE21, GIMO23)}


def joint_set(name: str) -> JointSet:
    """Return a joint set by name.

    Raises:
        UsageError: for an unknown one.
    """
    if name not in JOINT_SETS:
        raise UsageError(f"unknown joint set '{name}'; known ones are: {', '.join(JOINT_SETS)}.")
    return JOINT_SETS[name]


def transform_each(
    frames: Float[np.ndarray, "batch 4 4"], points: Float[np.ndarray, "batch *shape 3"]
) -> Float[np.ndarray, "batch *shape 3"]:
    """:func:`prbench.geometry.skeleton.transform_points` with a transform of its own for every row; float64.

    Written out axis by axis: a matrix product may round differently with another number of rows.
    """
    spread = frames.reshape(len(frames), *(1,) * (points.ndim - 2), 4, 4)
    x, y, z = (points[..., axis, None].astype(np.float64) for axis in range(3))
    return x * spread[..., :3, 0] + y * spread[..., :3, 1] + z * spread[..., :3, 2] + spread[..., :3, 3]


def invert_each(frames: Float[np.ndarray, "batch 4 4"]) -> Float[np.ndarray, "batch 4 4"]:
    """:func:`prbench.geometry.skeleton.invert_rigid` of every row."""
    return np.stack([invert_rigid(frame) for frame in frames])


def rotations_alone(frames: Float[np.ndarray, "batch 4 4"]) -> Float[np.ndarray, "batch 4 4"]:
    """Return the frames without their translation, for directions."""
    turns = frames.copy()
    turns[:, :3, 3] = 0.0
    return turns
