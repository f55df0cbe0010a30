"""From scores in long form to means with intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from prbench.evaluation.intervals import CONFIDENCE, metric_interval
from prbench.metrics import METRICS, MetricInfo
from prbench.metrics.scoring import LENGTH_MISMATCH
from prbench.runs.record import TableRecord
from prbench.runs.summary import DatasetSummary, MetricSummary
from prbench.sequences import DatasetInfo


@dataclass(frozen=True, kw_only=True)
class ScoredSet:
    """What the scores are of."""

    info: DatasetInfo | TableRecord
    recording_of: Mapping[str, str]
    """Recording of each scored sequence."""
    chosen: int
    """Sequences of split and limit, whether or not the method could generate them."""
    method: str
    condition: str
    control: str | None
    split: str
    samples: int


def summarise(scores: pa.Table, scored: ScoredSet) -> DatasetSummary:
    """``summary.json`` of one dataset.

    Args:
        scores: Rows of ``scores.parquet``.
        scored: What they are of.
    """
    metrics = _metrics(scores, scored.recording_of)
    mismatched = max((metric.flags.get(LENGTH_MISMATCH, 0) for metric in metrics), default=0)
    return DatasetSummary(
        dataset=scored.info.dataset,
        title=titled(scored.info.title, synthetic=scored.info.synthetic),
        synthetic=scored.info.synthetic,
        redistribution=scored.info.redistribution,
        method=scored.method,
        condition=scored.condition,
        control=scored.control,
        split=scored.split,
        sequences=scored.chosen,
        unsupported=scored.chosen - len(scored.recording_of),
        recordings=len(set(scored.recording_of.values())),
        samples=scored.samples,
        length_mismatches=mismatched,
        metrics=metrics,
    )


def titled(title: str, *, synthetic: bool) -> str:
    """The title of a dataset, with the word "synthetic" where the data are."""
    return f"{title} (synthetic)" if synthetic and "synthetic" not in title.lower() else title


def _metrics(scores: pa.Table, recording_of: Mapping[str, str]) -> tuple[MetricSummary, ...]:
    names = np.array(scores["metric"].to_pylist(), dtype=object)
    present = set(names)
    return tuple(
        _summarised(info, scores.take(pa.array(np.flatnonzero(names == info.id))), recording_of)
        for info in METRICS
        if info.id in present
    )


def _summarised(info: MetricInfo, rows: pa.Table, recording_of: Mapping[str, str]) -> MetricSummary:
    sequence_ids = rows["sequence_id"].to_pylist()
    recording_ids = [recording_of[name] for name in sequence_ids]
    estimate = metric_interval(info, rows["value"].to_numpy(), recording_ids, sequence_ids)
    flags = Counter(flag for text in rows["flag"].to_pylist() if text for flag in text.split(";"))
    return MetricSummary(
        metric=info.id,
        title=info.title,
        unit=info.unit,
        mean=estimate.mean,
        low=estimate.low,
        high=estimate.high,
        level=CONFIDENCE,
        interval=estimate.method,
        sequences=estimate.n_sequences,
        recordings=estimate.n_recordings,
        marks=estimate.marks,
        flags=dict(sorted(flags.items())),
    )
