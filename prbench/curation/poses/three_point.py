"""Make bodies from head and wrists, as ``prbench poses three-point`` does (docs/specification/three-points.md)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from jaxtyping import Bool, Float

import prbench
from prbench.curation.poses.make import Outcome
from prbench.curation.poses.states import held_dataset
from prbench.datasets import readable_datasets
from prbench.entry_points import POSE_ESTIMATORS, load_built_in
from prbench.errors import PrbenchError, RecordingUnusable
from prbench.files.storage import atomic_path, sole_writer
from prbench.geometry.skeleton import N_JOINTS, PARENTS, WRISTS, Joint, rotation_matrices
from prbench.geometry.timelines import covered, interpolate
from prbench.progress_bar import ProgressCallback
from prbench.readers import ReaderOptions, described_options, reader_for
from prbench.readers.three_point import LONGEST_GAP, THREE_POINT
from prbench.recording import SIDES, Recording

FPS = 30.0
_PIECE = 18_000  # frames that are estimated at once, so that an hour takes no more memory than ten minutes
_BEFORE = 90  # frames before them; networks look back for less than a second
# Central pupil frame in the head's joint frame, metres: synthetic people have (0, 0.012, 0.055) of their stature, here
# that of 1.70 m; both frames are parallel (x left, y up, z forward).
EYE_IN_HEAD = np.array([0.0, 0.0204, 0.0935])
# Heights of an adult's head joint, metres: seated at least, standing at least, and at most.
_HEIGHTS = (0.80, 1.30, 1.95)

# Rest offsets of the mean synthetic adult's joints from their parents in the T-pose, metres, without right joints.
_OFFSETS = np.array([
    (0.0, 0.0, 0.0), (0.0610, -0.0811, -0.0101), (0.0, 0.1270, -0.0169), (0.0, -0.3801, 0.0), (0.0, 0.1359, 0.0067),
    (0.0, -0.4162, 0.0), (0.0, 0.0591, 0.0034), (0.0, -0.0608, 0.1284), (0.0, 0.2064, -0.0184),
    (0.0695, 0.1012, -0.0169), (0.0, 0.0921, 0.0512), (0.1178, 0.0203, -0.0135), (0.2521, 0.0, 0.0),
    (0.2606, 0.0, 0.0),
])  # fmt: skip
MEAN_HEAD_HEIGHT = 1.5586  # m, of its head joint above the lowest joint


class PoseEstimator(Protocol):
    """What ``load(weights)`` returns, which a package offers in the group ``prbench.pose_estimators``.

    ``estimate(times, position, rotation, valid, rotation_valid, offsets)`` gets n frames of head, left and
    right wrist: seconds (n); places of the joints, metres, Y up, floor at height 0 (n, 3, 3); joint frame to world,
    w x y z (n, 3, 4), where a joint frame is the identity in the T-pose; where either was measured (n, 3); and each
    joint's rest offset from its parent in the T-pose (22, 3). It returns the joints (n, 22, 3), NaN where it cannot
    tell; the arguments alone decide them.

    Attributes:
        provenance: All that it says of itself: digest and licence of its weights, what they were trained on.
    """

    provenance: Mapping[str, str]
    estimate: Callable[..., Float[np.ndarray, "n 22 3"]]


class ThreePointOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the command.

    Attributes:
        estimator: Name in the group ``prbench.pose_estimators``.
        weights: Weights of the estimator; those that come with it by default.
        floor: Height of the floor in the recording's world, metres; see :func:`wearer_size` without it.
    """

    estimator: str = "avatarposer"
    weights: Path | None = None
    floor: float | None = None


def mean_offsets(scale: float) -> Float[np.ndarray, "22 3"]:
    """Return the mean adult's rest offsets, metres, times a scale."""
    offsets = np.zeros((N_JOINTS, 3))
    offsets[[joint for joint in Joint if not joint.name.startswith("RIGHT_")]] = scale * _OFFSETS
    left = [joint for joint in Joint if joint.name.startswith("LEFT_")]
    offsets[np.add(left, 1)] = offsets[left] * (-1.0, 1.0, 1.0)
    return offsets


def wearer_size(heights: Float[np.ndarray, " n"], floor: float | None) -> tuple[float, float, str]:
    """Find the wearer's size from the head.

    Args:
        heights: Heights of the head joint over time, metres.
        floor: Height of the floor; without it the world's height 0, unless the head is then where no adult's is.

    Returns:
        Bones as a multiple of the mean adult's, height of the floor in metres, and how they were found.
    """
    highest = float(np.percentile(heights, 95.0))
    if floor is None and not _HEIGHTS[0] <= highest <= _HEIGHTS[2]:
        return 1.0, highest - MEAN_HEAD_HEIGHT, "floor unknown, put where a mean adult would stand"
    above = highest - (floor or 0.0)
    stands = _HEIGHTS[1] <= above <= _HEIGHTS[2]
    return above / MEAN_HEAD_HEIGHT if stands else 1.0, floor or 0.0, f"head {above:.2f} m above the floor"


def estimated_body(recording: Recording, estimator: PoseEstimator, floor: float | None) -> tuple[dict[str, Any], str]:
    """Estimate a body 30 times a second from the head's poses and the wrists' positions.

    Nothing is interpolated over more than 0.1 s. A wrist measured at 5 Hz is known only in frames beside a sample.

    Returns:
        The arrays of the file, and the wearer's size in words.

    Raises:
        RecordingUnusable: if the head is nowhere known.
    """
    head = recording.head
    if head.valid.sum() < 2:
        raise RecordingUnusable(f"{recording.recording_id}: no poses of the head, from which a body could be made.")
    times = np.arange(head.times[0], head.times[-1], 1 / FPS)
    valid = np.zeros((len(times), 3), dtype=bool)
    valid[:, 0] = covered(head.times, head.valid, times, max_gap=LONGEST_GAP)
    position = np.zeros((len(times), 3, 3))
    rotation = np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 3, 1))
    eyes, rotation[:, 0] = head.pose_at(times)
    position[:, 0] = eyes - rotation_matrices(rotation[:, 0]) @ EYE_IN_HEAD
    for hand in recording.hands:
        if hand.contact == "wrist" and hand.valid.any():
            place = 1 + SIDES.index(hand.side)
            position[:, place] = interpolate(hand.times[hand.valid], hand.points[hand.valid, 0], times)
            # Or a sample lies within half a frame.
            valid[:, place] = covered(hand.times, hand.valid, times, max_gap=LONGEST_GAP, tolerance=0.5 / FPS)
    scale, floor, size = wearer_size(position[:, 0, 1], floor)
    position[..., 1] -= floor
    joints = np.zeros((len(times), N_JOINTS, 3), dtype=np.float32)
    for start in range(0, len(times), _PIECE):
        # Each piece begins earlier than it counts: a body follows from the frames before it.
        given = slice(max(start - _BEFORE, 0), start + _PIECE)
        known = valid[given] & [True, False, False]  # rotations are measured of the head alone
        asked = (times[given], position[given], rotation[given], valid[given], known)
        bodies = estimator.estimate(*asked, mean_offsets(scale))
        bend_arms(bodies, position[given], valid[given])
        bodies[..., 1] += floor
        joints[start : start + _PIECE] = bodies[start - given.start :]
    known = np.asarray(np.isfinite(joints).all(axis=(1, 2)))
    joints[~known] = 0.0
    return {"times": times, "joints": joints, "valid": known}, f"{size}, bones {scale:.3f} times the mean adult's"


def bend_arms(
    joints: Float[np.ndarray, "n 22 3"], position: Float[np.ndarray, "n 3 3"], valid: Bool[np.ndarray, "n 3"]
) -> None:
    """Move elbows and wrists so that measured wrists lie where they were measured, or as near as the arms reach.

    A network answers with rotations, whose wrists end centimetres away; bones keep their lengths and elbows their side.

    Args:
        joints: Estimated joints, metres; changed in place.
        position: Measured head and wrists.
        valid: True where they were measured.
    """
    for place, wrist in enumerate(WRISTS, start=1):
        rows = valid[:, place] & np.isfinite(joints[:, wrist, 0])
        elbow = PARENTS[wrist]
        shoulder, middle, end = (joints[rows, joint] for joint in (PARENTS[elbow], elbow, wrist))
        upper = np.linalg.norm(middle - shoulder, axis=-1, keepdims=True)
        lower = np.linalg.norm(end - middle, axis=-1, keepdims=True)
        wanted = position[rows, place] - shoulder
        distance = np.linalg.norm(wanted, axis=-1, keepdims=True)
        along = wanted / distance
        distance = np.clip(distance, np.abs(upper - lower) + 1e-3, 0.999 * (upper + lower))
        aside = middle - shoulder - ((middle - shoulder) * along).sum(axis=-1, keepdims=True) * along
        aside /= np.maximum(np.linalg.norm(aside, axis=-1, keepdims=True), 1e-9)
        # Law of cosines: the elbow's place along the line from shoulder to wrist, and aside of it.
        reach = (upper**2 - lower**2 + distance**2) / (2 * distance)
        joints[rows, elbow] = shoulder + reach * along + np.sqrt(np.maximum(upper**2 - reach**2, 0.0)) * aside
        joints[rows, wrist] = shoulder + distance * along


def make_bodies(
    root: Path,
    dataset: str | None,
    options: ThreePointOptions,
    *,
    recordings: str = "*",
    limit: int | None = None,
    progress: ProgressCallback = lambda *_: None,
) -> tuple[Outcome, ...]:
    """Make the bodies of all recordings of a dataset, one after the other, into ``root/three-point``.

    Args:
        root: The dataset's folder.
        dataset: Its name; found out from the folder if None.
        options: Estimator, weights and floor.
        recordings: Pattern of names.
        limit: Largest number of recordings.
        progress: Called with finished recordings, all of them, and the last one's name and state.

    Raises:
        UsageError: if there is no such estimator, or no recording whose reader takes such bodies.
        StorageError: if nothing can be written.
    """
    estimator: PoseEstimator = load_built_in(POSE_ESTIMATORS, options.estimator, of_others=True)(options.weights)
    named = described_options(options) | {"prbench": prbench.__version__, **estimator.provenance}
    root = root.expanduser().resolve()
    reader = reader_for(dataset or held_dataset(root, readable_datasets()), {"poses": THREE_POINT})
    chosen = [each for each in reader.find(root) if fnmatchcase(each.recording_id, recordings)][:limit]
    outcomes = []
    for found in chosen:
        # An earlier file, damaged or not, is not read.
        bare = replace(found, files=[file for file in found.files if file.role != THREE_POINT])
        try:
            arrays, size = estimated_body(reader.read(bare), estimator, options.floor)
        except PrbenchError as error:
            state = "skipped" if isinstance(error, RecordingUnusable) else "failed"
            outcomes.append(Outcome(found.recording_id, state, str(error)))
        else:
            path = root / THREE_POINT / f"{found.recording_id}.npz"
            with sole_writer(path), atomic_path(path) as temporary, open(temporary, "wb") as file:
                np.savez(file, **arrays, about=json.dumps(named | {"size": size}, sort_keys=True))
            outcomes.append(Outcome(found.recording_id, "made", f"{arrays['valid'].sum() / FPS:.1f} s; {size}"))
        progress(len(outcomes), len(chosen), f"{found.recording_id} {outcomes[-1].state}")
    return tuple(outcomes)
