"""All that a predictor is given, and what it answers: the firewall between it and the future, as types."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import AdapterError, UsageError
from prbench.randomness import named_generator


class Condition(StrEnum):
    """What a predictor knows of the observed frames.

    Attributes:
        POSE_HEAD: The head's direction, computed from the joints, stands in the place of gaze.
    """

    POSE = "pose"
    POSE_HEAD = "pose+head"
    POSE_GAZE = "pose+gaze"


@dataclass(frozen=True, kw_only=True)
class ObservedBatch:
    """The observed frames of B windows, and nothing later in any form. Metres, Y up.

    There is no target, no event time, no id and no path here, and no array is a view of one that holds more. The number
    of frames to predict is the same for all windows of a table, so that it does not tell when an event happens.

    Attributes:
        n_future: Frames to predict.
        observed_joints: Positions in the room, or in the frame of each window's last observed pose.
        key: One a window, 63 bits: with the seed and the sample's number the only source of randomness.
        gaze: Unit directions in the frame of the joints: of gaze, or of the head with ``pose+head``; None with
            ``pose``.
        gaze_valid: True where ``gaze`` was measured; elsewhere it is the last one measured before, or +Z if there
            was none.
    """

    condition: Condition
    fps: float
    n_future: int
    joint_names: tuple[str, ...]
    observed_joints: Float[np.ndarray, "batch observed joints 3"]
    key: tuple[int, ...]
    gaze: Float[np.ndarray, "batch observed 3"] | None = None
    gaze_valid: Bool[np.ndarray, "batch observed"] | None = None

    def __post_init__(self) -> None:
        batch, observed, joints, axes = self.observed_joints.shape
        if axes != 3 or joints != len(self.joint_names):
            raise ValueError(f"observed_joints: expected (B, H, {len(self.joint_names)}, 3), found {self.shape}")
        given = self.gaze is not None
        if given is (self.condition is Condition.POSE) or given is not (self.gaze_valid is not None):
            raise ValueError(f"condition {self.condition.value}: gaze must {'not ' if given else ''}be given")
        for name, shape in (("gaze", (batch, observed, 3)), ("gaze_valid", (batch, observed))):
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                raise ValueError(f"{name}: expected shape {shape}, found {array.shape}")
        if len(self.key) != batch:
            raise ValueError(f"key: expected {batch}, one a window, found {len(self.key)}")
        for name in ("observed_joints", "gaze", "gaze_valid"):
            array = getattr(self, name)
            if array is not None:
                # A view would lead back to the frames behind it through ``base``.
                alone = np.array(array, order="C")
                alone.flags.writeable = False
                object.__setattr__(self, name, alone)

    def __len__(self) -> int:
        return len(self.observed_joints)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the observed joints: batch, frames, joints, 3."""
        return self.observed_joints.shape

    def rows(self, start: int, stop: int) -> ObservedBatch:
        """Return a part of the batch; every row is complete in itself."""
        return self.chosen(range(start, stop))

    def chosen(self, rows: Sequence[int]) -> ObservedBatch:
        """Return some rows of the batch, in the order given."""
        places = np.asarray(rows, dtype=np.int64)
        arrays = {name: getattr(self, name) for name in ("observed_joints", "gaze", "gaze_valid")}
        chosen = {name: values[places] for name, values in arrays.items() if values is not None}
        return replace(self, key=tuple(self.key[place] for place in places), **chosen)


@dataclass(frozen=True, kw_only=True)
class Futures:
    """K possible continuations of each window.

    Attributes:
        joints: Metres, in the frame of the batch that they answer.
    """

    joints: Float[np.ndarray, "batch samples future joints 3"]


@runtime_checkable
class Predictor(Protocol):
    """What predicts: no frame but the observed ones reaches it.

    A predictor whose K samples are one design, so that fewer are no part of more, says so by ``one_design = True``: it
    has no scores of fewer samples than it was asked for.
    """

    @property
    def name(self) -> str:
        """Return the name that tables show."""
        ...

    @property
    def conditions(self) -> frozenset[Condition]:
        """The conditions that it accepts."""
        ...

    def predict(self, batch: ObservedBatch, *, n_samples: int, seed: int) -> Futures:
        """Predict ``n_samples`` futures of each window.

        Sample k of a window depends on ``seed``, the window's key and k alone (see :func:`sample_generator`), so that
        fewer samples are a prefix of more, and the batch around a window leaves no trace.
        """
        ...


def ask(predictor: Predictor, batch: ObservedBatch, *, n_samples: int, seed: int) -> Futures:
    """Ask a predictor, and hold its answer against the question.

    Raises:
        UsageError: for less than one sample, or a condition that it does not accept.
        AdapterError: if the answer does not fit (see :func:`require_futures`).
    """
    if n_samples < 1:
        raise UsageError(f"expected one sample or more, found {n_samples}.")
    if batch.condition not in predictor.conditions:
        known = ", ".join(sorted(condition.value for condition in predictor.conditions))
        remedy = f"it takes: {known}."
        raise UsageError(f"{predictor.name} does not accept the condition '{batch.condition.value}'; {remedy}")
    futures = predictor.predict(batch, n_samples=n_samples, seed=seed)
    return require_futures(futures, batch, n_samples, predictor=predictor.name)


def require_futures(answer: object, batch: ObservedBatch, n_samples: int, *, predictor: str) -> Futures:
    """Return what a predictor answered, if it is an answer to the question.

    Args:
        answer: What ``predict`` returned.
        batch: What it was asked.
        n_samples: Futures of each window.
        predictor: Its name, for messages.

    Raises:
        AdapterError: for anything but futures, for another shape, values that are no decimals or not finite, or the
            past instead of a future.
    """
    if not isinstance(answer, Futures):
        problem = f"expected prbench_benchmarks.motion_prediction.batch.Futures, found {type(answer).__name__}."
        advice = "Return Futures(joints=…) with joints of (windows, samples, frames, joints, 3)."
        raise AdapterError(f"{predictor}: {problem} {advice}")
    found = np.shape(answer.joints)
    expected = (len(batch), n_samples, batch.n_future, len(batch.joint_names), 3)
    if found != expected:
        problem = f"expected futures of shape {expected} (windows, samples, frames, joints, 3), found {found}."
        advice = "Return one future a sample, without the observed frames."
        raise AdapterError(f"{predictor}: {problem} {advice}")
    kind = np.asarray(answer.joints).dtype
    if not np.issubdtype(kind, np.floating):
        raise AdapterError(f"{predictor}: expected positions with decimals, found {kind}. Return float32, metres.")
    if not np.isfinite(answer.joints).all():
        raise AdapterError(f"{predictor}: expected finite positions, found NaN or infinity among the futures.")
    observed = batch.observed_joints
    shared = min(observed.shape[1], batch.n_future)
    moving = np.ptp(observed, axis=1).max() > 0 if len(batch) else False
    if shared > 1 and moving and (answer.joints[:, :, :shared] == observed[:, None, :shared]).all():
        remedy = "Return the frames after them alone."
        raise AdapterError(f"{predictor}: its futures begin with the {shared} observed frames. {remedy}")
    return answer


def window_key(window_id: str) -> int:
    """63 bits that name a window without telling which one it is."""
    return int.from_bytes(hashlib.sha256(f"window/{window_id}".encode()).digest()[:8], "big") >> 1


def sample_generator(seed: int, key: int, sample: int) -> np.random.Generator:
    """Return the generator of one sample of one window."""
    return named_generator("motion-prediction", seed, key, sample)
