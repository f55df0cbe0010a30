"""Motions that lost their root: pelvis pinned to one place, heading removed from every frame."""

from __future__ import annotations

import dataclasses

import numpy as np

from prbench.checking.doctor.headings import headings, wrapped
from prbench.checking.doctor.patient import Finding, Patient, healthy, of_motions
from prbench.checking.doctor.types import Diagnosis
from prbench.skeleton import Joint

_STILL = 1e-3  # metres that a pinned pelvis moves
_WALKED = 0.12  # metres that an ankle moves over the ground: no one sits
_SLID = 0.02  # metres that a foot moves under a pinned pelvis
_EXACT = np.deg2rad(0.05)  # nobody keeps a heading like this
_FEET = [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]


def examine_root(patient: Patient) -> Finding:
    """Look for a pelvis that stays in one place and for a heading that never changes."""
    moving = [row for row, motion in enumerate(patient.motions) if _moves(motion)]
    if not moving:
        return healthy(patient)
    diagnoses = [each for each in (_pinned(patient, moving), _one_heading(patient, moving)) if each is not None]
    if not any(each.kind == "root" for each in diagnoses):
        return Finding(tuple(diagnoses), patient)
    return Finding(tuple(diagnoses), dataclasses.replace(_on_the_floor(patient), pinned=True))


def _moves(motion: np.ndarray) -> bool:
    """Whether limbs move against the pelvis."""
    if len(motion) < 5:
        return False
    return float(np.ptp(_seen_by_the_body(motion), axis=0).max()) > 0.05


def _pinned(patient: Patient, moving: list[int]) -> Diagnosis | None:
    motions = [patient.motions[row] for row in moving]
    ranges = np.array([np.ptp(motion[:, Joint.PELVIS], axis=0) for motion in motions])
    at_zero = np.array([np.abs(motion[:, Joint.PELVIS]).max() < _STILL for motion in motions])
    if at_zero.mean() > 0.5:
        evidence = f"the pelvis is at (0, 0, 0) in every frame of {of_motions(int(at_zero.sum()), patient)}"
        remedy = "Add the pelvis's path to all joints: joints + pelvis[:, None]."
        return Diagnosis("root", True, evidence, "positions are relative to the pelvis; its path was not added", remedy)
    feet = np.array([np.ptp(_seen_by_the_body(motion)[:, _FEET][..., [0, 2]], axis=0).max() for motion in motions])
    pinned = (ranges[:, [0, 2]].max(axis=1) < _STILL) & (feet > _WALKED)
    if pinned.mean() <= 0.5:
        return None
    evidence = (
        f"the pelvis stays over one point (within {ranges[pinned][:, [0, 2]].max() * 1000:.2g} mm) in"
        f" {of_motions(int(pinned.sum()), patient)}, while ankles move up to {feet[pinned].max():.2f} m"
    )
    cause = "the path over the ground was left out, as in the position features of HumanML3D"
    remedy = "Add up the root's velocities: prbench.representation.decode does it for the 263 features."
    return Diagnosis("root", True, evidence, cause, remedy)


def _one_heading(patient: Patient, moving: list[int]) -> Diagnosis | None:
    motions = [patient.motions[row] for row in moving]
    spreads = np.array([np.ptp(wrapped(angles - angles[0])) for angles in map(headings, motions)])
    same = spreads < _EXACT
    if same.mean() <= 0.5:
        return None
    evidence = (
        f"bodies of {of_motions(int(same.sum()), patient)} keep their heading to {np.rad2deg(spreads[same].max()):.1g}"
        " degrees in all frames, while their limbs move"
    )
    remedy = "Turn whole motions by the heading of their first frame: prbench.representation.canonicalise."
    own_frames = "every frame was put into a canonical frame of its own; only the first frame decides"
    centred = same & np.array([_stays_over_the_origin(motion) for motion in motions])
    if centred.mean() > 0.5:
        evidence += f"; pelvises of {int(centred.sum())} stay over the origin, while their feet move"
        return Diagnosis("heading", True, evidence, own_frames, remedy)
    cause = f"the method never turns a body, which is allowed, or {own_frames}"
    return Diagnosis("heading", False, evidence, cause, f"If it was made so, nothing. Otherwise: {remedy}")


def _stays_over_the_origin(motion: np.ndarray) -> bool:
    """Whether the pelvis is pinned there, and feet slide under it; who only reaches has feet that stand."""
    ground = motion[..., [0, 2]]
    feet = float(np.ptp(ground[:, _FEET], axis=0).max())
    return float(np.abs(ground[:, Joint.PELVIS]).max()) < _STILL and feet > _SLID


def _seen_by_the_body(motion: np.ndarray) -> np.ndarray:
    """Joints relative to the pelvis and its heading: what turns or moves as a whole does not show."""
    limbs, yaw = motion - motion[:, :1], -headings(motion)[:, None]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    x, z = limbs[..., 0], limbs[..., 2]
    return np.stack([cosine * x + sine * z, limbs[..., 1], cosine * z - sine * x], axis=-1)


def _on_the_floor(patient: Patient) -> Patient:
    lift = np.array([0.0, 1.0, 0.0])
    return patient.changed(lambda motion: motion - motion[..., 1].min() * lift)
