"""Figures of ``prbench study``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, Command, SeveralValues, command
from prbench.cli.options import (
    OUT_FILE,
    data_arguments,
    limit_option,
    out_file_option,
    permission_option,
    sequence_option,
    tables_option,
    workers_option,
)
from prbench.errors import UsageError
from prbench_benchmarks.prime_and_reach.study_answers import StudyReport, require_formats, runs_arguments, study_answer

if TYPE_CHECKING:
    from prbench.viewing.replay.scene import Scene


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


def _numbers_option(function: Callable) -> Callable:
    return click.option(
        "--numbers",
        "files",
        cls=SeveralValues,
        type=OUT_FILE,
        metavar="FILE...",
        help="Write what the figure draws to these files: .csv, .tex or .md.",
    )(function)


def _figure_option(function: Callable) -> Callable:
    return out_file_option("The picture: .png or .svg.", required=True)(function)


@command("figure-s2", example="prbench study figure-s2 tables/adt --out figure_s2.svg", report=StudyReport)
@data_arguments
@_figure_option
def figure_s2(data: tuple[Path, ...], out: Path) -> Answer:
    """Draw where goals lie, how far people move and when they look (Figure S2)."""
    from prbench.errors import TableError
    from prbench.sequences import SequenceTable
    from prbench.sequences.table import table_statistics
    from prbench.viewing.distributions import draw_table_one
    from prbench.viewing.figures import require_drawable
    from prbench_benchmarks.prime_and_reach.study.sizes import table_one

    require_drawable(out)
    tables = [SequenceTable.open(folder) for folder in data]
    statistics = [each for each in map(table_statistics, tables) if each.sequences]
    if not statistics:
        raise TableError("nothing to draw, since no table holds sequences.")
    draw_table_one(statistics, out)
    return study_answer([table_one(tables)], (), drawn=out)


@command(
    "figure-4",
    example="prbench study figure-4 runs/pr-goal-loc --data tables/adt --by action --out figure_4.png",
    report=StudyReport,
)
@runs_arguments
@tables_option
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
    require_formats(files)
    from prbench.engine import engine_for
    from prbench.viewing.figures import require_drawable
    from prbench_benchmarks.prime_and_reach.study.breakdown import break_down, breakdown_table
    from prbench_benchmarks.prime_and_reach.study.drawing import draw_breakdown
    from prbench_benchmarks.prime_and_reach.study.genuine import genuine_runs

    require_drawable(out)
    scores = break_down(genuine_runs(runs, data, engine_for(workers)), by)
    draw_breakdown(scores, by, out)
    return study_answer([breakdown_table(scores, by)], files, drawn=out)


@command(
    "figure-s3",
    example="prbench study figure-s3 runs/pr-goal-loc --data tables/adt --out figure_s3.svg --numbers figure_s3.csv",
    report=StudyReport,
)
@runs_arguments
@tables_option
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
    require_formats(files)
    from prbench.engine import engine_for
    from prbench.viewing.figures import require_drawable
    from prbench_benchmarks.prime_and_reach.study.drawing import draw_sweep
    from prbench_benchmarks.prime_and_reach.study.genuine import genuine_runs
    from prbench_benchmarks.prime_and_reach.study.sweep import sweep, sweep_table

    require_drawable(out)
    engine = engine_for(workers)
    reading = "onset" if variant == "onset" else "equation"
    sweeps = [sweep(run, variant=reading, engine=engine) for run in genuine_runs(runs, data, engine)]
    draw_sweep(sweeps, out)
    return study_answer([sweep_table(sweeps)], files, drawn=out)


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
        from prbench_benchmarks.prime_and_reach.study.motions import draw_examples

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
@runs_arguments
@tables_option
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
    from prbench_benchmarks.prime_and_reach.study.motions import draw_moments

    scenes = _scenes(out, runs, data, sequences, limit, permission, default=3)
    draw_moments(scenes, out, title="Recorded and generated motion at the first frame, the prime and the reach")
    return _figure_answer(scenes, out)


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
    from prbench.viewing.view import ViewRequest, scenes_of

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
        """Print which sequences were drawn, what was left out, and the file."""
        for scene in scenes:
            print(f"{scene.sequence_id}: {scene.title}")
        for notice in notices:
            print(notice)
        print(f"written: {out}")

    return Answer(report, show)
