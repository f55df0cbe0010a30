"""The study's six metrics, their variants and plausibility: pure functions over ragged batches, one value a sequence.

Definitions: docs/specification/metrics.md; *Prime and Reach*, section 5.2. Constants come from the protocol.
"""

from __future__ import annotations

from collections.abc import Collection

from prbench.metrics.batch import UNKNOWN_HAND, GazeRays, MotionBatch, ScoringPair, ScoringTargets
from prbench.metrics.registry import (
    CHUNK_FRAMES,
    MetricFamily,
    MetricInfo,
    MetricValues,
    exported_unit,
    find_families,
    printed_scale,
    printed_unit,
    score_pair,
)
from prbench.protocol.manifests import MetricConstants

FAMILIES: tuple[MetricFamily, ...] = find_families(__name__, __path__)
# All metrics in the order in which they are printed.
METRICS: tuple[MetricInfo, ...] = tuple(
    sorted((info for family in FAMILIES for info in family.metrics), key=lambda info: info.position)
)
# Ids of the metrics that only motions with gaze have.
GAZE_METRICS: frozenset[str] = frozenset(info.id for family in FAMILIES if family.needs_gaze for info in family.metrics)
# Ids of the metrics that need the boxes of the scene.
SCENE_METRICS: frozenset[str] = frozenset(
    info.id for family in FAMILIES if family.needs_scene for info in family.metrics
)
# The metrics of any motion: those that need neither gaze nor the boxes of the scene.
METRICS_OF_MOTIONS: tuple[MetricInfo, ...] = tuple(
    info for info in METRICS if info.id not in GAZE_METRICS | SCENE_METRICS
)
# The columns of leaderboards.
MAIN_METRICS: tuple[MetricInfo, ...] = tuple(info for info in METRICS if info.main)
# The six columns of the study's Table 2.
STUDY_METRICS: tuple[MetricInfo, ...] = tuple(info for info in METRICS if info.in_study)


def score(
    predicted: MotionBatch,
    recorded: MotionBatch,
    targets: ScoringTargets,
    constants: MetricConstants,
    *,
    metrics: Collection[str] | None = None,
    allow_length_mismatch: bool = False,
    chunk_frames: int = CHUNK_FRAMES,
) -> dict[str, MetricValues]:
    """Score predicted motions against the recorded ones.

    Every sequence is scored on its own: neither its neighbours, nor their order, nor the size of the chunks changes a
    bit of its values.

    Args:
        predicted: Canonical frame, metres.
        recorded: The recorded motions of the same sequences, in the same order.
        targets: Their goals.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
        metrics: Ids of the wanted metrics; all by default, those of gaze and of the scene only where ``targets`` hold
            gaze and boxes.
        allow_length_mismatch: Accept motions of another length than the recorded one: the final frame is then each
            motion's own, MPJPE takes the frames that both have, and the values carry the flag ``length_mismatch``.
        chunk_frames: Frames that are worked on at once; a matter of speed and memory only.

    Returns:
        The values by metric id, in printed order.

    Raises:
        ValueError: for lengths that differ, sequences that are too short (one frame suffices for Goal MPJPE and
            Location Error, everything else needs two), NaN or infinity (naming sequence and frame, counted from 0),
            or an unknown metric.
    """
    return score_pair(
        ScoringPair(predicted, recorded, targets),
        constants,
        FAMILIES,
        metrics=metrics,
        allow_length_mismatch=allow_length_mismatch,
        chunk_frames=chunk_frames,
    )
