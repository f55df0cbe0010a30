"""Joints from what a HumanML3D model puts out: statistics, layout, rows and frames.

Sources: docs/specification/humanml3d.md#inverse and docs/specification/humanml3d.md#normalisation.

The steps, each a function: :func:`feature_rows`, :meth:`Statistics.restore`, :func:`motions_from_features`, and then
:func:`prbench.representation.converters.placed_on`. No torch: tensors come as ``tensor.detach().cpu().numpy()``.

Checks that features were restored with the statistics of their own model judge all motions of a batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.files.arrays import load_array
from prbench.files.bounded import foreign_input, require, require_rows
from prbench.geometry.skeleton import N_JOINTS
from prbench.representation.encoding import decode, yaw_matrices
from prbench.representation.features import (
    FOOT_CONTACTS,
    JOINT_VELOCITIES,
    N_FEATURES,
    ROOT_LINEAR_VELOCITY,
    ROOT_YAW_VELOCITY,
    Statistics,
)

# Name in messages of an array that comes from no file and no named method.
FEATURES = "features"

_WALKS = 0.005  # metres a frame; slower pelvises say nothing about their scale
_SAME_SCALE = 3.0  # factor between the two ways in which the step of the pelvis is written
_NO_MODEL = 10.0  # the same, enough for one motion alone; random weights seldom come here (2 of 72 did)
_FARTHEST_CONTACT = 4.0
_LEAST_CONTACTS_VARY = 0.1  # an evaluator's statistics leave 0.04 of the change between 0 and 1 …
_UNDECIDED = 0.05  # … and neither of them, but their mean
_FASTEST = 0.15  # metres a frame, mean over joints and frames: 3 m/s
_ENOUGH = 4  # motions whose majority is believed; of fewer each needs a second sign

_OTHER_STATISTICS = (
    "The features were never restored, or with the statistics of another model: take the Mean.npy and Std.npy that this"
    " one was trained with (those of text-to-motion evaluators have root and contacts about 25 times smaller). If the"
    " first three columns are absolute, say root='absolute'. If the statistics are right and the model makes such"
    " features (it is hardly trained, or has random weights), go on with motions_from_features(..., check=False), or"
    " likewise joints_from_features: it converts them as they are, and leaves out this check alone."
)


def check_features(
    features: Float[np.ndarray, "rows 263"] | Sequence[Float[np.ndarray, "_ 263"]],
    *,
    source: str = FEATURES,
    sequences: Sequence[str] | np.ndarray | None = None,
) -> None:
    """Refuse features that were not restored, or with the statistics of another model.

    The step of the pelvis stands in a row twice, in the root block and among the joint velocities. Statistics of an
    evaluator scale the one about 25 times as small as those of a generator, and leave the other. Numbers that were
    never restored are near 1 and move joints by half a metre a frame. Wrong statistics show in most motions, a model
    that has learnt little in some; so it counts what most of the motions say, and single ones are kept.

    Args:
        features: Raw features of one motion or several, relative root.
        source: Name of the method, with which messages begin.
        sequences: Name of each motion (``batch.opaque_id``), for messages.

    Raises:
        InputFileError: if in more than half of the motions that walk the two differ by more than a factor of three, if
            in more than half the foot contacts, which are 0 or 1, lie nowhere near, or joints move by more than 3 m/s
            in the mean. Fewer than four motions are refused for their steps only if the factor is above ten, or the
            contacts are odd, too.
    """
    motions = [features] if isinstance(features, np.ndarray) and features.ndim == 2 else list(features)
    walking = [row for row, motion in enumerate(motions) if max(_step_lengths(motion)) > _WALKS]
    everything = list(range(len(motions)))
    # Each tells columns, what is expected there, what is found, and True where nothing but other statistics explains
    # it, so that the motion needs no company to be refused.
    examinations: tuple[tuple[Callable[[np.ndarray], tuple[str, str, str, bool] | None], list[int]], ...] = (
        (_steps, walking),
        (_contacts, everything),
        (_speed, everything),
    )
    for look, rows in examinations:
        doubts = [(row, doubt) for row in rows if (doubt := look(motions[row])) is not None]
        believed = len(rows) >= _ENOUGH or all(sure for _, (_, _, _, sure) in doubts)
        if 2 * len(doubts) > len(rows) and believed:
            row, (where, expected, found, _) = doubts[0]
            place = f"row {row}, " if len(motions) > 1 else ""
            if sequences is not None:
                place = f"row {row} (sequence {sequences[row]}), "
            if len(rows) > 1:
                found += f", and likewise in {len(doubts)} of {len(rows)} motions"
            raise InputFileError(source, place + where, expected=expected, found=found, remedy=_OTHER_STATISTICS)


def _steps(motion: np.ndarray) -> tuple[str, str, str, bool] | None:
    """Return the pelvis steps by another length in the root block than among the joint velocities."""
    stepped, walked = _step_lengths(motion)
    ratio = stepped / max(walked, 1e-12)
    if 1 / _SAME_SCALE < ratio < _SAME_SCALE:
        return None
    contacts = motion[:, FOOT_CONTACTS]
    undecided = np.minimum(np.abs(contacts), np.abs(contacts - 1)).min() > _UNDECIDED
    squeezed = bool(undecided) and float(np.ptp(contacts, axis=0).max()) < _LEAST_CONTACTS_VARY
    stretched = float(np.abs(contacts).max()) > _FARTHEST_CONTACT
    expected = f"steps of the pelvis as long as those in columns 193 and 195 ({walked * 1000:.1f} mm a frame)"
    found = f"{stepped * 1000:.1f} mm ({ratio:.2g} times as long)"
    return "columns 1 and 2", expected, found, squeezed or stretched or not 1 / _NO_MODEL < ratio < _NO_MODEL


def _step_lengths(motion: np.ndarray) -> tuple[float, float]:
    """Mean step of the pelvis on the ground, metres: from the root block, and from the joint velocities."""
    pelvis = motion[:, JOINT_VELOCITIES.start : JOINT_VELOCITIES.start + 3 : 2]
    stepped = float(np.linalg.norm(motion[:, ROOT_LINEAR_VELOCITY], axis=1).mean())
    walked = float(np.linalg.norm(pelvis, axis=1).mean())
    return stepped, walked


def _contacts(motion: np.ndarray) -> tuple[str, str, str, bool] | None:
    """Foot contacts, which are 0 or 1, lie nowhere near."""
    contacts = motion[:, FOOT_CONTACTS]
    if np.abs(contacts).max() <= _FARTHEST_CONTACT:
        return None
    return "columns 259 to 262", "foot contacts near 0 or 1", f"{contacts.min():.1f} to {contacts.max():.1f}", True


def _speed(motion: np.ndarray) -> tuple[str, str, str, bool] | None:
    """Joints move faster than any body for the whole motion."""
    if len(motion) < 2:
        return None
    speed = float(np.linalg.norm(np.diff(decode(motion), axis=0), axis=-1).mean())
    if speed <= _FASTEST:
        return None
    expected = f"joints that move less than {_FASTEST * 100:.0f} cm a frame in the mean"
    return "columns 0 to 66", expected, f"{speed * 100:.0f} cm", True


Root = Literal["relative", "absolute"]

_TINIEST_STD = 1e-8


@foreign_input()
def read_feature_statistics(mean: Path, std: Path) -> Statistics:
    """``Mean.npy`` and ``Std.npy`` of the generator.

    Use the pair that the model was *trained* with. Text-to-motion evaluators come with another one, whose root and
    contact blocks are about 25 times smaller (docs/specification/humanml3d.md#normalisation); some models were trained
    with that one. :func:`check_features` tells a wrong pair from the numbers.

    Args:
        mean: 263 numbers.
        std: 263 numbers above 0; a zero (a feature that never changed) becomes 1.

    Raises:
        InputFileError: if a file is missing, no ``.npy`` of plain numbers, or holds other than 263 finite numbers.
    """
    remedy = "Give the Mean.npy and Std.npy that the model was trained with."
    vectors = []
    for path in (mean, std):
        values = load_array(path, remedy=remedy)
        fits = values.shape == (N_FEATURES,) and values.dtype.kind in "fiu"
        found = f"shape {values.shape} of {values.dtype}"
        require(path, (fits, "", f"{N_FEATURES} numbers", found, remedy))
        require_rows(path, ~np.isfinite(values), "a finite number", "NaN or infinity", place="column", first=0)
        vectors.append(values.astype(np.float32))
    means, stds = vectors
    remedy = "Is this Mean.npy?"
    require_rows(std, stds < 0, "0 or more", lambda row: f"{stds[row]:g}", place="column", first=0, remedy=remedy)
    return Statistics(means, np.where(stds < _TINIEST_STD, np.float32(1.0), stds))


def feature_rows(output: np.ndarray, *, source: str = FEATURES) -> Float[np.ndarray, "batch rows 263"]:
    """Return the output of a model as (batch, rows, 263).

    Args:
        output: (rows, 263), (batch, rows, 263), (batch, 263, 1, rows) as MDM and its family have it, or
            (batch, 263, rows). Where rows could be features, the last axis counts as features.
        source: Name that messages begin with.

    Raises:
        InputFileError: if no axis holds 263 features.
    """
    if output.ndim == 4 and output.shape[1:3] == (N_FEATURES, 1):
        return np.moveaxis(output[:, :, 0], 1, 2)
    if output.ndim == 2 and output.shape[1] == N_FEATURES:
        return output[None]
    if output.ndim == 3 and output.shape[2] == N_FEATURES:
        return output
    if output.ndim == 3 and output.shape[1] == N_FEATURES:
        return np.moveaxis(output, 1, 2)
    of_kit = "251 features are those of the KIT skeleton of 21 joints; they are not read."
    remedy = of_kit if N_FEATURES - 12 in output.shape else ""
    expected = "(batch, rows, 263), (rows, 263) or (batch, 263, 1, rows)"
    raise InputFileError(source, "", expected=expected, found=str(output.shape), remedy=remedy)


def motions_from_features(
    features: Float[np.ndarray, "batch rows 263"] | Sequence[Float[np.ndarray, "_ 263"]],
    n_frames: Sequence[int] | Int[np.ndarray, " batch"],
    *,
    root: Root = "relative",
    check: bool = True,
    source: str = FEATURES,
    sequences: Sequence[str] | np.ndarray | None = None,
) -> list[Float[np.ndarray, "_ 22 3"]]:
    """Joints of a batch of motions from raw features; each starts over the origin, facing +Z.

    Decodes as :func:`joints_from_features`. What it adds: whether the statistics were the model's own is judged over
    the batch, so that a single odd motion stops nothing.

    Args:
        features: Raw (restored with the model's statistics), one motion a row (:func:`feature_rows`).
        n_frames: Frames wanted of each: ``batch.n_frames``.
        root: See :func:`joints_from_features`.
        check: Refuse a batch that was restored with foreign statistics (:func:`check_features`).
        source: Name of the method, with which messages begin.
        sequences: Name of each motion, for messages: ``batch.opaque_id``.

    Returns:
        Metres, float32; the floor is where the model has it.

    Raises:
        InputFileError: if there are too few rows, a number is not finite, or the check fails.
    """
    expected = f"features of {len(n_frames)} motions, one for each of n_frames"
    require(source, (len(features) == len(n_frames), "", expected, len(features), ""))
    names = [f"{source}, row {row}" for row in range(len(features))]
    if sequences is not None:
        names = [f"{name} (sequence {sequence})" for name, sequence in zip(names, sequences)]
    wanted = [int(count) for count in n_frames]
    used = [_used_rows(features[row], wanted[row], root, names[row]) for row in range(len(names))]
    if check:
        check_features(used, source=source, sequences=sequences)
    return [_decoded(rows, frames) for rows, frames in zip(used, wanted)]


def joints_from_features(
    features: Float[np.ndarray, "rows 263"],
    n_frames: int | None = None,
    *,
    root: Root = "relative",
    check: bool = True,
    source: str = FEATURES,
) -> Float[np.ndarray, "frames 22 3"]:
    """Joints of one motion from raw features; it starts over the origin, facing +Z.

    A row holds a frame and the step to the next one, so N frames encode to N - 1 rows, and N - 1 rows decode to N - 1
    frames. Where one frame more is asked for, it is taken from the joint velocities of the last row. For several
    motions of one model :func:`motions_from_features` knows more.

    Args:
        features: Raw (restored with the model's statistics).
        n_frames: Frames wanted: as many as rows, one more, or fewer (rows behind are padding). None for all rows.
        root: ``absolute`` for models of the GMD family, whose first three columns hold heading (half angle) and place
            of the pelvis instead of their steps (docs/specification/gmd.md#representation).
        check: Refuse features that were restored with foreign statistics (:func:`check_features`).
        source: Name that messages begin with.

    Returns:
        Metres, float32; the floor is where the model has it.

    Raises:
        InputFileError: if there are too few rows, a number is not finite, or the check fails.
    """
    wanted = len(features) if n_frames is None else n_frames
    used = _used_rows(features, wanted, root, source)
    if check:
        check_features(used, source=source)
    return _decoded(used, wanted)


def _used_rows(features: np.ndarray, wanted: int, root: Root, source: str) -> np.ndarray:
    """Return the rows that the frames wanted come from, float64, relative root."""
    rows = len(features)
    expected = f"{wanted} rows, or {wanted - 1}, for {wanted} frames"
    remedy = "Ask the model for as many rows as the batch's n_frames."
    require(source, (1 <= wanted <= rows + 1 and rows > 0, "", expected, rows, remedy))
    used = features[: min(wanted, rows)].astype(np.float64)
    bad = np.argwhere(~np.isfinite(used))
    if bad.size:
        row, column = bad[0]
        raise InputFileError(source, f"row {row}, column {column}", expected="a finite number", found="NaN or infinity")
    return relative_root(used) if root == "absolute" else used


def _decoded(used: np.ndarray, wanted: int) -> np.ndarray:
    joints = decode(used)
    if wanted > len(used):
        # The frame to which the joint velocities of the last row lead.
        last = joints[-1]
        yaw = 2 * used[:-1, ROOT_YAW_VELOCITY].sum(axis=0)
        world_from_heading = yaw_matrices(np.cos(yaw), -np.sin(yaw))[0]
        step = used[-1, JOINT_VELOCITIES].reshape(N_JOINTS, 3) @ world_from_heading.T
        joints = np.concatenate([joints, (last + step).astype(np.float32)[None]])
    return joints


def relative_root(features: Float[np.ndarray, "rows 263"]) -> Float[np.ndarray, "rows 263"]:
    """Features with absolute heading and place in the first three columns, as HumanML3D has them: as steps.

    Args:
        features: Column 0 holds the heading as half an angle, columns 1 and 2 the pelvis's x and z.

    Returns:
        Raw features. The last row's step is 0, for no row says where it leads; the start is moved to the origin.
    """
    steps = features.copy()
    heading = features[:, 0] - features[0, 0]
    steps[:-1, 0], steps[-1, 0] = np.diff(heading), 0.0
    start = yaw_matrices(np.cos(2 * features[:1, 0]), np.sin(2 * features[:1, 0]))[0]
    place = np.zeros((len(features), 3))
    place[:, ::2] = features[:, 1:3] - features[:1, 1:3]
    walked = np.diff(place @ start.T, axis=0)
    seen = yaw_matrices(np.cos(2 * heading[1:]), np.sin(2 * heading[1:])) @ walked[..., None]
    steps[:-1, ROOT_LINEAR_VELOCITY], steps[-1, ROOT_LINEAR_VELOCITY] = seen[:, ::2, 0], 0.0
    return steps
