"""All that a tracker is given, and what it answers: the firewall between it and the body, as types."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.errors import AdapterError
from prbench.geometry.skeleton import Joint
from prbench.harness.planning import rows_of

# The joints whose poses the devices measure, in the order of all arrays of devices.
DEVICES = (Joint.HEAD, Joint.LEFT_WRIST, Joint.RIGHT_WRIST)


class Condition(StrEnum):
    """Which devices a tracker knows."""

    HEAD = "head"
    HEAD_WRISTS = "head+wrists"


@dataclass(frozen=True, kw_only=True)
class TrackedBatch:
    """The poses of head and wrists of B tracks, and nothing of the body but the lengths of its bones. World, Y up.

    Poses are those of joint frames: the identity where the body stands in the T-pose, facing +Z with x to its left.

    Attributes:
        fps: Frame rate of all tracks, frames per second.
        n_frames: Frames of each track; what stands beyond them is zero and not valid.
        position: Head, left wrist and right wrist, metres; zero where not valid.
        rotation: The same joints, joint frame to world, w x y z; the identity where not valid.
        valid: True where the position was measured; False at the wrists under the condition ``head``.
        rotation_valid: True where the rotation was measured.
        offsets: Each joint's rest offset from its parent in the T-pose, metres; the root's is zero.
        key: One a track, 63 bits: with the seed the only source of randomness.
    """

    condition: Condition
    fps: float
    n_frames: Int[np.ndarray, " batch"]
    position: Float[np.ndarray, "batch frames 3 3"]
    rotation: Float[np.ndarray, "batch frames 3 4"]
    valid: Bool[np.ndarray, "batch frames 3"]
    rotation_valid: Bool[np.ndarray, "batch frames 3"]
    offsets: Float[np.ndarray, "batch 22 3"]
    key: tuple[int, ...]

    def __post_init__(self) -> None:
        for name in ("n_frames", "position", "rotation", "valid", "rotation_valid", "offsets"):
            # A copy: a view would lead back to the body behind it through ``base``.
            alone = np.array(getattr(self, name), order="C")
            alone.flags.writeable = False
            object.__setattr__(self, name, alone)
        if self.condition is Condition.HEAD and (self.valid[:, :, 1:].any() or self.rotation_valid[:, :, 1:].any()):
            raise ValueError("condition head: the wrists must not be given")

    def __len__(self) -> int:
        return len(self.n_frames)

    def rows(self, start: int, stop: int) -> TrackedBatch:
        """Return a part of the batch; every row is complete in itself."""
        return rows_of(self, range(start, stop))


@dataclass(frozen=True, kw_only=True)
class Bodies:
    """One body a track.

    Attributes:
        joints: World, metres; NaN beyond ``n_frames`` of the batch.
    """

    joints: Float[np.ndarray, "batch frames 22 3"]


@runtime_checkable
class Tracker(Protocol):
    """What estimates bodies: nothing but a :class:`TrackedBatch` reaches it."""

    @property
    def name(self) -> str:
        """Return the name that tables show."""
        ...

    @property
    def conditions(self) -> frozenset[Condition]:
        """The conditions that it accepts."""
        ...

    def track(self, batch: TrackedBatch, *, seed: int) -> Bodies:
        """Return the bodies of a batch; each depends on its own row, ``seed`` and its key alone."""
        ...


def ask(tracker: Tracker, batch: TrackedBatch, *, seed: int) -> Bodies:
    """Ask a tracker, and hold its answer against the question.

    Raises:
        AdapterError: if the answer is no :class:`Bodies`, or of another shape, or not finite in a frame of a track.
    """
    answer = tracker.track(batch, seed=seed)
    if not isinstance(answer, Bodies):
        problem = f"expected prbench_benchmarks.three_points.batch.Bodies, found {type(answer).__name__}."
        raise AdapterError(f"{tracker.name}: {problem} Return Bodies(joints=…) of (tracks, frames, 22, 3).")
    expected = (*batch.position.shape[:2], len(Joint), 3)
    found = np.shape(answer.joints)
    if found != expected:
        raise AdapterError(f"{tracker.name}: expected joints of shape {expected}, found {found}.")
    within = np.arange(expected[1]) < batch.n_frames[:, None]
    if not np.isfinite(answer.joints[within]).all():
        problem = "expected finite positions in all frames of a track, found NaN or infinity."
        raise AdapterError(f"{tracker.name}: {problem}")
    return answer


def track_key(track_id: str) -> int:
    """63 bits that name a track without telling which one it is."""
    return int.from_bytes(hashlib.sha256(f"track/{track_id}".encode()).digest()[:8], "big") >> 1
