"""``prbench adapters check``: does a method keep the contract, and what has to be changed if not."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_method_settings, command, positive
from prbench.cli.progress import progress
from prbench.shown import clean

if TYPE_CHECKING:
    from prbench.checking.conformance import Finding, Report

_COLOURS = {"passed": "green", "warning": "yellow", "failed": "bold red", "skipped": "dim"}
_FAILED = 5  # as for every other breach of the adapter contract


def add_parser(group: argparse._SubParsersAction) -> None:
    """Register the command under ``prbench adapters``."""
    parser = command(
        group,
        "check",
        summary="check that a method keeps the contract, and say what to change where it does not",
        example="prbench adapters check static",
        execute=_check,
    )
    parser.add_argument("method", metavar="METHOD", help="an installed method, cmd:'python glide.py', or a .toml file")
    parser.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        help="ask about 12 test sequences of this dataset (default: invented people)",
    )
    add_method_settings(parser)
    parser.add_argument(
        "--time-limit", type=positive, default=600, metavar="SECONDS", help="for each call of the method (default 600)"
    )
    parser.add_argument(
        "--start-limit",
        type=positive,
        default=120,
        metavar="SECONDS",
        help="for importing an installed method, and for loading it (default 120)",
    )
    parser.add_argument("--isolate", action="store_true", help="run an installed method in a process of its own")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the findings there, too")


def _check(arguments: argparse.Namespace) -> int:
    from prbench.checking.conformance import CheckRequest, check
    from prbench.locks import sole_writer
    from prbench.storage import write_json

    request = CheckRequest(
        arguments.method,
        weights=arguments.weights,
        options=dict(arguments.option),
        device=arguments.device,
        threads=arguments.threads,
        isolate=arguments.isolate,
        data=arguments.data,
        time_limit=float(arguments.time_limit),
        start_limit=float(arguments.start_limit),
    )
    with progress(f"checking {arguments.method}") as show:
        report = check(request, lambda name, place, total: show(place, total, name))
    if arguments.json is not None:
        with sole_writer(arguments.json):
            write_json(arguments.json, report.as_json())
    print_report(report)
    return _FAILED if report.failed else 0


def print_report(report: Report) -> None:
    """A table on a terminal, plain lines elsewhere."""
    if sys.stdout.isatty():
        _print_table(report)
    else:
        for finding in _shown(report):
            print(f"{finding.outcome.value:<8} {finding.check:<16} {_sentences(finding)}")
    if waiting := _waiting(report):
        print("\n".join(waiting))
    print(_summary(report))


def _print_table(report: Report) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from prbench.cli.terminal import console

    table = Table("check", "", "what was found, and what to change", box=box.SIMPLE, pad_edge=False)
    for finding in _shown(report):
        outcome = finding.outcome.value
        table.add_row(finding.check, Text(outcome, _COLOURS[outcome]), clean(_sentences(finding), keep="\n"))
    console().print(table)


def _shown(report: Report) -> list[Finding]:
    """Select the findings that have a line of their own: all but the checks that wait for another one."""
    return [finding for finding in report.findings if not _waits(finding)]


def _waits(finding: Finding) -> bool:
    return finding.outcome.value == "skipped" and " before " in finding.said


def _waiting(report: Report) -> list[str]:
    """Write one line for all checks that wait for the same one."""
    by_reason: dict[str, list[str]] = {}
    for finding in filter(_waits, report.findings):
        by_reason.setdefault(finding.said, []).append(finding.check)
    return [f"skipped  {reason} {len(names)}: {', '.join(names)}." for reason, names in by_reason.items()]


def _sentences(finding: Finding) -> str:
    """Join what was found and what to change; behind a log the latter has a line of its own."""
    between = "\n    " if "\n" in finding.said else " "
    return f"{finding.said}{between}{finding.remedy}".strip()


def _summary(report: Report) -> str:
    from prbench.checking.conformance import Outcome

    counts = ", ".join(f"{len(report.of(outcome))} {outcome.value}" for outcome in Outcome)
    verdict = "does not keep the contract" if report.failed else "keeps the contract"
    return f"{report.method} {verdict}: {counts}; {report.seconds:.1f} s."
