"""Predictors that run elsewhere: observed windows out to a file, finished futures back in, scored as those of a run.

The file holds what a predictor may see, and nothing that names it. Source: docs/offline.md#predictors.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.engine import Engine, InProcess
from prbench.errors import AdapterError, InputFileError, PredictionsError, UsageError
from prbench.files.arrays import Archive
from prbench.files.storage import atomic_path, file_digest, sole_writer, text_digest, write_text
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.installed import name_problem
from prbench.harness.offline import ExportReport
from prbench.harness.preparation import PreparedDataset, PreparedRun, run_record
from prbench.harness.request import ProgressCallback, RunRequest, silent
from prbench.harness.run import RunPart, scored_parts
from prbench.harness.run_folder import DatasetSummary, MethodRecord, RunFolder
from prbench.harness.run_folder.predictions import PredictionRows, write_part
from prbench.sequences.dataset_info import notice, require_may_pass_on
from prbench.shown import listed
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, require_futures
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import WindowsInfo

BENCHMARK = "motion-prediction"
METADATA_KEY = "prbench_windows"  # Name of the array that holds :class:`WindowsFileInfo` as JSON.
FORMAT_VERSION = 1
_ELSEWHERE = "offline"
_SHARED = ("condition", "fps", "n_future", "joint_names")  # Fields of a batch that the file repeats.
_ASKED = ("seed", "samples", "split", "limit")  # Fields of a request that the file repeats.
_LARGEST = 8 * 1024**3  # bytes of one array
_LARGEST_IDS = 1024**3
_REMEDY = "Export the windows again with `prbench export-conditions --benchmark motion-prediction`."


class WindowsFileInfo(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the rows were made with. A predictor may see it as it may see the rows.

    Attributes:
        samples: Futures of each window.
        n_future: Frames to predict.
        table: Fingerprint of the table: whoever has it recognises it.
    """

    format_version: int = FORMAT_VERSION
    condition: Condition
    seed: int
    samples: int
    split: str
    limit: int | None
    fps: float
    n_future: int
    joint_names: tuple[str, ...]
    protocol_version: int
    table: str


def opaque_ids(batch: ObservedBatch) -> tuple[str, ...]:
    """Return what rows are called outside: their keys, which tell nothing about where they come from."""
    return tuple(f"{key:016x}" for key in batch.key)


def export_windows(
    *,
    data: Sequence[Path | str],
    condition: str,
    out: Path,
    seed: int = 0,
    samples: int = 50,
    split: str = "test",
    limit: int | None = None,
    permitted: Collection[str] = (),
) -> ExportReport:
    """Write what a predictor may see of a table's windows, and nothing else.

    Args:
        data: The folder of one table of windows.
        condition: What the predictor is told.
        out: ``.npz``.
        seed: The run's seed.
        samples: Futures of each window.
        split: The split that windows are taken from.
        limit: Number of windows at most.
        permitted: Datasets whose licensor lets the user pass on recorded motion.

    Raises:
        RedistributionError: if the dataset's terms keep its recordings.
        TableError: if the table is missing, edited or of an unknown version.
        UsageError: for another benchmark's condition, an empty split, ``pose+gaze`` without gaze, another kind of file,
            or several tables.
        StorageError: if the file cannot be written.
    """
    if out.suffix.lower() != ".npz":
        raise UsageError(f"{out}: expected a name that ends in .npz, found '{out.suffix}'.")
    if samples < 1:
        raise UsageError(f"--samples: expected 1 or more, found {samples}.")
    info, batch, table = _windows_of(data, condition, seed=seed, samples=samples, split=split, limit=limit)
    require_may_pass_on(table, f"a file of '{condition}' windows", permitted)
    said = notice(table, permitted)
    notices = out.with_suffix(".NOTICE.txt")
    arrays: dict[str, Any] = {
        METADATA_KEY: np.array(msgspec.json.encode(info, order="sorted").decode()),
        "opaque_id": np.array(opaque_ids(batch)),
        "key": np.array(batch.key, dtype=np.int64),
        "observed_joints": batch.observed_joints,
    }
    if batch.gaze is not None:
        arrays |= {"gaze": batch.gaze, "gaze_valid": batch.gaze_valid}
    with sole_writer(out), sole_writer(notices):
        if said:  # first, so that a file is never without what its terms ask
            write_text(notices, f"{said}\n")
        with atomic_path(out) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(file, **arrays)
    counts = {table.dataset: len(batch)}
    shown = (said,) if said else ()
    return ExportReport(out=out, rows=len(batch) * samples, sequences=counts, left_out={}, notices=shown)


def _windows_of(
    data: Sequence[Path | str], name: str, *, split: str, limit: int | None, **drawn: int
) -> tuple[WindowsFileInfo, ObservedBatch, WindowsInfo]:
    """Make the rows of a file, sorted by opaque id, and return them with the provenance of the table."""
    if len(data) != 1:
        remedy = "Windows of other tables may have other joints and rates: export each into a file of its own."
        raise UsageError(f"--data: expected one table of windows, found {len(data)}. {remedy}")
    benchmark = load_benchmark(BENCHMARK)
    condition = Condition(benchmark.condition(name))
    folders = tuple(map(Path, data))
    asked = RunRequest(benchmark=BENCHMARK, method=_ELSEWHERE, data=folders, split=split, limit=limit)
    tables = benchmark.open_tables(asked)
    benchmark.rules(asked, tables)
    (cases,) = benchmark.choose(asked, tables)
    protocol = load_prediction_protocol()
    batch = next(cases.table.batches(condition, cases.places, frame=protocol.evaluation.frame, size=len(cases)))[0]
    about: dict[str, Any] = {name: getattr(batch, name) for name in _SHARED}
    about |= drawn | {"split": split, "limit": limit}  # drawn are seed and samples
    identity = text_digest("prbench windows", cases.table.identity)
    info = WindowsFileInfo(**about, protocol_version=protocol.version, table=identity)
    return info, batch.chosen(sorted(range(len(batch)), key=lambda row: batch.key[row])), cases.table.info


def read_windows(path: Path) -> tuple[WindowsFileInfo, ObservedBatch]:
    """Read an exported file, sorted by opaque id.

    Raises:
        InputFileError: if it is missing, damaged, or no file of windows.
    """
    archive = Archive(path, remedy=_REMEDY)
    if METADATA_KEY not in archive.members:
        expected = f"a file of windows (with an array '{METADATA_KEY}')"
        raise InputFileError(path, "", expected=expected, found="none", remedy=_REMEDY)
    expected = "what prbench wrote about the file"
    try:
        info = msgspec.json.decode(str(archive.read(METADATA_KEY, largest=1024**2)), type=WindowsFileInfo)
        expected = "arrays of one number of windows"
        names = ["key", "observed_joints", *(("gaze", "gaze_valid") if info.condition is not Condition.POSE else ())]
        archive.require(names)
        arrays: dict[str, Any] = {name: archive.read(name, largest=_LARGEST) for name in names}
        arrays["key"] = tuple(arrays["key"].tolist())
        batch = ObservedBatch(**{name: getattr(info, name) for name in _SHARED}, **arrays)
    except (msgspec.ValidationError, msgspec.DecodeError, ValueError) as error:
        raise InputFileError(path, METADATA_KEY, expected=expected, found=str(error), remedy=_REMEDY) from error
    return info, batch


def score_futures(
    futures: Path,
    conditions: Path,
    data: Sequence[Path],
    *,
    name: str | None = None,
    one_design: bool = False,
    out: Path | None = None,
    engine: Engine | None = None,
    progress: ProgressCallback = silent,
) -> tuple[DatasetSummary, str]:
    """Score futures as a run scores those of a method that it asks.

    Args:
        futures: ``.npz`` with ``opaque_id`` (n,) and ``joints`` (n, K, F, J, 3), metres, in the frame of the observed
            joints.
        conditions: The file of `prbench export-conditions` that they were made from.
        data: The folder of the table that it was exported from.
        name: Name of the predictor; by default that of the file.
        one_design: The K futures of a window are one design: fewer have no scores.
        out: Run folder to write, which a leaderboard reads; nothing is written without it.
        engine: Runs the work, in this process or in several; changes no value.
        progress: Called after every scored batch.

    Returns:
        The scores, and where the futures come from, in words.

    Raises:
        UsageError: for another kind of file, or a name that is taken.
        PredictionsError: if windows are missing, repeated or unknown, futures have another shape or are not finite, or
            the conditions file is not of this table.
        InputFileError: if a file is missing or damaged.
        StorageError: if the run folder cannot be written.
    """
    if futures.suffix.lower() != ".npz":
        raise UsageError(f"{futures}: expected futures in a file that ends in .npz, found another name.")
    benchmark = load_benchmark(BENCHMARK)
    called = name or futures.stem
    if problem := name_problem(called, own=benchmark.about.methods):
        raise UsageError(f"{problem}. Say what the predictor is called with --name.")
    info, batch = read_windows(conditions)
    # A file of windows that the table does not give, value by value, is refused.
    made, own, _ = _windows_of(data, info.condition.value, **{name: getattr(info, name) for name in _ASKED})
    if made.table != info.table:
        remedy = "Give --data the very table that they were exported from."
        raise PredictionsError(f"{conditions}: expected windows of {data[0]}, found those of another table. {remedy}")
    pairs = [(getattr(own, name), getattr(batch, name)) for name in ("observed_joints", "gaze", "gaze_valid")]
    same = made == info and own.key == batch.key
    if not same or not all(np.array_equal(ours, theirs) for ours, theirs in pairs if ours is not None):
        remedy = "The file was changed: export the windows again."
        raise PredictionsError(f"{conditions}: expected what {data[0]} gives, found something else. {remedy}")
    joints = _joints(futures, info, batch)
    method = MethodRecord.of_file(called, futures.name, file_digest(futures), one_design=one_design)
    with contextlib.ExitStack() as held:
        folder = out or Path(held.enter_context(tempfile.TemporaryDirectory(prefix="prbench-futures-"))) / "run"
        held.enter_context(sole_writer(folder))
        given = {name: getattr(info, name) for name in _ASKED}
        given |= {"condition": info.condition.value, "batch_size": benchmark.about.batch_size}
        asked = RunRequest(benchmark=BENCHMARK, method=called, data=tuple(data), device=_ELSEWHERE, out=folder, **given)
        tables = benchmark.open_tables(asked)
        rules = benchmark.rules(asked, tables)
        (cases,) = benchmark.choose(asked, tables)
        work = benchmark.work(asked, cases, method=method, condition=info.condition, rules=rules)
        dataset = PreparedDataset(cases, cases, None, work)
        record = run_record(asked, info.condition, method, (dataset,), rules)
        record = msgspec.structs.replace(record, threads=0, packages={})
        prepared = PreparedRun(asked, benchmark, record, (dataset,), folder, rules)
        run = RunFolder.prepare(folder, record)
        row_of = {key: row for row, key in enumerate(batch.key)}
        for index, question in work.questions(frozenset(range(len(work.plan)))):
            keys = question.batch.key  # type: ignore[attr-defined]  # the benchmark's own kind of question
            part = joints[[row_of[key] for key in keys]]
            n_frames = np.full(len(keys), info.n_future)
            samples = [PredictionRows.from_padded(part[:, k], n_frames) for k in range(info.samples)]
            ids = dataset.ids(work.plan[index])
            path = run.dataset(dataset.name).part(index)
            write_part(path, ids, [keys] * info.samples, samples, protocol_version=rules.version)
        own = RunPart(prepared, dataset, run.dataset(dataset.name), engine or InProcess(), progress)
        summaries = scored_parts([own])
    return summaries[0], record.method.origin


def _joints(
    path: Path, info: WindowsFileInfo, batch: ObservedBatch
) -> Float[np.ndarray, "windows samples future joints 3"]:
    """Read the futures in the order of the windows' file.

    Raises:
        PredictionsError: naming windows that are missing, repeated or unknown, or what is wrong with the futures.
    """
    archive = Archive(path)
    shape = (len(batch), info.samples, info.n_future, len(info.joint_names), 3)
    try:
        archive.require(["opaque_id", "joints"])
        ids = [str(name) for name in archive.read("opaque_id", largest=_LARGEST_IDS).tolist()]
        joints = archive.read("joints", largest=2 * int(np.prod(shape)) * 8)
    except InputFileError as error:
        raise PredictionsError(str(error)) from error
    wanted = opaque_ids(batch)
    missing = sorted(set(wanted) - set(ids))
    unknown = sorted(set(ids) - set(wanted))
    repeated = sorted({name for name in ids if ids.count(name) > 1}) if len(set(ids)) < len(ids) else []
    if missing or unknown or repeated or len(ids) != len(joints):
        raise PredictionsError(
            f"{path}: expected the {len(wanted)} windows of the conditions file, each once, found {len(ids)} ids and"
            f" {len(joints)} rows of joints: missing {listed(missing)}, repeated {listed(repeated)}, unknown"
            f" {listed(unknown)}."
        )
    place = {name: row for row, name in enumerate(ids)}
    ordered = joints[[place[name] for name in wanted]]
    try:
        require_futures(Futures(joints=ordered), batch, info.samples, predictor=path.name)
    except AdapterError as error:
        raise PredictionsError(str(error)) from error
    return ordered.astype(np.float32)
