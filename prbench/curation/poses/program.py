"""Run a foreign program: with a log, a time limit, and nothing left behind."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from prbench.errors import StorageError, UsageError

_GRACE = 5.0  # seconds between asking a program to end and ending it
_TAIL_BYTES = 4096
_TAIL_LINES = 3
_UNPRINTABLE = re.compile(r"[^\x20-\x7e]+")


def run_program(
    command: Sequence[str], *, folder: Path, environment: Mapping[str, str], log: Path, timeout: float
) -> str:
    """Run a program without a shell, everything it prints into a log, and end it when its time is up.

    Args:
        command: Program and arguments.
        folder: Where it runs.
        environment: Added to this process's environment.
        log: Overwritten.
        timeout: Seconds.

    Returns:
        What went wrong, with the last words of the log; empty if nothing.

    Raises:
        UsageError: if it cannot be started.
        StorageError: if the log cannot be written.
    """
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        output = open(log, "wb")  # noqa: SIM115 (closed by the with below)
    except OSError as error:
        raise StorageError(f"{log}: cannot be written ({error.strerror}). Choose another folder.") from error
    with output:
        try:
            process = subprocess.Popen(
                list(command),
                cwd=folder,
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                # A group of its own, so that its children can be ended with it.
                start_new_session=os.name == "posix",
            )
        except OSError as error:
            raise UsageError(
                f"cannot start {command[0]} in {folder}: {error.strerror}."
                " Check python, folder and command in the config."
            ) from error
        try:
            code = process.wait(timeout)
            how = f"ended with exit code {code}" if code else ""
        except subprocess.TimeoutExpired:
            how = "ran out of time"
        finally:
            _end(process)
    if not how:
        return ""
    # The last lines that can be printed, whatever else the log holds.
    with open(log, "rb") as file:
        file.seek(0, 2)
        file.seek(max(file.tell() - _TAIL_BYTES, 0))
        text = file.read().decode("utf-8", errors="replace")
    lines = [_UNPRINTABLE.sub(" ", line).strip()[-160:] for line in text.splitlines()]
    kept = [line for line in lines if line][-_TAIL_LINES:]
    said = f" ('{' / '.join(kept)}')" if kept else ""
    return f"{how}{said}; its log is {log}"


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the program and what it started; nothing to do where it has ended and has no children."""
    # Also after a good end: a child that still runs would hold the GPU.
    _signal(process, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_GRACE)
    # The group may outlive its leader, and only POSIX has groups.
    if process.poll() is None or os.name == "posix":
        _signal(process, getattr(signal, "SIGKILL", signal.SIGTERM))
    process.wait()


def _signal(process: subprocess.Popen[bytes], number: int) -> None:
    """Send a signal to the whole group where there are groups, so that children of the program end too."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if os.name == "posix":
            os.killpg(process.pid, number)
        elif process.poll() is None:
            process.terminate()
