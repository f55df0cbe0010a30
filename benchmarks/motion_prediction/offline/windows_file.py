"""The file of what a predictor may see: observed frames of windows, and nothing that names them.

Source: docs/offline.md#predictors.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from prbench.errors import InputFileError, UsageError
from prbench.files.arrays import Archive
from prbench.files.storage import atomic_path, sole_writer, text_digest, turn_into_paths, write_text
from prbench.harness.benchmark import load_benchmark
from prbench.harness.request import RunRequest
from prbench.sequences.dataset_info import notice, require_may_pass_on
from prbench_benchmarks.motion_prediction.batch import Condition, ObservedBatch
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol

BENCHMARK = "motion-prediction"
METADATA_KEY = "prbench_windows"
"""Name of the array that holds :class:`WindowsFileInfo` as JSON."""
FORMAT_VERSION = 1
_SUFFIX = ".npz"
_LARGEST = 8 * 1024**3  # bytes of one array
_REMEDY = "Export the windows again with `prbench export-conditions --benchmark motion-prediction`."


class WindowsFileInfo(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the rows were made with. A predictor may see it as it may see the rows."""

    format_version: int = FORMAT_VERSION
    condition: Condition
    seed: int
    samples: int
    """Futures of each window."""
    split: str
    limit: int | None
    fps: float
    n_future: int
    """Frames to predict."""
    joint_names: tuple[str, ...]
    protocol_version: int
    table: str
    """Fingerprint of the table: whoever has it recognises it."""


@dataclass(frozen=True, kw_only=True)
class WindowsRequest:
    """The windows to export, and the file for them.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    data: tuple[Path, ...]
    """The folder of one table of windows."""
    condition: str
    out: Path
    """``.npz``."""
    seed: int = 0
    samples: int = 50
    split: str = "test"
    limit: int | None = None
    permitted: Collection[str] = ()
    """Datasets whose licensor lets the user pass on recorded motion."""

    def __post_init__(self) -> None:
        turn_into_paths(self, "data", "out")
        if self.out.suffix.lower() != _SUFFIX:
            raise UsageError(f"{self.out}: expected a name that ends in {_SUFFIX}, found '{self.out.suffix}'.")
        if len(self.data) != 1:
            raise UsageError(
                f"--data: expected one table of windows, found {len(self.data)}. Windows of other tables may have other"
                " joints and rates: export each into a file of its own."
            )
        if self.samples < 1:
            raise UsageError(f"--samples: expected 1 or more, found {self.samples}.")


@dataclass(frozen=True)
class WindowsExport:
    """What was written."""

    out: Path
    dataset: str
    windows: int
    notices: tuple[str, ...]


@dataclass(frozen=True)
class WindowsFile:
    """An exported file in memory, sorted by opaque id."""

    info: WindowsFileInfo
    batch: ObservedBatch

    @property
    def opaque_ids(self) -> tuple[str, ...]:
        """Return the id of each row."""
        return opaque_ids(self.batch)


def opaque_ids(batch: ObservedBatch) -> tuple[str, ...]:
    """Return what rows are called outside: their keys, which tell nothing about where they come from."""
    return tuple(f"{key:016x}" for key in batch.key)


def export_windows(request: WindowsRequest) -> WindowsExport:
    """Write what a predictor may see of a table's windows, and nothing else.

    Raises:
        RedistributionError: if the dataset's terms keep its recordings.
        TableError: if the table is missing, edited or of an unknown version.
        UsageError: for another benchmark's condition, an empty split, or ``pose+gaze`` without gaze.
        StorageError: if the file cannot be written.
    """
    made = windows_of(request)
    info = made.table_info
    require_may_pass_on(info, f"a file of '{request.condition}' windows", request.permitted)
    said = notice(info, request.permitted)
    notices = request.out.with_suffix(".NOTICE.txt")
    batch = made.file.batch
    arrays: dict[str, Any] = {
        METADATA_KEY: np.array(msgspec.json.encode(made.file.info, order="sorted").decode()),
        "opaque_id": np.array(made.file.opaque_ids),
        "key": np.array(batch.key, dtype=np.int64),
        "observed_joints": batch.observed_joints,
    }
    if batch.gaze is not None and batch.gaze_valid is not None:
        arrays |= {"gaze": batch.gaze, "gaze_valid": batch.gaze_valid}
    with sole_writer(request.out), sole_writer(notices):
        if said:  # first, so that a file is never without what its terms ask
            write_text(notices, f"{said}\n")
        with atomic_path(request.out) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, **arrays)
    return WindowsExport(request.out, info.dataset, len(batch), (said,) if said else ())


@dataclass(frozen=True)
class MadeWindows:
    """The rows of a table as a file would hold them."""

    file: WindowsFile
    table_info: Any
    """Provenance of the table."""


def windows_of(request: WindowsRequest) -> MadeWindows:
    """Make the rows of a file; nothing is written."""
    benchmark = load_benchmark(BENCHMARK)
    condition = Condition(benchmark.condition(request.condition))
    asked = RunRequest(
        benchmark=BENCHMARK, method="offline", data=request.data, split=request.split, limit=request.limit
    )
    tables = benchmark.open_tables(asked)
    benchmark.rules(asked, tables)
    (cases,) = benchmark.choose(asked, tables)
    protocol = load_prediction_protocol()
    frame = protocol.evaluation.frame
    batch = next(cases.table.batches(condition, cases.places, frame=frame, size=len(cases)))[0]
    order = sorted(range(len(batch)), key=lambda row: batch.key[row])
    info = WindowsFileInfo(
        condition=condition,
        seed=request.seed,
        samples=request.samples,
        split=request.split,
        limit=request.limit,
        fps=batch.fps,
        n_future=batch.n_future,
        joint_names=batch.joint_names,
        protocol_version=protocol.version,
        table=text_digest("prbench windows", cases.table.identity),
    )
    return MadeWindows(WindowsFile(info, batch.chosen(order)), cases.table.info)


def read_windows(path: Path) -> WindowsFile:
    """Read an exported file.

    Raises:
        InputFileError: if it is missing, damaged, or no file of windows.
    """
    archive = Archive(path, remedy=_REMEDY)
    if METADATA_KEY not in archive.members:
        raise InputFileError(
            path, "", expected=f"a file of windows (with an array '{METADATA_KEY}')", found="none", remedy=_REMEDY
        )
    try:
        info = msgspec.json.decode(str(archive.read(METADATA_KEY, largest=1024**2)), type=WindowsFileInfo)
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        raise InputFileError(
            path, METADATA_KEY, expected="what prbench wrote about the file", found=str(error), remedy=_REMEDY
        ) from error
    names = ["key", "observed_joints", *(("gaze", "gaze_valid") if info.condition is not Condition.POSE else ())]
    archive.require(names)
    arrays: dict[str, Any] = {name: archive.read(name, largest=_LARGEST) for name in names}
    try:
        batch = ObservedBatch(
            condition=info.condition,
            fps=info.fps,
            n_future=info.n_future,
            joint_names=info.joint_names,
            observed_joints=arrays["observed_joints"],
            key=tuple(arrays["key"].tolist()),
            gaze=arrays.get("gaze"),
            gaze_valid=arrays.get("gaze_valid"),
        )
    except ValueError as error:
        raise InputFileError(
            path, "", expected="arrays of one number of windows", found=str(error), remedy=_REMEDY
        ) from error
    return WindowsFile(info, batch)
