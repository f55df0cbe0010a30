"""Predictors without learning: zero velocity, constant velocity, and the nearest past of the training set.

Source: docs/specification/motion-prediction.md#predictors-without-learning.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, Predictor
from prbench_benchmarks.motion_prediction.joint_sets import JOINT_SETS, invert_each, rotations_alone, transform_each
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import Truth, WindowsTable

_ALL = frozenset(Condition)


def _repeated(joints: Float[np.ndarray, "batch future joints 3"], n_samples: int) -> Futures:
    """Repeat a future for every sample: these predictors know of no other."""
    return Futures(joints=np.repeat(joints[:, None], n_samples, axis=1).astype(np.float32))


@dataclass(frozen=True)
class ZeroVelocity:
    """The last observed pose, for ever."""

    name: str = "zero-velocity"
    conditions: frozenset[Condition] = _ALL

    def predict(self, batch: ObservedBatch, *, n_samples: int, seed: int) -> Futures:  # noqa: ARG002 - a protocol
        """See :class:`prbench_benchmarks.motion_prediction.batch.Predictor`; ``seed`` leaves no trace."""
        return _repeated(np.repeat(batch.observed_joints[:, -1:], batch.n_future, axis=1), n_samples)


@dataclass(frozen=True)
class ConstantVelocity:
    """Every joint goes on with the speed of its last two observed frames."""

    name: str = "constant-velocity"
    conditions: frozenset[Condition] = _ALL

    def predict(self, batch: ObservedBatch, *, n_samples: int, seed: int) -> Futures:  # noqa: ARG002 - a protocol
        """See :class:`prbench_benchmarks.motion_prediction.batch.Predictor`; ``seed`` leaves no trace.

        Raises:
            UsageError: for a single observed frame, which has no speed.
        """
        if batch.observed_joints.shape[1] < 2:
            raise UsageError(f"{self.name}: expected two observed frames or more, found one.")
        last = batch.observed_joints[:, -1].astype(np.float64)
        step = last - batch.observed_joints[:, -2]
        return _repeated(last[:, None] + np.arange(1, batch.n_future + 1)[:, None, None] * step[:, None], n_samples)


@dataclass(frozen=True)
class TrainingWindows:
    """The windows of a table that a predictor may learn from.

    Attributes:
        published: They are the training split of the published evaluation, in place of the dataset's.
    """

    folder: Path
    published: bool = False

    def batches(self, condition: Condition, *, size: int = 64) -> Iterator[tuple[ObservedBatch, Truth]]:
        """Yield the windows of the training split with what happened, as a run shows those of another split.

        Args:
            condition: What is known of the observed frames.
            size: Windows of a batch.

        Raises:
            UsageError: if there is none.
        """
        table = WindowsTable.open(self.folder)
        frame = load_prediction_protocol().evaluation.frame
        return table.batches(condition, table.training(published=self.published), frame=frame, size=size)


@dataclass
class NearestPast:
    """Sample k is the future of the training window whose observed frames are k-th nearest.

    Pasts are compared, and futures placed, with the pelvis of the last observed frame over the origin facing +Z. A gaze
    that is given counts as one more joint, a metre from the origin.

    Attributes:
        _remembered: Maps each condition to the observed frames of the windows, flattened, and their futures.
    """

    name: str = "nearest-past"
    conditions: frozenset[Condition] = _ALL
    train: TrainingWindows | None = None
    _remembered: dict[Condition, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def fit(self, train: TrainingWindows) -> None:
        """Remember which windows may be learnt from; they are read when the condition is known."""
        self.train = train

    def remember(self, batches: Iterable[tuple[ObservedBatch, Truth]]) -> NearestPast:
        """Remember windows of the training split, all of one condition.

        Raises:
            UsageError: if there is none.
        """
        pasts = []
        futures = []
        condition = Condition.POSE
        for batch, truth in batches:
            condition = batch.condition
            frames, features = _own_frame(batch)
            pasts.append(features)
            # Windows of an anchored table end with the event: their last pose is held, as nothing is known after it.
            shown = np.minimum(np.arange(batch.n_future), truth.n_scored[:, None] - 1)
            whole = np.take_along_axis(truth.joints, shown[:, :, None, None], axis=1)
            futures.append(transform_each(invert_each(frames), whole).astype(np.float32))
        if not futures:
            raise UsageError("nearest-past: expected windows to remember, found none.")
        self._remembered[condition] = (np.concatenate(pasts), np.concatenate(futures))
        return self

    def predict(self, batch: ObservedBatch, *, n_samples: int, seed: int) -> Futures:  # noqa: ARG002 - a protocol
        """See :class:`prbench_benchmarks.motion_prediction.batch.Predictor`; ``seed`` leaves no trace.

        Raises:
            UsageError: if it was not fitted, remembers fewer windows than samples are asked for, or windows of another
                length or of other joints.
        """
        if batch.condition not in self._remembered:
            if self.train is None:
                raise UsageError(f"{self.name}: expected to be fitted to a table of windows first; `prbench run` does.")
            self.remember(self.train.batches(batch.condition))
        pasts, known = self._remembered[batch.condition]
        if n_samples > len(known):
            raise UsageError(f"{self.name}: expected at most {len(known)} samples, found {n_samples}.")
        frames, features = _own_frame(batch)
        shapes = (pasts.shape[1], *known.shape[1:3])
        asked = (features.shape[1], batch.n_future, len(batch.joint_names))
        if asked != shapes:
            raise UsageError(
                f"{self.name}: it remembers windows of {shapes[1]} future frames and {shapes[2]} joints ({shapes[0]}"
                f" observed numbers), these have {asked[1]} and {asked[2]} ({asked[0]}). Fit it to windows like these."
            )
        apart = cdist(features, pasts)
        # Stable, so that a tie is not broken by how many samples are asked for.
        nearest = np.argsort(apart, axis=1, kind="stable")[:, :n_samples]
        return Futures(joints=transform_each(frames, known[nearest]).astype(np.float32))


def _own_frame(batch: ObservedBatch) -> tuple[Float[np.ndarray, "batch 4 4"], Float[np.ndarray, "batch values"]]:
    """``batch_from_own`` of each window, and its observed frames in the frame of its last pose, flattened."""
    joints = next(each for each in JOINT_SETS.values() if each.names == batch.joint_names)
    frames = joints.last_pose_frame(batch.observed_joints[:, -1])
    own_from_batch = invert_each(frames)
    features = [transform_each(own_from_batch, batch.observed_joints).reshape(len(batch), -1)]
    if batch.gaze is not None:
        features.append(transform_each(rotations_alone(own_from_batch), batch.gaze).reshape(len(batch), -1))
    return frames, np.concatenate(features, axis=1)


def _loaded(
    kind: type[ZeroVelocity] | type[ConstantVelocity] | type[NearestPast],
    weights: Path | None,
    *,
    options: Mapping[str, str],
    device: str,  # noqa: ARG001 - they run anywhere
) -> Predictor:
    """Entry point of the group ``prbench.predictors``: return a predictor that has neither weights nor options.

    One that learns from a table has ``fit(train)`` as well, which a run calls where the user gave no weights; it is
    shown the training split alone.
    """
    if weights is not None:
        raise ValueError(f"{kind.name} has no weights.")
    if options:
        raise ValueError(f"unknown option '{next(iter(options))}'; {kind.name} has none.")
    return kind()


zero_velocity = partial(_loaded, ZeroVelocity)
constant_velocity = partial(_loaded, ConstantVelocity)
nearest_past = partial(_loaded, NearestPast)
