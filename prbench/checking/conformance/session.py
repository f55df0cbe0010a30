"""Check one method from the outside: the findings of all checks, whatever the method does.

The checks run in a child process. When a method crashes it, or does not come to an end, the check that was under way
fails with that, and another child goes on with those that are left.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from prbench.checking.conformance.cases import cases_of_table
from prbench.checking.conformance.check import Check
from prbench.checking.conformance.checks import CHECKS
from prbench.checking.conformance.child_process import ChildProcess, Lost, TimeLimits
from prbench.checking.conformance.examine import worst_of
from prbench.checking.conformance.finding import Finding, Outcome, Report, failed, skipped
from prbench.checking.conformance.request import CheckRequest
from prbench.checking.conformance.subject import working_folder
from prbench.errors import UsageError
from prbench.methods.loaded_methods import MethodSpec
from prbench.methods.methods import method_spec
from prbench.methods.names import METHOD_CONTROLS

Announce = Callable[[str, int, int], None]
"""Called before each check with its name, its place and how many there are."""
_GRACE = 10.0  # seconds
_STARTS = ("import", "load")
_FORM = ("generates", "shapes", "dtype", "finite")  # without these there is nothing to look at
_LOST = (
    "A run would end in the same way. Look for a deadlock, a loop that does not end, os._exit, and crashes of compiled"
    " code under this input."
)
_SLOW_START = "If it is only slow, move the work into the first generate(), or raise --start-limit."


def check(request: CheckRequest, announce: Announce | None = None) -> Report:
    """Look at a method in every respect that the contract names.

    Args:
        request: The method, and what to ask it about.
        announce: Told what is looked at.

    Raises:
        AdapterError: if no such method is installed.
        InputFileError: if the TOML file does not say what it must.
        TableError: if the table cannot be read, or has no test sequences.
        UsageError: if the method is a control, or a program is not there.
    """
    started = time.perf_counter()
    spec = _possible(request)
    with working_folder() as folder:
        session = _Session(
            request, _limits(request, spec), Path(folder), announce or (lambda _name, _place, _total: None)
        )
        session.run([one for one in CHECKS if not one.fresh])
        session.run([one for one in CHECKS if one.fresh])
    places = {one.name: place for place, one in enumerate(CHECKS)}
    findings = sorted(session.findings, key=lambda finding: places[finding.check])
    return Report(request.method, tuple(findings), time.perf_counter() - started)


def _possible(request: CheckRequest) -> MethodSpec:
    """What the user got wrong is told before any process is started."""
    if request.method in METHOD_CONTROLS:
        raise UsageError(f"'{request.method}' is a control of the harness itself; there is no method to check.")
    spec = method_spec(request.method, weights=request.weights, options=request.options, isolate=request.isolate)
    if request.data is not None:
        cases_of_table(request.data)
    return spec


def _limits(request: CheckRequest, spec: MethodSpec) -> TimeLimits:
    """A program's own limits come a little earlier: they say more about what happened."""
    if spec.program is None:
        return TimeLimits(request.time_limit, request.start_limit)
    return TimeLimits(request.time_limit + _GRACE, spec.program.start_timeout + _GRACE)


class _Session:
    """All checks of one method, and what came of them so far."""

    def __init__(self, request: CheckRequest, limits: TimeLimits, folder: Path, announce: Announce) -> None:
        self.request, self.limits, self.folder, self.announce = request, limits, folder, announce
        self.findings: list[Finding] = []
        self._announced = 0
        self._lost: list[str] = []

    def run(self, checks: list[Check]) -> None:
        """Checks in one process, or in as many as are needed."""
        left = list(checks)
        while left:
            if why := self._hopeless():
                self.findings += [skipped(why).of(one.name) for one in left]
                return
            left = self._in_one_child(left)

    def _in_one_child(self, checks: list[Check]) -> list[Check]:
        """As far as one child comes; returns what is left."""
        left, under_way = list(checks), None
        known = {name: outcome.value for name, outcome in self._known().items()}
        with ChildProcess(self.request, [one.name for one in checks], known, self.folder) as child:
            try:
                for event in child.events(self.limits):
                    if event.finding is not None:
                        self.findings.append(event.finding)
                    elif event.waiting:
                        name = under_way.name if under_way is not None else "starting"
                        self.announce(f"{name}: {event.waiting}", self._announced, len(CHECKS))
                    else:
                        under_way, left = left[0], left[1:]
                        self._announced += 1
                        self.announce(under_way.name, self._announced, len(CHECKS))
            except Lost as lost:
                blamed = under_way or left.pop(0)
                self._lost.append(blamed.name)
                remedy = f"{_LOST} {_SLOW_START}" if blamed.name in _STARTS else _LOST
                self.findings.append(failed(str(lost), remedy).of(blamed.name))
        return left

    def _known(self) -> dict[str, Outcome]:
        names = {finding.check for finding in self.findings}
        return {name: worst_of(finding for finding in self.findings if finding.check == name) for name in names}

    def _hopeless(self) -> str:
        """Why nothing more can be looked at; empty if it can."""
        hopeless = [name for name in self._lost if name in (*_STARTS, *_FORM)]
        hopeless += [name for name, outcome in self._known().items() if name == "load" and outcome is Outcome.FAILED]
        return f"not looked at before '{hopeless[0]}' passes." if hopeless else ""
