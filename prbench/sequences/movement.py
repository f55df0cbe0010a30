"""How far body and hand move in a sequence: two columns of the table, as Table 1 of the study reports them."""

from __future__ import annotations

import numpy as np

from prbench.skeleton import Joint


def body_movement(joints: np.ndarray) -> float:
    """Largest 3-D distance of the pelvis from frame 0, metres; joints (n, 22, 3)."""
    pelvis = joints[:, Joint.PELVIS]
    return float(np.linalg.norm(pelvis - pelvis[0], axis=1).max())


def hand_movement(joints: np.ndarray, wrist: int) -> float:
    """Largest displacement of one wrist relative to the pelvis (translation removed, heading not), metres."""
    relative = joints[:, wrist] - joints[:, Joint.PELVIS]
    return float(np.linalg.norm(relative - relative[0], axis=1).max())
