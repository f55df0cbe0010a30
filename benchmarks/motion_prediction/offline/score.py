"""Finished futures in a file, scored by the code that scores a run."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.engine import Engine, InProcess
from prbench.errors import AdapterError, InputFileError, PredictionsError, UsageError
from prbench.files.arrays import Archive
from prbench.files.storage import file_digest, sole_writer, turn_into_paths
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.installed import name_problem
from prbench.harness.preparation import PreparedDataset, PreparedRun, run_record
from prbench.harness.request import ProgressCallback, RunRequest, silent
from prbench.harness.run import score_prepared
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import PredictionRows, write_part
from prbench.harness.run_folder.record import FILE, MethodRecord
from prbench.harness.run_folder.summary import DatasetSummary
from prbench_benchmarks.motion_prediction.batch import Futures
from prbench_benchmarks.motion_prediction.offline.windows_file import (
    BENCHMARK,
    WindowsFile,
    WindowsRequest,
    read_windows,
    windows_of,
)

_ELSEWHERE = "offline"
_LARGEST_IDS = 1024**3
_NAMED = 3  # ids listed in a message


@dataclass(frozen=True, kw_only=True)
class FuturesRequest:
    """Finished futures, and the windows that they were made from.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    futures: Path
    """``.npz`` with ``opaque_id`` (n,) and ``joints`` (n, K, F, J, 3), metres, in the frame of the observed joints."""
    conditions: Path
    """The file of `prbench export-conditions` that they were made from."""
    data: tuple[Path, ...]
    """The folder of the table that it was exported from."""
    name: str | None = None
    """Name of the predictor; by default that of the file."""
    one_design: bool = False
    """The K futures of a window are one design: fewer have no scores."""
    out: Path | None = None
    """Run folder to write, which a leaderboard reads; nothing is written without it."""

    def __post_init__(self) -> None:
        turn_into_paths(self, "futures", "conditions", "data", "out")
        if self.futures.suffix.lower() != ".npz":
            raise UsageError(f"{self.futures}: expected futures in a file that ends in .npz, found another name.")
        problem = name_problem(self.method, own=load_benchmark(BENCHMARK).about.methods)
        if problem:
            raise UsageError(f"{problem}. Say what the predictor is called with --name.")

    @property
    def method(self) -> str:
        """Return the name of the predictor."""
        return self.name or self.futures.stem


@dataclass(frozen=True)
class FuturesReport:
    """Scores of finished futures."""

    summary: DatasetSummary
    folder: Path | None
    """The run folder; None if nothing was written."""
    origin: str


def score_futures(
    request: FuturesRequest, *, engine: Engine | None = None, progress: ProgressCallback = silent
) -> FuturesReport:
    """Score futures as a run scores those of a method that it asks.

    Args:
        request: What to score.
        engine: Where the work is done; changes no value.
        progress: Called after every scored batch.

    Raises:
        PredictionsError: if windows are missing, repeated or unknown, futures have another shape or are not finite, or
            the conditions file is not of this table.
        InputFileError: if a file is missing or damaged.
        StorageError: if the run folder cannot be written.
    """
    windows = read_windows(request.conditions)
    _require_from_table(windows, request)
    joints = _joints(request.futures, windows)
    with _folder(request.out) as out, sole_writer(out):
        prepared = _prepared(request, windows, out)
        folder = RunFolder.prepare(prepared.out, prepared.record)
        dataset = prepared.datasets[0]
        files = folder.dataset(dataset.name)
        row_of = {key: row for row, key in enumerate(windows.batch.key)}
        for index, question in dataset.work.questions(frozenset(range(len(dataset.work.plan)))):
            batch = question.batch  # type: ignore[attr-defined]  # the benchmark's own kind of question
            part = joints[[row_of[key] for key in batch.key]]
            n_frames = np.full(len(batch), batch.n_future)
            samples = [PredictionRows.from_padded(part[:, k], n_frames) for k in range(windows.info.samples)]
            seeds = [batch.key] * windows.info.samples
            ids = dataset.ids(dataset.work.plan[index])
            write_part(files.part(index), ids, seeds, samples, protocol_version=prepared.rules.version)
        summaries = score_prepared(prepared, folder, engine=engine or InProcess(), progress=progress)
    return FuturesReport(summaries[0], request.out, prepared.record.method.origin)


@contextmanager
def _folder(out: Path | None) -> Iterator[Path]:
    if out is not None:
        yield out
        return
    with tempfile.TemporaryDirectory(prefix="prbench-futures-") as temporary:
        yield Path(temporary) / "run"


def _prepared(request: FuturesRequest, windows: WindowsFile, out: Path) -> PreparedRun:
    """Everything that a run knows before it scores, with a method that is a file."""
    info = windows.info
    benchmark = load_benchmark(BENCHMARK)
    asked = RunRequest(
        benchmark=BENCHMARK,
        method=request.method,
        data=request.data,
        condition=info.condition.value,
        split=info.split,
        limit=info.limit,
        seed=info.seed,
        samples=info.samples,
        batch_size=benchmark.about.batch_size,
        device=_ELSEWHERE,
        out=out,
    )
    tables = benchmark.open_tables(asked)
    rules = benchmark.rules(asked, tables)
    (cases,) = benchmark.choose(asked, tables)
    method = MethodRecord(
        name=request.method,
        kind=FILE,
        package=request.futures.name,
        version=file_digest(request.futures)[:12],
        weights=None,
        weights_digest=None,
        options={},
        max_frames=None,
        native_fps=None,
        motionless=False,
        one_design=request.one_design,
    )
    work = benchmark.work(asked, cases, method=method, condition=info.condition, rules=rules)
    datasets = (PreparedDataset(cases, cases, None, work),)
    record = run_record(asked, info.condition, method, datasets, rules)
    record = msgspec.structs.replace(record, threads=0, packages={})
    return PreparedRun(asked, benchmark, record, datasets, out, rules)


def _require_from_table(windows: WindowsFile, request: FuturesRequest) -> None:
    """Refuse a file of windows that the table does not give, value by value.

    Raises:
        PredictionsError: naming what differs.
    """
    info = windows.info
    made = windows_of(
        WindowsRequest(
            data=request.data,
            condition=info.condition.value,
            out=request.conditions,
            seed=info.seed,
            samples=info.samples,
            split=info.split,
            limit=info.limit,
        )
    ).file
    if made.info.table != info.table:
        raise PredictionsError(
            f"{request.conditions}: expected windows of {request.data[0]}, found those of another table. Give --data"
            " the very table that they were exported from."
        )
    same = made.info == info and made.batch.key == windows.batch.key
    arrays = ("observed_joints", "gaze", "gaze_valid")
    if not same or any(
        not np.array_equal(getattr(made.batch, name), getattr(windows.batch, name))
        for name in arrays
        if getattr(made.batch, name) is not None
    ):
        raise PredictionsError(
            f"{request.conditions}: expected what {request.data[0]} gives, found something else. The file was changed:"
            " export the windows again."
        )


def _joints(path: Path, windows: WindowsFile) -> Float[np.ndarray, "windows samples future joints 3"]:
    """Read the futures in the order of the windows' file.

    Raises:
        PredictionsError: naming windows that are missing, repeated or unknown, or what is wrong with the futures.
    """
    archive = Archive(path)
    try:
        archive.require(["opaque_id", "joints"])
        ids = [str(name) for name in archive.read("opaque_id", largest=_LARGEST_IDS).tolist()]
        info = windows.info
        shape = (len(windows.batch), info.samples, info.n_future, len(info.joint_names), 3)
        joints = archive.read("joints", largest=2 * int(np.prod(shape)) * 8)
    except InputFileError as error:
        raise PredictionsError(str(error)) from error
    wanted = windows.opaque_ids
    missing = sorted(set(wanted) - set(ids))
    unknown = sorted(set(ids) - set(wanted))
    repeated = sorted({name for name in ids if ids.count(name) > 1}) if len(set(ids)) < len(ids) else []
    if missing or unknown or repeated or len(ids) != len(joints):
        raise PredictionsError(
            f"{path}: expected the {len(wanted)} windows of the conditions file, each once, found {len(ids)} ids and"
            f" {len(joints)} rows of joints: missing {_listed(missing)}, repeated {_listed(repeated)}, unknown"
            f" {_listed(unknown)}."
        )
    place = {name: row for row, name in enumerate(ids)}
    ordered = joints[[place[name] for name in wanted]]
    try:
        Futures(joints=ordered).require_fits(windows.batch, info.samples, predictor=path.name)
    except AdapterError as error:
        raise PredictionsError(str(error)) from error
    return ordered.astype(np.float32)


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"{len(names)} ({', '.join(names[:_NAMED])}{more})" if names else "none"
