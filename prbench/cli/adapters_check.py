"""``prbench adapters check``: does a method keep the contract, and what has to be changed if not."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import PATH, SECONDS, benchmark_option, method_settings
from prbench.cli.progress import progress
from prbench.protocol.benchmarks import default_benchmark
from prbench.shown import clean

if TYPE_CHECKING:
    from prbench.checking.conformance import Finding, Report

_COLOURS = {"passed": "green", "warning": "yellow", "failed": "bold red", "skipped": "dim"}
_FAILED = 5  # as for every other breach of the adapter contract


class CheckFinding(msgspec.Struct, frozen=True, kw_only=True):
    """One sentence about a method, and what its author can do about it.

    Attributes:
        check: Name of the check (docs/conformance.md lists them); one check may find several things.
        outcome: ``passed``, ``skipped``, ``warning`` or ``failed``.
        said: The observation with its numbers; for a skipped check, the reason.
        remedy: The change to make; empty where there is none.
        numbers: Maps names that end in their unit to measured numbers.
    """

    check: str
    outcome: str
    said: str
    remedy: str
    numbers: dict[str, float | None]


class CheckReport(msgspec.Struct, frozen=True, kw_only=True):
    """All findings about one method.

    Attributes:
        method: What was checked, as it was named.
        seconds: How long the checks took.
        counts: Number of findings of each outcome.
        findings: The findings in the order of the checks. The exit code is 5 if one failed.
    """

    method: str
    seconds: float
    counts: dict[str, int]
    findings: list[CheckFinding]


@command("check", example="prbench adapters check static", report=CheckReport, writes_report=True)
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
    report = msgspec.convert(found.as_json(), CheckReport)
    return Answer(report, lambda: print_report(found), _FAILED if found.failed else 0)


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
