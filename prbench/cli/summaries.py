"""What ``prbench run`` answers: the runs that were made, their scores, and how a terminal shows them."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from prbench.cli.commands import Answer, session
from prbench.cli.options import MadeShard
from prbench.cli.terminal import print_table
from prbench.datasets import ON_SYNTHETIC_DATA, SYNTHETIC_PREFIX

if TYPE_CHECKING:
    from prbench.harness.run import RunReport
    from prbench.harness.run_folder.record import TableRecord
    from prbench.harness.run_folder.summary import (
        DatasetAgreement,
        DatasetSummary,
        MeanOverDatasets,
        MetricSummary,
        RateAgreement,
    )
    from prbench.metrics import MetricInfo
    from prbench.viewing.player.links import SequenceScores

_DASH = "–"
_PHI = "· phi"


def phi_cell(rate: RateAgreement | None) -> str:
    """Return a coefficient with its interval as far as there is one."""
    if rate is None or rate.phi is None:
        return _DASH
    bounds = "" if rate.low is None or rate.high is None else f" [{rate.low:+.2f}, {rate.high:+.2f}]"
    return f"{rate.phi:+.2f}{bounds}"


def print_agreement(agreement: DatasetAgreement | None) -> None:
    """Print the agreement of the main rates in one line, if there is any."""
    from prbench.metrics import METRICS

    main = {info.id for info in METRICS if info.main or session().all_metrics}
    parts = [f"{rate.title} {phi_cell(rate)}" for rate in agreement.rates if rate.metric in main] if agreement else []
    if parts:
        print(f"agreement with recorded people (phi): {', '.join(parts)}")


def print_summary(
    summary: DatasetSummary, *, origin: str, motionless: bool = False, metrics: Sequence[MetricInfo]
) -> None:
    """Print the scores of one method on one dataset.

    Args:
        summary: What it scored.
        origin: Whose method it is, in words.
        motionless: Its motions stand still, so that some metrics, such as Foot Skating, say nothing.
        metrics: All metrics of the benchmark.
    """
    from prbench.board.tables import undecided
    from prbench.harness.run_folder.summary import counted_units
    from prbench.metrics import printed_scale, printed_unit

    irrelevant = _irrelevant(motionless)
    shown = {info.id for info in metrics if info.main or (session().all_metrics and not info.is_detail)}
    rows = []
    for metric in summary.metrics:
        if metric.metric not in shown:
            continue
        if metric.metric in irrelevant:
            rows.append((metric.title, _DASH, "", "stands still"))
        else:
            flags = [f"{count} × {name}" for name, count in sorted(metric.flags.items())]
            arrival = [summary.arrival] if metric.metric == "prime_success" and summary.arrival else []
            remarks = "; ".join([*arrival, *metric.marks, *flags]).replace("_", " ")
            scale = printed_scale(metric.unit)
            mean = f"{metric.mean * scale:.2f}{printed_unit(metric.unit)}"
            bounds = _DASH
            if metric.low is not None and metric.high is not None:
                bounds = f"[{metric.low * scale:.2f}, {metric.high * scale:.2f}]"
            rows.append((metric.title, mean, bounds, remarks))
    counts = f"{summary.sequences} sequences of {counted_units(summary.recordings, summary.split)}"
    title = f"{summary.title}: {_method(summary, origin)}; {counts}, split {summary.split}"
    print_table(title, ("metric", "mean", "95 % interval", ""), rows, numbers=(1, 2))
    # What the data cannot decide.
    compared = [info for info in metrics if info.main and info.compared]
    about = (summary.dataset, summary.split, summary.sequences, summary.recordings)
    for line in undecided(*about, [summary.metrics], metrics=compared):
        print(line)
    _print_marks([summary])


def _print_datasets(
    report: RunReport, agreements: Sequence[DatasetAgreement | None], metrics: Sequence[MetricInfo]
) -> None:
    """Print the metrics of one method on several datasets, one column a dataset, and their mean.

    Below each rate stands its agreement with recorded people, and below the table what the datasets can decide.

    Args:
        report: A run of several datasets.
        agreements: One a dataset, in the same order.
        metrics: All metrics of the benchmark.
    """
    from prbench.board.tables import why_undecided
    from prbench.harness.run_folder.summary import means_over_datasets, share_a_mean

    record = report.folder.record
    summaries = report.summaries
    one_mean = share_a_mean(record.tables)
    found = {metric.metric for summary in summaries for metric in summary.metrics}
    wanted = [info for info in metrics if info.id in found and not info.is_detail]
    means = means_over_datasets(summaries) if one_mean else {}
    irrelevant = _irrelevant(record.method.motionless)
    names = list(map(_short, summaries))
    counts = (f"{each.sequences} ({each.recordings})" for each in summaries)
    rows: list[tuple[str, ...]] = [("sequences (recordings)", *counts, "")]
    for info in wanted:
        if not info.main and not session().all_metrics:
            continue
        cells = [_mean(each.metric(info.id), info, hidden=info.id in irrelevant) for each in summaries]
        if info.id == "prime_success":
            cells = [f"{cell} {each.arrival[:1]}".strip() for cell, each in zip(cells, summaries, strict=True)]
        rows.append((_with_unit(info), *cells, _mean(means.get(info.id), info, hidden=info.id in irrelevant)))
        phis = []
        for agreement in agreements:
            rates = [rate.phi for rate in agreement.rates if rate.metric == info.id] if agreement else []
            phis.append(f"{rates[0]:+.2f}" if rates and rates[0] is not None else _DASH)
        if any(phi != _DASH for phi in phis):
            rows.append((_PHI, *phis, ""))
    title = f"{_method(summaries[0], record.method.origin)}; split {summaries[0].split}"
    print_table(title, ("metric", *names, "mean"), rows, numbers=range(1, len(names) + 2))
    if any(row[0] == _PHI for row in rows):
        print("phi: agreement with recorded people, sequence by sequence; 0 is unrelated, 1 the same sequences.")
    for each in summaries:
        if each.arrival:
            print(f"{_short(each)} {each.arrival}.")
        if each.own_first_frame:
            print(f"{_short(each)} {each.own_first_frame}.")
    print("Intervals of 95 %: with --json; metrics beside the main ones: with --all.")
    if not one_mean:
        print("No mean: bodies of some datasets were estimated from the motion of the head, others were captured.")
    # Which datasets decide nothing between two methods.
    reasons: dict[str, list[str]] = {}
    for each in summaries:
        reasons.setdefault(why_undecided(each.split, each.sequences, each.recordings) or "", []).append(_short(each))
    for reason, undecided in reasons.items():
        if reason:
            print(f"Cannot be decided: {', '.join(undecided)} ({reason}).")
    _print_marks(summaries)


def _print_company(reports: Sequence[RunReport]) -> None:
    """Print means over datasets of several methods, one column a method."""
    from prbench.harness.run_folder.summary import means_over_datasets
    from prbench.metrics import MAIN_METRICS

    means = [means_over_datasets(report.summaries) for report in reports]
    methods = [report.folder.record.method for report in reports]
    rows = []
    for info in MAIN_METRICS:
        cells = []
        for method, own in zip(methods, means, strict=True):
            cells.append(_mean(own.get(info.id), info, hidden=method.motionless and info.irrelevant_if_motionless))
        rows.append((_with_unit(info), *cells))
    header = ["metric"]
    for method, report in zip(methods, reports, strict=True):
        symbols = " ".join(dict.fromkeys(each.symbols for each in report.summaries if each.symbols))
        header.append(f"{f'{method.name} {symbols}'.strip()}\n({report.folder.record.condition})\n{method.origin}")
    title = f"Means over {len(reports[0].summaries)} datasets"
    print_table(title, header, rows, numbers=range(1, len(header)))
    _print_synthetic([each for report in reports for each in report.summaries])


def _print_marks(summaries: Sequence[DatasetSummary]) -> None:
    """Print what is to be known beside scores of one method: what was left out, its marks, synthetic people."""
    for each in summaries:
        if each.unsupported:
            print(f"{_short(each)}: {each.unsupported} sequences are longer than the method can generate: not scored.")
        if each.remarks:
            print(f"{_short(each)}: {'; '.join(each.remarks)}.")
    _print_synthetic(summaries)


def exit_code_of(summaries: Sequence[DatasetSummary]) -> int:
    """Return 1 with ``--strict`` where motions are certainly wrong, else 0."""
    return int(session().strict and any(each.findings for each in summaries))


def print_findings(summaries: Sequence[DatasetSummary]) -> None:
    """Print what is certainly wrong with scored motions, a line each, last, where nobody overlooks it."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for each in summaries:
        for wrong in each.findings:
            found.setdefault((wrong.kind, wrong.cause, wrong.remedy), []).append(_short(each))
    for (kind, cause, remedy), names in found.items():
        print(f"WRONG MOTIONS ({kind}), {', '.join(names)}: {cause}. {remedy}")
    if found:
        print("The scores above are those of broken motions; `prbench doctor` shows the evidence (docs/doctor.md).")


def _print_synthetic(tables: Sequence[DatasetSummary | TableRecord]) -> None:
    if any(each.synthetic for each in tables):
        print(ON_SYNTHETIC_DATA)


def _irrelevant(motionless: bool) -> frozenset[str]:
    """Return the ids of metrics that say nothing about motions that stand still."""
    from prbench.metrics import METRICS

    return frozenset(info.id for info in METRICS if motionless and info.irrelevant_if_motionless)


def _method(summary: DatasetSummary, origin: str) -> str:
    control = f", {summary.control}" if summary.control else ""
    return f"{summary.method} ({origin}), condition {summary.condition}{control}"


def _short(summary: DatasetSummary) -> str:
    """Return the name of a dataset without the word that stands below the table."""
    return summary.dataset.removeprefix(SYNTHETIC_PREFIX)


def _with_unit(info: MetricInfo) -> str:
    from prbench.metrics import printed_unit

    unit = printed_unit(info.unit).strip()
    return f"{info.title}, {unit}" if unit else info.title


def _mean(found: MetricSummary | MeanOverDatasets | None, info: MetricInfo, *, hidden: bool) -> str:
    from prbench.metrics import printed_scale

    return _DASH if found is None or hidden else f"{found.mean * printed_scale(info.unit):.2f}"


class MadeRun(msgspec.Struct, frozen=True, kw_only=True):
    """One finished run.

    Attributes:
        folder: The run folder.
        method: Name of the method.
        origin: Origin of the method, in words.
        condition: What it was given.
        seed: Seed of the run.
        batches_found: Number of batches that an earlier call had left.
        datasets: Scores of each dataset, as in ``summary.json``.
        agreements: Agreement with recorded people on each dataset, and rates by the goal's place, as in
            ``agreement.json``; empty for merged folds and for benchmarks without recorded people.
        means: Mean of each metric over the datasets; without metrics that a dataset lacks, and empty for a single
            dataset.
        sequences: Every sequence with its scores and the link to its motion, the worst first, dataset after dataset;
            empty for a benchmark without recorded people.
    """

    folder: Path
    method: str
    origin: str
    condition: str
    seed: int
    batches_found: int
    datasets: tuple[DatasetSummary, ...]
    agreements: list[DatasetAgreement]
    means: dict[str, MeanOverDatasets]
    sequences: list[SequenceScores]


class RunAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """The runs of one command.

    Attributes:
        runs: The runs asked for, in their order.
        companions: Runs of other methods that a first run is shown beside.
        table_two: What ``--method all`` made; null for other methods.
        shards: One entry for each run of which a shard was made, with ``--shard``; then there are no runs.
    """

    runs: list[MadeRun] = []
    companions: list[MadeRun] = []
    table_two: dict[str, Any] | None = None
    shards: list[MadeShard] = []


def run_answer(
    reports: Sequence[RunReport],
    companions: Sequence[RunReport] = (),
    *,
    single: bool,
    data: Sequence[Path] = (),
    below: Sequence[str] = (),
) -> Answer:
    """Answer a command that has made runs.

    Args:
        reports: The runs asked for.
        companions: Runs of other methods that a first run is shown beside.
        single: The runs are of single sequences, whose scores are shown one by one.
        data: The tables that were run on.
        below: Lines that are printed below the scores.
    """
    scored = [summary for report in reports for summary in report.summaries]

    def show() -> None:
        for report in reports:
            _print_run(report, single=single)
        if companions:
            _print_company([reports[0], *companions])
        for report, made in zip(reports, answer.runs, strict=True):
            print(f"run folder: {report.folder.path}")
            print_worst(made.sequences, report.folder.path, data)
        for line in below:
            print(line)
        print_findings(scored)

    runs = [_made(report, data) for report in reports]
    answer = RunAnswer(runs=runs, companions=[_made(report, data) for report in companions])
    return Answer(answer, show, exit_code_of(scored))


SHOWN_SEQUENCES = 3  # that are printed; the report holds all


def print_worst(sequences: Sequence[SequenceScores], folder: Path | None, data: Sequence[Path]) -> None:
    """Print the worst sequences of a run, and the command that writes the page of their motions.

    Args:
        sequences: All sequences, the worst first; one dataset after another.
        folder: The run folder; None for motions of a file, which no page shows.
        data: The tables that were run on.
    """
    from prbench.files.storage import cache_folder
    from prbench.viewing.player.links import told_rates

    if not sequences:
        return
    first = [each for each in sequences if each.dataset == sequences[0].dataset]
    print(f"worst of {len(first)} sequences of {first[0].dataset}, by the mean of their ranks in the main metrics:")
    for each in first[:SHOWN_SEQUENCES]:
        place = each.sequence_id if folder is None else str(folder / (each.motion or ""))
        print(f"  {told_rates(each.scores)}: {place}")
    if folder is not None:
        # The embedded tables and folds lie in the cache, where the command finds them by their digests.
        needed = [str(table) for table in data if cache_folder() not in table.parents]
        named = ["--data", *needed] if needed else []
        print(f"motions: {shlex.join(['prbench', 'view', str(folder), *named])}")


def _made(report: RunReport, data: Sequence[Path]) -> MadeRun:
    from prbench.harness.run_folder.scores import CodedScores
    from prbench.harness.run_folder.summary import means_over_datasets, share_a_mean
    from prbench.protocol.manifests import default_benchmark
    from prbench.viewing.player.links import sequence_scores

    record = report.folder.record
    several = len(report.summaries) > 1 and share_a_mean(record.tables)
    sequences: list[SequenceScores] = []
    for each in report.summaries if record.benchmark == default_benchmark().name else ():
        scores = CodedScores.read(report.folder.dataset(each.dataset).scores)
        sequences += sequence_scores(scores, each.dataset, data, linked=True)
    about: dict[str, Any] = {"method": record.method.name, "origin": record.method.origin}
    about |= {
        "condition": record.condition,
        "folder": report.folder.path,
        "seed": record.seed,
        "batches_found": report.batches_found,
    }
    means = means_over_datasets(report.summaries) if several else {}
    agreements = [found for found in _agreements(report) if found]
    return MadeRun(**about, datasets=report.summaries, agreements=agreements, means=means, sequences=sequences)


def _agreements(report: RunReport) -> list[DatasetAgreement | None]:
    """Return the agreement with recorded people on each dataset; None for a benchmark that has none."""
    from prbench.harness.run_folder.summary import DatasetAgreement

    files = [report.folder.dataset(summary.dataset) for summary in report.summaries]
    return [DatasetAgreement.read(each.path) if each.agreement.is_file() else None for each in files]


def _print_run(report: RunReport, *, single: bool) -> None:
    from prbench.harness.benchmark import load_benchmark
    from prbench.harness.run_folder import read_scores
    from prbench.metrics import printed_unit

    record = report.folder.record
    metrics = load_benchmark(record.benchmark).metrics
    if single:
        # What every motion scored, sequence by sequence.
        for table in record.tables:
            rows = read_scores(report.folder.dataset(table.dataset).scores).to_pylist()
            for name in dict.fromkeys(row["sequence_id"] for row in rows):
                values = {(row["metric"], row["sample"]): row for row in rows if row["sequence_id"] == name}
                samples = sorted({sample for _, sample in values})
                lines = []
                for metric in metrics if session().all_metrics else [info for info in metrics if info.main]:
                    found = [values[metric.id, sample] for sample in samples if (metric.id, sample) in values]
                    cells = [f"{each['value']:.3f}{printed_unit(metric.unit)}" for each in found]
                    if metric.unit == "rate":
                        cells = ["yes" if each["value"] >= 0.5 else "no" for each in found]
                    remarks = dict.fromkeys(each["flag"].replace("_", " ") for each in found if each["flag"])
                    if found:
                        lines.append((metric.title, *cells, "; ".join(remarks)))
                header = ("metric", *(f"sample {sample}" if len(samples) > 1 else "value" for sample in samples), "")
                title = f"{name}: {record.method.name}, {record.condition}"
                print_table(title, header, lines, numbers=range(1, len(samples) + 1))
            _print_synthetic([table])
        return
    agreements = _agreements(report)
    if len(report.summaries) == 1:
        method = record.method
        print_summary(report.summaries[0], origin=method.origin, motionless=method.motionless, metrics=metrics)
        print_agreement(agreements[0])
    else:
        _print_datasets(report, agreements, metrics)
