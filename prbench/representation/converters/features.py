"""Joints from what a HumanML3D model puts out: statistics, layout, rows and frames.

Sources: docs/specification/humanml3d.md#inverse and docs/specification/humanml3d.md#normalisation.

The steps, each a function: :func:`feature_rows`, :meth:`Statistics.restore`, :func:`motions_from_features`, and then
:func:`prbench.representation.converters.placed_on`. No torch: tensors come as ``tensor.detach().cpu().numpy()``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.files.arrays import load_array
from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import N_JOINTS
from prbench.representation.converters.feature_checks import FEATURES, check_features
from prbench.representation.encoding import decode, decode_rotations, yaw_matrices
from prbench.representation.features import (
    JOINT_VELOCITIES,
    N_FEATURES,
    REST_OFFSETS,
    ROOT_LINEAR_VELOCITY,
    ROOT_YAW_VELOCITY,
)
from prbench.representation.statistics import Statistics

Root = Literal["relative", "absolute"]
Bones = Literal["positions", "rotations"]

_TINIEST_STD = 1e-8


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
    means = _vector(mean)
    stds = _vector(std)
    if (stds < 0).any():
        column = int(np.flatnonzero(stds < 0)[0])
        raise InputFileError(
            std, f"column {column}", expected="0 or more", found=f"{stds[column]:g}", remedy="Is this Mean.npy?"
        )
    return Statistics(means, np.where(stds < _TINIEST_STD, np.float32(1.0), stds))


@foreign_input()
def _vector(path: Path) -> np.ndarray:
    remedy = "Give the Mean.npy and Std.npy that the model was trained with."
    values = load_array(path, remedy=remedy)
    if values.shape != (N_FEATURES,) or values.dtype.kind not in "fiu":
        found = f"shape {values.shape} of {values.dtype}"
        raise InputFileError(path, "", expected=f"{N_FEATURES} numbers", found=found, remedy=remedy)
    if not np.isfinite(values).all():
        column = int(np.flatnonzero(~np.isfinite(values))[0])
        raise InputFileError(path, f"column {column}", expected="a finite number", found=str(values[column]))
    return values.astype(np.float32)


def feature_rows(output: np.ndarray, *, source: str = FEATURES) -> Float[np.ndarray, "batch rows 263"]:
    """The output of a model as (batch, rows, 263).

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
    raise InputFileError(
        source,
        "",
        expected="(batch, rows, 263), (rows, 263) or (batch, 263, 1, rows)",
        found=str(output.shape),
        remedy="251 features are those of the KIT skeleton of 21 joints; they are not read."
        if N_FEATURES - 12 in output.shape
        else "",
    )


def motions_from_features(
    features: Float[np.ndarray, "batch rows 263"] | Sequence[Float[np.ndarray, "_ 263"]],
    n_frames: Sequence[int] | Int[np.ndarray, " batch"],
    *,
    root: Root = "relative",
    bones: Bones = "positions",
    offsets: Float[np.ndarray, "*batch 22 3"] = REST_OFFSETS,
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
        root: As in :func:`joints_from_features`.
        bones: Likewise.
        offsets: Likewise; of one body, or of each (batch, 22, 3).
        check: Refuse a batch that was restored with foreign statistics (:func:`check_features`).
        source: Name of the method, with which messages begin.
        sequences: Name of each motion, for messages: ``batch.opaque_id``.

    Returns:
        Metres, float32; the floor is where the model has it.

    Raises:
        InputFileError: if there are too few rows, a number is not finite, or the check fails.
    """
    if len(features) != len(n_frames):
        raise InputFileError(
            source,
            "",
            expected=f"features of {len(n_frames)} motions, one for each of n_frames",
            found=str(len(features)),
        )
    names = [f"{source}, row {row}" for row in range(len(features))]
    if sequences is not None:
        names = [f"{name} (sequence {sequence})" for name, sequence in zip(names, sequences)]
    wanted = [int(count) for count in n_frames]
    used = [_used_rows(features[row], wanted[row], root, names[row]) for row in range(len(names))]
    if check:
        check_features(used, source=source, sequences=sequences)
    bodies = np.broadcast_to(offsets, (len(used), N_JOINTS, 3))
    return [_decoded(rows, frames, bones, body) for rows, frames, body in zip(used, wanted, bodies)]


def joints_from_features(
    features: Float[np.ndarray, "rows 263"],
    n_frames: int | None = None,
    *,
    root: Root = "relative",
    bones: Bones = "positions",
    offsets: Float[np.ndarray, "22 3"] = REST_OFFSETS,
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
        bones: ``positions`` decodes columns 4 to 66, as everybody does for evaluation; ``rotations`` decodes the
            rotations on ``offsets``, so bones keep their lengths, but errors add up along the limbs.
        offsets: With ``rotations``: the uniform skeleton, or the body of the initial pose
            (:func:`prbench.representation.rest_offsets`).
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
    return _decoded(used, wanted, bones, offsets)


def _used_rows(features: np.ndarray, wanted: int, root: Root, source: str) -> np.ndarray:
    """The rows that the frames wanted come from, float64, relative root."""
    rows = len(features)
    if not 1 <= wanted <= rows + 1 or rows == 0:
        raise InputFileError(
            source,
            "",
            expected=f"{wanted} rows, or {wanted - 1}, for {wanted} frames",
            found=str(rows),
            remedy="Ask the model for as many rows as the batch's n_frames.",
        )
    used = features[: min(wanted, rows)].astype(np.float64)
    bad = np.argwhere(~np.isfinite(used))
    if bad.size:
        row, column = bad[0]
        raise InputFileError(source, f"row {row}, column {column}", expected="a finite number", found="NaN or infinity")
    return relative_root(used) if root == "absolute" else used


def _decoded(used: np.ndarray, wanted: int, bones: Bones, offsets: np.ndarray) -> np.ndarray:
    joints = decode(used) if bones == "positions" else decode_rotations(used, offsets)
    if wanted > len(used):
        joints = np.concatenate([joints, _frame_after(used, joints[-1])[None]])
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


def _frame_after(features: np.ndarray, last: np.ndarray) -> np.ndarray:
    """The frame to which the joint velocities of the last row lead."""
    yaw = 2 * features[:-1, ROOT_YAW_VELOCITY].sum(axis=0)
    world_from_heading = yaw_matrices(np.cos(yaw), -np.sin(yaw))[0]
    step = features[-1, JOINT_VELOCITIES].reshape(N_JOINTS, 3) @ world_from_heading.T
    return (last + step).astype(np.float32)
