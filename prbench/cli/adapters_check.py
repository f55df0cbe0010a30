"""``prbench adapters check``: does a method keep the contract, and what has to be changed if not."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli.commands import Answer, command
from prbench.cli.options import PATH, SECONDS, benchmark_option, method_settings
from prbench.cli.progress import progress
from prbench.protocol.benchmarks import default_benchmark
from prbench.shown import clean

if TYPE_CHECKING:
    from prbench.checking.conformance import Report

_COLOURS = {"passed": "green", "skipped": "dim", "warning": "yellow", "failed": "bold red"}
"""Colour of each outcome, from good to bad."""
_FAILED = 5  # as for every other breach of the adapter contract


@command(
    "check",
    example="prbench adapters check static",
    report="prbench.checking.conformance.report:Report",
    writes_report=True,
)
@click.argument("method")
@benchmark_option
@click.option(
    "--data",
    type=PATH,
    metavar="DIR",
    help="Ask about 12 test cases of this table (default: synthetic people).",
)
@method_settings
@click.option(
    "--timeout",
    type=SECONDS,
    default=600,
    metavar="SECONDS",
    help="Time limit of each call of the method (default 600).",
)
@click.option(
    "--start-timeout",
    type=SECONDS,
    default=120,
    metavar="SECONDS",
    help="Time limit of importing an installed method, and of loading it (default 120).",
)
@click.option("--isolate", is_flag=True, help="Run an installed method in a process of its own.")
def check(
    method: str,
    benchmark: str | None,
    data: Path | None,
    weights: Path | None,
    options: tuple[tuple[str, str], ...],
    device: str,
    threads: int,
    timeout: float,
    start_timeout: float,
    isolate: bool,
) -> Answer:
    """Check that a method keeps the contract, and say what to change where it does not.

    METHOD is an installed method, cmd:'python glide.py', or a .toml file that describes a program.
    """
    from prbench.checking import conformance

    request = conformance.CheckRequest(
        method,
        benchmark=benchmark or default_benchmark().name,
        weights=weights,
        options=dict(options),
        device=device,
        threads=threads,
        isolate=isolate,
        data=data,
        time_limit=timeout,
        start_limit=start_timeout,
    )
    with progress(f"checking {method}") as show:
        found = conformance.check(request, lambda name, place, total: show(place, total, name))
    return Answer(found, lambda: print_report(found), _FAILED if found.failed else 0)


def print_report(report: Report) -> None:
    """Print a table on a terminal, plain lines elsewhere; one line for all checks that wait for the same one."""
    shown = []
    waiting: dict[str, list[str]] = {}
    for finding in report.findings:
        if finding.outcome.value == "skipped" and " before " in finding.said:
            waiting.setdefault(finding.said, []).append(finding.check)
            continue
        # Behind a log the remedy has a line of its own.
        between = "\n    " if "\n" in finding.said else " "
        shown.append((finding.check, finding.outcome.value, f"{finding.said}{between}{finding.remedy}".strip()))
    if sys.stdout.isatty():
        _print_table(shown)
    else:
        for check_name, outcome, sentences in shown:
            print(f"{outcome:<8} {check_name:<16} {sentences}")
    for reason, names in waiting.items():
        print(f"skipped  {reason} {len(names)}: {', '.join(names)}.")
    counts = ", ".join(
        f"{sum(finding.outcome == outcome for finding in report.findings)} {outcome}" for outcome in _COLOURS
    )
    verdict = "does not keep the contract" if report.failed else "keeps the contract"
    print(f"{report.method} {verdict}: {counts}; {report.seconds:.1f} s.")


def _print_table(shown: list[tuple[str, str, str]]) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from prbench.cli.terminal import console

    table = Table("check", "", "what was found, and what to change", box=box.SIMPLE, pad_edge=False)
    for check_name, outcome, sentences in shown:
        table.add_row(check_name, Text(outcome, _COLOURS[outcome]), clean(sentences, keep="\n"))
    console().print(table)
