"""Check one method from the outside: the findings of all checks, whatever the method does.

The checks run in a child process, ``python -m prbench.checking.conformance``, which gets one order in JSON on stdin and
tells events on stdout. When a method crashes it, or does not come to an end, the check that was under way fails with
that, and another child goes on with those that are left.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import psutil

from prbench.checking.conformance.cases import cases_of_table, kept_synthetic_cases
from prbench.checking.conformance.checks import CHECKS
from prbench.checking.conformance.findings import (
    FORM,
    Check,
    CheckRequest,
    Finding,
    Outcome,
    Report,
    examine,
    failed,
    skipped,
    worst_of,
)
from prbench.checking.conformance.subject import MethodSubject, Subject, working_folder
from prbench.errors import UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.installed import METHOD_CONTROLS
from prbench.harness.methods.loading import MethodSpec, forget_loaded_methods, method_spec
from prbench.harness.methods.process import exit_story, python_words, users_environment
from prbench.harness.methods.programs import is_program
from prbench.protocol.manifests import benchmarks, find_benchmark


@dataclass(frozen=True)
class Judge:
    """The checks of one benchmark."""

    checks: tuple[Check, ...]
    subject: Callable[[MethodSpec, CheckRequest, Path], MethodSubject]
    """Makes the method under examination: how to make it, the request, the folder of the check."""
    require_table: Callable[[Path], object]
    """Refuses a folder that holds no cases."""


def _motions(spec: MethodSpec, request: CheckRequest, folder: Path) -> Subject:
    cases = kept_synthetic_cases(folder) if request.data is None else cases_of_table(request.data)
    return Subject(spec, cases, folder)


def judge_of(benchmark: str) -> Judge:
    """Return the checks of a benchmark's methods.

    Raises:
        UsageError: for a benchmark whose methods cannot be checked.
    """
    about = find_benchmark(benchmark)
    if about.default:
        return Judge(CHECKS, _motions, cases_of_table)
    if not about.checks:
        known = ", ".join(each.name for each in benchmarks().values() if each.default or each.checks)
        raise UsageError(f"--benchmark {benchmark}: its methods cannot be checked; expected one of {known}.")
    module, _, attribute = about.checks.partition(":")
    return getattr(importlib.import_module(module), attribute)()


Tell = Callable[..., None]


def run_ordered() -> None:
    """Run the checks that are ordered on stdin and tell what they find; what the method prints goes to stderr."""
    order = json.loads(sys.stdin.readline())
    tell = _teller()
    request = CheckRequest.of_json(order["request"])
    folder = Path(order["folder"])
    spec = method_spec(
        request.method,
        weights=request.weights,
        options=request.options,
        device=request.device,
        threads=request.threads,
        isolate=request.isolate,
        timeout=request.time_limit if request.isolate or is_program(request.method) else None,
        hidden=() if request.data is None else (request.data,),
        group=load_benchmark(request.benchmark).methods,
    )
    subject = judge_of(request.benchmark).subject(spec, request, folder)
    subject.asking = lambda text: tell(event="asking", text=text)
    subject.starting = lambda text: tell(event="starting", text=text)
    known = {name: Outcome(value) for name, value in order["known"].items()}
    checks = [one for one in judge_of(request.benchmark).checks if one.name in order["checks"]]
    for finding in examine(subject, checks, known=known, announce=lambda one: tell(event="check", name=one.name)):
        tell(event="finding", finding=asdict(finding))
    forget_loaded_methods()
    tell(event="end")
    os._exit(0)  # a method's threads that do not end would keep the process


def _teller() -> Tell:
    """Writes events to what was stdout; from now on ``print`` writes to stderr."""
    # A method that prints must not break the events, which share the pipe with nobody.
    events = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def tell(**event: object) -> None:
        events.write(json.dumps(event) + "\n")
        events.flush()

    return tell


_MODULE = "prbench.checking.conformance"
_SHOWN_LINES = 5
_OTHERWISE = 120.0
_HEARTBEAT = 10.0  # seconds between words about the same work
_Announce = Callable[[str, int, int], None]
"""Called before each check with its name, its place and how many there are."""
_GRACE = 10.0  # seconds
_STARTS = ("import", "load")
_LOST = (
    "A run would end in the same way. Look for a deadlock, a loop that does not end, os._exit, and crashes of compiled"
    " code under this input."
)
_SLOW_START = "If it is only slow, move the work into the first generate(), or raise --start-timeout."


class _Lost(Exception):
    """The child crashed, or the method did not come to an end; the text says so."""


@dataclass(frozen=True)
class _Event:
    """A finding, a message about work that takes long, or the beginning of the next check."""

    finding: Finding | None = None
    waiting: str = ""


@dataclass(frozen=True)
class _TimeLimits:
    """Seconds."""

    call: float
    """For each call of the method."""
    start: float
    """For importing it, and for loading it."""

    def of(self, event: str) -> float:
        """Return the limit after an event of the child; the harness's own work has two minutes or more."""
        if event == "starting":
            return self.start
        return self.call if event == "asking" else max(self.call, _OTHERWISE)


class _ChildProcess:
    """Runs some checks in a process of its own, which may crash or hang."""

    def __init__(self, request: CheckRequest, checks: list[str], known: Mapping[str, str], folder: Path) -> None:
        self._doing = ""
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed in __exit__
        self._process = subprocess.Popen(
            python_words(_MODULE),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env=users_environment(),
        )
        order = {"request": request.as_json(), "checks": checks, "known": dict(known), "folder": str(folder)}
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
            self._process.stdin.close()
        except BrokenPipeError:
            pass  # it is gone already; events() says how it ended
        self._lines: queue.Queue[bytes] = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def __enter__(self) -> _ChildProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """End it with all that it started."""
        if self._process.poll() is None:
            for process in [*_descendants(self._process.pid), psutil.Process(self._process.pid)]:
                with contextlib.suppress(psutil.Error):
                    process.kill()
        self._process.wait()
        self._log.close()

    def events(self, limits: _TimeLimits) -> Iterator[_Event]:
        """Yield what the child does, until it has done everything.

        Raises:
            Lost: if it crashed, or the method took longer.
        """
        limit = limits.of("")
        while True:
            began = time.monotonic()
            while (line := self._next(min(_HEARTBEAT, limit - (time.monotonic() - began)))) is None:
                waited = time.monotonic() - began
                if waited >= limit:
                    raise _Lost(f"no end after {limit:g} s{self._story()}")
                yield _Event(waiting=f"{self._doing or 'while at work'}, {waited:.0f} s so far".removeprefix("while "))
            if not line:
                raise _Lost(f"the process of the method {exit_story(self._process.wait())}{self._story()}")
            message = json.loads(line)
            if message["event"] == "end":
                return
            self._doing = message.get("text", "")
            limit = limits.of(message["event"])
            if message["event"] == "check":
                yield _Event()
            elif message["event"] == "finding":
                found = message["finding"]
                yield _Event(Finding(**(found | {"outcome": Outcome(found["outcome"])})))

    def _next(self, patience: float) -> bytes | None:
        """Return the next line, empty at the end, or None if none comes in time."""
        try:
            return self._lines.get(timeout=max(patience, 0.01))
        except queue.Empty:
            return None

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put(b"")

    def _story(self) -> str:
        """Describe the work in progress and quote the last lines of stderr."""
        asked = f", {self._doing}" if self._doing else ""
        self._log.seek(0)
        lines = [line for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        told = " | ".join(line.strip() for line in lines[-_SHOWN_LINES:])
        return f"{asked}." + (f" Its last words on stderr: {told}" if told else "")


class _Session:
    """All checks of one method, and their findings so far."""

    def __init__(self, request: CheckRequest, limits: _TimeLimits, folder: Path, announce: _Announce) -> None:
        self.request = request
        self.checks = judge_of(request.benchmark).checks
        self.limits = limits
        self.folder = folder
        self.announce = announce
        self.findings: list[Finding] = []
        self._announced = 0
        self._lost: list[str] = []

    def run(self, checks: list[Check]) -> None:
        """Make checks in one process, or in as many as crashes require."""
        left = list(checks)
        while left:
            if why := self._blocked():
                self.findings += [replace(skipped(why), check=one.name) for one in left]
                return
            left = self._in_one_child(left)

    def _in_one_child(self, checks: list[Check]) -> list[Check]:
        """Make checks in one child until it ends; return the checks that are left."""
        left = list(checks)
        under_way = None
        # A new child knows nothing of its predecessors, and checks depend on one another.
        known = {name: outcome.value for name, outcome in self._known().items()}
        with _ChildProcess(self.request, [one.name for one in checks], known, self.folder) as child:
            try:
                for event in child.events(self.limits):
                    if event.finding is not None:
                        self.findings.append(event.finding)
                    elif event.waiting:
                        name = under_way.name if under_way is not None else "starting"
                        self.announce(f"{name}: {event.waiting}", self._announced, len(self.checks))
                    else:
                        under_way = left[0]
                        left = left[1:]
                        self._announced += 1
                        self.announce(under_way.name, self._announced, len(self.checks))
            except _Lost as lost:
                blamed = under_way or left.pop(0)
                self._lost.append(blamed.name)
                remedy = f"{_LOST} {_SLOW_START}" if blamed.name in _STARTS else _LOST
                self.findings.append(replace(failed(str(lost), remedy), check=blamed.name))
        return left

    def _known(self) -> dict[str, Outcome]:
        names = {finding.check for finding in self.findings}
        return {name: worst_of(finding for finding in self.findings if finding.check == name) for name in names}

    def _blocked(self) -> str:
        """Return why no further check can be made, or an empty text."""
        blocking = [name for name in self._lost if name in (*_STARTS, *FORM)]
        blocking += [name for name, outcome in self._known().items() if name == "load" and outcome is Outcome.FAILED]
        return f"not looked at before '{blocking[0]}' passes." if blocking else ""


def _descendants(pid: int) -> list[psutil.Process]:
    with contextlib.suppress(psutil.Error):
        return psutil.Process(pid).children(recursive=True)
    return []


def check(request: CheckRequest, announce: _Announce | None = None) -> Report:
    """Look at a method in every respect that the contract names.

    Args:
        request: The method, and what to ask it about.
        announce: Called with what is checked.

    Raises:
        AdapterError: if no such method is installed.
        InputFileError: if the TOML file does not say what it must.
        TableError: if the table cannot be read, or has no test sequences.
        UsageError: if the method is a control, or a program is not there.
    """
    started = time.perf_counter()
    # Raise the user's mistakes before any process is started.
    judge = judge_of(request.benchmark)
    if request.method in METHOD_CONTROLS:
        raise UsageError(f"'{request.method}' is a control of the harness itself; there is no method to check.")
    spec = method_spec(
        request.method,
        weights=request.weights,
        options=request.options,
        isolate=request.isolate,
        group=load_benchmark(request.benchmark).methods,
    )
    if request.data is not None:
        judge.require_table(request.data)
    with working_folder() as folder:
        session = _Session(
            request, _limits(request, spec), Path(folder), announce or (lambda _name, _place, _total: None)
        )
        session.run([one for one in session.checks if not one.fresh])
        session.run([one for one in session.checks if one.fresh])
    places = {one.name: place for place, one in enumerate(session.checks)}
    findings = sorted(session.findings, key=lambda finding: places[finding.check])
    return Report(request.method, tuple(findings), time.perf_counter() - started)


def _limits(request: CheckRequest, spec: MethodSpec) -> _TimeLimits:
    """Return limits a little longer than a program's own, whose messages say more about what happened."""
    if spec.program is None:
        return _TimeLimits(request.time_limit, request.start_limit)
    return _TimeLimits(request.time_limit + _GRACE, spec.program.start_timeout + _GRACE)
