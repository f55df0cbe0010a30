"""``prbench analyse KIND RUN...``: what the scores of finished runs do not say by themselves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec
from click.core import ParameterSource

from prbench.cli.commands import Answer, Session, command, progress
from prbench.cli.options import OUT_FILE, PATH, data_option, permission_option, run_checker, workers_option
from prbench.cli.places import PlaceType, Remote
from prbench.cli.terminal import print_tables
from prbench.errors import UsageError

if TYPE_CHECKING:  # help is quick: tables load NumPy
    from prbench.tables import Table


Paths = tuple[Path, ...]


class AnalysisReport(msgspec.Struct, frozen=True, kw_only=True):
    """What was found out.

    Attributes:
        tables: The tables, those of one run one behind the other.
        fan: The picture of diversity; null if none was asked for.
        fan_sequence: Id of the sequence in that picture; null if none was asked for.
        out: Folder with one row a motion (``motions.parquet``, ``motions.csv``), which ``errors`` writes; null without
            ``--out``.
    """

    tables: list[Table]
    fan: Path | None = None
    fan_sequence: str | None = None
    out: Path | None = None


def _answer(report: AnalysisReport, *lines: str) -> Answer:
    def show() -> None:
        print_tables(report.tables)
        for line in lines:
            print(line)

    return Answer(report, show)


def _agreement(runs: Paths, *, data: Paths, workers: int) -> Answer:
    from prbench_benchmarks.prime_and_reach.agreement import agreement_tables

    return _answer(AnalysisReport(tables=agreement_tables(runs, run_checker(data, workers))))


def _diversity(
    runs: Paths, *, data: Paths, fan: Path | None, sequence: str | None, permission: tuple[str, ...]
) -> Answer:
    from prbench.viewing.fan import draw_fan
    from prbench.viewing.figures import require_drawable
    from prbench_benchmarks.prime_and_reach.diversity import measure_diversity, read_fan

    if len(runs) != 1:
        raise UsageError("analyse diversity: name one RUN.")
    if fan is None and sequence is not None:
        raise UsageError("--sequence: belongs to --fan FILE, which it is drawn in.")
    if fan is not None:
        require_drawable(fan)
    drawn = None if fan is None else read_fan(runs[0], data, sequence=sequence, permitted=permission)
    with progress("measuring") as show:
        tables = measure_diversity(runs[0], data, progress=show)
    if fan is None or drawn is None:
        return _answer(AnalysisReport(tables=tables))
    draw_fan(drawn, fan)
    lines = [*([drawn.notice] if drawn.notice else []), f"fan: {fan} ({drawn.sequence_id})"]
    return _answer(AnalysisReport(tables=tables, fan=fan, fan_sequence=drawn.sequence_id), *lines)


def _errors(runs: Paths, *, beside: Path | None, data: Paths, out: Path | None) -> Answer:
    from prbench.harness.first_run import table_finder
    from prbench_benchmarks.prime_and_reach.error_budget.budget import error_budgets

    with progress("diagnosing") as show:
        tables = error_budgets(runs, beside=beside, find_table=table_finder(data), out=out, progress=show)
    lines = [] if out is None else [f"one row a motion: {out / 'motions.csv'}"]
    return _answer(AnalysisReport(tables=tables, out=out), *lines)


# The function of each kind, and the options that it takes (``--out`` beside them).
_KINDS = {
    "agreement": (_agreement, ("data", "workers")),
    "diversity": (_diversity, ("data", "fan", "sequence", "permission")),
    "errors": (_errors, ("data", "beside", "out")),
}


def _report_file(ctx: click.Context, _: click.Parameter, value: Path | Remote | None) -> Path | Remote | None:
    """Take ``--out`` for the report as JSON, unless the kind writes a folder of its own."""
    if value is None or ctx.params.get("kind") == "errors":
        return value
    if isinstance(value, Path) and value.is_dir():
        raise click.BadParameter(f"File '{value}' is a directory.")
    ctx.ensure_object(Session).report_file = value
    return None


@command(
    "analyse",
    section="board",
    example="prbench analyse errors runs/pr --beside runs/pr-off --data tables/adt --out budget",
    report=AnalysisReport,
)
@click.argument("kind", type=click.Choice(list(_KINDS)), metavar="KIND", is_eager=True)
@click.argument("runs", type=PATH, nargs=-1, required=True, metavar="RUN...")
@data_option(required=False, help="Tables of the runs, on which their scores are checked; the embedded ones are known.")
@click.option(
    "--fan",
    type=OUT_FILE,
    metavar="FILE",
    help="Of diversity: draw the motions of one sequence as a fan of bodies: .png, .svg.",
)
@click.option(
    "--sequence", metavar="ID", help="The sequence to draw: its id, or a part that fits one only (default: any)."
)
@permission_option
@click.option(
    "--beside",
    type=PATH,
    metavar="RUN",
    help="Of errors: a run of the same sequences by other options, such as one without optimisation: which it gains"
    " and loses.",
)
@click.option(
    "--out",
    type=PlaceType("folder"),
    metavar="PATH",
    callback=_report_file,
    help="Write the report as JSON to this file, too; of errors, one row a motion into this folder: motions.parquet and"
    " motions.csv.",
)
@workers_option()
@click.pass_context
def analyse(ctx: click.Context, kind: str, runs: Paths, **given: Any) -> Answer:
    """Say on which sequences methods succeed, how far their motions differ, or why they fail.

    agreement: on which sequences methods succeed: those of recorded people, and by where the goal is.

    diversity: how far several motions for one goal differ in poses, path and timing, beside recorded people; RUN is one
    run with --samples 2 or more (docs/diversity.md).

    errors: why motions fail, one cause each, and what explains the rest. Choose with it on the validation split:
    `prbench run --split validation --samples 3` (docs/error-budget.md).
    """
    make, taken = _KINDS[kind]
    spelt = {option.name: option.opts[0] for option in ctx.command.params if option.name in given}
    for option, spelling in spelt.items():
        if option not in (*taken, "out") and ctx.get_parameter_source(option) is not ParameterSource.DEFAULT:
            own = sorted({"--out", *(spelt[each] for each in taken)})
            raise UsageError(f"analyse {kind} takes no {spelling}; its options: {', '.join(own)}.")
    return make(runs, **{option: given[option] for option in taken})
