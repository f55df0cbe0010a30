"""``prbench split-dataset``: a table split anew, by participants."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import PATH, out_folder_option


class SplitReport(msgspec.Struct, frozen=True, kw_only=True):
    """A table that was split anew.

    Attributes:
        out: Its folder.
        dataset: Name of the dataset.
        fold: The fold that is tested on, from 1.
        folds: Number of folds.
        tested: Participants of the split ``test``.
        sequences: Maps the splits to their numbers of sequences.
    """

    out: Path
    dataset: str
    fold: int
    folds: int
    tested: list[str]
    sequences: dict[str, int]


@command(
    "split-dataset",
    example="prbench split-dataset tables/mogaze --split participants --fold 2/6 --out tables/mogaze-2",
    report=SplitReport,
)
@click.argument("data", type=PATH, metavar="DIR")
@click.option("--split", type=click.Choice(["participants"]), default="participants", help="What is kept together.")
@click.option("--fold", required=True, metavar="K/N", help="The fold to test on, such as 2/6.")
@out_folder_option("Folder of the new table; the old one stays as it is.", required=True)
def split_dataset(data: Path, split: str, fold: str, out: Path) -> Answer:
    """Write a copy of a table in which nobody is both learnt from and tested on.

    One run on each fold, put together by `prbench merge`, scores every sequence once.
    """
    from prbench.sequences import SequenceTable
    from prbench.sequences.folds import parse_fold, participant_folds, write_fold

    del split  # the only one so far
    number, count = parse_fold(fold)
    table = SequenceTable.open(data).with_sequences()
    write_fold(table, out, fold=number, folds=count)
    rows = SequenceTable.open(out).scalars()["split"].to_pylist()
    report = SplitReport(
        out=out,
        dataset=table.info.dataset,
        fold=number,
        folds=count,
        tested=sorted(name for name, place in participant_folds(table, count).items() if place == number),
        sequences={name: rows.count(name) for name in ("train", "validation", "test")},
    )
    return Answer(report, lambda: _print(report))


def _print(report: SplitReport) -> None:
    counts = ", ".join(f"{name} {number}" for name, number in report.sequences.items())
    print(f"{report.dataset}, fold {report.fold}/{report.folds}: {counts}")
    print(f"tested on: {', '.join(report.tested)}")
    print(f"table: {report.out}")
