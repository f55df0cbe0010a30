"""When feet slide and which bone changes (docs/error-budget.md#feet-and-bones)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import BONES, Joint
from prbench.metrics import MotionBatch, ScoringTargets
from prbench.metrics.bone_length_change import change_of_each_bone
from prbench.metrics.foot_skating import foot_skating, slow_slides
from prbench.protocol.manifests import MetricConstants

PHASES = ("before", "way", "end")
"""Up to the recorded prime time; from there to the last second; the last second."""

_END = 1.0  # seconds: the reach itself, when feet should stand


@dataclass(frozen=True, eq=False)
class Bodies:
    """Feet and bones of n motions."""

    skating: Float[np.ndarray, " n"]
    """Foot Skating."""
    slides: Float[np.ndarray, " n"]
    """Share of the frame transitions with a slow slide."""
    slides_in: dict[str, Float[np.ndarray, " n"]]
    """The same share in each of :data:`PHASES`; NaN where a motion has no transition in it."""
    bone_change: Float[np.ndarray, " n"]
    """Largest relative change of a bone's length against the first frame."""
    worst_bone: tuple[str, ...]
    """The bone that changes most, such as ``neck-head``."""


def diagnose_bodies(motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants) -> Bodies:
    """Measure sliding feet by phase, and the bone that changes most.

    Args:
        motion: Canonical frame, metres, two frames or more.
        targets: Of the sequences.
        constants: Of the protocol.
    """
    fps = targets.fps_of_sequence
    change, _ = change_of_each_bone(motion)
    names = [_bone_name(*BONES[bone]) for bone in change.argmax(axis=0)]
    return Bodies(
        foot_skating(motion, fps, constants),
        slow_slides(motion, fps, constants),
        _slides_by_phase(motion, targets, constants),
        change.max(axis=0),
        tuple(names),
    )


def _slides_by_phase(
    motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants
) -> dict[str, Float[np.ndarray, " n"]]:
    found = {phase: np.full(motion.n_sequences, np.nan) for phase in PHASES}
    for row in range(motion.n_sequences):
        fps = float(targets.fps_of_sequence[row])
        n = int(motion.n_frames[row])
        end = max(n - 1 - round(_END * fps), 0)
        prime = int(np.clip(round(float(targets.prime_time[row]) * fps), 0, end))
        for phase, first, last in zip(PHASES, (0, prime, end), (prime, end, n - 1), strict=True):
            if last > first:
                part = motion.part(row, row + 1)
                cut = MotionBatch(part.values[first : last + 1], np.array([0, last + 1 - first]))
                found[phase][row] = slow_slides(cut, fps, constants)[0]
    return found


def _bone_name(parent: int, child: int) -> str:
    """``neck-head``: the names of both joints."""
    return "-".join(Joint(joint).name.lower().replace("_", " ") for joint in (parent, child))
