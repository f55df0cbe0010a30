"""A program behind the wire protocol: started, asked, started again after a crash, and ended."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Self

import prbench
from prbench.errors import AdapterError
from prbench.harness.methods.remote.answers import Introduction, RemoteWeights, error_text
from prbench.harness.methods.remote.faults import Ended, Fault, ReportedError, TimedOut
from prbench.harness.methods.remote.log import ProgramLog
from prbench.harness.methods.remote.messages import WIRE_VERSION, Header
from prbench.harness.methods.remote.process import Program, ProgramProcess

_MEGABYTE = 1 << 20
_SLOW_BATCH = " Let it answer faster, lower --batch-size, or raise the limit with --timeout."
_SLOW_START = (
    " Let it load its weights with the first batch, or raise start_s under [limits] in a TOML file for it"
    " (docs/environments.md)."
)


@dataclass(frozen=True)
class Exchange:
    """One request to a program, and how its answer is read."""

    header: Header
    """Without the number of the batch."""
    payload: bytes
    largest: int
    """Most bytes of the answer's payload."""
    read: Callable[[Header, bytes | None, int], Any]
    """Turns header, payload and the number of the batch into the answer."""
    asked_for: str
    """What was asked for, for messages."""


class RemoteMethod:
    """A method of any benchmark in a process of its own; made by :meth:`start`.

    A program that crashes in mid-batch is started again, once for each batch; one that misses a time limit or breaks
    the protocol is not. It ends with :meth:`close`, with the interpreter, or when nobody holds this object any more.
    """

    all_conditions: ClassVar[type[StrEnum]]
    """The conditions of the benchmark."""
    said: ClassVar[Mapping[str, Any]] = {}
    """What the hello says besides."""

    def __init__(self, program: Program, hello: Header) -> None:
        self._program, self._hello = program, hello
        self._closed = False
        self.restarts = 0
        """Number of times that the program was started again after a crash."""
        introduction = self._introduction = self._launch(f"method '{program.name}'")
        self.name, self.version = introduction.name, introduction.version
        self.conditions: frozenset[Any] = introduction.declared.conditions
        self.max_frames, self.native_fps = introduction.declared.max_frames, introduction.declared.native_fps
        self.motionless = introduction.declared.motionless
        self.gaze = introduction.declared.gaze
        self.one_design = introduction.one_design
        self.weights: Mapping[StrEnum, RemoteWeights] = introduction.weights
        """Weights that it says it uses under each condition; empty if it says nothing."""
        self.trainable = introduction.trainable

    @classmethod
    def start(
        cls, program: Program, *, weights: str | None, options: Mapping[str, str], device: str, threads: int
    ) -> Self:
        """Start the program and let it introduce itself.

        Args:
            program: How to start it.
            weights: An absolute path, or a name that the program knows, or None for its default.
            options: ``--option key=value``, handed on as they are.
            device: ``cpu``, ``cuda`` …
            threads: Threads that it may use.

        Raises:
            AdapterError: if it cannot be started, refuses its settings, or does not introduce itself in time and as
                the protocol asks for.
        """
        settings = {"device": device, "threads": threads, "options": dict(options), "weights": weights}
        hello = {"message": "hello", "wire": WIRE_VERSION, "prbench": prbench.__version__, **cls.said, **settings}
        return cls(program, hello)

    def exchange(self, asked: Exchange) -> Any:
        """Ask the program once, or twice where it crashed.

        Raises:
            AdapterError: if it fails, crashes twice, answers too late or with something else than the protocol asks
                for. The program is ended then, unless it reported the failure itself.
            MemoryError: if it says that the batch does not fit in memory.
        """
        origin = f"method '{self.name}'"
        try:
            return self._asked(asked, origin)
        except Ended:
            self.restarts += 1
        try:
            return self._asked(asked, origin)
        except Ended as fault:
            raise AdapterError(self._told(f"{origin}, twice", fault, asked.asked_for)) from fault

    @property
    def exit_status(self) -> int | None:
        """Exit status of the program once it is closed; None if it had to be ended."""
        return self._process.exit_status

    def close(self) -> None:
        """End the program. May be called again."""
        self._closed = True
        self._finalizer()

    def _asked(self, asked: Exchange, origin: str) -> Any:
        """Ask once.

        Raises:
            AdapterError: if it failed for good.
            Ended: if the program did, so that it may be tried again.
        """
        if self._closed:
            raise AdapterError(f"{origin}: asked for motions after its program was closed.")
        if self._process.over and self._launch(origin) != self._introduction:
            self._process.close()
            raise AdapterError(
                f"{origin}: expected its program to introduce itself as before it was started again after a crash,"
                " found another name, version or declaration. Make its hello depend on its settings alone."
            )
        number, self._batches = self._batches, self._batches + 1
        try:
            answer, payload = self._process.ask(
                {"message": asked.header["message"], "batch": number, **asked.header},
                asked.payload,
                timeout=self._program.batch_timeout,
                answer_limit=asked.largest + _MEGABYTE,
            )
            return asked.read(answer, payload, number)
        except Ended:
            raise
        except Fault as fault:
            if not isinstance(fault, ReportedError):
                self._process.kill()
            raise AdapterError(self._told(origin, fault, asked.asked_for)) from fault

    def _launch(self, origin: str) -> Introduction:
        process = self._process = ProgramProcess(self._program)
        self._finalizer = weakref.finalize(self, process.close)
        self._batches = 0
        try:
            answer, _ = process.ask(self._hello, timeout=self._program.start_timeout, answer_limit=_MEGABYTE)
            if answer["message"] == "error":
                raise ReportedError(f"refused to start: {error_text(answer)}")
            return Introduction.read(answer, origin=origin, conditions=self.all_conditions)
        except Fault as fault:
            process.kill()
            told = self._told(f"{origin}, asked to introduce itself", fault, if_late=_SLOW_START)
            raise AdapterError(told) from fault
        except ValueError as error:  # options of more than 64 kB
            raise AdapterError(f"{origin}: its settings cannot be sent: {error}. Put them into a file.") from error
        except AdapterError as error:
            process.kill()
            raise AdapterError(f"{error}{_log_story(process.log, even_if_empty=False)}") from error

    def _told(self, origin: str, fault: Fault, asked_for: str = "", *, if_late: str = _SLOW_BATCH) -> str:
        """Describe a fault: what to do about it, what was asked for, and the end of the log."""
        text = f"{origin}: its program {fault}.".replace("..", ".")
        if isinstance(fault, TimedOut):
            text += if_late
        if isinstance(fault, Ended) and self._program.fence is not None:
            text += (
                f" It ran apart (--isolate, {self._program.fence}): paths and variables of this machine may be hidden."
            )
        return text + asked_for + _log_story(self._process.log, even_if_empty=isinstance(fault, Ended | TimedOut))


def _log_story(log: ProgramLog, *, even_if_empty: bool) -> str:
    lines = log.tail()
    if not lines:
        return " It wrote nothing to its log (stderr)." if even_if_empty else ""
    place = f"the log, {log.path}" if log.path is not None else "its log"
    return "\n".join([f" The end of {place}:", *(f"    {line}" for line in lines)])
