"""The program of a method while it runs: its environment, its pipes, its log, and how it ends."""

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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

import psutil

from prbench.engine.unseen import hide_process
from prbench.errors import AdapterError
from prbench.files.bounded import read_end
from prbench.files.storage import cache_folder
from prbench.harness.methods.messages import HEADER_LIMIT, Header, encode_message, parse_header

_SET_BY_LIBRARIES = ("KMP_DUPLICATE_LIB_OK",)  # by threadpoolctl, when it is imported
_NOT_THE_USERS = frozenset(name for name in _SET_BY_LIBRARIES if name not in os.environ)
_START = (
    "import json, runpy, sys; sys.path[:] = json.loads(sys.argv.pop(1));"
    " runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)


def users_environment() -> dict[str, str]:
    """Return the variables of this process without those that libraries set while prbench imported them."""
    return {name: value for name, value in os.environ.items() if name not in _NOT_THE_USERS}


def python_words(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module as ``python -m`` does, with this process's ``sys.path``.

    Args:
        module: Dotted name.
        arguments: Words that it finds in ``sys.argv[1:]``.
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
    """A program did not do its part. The text completes "its program …".

    Args:
        text: What it did instead.
        kind: ``ended`` (it is gone or has closed a pipe: starting it again may help), ``late`` (it has not done in time
            what it was asked for), ``broken`` (what it wrote is not the message that was due) or ``reported`` (it says
            itself that it failed, and goes on waiting).
    """

    def __init__(self, text: str, *, kind: Literal["ended", "late", "broken", "reported"] = "broken") -> None:
        super().__init__(text)
        self.kind = kind


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
    names = {int(each): each.name for each in signal.Signals} | {9: "SIGKILL; often the system that ran out of memory"}
    return names.get(number, "unknown")


EXIT_SECONDS = 5.0  # time for a program to end after its stdin was closed
TERM_SECONDS = 2.0  # time for it to end after SIGTERM
_KEPT_LOGS = 100
_TAIL_BYTES = 8192
_CHUNK = 1 << 16
_SLICE = 0.2  # seconds after which a wait looks whether the program still runs
_REMEDY = "Its stdout belongs to the protocol: print to stderr"


@dataclass(frozen=True)
class Program:
    """A method's program. Picklable, so that every worker can start its own; it knows nothing about tables.

    Attributes:
        name: Name in messages until it has introduced itself.
        words: The whole command: a fence, ``conda run`` and the like included.
        directory: Folder that it starts in; None for an empty temporary folder of its own.
        environment: The whole environment; nothing is inherited beside it.
        start_timeout: Seconds until it has introduced itself.
        batch_timeout: Seconds until a batch is answered.
        fence: ``process``, ``bubblewrap`` or ``container`` for what is kept at a distance; None for what is not.
        package: Command and environment of the user's own program, for the record: without the folders of this machine.
        expected_name: Name that it must introduce itself by; any name if None.
        readable: Files and folders that it needs beside the system's.
    """

    name: str
    words: tuple[str, ...]
    directory: Path | None
    environment: tuple[tuple[str, str], ...]
    start_timeout: float = 120.0
    batch_timeout: float = 600.0
    fence: str | None = None
    package: str | None = None
    expected_name: str | None = None
    readable: tuple[Path, ...] = ()
    in_container: bool = False


class ProgramProcess:
    """A started program. One request at a time; after a fault it is gone.

    Its stderr is a log file. A thread takes in at most a megabyte of its stdout before it is asked for, and each
    request is written by a thread of its own, so that neither side ever waits for the other beyond the time limit.
    """

    def __init__(self, program: Program) -> None:
        """Start it, in a session and process group of its own: Ctrl-C in the terminal is not for it.

        Raises:
            AdapterError: if the command or its folder does not exist, or cannot be run.
        """
        if program.fence is not None:
            hide_process()
        self._scratch = None
        if program.directory is None:
            self._scratch = tempfile.TemporaryDirectory(prefix="prbench-", ignore_cleanup_errors=True)
        self.log_path = _new_log(program.name)
        try:
            with open(self.log_path, "wb") as log:
                self._popen = subprocess.Popen(
                    program.words,
                    bufsize=0,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=log,
                    cwd=program.directory if self._scratch is None else self._scratch.name,
                    env=dict(program.environment),
                    start_new_session=True,
                    creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # the same on Windows
                )
        except (OSError, ValueError) as error:
            self._clear()
            command = f"'{program.words[0]}'"
            problem = f"{error}. Correct the command."
            if isinstance(error, PermissionError):
                problem = f"{command} may not be executed. Make it executable, or name its interpreter first."
            elif isinstance(error, FileNotFoundError | NotADirectoryError):
                problem = f"expected the command {command}, found none on PATH. Correct it or give its path."
                if program.directory is not None and not program.directory.is_dir():
                    problem = f"expected the folder {program.directory} to start in, found none."
            origin = f"method '{program.name}': its program cannot be started"
            raise AdapterError(f"{origin}: {problem}") from error
        self._owner = os.getpid()
        self._known_kin: list[psutil.Process] = []
        self._chunks: queue.Queue[bytes] = queue.Queue(maxsize=16)
        self._buffer = bytearray()
        self._discarding = threading.Event()
        threading.Thread(target=self._read_on, name="stdout of a program", daemon=True).start()
        self._writer: threading.Thread | None = None
        self._stdin_broken = threading.Event()
        self._written = self._total = 0
        self._has_answered = False
        self._seconds = self._end = 0.0
        self.over = False  # It was closed or killed

    def log_tail(self, lines: int = 10) -> list[str]:
        """Return the last lines of stderr, overlong ones cut, without what would move the cursor of a terminal."""
        if not self.log_path.is_file():
            return []
        text = read_end(self.log_path, _TAIL_BYTES).decode(errors="replace")
        shown = []
        for line in text.splitlines():
            plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line.expandtabs(4))
            plain = "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in plain)
            if plain.strip():
                shown.append(plain[:400])
        return shown[-lines:]

    def ask(
        self, header: Header, payload: bytes | None = None, *, timeout: float, answer_limit: int
    ) -> tuple[Header, bytes | None]:
        """Send a message and wait for the answer; what goes wrong, Ctrl-C included, kills the program.

        Args:
            header: Header of the message.
            payload: Payload of the message.
            timeout: Seconds for both.
            answer_limit: Bytes of payload that the answer may have; a larger one is refused unread.

        Raises:
            Fault: if what comes is no message, or not all of it comes in time, or the program ends or closes a pipe.
        """
        self._seconds = timeout
        self._end = time.monotonic() + timeout
        try:
            # What a program writes before the first question is taken for its answer, however early or late it comes:
            # the message must not depend on which of the two processes was faster.
            while self._has_answered and not self._chunks.empty():
                self._buffer += self._chunks.get_nowait()
            if self._has_answered and self._buffer:
                found = excerpt(self._buffer)
                raise Fault(f"wrote to stdout without being asked, behind its last answer: {found}. {_REMEDY}")
            self._send(encode_message(header, payload))
            answer = self._receive(answer_limit)
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
        self._close_stdin()
        self._discarding.set()
        try:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._popen.wait(EXIT_SECONDS)
        finally:  # Ctrl-C while waiting included
            self.kill()

    def kill(self) -> None:
        """End the program and what it started: SIGTERM, then SIGKILL. May be called again."""
        if self.over or os.getpid() != self._owner:
            return
        self.over = True
        self._discarding.set()
        try:
            self._signal_all("terminate", TERM_SECONDS)
        finally:  # a second Ctrl-C does not leave anything behind either
            self._signal_all("kill", TERM_SECONDS)
        self._close_stdin()
        self._clear()

    def _clear(self) -> None:
        """Remove the folder of its own and an empty log."""
        if self._scratch is not None:
            self._scratch.cleanup()
        with contextlib.suppress(OSError):
            if self.log_path.is_file() and not self.log_path.stat().st_size:
                self.log_path.unlink()
                self.log_path.parent.rmdir()

    def _close_stdin(self) -> None:
        # A thread that still writes holds the pipe; it ends when the program does.
        if self._writer is None or not self._writer.is_alive():
            with contextlib.suppress(OSError):
                self._stdin.close()

    @property
    def _stdin(self) -> IO[bytes]:
        assert self._popen.stdin is not None
        return self._popen.stdin

    def _remaining(self) -> float:
        return max(0.0, self._end - time.monotonic())

    def _send(self, message: Sequence[bytes]) -> None:
        if self._writer is not None:
            self._writer.join(self._remaining())
            if self._writer.is_alive():
                raise Fault(f"did not read its stdin within {self._seconds:g} s ({self._progress()})", kind="late")
        self._written = 0
        self._total = sum(map(len, message))

        def write() -> None:
            # Without a copy, and in pieces, so that progress can be told when a program stops reading.
            try:
                for piece in message:
                    left = memoryview(piece)
                    while left:
                        taken = os.write(self._stdin.fileno(), left[:_CHUNK])
                        self._written += taken
                        left = left[taken:]
            except (OSError, ValueError):  # a broken pipe, which Windows calls an invalid argument; or it was closed
                self._stdin_broken.set()

        self._writer = threading.Thread(target=write, name="stdin of a program", daemon=True)
        self._writer.start()

    def _progress(self) -> str:
        return f"{self._written:,} of {self._total:,} bytes of the request went into its stdin"

    def _receive(self, payload_limit: int) -> tuple[Header, bytes | None]:
        """Wait for one message."""
        while (end := self._buffer.find(b"\n", 0, HEADER_LIMIT)) < 0:
            found = len(self._buffer)
            if found >= HEADER_LIMIT:
                why = f"where a header has at most {HEADER_LIMIT:,}: {excerpt(self._buffer)}. {_REMEDY}"
                raise Fault(f"wrote {found:,} bytes without a line end, {why}")
            if found and self._buffer[0] != ord("{"):
                break
            self._take_in(f"{found:,} bytes of a header without its end" if found else "")
        line = self._cut(end + 1 if end >= 0 else len(self._buffer))
        reason = ""
        try:
            if line.startswith(b"{"):
                header = parse_header(line)
                if "bytes" not in header:
                    return header, None
                return header, self._payload(header["bytes"], payload_limit)
        except ValueError as error:
            reason = f" ({error})"
        raise Fault(f"wrote a line that is no message: {excerpt(line)}{reason}. {_REMEDY}")

    def _payload(self, size: int, limit: int) -> bytes:
        if size > limit:
            raise Fault(f"announced a payload of {size:,} bytes, where at most {limit:,} can be the answer")
        while (found := len(self._buffer)) < size:
            try:
                self._take_in(f"{found:,} of {size:,} bytes of its payload")
            except Fault as fault:
                if fault.kind != "late":
                    raise
                problem = f"announced a payload of {size:,} bytes and wrote {found:,} of them within {self._seconds:g}"
                problem += " s. 'bytes' has to be the size of what follows, all of it written and flushed; if it was"
                raise Fault(f"{problem} still writing, raise the limit with --timeout") from None
        return self._cut(size)

    def _cut(self, size: int) -> bytes:
        piece = bytes(memoryview(self._buffer)[:size])
        del self._buffer[:size]
        return piece

    def _take_in(self, so_far: str) -> None:
        """Wait for the next bytes."""
        behind = f", after {so_far}" if so_far else ""
        patience = 0.0  # until when a program that reads no more may answer
        while remaining := self._remaining():
            status = self._popen.poll()
            try:
                chunk = self._chunks.get(timeout=min(remaining, _SLICE))
            except queue.Empty:
                if status is not None:  # already before the wait, so nothing of it is on its way
                    raise Fault(f"{exit_story(status)}{behind}", kind="ended") from None
                if self._stdin_broken.is_set():
                    patience = patience or time.monotonic() + 2 * _SLICE
                    if time.monotonic() > patience:
                        raise Fault(f"closed its stdin{behind}", kind="ended") from None
                continue
            if chunk:
                self._buffer += chunk
                return
            # A pipe closes a moment before its process is gone.
            with contextlib.suppress(subprocess.TimeoutExpired):
                status = self._popen.wait(1.0)
            raise Fault(f"{'closed its stdout' if status is None else exit_story(status)}{behind}", kind="ended")
        unread = f" ({self._progress()})" if self._written < self._total else ""
        raise Fault(f"did not answer within {self._seconds:g} s{unread}{behind}", kind="late")

    def _read_on(self) -> None:
        """Take in stdout; a thread, because a wait for a pipe cannot be given up."""
        stdout = self._popen.stdout
        assert stdout is not None
        with stdout:
            chunk = b"first"
            while chunk:
                try:
                    chunk = os.read(stdout.fileno(), _CHUNK)
                except OSError:
                    chunk = b""
                # Once nobody asks any more it is read on, so that the program can end, but nothing is kept.
                while not self._discarding.is_set():
                    with contextlib.suppress(queue.Full):
                        self._chunks.put(chunk, timeout=_SLICE)
                        break

    def _signal_all(self, how: str, patience: float) -> None:
        """Send a signal to the program and its kin, and wait until they are gone."""
        until = time.monotonic() + patience
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
                self._popen.wait(max(0.0, until - time.monotonic()))
        while any(map(_runs, kin)) and time.monotonic() < until:
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


def _new_log(name: str) -> Path:
    """Return a path for the log of a program, and delete all but the newest logs.

    Folders and odd characters of the name are left out: ``python-my-glide.py---fast`` of
    ``/opt/envs/glide/bin/python '/home/me/my glide.py' --fast``.
    """
    folder = cache_folder() / "logs"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # a cache that cannot be written must not stop the program
        folder = Path(tempfile.gettempdir())
    for path in sorted(folder.glob("*.log"), key=lambda path: path.stat().st_mtime, reverse=True)[_KEPT_LOGS:]:
        path.unlink(missing_ok=True)
    without_folders = re.sub(r"[^\s'\"]*[/\\]", "", name)
    shown = re.sub(r"[^A-Za-z0-9._-]+", "-", without_folders).strip("-.")[:60] or "program"
    return folder / f"{shown}-{time.time_ns()}.log"
