"""What ``prbench run`` answers: the runs that were made, their scores, and how a terminal shows them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from prbench.cli.commands import Answer
from prbench.cli.shards import MadeShard, shard_answer
from prbench.cli.summaries import (
    print_agreement,
    print_carried_on,
    print_datasets,
    print_methods_on_datasets,
    print_scene,
    print_sequence_scores,
    print_summary,
)
from prbench.cli.table_two import TableTwoAnswer

if TYPE_CHECKING:
    from prbench.harness.run import RunReport
    from prbench.harness.run_folder.agreement import DatasetAgreement
    from prbench.harness.run_folder.means import MeanOverDatasets
    from prbench.harness.run_folder.rates_of_people import CarriedOn
    from prbench.harness.run_folder.summary import DatasetSummary


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
        carried_on: Seams and halves of each dataset, where puts carry on from generated picks; empty for other runs.
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
    carried_on: list[CarriedOn]


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
    table_two: TableTwoAnswer | None
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
    from prbench.harness.run_folder.means import means_over_datasets, share_a_mean

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
        carried_on=_carried_on(report),
    )


def _carried_on(report: RunReport) -> list[CarriedOn]:
    if not report.folder.record.carry_on:
        return []
    from prbench.harness.run_folder.carry_on import read_carried_on

    return [read_carried_on(report.folder.dataset(summary.dataset).path) for summary in report.summaries]


def _agreement(report: RunReport, dataset: str) -> DatasetAgreement | None:
    """Return the agreement with recorded people; None for a benchmark that has none."""
    from prbench.harness.run_folder.agreement import DatasetAgreement

    files = report.folder.dataset(dataset)
    return DatasetAgreement.read(files.path) if files.agreement.is_file() else None


def _print_run(report: RunReport, *, single: bool) -> None:
    from prbench.harness.benchmark import load_benchmark
    from prbench.harness.run_folder.means import share_a_mean

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
    print_carried_on(_carried_on(report))


def _print_company(reports: list[RunReport]) -> None:
    still = {shown.folder.record.method.name for shown in reports if shown.folder.record.method.motionless}
    print_methods_on_datasets(
        [shown.summaries for shown in reports],
        origins=[shown.folder.record.method.origin for shown in reports],
        motionless=frozenset(still),
    )
