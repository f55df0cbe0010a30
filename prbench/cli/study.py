"""``prbench study``: the tables and figures of the study on one's own tables and runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, Command, Group, SeveralValues, command, note
from prbench.cli.options import (
    PATH,
    data_arguments,
    data_option,
    limit_option,
    out_file_option,
    permission_option,
    sequence_option,
    workers_option,
)
from prbench.cli.terminal import print_table
from prbench.errors import RunError, UsageError

if TYPE_CHECKING:
    from prbench.leaderboard.tables import DatasetTable, Leaderboard
    from prbench.viewing.replay.scene import Scene
    from prbench.workflows.study.document import StudyTable

_ABLATIONS = ("3", "4", "s4", "s5", "s6", "s7")
_FIGURES = ("1", "2", "4", "5", "s2", "s3")
_EXAMPLE = "prbench study table-2 runs/table-2 --data tables/adt --with-published --out table_2.tex table_2.csv"

study = Group(
    "study",
    sections={
        "tables": {
            name: f"prbench.cli.study:{name.replace('-', '_')}"
            for name in ("table-1", "table-2", "table-s1", "table-s2", "table-s3", "table-s8")
        },
        "ablations: what `prbench ablation` has made": {
            f"table-{number}": f"prbench.cli.study:table_{number}" for number in _ABLATIONS
        },
        "figures": {f"figure-{number}": f"prbench.cli.study:figure_{number}" for number in _FIGURES},
    },
    example=_EXAMPLE,
    help="Make the study's tables and figures from your own tables and runs (docs/study.md).",
)


class StudyNumber(msgspec.Struct, frozen=True, kw_only=True):
    """One number of a table.

    Attributes:
        dataset: Name of the dataset.
        metric: Id of the metric or quantity.
        value: Rates in %, lengths in metres, times in seconds; null where a dash is printed.
        unit: ``%``, ``m``, ``s``, ``ratio``, or empty.
        condition: What the method was given.
        method: Name of the method.
        variant: What tells two rows of one method apart.
        low: Lower bound of the 95 % interval; null without one.
        high: Upper bound of the interval.
        sd: Standard deviation over sequences, or the number after ± in the study.
        sequences: Number of sequences behind the value.
        recordings: Number of recordings that they come from.
        detectable: Smallest difference to an unrelated method of the same spread that would be found with 80 % power;
            null where nothing can be tested.
        origin: ``measured``, ``measured on synthetic data``, ``published: …`` or ``measured - published: …``.
        note: What a reader of the number needs to know.
    """

    dataset: str
    metric: str
    value: float | None
    unit: str
    condition: str
    method: str
    variant: str
    low: float | None
    high: float | None
    sd: float | None
    sequences: int | None
    recordings: int | None
    detectable: float | None
    origin: str
    note: str


class MadeTable(msgspec.Struct, frozen=True, kw_only=True):
    """A table of the study, or one part of it.

    Attributes:
        number: Number in the study, such as ``S3``.
        title: What it shows.
        part: Dataset of a part; empty for a table of one part.
        stamp: A warning that belongs to all its numbers, such as that a smoke configuration made them; empty if there
            is none.
        notes: What a reader of the table needs to know.
        values: Its numbers, one a cell.
    """

    number: str
    title: str
    part: str
    stamp: str
    notes: list[str]
    values: list[StudyNumber]


class StudyReport(msgspec.Struct, frozen=True, kw_only=True):
    """What was made.

    Attributes:
        tables: The tables, or the numbers behind a figure.
        files: The files that were written.
    """

    tables: list[MadeTable]
    files: list[Path]


class FigureReport(msgspec.Struct, frozen=True, kw_only=True):
    """A figure of motions.

    Attributes:
        out: The picture.
        sequences: Ids of the sequences in it.
        notices: Sentences that the datasets' terms ask for, as they stand in the picture.
    """

    out: Path
    sequences: list[str]
    notices: list[str]


def _files_option(function: Callable) -> Callable:
    return click.option(
        "--out",
        "files",
        cls=SeveralValues,
        type=PATH,
        metavar="FILE...",
        help="Write the table to these files: .csv (one number a row), .tex (LaTeX with booktabs) or .md.",
    )(function)


def _numbers_option(function: Callable) -> Callable:
    return click.option(
        "--numbers",
        "files",
        cls=SeveralValues,
        type=PATH,
        metavar="FILE...",
        help="Write what the figure draws to these files: .csv, .tex or .md.",
    )(function)


def _published_option(function: Callable) -> Callable:
    return click.option(
        "--with-published",
        is_flag=True,
        help="Show the study's rows in a block of their own and, for runs on real recordings, the differences.",
    )(function)


def _runs_arguments(function: Callable) -> Callable:
    return click.argument("runs", type=PATH, nargs=-1, required=True, metavar="RUN...")(function)


def _tables_option(function: Callable) -> Callable:
    return data_option(
        required=False,
        help="The tables of the runs: scores are held against the motions on them, and called unverified without; the"
        " embedded tables need not be named.",
    )(function)


def _figure_option(function: Callable) -> Callable:
    return out_file_option("The picture: .png or .svg.", required=True)(function)


# Tables of datasets.


@command("table-1", example="prbench study table-1 tables/adt tables/mogaze --out table_1.tex", report=StudyReport)
@data_arguments
@_files_option
def table_1(data: tuple[Path, ...], files: tuple[Path, ...]) -> Answer:
    """Print how many sequences tables hold, how long they are and how far people move (Table 1)."""
    _require_formats(files)
    from prbench.sequences import SequenceTable
    from prbench.workflows.study.sizes import table_one

    return _answer([table_one([SequenceTable.open(folder) for folder in data])], files)


@command("table-s2", example="prbench study table-s2 tables/adt tables/mogaze --out table_s2.csv", report=StudyReport)
@data_arguments
@_files_option
def table_s2(data: tuple[Path, ...], files: tuple[Path, ...]) -> Answer:
    """Print how many sequences and recordings each split holds (Table S2)."""
    _require_formats(files)
    from prbench.sequences import SequenceTable
    from prbench.workflows.study.sizes import table_s2 as make

    return _answer([make([SequenceTable.open(folder) for folder in data])], files)


# Tables of methods.


def _methods_command(number: str, help: str) -> Command:
    """Make the command of Table 2 or Table S3."""

    @command(
        f"table-{number.lower()}",
        example=f"prbench study table-{number.lower()} runs/table-2 --data tables/adt --with-published"
        f" --out table_{number.lower()}.tex",
        report=StudyReport,
    )
    @_runs_arguments
    @_tables_option
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
        _require_formats(files)
        from prbench.workflows.study.methods import methods_table

        board = _board(runs, data, workers)
        tables = methods_table(_parts(board, part), number, with_published=with_published)
        return _answer(tables, files)

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
@_runs_arguments
@_tables_option
@_published_option
@_files_option
@workers_option()
def table_s1(
    runs: tuple[Path, ...], data: tuple[Path, ...], with_published: bool, files: tuple[Path, ...], workers: int
) -> Answer:
    """Print runs by the poses that they were trained and tested on (Table S1).

    The weights of a run have to bear names that end in -egoallo or -mocap.
    """
    _require_formats(files)
    from prbench.workflows.study.methods import poses_table

    board = _board(runs, data, workers)
    tables = poses_table(board, _pose_sources(data), with_published=with_published)
    return _answer(tables, files)


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
    @_tables_option
    @_published_option
    @_files_option
    @workers_option()
    def run(
        folder: Path, data: tuple[Path, ...], with_published: bool, files: tuple[Path, ...], workers: int
    ) -> Answer:
        _require_formats(files)
        from prbench.workflows.study.ablation import ablation_table

        tables = ablation_table(number, folder, _check(data, workers), with_published=with_published)
        _say_unverified(tables)
        return _answer(tables, files)

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
    _require_formats(files)
    from prbench.workflows.study.text import table_s8 as make

    return _answer([make(reports, with_published=with_published)], files)


# Figures.


@command("figure-s2", example="prbench study figure-s2 tables/adt --out figure_s2.svg", report=StudyReport)
@data_arguments
@_figure_option
def figure_s2(data: tuple[Path, ...], out: Path) -> Answer:
    """Draw where goals lie, how far people move and when they look (Figure S2)."""
    from prbench.errors import TableError
    from prbench.sequences import SequenceTable
    from prbench.sequences.table_one import table_statistics
    from prbench.viewing.distributions import draw_table_one
    from prbench.viewing.figures import require_drawable
    from prbench.workflows.study.sizes import table_one

    require_drawable(out)
    tables = [SequenceTable.open(folder) for folder in data]
    statistics = [each for each in map(table_statistics, tables) if each.sequences]
    if not statistics:
        raise TableError("nothing to draw, since no table holds sequences.")
    draw_table_one(statistics, out)
    return _answer([table_one(tables)], (), drawn=out)


@command(
    "figure-4",
    example="prbench study figure-4 runs/pr-goal-loc --data tables/adt --by action --out figure_4.png",
    report=StudyReport,
)
@_runs_arguments
@_tables_option
@click.option(
    "--by",
    type=click.Choice(["action", "hand", "kind", "distance", "bearing", "height", "gap"]),
    default="action",
    help="What sequences are grouped by (default action): pick or put, the reaching hand, the kind of prime, distance,"
    " bearing and height of the goal at the first frame, or the time from prime to event.",
)
@_numbers_option
@_figure_option
@workers_option()
def figure_4(
    runs: tuple[Path, ...], data: tuple[Path, ...], by: str, files: tuple[Path, ...], out: Path, workers: int
) -> Answer:
    """Draw scores by what a sequence asks for, such as picking against putting (Figure 4)."""
    _require_formats(files)
    from prbench.engine import engine_for
    from prbench.viewing.figures import require_drawable
    from prbench.workflows.study.breakdown import break_down, breakdown_table
    from prbench.workflows.study.drawing import draw_breakdown
    from prbench.workflows.study.genuine import genuine_runs

    require_drawable(out)
    scores = break_down(genuine_runs(runs, data, engine_for(workers)), by)
    draw_breakdown(scores, by, out)
    return _answer([breakdown_table(scores, by)], files, drawn=out)


@command(
    "figure-s3",
    example="prbench study figure-s3 runs/pr-goal-loc --data tables/adt --out figure_s3.svg --numbers figure_s3.csv",
    report=StudyReport,
)
@_runs_arguments
@_tables_option
@click.option(
    "--variant",
    type=click.Choice(["equation", "onset"]),
    default="equation",
    help="Reading of the deceleration (default equation, as the protocol scores).",
)
@_numbers_option
@_figure_option
@workers_option()
def figure_s3(
    runs: tuple[Path, ...], data: tuple[Path, ...], variant: str, files: tuple[Path, ...], out: Path, workers: int
) -> Answer:
    """Draw Prime Success over its distance and its window, from saved motions (Figure S3)."""
    _require_formats(files)
    from prbench.engine import engine_for
    from prbench.viewing.figures import require_drawable
    from prbench.workflows.study.drawing import draw_sweep
    from prbench.workflows.study.genuine import genuine_runs
    from prbench.workflows.study.sweep import sweep, sweep_table

    require_drawable(out)
    engine = engine_for(workers)
    reading = "onset" if variant == "onset" else "equation"
    sweeps = [sweep(run, variant=reading, engine=engine) for run in genuine_runs(runs, data, engine)]
    draw_sweep(sweeps, out)
    return _answer([sweep_table(sweeps)], files, drawn=out)


def _examples_command(number: str, limit: int, title: str, help: str) -> Command:
    """Make the command of Figure 1 or Figure 2."""

    @command(
        f"figure-{number}",
        example=f"prbench study figure-{number} tables/adt --out figure_{number}.png",
        report=FigureReport,
    )
    @data_arguments
    @sequence_option("Draw this sequence")
    @limit_option(str(limit))
    @permission_option
    @_figure_option
    def draw(
        data: tuple[Path, ...],
        sequences: tuple[str, ...],
        limit: int | None,
        permission: tuple[str, ...],
        out: Path,
    ) -> Answer:
        from prbench.viewing.study_motions import draw_examples

        scenes = _scenes(out, (), data, sequences, limit, permission, default=_limit)
        shown = [scene for scene in scenes if scene.shows_recorded]
        if not shown:
            raise UsageError("nothing to draw: the licence of these datasets keeps recorded motion (--permission).")
        draw_examples(shown, out, title=title)
        return _figure_answer(shown, out)

    _limit = limit
    draw.help = help
    return draw


figure_1 = _examples_command(
    "1",
    2,
    "Prime-and-reach sequences: people look at a goal before they reach it",
    "Draw recorded sequences with the look that primes the goal (Figure 1).",
)
figure_2 = _examples_command(
    "2",
    1,
    "Examples of curated prime-and-reach sequences",
    "Draw recorded sequences of each table (Figure 2).",
)


@command(
    "figure-5",
    example="prbench study figure-5 runs/pr-goal-pose runs/pr-goal-loc --data tables/adt --out figure_5.png",
    report=FigureReport,
)
@_runs_arguments
@_tables_option
@sequence_option("Draw this sequence")
@limit_option("3")
@permission_option
@_figure_option
def figure_5(
    runs: tuple[Path, ...],
    data: tuple[Path, ...],
    sequences: tuple[str, ...],
    limit: int | None,
    permission: tuple[str, ...],
    out: Path,
) -> Answer:
    """Draw recorded and generated poses at the first frame, the prime and the reach (Figure 5)."""
    from prbench.viewing.study_motions import draw_moments

    scenes = _scenes(out, runs, data, sequences, limit, permission, default=3)
    draw_moments(scenes, out, title="Recorded and generated motion at the first frame, the prime and the reach")
    return _figure_answer(scenes, out)


# What the commands share.


def _require_formats(files: Sequence[Path]) -> None:
    from prbench.workflows.study.formats import require_format

    for path in files:
        require_format(path)


def _check(data: Sequence[Path], workers: int) -> Callable:
    from prbench.engine import engine_for
    from prbench.submitted.verification import RunChecker
    from prbench.workflows.first_run import table_finder

    return RunChecker(table_finder(data), engine_for(workers)).check


def _board(runs: Sequence[Path], data: Sequence[Path], workers: int) -> Leaderboard:
    """Collect finished runs, whose scores are held against their motions."""
    from prbench.leaderboard import collect_runs, make_leaderboard

    collected = collect_runs(runs, check=_check(data, workers))
    for reason in collected.left_out:
        note(f"left out: {reason}")
    for row in collected.rows:
        if row.unverified:
            note(f"unverified: {row.run}: {row.unverified}")
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


def _answer(tables: Sequence[StudyTable], files: Sequence[Path], *, drawn: Path | None = None) -> Answer:
    """Write the tables and answer with their numbers."""
    from dataclasses import asdict

    from prbench.workflows.study.formats import write_tables

    for path in files:
        write_tables(tables, path)
    made = [
        MadeTable(
            number=table.number,
            title=table.title,
            part=table.part,
            stamp=table.stamp,
            notes=list(table.notes),
            values=[StudyNumber(**asdict(value)) for value in table.values],
        )
        for table in tables
    ]
    written = [*([] if drawn is None else [drawn]), *files]

    def show() -> None:
        print_study_tables(tables)
        for path in written:
            print(f"written: {path}")

    return Answer(StudyReport(tables=made, files=written), show)


def print_study_tables(tables: Sequence[StudyTable]) -> None:
    """Print tables block by block, with their notes."""
    for table in tables:
        print(table.heading)
        for block in table.blocks:
            print_table(block.title, table.header, block.rows, numbers=range(table.text_columns, len(table.header)))
        for line in table.notes:
            print(f"- {line}")


def _scenes(
    out: Path,
    runs: tuple[Path, ...],
    data: tuple[Path, ...],
    sequences: tuple[str, ...],
    limit: int | None,
    permission: tuple[str, ...],
    *,
    default: int,
) -> tuple[Scene, ...]:
    from prbench.viewing.figures import require_drawable
    from prbench.workflows.view import ViewRequest, scenes_of

    require_drawable(out)
    chosen = limit
    if chosen is None and not sequences:
        chosen = default
    return scenes_of(
        ViewRequest(out=out, runs=runs, data=data, sequences=sequences, limit=chosen, permitted=permission)
    )


def _figure_answer(scenes: Sequence[Scene], out: Path) -> Answer:
    notices = list(dict.fromkeys(scene.notice for scene in scenes if scene.notice))
    report = FigureReport(out=out, sequences=[scene.sequence_id for scene in scenes], notices=notices)

    def show() -> None:
        for scene in scenes:
            print(f"{scene.sequence_id}: {scene.title}")
        for notice in notices:
            print(notice)
        print(f"written: {out}")

    return Answer(report, show)
