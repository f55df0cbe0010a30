"""Declarations of installed methods, each imported in a process of its own, with a time limit.

Importing a package of others may print, leave the interpreter, crash it or never end. Here that costs one line of a
list, never the list.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path
from typing import IO, Any

from prbench.errors import PrbenchError
from prbench.harness.methods.installed import InstalledEntry, list_adapters, offered_twice
from prbench.harness.methods.loading import find_adapter, load_adapter
from prbench.harness.methods.motions import Declared
from prbench.harness.methods.process import python_words, users_environment
from prbench.harness.methods.remote import MethodGroup, group_of
from prbench.protocol.manifests import PROTOCOL_NAME, find_benchmark

TIME_LIMIT = 30.0  # seconds; the slowest of our own takes 5 s on a busy core
_TAIL = 4096  # bytes of output that are kept
_LONGEST_LINE = 300  # characters
_LOOK_EVERY = 0.2  # seconds, to see whether it shall be stopped
_CHILD = "prbench.harness.methods.describe"


@dataclass(frozen=True)
class Description:
    """One installed method, imported and asked, or the reason why it could not be."""

    method: InstalledEntry
    """Its package metadata."""
    conditions: tuple[str, ...] = ()
    """Conditions that it can be given, of those of its benchmark."""
    fitted: bool = False
    """It learns from a table (``fit``), so a run fits it by itself when it is given no weights."""
    max_frames: int | None = None
    """Longest motion that it generates, in frames; None if there is no limit."""
    native_fps: float | None = None
    """Rate of its motions in frames per second; None if it takes any."""
    motionless: bool = False
    """Its motions stand still."""
    weights: tuple[str, ...] = ()
    """Files or folders that it brings, over all its conditions."""
    import_seconds: float | None = None
    """Seconds that importing its module took."""
    load_seconds: float | None = None
    """Seconds that ``load()`` took after that."""
    printed: int = 0
    """Bytes that it wrote to stdout and stderr meanwhile."""
    error: str = ""
    """Reason in one line; empty if there is none."""


def describe_adapters(
    names: Iterable[str] | None = None,
    *,
    benchmark: str = PROTOCOL_NAME,
    time_limit: float = TIME_LIMIT,
    workers: int | None = None,
) -> list[Description]:
    """Import the installed methods, several at a time, and say what each declares.

    Args:
        names: Of methods; None for all.
        benchmark: Whose methods are meant.
        time_limit: Seconds for each.
        workers: Processes at a time; None for one a core.

    Returns:
        One description a method, in the order of :func:`~prbench.harness.methods.installed.list_adapters`.
    """
    installed = list_adapters(find_benchmark(benchmark).entry_points)
    wanted = None if names is None else frozenset(names)
    chosen = [method for method in installed if wanted is None or method.name in wanted]
    twice = offered_twice(installed)
    stop = threading.Event()

    def describe(method: InstalledEntry) -> Description:
        if method.name in twice:
            return Description(method, error="another package offers the same name; uninstall one of them")
        return describe_adapter(method, benchmark=benchmark, time_limit=time_limit, stop=stop)

    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            return list(pool.map(describe, chosen))
        finally:
            stop.set()  # after Ctrl-C nobody waits for the rest


def describe_adapter(
    method: InstalledEntry,
    *,
    benchmark: str = PROTOCOL_NAME,
    time_limit: float = TIME_LIMIT,
    stop: threading.Event | None = None,
) -> Description:
    """Import one method in a process of its own and ask it; whatever it does there becomes one line.

    Args:
        method: As listed.
        benchmark: Whose method it is.
        time_limit: Seconds after which the process is ended.
        stop: Ends it before that, once set.
    """
    if method.problem:
        return Description(method, error=method.problem)
    with tempfile.TemporaryDirectory(prefix="prbench-describe-", ignore_cleanup_errors=True) as folder:
        report = Path(folder) / "report.jsonl"
        child = _Child.start(method, benchmark, report)
        status = child.wait(time_limit, stop or threading.Event())
        # Everything that the process put down before it ended, later lines over earlier ones.
        said: dict = {}
        for line in report.read_text(encoding="utf-8").splitlines() if report.is_file() else []:
            said |= json.loads(line)
    if said.get("error"):
        return Description(method, import_seconds=said.get("import_seconds"), error=_line(said["error"]))
    if "conditions" in said:
        declared: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in said.items()
        }
        del declared["stage"]
        return Description(method, printed=child.printed, **declared)
    return Description(method, printed=child.printed, error=_line(_ending(said, status, time_limit, child.tail)))


def _ending(said: dict, status: int | None, time_limit: float, tail: str) -> str:
    """Say how a process ended that never finished its report."""
    doing = {"import": "while it was imported", "load": "in load()"}.get(
        said.get("stage", ""), "before it was imported"
    )
    if status is None:
        return f"took longer than {time_limit:g} s {doing} and was stopped. Import heavy packages on first use"
    last = next((line for line in reversed(tail.splitlines()) if line.strip()), "")
    output = f"; it last printed: {last.strip()}" if last else ""
    if status < 0:
        return f"crashed {doing}: killed by {_signal_name(-status)}{output}"
    return f"left the process {doing}, with exit status {status}{output}"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _line(text: str) -> str:
    """Return a message as one line of bounded length."""
    line = " ".join(text.split())
    return line if len(line) <= _LONGEST_LINE else line[: _LONGEST_LINE - 2] + " …"


@dataclass
class _Child:
    """The process that imports a method; of what it prints only the end is kept."""

    process: subprocess.Popen[bytes]
    reader: threading.Thread | None = None
    printed: int = 0
    tail: str = ""

    @classmethod
    def start(cls, method: InstalledEntry, benchmark: str, report: Path) -> _Child:
        """Start importing a method, from where this process would import it."""
        process = subprocess.Popen(
            python_words(_CHILD, method.name, benchmark, str(report)),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=users_environment(),
            start_new_session=True,
        )
        assert process.stdout is not None
        child = cls(process)
        child.reader = threading.Thread(target=child._read, args=(process.stdout,), daemon=True)
        child.reader.start()
        return child

    def wait(self, time_limit: float, stop: threading.Event) -> int | None:
        """The exit status, or None if it had to be stopped; nothing that it started is left behind."""
        deadline = time.monotonic() + time_limit
        try:
            while time.monotonic() < deadline and not stop.is_set():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return self.process.wait(_LOOK_EVERY)
            return None
        finally:
            self._stop()

    def _read(self, stream: IO[bytes]) -> None:
        kept = b""
        while part := os.read(stream.fileno(), 65536):
            self.printed += len(part)
            kept = (kept + part)[-_TAIL:]
            self.tail = kept.decode("utf-8", "replace")

    def _stop(self) -> None:
        """End the process and whatever it has started."""
        if hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended, and so has what it started
                os.killpg(self.process.pid, signal.SIGKILL)
        else:
            self.process.kill()
        self.process.wait()
        if self.reader is not None:
            self.reader.join(timeout=1.0)  # something that left the group may still hold the pipe


def main(name: str, benchmark: str, report: Path) -> None:
    """Import, load and ask the method; ends the process at once, without waiting for threads that it may have left."""
    group = group_of(benchmark)
    method = find_adapter(name, entry_points=group.entry_points)
    _write(report, stage="import")
    started = time.perf_counter()
    try:
        importlib.import_module(method.target.partition(":")[0].strip())
    except BaseException as error:  # a plug-in may raise anything, SystemExit and KeyboardInterrupt too
        said = f"cannot be imported: {type(error).__name__}: {error}".rstrip(".: ")
        _write(report, error=said + _remedy(error, method))
        return
    imported = time.perf_counter()
    _write(report, stage="load", import_seconds=round(imported - started, 3))
    try:
        adapter = load_adapter(name, None, {}, "cpu", group=group)
        _write(report, load_seconds=round(time.perf_counter() - imported, 3), **declarations(adapter, group))
    except PrbenchError as error:
        said = str(error).removeprefix(_origin(method)).rstrip(".")
        _write(report, error=said + _remedy(error.__cause__, method))
    except BaseException as error:
        _write(report, error=f"{type(error).__name__}: {error}")


def declarations(adapter: Any, group: MethodGroup) -> dict:
    """Return the declarations of a method as plain values."""
    declared = Declared.by(adapter, origin="it", conditions=group.conditions)
    weights_for = getattr(adapter, "weights_for", None)
    paths = [weights_for(condition) for condition in sorted(declared.conditions)] if weights_for is not None else []
    return {
        "conditions": sorted(condition.value for condition in declared.conditions),
        "fitted": hasattr(adapter, "fit"),
        "max_frames": declared.max_frames,
        "native_fps": declared.native_fps,
        "motionless": declared.motionless,
        "weights": sorted({Path(path).name for path in paths if path is not None}),
    }


def _origin(method: InstalledEntry) -> str:
    return f"adapter '{method.name}' (package {method.package} {method.version}, {method.target}): "


def _remedy(error: BaseException | None, method: InstalledEntry) -> str:
    """Say how to install a module that is missing, if the package's own metadata tell."""
    if not isinstance(error, ModuleNotFoundError) or not error.name:
        return ""
    missing = error.name.partition(".")[0]
    for requirement in _requirements(method.package):
        package = re.match(r"[\w.-]+", requirement)
        if package is None or _normalised(package[0]) != _normalised(missing):
            continue
        extra = re.search(r"extra\s*==\s*['\"]([\w.-]+)['\"]", requirement)
        wanted = f"{method.package}[{extra[1]}]" if extra else package[0]
        return f". Run: pip install '{wanted}'"
    return f". The package does not say what brings the module '{missing}'; see its documentation"


def _requirements(package: str) -> list[str]:
    try:
        return requires(package) or []
    except PackageNotFoundError:
        return []


def _normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _write(report: Path, **values: object) -> None:
    with open(report, "a", encoding="utf-8") as file:
        file.write(json.dumps(values) + "\n")


if __name__ == "__main__":
    sys.dont_write_bytecode = True  # looking at a method leaves no files in its package
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
    with contextlib.suppress(Exception):  # a method may have closed or replaced it; what it printed is counted whole
        sys.stdout.flush()
    os._exit(0)
