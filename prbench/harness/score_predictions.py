"""Score motions that lie on disk: those of a run folder, or a file that somebody hands in; and the request to do so."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

import prbench
from prbench.checking.doctor.motion_set import Diagnosis
from prbench.contract import GIVEN, Condition
from prbench.engine import Engine, InProcess
from prbench.engine.pool import give_back
from prbench.errors import PredictionsError, RunError, StorageError, UsageError
from prbench.files.storage import file_digest, remove_half_written, sole_writer, text_digest, turn_into_paths
from prbench.harness import offline
from prbench.harness.agreement import agreement_with_people
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.methods.installed import SHUFFLED_GOAL, name_problem
from prbench.harness.planning import Selection, open_tables, select, supported
from prbench.harness.preparation import table_record
from prbench.harness.request import ProgressCallback, reported, require_settings, silent
from prbench.harness.results import cases_of_run, differences, require_scores, summary_of, tree_of, work_of_run
from prbench.harness.run_folder import (
    CodedScores,
    DatasetAgreement,
    DatasetFolder,
    DatasetSummary,
    Predictions,
    RunFolder,
)
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.folder import run_folder_of
from prbench.harness.run_folder.predictions import write_part
from prbench.harness.run_folder.record import FILE, MethodRecord, RunCost, RunRecord, TableRecord
from prbench.harness.run_folder.scores import RUN_SCHEMA_VERSION
from prbench.harness.run_folder.summary import FILE_NAME as SUMMARY_FILE
from prbench.harness.scoring import ScoringRules, at_table_rate, certain_faults, score_selection
from prbench.protocol.manifests import BenchmarkProtocol
from prbench.protocol.own_protocol import FILE_NAME, protocol_for, write_protocol
from prbench.sequences import SequenceTable
from prbench.shown import clean, listed


@dataclass(frozen=True, kw_only=True)
class ScoreRequest:
    """The predictions to score, and the tables to score them on.

    What is None is taken from the run, or from the conditions file; saying it otherwise than that file is an error.

    Attributes:
        predictions: A run folder, its part for one dataset, a Parquet file with the columns sequence_id (or opaque_id),
            sample (0 if absent) and joints, a folder of such files, or an ``.npz``.
        data: The dataset folders.
        conditions: The file of `prbench export-conditions` that the motions were made from.
        split: Split; by default that of the run, else ``test``.
        limit: Sequences of each dataset; by default as many as the run has, else all.
        seed: Seed behind the opaque ids, if the predictions have those; 0 by default.
        condition: Condition that the method was given, for the record.
        control: ``shuffled-goal`` if that is how the conditions were made; a conditions file tells by its goals.
        max_frames: The method makes no more: longer sequences are not missed but count as unsupported.
        native_fps: Rate of the motions, if it is another than the table's; they are resampled.
        name: Name of the method; by default that of the file.
        protocol: The user's own protocol; by default that of the run, else prbench's.
        out: Folder that gets ``<dataset>/scores.parquet``, ``<dataset>/summary.json`` and what a leaderboard needs
            beside them; nothing is written without it.
        keep_motions: The motions of a file are kept there, too, so that they can be submitted.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    predictions: Path
    data: tuple[Path, ...]
    conditions: Path | None = None
    split: str | None = None
    limit: int | None = None
    seed: int | None = None
    condition: Condition | None = None
    control: str | None = None
    max_frames: int | None = None
    native_fps: float | None = None
    name: str | None = None
    allow_length_mismatch: bool = False
    protocol: Path | None = None
    out: Path | None = None
    keep_motions: bool = False

    def __post_init__(self) -> None:
        turn_into_paths(self, "predictions", "data", "conditions", "protocol", "out")
        if not self.data:
            raise UsageError("scoring needs one dataset folder or more (--data DIR).")
        require_settings({}, control=self.control, native_fps=self.native_fps)
        if self.name is not None and (problem := name_problem(self.name)):
            raise UsageError(f"--name: {problem}.")


@dataclass(frozen=True)
class ScoreReport:
    """Scores of one dataset in long form, and their summary.

    Attributes:
        folder: Folder that they were written to; None if nowhere.
        origin: Origin of the motions, in words: ``MethodRecord.origin``.
        agreement: Agreement with recorded people, and rates by the goal's place.
        motionless: The run declares that its motions stand still, so that Foot Skating says nothing.
        changed: The first value of the run's own summary that is another one now, and how many more there are.
    """

    coded: CodedScores
    summary: DatasetSummary
    folder: Path | None
    origin: str
    agreement: DatasetAgreement
    motionless: bool = False
    changed: str = ""

    @property
    def scores(self) -> pa.Table:
        """The rows of ``scores.parquet``."""
        return self.coded.long_form()


def settled_by_conditions(
    request: ScoreRequest, conditions: offline.ConditionsFile, tables: list[SequenceTable]
) -> ScoreRequest:
    """Return the request with what the conditions file says; the file is held, row by row, against the tables.

    Raises:
        UsageError: if the request says something else.
        PredictionsError: if the file was made from other tables, or its rows were changed.
    """
    info = conditions.info
    path = request.conditions
    assert path is not None
    names = ("condition", "seed", "split", "limit", "max_frames", "native_fps")
    stated: dict[str, Any] = {name: getattr(info, name) for name in names}
    for name, found in stated.items():
        asked = getattr(request, name)
        if asked is not None and asked != found:
            flag = f"--{name.replace('_', '-')}"
            shown = "none" if found is None else found
            raise UsageError(f"{flag} {asked}: {path} was exported with {shown}. Leave {flag} out.")
    samples = int(conditions.sample.max(initial=-1)) + 1
    if info.samples != samples:
        remedy = "It was changed; export it again."
        raise PredictionsError(f"{path}: expected rows of {info.samples} samples, found {samples}. {remedy}")
    listed = ", ".join(str(table.folder) for table in tables)
    # Fingerprints instead of names: the file must not tell a method which data it is asked about.
    if info.tables != offline.fingerprints(table.identity for table in tables):
        refusal = f"{path}: expected conditions of {listed}, found those of {len(info.tables)}"
        refusal += f" table{'' if len(info.tables) == 1 else 's'} of which not all are given or one is another. Give"
        raise PredictionsError(f"{refusal} --data the very tables that the conditions were exported from.")
    # Nothing in the file says whether goals were shuffled; the goals themselves do.
    has_goals = bool(offline.GOALS & set(offline.given_columns(info.condition)))
    different = []
    for control in (None, SHUFFLED_GOAL) if has_goals else (None,):
        wanted = offline.ExportRequest(data=request.data, out=path, samples=info.samples, control=control, **stated)
        made = offline.conditions_of(tables, wanted)[0]
        difference = None  # column and row of the file that the tables do not give
        if len(made) != len(conditions):
            difference = f"{len(conditions)} rows"
        else:
            for name in ("opaque_id", "sample", "noise_seed", "n_frames", "fps", *conditions.given):
                wrong = np.asarray(getattr(conditions, name)) != np.asarray(getattr(made, name))
                rows = np.flatnonzero(wrong.reshape(len(made), -1).any(axis=1))
                if rows.size:
                    difference = f"column '{name}', row {rows[0]}"
                    break
        if difference is None:
            break
        different.append(difference)
    else:
        problem = "something else. The file was changed, or exported from another build of the same recordings"
        why = "export the conditions again."
        raise PredictionsError(f"{path}, {different[0]}: expected what {listed} give, found {problem}: {why}")
    if request.control not in (None, control):
        raise UsageError(f"--control {request.control}: the goals in {path} are each sequence's own.")
    return replace(request, control=control, **stated)


def require_complete(
    predictions: Predictions, request: ScoreRequest, selections: Sequence[Selection], *, seed: int, samples: int | None
) -> list[int]:
    """Return the samples, if every sequence has each of them exactly once and nothing else is there.

    Args:
        predictions: The motions.
        request: Names files in messages.
        selections: The sequences of each table.
        seed: Seed behind opaque ids.
        samples: Motions of each sequence; None for as many as are there.

    Raises:
        PredictionsError: naming sequences that are missing, repeated or unknown.
    """

    def names_of(selection: Selection) -> Sequence[str]:
        if predictions.id_column == "sequence_id":
            return selection.sequence_ids
        return opaque_ids(selection.sequence_ids, run_salt(seed, selection.table.identity))

    sequence_of = {
        name: sequence_id
        for selection in selections
        for name, sequence_id in zip(names_of(selection), selection.sequence_ids, strict=True)
    }
    # Every sequence needs the same samples, or means over them would weigh sequences differently.
    wanted = sorted(set(predictions.samples)) if samples is None else list(range(samples))
    counts = Counter(zip(predictions.ids, predictions.samples))
    missing = [
        sequence_id
        for name, sequence_id in sequence_of.items()
        if not wanted or not all((name, sample) in counts for sample in wanted)
    ]
    repeated = sorted({name for (name, _), count in counts.items() if count > 1})
    unknown = set(predictions.ids) - set(sequence_of)
    for selection in selections if unknown else ():
        # The whole split is known, not only what --limit chose: a complete file may be scored in part.
        unknown -= set(names_of(select(selection.table, split=selection.split, limit=None)))
    surplus = sorted(set(predictions.samples) - set(wanted))
    if not missing and not repeated and not unknown and not surplus:
        return wanted
    there = {sequence_id for name, sequence_id in sequence_of.items() if name in set(predictions.ids)}
    expected = " and ".join(f"{len(one)} {one.split} sequences of {one.table.info.dataset}" for one in selections)
    each = f", each with samples {', '.join(map(str, wanted))}" if len(wanted) > 1 else ""
    if (run_folder_of(request.predictions) / run_record.FILE_NAME).is_file():
        remedy = "Run the same command again: it resumes."
    elif predictions.id_column == "opaque_id" and unknown and not there:
        remedy = f"Opaque ids hold for one seed and one table: is --seed {seed} that of the run, and --data its table?"
        if request.conditions is not None:
            remedy = f"None of the ids stands in {request.conditions}: is it the file that the motions were made from?"
    elif repeated and len(repeated) == len(set(predictions.ids)):
        remedy = "Where a sequence has several motions, number them from 0 in 'sample', as the conditions file does."
    else:
        remedy = "Hand in every sequence exactly once for each sample, or name the split that the motions are of"
        remedy += f" (--split, split=; {selections[0].split} is scored) or a part of it (--limit, limit=)."
    problem = f"{request.predictions}: expected the {expected}{each}, found {len(there - set(missing))}: missing"
    problem += f" {listed(missing)}, repeated {listed(repeated)}, unknown"
    problem += f" {listed(sorted(unknown))}{f', samples that were not asked for {surplus[:3]}' if surplus else ''}."
    raise PredictionsError(f"{problem} {remedy}")


# Condition of motions of which nobody said what they were made from; never ranked.
UNSTATED = "unstated"
InMemory = tuple[Predictions, str] | None
KeepMotions = Callable[[DatasetFolder], None]
_STATED_BY_THE_RUN = ("conditions", "condition", "control", "seed", "split", "max_frames", "native_fps", "name")


def score_predictions(
    request: ScoreRequest, *, given: InMemory = None, engine: Engine | None = None, progress: ProgressCallback = silent
) -> tuple[ScoreReport, ...]:
    """Score predictions against tables.

    Args:
        request: What to score.
        given: The motions where they are in memory, and a digest over their ids and values; by default they are read
            from ``request.predictions``.
        engine: Processes or cluster that scores; changes no value.
        progress: Called after every scored window.

    Returns:
        One report a table, in the order of the tables.

    Raises:
        PredictionsError: if sequences are missing, repeated or unknown (named), or a motion has a wrong shape, another
            length than the recorded one, or NaN; or if the conditions file is not of these tables.
        RunError: if a run folder belongs to another table.
        TableError: if a table is missing, empty or of an unknown version.
        UsageError: if the request contradicts its conditions file or run.
        StorageError: if the results cannot be written.
    """
    tables = open_tables(request.data)
    engine = engine or InProcess()
    run = None
    path = request.predictions
    # A run is named by its folder, by that of a dataset, or by the predictions in there.
    for base in (path, path.parent, path.parent.parent) if given is None else ():
        if run is None and (base / run_record.FILE_NAME).is_file():
            there = RunFolder.open(base)
            parts = [there.dataset(table.dataset) for table in there.record.tables]
            if path == base or any(path in (part.path, part.predictions) for part in parts):
                run = there
    if run is not None and run.record.method.kind == run_record.FILE:
        remedy = "Score that file again."
        raise RunError(f"{run.path}: holds the scores of {run.record.method.package}, not its motions. {remedy}")
    if request.keep_motions and (run is not None or request.out is None):
        raise UsageError("--keep-motions: keeps finished motions from a file, in the folder of --out.")
    with nullcontext() if request.out is None else sole_writer(request.out):
        if run is not None:
            protocol, reports = _score_run(run, tables, request, engine, progress)
            return _written(request.out, reports, protocol, record=None)
        record, protocol, reports, keep = _score_file(tables, request, given, engine, progress)
        return _written(request.out, reports, protocol, record=record, keep=keep if request.keep_motions else ())


def _score_run(
    run: RunFolder, tables: list[SequenceTable], request: ScoreRequest, engine: Engine, progress: ProgressCallback
) -> tuple[BenchmarkProtocol, list[ScoreReport]]:
    for name in _STATED_BY_THE_RUN:
        if getattr(request, name) is not None:
            why = f"{request.predictions} is a run, whose run.json says how its motions were made"
            raise UsageError(f"--{name.replace('_', '-')}: {why}. Leave the option out.")
    # A run of an earlier version of prbench's own protocol is scored by today's.
    followed = run.protocol
    own = run.path / FILE_NAME if followed is not None and followed.is_own else None
    protocol = protocol_for(request.protocol or own, (table.described_protocol for table in tables))
    record = run.record
    reports = []
    for table in tables:
        asked, chosen, selection = cases_of_run(run, table, limit=request.limit)
        files = run.dataset(table.info.dataset)
        predictions = Predictions.open(files.predictions)
        require_complete(predictions, request, [selection], seed=record.seed, samples=record.samples)
        work = work_of_run(run, asked, selection, protocol)
        scores = CodedScores.of(reported(work.scores(files, engine), table.info.dataset, len(selection), progress))
        table_entry = table_record(chosen, selection)
        report = _report(record, table_entry, selection, scores, work.findings(files), protocol)
        reports.append(replace(report, changed=_changed(files, report)) if request.limit is None else report)
    return protocol, reports


def _changed(files: DatasetFolder, now: ScoreReport) -> str:
    """Say what a run's own files say otherwise: the first value and how many more; empty where nothing differs."""
    if not files.finished:
        return ""
    try:
        found = list(differences(tree_of(DatasetSummary.read(files.path)), tree_of(now.summary)))
        if not found:
            require_scores(files, CodedScores.read(files.scores), now.coded)
            return ""
    except RunError as error:
        return str(error)
    key, stored, scored = found[0]
    rest = f"; and {len(found) - 1} more" if found[1:] else ""
    return f"{files.path / SUMMARY_FILE}, {key}: {stored} there, {scored} when scored now{rest}"


def _score_file(
    tables: list[SequenceTable], request: ScoreRequest, given: InMemory, engine: Engine, progress: ProgressCallback
) -> tuple[RunRecord, BenchmarkProtocol, list[ScoreReport], list[KeepMotions]]:
    path = request.predictions
    name = request.name or path.absolute().stem
    if problem := name_problem(name):
        raise UsageError(f"{clean(path)}: {problem}. Say what the method is called with --name.")
    protocol = protocol_for(request.protocol, (table.described_protocol for table in tables))
    samples = None
    if request.conditions is not None:
        conditions = offline.read_conditions_file(request.conditions)
        samples = conditions.info.samples
        request = settled_by_conditions(request, conditions, tables)
    if request.native_fps is not None and request.allow_length_mismatch:
        raise UsageError("--allow-length-mismatch: motions that have to be resampled need the length of --native-fps.")
    split = request.split or "test"
    seed = request.seed or 0
    chosen = [select(table, split=split, limit=request.limit) for table in tables]
    selections = [supported(each, max_frames=request.max_frames, native_fps=request.native_fps) for each in chosen]
    for each, selection in zip(chosen, selections, strict=True):
        if not len(selection):
            why = f"all {len(each)} chosen sequences of {each.table.info.dataset} are longer."
            raise UsageError(f"--max-frames {request.max_frames}: {why}")
    predictions = Predictions.open(path) if given is None else given[0]
    found = require_complete(predictions, request, selections, seed=seed, samples=samples)
    digest = ""  # takes long, and nobody asks for it where nothing is written
    if request.out is not None:
        if given is not None:
            digest = given[1]
        elif path.is_file():
            digest = file_digest(path)
        else:
            files = sorted(file for file in path.rglob("*") if file.is_file())
            named = ((file.relative_to(path).as_posix(), file_digest(file)) for file in files)
            digest = text_digest(*itertools.chain.from_iterable(named))
    limits = {"max_frames": request.max_frames, "native_fps": request.native_fps}
    method = MethodRecord.of_file(name, path.name, digest, **limits, gaze=predictions.has_gaze)
    record = RunRecord(
        schema_version=RUN_SCHEMA_VERSION,
        prbench_version=prbench.__version__,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        method=method,
        condition=request.condition.value if request.condition else UNSTATED,
        control=request.control,
        split=split,
        limit=request.limit,
        seed=seed,
        samples=len(found),
        device="offline",
        threads=0,
        packages={},
        tables=tuple(table_record(each, own) for each, own in zip(chosen, selections, strict=True)),
    )
    rules = ScoringRules(
        protocol.metrics,
        pose_given=request.condition is not None and "initial_joints" in GIVEN[request.condition],
        **{name: getattr(request, name) for name in ("allow_length_mismatch", "native_fps")},
        id_seed=seed,
    )
    reports = []
    keep: list[KeepMotions] = []
    for table, selection in zip(record.tables, selections, strict=True):
        keep.append(partial(_keep_motions, selection, predictions, found, rules, protocol.version))
        windows = score_selection(selection, predictions, samples=found, rules=rules, engine=engine)
        scores = CodedScores.of(reported(windows, table.dataset, len(selection), progress))
        given_as = {"condition": record.condition, "id_seed": seed, "native_fps": request.native_fps}
        findings = certain_faults(selection, predictions, **given_as)
        reports.append(_report(record, table, selection, scores, findings, protocol))
    return record, protocol, reports, keep


def _keep_motions(
    cases: Selection, stored: Predictions, samples: list[int], rules: ScoringRules, version: int, files: DatasetFolder
) -> None:
    """Write motions as a run has them: under the ids of the table, at its rate."""
    salt = run_salt(rules.id_seed, cases.table.identity)
    for number, (place, chunk) in enumerate(cases.windows(["n_frames"])):
        ids = chunk.sequence_ids
        names = opaque_ids(ids, salt) if stored.id_column == "opaque_id" else ids
        motions = [stored.motions(names, sample) for sample in samples]
        if rules.native_fps is not None:
            step = rules.native_fps / cases.fps
            motions = [at_table_rate(each, cases.n_frames[place], step=step) for each in motions]
        seeds = [[rules.id_seed] * len(ids)] * len(samples)
        write_part(files.part(number), ids, seeds, motions, protocol_version=version)


def _report(
    record: RunRecord,
    table: TableRecord,
    selection: Selection,
    scores: CodedScores,
    findings: tuple[Diagnosis, ...],
    protocol: BenchmarkProtocol,
) -> ScoreReport:
    give_back()
    agreement = agreement_with_people(selection, scores, protocol=protocol)
    give_back()
    recording_of = dict(zip(selection.sequence_ids, selection.recording_ids, strict=True))
    summary = summary_of(record, table, scores, recording_of, findings)
    return ScoreReport(scores, summary, None, record.method.origin, agreement, record.method.motionless)


def _written(
    folder: Path | None,
    reports: list[ScoreReport],
    protocol: BenchmarkProtocol,
    *,
    record: RunRecord | None,
    keep: Sequence[KeepMotions] = (),
) -> tuple[ScoreReport, ...]:
    """Write scores as a leaderboard reads them; those of a run beside what it has itself, without its ``run.json``.

    Raises:
        RunError: if the folder belongs to another submission.
        StorageError: if it is that of a run, holds something else, or cannot be written.
    """
    if folder is None:
        return tuple(reports)
    if (folder / run_record.FILE_NAME).is_file() and RunRecord.read(folder).method.kind != FILE:
        raise StorageError(f"{folder}: is a run folder with scores of its own. Choose another folder for --out.")
    if record is None:
        remove_half_written(folder)
        parts = [folder / one.summary.dataset for one in reports]
    else:
        run = RunFolder.prepare(folder, record, protocol)
        parts = [run.dataset(one.summary.dataset).path for one in reports]
    for part, keep_motions in zip(parts, keep):
        keep_motions(DatasetFolder(part))
    for part, one in zip(parts, reports, strict=True):
        one.coded.write(part / "scores.parquet")
        if record is not None:
            RunCost().write(part / "cost.json")  # nothing was measured
        one.agreement.write(part)
        one.summary.write(part)
    write_protocol(folder, protocol)
    return tuple(replace(one, folder=part) for part, one in zip(parts, reports, strict=True))
