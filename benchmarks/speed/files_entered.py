"""Count the files that a build and a run of ADT enter: ``python benchmarks/speed/files_entered.py`` lists them.

A file counts when a function of it is called; importing it, or making its classes, does not. Worker processes
are not followed, so everything runs in one.
"""

from __future__ import annotations

import inspect
import sys
import tempfile
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import prbench
from prbench.cli import main

FOLDERS = ("prbench", "adapters", "benchmarks", "data_manifests")


def entered_files(commands: list[list[str]]) -> list[str]:
    """Return the project's files in which the commands call a function, relative to the checkout, sorted.

    Args:
        commands: Words of each command line, without ``prbench``.

    Raises:
        SystemExit: if a command fails.
    """
    root = Path(prbench.__file__).resolve().parents[1]
    seen: set[CodeType] = set()

    def watch(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            seen.add(frame.f_code)

    sys.setprofile(watch)
    try:
        codes = [main(words) for words in commands]
    finally:
        sys.setprofile(None)
    if any(codes):
        raise SystemExit(f"a command failed: exit codes {codes}")
    files = set()
    for code in seen:
        path = Path(code.co_filename)
        # A module's own code and the bodies of its classes run when it is imported: that is no call.
        called = code.co_flags & inspect.CO_OPTIMIZED and "<module>" not in code.co_name
        is_ours = path.is_relative_to(root) and path.relative_to(root).parts[0] in FOLDERS
        if called and is_ours and path != Path(__file__).resolve():
            files.add(str(path.relative_to(root)))
    return sorted(files)


def trace() -> None:
    """Make recordings in ADT's layout, then build a table of them and run a method over it while calls are traced."""
    with tempfile.TemporaryDirectory() as scratch:
        native, table, run = (f"{scratch}/{name}" for name in ("native", "table", "run"))
        if main(["synthesize", "adt", "--count", "4", "--seed", "2", "--out", native, "--quiet"]):
            raise SystemExit("recordings could not be made")
        build = ["build-dataset", "adt", "--root", native, "--out", table, "--quiet"]
        ask = ["run", "--method", "pr", "--condition", "goal-loc", "--data", table, "--out", run, "--quiet"]
        files = entered_files([build, ask])
    print("\n".join(files))
    print(f"{len(files)} files entered by a build and a run of ADT")


if __name__ == "__main__":
    trace()
