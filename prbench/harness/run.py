"""Run a method over tables: questions, answers, scores, summary, in a run folder that resumes.

Nothing here knows of a benchmark but its value (:mod:`prbench.harness.benchmark`).

``run.json`` is written first and holds everything that decides the result; a batch of predictions is written whole;
scores, cost and summary follow when all batches are there, the summary last. Whatever moment a run was killed at, the
same request finds out from the files what is left to do and ends with the same bytes.
"""

from __future__ import annotations

import contextlib
import itertools
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import psutil
from jaxtyping import Int

from prbench.engine import Engine, InProcess
from prbench.errors import AdapterError, MemoryFullError
from prbench.files.storage import remove_half_written, sole_writer, write_text
from prbench.harness import preparation, results, run_folder
from prbench.harness.methods.loading import MethodSpec, count_parameters, forget_loaded_methods, unload_method
from prbench.harness.methods.process import computing_threads
from prbench.harness.methods.programs import runs_in_container
from prbench.harness.request import DEFAULT_PARENT, Progress, ProgressCallback, RunRequest, reported, silent
from prbench.harness.run_folder.predictions import write_part
from prbench.harness.run_folder.record import PACKAGE, RunCost, total_cost
from prbench.harness.run_folder.scores import CodedScores, write_scores
from prbench.sequences.dataset_info import run_notice


@dataclass(frozen=True)
class BatchTask:
    """The unit of work and of resumption. Goes to a worker as it is; a method sees nothing but the question.

    Attributes:
        question: See :meth:`prbench.harness.benchmark.CaseWork.questions`.
        method: None for a control.
    """

    index: int
    sequence_ids: tuple[str, ...]
    question: Any
    method: MethodSpec | None
    seed: int
    part: Path
    cost: Path
    protocol_version: int

    @property
    def name(self) -> str:
        """Name of the batch in messages."""
        return f"batch {self.index}, from sequence {self.sequence_ids[0]} on"


def run_batch(task: BatchTask) -> int:
    """Generate, check, measure and write one batch.

    Returns:
        The index of the batch.

    Raises:
        AdapterError: if the method breaks the contract; nothing is written then.
        StorageError: if the part cannot be written.
    """
    method = None if task.method is None else task.method.load()
    if cuda := _used_cuda():
        cuda.reset_peak_memory_stats()
    in_container = task.method is not None and runs_in_container(task.method.name)
    _, computed = _used_by_processes()
    started = _synchronised_time()
    with contextlib.nullcontext() if task.method is None else computing_threads(task.method.threads):
        answer = task.question.ask(method, seed=task.seed, sequence_ids=task.sequence_ids)
    seconds = _synchronised_time() - started
    cuda = _used_cuda()
    peak, processor_seconds = _used_by_processes()
    # What a container computes is none of this process's children.
    computed = None if in_container else processor_seconds - computed
    cost = RunCost(
        peak_process_bytes=peak,
        peak_device_bytes=None if cuda is None else int(cuda.max_memory_allocated()),
        network_passes_declared=answer.network_passes,
    )
    motions = len(answer.samples) * len(task.sequence_ids)
    frames = sum(int(rows.offsets[-1]) for rows in answer.samples)
    if method is None:
        cost = msgspec.structs.replace(cost, motions=motions, frames=frames)
    else:
        timed = {"motions": motions, "frames": frames, "seconds": seconds, "processor_seconds": computed}
        cost = msgspec.structs.replace(
            cost,
            parameters=count_parameters(method.adapter),
            **(timed if method.warmed_up else {f"warm_up_{name}": value for name, value in timed.items()}),
        )
        method.warmed_up = True
    cost.write(task.cost)  # first, so that a part on disk is never without its measurement
    about = {"protocol_version": task.protocol_version, "question": task.question.digest}
    write_part(task.part, task.sequence_ids, answer.seeds, answer.samples, **about)
    return task.index


def _used_by_processes() -> tuple[int, float]:
    """Return the memory of this process and of all that it has started, in bytes, and their processor time, seconds.

    A machine that does other work too makes a run slow; it changes processor time little.
    """
    memory = 0
    seconds = 0.0
    own = psutil.Process()
    for process in (own, *own.children(recursive=True)):
        with contextlib.suppress(psutil.Error):  # it has just ended; its parent's time holds its own
            memory += process.memory_info().rss
            seconds += sum(process.cpu_times()[:4])  # of user and system, and of the children that have ended
    return memory, seconds


def _synchronised_time() -> float:
    if cuda := _used_cuda():
        cuda.synchronize()  # the GPU works on after a call has returned
    return time.perf_counter()


def _used_cuda() -> Any:
    """Return ``torch.cuda`` where the method has used it; asking torch itself would import and start it."""
    torch = sys.modules.get("torch")
    used = torch is not None and torch.cuda.is_available() and torch.cuda.is_initialized()
    return torch.cuda if torch is not None and used else None


@dataclass(frozen=True)
class RunReport:
    """Results of a run.

    Attributes:
        batches_made: Number of batches that this call generated.
        batches_found: Number of batches that an earlier call has left.
    """

    folder: run_folder.RunFolder
    summaries: tuple[run_folder.DatasetSummary, ...]
    batches_made: int
    batches_found: int


def run_method(request: RunRequest, *, engine: Engine | None = None, progress: ProgressCallback = silent) -> RunReport:
    """Run a method and score it; goes on where an earlier call with the same request was interrupted.

    Args:
        request: What to run on what.
        engine: Processes or cluster that generates and scores; this process by default. Leaves no trace in the files
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
        with tidied(request):
            prepared = preparation.prepare_run(request)
            held.enter_context(sole_writer(prepared.out))
            folder = prepared_folder(prepared)
            parts = [RunPart(prepared, one, folder.dataset(one.name), engine, progress) for one in prepared.datasets]
            made = generate_all(parts, folder, engine)
        summaries = scored_parts(parts)
    total = sum(len(part.plan) for part in parts)
    return RunReport(folder, summaries, batches_made=made, batches_found=total - made)


@contextlib.contextmanager
def tidied(request: RunRequest) -> Iterator[None]:
    """End programs once a run is generated, however it ends, and remove an empty folder that was made to be hidden."""
    try:
        yield
    except Exception:
        folder = request.out or DEFAULT_PARENT
        if request.isolate and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
        raise
    finally:
        forget_loaded_methods()


def scored_parts(parts: Sequence[RunPart]) -> tuple[run_folder.DatasetSummary, ...]:
    """Write what a licence asks for into each dataset's folder, then score what lies there."""
    for part in parts:
        part.write_notice()
    return tuple(part.scored() for part in parts)


def prepared_folder(prepared: preparation.PreparedRun) -> run_folder.RunFolder:
    """Make the run folder, with a copy of the protocol where it is the user's own."""
    return run_folder.RunFolder.prepare(prepared.out, prepared.record, prepared.benchmark.copied_rules(prepared.rules))


def generate_all(parts: list[RunPart], folder: run_folder.RunFolder, engine: Engine) -> int:
    """Make what is missing of every dataset; a folder without a single batch is removed where that fails.

    Args:
        parts: The work on each dataset.
        folder: The run folder.
        engine: Processes or cluster that makes batches.

    Returns:
        Number of batches that were made.
    """
    if not isinstance(engine, InProcess):
        unload_method()  # every worker loads its own
    try:
        missing = [(part, part.missing()) for part in parts]
        owners = [part for part, own in missing for _ in own]
        done = {part.dataset.name: len(part.batches) - len(own) for part, own in missing}
        tasks = itertools.chain.from_iterable(part.tasks(frozenset(own)) for part, own in missing if own)
        if owners:
            owners[0].tell(done)
            # One stream of work for all datasets, so that every worker starts once and loads the method once.
            for _, part in zip(engine.map(run_batch, tasks), owners, strict=True):
                done[part.dataset.name] += 1
                part.tell(done)
        remove_half_written(folder.path)  # by workers that were killed
        return len(owners)
    except MemoryFullError as error:  # or a worker that ended without an answer
        folder.discard_if_empty()
        method = parts[0].prepared.record.method
        if method.kind != PACKAGE:
            raise
        why = f"{error} If the method itself ends the process, --isolate shows what it wrote last."
        raise AdapterError(f"method '{method.name}': {why}") from error
    except Exception:
        folder.discard_if_empty()
        raise


@dataclass(frozen=True)
class RunPart:
    """The work of a run on one of its datasets.

    Attributes:
        chosen: The batches of a shard; None for all.
    """

    prepared: preparation.PreparedRun
    dataset: preparation.PreparedDataset
    files: run_folder.DatasetFolder
    engine: Engine
    progress: ProgressCallback
    chosen: frozenset[int] | None = None

    @property
    def plan(self) -> list[Int[np.ndarray, "_"]]:
        """The places of the cases of each batch."""
        return self.dataset.work.plan

    @property
    def batches(self) -> list[int]:
        """Numbers of the batches that are to be made."""
        return [index for index in range(len(self.plan)) if self.chosen is None or index in self.chosen]

    def tell(self, done: dict[str, int]) -> None:
        """Report how many batches of this dataset are done."""
        self.progress(Progress(self.dataset.name, "generate", done[self.dataset.name], len(self.batches)))

    def missing(self) -> list[int]:
        """Batches that no earlier call has made."""
        self.files.require_no_other_parts(len(self.plan))
        return [index for index in self.batches if not self.has(index, self.files)]

    def has(self, index: int, files: run_folder.DatasetFolder) -> bool:
        """Return True if a batch of this dataset is in a folder, whole."""
        return files.has_part(index, self.dataset.ids(self.plan[index]), self.prepared.request.samples)

    def tasks(self, wanted: frozenset[int]) -> Iterator[BatchTask]:
        """Yield the work on some batches, in the order of the plan."""
        for index, question in self.dataset.work.questions(wanted):
            ids = self.dataset.ids(self.plan[index])
            seed, version = self.prepared.request.seed, self.prepared.rules.version
            files = self.files.part(index), self.files.batch_cost(index)
            yield BatchTask(index, ids, question, self.dataset.method, seed, *files, version)

    def write_notice(self) -> None:
        """Say beside the predictions what the data's terms ask, so that it travels with a folder that is passed on."""
        text = run_notice(self.dataset.cases.table.info, recorded_motion=self.dataset.work.holds_recordings)
        if text and not self.files.notice.is_file():
            write_text(self.files.notice, text)

    def scored(self) -> run_folder.DatasetSummary:
        """Score what was generated; what an earlier call wrote has to follow from the motions and the table."""
        files = self.files
        work = self.dataset.work
        scores = reported(work.scores(files, self.engine), self.dataset.name, len(self.dataset.cases), self.progress)
        if files.finished:
            stored = CodedScores.read(files.scores)
            results.require_scores(files, stored, CodedScores.of(scores))
            results.require_summary(files, self._summary(stored))
            work.require_beside(files, stored)
        else:
            write_scores(files.scores, scores)
            measured = files.batch_costs()
            if measured or not files.cost.is_file():  # else only scores were lost, and what was measured still holds
                total_cost([RunCost.read(path) for path in measured]).write(files.cost)
            stored = CodedScores.read(files.scores)
            work.write_beside(files, stored)
            # The summary comes last: where it stands, everything else does.
            self._summary(stored).write(files.path)
        files.forget_batch_costs()
        return run_folder.DatasetSummary.read(files.path)

    def _summary(self, scores: CodedScores) -> run_folder.DatasetSummary:
        record = self.prepared.record
        table = next(table for table in record.tables if table.dataset == self.dataset.name)
        cases = self.dataset.cases
        recording_of = dict(zip(cases.sequence_ids, cases.recording_ids, strict=True))
        return results.summary_of(record, table, scores, recording_of, self.dataset.work.findings(self.files))
