"""Motion prediction: tables of windows, runs, and files of futures."""

from __future__ import annotations

from pathlib import Path

from prbench.engine.pool import ProcessPool
from prbench.errors import StorageError, TableError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench_benchmarks.motion_prediction.windows import build_windows, plan_windows
from tests.benchmarks.motion_prediction.windows import mogaze, walking, write
from tests.laws.cases import BadInput, SameBytes


def _native(folder: Path, **how) -> None:
    build_windows(plan_windows("mogaze", mogaze()), folder / "windows", **how)


def _run(folder: Path, **how) -> None:
    table = write(folder / "windows")
    asked = {"condition": "pose", "samples": 2, "batch_size": 2, "data": (table,), "out": folder / "run"}
    run_method(RunRequest(benchmark="motion-prediction", method="constant-velocity", **asked), **how)


def _onto_a_thesis(folder: Path, build) -> None:
    (folder / "thesis.txt").write_text("dear")
    build(folder)


SAME_BYTES = [
    SameBytes("windows", {"once": lambda f: write(f / "w") and None, "again": lambda f: write(f / "w") and None}),
    SameBytes(
        "windows of native files",
        {"in one process": _native, "by two processes": lambda folder: _native(folder, engine=ProcessPool(2))},
    ),
    SameBytes(
        "a run of motion prediction",
        {"in one process": _run, "by two workers": lambda folder: _run(folder, engine=ProcessPool(2))},
        unequal=("cost.json",),
    ),
]
BAD_INPUT = [
    BadInput(
        "windows in a folder of something else",
        lambda folder: _onto_a_thesis(folder, write),
        ("no table of windows",),
        StorageError,
    ),
    BadInput(
        "native windows in a folder of something else",
        lambda folder: _onto_a_thesis(folder, lambda out: build_windows(plan_windows("mogaze", mogaze()), out)),
        ("no table of windows",),
        StorageError,
    ),
    BadInput(
        "windows of captured beside estimated bodies",
        lambda folder: write(folder / "w", walking("a", 120), walking("b", 120, pose_source="egoallo")),
        ("found both: a and b",),
        TableError,
        unwritten=("w",),
    ),
]
