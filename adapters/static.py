"""Static: the mean pose of all training frames, held still (docs/specification/metrics.md#ceilings-and-static).

A lower bound without conditions. Averaging joints of people who face and stand differently shrinks the limbs, which is
part of the baseline as the study describes it ("average full-body pose of training data").
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from prbench.contract import Condition, ConditionBatch, Motions, TrainingRun
from prbench.errors import AdapterError
from prbench.files.bounded import require
from prbench.files.storage import read_json, write_json
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.sequences import SequenceTable

_CHECKPOINT = "mean_pose.json"
_OPTIONS = {"pose-only": ("true", "false")}


class Static:
    """Repeats one pose for as many frames as asked."""

    name = "static"
    conditions = frozenset({Condition.NONE})
    motionless = True  # Foot Skating of a body that stands still says nothing

    def __init__(self, *, pose_only: bool = False) -> None:
        self.pose_only = pose_only
        self._pose: np.ndarray | None = None  # (22, 3), canonical frame, metres

    def fit(self, train: SequenceTable, *, validation: SequenceTable | None, run: TrainingRun) -> None:  # noqa: ARG002
        """Take the mean over all frames of all training sequences, or what an earlier fit in ``run.folder`` found.

        Raises:
            AdapterError: if the table has no training sequences.
        """
        checkpoint = run.folder / _CHECKPOINT
        # A resumed run reads what the first one found, to the last digit.
        if not checkpoint.is_file():
            write_json(checkpoint, mean_pose(train).tolist())
        pose = np.asarray(read_json(checkpoint), dtype=np.float64)
        fits = pose.shape == (N_JOINTS, 3)
        require(checkpoint, (fits, "", "22 joints with x, y, z", f"shape {pose.shape}", "Delete it."))
        self._pose = pose
        if self.pose_only:
            self._pose[:, [0, 2]] -= self._pose[Joint.PELVIS, [0, 2]]

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - nothing is drawn
        """Return the mean pose, ``batch.n_frames`` times."""
        if self._pose is None:
            raise AdapterError("adapter 'static' was asked for motions before it was fitted to a table.")
        joints = np.broadcast_to(self._pose, (len(batch), int(batch.n_frames.max()), N_JOINTS, 3))
        return Motions(joints, batch.n_frames)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> Static:  # noqa: ARG001 - runs anywhere
    """Entry point ``static``; option ``pose-only=true`` puts the pelvis over the origin."""
    if weights is not None:
        raise ValueError("static has no weights; it takes the mean of the table that it is run on.")
    for key, value in options.items():
        if key not in _OPTIONS:
            raise ValueError(f"unknown option '{key}'; known options: {', '.join(_OPTIONS)}.")
        if value not in _OPTIONS[key]:
            raise ValueError(f"option '{key}': expected {' or '.join(_OPTIONS[key])}, found '{value}'.")
    return Static(pose_only=options.get("pose-only") == "true")


def mean_pose(train: SequenceTable) -> np.ndarray:
    """Mean of the canonical joints over all frames of the ``train`` split, (22, 3) float64, metres.

    Raises:
        AdapterError: if there is no such sequence.
    """
    total = np.zeros((N_JOINTS, 3))
    frames = 0
    for chunk in train.chunks(split="train", columns=["joints"]):
        # Millions of float32 frames would lose the last digits of the mean.
        total += chunk.joints.sum(axis=0, dtype=np.float64)
        frames += len(chunk.joints)
    if not frames:
        raise AdapterError(f"adapter 'static' needs training sequences, but {train.folder} has none in split 'train'.")
    return total / frames
