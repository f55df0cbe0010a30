"""The common part of runs and scored motions: long-form scores, means with intervals, and how both are shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pyarrow as pa

from prbench.api.frames import frame_from_rows, frame_of, notebook_table
from prbench.harness.run_folder import DatasetSummary
from prbench.metrics import METRICS, printed_scale, printed_unit

if TYPE_CHECKING:
    import pandas as pd

_METRIC = (
    "metric", "title", "unit", "mean", "low", "high", "level", "interval", "sequences", "recordings",
)  # fmt: skip
_SUMMARY = ("dataset", "method", "condition", *_METRIC, "marks")
_SHOWN = ("metric", "mean", "95 % interval", "remark")
_ON_SYNTHETIC_DATA = "These are scores on synthetic data: never compare them with published ones."


def summary_frame(summaries: Sequence[DatasetSummary], irrelevant: frozenset[str]) -> pd.DataFrame:
    """Return one row a dataset and metric: the mean over sequences with its interval.

    Args:
        summaries: One a dataset.
        irrelevant: Ids of metrics that say nothing of this method; they are left out.
    """
    rows = []
    for summary in summaries:
        about = (summary.dataset, summary.method, summary.condition)
        for metric in summary.metrics:
            if metric.metric not in irrelevant:
                values = (getattr(metric, name) for name in _METRIC)
                rows.append((*about, *values, ";".join(metric.marks)))
    return frame_from_rows(rows, _SUMMARY)


def scores_frame(tables: Sequence[pa.Table]) -> pd.DataFrame:
    """Return scores in long form as one frame.

    Args:
        tables: Long forms, one a dataset.
    """
    return frame_of(pa.concat_tables(tables).combine_chunks())


def irrelevant_metrics(*, motionless: bool) -> frozenset[str]:
    """Return ids of the metrics that say nothing of a method that declares to stand still.

    Args:
        motionless: The method declares so.
    """
    return frozenset(info.id for info in METRICS if motionless and info.irrelevant_if_motionless)


def scores_for_notebook(summaries: Sequence[DatasetSummary], irrelevant: frozenset[str], *, origin: str) -> str:
    """Return the means with their intervals as a notebook shows them, in the units that the study prints.

    Args:
        summaries: One a dataset.
        irrelevant: See :func:`summary_frame`.
        origin: Where the method comes from, in words.
    """
    parts = []
    for summary in summaries:
        title = (
            f"{summary.title}: {summary.method} ({origin}), condition {summary.condition};"
            f" {summary.sequences} sequences of {summary.recordings} recordings, split {summary.split}"
        )
        rows = []
        for metric in summary.metrics:
            if metric.metric in irrelevant:
                continue
            scale = printed_scale(metric.unit)
            interval = "–"
            if metric.low is not None and metric.high is not None:
                interval = f"[{metric.low * scale:.2f}, {metric.high * scale:.2f}]"
            remarks = [mark.replace("_", " ") for mark in metric.marks]
            remarks += [f"{count} × {name.replace('_', ' ')}" for name, count in sorted(metric.flags.items())]
            mean = f"{metric.mean * scale:.2f}{printed_unit(metric.unit)}"
            rows.append((metric.title, mean, interval, "; ".join(remarks)))
        below = []
        if summary.unsupported:
            below.append(
                f"{summary.unsupported} sequences are longer than the method can generate and were not scored."
            )
        if summary.mark:
            below.append(f"{summary.mark}.")
        if summary.synthetic:
            below.append(_ON_SYNTHETIC_DATA)
        parts.append(notebook_table(title, frame_from_rows(rows, _SHOWN), below))
    return "".join(parts)


def described(summaries: Sequence[DatasetSummary]) -> str:
    """Return the method, its condition and the datasets in a few words.

    Args:
        summaries: One a dataset, at least one.
    """
    first = summaries[0]
    where = ", ".join(f"{summary.sequences} sequences of {summary.dataset}" for summary in summaries)
    return f"{first.method}, condition {first.condition}, {where}"
