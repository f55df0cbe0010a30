"""``prbench analyse diversity``: how far several motions for one goal differ, beside recorded people."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from prbench.cli.commands import Answer, progress
from prbench.cli.terminal import print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.harness.intervals import Estimate
    from prbench_benchmarks.prime_and_reach.diversity import DatasetDiversity


class SpreadEstimate(msgspec.Struct, frozen=True, kw_only=True):
    """A mean over sequences.

    Attributes:
        mean: The mean.
        low: Lower bound of its 95 % interval over recordings; null where too few recordings allow none.
        high: Upper bound of the interval.
        marks: What a reader of the interval needs to know: ``few_recordings``, ``one_recording``, ``all_equal``.
    """

    mean: float
    low: float | None
    high: float | None
    marks: list[str]


class Spread(msgspec.Struct, frozen=True, kw_only=True):
    """One measure of how far the motions of a sequence differ.

    Attributes:
        measure: Id of the measure (docs/specification/metrics.md#diversity).
        title: Its name as printed.
        unit: Unit of the values.
        method: Mean of the method.
        people: Mean of recorded people in similar tasks, an upper bound of their spread in one task; null where the
            table has too few recordings.
        difference: Method minus people; null likewise.
    """

    measure: str
    title: str
    unit: str
    method: SpreadEstimate
    people: SpreadEstimate | None
    difference: SpreadEstimate | None


class DiversityOfDataset(msgspec.Struct, frozen=True, kw_only=True):
    """The diversity of a run on one dataset.

    Attributes:
        dataset: Name of the dataset.
        title: Its name as printed.
        synthetic: The people are synthetic.
        motions: Motions of each sequence, generated as well as recorded.
        sequences: Number of sequences.
        recordings: Number of recordings that they come from.
        goals_apart: Median distance of the goal of a similar task from a sequence's own, metres; null without people.
        lengths_apart: Median difference of their lengths, seconds; null without people.
        spreads: One entry a measure.
    """

    dataset: str
    title: str
    synthetic: bool
    motions: int
    sequences: int
    recordings: int
    goals_apart: float | None
    lengths_apart: float | None
    spreads: list[Spread]


class DiversityReport(msgspec.Struct, frozen=True, kw_only=True):
    """How far the motions of a run differ.

    Attributes:
        run: The run folder.
        method: Name of the method.
        condition: What it was given.
        datasets: One entry a dataset.
        fan: The picture; null if none was asked for.
        fan_sequence: Id of the sequence in it; null likewise.
    """

    run: Path
    method: str
    condition: str
    datasets: list[DiversityOfDataset]
    fan: Path | None
    fan_sequence: str | None


def diversity(
    runs: tuple[Path, ...],
    *,
    data: tuple[Path, ...],
    fan: Path | None,
    sequence: str | None,
    permission: tuple[str, ...],
) -> Answer:
    """Say how far several motions for one goal differ in poses, path and timing, beside recorded people."""
    from prbench.harness.run_folder import RunFolder
    from prbench.viewing.fan import draw_fan
    from prbench.viewing.figures import require_drawable
    from prbench_benchmarks.prime_and_reach.diversity import measure_diversity, read_fan

    if len(runs) != 1:
        raise UsageError("analyse diversity: name one RUN.")
    run = runs[0]
    if fan is None and sequence is not None:
        raise UsageError("--sequence: belongs to --fan FILE, which it is drawn in.")
    if fan is not None:
        require_drawable(fan)
    drawn = read_fan(run, data, sequence=sequence, permitted=permission) if fan is not None else None
    with progress("measuring") as show:
        found = measure_diversity(run, data, progress=show)
    if fan is not None and drawn is not None:
        draw_fan(drawn, fan)
    record = RunFolder.open(run).record
    report = DiversityReport(
        run=run,
        method=record.method.name,
        condition=record.condition,
        datasets=[_dataset(each) for each in found],
        fan=fan,
        fan_sequence=None if drawn is None else drawn.sequence_id,
    )
    notice = "" if drawn is None else drawn.notice
    return Answer(report, lambda: _print(report, notice))


def _dataset(each: DatasetDiversity) -> DiversityOfDataset:
    return DiversityOfDataset(
        dataset=each.dataset,
        title=each.title,
        synthetic=each.synthetic,
        motions=each.motions,
        sequences=each.sequences,
        recordings=each.recordings,
        goals_apart=each.goals_apart,
        lengths_apart=each.lengths_apart,
        spreads=[
            Spread(
                measure=spread.info.id,
                title=spread.info.title,
                unit=spread.info.unit,
                method=_estimate(spread.method),
                people=spread.people and _estimate(spread.people),
                difference=spread.difference and _estimate(spread.difference),
            )
            for spread in each.spreads
        ],
    )


def _estimate(estimate: Estimate) -> SpreadEstimate:
    return SpreadEstimate(mean=estimate.mean, low=estimate.low, high=estimate.high, marks=list(estimate.marks))


def _print(report: DiversityReport, notice: str) -> None:
    for each in report.datasets:
        title = (
            f"{each.title}: {report.method}, condition {report.condition}; {each.motions} motions of each of"
            f" {each.sequences} sequences of {each.recordings} recording{'' if each.recordings == 1 else 's'}"
        )
        print_table(
            f"{title}; means over sequences and their 95 % intervals",
            ("measure", "unit", "method", "people", "method - people"),
            [_row(spread) for spread in each.spreads],
            numbers=(2, 3, 4),
        )
        if each.goals_apart is None:
            print("People: the table has too few recordings to put people beside one another.")
        else:
            print(
                "People: the sequence and similar tasks of other recordings, laid on its goal; an upper bound of what"
                f" one task brings forth (goals {each.goals_apart:.2f} m apart in median, lengths"
                f" {each.lengths_apart:.2f} s)."
            )
        if any("few_recordings" in spread.method.marks for spread in each.spreads):
            print("Few recordings (below ten): the intervals say little.")
        if each.synthetic:
            print("Synthetic people: this says nothing about real ones.")
    if notice:
        print(notice)
    if report.fan is not None:
        print(f"fan: {report.fan} ({report.fan_sequence})")


def _row(spread: Spread) -> tuple[str, ...]:
    return (spread.title, spread.unit, _cell(spread.method), _cell(spread.people), _cell(spread.difference, sign=True))


def _cell(estimate: SpreadEstimate | None, *, sign: bool = False) -> str:
    if estimate is None:
        return "–"
    form = "+.3f" if sign else ".3f"
    bounds = ""
    if estimate.low is not None and estimate.high is not None:
        bounds = f" [{estimate.low:{form}}, {estimate.high:{form}}]"
    return f"{estimate.mean:{form}}{bounds}"
