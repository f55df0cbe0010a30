"""``prbench prediction tables``: Tables 1, 2 and 3 of the study on a table of windows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import msgspec

from prbench.cli.commands import Answer, SeveralValues, command, note, progress
from prbench.cli.options import PATH, POSITIVE, device_option, limit_option, out_folder_option, seed_option
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench_benchmarks.motion_prediction.tables import PredictionLayout, TablesReport
    from prbench_benchmarks.motion_prediction.tables.layout import Table


class PredictionTablesReport(msgspec.Struct, frozen=True, kw_only=True):
    """The study's tables of motion prediction on one table of windows.

    Attributes:
        folder: Where the tables, the charts and the scores of each row are.
        scored: Names of the rows that were scored by this call.
        missing: Rows without numbers, and why.
        charts: Pictures that were drawn.
        tables: The content of ``tables.json``: lines with measured and printed numbers, orders, values of gaze.
    """

    folder: Path
    scored: list[str]
    missing: dict[str, str]
    charts: list[Path]
    tables: dict[str, Any]


@command(
    "tables",
    example="prbench prediction tables windows/mogaze --weights trained --out tables/mogaze",
    report=PredictionTablesReport,
    resumes=True,
)
@click.argument("windows", type=PATH, metavar="WINDOWS")
@out_folder_option("Folder of the tables, the charts, and the scores of each row.", required=True)
@click.option(
    "--weights",
    type=PATH,
    metavar="DIR",
    help="Folder with weights by the row's name, such as no-gaze.safetensors (default: those that come with prbench).",
)
@click.option(
    "--runs",
    cls=SeveralValues,
    type=PATH,
    metavar="RUN...",
    help="Finished runs on WINDOWS (`prbench run --benchmark motion-prediction`): their scores stand for their rows.",
)
@click.option(
    "--split",
    type=click.Choice(["published", "dataset", "participants"]),
    help="Windows that are scored: of the study's test split (default where there is one), of the dataset's, or each"
    " participant's, left out of what is learnt.",
)
@click.option("--samples", type=POSITIVE, default=50, metavar="K", help="Futures of each window (default 50).")
@limit_option()
@seed_option("of the futures")
@device_option
def tables(
    windows: Path,
    out: Path,
    weights: Path | None,
    runs: tuple[Path, ...],
    split: Literal["published", "dataset", "participants"] | None,
    samples: int,
    limit: int | None,
    seed: int,
    device: str,
) -> Answer:
    """Score every row of the study's Tables 1, 2 and 3 on WINDOWS, and print them beside the printed numbers."""
    from prbench_benchmarks.motion_prediction.tables import TablesRequest, run_tables
    from prbench_benchmarks.motion_prediction.tables.as_markdown import as_builtins

    request = TablesRequest(
        windows=windows,
        out=out,
        split=split,
        samples=samples,
        limit=limit,
        weights=weights,
        runs=runs,
        seed=seed,
        device=device,
    )
    with progress("scoring") as tell:
        report = run_tables(request, tell)
    missing = {line.row.name: line.missing for table in report.layout.tables for line in table.lines if line.missing}
    answer = PredictionTablesReport(
        folder=report.folder,
        scored=list(report.scored),
        missing=missing,
        charts=list(report.charts),
        tables=as_builtins(report.layout, report.values),
    )
    for name, why in missing.items():
        note(f"{name}: {why}")
    return Answer(answer, lambda: _show(report))


def _show(report: TablesReport) -> None:
    from prbench_benchmarks.motion_prediction.tables.as_markdown import heading, notes, order, told, value_cells
    from prbench_benchmarks.motion_prediction.tables.gaze_value import EVERY
    from prbench_benchmarks.motion_prediction.tables.run import JSON, MARKDOWN

    print(heading(report.layout))
    for table in report.layout.tables:
        _print(table, report.layout)
        if table.order:
            print(order(table))
    values = [each for each in told(report.values) if each.anchor == EVERY]
    if values:
        header = ("method", "metric", "told", "difference, m", "p")
        rows = [(each.method, *value_cells(each)[1:]) for each in values]
        print_table("What the head and gaze are worth, all windows", header, rows, numbers=(3, 4))
    for text in notes(report.layout):
        print(text)
    print(f"tables, and values by the time before the event: {report.folder / MARKDOWN}, {report.folder / JSON}")
    for chart in report.charts:
        print(f"chart: {chart}")


def _print(table: Table, layout: PredictionLayout) -> None:
    """Print a table; the numbers of the study stand in one of their own."""
    from prbench_benchmarks.motion_prediction.tables.as_markdown import cells, columns

    title = f"Table {table.number}: {table.title}"
    header = columns(layout)
    measured = len(header) - 4 * len(layout.shown_datasets)
    rows = [tuple(cell.replace(" [", "\n[") for cell in cells(line, layout)) for line in table.lines]
    print_table(title, header[:measured], [row[:measured] for row in rows], numbers=range(1, measured))
    for number, dataset in enumerate(layout.shown_datasets):
        first = measured + 4 * number
        kept = [(row[0], *row[first : first + 4]) for row in rows]
        kept = [row for row in kept if set(row[1:]) != {"–"}]
        if kept:
            print_table(f"{title}, as printed for {dataset}", header[:measured], kept, numbers=range(1, measured))
