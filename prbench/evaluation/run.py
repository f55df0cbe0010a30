"""Run a method over tables: conditions, motions, scores, summary, in a run folder that resumes.

``run.json`` is written first and holds everything that decides the result; a batch of predictions is written whole;
scores, cost and summary follow when all batches are there, the summary last. Whatever moment a run was killed at, the
same request finds out from the files what is left to do and ends with the same bytes.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.engine import Engine, InProcess
from prbench.errors import AdapterError, MemoryFullError
from prbench.evaluation.agreement import agreement_with_people, require_agreement
from prbench.evaluation.best_of import ChoiceRules
from prbench.evaluation.carry_on import measure_carried
from prbench.evaluation.conditions import ConditionSource, run_salt
from prbench.evaluation.controls import HOLDS_RECORDINGS, RECORDED_MOTION, control_motions
from prbench.evaluation.generation import BatchTask, run_batch
from prbench.evaluation.preparation import DEFAULT_PARENT, PreparedDataset, PreparedRun, prepare_run
from prbench.evaluation.request import Progress, ProgressCallback, RunRequest, silent
from prbench.evaluation.results import ScoredSet, require_scores, require_summary, summarise
from prbench.evaluation.scoring import ScoringRules, reported, score_selection
from prbench.locks import sole_writer
from prbench.methods.loaded_methods import forget_loaded_methods, unload_method
from prbench.runs.carry_on import write_carried_on
from prbench.runs.cost import read_batch_costs, total_cost
from prbench.runs.folder import DatasetFolder, RunFolder
from prbench.runs.predictions import Predictions
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
            folder = RunFolder.prepare(prepared.out, prepared.record, prepared.protocol)
            parts = [_Part(prepared, one, folder.dataset(one.name), engine, progress) for one in prepared.datasets]
            made = _generate_all(parts, folder, engine)
        except Exception:
            if request.isolate:
                _remove_empty(request.out or DEFAULT_PARENT)  # made so that it could be withheld
            raise
        finally:
            forget_loaded_methods()  # no program outlives the run, however it ends
        for part in parts:
            part.write_notice()
        summaries = tuple(part.scored() for part in parts)
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
    folder = RunFolder.prepare(prepared.out, prepared.record, prepared.protocol)
    if not isinstance(engine, InProcess):
        unload_method()  # every worker loads its own
    for dataset in prepared.datasets:
        part = _Part(prepared, dataset, folder.dataset(dataset.name), engine, silent)
        yield from part.tasks(frozenset(part.missing()))


def _generate_all(parts: list[_Part], folder: RunFolder, engine: Engine) -> list[int]:
    """Make what is missing of every dataset; returns how many batches each took."""
    if not isinstance(engine, InProcess):
        unload_method()  # every worker loads its own
    try:
        missing = [part.missing() for part in parts]
        done = {part.dataset.name: len(part.dataset.plan) - len(own) for part, own in zip(parts, missing, strict=True)}
        # Puts that carry on are a second round: they start where the motions of the first one end.
        for carries in (False, True):
            rounds = [
                [index for index in wanted if part.carries(index) is carries]
                for part, wanted in zip(parts, missing, strict=True)
            ]
            tasks = (part.tasks(frozenset(wanted)) for part, wanted in zip(parts, rounds, strict=True) if wanted)
            owners = [part for part, wanted in zip(parts, rounds, strict=True) for _ in wanted]
            if not owners:
                continue
            owners[0].tell(done)
            # One stream of work for all datasets, so that every worker starts once and loads the method once.
            for _, part in zip(engine.map(run_batch, itertools.chain.from_iterable(tasks)), owners, strict=True):
                done[part.dataset.name] += 1
                part.tell(done)
    except MemoryFullError as error:  # or a worker that ended without an answer
        folder.discard_if_empty()
        method = parts[0].prepared.record.method
        if method.kind != PACKAGE:
            raise
        raise AdapterError(
            f"method '{method.name}': {error} If the method itself ends the process, --isolate shows what it wrote"
            " last."
        ) from error
    except Exception:
        folder.discard_if_empty()
        raise
    return [len(wanted) for wanted in missing]


def _remove_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


@dataclass(frozen=True)
class _Part:
    """The work of a run on one of its datasets."""

    prepared: PreparedRun
    dataset: PreparedDataset
    files: DatasetFolder
    engine: Engine
    progress: ProgressCallback

    def tell(self, done: dict[str, int]) -> None:
        """Report how many batches of this dataset are done."""
        self.progress(Progress(self.dataset.name, "generate", done[self.dataset.name], len(self.dataset.plan)))

    def missing(self) -> list[int]:
        """Batches that no earlier call has made."""
        self.files.require_no_other_parts(len(self.dataset.plan))
        samples = self.prepared.request.samples
        return [
            index
            for index, rows in enumerate(self.dataset.plan)
            if not self.files.has_part(index, self.dataset.ids(rows), samples)
        ]

    def carries(self, index: int) -> bool:
        """Return True for a batch of puts that start where generated picks end."""
        return self.dataset.carrying is not None and index >= self.dataset.pick_batches

    def _carried(self, sample: int) -> tuple[ConditionSource, np.ndarray]:
        assert self.dataset.carrying is not None
        predictions = Predictions.open(self.files.predictions)
        predictions.make_ready()
        return self.dataset.carrying.source(self.dataset.source, predictions, sample)

    def tasks(self, wanted: frozenset[int]) -> Iterator[BatchTask]:
        """The work on some batches, in the order of the plan."""
        request = self.prepared.request
        dataset = self.dataset
        salt = run_salt(request.seed, dataset.selection.table.identity)
        given = None
        if request.is_control:
            given = control_motions(request.method, dataset.selection, dataset.source, dataset.plan)
        carried = [self._carried(sample) for sample in range(request.samples)] if any(map(self.carries, wanted)) else []
        for index, rows in enumerate(dataset.plan):
            # Controls come in order: those of finished batches are made and passed over.
            motions = next(given) if given is not None else None
            if index not in wanted:
                continue
            sources = [source for source, _ in carried] or [dataset.source] * request.samples
            first = [
                source.batch(rows, self.prepared.condition, seed=request.seed, salt=salt, sample=0)
                for source in sources
            ]
            yield BatchTask(
                index=index,
                sequence_ids=dataset.ids(rows),
                # Motions of one sample are consecutive draws, so that one of one is the sample itself.
                conditions=tuple(
                    dataset.source.redrawn(first[draw // request.best_of], rows, seed=request.seed, sample=draw)
                    for draw in range(request.samples * request.best_of)
                ),
                choice=ChoiceRules.of(
                    self.prepared.protocol, best_of=request.best_of, head_tilt_deg=dataset.source.head_tilt_deg[rows]
                ),
                method=dataset.method,
                seed=request.seed,
                given=motions,
                part=self.files.part(index),
                cost=self.files.batch_cost(index),
                protocol_version=self.prepared.protocol.version,
                placements=tuple(placements[rows] for _, placements in carried),
            )

    def write_notice(self) -> None:
        """Say beside the predictions what the data's terms ask, so that it travels with a folder that is passed on."""
        recorded = self.prepared.request.method in HOLDS_RECORDINGS
        text = run_notice(self.dataset.selection.table.info, recorded_motion=recorded)
        if text and not self.files.notice.is_file():
            write_text(self.files.notice, text)

    def scored(self) -> DatasetSummary:
        """Score what was generated; what an earlier call wrote has to follow from the motions and the table."""
        files = self.files
        if files.finished and files.has_scores():
            stored = read_scores(files.scores)
            require_scores(files, stored, pa.concat_tables(self._windows()))
            require_summary(files, summarise(stored, self._scored_set()))
            agreement = agreement_with_people(self.dataset.selection, stored, protocol=self.prepared.protocol)
            require_agreement(files, agreement)
            if not files.agreement.is_file():  # a run of an earlier version
                agreement.write(files.path)
        else:
            write_scores(files.scores, self._windows())
            measured = files.batch_costs()
            if measured or not files.cost.is_file():  # else only scores were lost, and what was measured still holds
                total_cost(read_batch_costs(measured), batches=len(self.dataset.plan)).write(files.cost)
            stored = read_scores(files.scores)
            agreement_with_people(self.dataset.selection, stored, protocol=self.prepared.protocol).write(files.path)
            # The summary comes last: where it stands, everything else does.
            summarise(stored, self._scored_set()).write(files.path)
        files.forget_batch_costs()
        if self.dataset.carrying is not None:
            samples = range(self.prepared.request.samples)
            found = measure_carried(self.dataset.selection, files.predictions, stored, samples=samples)
            write_carried_on(files.path, found)
        return DatasetSummary.read(files.path)

    def _scored_set(self) -> ScoredSet:
        request = self.prepared.request
        selection = self.dataset.selection
        return ScoredSet(
            info=selection.table.info,
            recording_of=dict(zip(selection.sequence_ids, selection.recording_ids)),
            chosen=len(self.dataset.chosen),
            method=self.prepared.record.method.name,
            condition=self.prepared.condition.value,
            control=request.control,
            split=request.split,
            samples=request.samples,
            best_of=request.best_of,
            gaze=self.prepared.record.method.gaze,
            obstacles=self.prepared.record.method.wants_obstacles,
            carry_on=self.prepared.record.carry_on,
        )

    def _windows(self) -> Iterator[pa.Table]:
        """The scores of what was generated, a window of sequences at a time."""
        request = self.prepared.request
        rules = ScoringRules(
            self.prepared.protocol.metrics,
            recorded_motion=request.method in RECORDED_MOTION,
            other_goals=self.dataset.scored_goals,
            run_of=self.prepared.record.method.name,
        )
        selection = self.dataset.selection
        windows = score_selection(
            selection, self.files.predictions, samples=range(request.samples), rules=rules, engine=self.engine
        )
        return reported(windows, selection, self.progress)
