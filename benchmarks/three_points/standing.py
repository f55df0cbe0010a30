"""A tracker that learns nothing: a body that stands below the head, with its arms at the wrists."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import PARENTS, WRISTS, Joint, forward_kinematics, rotation_matrices
from prbench.synthetic.people.kinematics import two_bone
from prbench_benchmarks.three_points.batch import Bodies, Condition, TrackedBatch

_ARM_DOWN = np.deg2rad(80.0)  # from the T-pose
_STRETCH = (0.97, 0.999)  # of an arm, at which reaching is softened, and never passed


class Standing:
    """A lower bound: upright, turned like the head, legs straight; wrists where they are known, else hanging."""

    name = "standing"
    conditions = frozenset(Condition)

    def track(self, batch: TrackedBatch, *, seed: int) -> Bodies:  # noqa: ARG002 - a protocol
        """See :class:`prbench_benchmarks.three_points.batch.Tracker`; ``seed`` leaves no trace."""
        joints = np.full((*batch.position.shape[:2], len(Joint), 3), np.nan)
        for row, n in enumerate(batch.n_frames.tolist()):
            head = rotation_matrices(batch.rotation[row, :n, 0])
            local = np.tile(np.eye(3), (n, len(Joint), 1, 1))
            yaw = np.arctan2(head[:, 0, 2], head[:, 2, 2])
            local[:, Joint.PELVIS] = Rotation.from_euler("y", yaw[:, None]).as_matrix()
            for shoulder, side in ((Joint.LEFT_SHOULDER, -1.0), (Joint.RIGHT_SHOULDER, 1.0)):
                local[:, shoulder] = Rotation.from_euler("z", side * _ARM_DOWN).as_matrix()
            body, turned = forward_kinematics(batch.offsets[row], np.zeros((n, 3)), local, PARENTS)
            body += (batch.position[row, :, 0][:n] - body[:, Joint.HEAD])[:, None]
            for place, wrist in enumerate(WRISTS, start=1):
                known = batch.valid[row, :n, place]
                elbow = PARENTS[wrist]
                lengths = np.linalg.norm(batch.offsets[row, [elbow, wrist]], axis=-1)
                pole = turned[known, 0] @ np.array([0.0, -1.0, -0.5])  # elbows point down and back
                target = batch.position[row, :n, place][known]
                reached = two_bone(body[known, PARENTS[elbow]], target, tuple(lengths.tolist()), pole, _STRETCH)
                body[known, elbow], body[known, wrist] = reached
            joints[row, :n] = body
        return Bodies(joints=joints)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> Standing:  # noqa: ARG001 - runs anywhere
    """Entry point of the group ``prbench.trackers``: return the tracker, which has neither weights nor options."""
    if weights is not None or options:
        raise ValueError(f"{Standing.name} has neither weights nor options.")
    return Standing()
