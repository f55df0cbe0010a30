"""``prbench stats``: Table 1, Table S2 and Figure S2 of the study, for one's own tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import OUT_FILE, data_arguments
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.protocol.published import PublishedRow
    from prbench.sequences import DatasetInfo
    from prbench.sequences.table_one import TableStatistics


class Quantity(msgspec.Struct, frozen=True, kw_only=True):
    """One quantity of Table 1, over all sequences of a table.

    Attributes:
        unit: ``s`` or ``m``.
        mean: Mean over sequences; null without sequences.
        sd: Standard deviation over sequences.
        published_mean: The study's mean; null where it prints none.
        published_sd: The study's standard deviation.
        deviation: (mean - published mean) / published standard deviation.
    """

    unit: str
    mean: float | None
    sd: float | None
    published_mean: float | None
    published_sd: float | None
    deviation: float | None


class TableStats(msgspec.Struct, frozen=True, kw_only=True):
    """The statistics of one table.

    Attributes:
        dataset: Name of the dataset.
        sequences: Number of sequences.
        by_split: Number of sequences of each split.
        published_sequences: The study's number; null where it prints none.
        participants_in_two_splits: People with sequences in both train and test.
        pose_sources: Where the bodies come from.
        quantities: ``duration``, ``prime_gap``, ``body_movement`` and ``hand_movement``.
        remarks: Why there are no sequences, and recordings that are cut short.
    """

    dataset: str
    sequences: int
    by_split: dict[str, int]
    published_sequences: int | None
    participants_in_two_splits: int
    pose_sources: list[str]
    quantities: dict[str, Quantity]
    remarks: list[str]


class StatsReport(msgspec.Struct, frozen=True, kw_only=True):
    """Tables beside the study.

    Attributes:
        tables: One entry a table.
        drawing: The picture, if one was asked for.
    """

    tables: list[TableStats]
    drawing: Path | None


@command(
    "stats",
    example="prbench stats tables/adt tables/mogaze --draw figure_s2.svg",
    report=StatsReport,
    writes_report=True,
)
@data_arguments
@click.option("--draw", type=OUT_FILE, metavar="FILE", help="Draw the six panels of Figure S2 as PNG or SVG.")
def stats(data: tuple[Path, ...], draw: Path | None) -> Answer:
    """Print how many sequences tables hold, how long they are and how far people move, beside the study."""
    from prbench.protocol.published import load_table_one
    from prbench.sequences import SequenceTable
    from prbench.sequences.table_one import table_statistics

    if draw is not None:
        from prbench.viewing.distributions import require_drawable

        require_drawable(draw)
    tables = [SequenceTable.open(folder) for folder in data]
    statistics = [table_statistics(table) for table in tables]
    if draw is not None:
        from prbench.viewing.distributions import draw_table_one

        draw_table_one(_with_sequences(statistics), draw)
    published = {each.dataset: load_table_one().get(each.dataset.removeprefix("synthetic-")) for each in statistics}
    remarks = {table.info.dataset: _remarks(table.info) for table in tables}
    report = StatsReport(
        tables=[_table_stats(each, published[each.dataset], remarks[each.dataset]) for each in statistics],
        drawing=draw,
    )
    return Answer(report, lambda: _print(report, statistics, published))


def _table_stats(each: TableStatistics, published: PublishedRow | None, remarks: list[str]) -> TableStats:
    from prbench.protocol.published import QUANTITIES

    quantities = {}
    for name, unit in QUANTITIES.items():
        ours = each.spread(name)
        theirs = getattr(published, name) if published else None
        quantities[name] = Quantity(
            unit=unit,
            mean=ours.mean,
            sd=ours.sd,
            published_mean=theirs.mean if theirs else None,
            published_sd=theirs.sd if theirs else None,
            deviation=each.deviation(name, theirs) if theirs else None,
        )
    return TableStats(
        dataset=each.dataset,
        sequences=each.sequences,
        by_split=each.by_split,
        published_sequences=published.sequences if published else None,
        participants_in_two_splits=each.participants_in_two_splits,
        pose_sources=list(each.pose_sources),
        quantities=quantities,
        remarks=remarks,
    )


def _print(report: StatsReport, statistics: list[TableStatistics], published: dict[str, PublishedRow | None]) -> None:
    rows = []
    for each in statistics:
        row = published[each.dataset]
        rows += [_ours(each), _theirs(row)] if row else [_ours(each)]
        rows += [_deviations(each, row)] if row and each.sequences else []
    print_table(
        "prime-and-reach sequences (mean ± standard deviation over sequences)",
        (
            "dataset",
            "sequences",
            "train",
            "validation",
            "test",
            "duration s",
            "prime gap s",
            "body m",
            "hand m",
            "body",
        ),
        rows,
        numbers=range(1, 9),
    )
    for each in statistics:
        if each.participants_in_two_splits:
            print(
                f"{each.dataset}: {each.participants_in_two_splits} participants have sequences in both train and test;"
                " the protocol splits by recording, as the study does."
            )
    for table in report.tables:
        for remark in table.remarks:
            print(f"{table.dataset}: {remark}")
    if any(each.dataset.startswith("synthetic-") for each in statistics):
        print("Synthetic sequences imitate the published means; their counts and scores are not comparable with them.")
    if report.drawing is not None:
        print(f"drawing: {report.drawing}")


def _with_sequences(statistics: list[TableStatistics]) -> list[TableStatistics]:
    """Select the tables of which there is something to draw."""
    from prbench.errors import TableError

    drawable = [each for each in statistics if each.sequences]
    if not drawable:
        raise TableError("--draw: nothing to draw, since no table holds sequences (see above).")
    return drawable


def _remarks(info: DatasetInfo) -> list[str]:
    """Say why a table holds no sequences, and that recordings of it are cut short."""
    from prbench.sequences.table import why_no_sequences

    counts = info.counts
    remarks = []
    if not counts.sequences:
        remarks.append(f"no sequences. {why_no_sequences(info)}")
    if counts.recordings_cut_short:
        remarks.append(
            f"{counts.recordings_cut_short} of {counts.recordings_read} recordings are cut short: a stream of theirs"
            " ends before the others, and events may be missing. Messages in `recordings` name it."
        )
    return remarks


def _ours(each: TableStatistics) -> tuple[str, ...]:
    from prbench.protocol.published import QUANTITIES

    spreads = [each.spread(name) for name in QUANTITIES]
    counts = [str(each.by_split[split]) for split in ("train", "validation", "test")]
    numbers = [f"{spread.mean:.2f} ± {spread.sd:.2f}" if each.sequences else "–" for spread in spreads]
    return (each.dataset, str(each.sequences), *counts, *numbers, ", ".join(each.pose_sources))


def _theirs(row: PublishedRow) -> tuple[str, ...]:
    from prbench.protocol.published import QUANTITIES

    spreads = [getattr(row, name) for name in QUANTITIES]
    numbers = [f"{spread.mean:.2f} ± {spread.sd:.2f}" for spread in spreads]
    return ("  published", str(row.sequences), str(row.train), "–", str(row.test), *numbers, "")


def _deviations(each: TableStatistics, row: PublishedRow) -> tuple[str, ...]:
    from prbench.protocol.published import QUANTITIES

    numbers = [f"{each.deviation(name, getattr(row, name)):+.2f} sd" for name in QUANTITIES]
    return ("  difference", "", "", "", "", *numbers, "")
