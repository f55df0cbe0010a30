"""Check one method from the outside: the findings of all checks, whatever the method does.

The checks run in a child process, ``python -m prbench.checking.conformance``, which gets one order in JSON on stdin and
tells events on stdout. When a method crashes it, or does not come to an end, the check that was under way fails with
that, and another child goes on with those that are left.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
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
from typing import IO, Any

import msgspec
import psutil

from prbench.checking.conformance import findings as verdicts
from prbench.checking.conformance.cases import cases_of_table, synthetic_cases
from prbench.checking.conformance.checks import CHECKS
from prbench.checking.conformance.subject import MethodSubject, Subject
from prbench.errors import UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.installed import METHOD_CONTROLS, is_program
from prbench.harness.methods.loading import MethodSpec, forget_loaded_methods, method_spec
from prbench.harness.methods.process import exit_story, python_words, users_environment
from prbench.protocol.manifests import benchmarks, find_benchmark


@dataclass(frozen=True)
class Judge:
    """The checks of one benchmark.

    Attributes:
        subject: Makes the method under examination: how to make it, the request, the folder of the check.
        require_table: Refuses a folder that holds no cases.
    """

    checks: tuple[verdicts.Check, ...]
    subject: Callable[[MethodSpec, verdicts.CheckRequest, Path], MethodSubject]
    require_table: Callable[[Path], object]


def _motions(spec: MethodSpec, request: verdicts.CheckRequest, folder: Path) -> Subject:
    cases = synthetic_cases(folder) if request.data is None else cases_of_table(request.data)
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


def _spec(request: verdicts.CheckRequest, **more: Any) -> MethodSpec:
    methods = load_benchmark(request.benchmark).methods
    asked = {"weights": request.weights, "options": request.options, "isolate": request.isolate}
    return method_spec(request.method, group=methods, **asked, **more)


def run_ordered() -> None:
    """Run the checks that are ordered on stdin and tell what they find; what the method prints goes to stderr."""
    order = json.loads(sys.stdin.readline())
    # A method that prints must not break the events, which share the pipe with nobody.
    events = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def tell(**event: object) -> None:
        events.write(json.dumps(event) + "\n")
        events.flush()

    request = msgspec.convert(order["request"], verdicts.CheckRequest, dec_hook=lambda kind, text: kind(text))
    folder = Path(order["folder"])
    spec = _spec(
        request,
        device=request.device,
        threads=request.threads,
        timeout=request.time_limit if request.isolate or is_program(request.method) else None,
        hidden=() if request.data is None else (request.data,),
    )
    subject = judge_of(request.benchmark).subject(spec, request, folder)
    subject.asking = lambda text: tell(event="asking", text=text)
    subject.starting = lambda text: tell(event="starting", text=text)
    known = {name: verdicts.Outcome(value) for name, value in order["known"].items()}
    checks = [one for one in judge_of(request.benchmark).checks if one.name in order["checks"]]
    for finding in verdicts.examine(
        subject, checks, known=known, announce=lambda one: tell(event="check", name=one.name)
    ):
        tell(event="finding", finding=asdict(finding))
    forget_loaded_methods()
    tell(event="end")
    os._exit(0)  # a method's threads that do not end would keep the process


_SHOWN_LINES = 5
_OTHERWISE = 120.0  # seconds for work that is not the method's
_GRACE = 10.0  # seconds by which our limits are longer than a program's own, whose messages say more
_STARTS = ("import", "load")
_LOST = (
    "A run would end in the same way. Look for a deadlock, a loop that does not end, os._exit, and crashes of compiled"
    " code under this input."
)
_SLOW_START = "If it is only slow, move the work into the first generate(), or raise --start-timeout."
_Announce = Callable[[str, int, int], None]  # called before each check with its name, its place and how many there are


class _Lost(Exception):
    """The child crashed, or the method did not come to an end; the text says so."""


def check(request: verdicts.CheckRequest, announce: _Announce | None = None) -> verdicts.Report:
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
    spec = _spec(request)
    if request.data is not None:
        judge.require_table(request.data)
    call = request.time_limit
    start = request.start_limit
    if spec.program is not None:
        call += _GRACE
        start = spec.program.start_timeout + _GRACE
    limits = {"starting": start, "asking": call}
    findings: list[verdicts.Finding] = []
    lost: list[str] = []
    announced = itertools.count(1)
    with tempfile.TemporaryDirectory(prefix="prbench-check-", ignore_cleanup_errors=True) as folder:
        for fresh in (False, True):
            left = [one for one in judge.checks if one.fresh is fresh]
            while left:
                # A new child knows nothing of its predecessors, and checks depend on one another.
                made = dict.fromkeys(finding.check for finding in findings)
                known = {name: verdicts.worst_of(each for each in findings if each.check == name) for name in made}
                blocking = [name for name in lost if name in (*_STARTS, *verdicts.FORM)]
                blocking += ["load"] * (known.get("load") is verdicts.Outcome.FAILED)
                if blocking:
                    why = f"not looked at before '{blocking[0]}' passes."
                    findings += [replace(verdicts.skipped(why), check=one.name) for one in left]
                    break
                order = {
                    "request": msgspec.to_builtins(request, enc_hook=str),
                    "checks": [one.name for one in left],
                    "known": {name: outcome.value for name, outcome in known.items()},
                    "folder": folder,
                }
                blamed = left[0].name
                try:
                    for message in _events_of_child(order, limits):
                        if message["event"] == "check":
                            blamed = left.pop(0).name
                            if announce is not None:
                                announce(blamed, next(announced), len(judge.checks))
                        elif message["event"] == "finding":
                            findings.append(msgspec.convert(message["finding"], verdicts.Finding))
                except _Lost as why_lost:
                    if left and left[0].name == blamed:
                        del left[0]
                    lost.append(blamed)
                    remedy = f"{_LOST} {_SLOW_START}" if blamed in _STARTS else _LOST
                    findings.append(replace(verdicts.failed(str(why_lost), remedy), check=blamed))
    places = {one.name: place for place, one in enumerate(judge.checks)}
    findings.sort(key=lambda finding: places[finding.check])
    return verdicts.Report(request.method, tuple(findings), time.perf_counter() - started)


def _events_of_child(order: Mapping[str, object], limits: Mapping[str, float]) -> Iterator[dict[str, Any]]:
    """Make checks in a process of its own, which may crash or hang, and yield what it tells until it has done all.

    Args:
        order: What the child is told.
        limits: Seconds for what follows an event of the child; its own work has two minutes or more.

    Raises:
        _Lost: if it crashed, or the method took longer.
    """
    with tempfile.TemporaryFile() as log:
        words = python_words("prbench.checking.conformance")
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": log}
        process = subprocess.Popen(words, env=users_environment(), **pipes)
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # it is gone already; its exit status is told below
            process.stdin.write(json.dumps(order).encode() + b"\n")
            process.stdin.close()
        lines: queue.Queue[bytes] = queue.Queue()
        threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
        otherwise = max(limits["asking"], _OTHERWISE)
        limit = otherwise
        doing = ""
        try:
            while True:
                try:
                    line = lines.get(timeout=limit)
                except queue.Empty:
                    problem = f"no end after {limit:g} s"
                    break
                if not line:
                    problem = f"the process of the method {exit_story(process.wait())}"
                    break
                message = json.loads(line)
                if message["event"] == "end":
                    return
                doing = message.get("text", "")
                limit = limits.get(message["event"], otherwise)
                yield message
            log.seek(0)
            words = [line.strip() for line in log.read().decode(errors="replace").splitlines() if line.strip()]
            told = f" Its last words on stderr: {' | '.join(words[-_SHOWN_LINES:])}" if words else ""
            raise _Lost(f"{problem}{f', {doing}' if doing else ''}.{told}")
        finally:
            # End it with all that it started.
            with contextlib.suppress(psutil.Error):
                started = psutil.Process(process.pid)
                for each in [*started.children(recursive=True), started]:
                    with contextlib.suppress(psutil.Error):
                        each.kill()
            process.wait()


def _read(stream: IO[bytes], lines: queue.Queue[bytes]) -> None:
    for line in stream:
        lines.put(line)
    lines.put(b"")
