"""All that a method is given: the firewall between it and the recorded motion, as a type."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.shapes import Boxes

_INITIAL_STATE = frozenset({"initial_joints", "previous_joints"})


class Condition(StrEnum):
    """The four conditions of the protocol (*Prime and Reach*, table 2)."""

    NONE = "none"
    TEXT = "text"
    GOAL_POSE = "goal-pose"
    GOAL_LOCATION = "goal-loc"


GIVEN: dict[Condition, frozenset[str]] = {
    Condition.NONE: frozenset(),
    Condition.TEXT: frozenset({"text"}),
    Condition.GOAL_POSE: frozenset({"text", "goal_joints"}) | _INITIAL_STATE,
    Condition.GOAL_LOCATION: frozenset({"text", "goal_location"}) | _INITIAL_STATE,
}
"""Fields of a :class:`ConditionBatch` that each condition fills; all the others are None."""


@dataclass(frozen=True, kw_only=True)
class ConditionBatch:
    """Everything that a method may know about B sequences. Canonical frame, metres.

    There is no ground truth here, no gaze, no prime time, no path, and no id that leads to them. Where the initial
    state is given, whoever has the table can still recognise a sequence by it; the firewall prevents accidents.
    """

    condition: Condition
    n_frames: Int[np.ndarray, " batch"]
    """Frames to generate, at ``fps``."""
    fps: float
    opaque_id: tuple[str, ...]
    """Names the sequences within one run without telling which they are."""
    noise_seed: tuple[int, ...]
    """One per sequence, 63 bits: the only source of randomness (``prbench.randomness.sequence_generator``)."""
    text: tuple[str, ...] | None = None
    initial_joints: Float[np.ndarray, "batch 22 3"] | None = None
    """The recorded first frame."""
    previous_joints: Float[np.ndarray, "batch 22 3"] | None = None
    """The frame before it, for the initial velocity."""
    goal_joints: Float[np.ndarray, "batch 22 3"] | None = None
    """The recorded last frame (``goal-pose`` only)."""
    goal_location: Float[np.ndarray, "batch 3"] | None = None
    """Centre of the object, or of the place it is put to (``goal-loc`` only)."""
    obstacles: Boxes | None = None
    """The solid boxes around each sequence; only for methods that ask for them (``wants_obstacles``), whose rows no
    table ranks with the others (docs/specification/scene.md#solid-boxes)."""

    def __post_init__(self) -> None:
        for name in sorted(frozenset().union(*GIVEN.values())):
            given = getattr(self, name) is not None
            if given is not (name in GIVEN[self.condition]):
                raise ValueError(f"condition {self.condition.value}: '{name}' must {'not ' if given else ''}be given")
            if given and len(getattr(self, name)) != len(self):
                raise ValueError(f"'{name}' has {len(getattr(self, name))} rows, the batch has {len(self)}")
        if self.obstacles is not None and len(self.obstacles) != len(self):
            raise ValueError(f"'obstacles' are those of {len(self.obstacles)} rows, the batch has {len(self)}")
        if len(self.opaque_id) != len(self) or len(self.noise_seed) != len(self):
            raise ValueError("opaque_id and noise_seed need one entry a sequence")

    def __len__(self) -> int:
        return len(self.n_frames)

    def rows(self, start: int, stop: int) -> ConditionBatch:
        """A part of the batch; every row is complete in itself."""
        part = slice(start, stop)
        return ConditionBatch(
            condition=self.condition,
            n_frames=self.n_frames[part],
            fps=self.fps,
            opaque_id=self.opaque_id[part],
            noise_seed=self.noise_seed[part],
            obstacles=None if self.obstacles is None else self.obstacles.part(start, stop),
            **{name: getattr(self, name)[part] for name in GIVEN[self.condition]},
        )
