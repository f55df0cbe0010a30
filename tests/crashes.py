"""Work that dies before its first file operation, before its second, and so on: all that a kill can leave behind.

Only single-threaded interpreters may fork, so tests run this in one of their own (:func:`tried_by`).
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import pyarrow as pa

ROOT = Path(__file__).parents[1]
_DIED = 9
_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.link", "os.symlink", "os.truncate"}
_FOR_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT

os.fsync = lambda _file: None  # as in conftest.py, in the interpreters that tests start: they write thousands of files

Work = Callable[[Path], object]


def tried_by(module: str, folder: Path, *, check: str = "check") -> int:
    """Run a module's ``check(folder)`` in an interpreter of its own: the number of crashes that it has tried."""
    script = f"import sys, pathlib, {module} as killed; print(killed.{check}(pathlib.Path(sys.argv[1])))"
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script, str(folder)], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


def crashes(work: Work, base: Path) -> Iterator[Path]:
    """The folders that crashed work has left, one after the other; ends with the crash that came too late.

    Args:
        work: Writes below the folder that it is given; Arrow's own writing is not seen, what Python does around it is.
        base: Where the folders are made.
    """
    for operation in itertools.count(1):
        folder = base / str(operation)
        folder.mkdir(parents=True)
        if in_a_child(work, folder, dies_before=operation):
            yield folder
        else:
            return


def operations(work: Work, folder: Path) -> int:
    """Do work in this process, undisturbed; how many file operations it did."""
    count = itertools.count()
    _at_each_operation(str(folder), lambda: next(count))
    work(folder)
    return next(count)


def in_a_child(work: Work, folder: Path, *, dies_before: int = 0) -> bool:
    """Whether the work died before its so-manieth file operation; 0 lets it live.

    Raises:
        RuntimeError: if it failed otherwise.
    """
    pa.set_cpu_count(1)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            if dies_before:
                _die_before(dies_before, str(folder))
            work(folder)
            status = 0
        except BaseException:  # told to the parent by the status; pytest's own handlers must not run twice
            traceback.print_exc()
        finally:
            os._exit(status)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status not in (0, _DIED):
        raise RuntimeError(f"{folder}: ended with {status}")
    return status == _DIED


def killed_after(work: Work, folder: Path, seconds: float) -> bool:
    """Whether the work was killed (SIGKILL) some time after it began, anywhere, within Arrow's own writing too.

    Raises:
        RuntimeError: if it failed by itself.
    """
    pa.set_cpu_count(1)
    child = os.fork()
    if child == 0:
        status = 1
        try:
            work(folder)
            status = 0
        except BaseException:  # see in_a_child
            traceback.print_exc()
        finally:
            os._exit(status)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)  # not yet waited for, so that the number is still this child's
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status not in (0, -signal.SIGKILL):
        raise RuntimeError(f"{folder}: ended with {status}")
    return status == -signal.SIGKILL


def _die_before(operation: int, folder: str) -> None:
    count = itertools.count(1)

    def die_if_its_turn() -> None:
        if next(count) == operation:
            os._exit(_DIED)

    _at_each_operation(folder, die_if_its_turn)


def _at_each_operation(folder: str, act: Callable[[], object]) -> None:
    """Call something before each file operation below a folder."""

    def look(event: str, arguments: tuple) -> None:
        changes = bool((arguments[2] or 0) & _FOR_WRITING) if event == "open" else event in _CHANGES
        relative = event in ("os.remove", "os.rmdir")  # shutil.rmtree names what it deletes within its folder
        if changes and (relative or any(folder in str(place) for place in arguments[:2])):
            act()

    sys.addaudithook(look)
