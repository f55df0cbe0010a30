"""Metrics of stochastic prediction: five as the study computes them, and ours beside them.

Source: docs/specification/motion-prediction.md#metrics. Distances are Euclidean; those of the study are over the
flattened pose, sqrt(J) times the root mean square a joint. Everything is computed in float64.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist, pdist

from prbench.errors import UsageError
from prbench.metrics import MetricInfo
from prbench_benchmarks.motion_prediction.joint_sets import JOINT_SETS
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol

Poses = Float[np.ndarray, "batch joints 3"]
Scores = Float[np.ndarray, " batch"]
Futures = Float[np.ndarray, "batch samples frames joints 3"]  # metres
Recorded = Float[np.ndarray, "batch frames joints 3"]  # metres

_MOST_VALUES = 8_000_000  # Float64 values of one block of distances between samples and futures: 64 MB.
_DEGENERATE_BONE = 1e-6  # metres; shorter bones have no relative error


def frame_errors(predicted: Futures, truth: Recorded) -> Float[np.ndarray, "batch samples frames"]:
    """Distance of the flattened pose in every frame, metres."""
    return np.sqrt(_squared_errors(predicted, truth).sum(axis=-1))


def joint_errors(predicted: Futures, truth: Recorded) -> Float[np.ndarray, "batch samples frames joints"]:
    """Distance of every joint in every frame, metres."""
    return np.sqrt(_squared_errors(predicted, truth))


def _squared_errors(predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    apart = predicted.astype(np.float64) - truth[:, None]
    return np.einsum("...c,...c->...", apart, apart)


def displacements(errors: Float[np.ndarray, "batch samples frames"]) -> dict[str, Scores]:
    """ADE and FDE from :func:`frame_errors`, metres; any distance a frame will do.

    Returns:
        ``ade``, mean over the frames, of the best sample; ``fde``, last frame, of the best sample, which may be another
        one; ``ade_mean`` and ``fde_mean``, means over the samples in place of the best one, which reward no spread.

    Raises:
        UsageError: without samples or frames.
    """
    if 0 in errors.shape[1:]:
        raise UsageError(f"expected one sample and one frame or more, found {errors.shape[1]} and {errors.shape[2]}.")
    average = errors.mean(axis=2)
    last = errors[:, :, -1]
    best = {"ade": average.min(axis=1), "fde": last.min(axis=1)}
    return best | {"ade_mean": average.mean(axis=1), "fde_mean": last.mean(axis=1)}


def diversity(predicted: Futures) -> Scores:
    """APD: mean distance of two samples over the flattened motion, metres; 0 for one sample."""
    batch, samples = predicted.shape[:2]
    if samples < 2:
        return np.zeros(batch)
    return np.array([pdist(each).mean() for each in predicted.reshape(batch, samples, -1).astype(np.float64)])


def similar_pasts(
    last_poses: Float[np.ndarray, "windows joints 3"], *, closer_than: float, block: int = 1024
) -> list[np.ndarray]:
    """For each window the windows whose last observed pose is close, itself included.

    Args:
        last_poses: Metres, joints alone; in the room, or each in the frame of its own pelvis.
        closer_than: Distance over the flattened pose, metres; a pose exactly as far away is not close.
        block: Windows that are compared at once.

    Returns:
        Ascending places of the windows of each set.
    """
    flat = last_poses.reshape(len(last_poses), -1).astype(np.float64)
    sets = []
    for start in range(0, len(flat), block):
        sets += [np.flatnonzero(row) for row in (cdist(flat[start : start + block], flat) < closer_than)]
    return sets


def multimodal_displacements(
    predicted: Float[np.ndarray, "samples frames joints 3"], futures: Float[np.ndarray, "members frames joints 3"]
) -> tuple[float, float]:
    """MMADE and MMFDE of one window: the best sample for each of several futures, averaged over these, metres.

    Args:
        predicted: The samples of the window.
        futures: The futures of all windows with a similar past, the window's own among them.
    """
    samples, frames = predicted.shape[:2]
    flat = predicted.reshape(samples, frames, -1).astype(np.float64)
    members = futures.reshape(len(futures), frames, -1).astype(np.float64)
    most = max(1, _MOST_VALUES // flat.size)
    ade = []
    fde = []
    for start in range(0, len(members), most):
        part = members[start : start + most]
        # One subtraction for a block of members; a Gram matrix would lose digits where motions nearly agree.
        errors = np.linalg.norm(flat[None] - part[:, None], axis=-1)
        ade.append(errors.mean(axis=2).min(axis=1))
        fde.append(errors[:, :, -1].min(axis=1))
    return float(np.concatenate(ade).mean()), float(np.concatenate(fde).mean())


def first_frame_jump(predicted: Futures, last_observed: Poses) -> Scores:
    """Mean distance of the joints between the last observed and the first predicted frame, over all samples, metres."""
    apart = predicted[:, :, 0].astype(np.float64) - last_observed[:, None]
    return np.linalg.norm(apart, axis=-1).mean(axis=(1, 2))


def bone_error(predicted: Futures, last_observed: Poses, bones: Sequence[tuple[int, int]]) -> Scores:
    """Mean deviation of the bones' lengths from those of the last observed pose, percent.

    Args:
        predicted: Metres.
        last_observed: Metres.
        bones: (parent, child); such as have no length in the last observed pose are left out of its mean.
    """
    parents, children = np.transpose(bones)
    lengths = np.linalg.norm(predicted[..., children, :].astype(np.float64) - predicted[..., parents, :], axis=-1)
    rest = np.linalg.norm(last_observed[:, children].astype(np.float64) - last_observed[:, parents], axis=-1)
    known = rest > _DEGENERATE_BONE
    deviation = np.abs(lengths - rest[:, None, None]) / np.where(known, rest, 1.0)[:, None, None]
    share = known / np.maximum(known.sum(axis=1, keepdims=True), 1)
    return 100.0 * np.einsum("bktn,bn->b", deviation, share) / np.prod(lengths.shape[1:3])


def goal_distances(
    predicted_wrists: Float[np.ndarray, "batch samples 2 3"], goal: Float[np.ndarray, "batch 3"]
) -> tuple[Scores, Scores]:
    """Distance of the nearer wrist to the goal at the event: of the best sample, and mean over the samples, metres."""
    distance = np.linalg.norm(predicted_wrists.astype(np.float64) - goal[:, None, None], axis=-1).min(axis=2)
    return distance.min(axis=1), distance.mean(axis=1)


_LOWER = False
_HIGHER = True


@cache
def prediction_metrics() -> tuple[MetricInfo, ...]:
    """Return all scores that ``scoring.score_batch`` may give, in printed order."""
    rules = load_prediction_protocol().evaluation
    infos = [
        *(_info(name, name.upper(), main=True) for name in ("ade", "fde", "mmade", "mmfde")),
        # Spread is a merit beside a small error alone: a predictor that answers anything has most of it.
        _info("apd", "APD", main=True, better=_HIGHER, ranked=False, compared=False),
        # Of windows that end at the event alone: where no window of a table does, boards have an empty column.
        _info("wrist_to_goal", "Wrist to goal", main=True),
        _info("ade_mean", "ADE, mean over samples"),
        _info("fde_mean", "FDE, mean over samples"),
        _info("mmade_canonical", "MMADE, own frames"),
        _info("mmfde_canonical", "MMFDE, own frames"),
        _info("similar_pasts", "Similar pasts", unit="windows", better=None),
        _info("similar_pasts_canonical", "Similar pasts, own frames", unit="windows", better=None),
    ]
    for n in rules.samples:
        infos += [_info(f"ade@k{n}", f"ADE, K = {n}"), _info(f"fde@k{n}", f"FDE, K = {n}")]
    for seconds in rules.horizons:
        infos.append(_info(f"ade@{seconds:g}s", f"ADE to {seconds:g} s"))
        infos.append(_info(f"fde@{seconds:g}s", f"FDE at {seconds:g} s"))
    infos += [
        _info("wrists_ade", "ADE, wrists"),
        _info("wrists_fde", "FDE, wrists"),
        _info("first_frame_jump", "First-frame jump"),
        _info("bone_error_percent", "Bone error", unit="%"),
        _info("wrist_to_goal_mean", "Wrist to goal, mean over samples"),
        _info("wrist_to_goal_recorded", "Wrist to goal, as recorded", better=None),
        _info("pelvis_at_event", "Pelvis at event"),
        _info("pelvis_at_event_mean", "Pelvis at event, mean over samples"),
        _info("mpjpe", "MPJPE"),
    ]
    joints = dict.fromkeys(name for each in JOINT_SETS.values() for name in each.names)
    infos += [_info(f"joint/{name}", f"MPJPE, {name}", is_detail=True) for name in joints]
    return tuple(replace(info, position=position) for position, info in enumerate(infos))


def _info(id: str, title: str, *, unit: str = "m", better: bool | None = _LOWER, **more: bool) -> MetricInfo:
    """Return a score that compares with what happened; its position is set with those of all others."""
    about: Any = {"main": False, "position": 0, "compares_with_recorded": True, **more}
    return MetricInfo(id=id, title=title, unit=unit, higher_is_better=better, **about)
