"""Score motions that lie on disk: those of a run folder, or a file that somebody hands in."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

import prbench
from prbench.engine import Engine, InProcess
from prbench.engine.pool import give_back
from prbench.errors import RunError, StorageError, UsageError
from prbench.files.storage import file_digest, remove_half_written, sole_writer, text_digest
from prbench.harness.agreement import agreement_with_people
from prbench.harness.conditions import ConditionSource, derangement
from prbench.harness.controls import RECORDED_MOTION, SHUFFLED_GOAL
from prbench.harness.methods.installed import name_problem
from prbench.harness.offline import read_conditions_file
from prbench.harness.planning import Selection, open_tables, select, supported
from prbench.harness.preparation import table_record
from prbench.harness.request import ProgressCallback, reported, silent
from prbench.harness.results import require_same_table, summary_of
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.agreement import DatasetAgreement
from prbench.harness.run_folder.cost import total_cost
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.record import FILE, BatchPlanRecord, MethodRecord, RunRecord, TableRecord
from prbench.harness.run_folder.scores import RUN_SCHEMA_VERSION, CodedScores
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.harness.score_request import (
    GivenMotions,
    ScoreReport,
    ScoreRequest,
    Stated,
    Wanted,
    require_complete,
    require_lengths,
    stated_by_conditions,
    stated_by_request,
)
from prbench.harness.scoring import ScoringRules, score_selection
from prbench.protocol.manifests import BenchmarkProtocol
from prbench.protocol.own_protocol import FILE_NAME, protocol_for, write_protocol
from prbench.sequences import SequenceTable
from prbench.shown import clean

_ELSEWHERE = "offline"
"""Device of a method whose motions came as a file."""
_NO_BATCHES = BatchPlanRecord(batch_size=0, batches=0, digest="")
UNSTATED = "unstated"
"""Condition of motions of which nobody said what they were made from; never ranked."""


@dataclass(frozen=True)
class Work:
    """The engine that does the work, and the receiver of its progress."""

    engine: Engine
    progress: ProgressCallback


@dataclass(frozen=True)
class Scored:
    """The results of one table."""

    scores: CodedScores
    summary: DatasetSummary
    agreement: DatasetAgreement

    @classmethod
    def of(
        cls,
        record: RunRecord,
        table: TableRecord,
        selection: Selection,
        predictions: Predictions,
        *,
        samples: Sequence[int],
        rules: ScoringRules,
        protocol: BenchmarkProtocol,
        work: Work,
    ) -> Scored:
        """Score the motions of the chosen sequences of a table and summarise them as those of a run."""
        windows = score_selection(selection, predictions, samples=samples, rules=rules, engine=work.engine)
        scores = CodedScores.of(reported(windows, table.dataset, len(selection), work.progress))
        give_back()
        agreement = agreement_with_people(selection, scores, protocol=protocol)
        give_back()
        recording_of = dict(zip(selection.sequence_ids, selection.recording_ids))
        return cls(scores, summary_of(record, table, scores, recording_of), agreement)


def predictions_digest(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of a folder's files."""
    if path.is_file():
        return file_digest(path)
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return text_digest(*(part for file in files for part in (file.relative_to(path).as_posix(), file_digest(file))))


def write_submission(
    folder: Path, record: RunRecord, scored: tuple[Scored, ...], protocol: BenchmarkProtocol
) -> tuple[Path, ...]:
    """Write the scores of a submission as a leaderboard reads them; its motions stay where they are.

    Returns:
        The folder of each dataset.

    Raises:
        RunError: if the folder belongs to another submission.
        StorageError: if it holds something else, or cannot be written.
    """
    _require_no_run(folder)
    run = RunFolder.prepare(folder, record, protocol)
    parts = [run.dataset(one.summary.dataset) for one in scored]
    give_back()
    for part, one in zip(parts, scored):
        one.scores.write(part.scores)
        total_cost([], batches=0).write(part.cost)  # nothing was measured
        one.agreement.write(part.path)
        one.summary.write(part.path)
    return tuple(part.path for part in parts)


def write_plain(folder: Path, scored: tuple[Scored, ...], protocol: BenchmarkProtocol) -> tuple[Path, ...]:
    """Write the scores of a run beside those that it has itself.

    Raises:
        StorageError: if the folder is that of a run, or cannot be written.
    """
    _require_no_run(folder)
    remove_half_written(folder)
    parts = [folder if len(scored) == 1 else folder / one.summary.dataset for one in scored]
    for part, one in zip(parts, scored):
        one.scores.write(part / "scores.parquet")
        one.agreement.write(part)
        one.summary.write(part)
    write_protocol(folder, protocol)
    return tuple(parts)


def _require_no_run(folder: Path) -> None:
    if (folder / run_record.FILE_NAME).is_file() and RunRecord.read(folder).method.kind != FILE:
        raise StorageError(f"{folder}: is a run folder with scores of its own. Choose another folder for --out.")


_STATED_BY_THE_RUN = ("conditions", "condition", "control", "seed", "max_frames", "native_fps", "name")


def score_run(
    run: RunFolder, tables: list[SequenceTable], request: ScoreRequest, work: Work
) -> tuple[ScoreReport, ...]:
    """Score the motions of a run.

    Raises:
        UsageError: if the request says what the run itself says.
        RunError: if it is of another table.
        PredictionsError: if motions are missing.
    """
    _require_plain(request)
    # A run of an earlier version of prbench's own protocol is scored by today's.
    protocol = protocol_for(_protocol_file(run, request), (table.described_protocol for table in tables))
    scored = tuple(_scored(run, table, request, work, protocol) for table in tables)
    folders = (None,) * len(scored) if request.out is None else write_plain(request.out, scored, protocol)
    method = run.record.method
    return tuple(
        ScoreReport(one.scores, one.summary, at, method.origin, one.agreement, method.motionless)
        for one, at in zip(scored, folders)
    )


def scored_sequences(run: RunFolder, table: SequenceTable) -> Selection:
    """The sequences that a run was scored on.

    Raises:
        RunError: if it is of another table.
    """
    require_same_table(run, table)
    return _selections(ScoreRequest(predictions=run.path, data=(table.folder,)), run.record, table)[1]


def _protocol_file(run: RunFolder, request: ScoreRequest) -> Path | None:
    """File of the user's own protocol: the one asked for, else the run's; None for prbench's."""
    if request.protocol is not None:
        return request.protocol
    followed = run.protocol
    return run.path / FILE_NAME if followed is not None and followed.is_own else None


def _scored(
    run: RunFolder, table: SequenceTable, request: ScoreRequest, work: Work, protocol: BenchmarkProtocol
) -> Scored:
    require_same_table(run, table)
    record = run.record
    chosen, selection = _selections(request, record, table)
    predictions = Predictions.open(run.dataset(table.info.dataset).predictions)
    wanted = Wanted(
        path=request.predictions,
        selections=(selection,),
        seed=record.seed,
        samples=None,
        native_fps=None,
        conditions=None,
    )
    samples = require_complete(predictions, wanted)
    # What is scored may be another split or fewer sequences than the run's.
    scored = msgspec.structs.replace(
        record,
        split=selection.split,
        samples=len(samples),
        method=msgspec.structs.replace(record.method, gaze=predictions.has_gaze),
    )
    recorded_motion = record.method.kind == run_record.CONTROL and record.method.name in RECORDED_MOTION
    other_goals = None
    if recorded_motion and record.control == SHUFFLED_GOAL:
        order = derangement(selection, seed=record.seed)
        other_goals = ConditionSource.read(selection).goal_location[order]
    return Scored.of(
        scored,
        table_record(chosen, selection, _NO_BATCHES),
        selection,
        predictions,
        samples=samples,
        rules=ScoringRules(
            protocol.metrics,
            recorded_motion=recorded_motion,
            other_goals=other_goals,
            run_of=record.method.name,
            allow_length_mismatch=request.allow_length_mismatch,
        ),
        protocol=protocol,
        work=work,
    )


def _require_plain(request: ScoreRequest) -> None:
    """A run says itself how its motions were made."""
    for name in _STATED_BY_THE_RUN:
        if getattr(request, name) is not None:
            raise UsageError(
                f"--{name.replace('_', '-')}: {request.predictions} is a run, whose run.json says how its motions were"
                " made. Leave the option out."
            )


def _selections(request: ScoreRequest, record: RunRecord, table: SequenceTable) -> tuple[Selection, Selection]:
    """The chosen sequences, and those of them that have to be there."""
    limit = record.limit if request.limit is None else request.limit
    chosen = select(table, split=request.split or record.split, limit=limit)
    if record.sequences and request.limit is None:
        chosen = chosen.chosen(np.isin(chosen.sequence_ids, record.sequences))
    return chosen, supported(chosen, max_frames=record.method.max_frames, native_fps=record.method.native_fps)


def score_predictions(
    request: ScoreRequest,
    *,
    given: GivenMotions | None = None,
    engine: Engine | None = None,
    progress: ProgressCallback = silent,
) -> tuple[ScoreReport, ...]:
    """Score predictions against tables.

    Args:
        request: What to score.
        given: The motions where they are in memory; by default they are read from ``request.predictions``.
        engine: Where the work is done; changes no value.
        progress: Called after every scored window.

    Returns:
        One report a table, in the order of the tables.

    Raises:
        PredictionsError: if sequences are missing, repeated or unknown (named), or a motion has a wrong shape, another
            length than the recorded one, or NaN; or if the conditions file is not of these tables.
        RunError: if a run folder belongs to another table.
        TableError: if a table is missing, empty or of an unknown version.
        UsageError: if the request contradicts its conditions file.
        StorageError: if the results cannot be written.
    """
    tables = open_tables(request.data)
    work = Work(engine or InProcess(), progress)
    run = _run_of(request.predictions) if given is None else None
    with nullcontext() if request.out is None else sole_writer(request.out):
        if run is not None:
            return score_run(run, tables, request, work)
        # Score the motions of a file, or those in memory.
        name = request.name or _name_of(request.predictions)
        protocol = protocol_for(request.protocol, (table.described_protocol for table in tables))
        stated = _stated(tables, request)
        chosen = [select(table, split=stated.split, limit=stated.limit) for table in tables]
        selections = [_supported(each, stated) for each in chosen]
        predictions = Predictions.open(request.predictions) if given is None else given.predictions
        samples = _require_fit(predictions, selections, stated, request)
        rules = ScoringRules(
            protocol.metrics,
            allow_length_mismatch=request.allow_length_mismatch,
            id_seed=stated.seed,
            native_fps=stated.native_fps,
        )
        digest = ""  # takes long, and nobody asks for it where nothing is written
        if request.out is not None:
            digest = predictions_digest(request.predictions) if given is None else given.digest
        record = RunRecord(
            schema_version=RUN_SCHEMA_VERSION,
            prbench_version=prbench.__version__,
            protocol_version=protocol.version,
            protocol_digest=protocol.digest,
            method=MethodRecord(
                name=name,
                kind=FILE,
                package=request.predictions.name,
                version=digest[:12],
                weights=None,
                weights_digest=None,
                options={},
                max_frames=stated.max_frames,
                native_fps=stated.native_fps,
                motionless=False,
                gaze=predictions.has_gaze,
            ),
            condition=stated.condition.value if stated.condition else UNSTATED,
            control=stated.control,
            split=stated.split,
            limit=stated.limit,
            seed=stated.seed,
            samples=len(samples),
            device=_ELSEWHERE,
            threads=0,
            packages={},
            tables=tuple(table_record(each, own, _NO_BATCHES) for each, own in zip(chosen, selections)),
        )
        scored = tuple(
            Scored.of(record, table, selection, predictions, samples=samples, rules=rules, protocol=protocol, work=work)
            for table, selection in zip(record.tables, selections)
        )
        folders: tuple[Path | None, ...] = (None,) * len(scored)
        if request.out is not None:
            folders = write_submission(request.out, record, scored, protocol)
        origin = f"file {clean(request.predictions.name)}"
        return tuple(
            ScoreReport(one.scores, one.summary, at, origin, one.agreement) for one, at in zip(scored, folders)
        )


def _stated(tables: list[SequenceTable], request: ScoreRequest) -> Stated:
    """Return what is known of the motions."""
    stated = stated_by_request(request)
    if request.conditions is not None:
        stated = stated_by_conditions(read_conditions_file(request.conditions), tables, request)
    if stated.native_fps is not None and request.allow_length_mismatch:
        raise UsageError("--allow-length-mismatch: motions that have to be resampled need the length of --native-fps.")
    return stated


def _supported(chosen: Selection, stated: Stated) -> Selection:
    selection = supported(chosen, max_frames=stated.max_frames, native_fps=stated.native_fps)
    if not len(selection):
        raise UsageError(
            f"--max-frames {stated.max_frames}: all {len(chosen)} chosen sequences of {chosen.table.info.dataset} are"
            " longer."
        )
    return selection


def _require_fit(
    predictions: Predictions, selections: list[Selection], stated: Stated, request: ScoreRequest
) -> list[int]:
    """The samples, if every sequence has its motions and those have the right lengths as far as is known yet."""
    wanted = Wanted(
        path=request.predictions,
        selections=tuple(selections),
        seed=stated.seed,
        samples=stated.samples,
        native_fps=stated.native_fps,
        conditions=request.conditions,
    )
    samples = require_complete(predictions, wanted)
    if not request.allow_length_mismatch:
        require_lengths(predictions, wanted, samples)
    return samples


def _name_of(path: Path) -> str:
    """Return the name of the file; a folder ``motions`` is named by the one that it stands in.

    Raises:
        UsageError: if the method cannot be called that.
    """
    name = path.absolute().stem
    if problem := name_problem(name):
        raise UsageError(f"{clean(path)}: {problem}. Say what the method is called with --name.")
    return name


def _run_of(path: Path) -> RunFolder | None:
    """The run that a path belongs to: its folder, its part for a dataset, or the predictions in there.

    Raises:
        RunError: if the folder holds the scores of a submission, without motions.
    """
    for base in (path, path.parent, path.parent.parent):
        if not (base / run_record.FILE_NAME).is_file():
            continue
        run = RunFolder.open(base)
        parts = [run.dataset(table.dataset) for table in run.record.tables]
        if path == base or any(path in (part.path, part.predictions) for part in parts):
            if run.record.method.kind == run_record.FILE:
                raise RunError(
                    f"{base}: holds the scores of {run.record.method.package}, not its motions. Score that file again."
                )
            return run
    return None
