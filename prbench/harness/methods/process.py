"""The program of a method while it runs: its environment, its pipes, its log, and how it ends.

The two pipes have a thread each, so that waiting for them can always be given up; pipes cannot be selected on Windows.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psutil

from prbench.errors import AdapterError
from prbench.files.storage import cache_folder
from prbench.harness.methods.messages import HEADER_LIMIT, Header, encode_message, parse_header

_SET_BY_LIBRARIES = ("KMP_DUPLICATE_LIB_OK",)  # by threadpoolctl, when it is imported
_NOT_THE_USERS = frozenset(name for name in _SET_BY_LIBRARIES if name not in os.environ)
_START = (
    "import json, runpy, sys; sys.path[:] = json.loads(sys.argv.pop(1));"
    " runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)


def users_environment() -> dict[str, str]:
    """The variables of this process without those that libraries set while prbench imported them."""
    return {name: value for name, value in os.environ.items() if name not in _NOT_THE_USERS}


def python_words(module: str, *arguments: str) -> list[str]:
    """The command that runs a module as ``python -m`` does, with this process's ``sys.path`` and no variable for it.

    Args:
        module: Dotted name.
        arguments: What it finds in ``sys.argv[1:]``.
    """
    paths = [os.path.abspath(path) for path in sys.path]  # noqa: PTH100 - an empty entry is the current folder
    return [sys.executable, "-P", "-c", _START, json.dumps(paths), module, *arguments]


@contextlib.contextmanager
def computing_threads(threads: int) -> Iterator[None]:
    """Fix the threads of numerical libraries: the same in this process and in any other, whatever it started with."""
    from threadpoolctl import threadpool_limits  # sets a variable, which users_environment() has to see come

    torch = sys.modules.get("torch")
    if torch is not None and torch.get_num_threads() != threads:
        torch.set_num_threads(threads)  # torch manages its own
    with threadpool_limits(threads):
        yield


class Fault(Exception):
    """A program did not do its part. The text completes "its program …"."""


class Ended(Fault):
    """It is gone, or has closed one of its pipes; starting it again may help."""


class TimedOut(Fault):
    """It has not done in time what it was asked for."""


class CutShort(Fault):
    """It has announced a payload and not written all of it in time."""


class BrokenProtocol(Fault):
    """It wrote to stdout what is no message, or not the message that was due."""


class ReportedError(Fault):
    """It says itself that it failed, and goes on waiting."""


def excerpt(found: bytes | bytearray, limit: int = 80) -> str:
    r"""Return the first characters of what was found, in quotes, whatever bytes they are.

    >>> excerpt(b"epoch 1\r\n")
    "'epoch 1'"
    """
    text = found[: 4 * limit].decode(errors="backslashreplace").rstrip("\r\n")
    shown = "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)
    return f"'{shown[:limit]}'" + ("…" if len(shown) > limit or len(found) > 4 * limit else "")


def exit_story(status: int) -> str:
    """Say how a process ended, from its return code.

    >>> exit_story(1)
    'ended with exit status 1'
    >>> exit_story(-9)
    'was ended by signal 9 (SIGKILL; often the system that ran out of memory)'
    """
    if sys.platform == "win32" and status > 255:
        return f"ended with exit status 0x{status:08X}"
    if status < 0:
        return f"was ended by signal {-status} ({_signal_name(-status)})"
    if 128 < status < 160 and sys.platform != "win32":  # how shells, fences and containers pass a signal on
        return f"ended with exit status {status} (128 + {status - 128}: {_signal_name(status - 128)})"
    return f"ended with exit status {status}"


def _signal_name(number: int) -> str:
    try:
        name = signal.Signals(number).name
    except ValueError:
        return "unknown"
    return f"{name}; often the system that ran out of memory" if name == "SIGKILL" else name


_PART = 512 * 1024
"""Bytes kept of the beginning of a log, and at least as many of its end, at most twice as many."""
_TAIL_BYTES = 8192
_KEPT_LOGS = 100


class ProgramLog:
    """Takes in stderr all the time, so that a program that writes much is never held up.

    The file is made when the first byte comes. Once it is full, its first half megabyte stays and its latest half
    megabytes take turns.
    """

    def __init__(self, stderr: IO[bytes], name: str, pid: int) -> None:
        self._path = cache_folder() / "logs" / f"{_file_name(name)}-{pid}.log"
        self._tail = b""
        self._written = False
        self._ended = threading.Event()
        threading.Thread(target=self._drain, args=(stderr,), name=f"log of {name}", daemon=True).start()

    @property
    def path(self) -> Path | None:
        """The file; None while nothing was written, or if it could not be."""
        return self._path if self._written else None

    def tail(self, lines: int = 10) -> list[str]:
        """Return the last lines, overlong ones cut."""
        text = self._tail.decode(errors="replace")
        return [_printable(line) for line in text.splitlines() if line.strip()][-lines:]

    def wait_for_end(self, seconds: float) -> None:
        """Wait until everything is read; not for ever, since a forgotten child may hold stderr open."""
        self._ended.wait(seconds)

    def _drain(self, stderr: IO[bytes]) -> None:
        with contextlib.ExitStack() as open_files:
            open_files.callback(self._ended.set)
            open_files.callback(stderr.close)
            file: _BoundedFile | None = None
            while chunk := os.read(stderr.fileno(), 65_536):
                self._tail = (self._tail + chunk)[-_TAIL_BYTES:]
                if file is None:
                    file = open_files.enter_context(_BoundedFile(self._path))
                self._written = file.write(chunk)


class _BoundedFile:
    """A file that keeps its beginning and its latest part; gives up quietly if the disk does not take it."""

    def __init__(self, path: Path) -> None:
        self._file: IO[bytes] | None = None
        self._size = self._cut = 0
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            _prune(path.parent)
            self._file = path.open("wb", buffering=0)

    def __enter__(self) -> _BoundedFile:
        return self

    def __exit__(self, *error: object) -> None:
        if self._file is not None:
            self._file.close()

    def write(self, chunk: bytes) -> bool:
        """Append; false if there is no file to append to."""
        if self._file is None:
            return False
        try:
            if self._size + len(chunk) > 2 * _PART:
                self._begin_latest_part(self._file)
            self._size += self._file.write(chunk) or 0
        except OSError:  # a full disk must not stop the program; the last lines are still in memory
            self._file.close()
            self._file = None
            return False
        return True

    def _begin_latest_part(self, file: IO[bytes]) -> None:
        # The beginning tells how the program was set up, the end why it failed; the middle goes.
        kept = min(_PART, self._size)
        self._cut += self._size - kept
        file.seek(kept)
        file.truncate()
        note = f"\n[… {self._cut:,} bytes cut here by prbench …]\n".encode()
        file.write(note)
        self._size = kept


def _file_name(name: str) -> str:
    """Make a file name of the name that a program has in messages: folders and odd characters are left out.

    >>> _file_name("/opt/envs/glide/bin/python '/home/me/my glide.py' --fast")
    'python-my-glide.py---fast'
    """
    without_folders = re.sub(r"[^\s'\"]*[/\\]", "", name)
    return re.sub(r"[^A-Za-z0-9._-]+", "-", without_folders).strip("-.")[:60] or "program"


def _prune(folder: Path) -> None:
    """Delete all but the newest logs."""
    logs = sorted(folder.glob("*.log"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in logs[_KEPT_LOGS:]:
        path.unlink(missing_ok=True)


def _printable(line: str) -> str:
    """Remove what would move the cursor or colour a terminal."""
    line = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line.expandtabs(4))
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in line)[:400]


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


EXIT_SECONDS = 5.0
"""Time for a program to end after its stdin was closed."""
TERM_SECONDS = 2.0
"""Time for it to end after SIGTERM."""


@dataclass(frozen=True)
class Program:
    """A method's program. Picklable, so that every worker can start its own; it knows nothing about tables."""

    name: str
    """Name in messages until it has introduced itself."""
    words: tuple[str, ...]
    """The whole command: a fence, ``conda run`` and the like included."""
    directory: Path | None
    """Folder that it starts in; None for an empty temporary folder of its own."""
    environment: tuple[tuple[str, str], ...]
    """The whole environment; nothing is inherited beside it."""
    start_timeout: float = 120.0
    """Seconds until it has introduced itself."""
    batch_timeout: float = 600.0
    """Seconds until a batch is answered."""
    fence: str | None = None
    """None for the user's own program; ``process`` or ``bubblewrap`` for an installed method kept at a distance."""


class ProgramProcess:
    """A started program. One request at a time; after a fault it is gone."""

    def __init__(self, program: Program) -> None:
        """Start it, in a session and process group of its own: Ctrl-C in the terminal is not for it.

        Raises:
            AdapterError: if the command or its folder does not exist, or cannot be run.
        """
        self._scratch = (
            tempfile.TemporaryDirectory(prefix="prbench-", ignore_cleanup_errors=True)
            if program.directory is None
            else None
        )
        self._popen = self._started(program)
        stdin = self._popen.stdin
        stdout = self._popen.stdout
        stderr = self._popen.stderr
        assert stdin is not None
        assert stdout is not None
        assert stderr is not None
        self._owner = os.getpid()
        self._known_kin: list[psutil.Process] = []
        self.log = ProgramLog(stderr, program.name, self._popen.pid)
        self._outbox = Outbox(stdin)
        self._inbox = Inbox(stdout, self._ended, self._outbox)
        self._has_answered = False
        self.over = False
        """It was closed or killed."""
        self.exit_status: int | None = None
        """Exit status once it is closed; None if it had to be ended."""

    @property
    def pid(self) -> int:
        """Process id of what was started, which may be a fence or ``conda run``."""
        return self._popen.pid

    def ask(
        self, header: Header, payload: bytes | None = None, *, timeout: float, answer_limit: int
    ) -> tuple[Header, bytes | None]:
        """Send a message and wait for the answer; what goes wrong, Ctrl-C included, kills the program.

        Args:
            header: Header of the message.
            payload: Payload of the message.
            timeout: Seconds for both.
            answer_limit: Bytes of payload that the answer may have.

        Raises:
            Fault: see :meth:`prbench.harness.methods.process.Inbox.receive`.
        """
        deadline = Deadline(timeout)
        try:
            # What a program writes before the first question is taken for its answer, however early or late it comes:
            # the message must not depend on which of the two processes was faster.
            if self._has_answered:
                self._inbox.require_silence()
            self._outbox.send(encode_message(header, payload), deadline)
            answer = self._inbox.receive(answer_limit, deadline)
            self._has_answered = True
            return answer
        except BaseException:
            self.kill()
            raise

    def close(self) -> None:
        """Close stdin, give the program time to end, then end it and what it started. May be called again."""
        if self.over or os.getpid() != self._owner:
            return
        self._known_kin = list(self._kin())  # once the program is gone, nobody knows whose children they were
        self._outbox.close()
        self._inbox.discard()
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.exit_status = self._popen.wait(EXIT_SECONDS)
        finally:  # Ctrl-C while waiting included
            self.kill()

    def kill(self) -> None:
        """End the program and what it started: SIGTERM, then SIGKILL. May be called again."""
        if self.over or os.getpid() != self._owner:
            return
        self.over = True
        self._inbox.discard()
        try:
            self._signal_all("terminate", TERM_SECONDS)
        finally:  # a second Ctrl-C does not leave anything behind either
            self._signal_all("kill", TERM_SECONDS)
        self._outbox.close()
        self.log.wait_for_end(0.5)
        if self._scratch is not None:
            self._scratch.cleanup()

    def _started(self, program: Program) -> subprocess.Popen[bytes]:
        directory = self._scratch.name if self._scratch is not None else program.directory
        try:
            return subprocess.Popen(
                program.words,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                cwd=directory,
                env=dict(program.environment),
                start_new_session=True,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # the same on Windows
            )
        except (OSError, ValueError) as error:
            if self._scratch is not None:
                self._scratch.cleanup()
            raise AdapterError(_cannot_start(program, error)) from error

    def _ended(self) -> str | None:
        status = self._popen.poll()
        return None if status is None else exit_story(status)

    def _signal_all(self, how: str, patience: float) -> None:
        """Send a signal to the program and its kin, and wait until they are gone."""
        until = Deadline(patience)
        kin = self._known_kin = list({*self._kin(), *filter(_runs, self._known_kin)})
        if sys.platform != "win32" and (kin or self._popen.poll() is None):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._popen.pid, signal.SIGTERM if how == "terminate" else signal.SIGKILL)
        for process in kin:
            with contextlib.suppress(psutil.Error):
                getattr(process, how)()
        if self._popen.poll() is None:
            getattr(self._popen, how)()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._popen.wait(until.remaining())
        while any(map(_runs, kin)) and until.remaining():
            time.sleep(0.01)

    def _kin(self) -> Iterator[psutil.Process]:
        """Yield the processes that the program has started and that still run: its descendants and its group."""
        # A grandchild whose parent has ended is no descendant any more, but still in the group.
        seen = {self._popen.pid}
        with contextlib.suppress(psutil.Error):
            for process in psutil.Process(self._popen.pid).children(recursive=True):
                seen.add(process.pid)
                yield process
        if sys.platform == "win32":
            return
        for pid in psutil.pids():
            with contextlib.suppress(psutil.Error, ProcessLookupError, PermissionError):
                if pid not in seen and os.getpgid(pid) == self._popen.pid:
                    process = psutil.Process(pid)
                    if _runs(process):
                        yield process


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.Error:
        return False


def _cannot_start(program: Program, error: Exception) -> str:
    origin = f"method '{program.name}': its program cannot be started"
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        if program.directory is not None and not program.directory.is_dir():
            return f"{origin}: expected the folder {program.directory} to start in, found none."
        return f"{origin}: expected the command '{program.words[0]}', found none on PATH. Correct it or give its path."
    if isinstance(error, PermissionError):
        return f"{origin}: '{program.words[0]}' may not be executed. Make it executable, or name its interpreter first."
    return f"{origin}: {error}. Correct the command."
