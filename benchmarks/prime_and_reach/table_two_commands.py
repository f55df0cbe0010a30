"""``prbench run --method all --condition all``: Table 2, its rows run one after the other, printed in its layout."""

from __future__ import annotations

import contextlib
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from prbench.cli.commands import Answer, note, progress
from prbench.cli.options import PARTICIPANTS, embedded_tables, opened
from prbench.cli.terminal import print_table, shown_width
from prbench.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from prbench.engine.choice import EngineChoice
    from prbench.harness.request import ProgressCallback
    from prbench_benchmarks.prime_and_reach.table_two import Cell, DatasetLayout, TableLayout
    from prbench_benchmarks.prime_and_reach.table_two.plan import PlannedRow

ALL = "all"
_WORKERS = 2
_SINGLE_RUN = {"sequences": "sequence", "isolate": "isolate", "timeout": "timeout", "fold": "fold"}
_WIDE = 180
"""Columns that the whole layout takes."""
_LEADS = "¹"


class TableTwoAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """Table 2 on one's own tables (``--method all``).

    Attributes:
        folder: Where the rows' run folders and the two files of the table are.
        failed: Names of the rows that were to be run and have no numbers.
        table: The content of ``table_2.json``: blocks, lines and cells.
    """

    folder: Path
    failed: list[str]
    table: dict[str, Any]


def run_table_two(given: Mapping[str, Any], *, minutes: int | None, choice: EngineChoice) -> Answer:
    """Run what is missing of the table; the exit code is 1 if a row failed."""
    from prbench.harness.preparation import DEFAULT_PARENT
    from prbench_benchmarks.prime_and_reach.table_two import run_table
    from prbench_benchmarks.prime_and_reach.table_two.as_markdown import as_builtins
    from prbench_benchmarks.prime_and_reach.table_two.run import JSON, MARKDOWN, Say

    engine = opened(
        choice,
        usual=_WORKERS,
        threads=given["threads"],
        reads=tuple(given["data"]),
        writes=(given["out"] or DEFAULT_PARENT / "table",),
    )
    # Turn the arguments into a request.
    data = tuple(given["data"]) or embedded_tables(engine)
    from prbench.contract import Condition
    from prbench_benchmarks.prime_and_reach.table_two import TableRequest
    from prbench_benchmarks.prime_and_reach.table_two.request import DEFAULT_MINUTES

    for name, option in _SINGLE_RUN.items():
        if given[name]:
            raise UsageError(f"--{option}: belongs to a run of one method under one condition; leave it out.")
    if given["split"] == PARTICIPANTS:
        raise UsageError("--split participants: run --method all on a table of each fold (`prbench split-dataset`).")
    request = TableRequest(
        data=data,
        method=None if given["method"] == ALL else given["method"],
        condition=None if given["condition"] in (ALL, None) else Condition(given["condition"]),
        weights=given["weights"],
        options=dict(given["options"]),
        split=given["split"],
        limit=given["limit"],
        minutes=minutes or DEFAULT_MINUTES,
        seed=given["seed"],
        samples=given["samples"] or 1,
        batch_size=given["batch_size"],
        device=given["device"],
        threads=given["threads"],
        protocol=given["protocol"],
        shuffled_goal=given["control"] is not None,
        more_controls=given["with_controls"],
        out=given["out"],
    )
    say = Say(
        notice=note,
        timing=lambda: progress("timing a first batch"),
        generating=lambda: progress("generating, row"),
        row=_row_progress,
    )
    report = run_table(request, engine=engine, say=say)
    for outcome in report.failed:
        note(f"failed: {outcome.planned.name}; the same command tries it again")

    def show() -> None:
        _print_layout(report.layout)
        print(f"table: {report.folder / MARKDOWN}, {report.folder / JSON}")
        print(f"beside the study's numbers: prbench study table-2 {report.folder} --data DIR... --with-published")

    answer = TableTwoAnswer(
        folder=report.folder,
        failed=[outcome.planned.name for outcome in report.failed],
        table=as_builtins(report.layout),
    )
    return Answer(answer, show, exit_code=1 if report.failed else 0)


def _print_layout(layout: TableLayout) -> None:
    """Print each dataset's part, and what a reader has to know of them."""
    from prbench_benchmarks.prime_and_reach.table_two.as_markdown import heading, notes, orders

    show = _print_dataset if shown_width() >= _WIDE else _print_narrow
    for dataset in layout.datasets:
        show(dataset, heading(dataset, layout))
        for text in orders(dataset):
            print(text)
    for line in notes(layout):
        print(line)


def _print_dataset(dataset: DatasetLayout, title: str) -> None:
    from prbench.metrics import STUDY_METRICS
    from prbench_benchmarks.prime_and_reach.table_two.as_markdown import COST_TITLES, cost_cells, shown_label
    from prbench_benchmarks.prime_and_reach.table_two.layout import metric_title

    header = ("Condition", "Method", *(metric_title(info) for info in STUDY_METRICS), *COST_TITLES)
    rows = []
    for block in dataset.blocks:
        for i, line in enumerate(block.lines):
            cells = (_cell(line.cells[info.id]) for info in STUDY_METRICS)
            rows.append((block.title if i == 0 else "", shown_label(line), *cells, *cost_cells(line.cost)))
    print_table(title, header, rows, numbers=range(2, len(header)))


def _print_narrow(dataset: DatasetLayout, title: str) -> None:
    """Print a dataset's part on a terminal of 80 columns: blocks one below the other, costs below their numbers."""
    from prbench.metrics import STUDY_METRICS
    from prbench_benchmarks.prime_and_reach.table_two.as_markdown import COST_TITLES, cost_cells, shown_label
    from prbench_benchmarks.prime_and_reach.table_two.layout import metric_title

    print(title)
    metrics = ("Method", *(metric_title(info).replace(" ", "\n", 1) for info in STUDY_METRICS))
    for block in dataset.blocks:
        rows = [
            (_folded(shown_label(line)), *(_cell(line.cells[info.id], ",\n") for info in STUDY_METRICS))
            for line in block.lines
        ]
        print_table(block.title, metrics, rows, numbers=range(1, len(metrics)))
        costs = [
            (_folded(shown_label(line)), *cost_cells(line.cost))
            for line in block.lines
            if line.cost.seconds is not None
        ]
        if costs:
            print_table(f"{block.title}: cost", ("Method", *COST_TITLES), costs, numbers=range(1, 1 + len(COST_TITLES)))


def _folded(label: str) -> str:
    """Fold a label into lines no longer than a method's name and its mark."""
    return textwrap.fill(label, len("DartControl †"))


def _cell(cell: Cell | None, between: str = ", ") -> str:
    """Write a mean with its place, and the interval below."""
    if cell is None:
        return "–"
    mean = f"{cell.mean:.2f}{_LEADS if cell.leads else ''}"
    return f"{mean}\n{cell.interval.replace(', ', between)}".rstrip()


@contextlib.contextmanager
def _row_progress(planned: PlannedRow) -> Iterator[ProgressCallback]:
    with progress(f"scoring {planned.name}") as show:
        yield lambda step: show(step.done, step.total, f"{step.stage} {step.dataset}")
