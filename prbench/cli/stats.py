"""``prbench stats``: Table 1, Table S2 and Figure S2 of the study, for one's own tables."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import command
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.published import PublishedRow
    from prbench.sequences import DatasetInfo
    from prbench.sequences.table_one import TableStatistics


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "stats",
        summary="print how many sequences a table holds, how long they are and how far people move, beside the study",
        example="prbench stats tables/adt tables/mogaze --draw figure_s2.svg",
        execute=_stats,
    )
    parser.add_argument("data", type=Path, nargs="+", metavar="DIR", help="built dataset folder(s)")
    parser.add_argument("--draw", type=Path, metavar="FILE", help="draw the six panels of Figure S2 as PNG or SVG")


def _stats(arguments: argparse.Namespace) -> int:
    from prbench.published import load_table_one
    from prbench.sequences import SequenceTable
    from prbench.sequences.table_one import table_statistics

    if arguments.draw is not None:
        from prbench.viewing.distributions import require_drawable

        require_drawable(arguments.draw)
    tables = [SequenceTable.open(folder) for folder in arguments.data]
    statistics = [table_statistics(table) for table in tables]
    published = load_table_one()
    rows = []
    for each in statistics:
        row = published.get(each.dataset.removeprefix("synthetic-"))
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
    for table in tables:
        _print_remarks(table.info)
    if any(each.dataset.startswith("synthetic-") for each in statistics):
        print("Synthetic sequences imitate the published means; their counts and scores are not comparable with them.")
    if arguments.draw is not None:
        from prbench.viewing.distributions import draw_table_one

        draw_table_one(_with_sequences(statistics), arguments.draw)
        print(f"drawing: {arguments.draw}")
    return 0


def _with_sequences(statistics: list[TableStatistics]) -> list[TableStatistics]:
    """Select the tables of which there is something to draw."""
    from prbench.errors import TableError

    drawable = [each for each in statistics if each.sequences]
    if not drawable:
        raise TableError("--draw: nothing to draw, since no table holds sequences (see above).")
    return drawable


def _print_remarks(info: DatasetInfo) -> None:
    """Say why a table holds no sequences, and that recordings of it are cut short."""
    from prbench.sequences.table import why_no_sequences

    counts = info.counts
    if not counts.sequences:
        print(f"{info.dataset}: no sequences. {why_no_sequences(info)}")
    if counts.recordings_cut_short:
        print(
            f"{info.dataset}: {counts.recordings_cut_short} of {counts.recordings_read} recordings are cut short: a"
            " stream of theirs ends before the others, and events may be missing. Messages in `recordings` name it."
        )


def _ours(each: TableStatistics) -> tuple[str, ...]:
    from prbench.published import QUANTITIES

    spreads = [each.spread(name) for name in QUANTITIES]
    counts = [str(each.by_split[split]) for split in ("train", "validation", "test")]
    numbers = [f"{spread.mean:.2f} ± {spread.sd:.2f}" if each.sequences else "–" for spread in spreads]
    return (each.dataset, str(each.sequences), *counts, *numbers, ", ".join(each.pose_sources))


def _theirs(row: PublishedRow) -> tuple[str, ...]:
    from prbench.published import QUANTITIES

    spreads = [getattr(row, name) for name in QUANTITIES]
    numbers = [f"{spread.mean:.2f} ± {spread.sd:.2f}" for spread in spreads]
    return ("  published", str(row.sequences), str(row.train), "–", str(row.test), *numbers, "")


def _deviations(each: TableStatistics, row: PublishedRow) -> tuple[str, ...]:
    from prbench.published import QUANTITIES

    numbers = [f"{each.deviation(name, getattr(row, name)):+.2f} sd" for name in QUANTITIES]
    return ("  difference", "", "", "", "", *numbers, "")
