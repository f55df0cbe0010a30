"""The child's side: ``python -m prbench.checking.conformance.child``, one order in JSON on stdin, events on stdout.

What the method itself prints goes to stderr, so that it cannot be taken for an event.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from prbench.checking.conformance.check import examine
from prbench.checking.conformance.judges import judge_of
from prbench.checking.conformance.method_subject import MethodSubject
from prbench.checking.conformance.report import CheckRequest, Outcome
from prbench.errors import PrbenchError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench.harness.methods.programs import is_program

Tell = Callable[..., None]


def main() -> None:
    """Run the ordered checks and tell what they find."""
    order = json.loads(sys.stdin.readline())
    tell = _teller()
    request = CheckRequest.of_json(order["request"])
    subject = _subject(request, Path(order["folder"]))
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


def _subject(wanted: CheckRequest, folder: Path) -> MethodSubject:
    spec = method_spec(
        wanted.method,
        weights=wanted.weights,
        options=wanted.options,
        device=wanted.device,
        threads=wanted.threads,
        isolate=wanted.isolate,
        timeout=wanted.time_limit if wanted.isolate or is_program(wanted.method) else None,
        hidden=() if wanted.data is None else (wanted.data,),
        group=load_benchmark(wanted.benchmark).methods,
    )
    return judge_of(wanted.benchmark).subject(spec, wanted, folder)


if __name__ == "__main__":
    try:
        main()
    except PrbenchError as error:
        sys.stderr.write(f"{error}\n")
        sys.exit(error.exit_code)
