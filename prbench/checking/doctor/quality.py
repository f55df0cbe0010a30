"""Bodies that tremble or stretch: the fault of a model rather than of its conversion, so never certain."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.patient import Finding, Patient
from prbench.checking.doctor.tremor import Tremor
from prbench.checking.doctor.types import Diagnosis
from prbench.skeleton import BONES, Joint, bone_lengths

_STRETCHY = 0.12  # standard deviation of a bone's length over time, as a share of it


def examine_quality(patient: Patient) -> Finding:
    """Look at bones and at how smoothly joints move."""
    long = [motion for motion in patient.motions if len(motion) > 4]
    if not long:
        return Finding((), patient)
    return Finding((*_stretching(long), *_trembling(long)), patient)


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
