"""All metrics of predicted motions, in chunks that fit in the processor's cache."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from prbench.metrics.batch import require_equal_lengths
from prbench.metrics.registry import MetricFamily, MetricInfo, MetricValues
from prbench.metrics.targets import ScoringPair
from prbench.protocol.manifests import MetricConstants

CHUNK_FRAMES = 8192
LENGTH_MISMATCH = "length_mismatch"


def score_pair(
    pair: ScoringPair,
    constants: MetricConstants,
    families: tuple[MetricFamily, ...],
    *,
    metrics: Collection[str] | None,
    allow_length_mismatch: bool,
    chunk_frames: int,
) -> dict[str, MetricValues]:
    """Compute the wanted metrics chunk by chunk; see :func:`prbench.metrics.score`."""
    wanted = _wanted(pair, families, metrics)
    _check(pair, wanted, allow_length_mismatch=allow_length_mismatch)
    chunks = []
    for start, stop in pair.predicted.chunk_bounds(chunk_frames):
        part = pair.part(start, stop)
        part.predicted.require_finite("predicted", counted_from=start)
        part.recorded.require_finite("recorded", counted_from=start)
        chunks.append({values.metric: values for family in wanted for values in family.compute(part, constants)})
    # The whole batch is known here; a chunk would flag only its own sequences.
    mismatch = pair.predicted.n_frames != pair.recorded.n_frames
    ids = [info.id for info in _infos(wanted, metrics)]
    return {metric: _joined(metric, [chunk[metric] for chunk in chunks], mismatch) for metric in ids}


def _wanted(
    pair: ScoringPair, families: tuple[MetricFamily, ...], metrics: Collection[str] | None
) -> tuple[MetricFamily, ...]:
    known = {info.id: family for family in families for info in family.metrics}
    unknown = sorted(set(metrics or ()) - known.keys())
    if unknown:
        raise ValueError(f"unknown metric '{unknown[0]}'; known ones are: {', '.join(known)}")
    if metrics is None:
        return tuple(family for family in families if _is_given(family, pair))
    chosen = tuple(family for family in families if any(info.id in metrics for info in family.metrics))
    if any(family.needs_gaze for family in chosen) and pair.targets.gaze is None:
        raise ValueError("a metric of gaze was asked for, but the targets hold no gaze")
    if any(family.needs_scene for family in chosen) and pair.targets.scene is None:
        raise ValueError("a metric of the scene was asked for, but the targets hold no boxes")
    return chosen


def _is_given(family: MetricFamily, pair: ScoringPair) -> bool:
    """Return True where the targets hold what a family needs beside goals and times."""
    has_gaze = pair.targets.gaze is not None or not family.needs_gaze
    return has_gaze and (pair.targets.scene is not None or not family.needs_scene)


def _infos(families: tuple[MetricFamily, ...], metrics: Collection[str] | None) -> list[MetricInfo]:
    infos = [info for family in families for info in family.metrics if metrics is None or info.id in metrics]
    return sorted(infos, key=lambda info: info.position)


def _check(pair: ScoringPair, families: tuple[MetricFamily, ...], *, allow_length_mismatch: bool) -> None:
    predicted = pair.predicted
    recorded = pair.recorded
    if not len(pair.targets) == predicted.n_sequences == recorded.n_sequences:
        raise ValueError(
            f"expected as many predicted as recorded motions and targets, found {predicted.n_sequences},"
            f" {recorded.n_sequences} and {len(pair.targets)}"
        )
    if not allow_length_mismatch:
        require_equal_lengths(predicted, recorded)
    if pair.targets.gaze is not None and len(pair.targets.gaze.valid) != len(predicted.values):
        raise ValueError(f"expected {len(predicted.values)} gaze rays, found {len(pair.targets.gaze.valid)}")
    if pair.targets.scene is not None and len(pair.targets.scene) != len(pair.targets):
        raise ValueError(
            f"expected the boxes of {len(pair.targets)} sequences, found those of {len(pair.targets.scene)}"
        )
    minimum = max((family.minimum_frames for family in families), default=1)
    predicted.require_frames(minimum)
    recorded.require_frames(minimum)


def _joined(metric: str, parts: list[MetricValues], mismatch: np.ndarray) -> MetricValues:
    if not parts:
        return MetricValues(metric, np.empty(0), {})
    flags = {name: np.concatenate([part.flags[name] for part in parts]) for name in parts[0].flags}
    if mismatch.any():
        flags[LENGTH_MISMATCH] = mismatch
    raised = {name: mask for name, mask in flags.items() if mask.any()}
    return MetricValues(metric, np.concatenate([part.value for part in parts]), raised)
