"""Tables of ``prbench study``: of datasets, of methods, of ablations and of text-to-motion evaluation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli.commands import Answer, Command, SeveralValues, command, note
from prbench.cli.options import (
    OUT_FILE,
    PATH,
    collected_runs,
    data_arguments,
    run_checker,
    tables_option,
    workers_option,
)
from prbench.entry_points import STUDY_ITEMS, load_built_in
from prbench.errors import RunError, UsageError
from prbench_benchmarks.prime_and_reach.study_answers import StudyReport, require_formats, runs_arguments, study_answer

if TYPE_CHECKING:
    from prbench.board.tables import DatasetTable, Leaderboard
    from prbench_benchmarks.prime_and_reach.study.document import StudyTable


def _files_option(function: Callable) -> Callable:
    return click.option(
        "--out",
        "files",
        cls=SeveralValues,
        type=OUT_FILE,
        metavar="FILE...",
        help="Write the table to these files: .csv (one number a row), .tex (LaTeX with booktabs) or .md.",
    )(function)


def _published_option(function: Callable) -> Callable:
    return click.option(
        "--with-published",
        is_flag=True,
        help="Show the study's rows in a block of their own and, for runs on real recordings, the differences.",
    )(function)


# Tables of datasets.


@command("table-1", example="prbench study table-1 tables/adt tables/mogaze --out table_1.tex", report=StudyReport)
@data_arguments
@_files_option
def table_1(data: tuple[Path, ...], files: tuple[Path, ...]) -> Answer:
    """Print how many sequences tables hold, how long they are and how far people move (Table 1)."""
    require_formats(files)
    from prbench.sequences import SequenceTable
    from prbench_benchmarks.prime_and_reach.study.sizes import table_one

    return study_answer([table_one([SequenceTable.open(folder) for folder in data])], files)


@command("table-s2", example="prbench study table-s2 tables/adt tables/mogaze --out table_s2.csv", report=StudyReport)
@data_arguments
@_files_option
def table_s2(data: tuple[Path, ...], files: tuple[Path, ...]) -> Answer:
    """Print how many sequences and recordings each split holds (Table S2)."""
    require_formats(files)
    from prbench.sequences import SequenceTable
    from prbench_benchmarks.prime_and_reach.study.sizes import table_s2 as make

    return study_answer([make([SequenceTable.open(folder) for folder in data])], files)


# Tables of methods.


def _methods_command(number: str, help: str) -> Command:
    """Make the command of Table 2 or Table S3."""

    @command(
        f"table-{number.lower()}",
        example=f"prbench study table-{number.lower()} runs/table-2 --data tables/adt --with-published"
        f" --out table_{number.lower()}.tex",
        report=StudyReport,
    )
    @runs_arguments
    @tables_option
    @click.option("--part", metavar="DATASET", help="Only this dataset's part (default: a part for each).")
    @_published_option
    @_files_option
    @workers_option()
    def run(
        runs: tuple[Path, ...],
        data: tuple[Path, ...],
        part: str | None,
        with_published: bool,
        files: tuple[Path, ...],
        workers: int,
    ) -> Answer:
        require_formats(files)
        from prbench_benchmarks.prime_and_reach.study.methods import methods_table

        board = _board(runs, data, workers)
        tables = methods_table(_parts(board, part), number, with_published=with_published)
        return study_answer(tables, files)

    run.help = help
    return run


table_2 = _methods_command(
    "2",
    "Print runs in the layout of the study's main table, a part for each dataset (Table 2).\n\n"
    "RUN are run folders, or folders that hold some, such as that of `prbench run --method all --condition all`.",
)
table_s3 = _methods_command(
    "S3",
    "Print runs of models that were trained on one dataset each (Table S3).\n\n"
    "The weights of a run have to bear the name of the row and the dataset: pr-goal-loc-adt.",
)


@command(
    "table-s1",
    example="prbench study table-s1 runs/s1 --data tables/adt tables/adt-egoallo --with-published",
    report=StudyReport,
)
@runs_arguments
@tables_option
@_published_option
@_files_option
@workers_option()
def table_s1(
    runs: tuple[Path, ...], data: tuple[Path, ...], with_published: bool, files: tuple[Path, ...], workers: int
) -> Answer:
    """Print runs by the poses that they were trained and tested on (Table S1).

    The weights of a run have to bear names that end in -egoallo or -mocap.
    """
    require_formats(files)
    from prbench_benchmarks.prime_and_reach.study.methods import poses_table

    board = _board(runs, data, workers)
    tables = poses_table(board, _pose_sources(data), with_published=with_published)
    return study_answer(tables, files)


def _pose_sources(data: Sequence[Path]) -> Callable[[DatasetTable], Sequence[str]]:
    """Make what says where the bodies of a table of runs come from, by the digest of its content."""
    from prbench.sequences import SequenceTable

    opened = [SequenceTable.open(folder) for folder in data]
    sources = {table.content: sorted(set(table.scalars()["pose_source"].to_pylist())) for table in opened}
    return lambda table: sources.get(table.key[2], [])


def _ablation_command(number: str) -> Command:
    """Make the command of a table of ablations."""

    @command(
        f"table-{number.lower()}",
        example=f"prbench study table-{number.lower()} ablations/paper --data tables/hd-epic tables/mogaze"
        f" --with-published --out table_{number.lower()}.tex",
        report=StudyReport,
    )
    @click.argument("folder", type=PATH, metavar="DIR")
    @tables_option
    @_published_option
    @_files_option
    @workers_option()
    def run(
        folder: Path, data: tuple[Path, ...], with_published: bool, files: tuple[Path, ...], workers: int
    ) -> Answer:
        require_formats(files)
        tables = load_built_in(STUDY_ITEMS, "ablation")(
            number, folder, run_checker(data, workers).check, with_published=with_published
        )
        _say_unverified(tables)
        return study_answer(tables, files)

    run.help = (
        f"Print the rows of Table {number} that `prbench ablation table-{number.lower()}` has made.\n\n"
        "DIR is the folder of one configuration, such as ablations/paper."
    )
    return run


table_3 = _ablation_command("3")
table_4 = _ablation_command("4")
table_s4 = _ablation_command("S4")
table_s5 = _ablation_command("S5")
table_s6 = _ablation_command("S6")
table_s7 = _ablation_command("S7")


@command(
    "table-s8", example="prbench study table-s8 evaluation.json --with-published --out table_s8.tex", report=StudyReport
)
@click.argument("reports", type=PATH, nargs=-1, required=True, metavar="FILE...")
@_published_option
@_files_option
def table_s8(reports: tuple[Path, ...], with_published: bool, files: tuple[Path, ...]) -> Answer:
    """Print text-to-motion evaluations in the layout of the study (Table S8).

    FILE are what `prbench evaluate-text` has written.
    """
    require_formats(files)
    return study_answer([load_built_in(STUDY_ITEMS, "table-s8")(reports, with_published=with_published)], files)


# What the tables share.


def _board(runs: Sequence[Path], data: Sequence[Path], workers: int) -> Leaderboard:
    """Collect finished runs, whose scores are held against their motions."""
    from prbench.board import make_leaderboard

    collected = collected_runs(runs, data, workers)
    if not collected.rows:
        raise RunError("no finished run was found.")
    return make_leaderboard(collected)


def _parts(board: Leaderboard, part: str | None) -> Leaderboard:
    """Keep one dataset's tables, if one is named."""
    import dataclasses

    if part is None:
        return board
    known = [table.dataset for table in board.tables]
    if part not in known:
        raise UsageError(f"--part: no run is of '{part}'; those named are of: {', '.join(dict.fromkeys(known))}.")
    return dataclasses.replace(board, tables=tuple(table for table in board.tables if table.dataset == part))


def _say_unverified(tables: Sequence[StudyTable]) -> None:
    for table in tables:
        for line in table.notes:
            if "unverified, because" in line:
                note(line)
