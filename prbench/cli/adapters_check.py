"""``prbench adapters check``: does a method keep the contract, and what has to be changed if not."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import command, key_value, positive
from prbench.cli.progress import progress

if TYPE_CHECKING:
    from prbench.evaluation.conformance import Finding, Report

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
    parser.add_argument("--weights", type=Path, metavar="NAME|FILE", help="the method's weights")
    parser.add_argument(
        "--option", type=key_value, action="append", default=[], metavar="KEY=VALUE", help="for the method; repeatable"
    )
    parser.add_argument("--device", default="cpu", help="cpu (default), cuda, cuda:1 …")
    parser.add_argument("--threads", type=positive, default=1, metavar="N", help="threads (default 1)")
    parser.add_argument(
        "--time-limit", type=positive, default=600, metavar="SECONDS", help="for each call of the method (default 600)"
    )
    parser.add_argument("--isolate", action="store_true", help="run an installed method in a process of its own")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the findings there, too")


def _check(arguments: argparse.Namespace) -> int:
    from prbench.evaluation.conformance import CheckRequest, check
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
    )
    with progress(f"checking {arguments.method}") as show:
        report = check(request, lambda name, place, total: show(place, total, name))
    if arguments.json is not None:
        write_json(arguments.json, report.as_json())
    print_report(report)
    return _FAILED if report.failed else 0


def print_report(report: Report) -> None:
    """A table on a terminal, plain lines elsewhere."""
    if sys.stdout.isatty():
        _print_table(report)
    else:
        for finding in report.findings:
            print(f"{finding.outcome.value:<8} {finding.check:<16} {_sentences(finding)}")
    print(_summary(report))


def _print_table(report: Report) -> None:
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table("check", "", "what was found, and what to change", box=box.SIMPLE, pad_edge=False)
    for finding in report.findings:
        outcome = finding.outcome.value
        table.add_row(finding.check, f"[{_COLOURS[outcome]}]{outcome}[/]", escape(_sentences(finding)))
    Console().print(table)


def _sentences(finding: Finding) -> str:
    return f"{finding.said} {finding.remedy}".strip()


def _summary(report: Report) -> str:
    from prbench.evaluation.conformance import Outcome

    counts = ", ".join(f"{len(report.of(outcome))} {outcome.value}" for outcome in Outcome)
    verdict = "does not keep the contract" if report.failed else "keeps the contract"
    return f"{report.method} {verdict}: {counts}; {report.seconds:.1f} s."
