"""Check one method from the outside: the findings of all checks, whatever the method does.

The checks run in a child process. When a method crashes it, or does not come to an end, the check that was under way
fails with that, and another child goes on with those that are left.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from prbench.errors import UsageError
from prbench.evaluation.conformance.cases import cases_of_table
from prbench.evaluation.conformance.check import Check
from prbench.evaluation.conformance.checks import CHECKS
from prbench.evaluation.conformance.child_process import ChildProcess, Lost
from prbench.evaluation.conformance.examine import worst_of
from prbench.evaluation.conformance.finding import Finding, Outcome, Report, failed, skipped
from prbench.evaluation.conformance.request import CheckRequest
from prbench.evaluation.conformance.subject import working_folder
from prbench.evaluation.controls import METHOD_CONTROLS
from prbench.evaluation.methods import method_spec
from prbench.evaluation.programs import is_program

Announce = Callable[[str, int, int], None]
"""Called before each check with its name, its place and how many there are."""
_GRACE = 10.0  # seconds
_FORM = ("generates", "shapes", "dtype", "finite")  # without these there is nothing to look at
_LOST = (
    "A run would end in the same way. Look for a deadlock, a loop that does not end, os._exit, and crashes of compiled"
    " code under this input."
)


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
    _require_possible(request)
    with working_folder() as folder:
        session = _Session(request, Path(folder), announce or (lambda _name, _place, _total: None))
        session.run([one for one in CHECKS if not one.fresh])
        session.run([one for one in CHECKS if one.fresh])
    places = {one.name: place for place, one in enumerate(CHECKS)}
    findings = sorted(session.findings, key=lambda finding: places[finding.check])
    return Report(request.method, tuple(findings), time.perf_counter() - started)


def _require_possible(request: CheckRequest) -> None:
    """What the user got wrong, before any process is started."""
    if request.method in METHOD_CONTROLS:
        raise UsageError(f"'{request.method}' is a control of the harness itself; there is no method to check.")
    method_spec(request.method, weights=request.weights, options=request.options, isolate=request.isolate)
    if request.data is not None:
        cases_of_table(request.data)


class _Session:
    """All checks of one method, and what came of them so far."""

    def __init__(self, request: CheckRequest, folder: Path, announce: Announce) -> None:
        self.request, self.folder, self.announce = request, folder, announce
        self.findings: list[Finding] = []
        self._announced = 0

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
                for event in child.events(self._time_limit()):
                    if event.finding is not None:
                        self.findings.append(event.finding)
                    else:
                        under_way, left = left[0], left[1:]
                        self._announced += 1
                        self.announce(under_way.name, self._announced, len(CHECKS))
            except Lost as lost:
                blamed = under_way or left.pop(0)
                self.findings.append(failed(str(lost), _LOST).of(blamed.name))
        return left

    def _time_limit(self) -> float:
        """A program gets a little less: its own time limit says more about what happened."""
        of_program = self.request.isolate or is_program(self.request.method)
        return self.request.time_limit + (_GRACE if of_program else 0.0)

    def _known(self) -> dict[str, Outcome]:
        names = {finding.check for finding in self.findings}
        return {name: worst_of(finding for finding in self.findings if finding.check == name) for name in names}

    def _hopeless(self) -> str:
        """Why nothing more can be looked at; empty if it can."""
        for finding in self.findings:
            if finding.remedy == _LOST and finding.check in ("import", "load", *_FORM):
                return f"not looked at before '{finding.check}' passes."
        return ""
