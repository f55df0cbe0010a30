"""The running program: started, asked, ended with everything that it started itself."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil

from prbench.errors import AdapterError
from prbench.harness.methods.remote.faults import exit_story
from prbench.harness.methods.remote.log import ProgramLog
from prbench.harness.methods.remote.messages import Header, encode_message
from prbench.harness.methods.remote.pipes import Deadline, Inbox, Outbox

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
            Fault: see :meth:`prbench.harness.methods.remote.pipes.Inbox.receive`.
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
