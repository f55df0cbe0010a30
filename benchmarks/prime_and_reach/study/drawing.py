"""Figures 4 and S3 from the numbers of :mod:`prbench_benchmarks.prime_and_reach.study`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prbench.errors import UsageError
from prbench.metrics import MAIN_METRICS, printed_unit
from prbench_benchmarks.prime_and_reach.study.breakdown import GroupScore
from prbench_benchmarks.prime_and_reach.study.charts import MOST_RUNS, Bar, BarPanel, CurvePanel, draw_bars, draw_sweeps
from prbench_benchmarks.prime_and_reach.study.genuine import GenuineRun
from prbench_benchmarks.prime_and_reach.study.sweep import Sweep

_SYNTHETIC = "Synthetic people: says nothing about real ones."


def draw_breakdown(scores: Sequence[GroupScore], by: str, path: Path) -> None:
    """Draw Figure 4: a panel for each metric, bars by group.

    Args:
        scores: Of :func:`prbench_benchmarks.prime_and_reach.study.breakdown.break_down`.
        by: What the sequences are grouped by.
        path: ``.png`` or ``.svg``.

    Raises:
        UsageError: for another kind of file, or more runs than there are colours.
        StorageError: if the file cannot be written.
    """
    runs = {one.run.title for one in scores}
    if len(runs) > MOST_RUNS:
        raise UsageError(f"expected at most {MOST_RUNS} runs in one figure, found {len(runs)}.")
    panels = []
    for info in MAIN_METRICS:
        bars = tuple(_bar(one) for one in scores if one.info.id == info.id)
        if bars:
            unit = printed_unit(info.unit).strip()
            panels.append(BarPanel(f"{info.title}{info.arrow}{f' ({unit})' if unit else ''}", bars))
    draw_bars(
        panels,
        path,
        title=f"Scores by {by}",
        foot=" ".join(
            (
                "Lines: 95 % intervals over the recordings of each group."
                " Groups hold other sequences: overlap of intervals is no comparison.",
                *_warnings([one.run for one in scores]),
            )
        ),
    )


def draw_sweep(sweeps: Sequence[Sweep], path: Path) -> None:
    """Draw Figure S3: a panel for each run, a curve for each window.

    Args:
        sweeps: Of :func:`prbench_benchmarks.prime_and_reach.study.sweep.sweep`, all of one variant.
        path: ``.png`` or ``.svg``.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    constants = sweeps[0].run.protocol.metrics
    panels = [
        CurvePanel(f"{one.run.title}, {one.sequences} sequences", one.distances, one.windows, 100 * one.rates)
        for one in sweeps
    ]
    draw_sweeps(
        panels,
        path,
        title=f"Prime Success ({sweeps[0].variant}) over distance δ and window σ",
        limits=(constants.prime_distance, constants.prime_window),
        foot=" ".join(_warnings([one.run for one in sweeps])),
    )


def _bar(one: GroupScore) -> Bar:
    scale = one.info.scale
    estimate = one.estimate
    return Bar(
        run=one.run.title,
        group=one.group,
        mean=scale * estimate.mean,
        low=None if estimate.low is None else scale * estimate.low,
        high=None if estimate.high is None else scale * estimate.high,
        count=f"{estimate.n_sequences} of {estimate.n_recordings} rec.",
    )


def _warnings(runs: Sequence[GenuineRun]) -> list[str]:
    return [_SYNTHETIC] if any(run.record.synthetic for run in runs) else []
