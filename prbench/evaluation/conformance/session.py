"""Check one method from the outside: the findings of all checks, whatever the method does."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from prbench.evaluation.conformance.cases import cases_of_table, invented_cases
from prbench.evaluation.conformance.check import Check
from prbench.evaluation.conformance.checks import CHECKS
from prbench.evaluation.conformance.examine import examine
from prbench.evaluation.conformance.finding import Report
from prbench.evaluation.conformance.subject import Subject, working_folder
from prbench.evaluation.methods import method_spec

Announce = Callable[[Check, int, int], None]
"""Called before each check with its place and how many there are."""


@dataclass(frozen=True)
class CheckRequest:
    """What to check."""

    method: str
    """Installed name, ``cmd:`` and a command, or a TOML file."""
    weights: Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    device: str = "cpu"
    threads: int = 1
    isolate: bool = False
    data: Path | None = None
    """A dataset whose test sequences are asked about; None for invented people."""


def check(request: CheckRequest, announce: Announce | None = None) -> Report:
    """Look at a method in every respect that the contract names.

    Raises:
        AdapterError: if no such method is installed.
        TableError: if the table cannot be read.
    """
    started = time.perf_counter()
    spec = method_spec(
        request.method,
        weights=request.weights,
        options=request.options,
        device=request.device,
        threads=request.threads,
        isolate=request.isolate,
    )
    cases = invented_cases() if request.data is None else cases_of_table(request.data)
    with working_folder() as folder:
        subject = Subject(spec, cases, Path(folder))
        findings = tuple(examine(subject, CHECKS, announce=_counted(announce)))
    return Report(request.method, findings, time.perf_counter() - started)


def _counted(announce: Announce | None) -> Callable[[Check], None] | None:
    if announce is None:
        return None
    places = {one.name: place for place, one in enumerate(CHECKS)}
    return lambda one: announce(one, places[one.name], len(CHECKS))
