"""The parent's side of the process in which a method is looked at."""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import psutil

from prbench.checking.conformance.finding import Finding, Outcome
from prbench.checking.conformance.request import CheckRequest
from prbench.methods.remote.faults import exit_story
from prbench.methods.users_environment import python_words, users_environment

_MODULE = "prbench.checking.conformance.child"
_SHOWN_LINES = 5
_OTHERWISE = 120.0
_HEARTBEAT = 10.0  # seconds between words about the same work


class Lost(Exception):
    """The child crashed, or the method did not come to an end; the text says so."""


@dataclass(frozen=True)
class Event:
    """A finding, a word about what takes so long, or the beginning of the next check."""

    finding: Finding | None = None
    waiting: str = ""


@dataclass(frozen=True)
class TimeLimits:
    """Seconds."""

    call: float
    """For each call of the method."""
    start: float
    """For importing it, and for loading it."""

    def of(self, event: str) -> float:
        """What may follow an event of the child; whatever is not the method's own work has two minutes or more."""
        if event == "starting":
            return self.start
        return self.call if event == "asking" else max(self.call, _OTHERWISE)


class ChildProcess:
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

    def __enter__(self) -> ChildProcess:
        return self

    def __exit__(self, *_: object) -> None:
        """End it with all that it started."""
        if self._process.poll() is None:
            for process in [*_descendants(self._process.pid), psutil.Process(self._process.pid)]:
                with contextlib.suppress(psutil.Error):
                    process.kill()
        self._process.wait()
        self._log.close()

    def events(self, limits: TimeLimits) -> Iterator[Event]:
        """What the child does, until it has done everything.

        Raises:
            Lost: if it crashed, or the method took longer.
        """
        limit = limits.of("")
        while True:
            began = time.monotonic()
            while (line := self._next(min(_HEARTBEAT, limit - (time.monotonic() - began)))) is None:
                waited = time.monotonic() - began
                if waited >= limit:
                    raise Lost(f"no end after {limit:g} s{self._story()}")
                yield Event(waiting=f"{self._doing or 'while at work'}, {waited:.0f} s so far".removeprefix("while "))
            if not line:
                raise Lost(f"the process of the method {exit_story(self._process.wait())}{self._story()}")
            message = json.loads(line)
            if message["event"] == "end":
                return
            self._doing = message.get("text", "")
            limit = limits.of(message["event"])
            if message["event"] == "check":
                yield Event()
            elif message["event"] == "finding":
                found = message["finding"]
                yield Event(Finding(**(found | {"outcome": Outcome(found["outcome"])})))

    def _next(self, patience: float) -> bytes | None:
        """The next line, empty at the end; None if it does not come."""
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
        """What was under way, and the last words on stderr."""
        asked = f", {self._doing}" if self._doing else ""
        self._log.seek(0)
        lines = [line for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        told = " | ".join(line.strip() for line in lines[-_SHOWN_LINES:])
        return f"{asked}." + (f" Its last words on stderr: {told}" if told else "")


def _descendants(pid: int) -> list[psutil.Process]:
    with contextlib.suppress(psutil.Error):
        return psutil.Process(pid).children(recursive=True)
    return []
