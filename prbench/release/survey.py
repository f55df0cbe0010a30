"""Measure all arrays of a release before any of them is converted.

A few numbers are kept of each sequence, so that memory does not grow with the motions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import InputFileError
from prbench.files.boundary import foreign_input
from prbench.files.bounded import read_whole
from prbench.files.storage import bytes_digest
from prbench.geometry.axes import Y_UP_FROM_Z_UP
from prbench.geometry.skeleton import BONES, WRISTS, Joint, bone_lengths, canonical_frame, transform_points
from prbench.limits import HARMLESS_SIZE
from prbench.metrics.ray_track import ray_distance
from prbench.release.block import fits, parse_array, unpack_arrays
from prbench.release.candidates import Candidate, Found
from prbench.release.known import load_known

GOAL_FRAMES = ("as the motions", "z up", "canonical", "canonical, z up")
"""Frames in which goals may be given, in the order in which they are tested."""


@dataclass(frozen=True)
class Measured:
    """The measurements of one sequence; lengths in the release's unit."""

    candidate: Candidate
    digest: str
    """Digest of the bytes of its files."""
    pelvis_to_head: float
    bones: Float[np.ndarray, " bones"]
    """Lengths of the bones, medians over the frames."""
    bone_change: float
    """Largest standard deviation of a bone over the frames."""
    world_from_canonical: Float[np.ndarray, "4 4"]
    goal_to_wrist: Float[np.ndarray, " frames_tried"]
    """Distance of goal and nearer wrist in the last frame, for each of :data:`GOAL_FRAMES`."""
    gaze_ray: Float[np.ndarray, " frames_tried"] | None
    """Distance of the goal from the gaze ray at the primed frame, for each of :data:`GOAL_FRAMES`."""


def survey(found: Found, primed_frame: dict[int, int], *, first_frame: int = 0) -> list[Measured]:
    """Read and measure every candidate once; unusable ones are reported in ``found``.

    Args:
        found: Candidates; problems are added.
        primed_frame: Maps the number of each sequence to its frame of the prime, from 0.
        first_frame: Frame at which the sequences begin; its pose decides the canonical frame.
    """
    measured = []
    for candidate in found.candidates:
        result = _measure(candidate, primed_frame[candidate.index], first_frame, found)
        if result is not None:
            measured.append(result)
    return measured


@dataclass(frozen=True)
class _Arrays:
    """The arrays of one sequence, as they stand in the files."""

    candidate: Candidate
    """Without its further arrays where these are unusable."""
    digest: str
    joints: Float[np.ndarray, "n 22 3"]
    gaze: np.ndarray | None


def _read(candidate: Candidate, found: Found) -> _Arrays | None:
    """Read the arrays of a sequence; report it and return None where its motion is damaged or not finite."""
    key = candidate.entry.key
    try:
        with foreign_input(candidate.motion):
            content = read_whole(candidate.motion, largest=HARMLESS_SIZE)
            joints = parse_array(candidate.motion, content).astype(np.float64)
            gaze_content = b"" if candidate.gaze is None else read_whole(candidate.gaze, largest=HARMLESS_SIZE)
            gaze = None if candidate.gaze is None else parse_array(candidate.gaze, gaze_content)
            further = b"" if candidate.further is None else read_whole(candidate.further, largest=HARMLESS_SIZE)
    except InputFileError as error:
        found.report(key, f"cannot be read: {error}")
        return None
    if candidate.further is not None and not _is_usable(candidate.further, further, len(joints)):
        found.report(key, "further: damaged or of another motion, not used", left_out=False)
        candidate = replace(candidate, further=None)
        further = b""
    if not np.isfinite(joints).all():
        found.report(key, "motion: expected finite numbers, found NaN or infinity")
        return None
    return _Arrays(candidate, bytes_digest(content + gaze_content + further), joints, gaze)


def _measure(candidate: Candidate, primed: int, first_frame: int, found: Found) -> Measured | None:
    arrays = _read(candidate, found)
    if arrays is None:
        return None
    joints = arrays.joints
    key = candidate.entry.key
    try:
        # A frame before the sequence is no part of it: place and heading are those of the first pose after it.
        world_from_canonical = canonical_frame(joints[first_frame:])
    except ValueError:
        found.report(key, "motion: its first pose has no heading, hips and shoulders lie on one vertical line")
        return None
    goals = _goals_in_every_frame(candidate.goal.location, world_from_canonical)
    directions, valid = clean_gaze(arrays.gaze, len(joints))
    if arrays.gaze is not None and not valid.any():
        found.report(key, "gaze: no frame has a unit vector", left_out=False)
    head = joints[primed, Joint.HEAD]
    lengths = bone_lengths(joints)
    # From the head joint, because the layout holds directions of gaze and no eyes.
    ray = [ray_distance(head[None], directions[primed][None], goal[None])[0] for goal in goals]
    return Measured(
        candidate=arrays.candidate,
        digest=arrays.digest,
        pelvis_to_head=float(np.median(np.linalg.norm(joints[:, Joint.HEAD] - joints[:, Joint.PELVIS], axis=1))),
        bones=np.median(lengths, axis=0),
        bone_change=float(lengths.std(axis=0).max()),
        world_from_canonical=world_from_canonical,
        goal_to_wrist=np.linalg.norm(goals[:, None] - joints[-1, WRISTS], axis=-1).min(axis=1),
        gaze_ray=np.array(ray) if valid[primed] else None,
    )


def _is_usable(path: Path, content: bytes, n_frames: int) -> bool:
    """Return True if our exporter's further arrays are whole and belong to this motion."""
    try:
        with foreign_input(path):
            return fits(unpack_arrays(path, content), n_frames)
    except InputFileError:
        return False


def _goals_in_every_frame(
    goal: Float[np.ndarray, "3"], world_from_canonical: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "tried 3"]:
    """Return the goal in the frame of the motions, for each of :data:`GOAL_FRAMES` that it may have been given in."""
    return np.stack([transform_points(goal_transform(name, world_from_canonical), goal) for name in GOAL_FRAMES])


def goal_transform(frame: str, world_from_canonical: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Return the transform from one of :data:`GOAL_FRAMES` into the frame of the motions."""
    axes = Y_UP_FROM_Z_UP if frame.endswith("z up") else np.eye(4)
    return world_from_canonical @ axes if frame.startswith("canonical") else axes


def clean_gaze(gaze: np.ndarray | None, n_frames: int) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Return unit directions and their validity.

    A missing last frame is invalid, one too many is cut off. NaN, zero and lengths far from 1 are invalid; lengths
    near 1 are made exact.
    """
    directions = np.full((n_frames, 3), np.nan)
    if gaze is not None:
        rows = min(n_frames, len(gaze))
        directions[:rows] = gaze[:rows]
    length = np.linalg.norm(directions, axis=1)
    valid = np.abs(length - 1) <= load_known().gaze.renormalised_tolerance
    unit = np.abs(length - 1) <= load_known().gaze.unit_tolerance
    scale = np.where(valid & ~unit, length, 1.0)[:, None]
    return np.where(valid[:, None], directions / scale, [0.0, 0.0, 1.0]), valid


def mean_bones(measured: Iterable[Measured]) -> Float[np.ndarray, "sequences bones"]:
    """Return the bone lengths of all sequences, one row each, in the order of the skeleton's bones."""
    return np.array([each.bones for each in measured]).reshape(-1, len(BONES))
