"""The two pipes of a program, each with a thread of its own: waiting for them can always be given up.

Threads instead of ``select`` because pipes cannot be selected on Windows.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Sequence
from typing import IO

from prbench.harness.methods.remote.faults import BrokenProtocol, CutShort, Ended, TimedOut, excerpt
from prbench.harness.methods.remote.messages import HEADER_LIMIT, Header, parse_header

_CHUNK = 1 << 16
_SLICE = 0.2
"""Seconds after which a wait looks whether the program still runs."""
_LINE_PATIENCE = 0.3
"""Seconds to wait for the rest of a line that is no message, so that it can be shown."""
_REMEDY = "Its stdout belongs to the protocol: print to stderr"


class Deadline:
    """A time limit that has begun to run."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._end = time.monotonic() + seconds

    def remaining(self) -> float:
        """Seconds, 0 when it is over."""
        return max(0.0, self._end - time.monotonic())


class Outbox:
    """Writes to the program's stdin; one message may wait while another is being written."""

    def __init__(self, stdin: IO[bytes]) -> None:
        self._waiting: queue.Queue[Sequence[bytes] | None] = queue.Queue(maxsize=1)
        self.broken = threading.Event()
        """The program has closed its end."""
        self.written = self.total = 0
        """Bytes of the message that is being written."""
        threading.Thread(target=self._write, args=(stdin,), name="stdin of a program", daemon=True).start()

    def send(self, message: Sequence[bytes], deadline: Deadline) -> None:
        """Leave a message to be written.

        Raises:
            TimedOut: if earlier ones are still unread at the deadline.
        """
        try:
            self._waiting.put(message, timeout=deadline.remaining())
        except queue.Full:
            raise TimedOut(f"did not read its stdin within {deadline.seconds:g} s ({self.progress()})") from None

    def progress(self) -> str:
        """Say how much of the message the program has taken."""
        return f"{self.written:,} of {self.total:,} bytes of the request went into its stdin"

    def close(self) -> None:
        """Close stdin once all is written; at once if the program reads no more."""
        try:
            self._waiting.put_nowait(None)
        except queue.Full:
            self.broken.set()

    def _write(self, stdin: IO[bytes]) -> None:
        with stdin:
            for message in iter(self._waiting.get, None):
                self.written, self.total = 0, sum(map(len, message))
                for piece in message:
                    if self.broken.is_set() or not self._write_piece(stdin.fileno(), piece):
                        self.broken.set()
                        return

    def _write_piece(self, stdin: int, piece: bytes) -> bool:
        # Without a copy, and in pieces, so that progress can be told when a program stops reading.
        left = memoryview(piece)
        while left:
            try:
                taken = os.write(stdin, left[:_CHUNK])
            except OSError:  # a broken pipe, which Windows calls an invalid argument
                return False
            self.written += taken
            left = left[taken:]
        return True


class Inbox:
    """Reads messages from the program's stdout; at most a megabyte is taken in before it is asked for."""

    def __init__(self, stdout: IO[bytes], ended: Callable[[], str | None], outbox: Outbox) -> None:
        self._chunks: queue.Queue[bytes] = queue.Queue(maxsize=16)
        self._buffer = bytearray()
        self._ended = ended
        self._outbox = outbox
        self._discarding = threading.Event()
        threading.Thread(target=self._read, args=(stdout,), name="stdout of a program", daemon=True).start()

    def receive(self, payload_limit: int, deadline: Deadline) -> tuple[Header, bytes | None]:
        """Wait for one message.

        Args:
            payload_limit: Bytes; a larger payload is refused unread.
            deadline: For the whole message.

        Raises:
            BrokenProtocol: if what comes is no message.
            CutShort: if less of the payload comes in time than its header announces.
            Ended: if the program ends or closes a pipe before the message is complete.
            TimedOut: if the message is not complete in time.
        """
        header = self._header(deadline)
        if "bytes" not in header:
            return header, None
        size = header["bytes"]
        if size > payload_limit:
            raise BrokenProtocol(
                f"announced a payload of {size:,} bytes, where at most {payload_limit:,} can be the answer"
            )
        while len(self._buffer) < size:
            try:
                self._take_in(deadline, f"{len(self._buffer):,} of {size:,} bytes of its payload")
            except TimedOut:
                raise CutShort(_cut_short(size, len(self._buffer), deadline.seconds)) from None
        return header, self._cut(size)

    def require_silence(self) -> None:
        """Refuse what was sent without being asked for.

        Raises:
            BrokenProtocol: showing the beginning of it.
        """
        while not self._chunks.empty():
            self._buffer += self._chunks.get_nowait()
        if self._buffer:
            raise BrokenProtocol(
                f"wrote to stdout without being asked, behind its last answer: {excerpt(self._buffer)}. {_REMEDY}"
            )

    def discard(self) -> None:
        """Read on, so that the program can end, but keep nothing."""
        self._discarding.set()

    def _header(self, deadline: Deadline) -> Header:
        searched = 0
        while (end := self._buffer.find(b"\n", searched, HEADER_LIMIT)) < 0:
            searched = len(self._buffer)
            if searched >= HEADER_LIMIT:
                raise BrokenProtocol(
                    f"wrote {searched:,} bytes without a line end, where a header has at most {HEADER_LIMIT:,}:"
                    f" {excerpt(self._buffer)}. {_REMEDY}"
                )
            if searched and self._buffer[0] != ord("{"):
                self._refuse_line(deadline)
            self._take_in(deadline, f"{searched:,} bytes of a header without its end" if searched else "")
        line = self._cut(end + 1)
        if not line.startswith(b"{"):
            raise _no_message(line)
        try:
            return parse_header(line)
        except ValueError as error:
            raise _no_message(line, f" ({error})") from error

    def _refuse_line(self, deadline: Deadline) -> None:
        """Take in a little more of what can be no header, so that the message can show it."""
        patience = Deadline(min(deadline.remaining(), _LINE_PATIENCE))
        while len(self._buffer) < 400 and b"\n" not in self._buffer:
            try:
                self._take_in(patience, "")
            except (Ended, TimedOut):
                break
        raise _no_message(bytes(self._buffer).split(b"\n")[0])

    def _cut(self, size: int) -> bytes:
        piece = bytes(memoryview(self._buffer)[:size])
        del self._buffer[:size]
        return piece

    def _take_in(self, deadline: Deadline, so_far: str) -> None:
        """Wait for the next bytes."""
        behind = f", after {so_far}" if so_far else ""
        patience: Deadline | None = None  # with a program that reads no more
        while remaining := deadline.remaining():
            ended = self._ended()
            try:
                chunk = self._chunks.get(timeout=min(remaining, _SLICE))
            except queue.Empty:
                if ended is not None:  # already before the wait, so nothing of it is on its way
                    raise Ended(f"{ended}{behind}") from None
                if self._outbox.broken.is_set():
                    patience = patience or Deadline(2 * _SLICE)
                    if not patience.remaining():
                        raise Ended(f"closed its stdin{behind}") from None
                continue
            if not chunk:
                raise Ended(f"{self._ended_soon() or 'closed its stdout'}{behind}")
            self._buffer += chunk
            return
        unread = self._outbox.written < self._outbox.total
        raise TimedOut(
            f"did not answer within {deadline.seconds:g} s{f' ({self._outbox.progress()})' if unread else ''}{behind}"
        )

    def _ended_soon(self) -> str | None:
        """Say how the program ended; a pipe closes a moment before its process is gone."""
        patience = Deadline(1.0)
        while (ended := self._ended()) is None and patience.remaining():
            time.sleep(0.01)
        return ended

    def _read(self, stdout: IO[bytes]) -> None:
        with stdout:
            while True:
                try:
                    chunk = os.read(stdout.fileno(), _CHUNK)
                except OSError:
                    chunk = b""
                while not self._discarding.is_set():
                    try:
                        self._chunks.put(chunk, timeout=_SLICE)
                        break
                    except queue.Full:
                        continue
                if not chunk:
                    return


def _cut_short(announced: int, written: int, seconds: float) -> str:
    return (
        f"announced a payload of {announced:,} bytes and wrote {written:,} of them within {seconds:g} s. 'bytes' has"
        " to be the size of what follows, all of it written and flushed; if it was still writing, raise the limit with"
        " --timeout"
    )


def _no_message(line: bytes, reason: str = "") -> BrokenProtocol:
    return BrokenProtocol(f"wrote a line that is no message: {excerpt(line)}{reason}. {_REMEDY}")
