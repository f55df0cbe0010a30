"""Run a method over tables: conditions, motions, scores, summary, in a run folder that resumes.

``run.json`` is written first and holds everything that decides the result; a batch of predictions is written whole;
scores, cost and summary follow when all batches are there, the summary last. Whatever moment a run was killed at, the
same request finds out from the files what is left to do and ends with the same bytes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from prbench.engine import Engine, InProcess
from prbench.errors import AdapterError, MemoryFullError
from prbench.evaluation.conditions import run_salt
from prbench.evaluation.controls import RECORDED_MOTION, control_motions
from prbench.evaluation.generation import BatchTask, run_batch
from prbench.evaluation.preparation import DEFAULT_PARENT, PreparedDataset, PreparedRun, prepare_run
from prbench.evaluation.request import Progress, ProgressCallback, RunRequest, silent
from prbench.evaluation.results import ScoredSet, require_scores, require_summary, summarise
from prbench.evaluation.scoring import ScoringRules, score_selection
from prbench.locks import sole_writer
from prbench.manifests import load_protocol
from prbench.methods.loaded_methods import forget_loaded_methods, unload_method
from prbench.runs.cost import read_batch_costs, total_cost
from prbench.runs.folder import DatasetFolder, RunFolder
from prbench.runs.record import PACKAGE
from prbench.runs.scores import read_scores, write_scores
from prbench.runs.summary import DatasetSummary
from prbench.sequences.redistribution import run_notice
from prbench.storage import write_text


@dataclass(frozen=True)
class RunReport:
    """Results of a run."""

    folder: RunFolder
    summaries: tuple[DatasetSummary, ...]
    batches_made: int
    """Number of batches that this call generated."""
    batches_found: int
    """Number of batches that an earlier call has left."""


def run_method(request: RunRequest, *, engine: Engine | None = None, progress: ProgressCallback = silent) -> RunReport:
    """Run a method and score it; goes on where an earlier call with the same request was interrupted.

    Args:
        request: What to run on what.
        engine: Where batches are generated and scored; in this process by default. Leaves no trace in the files
            except ``cost.json``.
        progress: Called after every batch and every scored window.

    Raises:
        AdapterError: if the method is unknown, does not take the condition, or breaks its contract.
        RunError: if the run folder belongs to other inputs, or its scores do not follow from its motions.
        TableError: if a table is missing, empty, changed or of an unknown version.
        StorageError: if a file cannot be written, or another process works in the run folder.
        UsageError: if the request does not fit together.
    """
    engine = engine or InProcess()
    with contextlib.ExitStack() as held:
        try:
            prepared = prepare_run(request)
            held.enter_context(sole_writer(prepared.out))
            folder = RunFolder.prepare(prepared.out, prepared.record)
            made = _generate_all(prepared, folder, engine, progress)
        except Exception:
            if request.isolate:
                _remove_empty(request.out or DEFAULT_PARENT)  # made so that it could be withheld
            raise
        finally:
            forget_loaded_methods()  # no program outlives the run, however it ends
        for dataset in prepared.datasets:
            _write_notice(prepared, dataset, folder)
        summaries = tuple(_scored(prepared, dataset, folder, engine, progress) for dataset in prepared.datasets)
    total = sum(len(dataset.plan) for dataset in prepared.datasets)
    return RunReport(folder, summaries, batches_made=sum(made), batches_found=total - sum(made))


def missing_batches(request: RunRequest, *, engine: Engine) -> Iterator[BatchTask]:
    """Work that a run still has to do, for whoever makes the batches of several runs at once.

    :func:`run_method` finds them where :func:`~prbench.evaluation.generation.run_batch` puts them, and scores them.
    The caller holds the run folder until the batches are made.

    Args:
        request: See :func:`run_method`, whose errors these are.
        engine: Where the batches will be made.
    """
    prepared = prepare_run(request)
    folder = RunFolder.prepare(prepared.out, prepared.record)
    if not isinstance(engine, InProcess):
        unload_method()  # every worker loads its own
    for dataset in prepared.datasets:
        files = folder.dataset(dataset.name)
        yield from _tasks(prepared, dataset, files, frozenset(_missing(prepared, dataset, files)))


def _generate_all(prepared: PreparedRun, folder: RunFolder, engine: Engine, progress: ProgressCallback) -> list[int]:
    """Make what is missing of every dataset; returns how many batches each took."""
    if not isinstance(engine, InProcess):
        unload_method()  # every worker loads its own
    try:
        return [_generate(prepared, dataset, folder, engine, progress) for dataset in prepared.datasets]
    except Exception:
        folder.discard_if_empty()
        raise


def _remove_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _write_notice(prepared: PreparedRun, dataset: PreparedDataset, folder: RunFolder) -> None:
    """Say beside the predictions what the data's terms ask, so that it travels with a folder that is passed on."""
    files = folder.dataset(dataset.name)
    recorded = prepared.request.method in RECORDED_MOTION
    text = run_notice(dataset.selection.table.info, recorded_motion=recorded)
    if text and not files.notice.is_file():
        write_text(files.notice, text)


def _generate(
    prepared: PreparedRun,
    dataset: PreparedDataset,
    folder: RunFolder,
    engine: Engine,
    progress: ProgressCallback,
) -> int:
    """Make the batches that are not there yet; returns how many."""
    files = folder.dataset(dataset.name)
    missing = _missing(prepared, dataset, files)
    done = len(dataset.plan) - len(missing)
    if not missing:
        return 0
    progress(Progress(dataset.name, "generate", done, len(dataset.plan)))
    try:
        for _ in engine.map(run_batch, _tasks(prepared, dataset, files, frozenset(missing))):
            done += 1
            progress(Progress(dataset.name, "generate", done, len(dataset.plan)))
    except MemoryFullError as error:  # or a worker that ended without an answer
        if prepared.record.method.kind != PACKAGE:
            raise
        name = prepared.record.method.name
        raise AdapterError(
            f"method '{name}': {error} If the method itself ends the process, --isolate shows what it wrote last."
        ) from error
    return len(missing)


def _missing(prepared: PreparedRun, dataset: PreparedDataset, files: DatasetFolder) -> list[int]:
    """Batches that no earlier call has made."""
    files.require_no_other_parts(len(dataset.plan))
    return [
        index
        for index, rows in enumerate(dataset.plan)
        if not files.has_part(index, dataset.ids(rows), prepared.request.samples)
    ]


def _tasks(
    prepared: PreparedRun, dataset: PreparedDataset, files: DatasetFolder, wanted: frozenset[int]
) -> Iterator[BatchTask]:
    request = prepared.request
    protocol = load_protocol()
    salt = run_salt(request.seed, dataset.selection.table.identity)
    given = None
    if request.is_control:
        given = control_motions(request.method, dataset.selection, dataset.source, dataset.plan)
    for index, rows in enumerate(dataset.plan):
        motions = next(given) if given is not None else None
        if index not in wanted:
            continue
        first = dataset.source.batch(rows, prepared.condition, seed=request.seed, salt=salt, sample=0)
        yield BatchTask(
            index=index,
            sequence_ids=dataset.ids(rows),
            conditions=tuple(
                dataset.source.redrawn(first, rows, seed=request.seed, sample=sample)
                for sample in range(request.samples)
            ),
            method=dataset.method,
            seed=request.seed,
            given=motions,
            part=files.part(index),
            cost=files.batch_cost(index),
            protocol_version=protocol.version,
        )


def _scored(
    prepared: PreparedRun,
    dataset: PreparedDataset,
    folder: RunFolder,
    engine: Engine,
    progress: ProgressCallback,
) -> DatasetSummary:
    """Score what was generated; what an earlier call wrote has to be what follows from the motions and the table."""
    files = folder.dataset(dataset.name)
    if files.finished and files.has_scores():
        stored = read_scores(files.scores)
        require_scores(files, stored, pa.concat_tables(_windows(prepared, dataset, files, engine, progress)))
        require_summary(files, summarise(stored, _scored_set(prepared, dataset)))
    else:
        write_scores(files.scores, _windows(prepared, dataset, files, engine, progress))
        measured = files.batch_costs()
        if measured or not files.cost.is_file():  # else only scores were lost, and what was measured still holds
            total_cost(read_batch_costs(measured), batches=len(dataset.plan)).write(files.cost)
        summarise(read_scores(files.scores), _scored_set(prepared, dataset)).write(files.path)
    files.forget_batch_costs()
    return DatasetSummary.read(files.path)


def _scored_set(prepared: PreparedRun, dataset: PreparedDataset) -> ScoredSet:
    request = prepared.request
    selection = dataset.selection
    return ScoredSet(
        info=selection.table.info,
        recording_of=dict(zip(selection.sequence_ids, selection.recording_ids)),
        chosen=len(dataset.chosen),
        method=prepared.record.method.name,
        condition=prepared.condition.value,
        control=request.control,
        split=request.split,
        samples=request.samples,
    )


def _windows(
    prepared: PreparedRun,
    dataset: PreparedDataset,
    files: DatasetFolder,
    engine: Engine,
    progress: ProgressCallback,
) -> Iterator[pa.Table]:
    """The scores of what was generated, a window of sequences at a time."""
    rules = ScoringRules(
        load_protocol().metrics,
        recorded_motion=prepared.request.method in RECORDED_MOTION,
        other_goals=dataset.scored_goals,
        run_of=prepared.record.method.name,
    )
    samples = range(prepared.request.samples)
    windows = score_selection(dataset.selection, files.predictions, samples=samples, rules=rules, engine=engine)
    return _counted(windows, dataset, progress)


def _counted(windows: Iterator[pa.Table], dataset: PreparedDataset, progress: ProgressCallback) -> Iterator[pa.Table]:
    done = 0
    total = len(dataset.selection)
    for window in windows:
        yield window
        done += len(window["sequence_id"].unique())
        progress(Progress(dataset.name, "score", done, total))
