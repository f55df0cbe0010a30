"""Scores on the terminal: of a method on a dataset, of methods side by side, and of single sequences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from prbench.cli.terminal import print_table, shown_width
from prbench.rates_of_people import BinRate, RateAgreement

if TYPE_CHECKING:
    from collections.abc import Sequence

    from prbench.metrics import MetricInfo
    from prbench.runs import RunFolder
    from prbench.runs.agreement import DatasetAgreement
    from prbench.runs.summary import DatasetSummary, MetricSummary

_MARKS = {
    "few_recordings": "few recordings",
    "one_recording": "one recording",
    "all_equal": "all equal",
}


class MetricScore(msgspec.Struct, frozen=True, kw_only=True):
    """One metric of one method on one dataset.

    Attributes:
        metric: Id of the metric, such as ``prime_success``.
        title: Its name as printed.
        unit: ``rate`` (from 0 to 1), ``m``, or the metric's other unit.
        mean: Mean over sequences; null without any.
        low: Lower bound of the interval; null where too few recordings allow none.
        high: Upper bound of the interval; null likewise.
        level: Confidence level of the interval, such as 0.95.
        sequences: Number of sequences that it was computed on.
        recordings: Number of recordings that they come from.
        marks: What a reader of the interval has to know: ``few_recordings``, ``one_recording``, ``all_equal``.
        flags: Number of motions that carry each remark.
        detectable: Smallest difference to an unrelated method of the same spread that is found with 80 % power, among
            the main metrics; null where nothing can be tested.
        uncertainty: Shares of the mean's variance that come from ``recordings``, ``sequences`` and ``samples``.
        means_nothing: The method stands still, so that this metric says nothing about it.
    """

    metric: str
    title: str
    unit: str
    mean: float | None
    low: float | None
    high: float | None
    level: float
    sequences: int
    recordings: int
    marks: list[str]
    flags: dict[str, int]
    detectable: float | None
    uncertainty: dict[str, float]
    means_nothing: bool


class AgreementReport(msgspec.Struct, frozen=True, kw_only=True):
    """How a method's successes go with those of recorded people, and with where the goal is.

    Attributes:
        rates: Agreement with recorded people, one entry a rate.
        breakdown: Rates by the goal's bearing, distance and height.
    """

    rates: list[RateAgreement]
    breakdown: list[BinRate]


class DatasetScores(msgspec.Struct, frozen=True, kw_only=True):
    """Scores of one method on one dataset.

    Attributes:
        dataset: Name of the dataset.
        title: Its name as printed; carries the word "synthetic" where the data are.
        synthetic: The people are synthetic: never compare these scores with published ones.
        method: Name of the method.
        condition: What it was given.
        control: ``shuffled-goal`` or null.
        split: Split of the table.
        sequences: Number of chosen sequences.
        unsupported: Number of them that are longer than the method can generate, and were not scored.
        recordings: Number of recordings that they come from.
        samples: Motions a sequence.
        remark: That recorded motions were handed in; empty if there are none.
        metrics: One entry a metric.
        agreement: Agreement with recorded people, and rates by the goal's place; null for merged folds and for runs of
            earlier versions.
    """

    dataset: str
    title: str
    synthetic: bool
    method: str
    condition: str
    control: str | None
    split: str
    sequences: int
    unsupported: int
    recordings: int
    samples: int
    remark: str
    metrics: list[MetricScore]
    agreement: AgreementReport | None


def dataset_scores(
    summary: DatasetSummary, agreement: DatasetAgreement | None, *, motionless: bool = False
) -> DatasetScores:
    """Turn a summary into the shape that ``--json`` prints.

    Args:
        summary: Scores of a method on a dataset.
        agreement: How they go with recorded people's; None for a run of an earlier version.
        motionless: The method's motions stand still.
    """
    metrics = [
        MetricScore(
            metric=metric.metric,
            title=metric.title,
            unit=metric.unit,
            mean=metric.mean,
            low=metric.low,
            high=metric.high,
            level=metric.level,
            sequences=metric.sequences,
            recordings=metric.recordings,
            marks=list(metric.marks),
            flags=metric.flags,
            detectable=metric.detectable,
            uncertainty=metric.uncertainty,
            means_nothing=metric.metric in _irrelevant(motionless),
        )
        for metric in summary.metrics
    ]
    return DatasetScores(
        dataset=summary.dataset,
        title=summary.title,
        synthetic=summary.synthetic,
        method=summary.method,
        condition=summary.condition,
        control=summary.control,
        split=summary.split,
        sequences=summary.sequences,
        unsupported=summary.unsupported,
        recordings=summary.recordings,
        samples=summary.samples,
        remark=summary.recorded_motion_mark,
        metrics=metrics,
        agreement=agreement and agreement_report(agreement),
    )


def agreement_report(agreement: DatasetAgreement) -> AgreementReport:
    """Turn the file of a run into the shape that ``--json`` prints."""
    return AgreementReport(rates=list(agreement.rates), breakdown=list(agreement.breakdown))


def print_agreement(agreement: DatasetAgreement | None) -> None:
    """Print the agreement of the main rates in one line, if there is any."""
    from prbench.metrics import METRICS

    main = {info.id for info in METRICS if info.main}
    parts = [f"{rate.title} {phi_cell(rate)}" for rate in agreement.rates if rate.metric in main] if agreement else []
    if parts:
        print(f"agreement with recorded people (phi): {', '.join(parts)}")


def phi_cell(rate: RateAgreement) -> str:
    """Return a coefficient with its interval as far as there is one."""
    if rate.phi is None:
        return "–"
    bounds = "" if rate.low is None or rate.high is None else f" [{rate.low:+.2f}, {rate.high:+.2f}]"
    return f"{rate.phi:+.2f}{bounds}"


def _irrelevant(motionless: bool) -> frozenset[str]:
    """Return the ids of metrics that say nothing about motions that stand still."""
    from prbench.metrics import METRICS

    return frozenset(info.id for info in METRICS if motionless and info.irrelevant_if_motionless)


def print_summary(summary: DatasetSummary, *, origin: str, motionless: bool = False) -> None:
    """Print the scores of one method on one dataset.

    Args:
        summary: What it scored.
        origin: Whose method it is, in words.
        motionless: Its motions stand still, so that some metrics, such as Foot Skating, say nothing.
    """
    irrelevant = _irrelevant(motionless)
    control = f", {summary.control}" if summary.control else ""
    title = (
        f"{summary.title}: {summary.method} ({origin}), condition {summary.condition}{control};"
        f" {summary.sequences} sequences of {summary.recordings} recording{'' if summary.recordings == 1 else 's'},"
        f" split {summary.split}"
    )
    rows = [
        (metric.title, "–", "", "stands still")
        if metric.metric in irrelevant
        else (metric.title, *_cells(metric), _remarks(metric))
        for metric in summary.metrics
    ]
    print_table(title, ("metric", "mean", "95 % interval", ""), rows, numbers=(1, 2))
    for line in _design_lines(summary):
        print(line)
    if summary.unsupported:
        print(f"{summary.unsupported} sequences are longer than the method can generate and were not scored.")
    if summary.recorded_motion_mark:
        print(f"{summary.recorded_motion_mark}.")
    if summary.synthetic:
        print("These are scores on synthetic data: never compare them with published ones.")


def _design_lines(summary: DatasetSummary) -> list[str]:
    """Say what the data cannot decide, and what makes the first metric uncertain."""
    from prbench.leaderboard.decidable import undecided

    lines = list(undecided(summary.dataset, summary.sequences, summary.recordings, [summary.metrics]))
    metric = next((metric for metric in summary.metrics if any(metric.uncertainty.values())), None)
    if metric is not None:
        source, share = max(metric.uncertainty.items(), key=lambda item: item[1])
        lines.append(
            f"{metric.title}: {100 * share:.0f} % of the uncertainty comes from the choice of {source};"
            f" more {source} reduce it."
        )
    return lines


def print_datasets(summaries: Sequence[DatasetSummary], *, origin: str, motionless: bool = False) -> None:
    """Print the main metrics of one method on several datasets, one column a dataset, and their mean.

    Args:
        summaries: One a dataset.
        origin: Whose method it is, in words.
        motionless: Its motions stand still, so that some metrics, such as Foot Skating, say nothing.
    """
    from prbench.leaderboard.decidable import FEWEST_RANKED
    from prbench.metrics import MAIN_METRICS
    from prbench.runs.summary import means_over_datasets

    first = summaries[0]
    means = means_over_datasets(summaries)
    irrelevant = _irrelevant(motionless)
    is_wide = shown_width() >= _WIDE
    cell = _interval_cell if is_wide else _bare_cell
    rows = [("sequences (recordings)", *(f"{each.sequences} ({each.recordings})" for each in summaries), "")]
    for info in MAIN_METRICS:
        cells = [_DASH if info.id in irrelevant else cell(each, info) for each in summaries]
        mean = _DASH if info.id in irrelevant else _number(means.get(info.id), info)
        rows.append((_with_unit(info), *cells, mean))
    control = f", {first.control}" if first.control else ""
    title = f"{first.method} ({origin}), condition {first.condition}{control}; split {first.split}"
    header = ("metric", *map(_short, summaries), "mean")
    print_table(title, header, rows, numbers=range(1, len(header)))
    if not is_wide:
        print(f"Intervals of 95 %: on a terminal of {_WIDE} columns, in a file, or with --json.")
    if min(each.sequences for each in summaries) < FEWEST_RANKED:
        print(f"A first look: fewer than {FEWEST_RANKED} sequences of a dataset rank nothing.")
    unsupported = [f"{each.unsupported} of {_short(each)}" for each in summaries if each.unsupported]
    if unsupported:
        print(f"Longer than the method can generate, and not scored: {', '.join(unsupported)}.")
    for each in summaries:
        if each.recorded_motion_mark:
            print(f"{_short(each)}: {each.recorded_motion_mark}.")
    if any(each.synthetic for each in summaries):
        print("Synthetic data: never compare these scores with published ones.")


def print_methods_on_datasets(
    methods: Sequence[Sequence[DatasetSummary]], *, origins: Sequence[str], motionless: frozenset[str]
) -> None:
    """Print means over datasets of several methods, one column a method; the two successes also on each dataset.

    Args:
        methods: Summaries of each method on the same datasets, in the same order.
        origins: Whose methods they are, in words, one a method.
        motionless: Names of methods that stand still, which get no Foot Skating and the like.
    """
    from prbench.metrics import MAIN_METRICS
    from prbench.runs.summary import TWICE_DAGGER, means_over_datasets

    firsts = [summaries[0] for summaries in methods]
    means = [means_over_datasets(summaries) for summaries in methods]
    rows: list[tuple[str, ...]] = []
    for info in MAIN_METRICS:
        hidden = [first.method in motionless and info.irrelevant_if_motionless for first in firsts]
        cells = (_DASH if no else _number(own.get(info.id), info) for no, own in zip(hidden, means, strict=True))
        rows.append((_with_unit(info), *cells))
        if info.id in _SHOWN_BY_DATASET:
            for on_one in zip(*methods, strict=True):
                rows.append((f"· {_short(on_one[0])}", *(_bare_cell(each, info) for each in on_one)))
    header = ["metric"]
    for summaries, first, origin in zip(methods, firsts, origins, strict=True):
        mark = f" {TWICE_DAGGER}" if any(each.recorded_motion_mark for each in summaries) else ""
        header.append(f"{first.method}{mark}\n({first.condition})\n{origin}")
    print_table(f"Means over {len(methods[0])} datasets", header, rows, numbers=range(1, len(header)))
    for summaries in methods:
        for each in summaries:
            if each.recorded_motion_mark:
                print(f"{each.method} on {_short(each)} {each.recorded_motion_mark}.")


_DASH = "–"
_SHOWN_BY_DATASET = ("prime_success", "reach_success")
"""Metrics in which datasets differ so much that a mean alone would not be understood."""
_WIDE = 150
"""Columns that five datasets with intervals take."""


def _short(summary: DatasetSummary) -> str:
    """Return the name of a dataset without the word that stands below the table."""
    from prbench.readers import SYNTHETIC_PREFIX

    return summary.dataset.removeprefix(SYNTHETIC_PREFIX)


def _with_unit(info: MetricInfo) -> str:
    from prbench.metrics import printed_unit

    unit = printed_unit(info.unit).strip()
    return f"{info.title}, {unit}" if unit else info.title


def _number(mean: float | None, info: MetricInfo) -> str:
    from prbench.metrics import printed_scale

    return _DASH if mean is None else f"{mean * printed_scale(info.unit):.2f}"


def _bare_cell(summary: DatasetSummary, info: MetricInfo) -> str:
    found = summary.metric(info.id)
    return _DASH if found is None else _number(found.mean, info)


def _interval_cell(summary: DatasetSummary, info: MetricInfo) -> str:
    found = summary.metric(info.id)
    return _DASH if found is None else f"{_number(found.mean, info)}\n{_cells(found)[1]}"


def _cells(metric: MetricSummary) -> tuple[str, str]:
    from prbench.metrics import printed_scale, printed_unit

    scale = printed_scale(metric.unit)
    mean = f"{metric.mean * scale:.2f}{printed_unit(metric.unit)}"
    if metric.low is None or metric.high is None:
        return mean, "–"
    return mean, f"[{metric.low * scale:.2f}, {metric.high * scale:.2f}]"


def _remarks(metric: MetricSummary) -> str:
    flags = [f"{count} × {name.replace('_', ' ')}" for name, count in sorted(metric.flags.items())]
    return "; ".join([_MARKS.get(mark, mark) for mark in metric.marks] + flags)


def print_sequence_scores(run: RunFolder) -> None:
    """Print what every motion of a run scored, sequence by sequence."""
    from prbench.metrics import METRICS
    from prbench.runs import read_scores

    for table in run.record.tables:
        rows = read_scores(run.dataset(table.dataset).scores).to_pylist()
        for name in dict.fromkeys(row["sequence_id"] for row in rows):
            values = {(row["metric"], row["sample"]): row for row in rows if row["sequence_id"] == name}
            samples = sorted({sample for _, sample in values})
            header = ("metric", *(f"sample {sample}" if len(samples) > 1 else "value" for sample in samples), "")
            lines = []
            for metric in METRICS:
                cells = [values[metric.id, sample] for sample in samples if (metric.id, sample) in values]
                if cells:
                    remarks = dict.fromkeys(cell["flag"].replace("_", " ") for cell in cells if cell["flag"])
                    lines.append(
                        (metric.title, *(_value_cell(cell["value"], metric.unit) for cell in cells), "; ".join(remarks))
                    )
            print_table(
                f"{name}: {run.record.method.name}, {run.record.condition}",
                header,
                lines,
                numbers=range(1, len(samples) + 1),
            )
        if table.synthetic:
            print("These are scores on synthetic data: never compare them with published ones.")


def _value_cell(value: float, unit: str) -> str:
    from prbench.metrics import printed_unit

    if unit == "rate":
        return "yes" if value >= 0.5 else "no"
    return f"{value:.3f}{printed_unit(unit)}"
