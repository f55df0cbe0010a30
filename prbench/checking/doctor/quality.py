"""Finds bodies that tremble or stretch: the fault of a model rather than of its conversion, so never certain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet
from prbench.geometry.skeleton import BONES, Joint, bone_lengths

_TREMBLING = 1.2  # second over first differences (noise 1.7, movement 0.3)
_TREMOR = 0.003  # metres
SMOOTHED_OVER = 1.5
"""Standard deviation of the Gaussian in :func:`smoothed`, frames."""
_STRETCHY = 0.12  # standard deviation of a bone's length over time, as a share of it


@dataclass(frozen=True)
class Tremor:
    """Trembling of most motions; medians over them."""

    ratio: float
    """Second over first differences of the joints relative to the pelvis."""
    metres: float
    motions: int
    """Number of motions that were long enough."""

    @classmethod
    def of(cls, motions: Sequence[Float[np.ndarray, "_frames 22 3"]]) -> Tremor | None:
        """Measure motions; None if they do not tremble, or are too short to tell."""
        ratios = []
        sizes = []
        for motion in motions:
            if len(motion) <= 4:
                continue
            # Relative to the pelvis, whose own path may be smoothed by another part of a model.
            limbs = motion - motion[:, :1]
            first, second = (np.linalg.norm(np.diff(limbs, n, axis=0), axis=-1).mean(axis=-1) for n in (1, 2))
            ratios.append(float(np.median(second) / max(float(np.median(first)), 1e-9)))
            # The second difference of independent noise has a variance of 1 + 4 + 1 = 6 times its own.
            sizes.append(float(np.median(second)) / np.sqrt(6))
        if not ratios or np.median(ratios) < _TREMBLING or np.median(sizes) < _TREMOR:
            return None
        return cls(float(np.median(ratios)), float(np.median(sizes)), len(ratios))


def examine_quality(motion_set: MotionSet) -> Finding:
    """Look at bones and at how smoothly joints move."""
    long = [motion for motion in motion_set.motions if len(motion) > 4]
    if not long:
        return Finding((), motion_set)
    return Finding((*_stretching(long), *_trembling(long)), motion_set)


def _stretching(motions: list[np.ndarray]) -> tuple[Diagnosis, ...]:
    changes = []
    for motion in motions:
        lengths = bone_lengths(motion)
        changes.append(lengths.std(axis=0) / np.maximum(lengths.mean(axis=0), 1e-9))
    worst = np.max(changes, axis=1)
    if np.median(worst) < _STRETCHY:
        return ()
    bone = int(np.median(changes, axis=0).argmax())
    parent, child = (Joint(joint).name.lower() for joint in BONES[bone])
    evidence = (
        f"lengths of bones change by up to {np.median(worst):.0%} (standard deviation of the worst bone, median of"
        f" {len(motions)} motions); most from {parent} to {child}"
    )
    cause = "joints were generated or interpolated one by one, without a skeleton"
    remedy = "Decode through rotations (prbench.representation.decode_rotations), or add a loss on bones."
    return (Diagnosis("bones", False, evidence, cause, remedy),)


def _trembling(motions: list[np.ndarray]) -> tuple[Diagnosis, ...]:
    tremor = Tremor.of(motions)
    if tremor is None:
        return ()
    evidence = (
        f"joints tremble by about {tremor.metres * 1000:.0f} mm: steps change from frame to frame by"
        f" {tremor.ratio:.2f} of their own size (medians of {tremor.motions} motions;"
        " smooth movement 0.3, noise 1.7)"
    )
    cause = "noise of a sampler with few steps, or frames that are generated without their neighbours"
    remedy = "Sample with more steps or smooth the joints; metrics of the head and of feet suffer from it."
    return (Diagnosis("jitter", False, evidence, cause, remedy),)


def smoothed(motion: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """Smooth the motion over frames."""
    from scipy.ndimage import gaussian_filter1d  # late: 0.3 s that a run and its workers do not need

    return gaussian_filter1d(motion, SMOOTHED_OVER, axis=0, mode="nearest")
