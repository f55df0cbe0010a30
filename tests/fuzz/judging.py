"""Lets a process of its own read damaged files, and judges what became of it."""

from __future__ import annotations

import json
import os
import re
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from prbench.errors import PrbenchError, UnforeseenInput

SECONDS = 60.0
"""How long one look may take."""
BYTES = 2 * 2**30
"""How much memory one look may add."""
LONGEST_MESSAGE = 2_500
_UNPRINTABLE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


@dataclass(frozen=True)
class Seen:
    """What one look at files gave."""

    values: str
    """Digest of all values."""
    remarks: tuple[str, ...] = ()
    """What was told beside them."""


@dataclass(frozen=True)
class Outcome:
    """How a look ended."""

    ending: str
    """``read``, ``refused``, ``unforeseen``, ``traceback``, ``hang``, ``memory`` or ``died``."""
    seen: Seen | None = None
    message: str = ""
    seconds: float = 0.0


Look = Callable[[], Seen]


class Looker:
    """Takes looks in a forked process with bounded time and memory; only single-threaded interpreters may do this.

    One process takes many looks, because forking costs more than most of them; one that hangs or dies is replaced.

    Args:
        look: What is done at each look.
        seconds: How long one look may take.
        memory: Bytes that one look may add.
    """

    def __init__(self, look: Look, *, seconds: float = SECONDS, memory: int = BYTES) -> None:
        self._look, self._seconds, self._memory = look, seconds, memory
        self._child = 0
        self._asking = self._answers = -1

    def __call__(self) -> Outcome:
        """Take a look."""
        if not self._child:
            self._start()
        started = time.monotonic()
        os.write(self._asking, b"?")
        answer = self._received(started + self._seconds)
        took = time.monotonic() - started
        if answer is None:
            self.close()
            return Outcome("hang", message=f"more than {self._seconds:.0f} s", seconds=took)
        if not answer:
            return Outcome("died", message=f"status {self.close()}", seconds=took)
        ending, message, values, remarks = json.loads(answer)
        seen = Seen(values, tuple(remarks)) if ending == "read" else None
        return Outcome(ending, seen, message, took)

    def close(self) -> int:
        """End the process, if there is one; its exit status."""
        if not self._child:
            return 0
        os.kill(self._child, signal.SIGKILL)
        _, status = os.waitpid(self._child, 0)
        os.close(self._asking)
        os.close(self._answers)
        self._child = 0
        return os.waitstatus_to_exitcode(status)

    def _start(self) -> None:
        asked, self._asking = os.pipe()
        self._answers, answering = os.pipe()
        self._child = os.fork()
        if self._child == 0:
            os.close(self._asking)
            os.close(self._answers)
            _answer(self._look, asked, answering, self._memory)
        os.close(asked)
        os.close(answering)

    def _received(self, until: float) -> bytes | None:
        """One line; nothing if the process died before its end, None if it took too long."""
        parts = b""
        while not parts.endswith(b"\n"):
            ready, _, _ = select.select([self._answers], [], [], max(0.0, until - time.monotonic()))
            if not ready:
                return None
            part = os.read(self._answers, 1 << 16)
            if not part:
                return b""
            parts += part
        return parts


def _answer(look: Look, asked: int, answering: int, memory: int) -> None:
    """Look whenever asked to, and answer; runs in the child and never returns."""
    try:
        while os.read(asked, 1):
            used = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_DATA, (used + memory, resource.RLIM_INFINITY))
            answer = json.dumps(_told(look)).encode() + b"\n"
            while answer:
                answer = answer[os.write(answering, answer) :]
    finally:
        os._exit(0)


def _told(look: Look) -> tuple[str, str, str, tuple[str, ...]]:
    try:
        seen = look()
    except PrbenchError as error:
        if isinstance(error.__cause__, MemoryError):
            return "memory", str(error), "", ()
        return "unforeseen" if isinstance(error, UnforeseenInput) else "refused", str(error), "", ()
    except MemoryError:
        return "memory", _where(), "", ()
    except BaseException as error:  # whatever it is, it is the finding
        return "traceback", f"{type(error).__name__}: {str(error)[:200]} {_where()}", "", ()
    return "read", "", seen.values, seen.remarks


def _where() -> str:
    frames = traceback.extract_tb(sys.exc_info()[2])
    own = [frame for frame in frames if "prbench" in frame.filename] or frames
    return " < ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(own[-4:]))


def verdict(before: Seen, after: Outcome, *, must_be_told: bool) -> str:
    """Say what one damage led to.

    Returns:
        One of the good ends ``refused``, ``told`` (values changed, and something said so), ``same`` and ``unseen``
        (values changed as values can, and nothing can know); or a finding: ``silent`` (values changed and something
        should have said so), ``message`` (a message too long or with characters that steer a terminal), or the ending.
    """
    if after.ending == "refused":
        steers = _UNPRINTABLE.search(after.message) is not None
        return "message" if steers or len(after.message) > LONGEST_MESSAGE else "refused"
    if after.seen is None:
        return after.ending
    if after.seen.values == before.values:
        return "same"
    if after.seen.remarks != before.remarks:
        return "told"
    return "silent" if must_be_told else "unseen"


GOOD = frozenset({"refused", "told", "same", "unseen"})


def temporary_folder() -> Path:
    """Return a new folder for one door's files."""
    return Path(tempfile.mkdtemp(prefix="prbench-fuzz-"))
