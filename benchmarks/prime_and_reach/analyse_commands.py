"""``prbench analyse KIND RUN...``: what the scores of finished runs do not say by themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from prbench.cli.commands import Answer, Session, command, session
from prbench.cli.options import OUT_FILE, PATH, data_option, permission_option, workers_option
from prbench.cli.places import PlaceType, Remote
from prbench.errors import UsageError
from prbench_benchmarks.prime_and_reach.agreement_commands import AgreementsReport, agreement
from prbench_benchmarks.prime_and_reach.diversity_commands import DiversityReport, diversity
from prbench_benchmarks.prime_and_reach.error_budget.report import ErrorBudgetReport
from prbench_benchmarks.prime_and_reach.error_budget_commands import error_budget

_KINDS = {
    "agreement": (agreement, ("data", "workers"), AgreementsReport),
    "diversity": (diversity, ("data", "fan", "sequence", "permission"), DiversityReport),
    "errors": (error_budget, ("data", "beside", "out"), ErrorBudgetReport),
}
"""The function of each kind, the options that it takes (``--out`` beside them), and its report."""


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
    report={kind: report for kind, (_, _, report) in _KINDS.items()},
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
def analyse(ctx: click.Context, kind: str, runs: tuple[Path, ...], **given: Any) -> Answer:
    """Say on which sequences methods succeed, how far their motions differ, or why they fail.

    agreement: on which sequences methods succeed: those of recorded people, and by where the goal is.

    diversity: how far several motions for one goal differ in poses, path and timing, beside recorded people; RUN is one
    run with --samples 2 or more (docs/diversity.md).

    errors: why motions fail, one cause each, and what explains the rest. Choose with it on the validation split:
    `prbench run --split validation --samples 3` (docs/error-budget.md).
    """
    make, taken, _ = _KINDS[kind]
    spelt = {option.name: option.opts[0] for option in ctx.command.params if option.name in given}
    for option, spelling in spelt.items():
        if option not in (*taken, "out") and ctx.get_parameter_source(option) is not ParameterSource.DEFAULT:
            own = sorted({"--out", *(spelt[each] for each in taken)})
            raise UsageError(f"analyse {kind} takes no {spelling}; its options: {', '.join(own)}.")
    session().command = f"analyse {kind}"
    return make(runs, **{option: given[option] for option in taken})
