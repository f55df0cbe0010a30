"""Scores on the terminal: of a method on a dataset, of methods side by side, and of single sequences.

What ``prbench run`` answers: the runs that were made, their scores, and how a terminal shows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from prbench.cli.commands import Answer
from prbench.cli.options import MadeShard, shard_answer
from prbench.cli.terminal import print_table, shown_width

if TYPE_CHECKING:
    from collections.abc import Sequence

    from prbench.harness.run import RunReport
    from prbench.harness.run_folder import RunFolder
    from prbench.harness.run_folder.agreement import DatasetAgreement, RateAgreement
    from prbench.harness.run_folder.summary import DatasetSummary, MeanOverDatasets, MetricSummary
    from prbench.metrics import MetricInfo


_MARKS = {
    "few_recordings": "few recordings",
    "one_recording": "one recording",
    "all_equal": "all equal",
}


def print_agreement(agreement: DatasetAgreement | None) -> None:
    """Print the agreement of the main rates in one line, if there is any."""
    from prbench.metrics import GAZE_METRICS, METRICS

    main = {info.id for info in METRICS if info.main} | GAZE_METRICS
    parts = [f"{rate.title} {phi_cell(rate)}" for rate in agreement.rates if rate.metric in main] if agreement else []
    if parts:
        print(f"agreement with recorded people (phi): {', '.join(parts)}")


def print_scene(summaries: Sequence[DatasetSummary], agreements: Sequence[DatasetAgreement | None]) -> None:
    """Print how far motions come into the boxes of the scene, beside recorded people, where a table knows of boxes.

    Args:
        summaries: Scores of one method, one a dataset.
        agreements: One a dataset, in the same order; None for a run of an earlier version.
    """
    from prbench.protocol.manifests import load_scene_constants

    lines = []
    for summary, agreement in zip(summaries, agreements, strict=True):
        share = summary.metric("scene_penetration")
        depth = summary.metric("scene_depth")
        people = agreement and agreement.scene
        if share is None or depth is None or people is None:
            continue
        name = f"{_short(summary)}: " if len(summaries) > 1 else ""
        lines.append(
            f"  {name}{100 * share.mean:.2f} % of frames, {100 * depth.mean:.1f} cm at the deepest (recorded people"
            f" {100 * people.penetration:.2f} %, {100 * people.depth:.1f} cm); {people.solid} of {people.boxes} boxes"
        )
    if lines:
        limit = 100 * load_scene_constants().depth
        print(f"scene: joints more than {limit:g} cm inside a solid box (means over sequences; never ranked)")
        for line in lines:
            print(line)


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


def print_summary(
    summary: DatasetSummary,
    *,
    origin: str,
    motionless: bool = False,
    metrics: Sequence[MetricInfo] = (),
) -> None:
    """Print the scores of one method on one dataset.

    Args:
        summary: What it scored.
        origin: Whose method it is, in words.
        motionless: Its motions stand still, so that some metrics, such as Foot Skating, say nothing.
        metrics: All metrics of the benchmark; those of prime-and-reach by default.
    """
    from prbench.board.tables import undecided
    from prbench.metrics import RANKED_METRICS, printed_scale, printed_unit

    irrelevant = _irrelevant(motionless)
    details = {info.id for info in metrics if info.is_detail}
    control = f", {summary.control}" if summary.control else ""
    title = (
        f"{summary.title}: {summary.method} ({origin}), condition {summary.condition}{control};"
        f" {summary.sequences} sequences of {summary.recordings} recording{'' if summary.recordings == 1 else 's'},"
        f" split {summary.split}"
    )
    rows = []
    for metric in summary.metrics:
        if metric.metric in details:
            continue
        if metric.metric in irrelevant:
            rows.append((metric.title, "–", "", "stands still"))
            continue
        scale = printed_scale(metric.unit)
        bounds = "–"
        if metric.low is not None and metric.high is not None:
            bounds = f"[{metric.low * scale:.2f}, {metric.high * scale:.2f}]"
        flags = [f"{count} × {name.replace('_', ' ')}" for name, count in sorted(metric.flags.items())]
        remarks = "; ".join([_MARKS.get(mark, mark) for mark in metric.marks] + flags)
        rows.append((metric.title, f"{metric.mean * scale:.2f}{printed_unit(metric.unit)}", bounds, remarks))
    print_table(title, ("metric", "mean", "95 % interval", ""), rows, numbers=(1, 2))
    # What the data cannot decide, and what makes the first metric uncertain.
    ranked = [info for info in metrics if info.main and info.ranked] or RANKED_METRICS
    for line in undecided(summary.dataset, summary.sequences, summary.recordings, [summary.metrics], ranked=ranked):
        print(line)
    uncertain = next((metric for metric in summary.metrics if any(metric.uncertainty.values())), None)
    if uncertain is not None:
        source, share = max(uncertain.uncertainty.items(), key=lambda item: item[1])
        print(
            f"{uncertain.title}: {100 * share:.0f} % of the uncertainty comes from the choice of {source};"
            f" more {source} reduce it."
        )
    if summary.unsupported:
        print(f"{summary.unsupported} sequences are longer than the method can generate and were not scored.")
    if summary.mark:
        print(f"{summary.mark}.")
    if summary.synthetic:
        print("These are scores on synthetic data: never compare them with published ones.")


def print_datasets(
    summaries: Sequence[DatasetSummary],
    agreements: Sequence[DatasetAgreement | None],
    *,
    origin: str,
    motionless: bool = False,
    metrics: Sequence[MetricInfo],
    one_mean: bool = True,
) -> None:
    """Print main metrics of one method, and those of gaze, on several datasets, one column a dataset, and their mean.

    Below each rate stands its agreement with recorded people, and below the table what the datasets can decide.

    Args:
        summaries: One a dataset.
        agreements: One a dataset, in the same order.
        origin: Whose method it is, in words.
        motionless: Its motions stand still, so that some metrics, such as Foot Skating, say nothing.
        metrics: All metrics of the benchmark.
        one_mean: The datasets may enter one mean.
    """
    from prbench.harness.run_folder.summary import means_over_datasets
    from prbench.metrics import GAZE_METRICS

    first = summaries[0]
    by_gaze = [info for info in metrics if info.id in GAZE_METRICS]
    main = [info for info in metrics if info.main]
    # Beside what the head does; recorded motion, whose eyes were measured, has them too.
    shown = (*main, *(info for info in by_gaze if all(each.metric(info.id) for each in summaries)))
    means = means_over_datasets(summaries) if one_mean else {}
    irrelevant = _irrelevant(motionless)
    is_wide = shown_width() >= _WIDE
    rows: list[tuple[str, ...]] = []
    rows.append(("sequences (recordings)", *(f"{each.sequences} ({each.recordings})" for each in summaries), ""))
    for info in shown:
        if info.id in irrelevant:
            rows.append((_with_unit(info), *[_DASH] * (len(summaries) + 1)))
            continue
        found = [*(summary.metric(info.id) for summary in summaries), means.get(info.id)]
        rows.append((_with_unit(info), *(_estimate_cell(each, info, interval=is_wide) for each in found)))
        phis = [_phi_of(agreement, info, interval=is_wide) for agreement in agreements]
        if any(phi != _DASH for phi in phis):
            rows.append((_PHI, *phis, ""))
    control = f", {first.control}" if first.control else ""
    title = f"{first.method} ({origin}), condition {first.condition}{control}; split {first.split}"
    header = ("metric", *map(_short, summaries), "mean")
    print_table(title, header, rows, numbers=range(1, len(header)))
    if any(row[0] == _PHI for row in rows):
        print("phi: agreement with recorded people, sequence by sequence; 0 is unrelated, 1 the same sequences.")
    if not is_wide:
        print(f"Intervals of 95 %: on a terminal of {_WIDE} columns, in a file, or with --json.")
    if not one_mean:
        print("No mean: bodies of some datasets were estimated from the motion of the head, others were captured.")
    _print_decidable(summaries, [info for info in main if info.ranked])
    unsupported = [f"{each.unsupported} of {_short(each)}" for each in summaries if each.unsupported]
    if unsupported:
        print(f"Longer than the method can generate, and not scored: {', '.join(unsupported)}.")
    for each in summaries:
        if each.recorded_motion_mark:
            print(f"{_short(each)}: {each.recorded_motion_mark}.")
    for mark in first.run_marks:  # those of the run, so the same on every dataset
        print(f"{mark}.")
    if any(each.synthetic for each in summaries):
        print("Synthetic data: never compare these scores with published ones.")


def _print_decidable(summaries: Sequence[DatasetSummary], ranked: Sequence[MetricInfo]) -> None:
    """Print which datasets decide nothing, and the smallest differences that the others could find."""
    from prbench.board.tables import why_undecided

    reasons: dict[str, list[str]] = {}
    for each in summaries:
        reason = why_undecided(each.sequences, each.recordings)
        if reason:
            reasons.setdefault(reason, []).append(_short(each))
    for reason, names in reasons.items():
        print(f"Cannot be decided: {', '.join(names)} ({reason}).")
    rows = []
    for info in ranked:
        cells = [_detectable_cell(each.metric(info.id), info) for each in summaries]
        if any(cell not in (_DASH, _NOT_EVEN) for cell in cells):
            rows.append((_with_unit(info), *cells))
    title = "Smallest difference to an unrelated method of this spread that four of five repetitions would find"
    if rows:
        print_table(title, ("metric", *map(_short, summaries)), rows, numbers=range(1, len(summaries) + 1))
    else:
        print("No difference between two unrelated methods would be found here, however large.")


def print_methods_on_datasets(
    methods: Sequence[Sequence[DatasetSummary]], *, origins: Sequence[str], motionless: frozenset[str]
) -> None:
    """Print means over datasets of several methods, one column a method; the two successes also on each dataset.

    Args:
        methods: Summaries of each method on the same datasets, in the same order.
        origins: Whose methods they are, in words, one a method.
        motionless: Names of methods that stand still, which get no Foot Skating and the like.
    """
    from prbench.harness.run_folder.summary import means_over_datasets
    from prbench.metrics import MAIN_METRICS

    firsts = [summaries[0] for summaries in methods]
    means = [means_over_datasets(summaries) for summaries in methods]
    rows: list[tuple[str, ...]] = []
    for info in MAIN_METRICS:
        hidden = [first.method in motionless and info.irrelevant_if_motionless for first in firsts]
        cells = (_DASH if no else _estimate_cell(own.get(info.id), info) for no, own in zip(hidden, means, strict=True))
        rows.append((_with_unit(info), *cells))
        if info.id in _SHOWN_BY_DATASET:
            for on_one in zip(*methods, strict=True):
                cells = (_estimate_cell(each.metric(info.id), info) for each in on_one)
                rows.append((f"· {_short(on_one[0])}", *cells))
    header = ["metric"]
    for summaries, first, origin in zip(methods, firsts, origins, strict=True):
        symbols = " ".join(dict.fromkeys(each.symbols for each in summaries if each.symbols))
        mark = f" {symbols}" if symbols else ""
        header.append(f"{first.method}{mark}\n({first.condition})\n{origin}")
    print_table(f"Means over {len(methods[0])} datasets", header, rows, numbers=range(1, len(header)))
    for summaries in methods:
        for each in summaries:
            if each.recorded_motion_mark:
                print(f"{each.method} on {_short(each)} {each.recorded_motion_mark}.")
        for mark in summaries[0].run_marks:
            print(f"{summaries[0].method} {mark}.")


_DASH = "–"
_NOT_EVEN = "none"
"""In place of a rate's smallest detectable difference, where not even 100 points would be found."""
_PHI = "· phi"
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


def _estimate_cell(found: MetricSummary | MeanOverDatasets | None, info: MetricInfo, *, interval: bool = False) -> str:
    """Return a mean, with its interval in a second line where that is wanted and given."""
    from prbench.metrics import printed_scale

    if found is None:
        return _DASH
    scale = printed_scale(info.unit)
    mean = f"{found.mean * scale:.2f}"
    if not interval:
        return mean
    bounds = _DASH
    if found.low is not None and found.high is not None:
        bounds = f"[{found.low * scale:.2f}, {found.high * scale:.2f}]"
    return f"{mean}\n{bounds}"


def _phi_of(agreement: DatasetAgreement | None, info: MetricInfo, *, interval: bool) -> str:
    rates = agreement.rates if agreement else ()
    rate = next((rate for rate in rates if rate.metric == info.id), None)
    if rate is None or rate.phi is None:
        return _DASH
    return phi_cell(rate).replace(" ", "\n", 1) if interval else f"{rate.phi:+.2f}"


def _detectable_cell(metric: MetricSummary | None, info: MetricInfo) -> str:
    from prbench.metrics import printed_scale

    if metric is None or metric.detectable is None:
        return _DASH
    if info.unit == "rate" and metric.detectable > 1:
        return _NOT_EVEN
    return f"{metric.detectable * printed_scale(info.unit):.2f}"


def print_sequence_scores(run: RunFolder, metrics: Sequence[MetricInfo]) -> None:
    """Print what every motion of a run scored, sequence by sequence.

    Args:
        run: The run.
        metrics: All metrics of its benchmark.
    """
    from prbench.harness.run_folder import read_scores

    for table in run.record.tables:
        rows = read_scores(run.dataset(table.dataset).scores).to_pylist()
        for name in dict.fromkeys(row["sequence_id"] for row in rows):
            values = {(row["metric"], row["sample"]): row for row in rows if row["sequence_id"] == name}
            samples = sorted({sample for _, sample in values})
            header = ("metric", *(f"sample {sample}" if len(samples) > 1 else "value" for sample in samples), "")
            lines = []
            for metric in metrics:
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


class MadeRun(msgspec.Struct, frozen=True, kw_only=True):
    """One finished run.

    Attributes:
        folder: The run folder.
        method: Name of the method.
        origin: Where the method comes from, in words.
        motionless: The method stands still, so that some metrics, such as Foot Skating, say nothing about it.
        condition: What it was given.
        seed: Seed of the run.
        batches_found: Number of batches that an earlier call had left.
        datasets: Scores of each dataset, as in ``summary.json``.
        agreements: Agreement with recorded people on each dataset, and rates by the goal's place, as in
            ``agreement.json``; empty for merged folds and for benchmarks without recorded people.
        means: Mean of each metric over the datasets; without metrics that a dataset lacks, and empty for a single
            dataset.
    """

    folder: Path
    method: str
    origin: str
    motionless: bool
    condition: str
    seed: int
    batches_found: int
    datasets: tuple[DatasetSummary, ...]
    agreements: list[DatasetAgreement]
    means: dict[str, MeanOverDatasets]


class RunAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """The runs of one command.

    Attributes:
        runs: The runs asked for, in their order.
        companions: Runs of other methods that a first run is shown beside.
        view: The picture, film or page, if one was asked for.
        table_two: What ``--method all`` made; null for other methods.
        shards: One entry for each run of which a shard was made, with ``--shard``; then there are no runs.
    """

    runs: list[MadeRun]
    companions: list[MadeRun]
    view: Path | None
    table_two: dict[str, Any] | None
    shards: list[MadeShard] = []


def run_answer(
    reports: list[RunReport], companions: Sequence[RunReport] = (), *, view: Path | None = None, single: bool
) -> Answer:
    """Answer a command that has made runs.

    Args:
        reports: The runs asked for.
        companions: Runs of other methods that a first run is shown beside.
        view: The picture of the runs, if one was asked for.
        single: The runs are of single sequences, whose scores are shown one by one.
    """

    def show() -> None:
        for report in reports:
            _print_run(report, single=single)
        if companions:
            _print_company([reports[0], *companions])
        for report in reports:
            print(f"run folder: {report.folder.path}")

    answer = RunAnswer(
        runs=[_made(report) for report in reports],
        companions=[_made(report) for report in companions],
        view=view,
        table_two=None,
    )
    return Answer(answer, show)


def shards_answer(made: list[MadeShard]) -> Answer:
    """Answer a command that has made one shard of each run."""
    report = RunAnswer(runs=[], companions=[], view=None, table_two=None, shards=made)
    answers = [shard_answer(report, each, unit="batches") for each in made]

    def show() -> None:
        for answer in answers:
            answer.show()

    return Answer(report, show)


def _made(report: RunReport) -> MadeRun:
    from prbench.harness.run_folder.summary import means_over_datasets, share_a_mean

    record = report.folder.record
    several = len(report.summaries) > 1 and share_a_mean(record.tables)
    return MadeRun(
        folder=report.folder.path,
        method=record.method.name,
        origin=record.method.origin,
        motionless=record.method.motionless,
        condition=record.condition,
        seed=record.seed,
        batches_found=report.batches_found,
        datasets=report.summaries,
        agreements=[found for summary in report.summaries if (found := _agreement(report, summary.dataset))],
        means=means_over_datasets(report.summaries) if several else {},
    )


def _agreement(report: RunReport, dataset: str) -> DatasetAgreement | None:
    """Return the agreement with recorded people; None for a benchmark that has none."""
    from prbench.harness.run_folder.agreement import DatasetAgreement

    files = report.folder.dataset(dataset)
    return DatasetAgreement.read(files.path) if files.agreement.is_file() else None


def _print_run(report: RunReport, *, single: bool) -> None:
    from prbench.harness.benchmark import load_benchmark
    from prbench.harness.run_folder.summary import share_a_mean

    record = report.folder.record
    metrics = load_benchmark(record.benchmark).metrics
    if single:
        print_sequence_scores(report.folder, metrics)
        return
    method = record.method
    agreements = [_agreement(report, summary.dataset) for summary in report.summaries]
    if len(report.summaries) == 1:
        print_summary(report.summaries[0], origin=method.origin, motionless=method.motionless, metrics=metrics)
        print_agreement(agreements[0])
    else:
        print_datasets(
            report.summaries,
            agreements,
            origin=method.origin,
            motionless=method.motionless,
            metrics=metrics,
            one_mean=share_a_mean(record.tables),
        )
    print_scene(report.summaries, agreements)


def _print_company(reports: list[RunReport]) -> None:
    still = {shown.folder.record.method.name for shown in reports if shown.folder.record.method.motionless}
    print_methods_on_datasets(
        [shown.summaries for shown in reports],
        origins=[shown.folder.record.method.origin for shown in reports],
        motionless=frozenset(still),
    )
