"""``prbench run``: a method over tables, scored."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import (
    CONDITIONS,
    FIRST_RUN_SEQUENCES,
    add_data,
    add_limit,
    add_method_settings,
    add_permission,
    add_split,
    add_workers,
    command,
    positive,
)
from prbench.cli.progress import progress
from prbench.cli.summaries import print_sequence_scores, print_side_by_side, print_summary
from prbench.cli.table_two import run_and_print, wants_table

if TYPE_CHECKING:
    from prbench.engine import Engine
    from prbench.evaluation.request import RunRequest
    from prbench.evaluation.run import RunReport

_FIRST_RUN_WORKERS = 2
_TABLE_WORKERS = 2


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "run",
        summary="run a method over tables and score what it generates",
        example="prbench run --method static --condition none --data tables/adt --out runs/static",
        execute=_run,
        resumes=True,
    )
    parser.add_argument(
        "--method",
        required=True,
        metavar="NAME|cmd:…|FILE",
        help="an installed method; a program: 'cmd:python glide.py', or a .toml file that describes one; or a control:"
        " ground-truth, ground-truth-resampled, scripted; all: the rows of the study's Table 2",
    )
    parser.add_argument(
        "--condition",
        choices=[*CONDITIONS, "all"],
        help="what the method is given (default: none; all for --method all); all: every row that Table 2 has of it",
    )
    add_data(parser, required=False, help="built dataset folder(s); without it a synthetic one is built and used")
    parser.add_argument("--out", type=Path, metavar="DIR", help="run folder (default: one under ./runs); resumes")
    add_split(parser)
    add_limit(parser, default=f"all; {FIRST_RUN_SEQUENCES} without --data; with all: what fits into --minutes")
    parser.add_argument(
        "--minutes",
        type=positive,
        metavar="N",
        help="with all: run as many sequences of each dataset as fit into this time (default 30), unless --limit says",
    )
    parser.add_argument(
        "--sequence",
        action="append",
        default=[],
        metavar="ID",
        help="run this one only; the id, or a beginning, end or part that fits one only; repeatable",
    )
    parser.add_argument("--view", type=Path, metavar="FILE", help="show the motions as .png, .mp4 or .html")
    add_permission(parser)
    add_method_settings(parser)
    parser.add_argument("--control", choices=["shuffled-goal"], help="give every sequence another one's goal")
    parser.add_argument("--seed", type=int, default=0, help="of the run (default 0)")
    parser.add_argument("--samples", type=positive, default=1, metavar="N", help="motions a sequence (default 1)")
    parser.add_argument(
        "--batch-size",
        type=positive,
        metavar="N",
        help="sequences a batch (default 64; with all: up to 16, so that two workers have as many)",
    )
    parser.add_argument(
        "--isolate",
        action="store_true",
        help="run the method in a process that is given neither paths, objects nor environment; with bubblewrap (Linux)"
        " the file system is withheld too",
    )
    parser.add_argument(
        "--timeout",
        type=float,
        metavar="SECONDS",
        help="for each batch, of a program or with --isolate (default 600); a program that is late is stopped",
    )
    add_workers(parser)
    parser.set_defaults(workers=None, runs_a_method=True)


def _run(arguments: argparse.Namespace) -> int:
    from prbench.engine import engine_for

    if wants_table(arguments):
        engine = engine_for(arguments.workers or _TABLE_WORKERS)
        return run_and_print(arguments, tuple(arguments.data or ()) or (_embedded_table(engine),), engine)
    _require_no_minutes(arguments)
    _tell_claims(arguments.method)
    if arguments.view is not None:
        from prbench.viewing.replay.write import file_kind

        file_kind(arguments.view)  # what would fail after the run fails before it
    first_run = not arguments.data
    engine = engine_for(arguments.workers or (_FIRST_RUN_WORKERS if first_run else 1))
    data = (_embedded_table(engine),) if first_run else tuple(arguments.data)
    request = _request(arguments, data)
    report = _generated(request, engine)
    if arguments.sequence:
        print_sequence_scores(report.folder)
    else:
        for summary in report.summaries:
            method = report.folder.record.method
            print_summary(summary, origin=method.origin, motionless=method.motionless)
    if first_run:
        _in_company(request, report, engine)
        if request.limit is not None:
            _tell_limit(request)
    print(f"run folder: {report.folder.path}")
    if arguments.view is not None:
        _view(arguments, report.folder.path, data)
    elif first_run:
        print(f"look at it: prbench view {report.folder.path} --out motions.png   (or .mp4, .html)")
    return 0


def _require_no_minutes(arguments: argparse.Namespace) -> None:
    from prbench.errors import UsageError

    if arguments.minutes is not None:
        raise UsageError("--minutes: belongs to --method all or --condition all; --limit N chooses N sequences.")


def _tell_claims(method: str) -> None:
    """Name the packages that offer a method under a name that belongs to prbench; theirs is never run."""
    from prbench.methods.installed import list_adapters

    for adapter in list_adapters():
        if adapter.name == method and adapter.problem:
            print(f"note: {adapter.package} {adapter.version} is not used: {adapter.problem}.", file=sys.stderr)


def _generated(request: RunRequest, engine: Engine) -> RunReport:
    from prbench.evaluation.run import run_method

    if request.isolate:
        _tell_isolation(request.method)
    with progress(f"running {request.method_label}") as show:
        report = run_method(
            request,
            engine=engine,
            progress=lambda step: show(step.done, step.total, f"{step.stage} {step.dataset}"),
        )
    if report.batches_found:
        print(f"{report.batches_found} batches were taken over from an earlier run.", file=sys.stderr)
    _tell_crashes(report)
    return report


def _tell_crashes(report: RunReport) -> None:
    """Tell how often a program crashed, which its motions do not show."""
    from prbench.runs.cost import RunCost

    for table in report.folder.record.tables:
        cost = report.folder.dataset(table.dataset).cost
        crashes = sum(RunCost.read(cost).restarts.values())
        if crashes:
            times = "once" if crashes == 1 else f"{crashes} times"
            print(f"its program crashed {times} and was started again: {cost}, restarts.", file=sys.stderr)


def _tell_isolation(method: str) -> None:
    from prbench.methods.isolation import available_fence
    from prbench.methods.programs import runs_in_container

    in_container = "isolated in its container, which shows what its TOML file mounts; tables in there are covered."
    print(in_container if runs_in_container(method) else available_fence().notice, file=sys.stderr)


def _in_company(request: RunRequest, report: RunReport, engine: Engine) -> None:
    """Show a first run beside the methods that tell what its scores are worth."""
    from prbench.workflows.first_run import companions

    reports = [report, *(_generated(companion, engine) for companion in companions(request))]
    if len(reports) > 1:
        still = {shown.folder.record.method.name for shown in reports if shown.folder.record.method.motionless}
        print_side_by_side(
            [shown.summaries[0] for shown in reports],
            origins=[shown.folder.record.method.origin for shown in reports],
            motionless=frozenset(still),
        )


def _view(arguments: argparse.Namespace, run: Path, data: tuple[Path, ...]) -> None:
    from prbench.workflows.view import ViewRequest, view

    request = ViewRequest(
        out=arguments.view,
        runs=(run,),
        data=data,
        sequences=tuple(arguments.sequence),
        permitted=tuple(arguments.permission),
    )
    with progress(f"drawing {arguments.view.name}") as show:
        report = view(request, show)
    for notice in report.notices:
        print(notice)
    print(f"view: {report.out}")


def _request(arguments: argparse.Namespace, data: tuple[Path, ...]) -> RunRequest:
    from prbench.contract import Condition
    from prbench.evaluation.request import DEFAULT_BATCH_SIZE, RunRequest
    from prbench.workflows import first_run

    limit = arguments.limit
    batch_size = arguments.batch_size or DEFAULT_BATCH_SIZE
    if not arguments.data and not arguments.sequence:
        limit = limit or first_run.SEQUENCES
        batch_size = arguments.batch_size or first_run.BATCH_SIZE
    return RunRequest(
        method=arguments.method,
        data=data,
        condition=Condition(arguments.condition or Condition.NONE),
        weights=arguments.weights,
        options=dict(arguments.option),
        split=arguments.split,
        limit=limit,
        sequences=tuple(arguments.sequence),
        seed=arguments.seed,
        samples=arguments.samples,
        batch_size=batch_size,
        device=arguments.device,
        threads=arguments.threads,
        control=arguments.control,
        out=arguments.out,
        isolate=arguments.isolate,
        timeout=arguments.timeout,
    )


def _embedded_table(engine: Engine) -> Path:
    """Return the folder of the embedded synthetic dataset, which is built on the first call."""
    from prbench.workflows.first_run import RECORDINGS, default_table, default_table_folder

    folder = default_table_folder()
    if (folder / "dataset.json").is_file():
        print(f"no --data given: using the embedded synthetic dataset in {folder}", file=sys.stderr)
    else:
        print(
            f"no --data given: building a synthetic dataset of {RECORDINGS} recordings in {folder} (once)",
            file=sys.stderr,
        )
    with progress("building synthetic data") as show:
        return default_table(engine, show, tell=lambda line: print(line, file=sys.stderr)).folder


def _tell_limit(request: RunRequest) -> None:
    """Tell which of the embedded sequences were run, and how a method that runs elsewhere gets the same ones."""
    print(
        f"these are {request.limit} of its sequences (--limit N takes another number); for the same ones elsewhere:"
        f" prbench export-conditions --data {request.data[0]} --limit {request.limit} …",
        file=sys.stderr,
    )
