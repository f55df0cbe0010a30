"""Declarations of installed methods, each imported in a process of its own, with a time limit.

Importing a package of others may print, leave the interpreter, crash it or never end. Here that costs one line of a
list, never the list.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prbench.errors import PrbenchError
from prbench.harness.methods.installed import InstalledEntry, list_adapters, offered_twice
from prbench.harness.methods.loading import find_adapter, load_adapter
from prbench.harness.methods.motions import Declared
from prbench.harness.methods.process import exit_story, python_words, users_environment
from prbench.harness.methods.remote import MethodGroup, group_of
from prbench.protocol.manifests import PROTOCOL_NAME, find_benchmark

TIME_LIMIT = 30.0  # seconds; the slowest of our own takes 5 s on a busy core
_LONGEST_LINE = 300  # characters
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
    running: list[subprocess.Popen[bytes]] = []

    def describe(method: InstalledEntry) -> Description:
        if method.problem:
            return Description(method, error=method.problem)
        if method.name in twice:
            return Description(method, error="another package offers the same name; uninstall one of them")
        return _described(method, benchmark, time_limit, running)

    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            return list(pool.map(describe, chosen))
        finally:
            for process in running:  # after Ctrl-C nobody waits for the rest
                _end(process)


def _described(
    method: InstalledEntry, benchmark: str, time_limit: float, running: list[subprocess.Popen[bytes]]
) -> Description:
    """Import one method in a process of its own and ask it; whatever it does there becomes one line."""
    with tempfile.TemporaryDirectory(prefix="prbench-describe-", ignore_cleanup_errors=True) as folder:
        report = Path(folder) / "report.jsonl"
        printed = Path(folder) / "printed"
        with open(printed, "wb") as output:
            process = subprocess.Popen(
                python_words(_CHILD, method.name, benchmark, str(report)),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=users_environment(),
                start_new_session=True,
            )
        running.append(process)
        status = None
        with contextlib.suppress(subprocess.TimeoutExpired):
            status = process.wait(time_limit)
        _end(process)  # and what it started
        # Everything that the process put down before it ended, later lines over earlier ones.
        said: dict[str, Any] = {}
        for line in report.read_text(encoding="utf-8").splitlines() if report.is_file() else []:
            said |= json.loads(line)
        if "conditions" in said:
            del said["stage"]
            return Description(
                method, **{key: tuple(value) if isinstance(value, list) else value for key, value in said.items()}
            )
        error = said.get("error", "")
        if not error:
            stages = {"import": "while it was imported", "load": "in load()"}
            doing = stages.get(said.get("stage", ""), "before it was imported")
            error = f"took longer than {time_limit:g} s {doing} and was stopped. Import heavy packages on first use"
            if status is not None:
                lines = [line for line in printed.read_text(errors="replace")[-4096:].splitlines() if line.strip()]
                output_end = f"; it last printed: {lines[-1].strip()}" if lines else ""
                error = f"its process {exit_story(status)} {doing}{output_end}"
    line = " ".join(error.split())
    return Description(method, error=line if len(line) <= _LONGEST_LINE else line[: _LONGEST_LINE - 2] + " …")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process and whatever it has started."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):  # it has ended, and so has what it started
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()


def main(name: str, benchmark: str, report: Path) -> None:
    """Import, load and ask the method."""

    def write(**values: object) -> None:
        with open(report, "a", encoding="utf-8") as file:
            file.write(json.dumps(values) + "\n")

    group = group_of(benchmark)
    method = find_adapter(name, entry_points=group.entry_points)
    write(stage="import")
    try:
        importlib.import_module(method.target.partition(":")[0].strip())
    except BaseException as error:  # a plug-in may raise anything, SystemExit and KeyboardInterrupt too
        write(error=f"cannot be imported: {type(error).__name__}: {error}".rstrip(".: "))
        return
    write(stage="load")
    origin = f"adapter '{method.name}' (package {method.package} {method.version}, {method.target}): "
    try:
        write(**declarations(load_adapter(name, None, {}, "cpu", group=group), group))
    except PrbenchError as error:
        write(error=str(error).removeprefix(origin).rstrip("."))
    except BaseException as error:
        write(error=f"{type(error).__name__}: {error}")


def declarations(adapter: Any, group: MethodGroup) -> dict[str, Any]:
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


if __name__ == "__main__":
    sys.dont_write_bytecode = True  # looking at a method leaves no files in its package
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
    with contextlib.suppress(Exception):  # a method may have closed or replaced it
        sys.stdout.flush()
    os._exit(0)  # at once, without waiting for threads that the method may have left
