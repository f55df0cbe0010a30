"""Finds first frames that face another way than +Z, and motions that lost their path or their heading."""

from __future__ import annotations

import dataclasses

import numpy as np

from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, no_finding
from prbench.geometry.skeleton import Joint

_CERTAIN = np.deg2rad(25.0)  # from the wanted heading
_SUSPICIOUS = np.deg2rad(15.0)
_AGREEING = 0.9  # length of the mean of unit vectors
_STILL = 1e-3  # metres that a pinned pelvis moves
_WALKED = 0.12  # metres that an ankle moves over the ground: no one sits
_SLID = 0.02  # metres that a foot moves under a pinned pelvis
_EXACT = np.deg2rad(0.05)  # nobody keeps a heading like this
_FEET = [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]


def examine_facing(motion_set: MotionSet) -> Finding:
    """Compare the headings of first frames with those of the initial poses, or with +Z."""
    off = wrapped(headings(motion_set.first_poses()) - _wanted(motion_set))
    typical = float(np.median(np.abs(off)))
    if typical < _SUSPICIOUS:
        return no_finding(motion_set)
    # Angles are averaged as unit vectors; their mean length tells how well they agree.
    mean = np.exp(1j * off).mean()
    common = abs(mean) > _AGREEING
    certain = bool(typical > _CERTAIN) and not motion_set.motionless
    degrees = np.rad2deg(np.angle(mean)) if common else np.rad2deg(typical)
    if common:
        evidence = f"in their first frame bodies face {degrees:+.0f} degrees off +Z (positive towards +X)"
        cause = "motions are turned as a whole, by the axes of another program or a canonical frame of its own"
        undone = motion_set.changed(lambda motion: turned(motion, -float(np.angle(mean))))
    else:
        lowest = np.rad2deg(off.min())
        highest = np.rad2deg(off.max())
        evidence = (
            f"first frames face all ways: {degrees:.0f} degrees off +Z (median), from {lowest:.0f} to {highest:.0f}"
        )
        cause = "motions are in the frame of their rooms or recordings, and were not put into their canonical frames"
        undone = motion_set.with_motions(
            [turned(motion, -float(angle)) for motion, angle in zip(motion_set.motions, off, strict=True)]
        )
    if len(motion_set) > 1:
        evidence += f" ({len(motion_set)} motions)"
    remedy = "Turn each whole motion until its first frame faces +Z: prbench.representation.canonicalise."
    return Finding((Diagnosis("facing", certain, evidence, cause, remedy),), undone)


def _wanted(motion_set: MotionSet) -> np.ndarray:
    return np.array(
        [
            0.0 if known.initial_joints is None else float(headings(known.initial_joints))
            for known in motion_set.expected
        ]
    )


def examine_root(motion_set: MotionSet) -> Finding:
    """Look for a pelvis that stays in one place and for a heading that never changes."""
    moving = [row for row, motion in enumerate(motion_set.motions) if _moves(motion)]
    if not moving:
        return no_finding(motion_set)
    diagnoses = [each for each in (_pinned(motion_set, moving), _one_heading(motion_set, moving)) if each is not None]
    if not any(each.kind == "root" for each in diagnoses):
        return Finding(tuple(diagnoses), motion_set)
    return Finding(tuple(diagnoses), dataclasses.replace(_on_the_floor(motion_set), pinned=True))


def _moves(motion: np.ndarray) -> bool:
    """Return True if limbs move against the pelvis."""
    if len(motion) < 5:
        return False
    return float(np.ptp(_seen_by_the_body(motion), axis=0).max()) > 0.05


def _pinned(motion_set: MotionSet, moving: list[int]) -> Diagnosis | None:
    motions = [motion_set.motions[row] for row in moving]
    ranges = np.array([np.ptp(motion[:, Joint.PELVIS], axis=0) for motion in motions])
    at_zero = np.array([np.abs(motion[:, Joint.PELVIS]).max() < _STILL for motion in motions])
    if at_zero.mean() > 0.5:
        evidence = f"the pelvis is at (0, 0, 0) in every frame of {motion_set.in_words(int(at_zero.sum()))}"
        remedy = "Add the pelvis's path to all joints: joints + pelvis[:, None]."
        return Diagnosis("root", True, evidence, "positions are relative to the pelvis; its path was not added", remedy)
    feet = np.array([np.ptp(_seen_by_the_body(motion)[:, _FEET][..., [0, 2]], axis=0).max() for motion in motions])
    pinned = (ranges[:, [0, 2]].max(axis=1) < _STILL) & (feet > _WALKED)
    if pinned.mean() <= 0.5:
        return None
    evidence = (
        f"the pelvis stays over one point (within {ranges[pinned][:, [0, 2]].max() * 1000:.2g} mm) in"
        f" {motion_set.in_words(int(pinned.sum()))}, while ankles move up to {feet[pinned].max():.2f} m"
    )
    cause = "the path over the ground was left out, as in the position features of HumanML3D"
    remedy = "Add up the root's velocities: prbench.representation.decode does it for the 263 features."
    return Diagnosis("root", True, evidence, cause, remedy)


def _one_heading(motion_set: MotionSet, moving: list[int]) -> Diagnosis | None:
    motions = [motion_set.motions[row] for row in moving]
    spreads = np.array([np.ptp(wrapped(angles - angles[0])) for angles in map(headings, motions)])
    same = spreads < _EXACT
    if same.mean() <= 0.5:
        return None
    evidence = (
        f"bodies of {motion_set.in_words(int(same.sum()))} keep their heading to {np.rad2deg(spreads[same].max()):.1g}"
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
    """Return True if the pelvis is pinned there while feet slide; in a mere reach feet stand still."""
    ground = motion[..., [0, 2]]
    feet = float(np.ptp(ground[:, _FEET], axis=0).max())
    return float(np.abs(ground[:, Joint.PELVIS]).max()) < _STILL and feet > _SLID


def _seen_by_the_body(motion: np.ndarray) -> np.ndarray:
    """Return joints relative to the pelvis and its heading, so that rigid movement of the whole body vanishes."""
    return turned(motion - motion[:, :1], -headings(motion)[:, None])


def _on_the_floor(motion_set: MotionSet) -> MotionSet:
    lift = np.array([0.0, 1.0, 0.0])
    return motion_set.changed(lambda motion: motion - motion[..., 1].min() * lift)


def headings(poses: np.ndarray) -> np.ndarray:
    """Return the heading of each pose, as ``skeleton.facing_yaw`` defines it; (…, 22, 3) to (…)."""
    across = (
        poses[..., Joint.RIGHT_HIP, :]
        - poses[..., Joint.LEFT_HIP, :]
        + poses[..., Joint.RIGHT_SHOULDER, :]
        - poses[..., Joint.LEFT_SHOULDER, :]
    )
    return np.asarray(np.arctan2(across[..., 2], -across[..., 0]))


def wrapped(angles: np.ndarray) -> np.ndarray:
    """Wrap angles to [-pi, pi)."""
    return np.mod(np.asarray(angles) + np.pi, 2 * np.pi) - np.pi


def turned(points: np.ndarray, yaw: float | np.ndarray) -> np.ndarray:
    """Turn points (…, 3) about +Y by radians; +Z goes towards +X."""
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
