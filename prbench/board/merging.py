"""Runs on the folds of one dataset, merged: every sequence is scored once, by a method that never saw its participant.

Source: docs/specification/protocol.md#participant-folds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import pyarrow as pa

from prbench.checking.doctor.motion_set import Diagnosis
from prbench.engine import Engine
from prbench.errors import RunError, StorageError, UsageError
from prbench.files.storage import atomic_folder, sole_writer, text_digest, write_json
from prbench.harness.request import DEFAULT_PARENT, ProgressCallback, RunRequest, silent
from prbench.harness.results import RunChecker, summary_of
from prbench.harness.run import RunReport, run_method
from prbench.harness.run_folder.folder import FOLDS_FILE, MERGED, FoldRun, RunFolder, read_folds
from prbench.harness.run_folder.record import BatchPlanRecord, RunCost, RunRecord, TableRecord, total_cost
from prbench.harness.run_folder.scores import read_scores, write_scores
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.protocol.manifests import PROTOCOL_NAME
from prbench.protocol.own_protocol import write_protocol
from prbench.sequences.folds import ALL_FOLDS, participant_units
from prbench.sequences.sequence import recording_key
from prbench.sequences.table import SequenceTable

# Stands beside the name of weights that no fold has trained: they may have learnt from the people tested on.
SAME_WEIGHTS = "the same in every fold"


@dataclass(frozen=True, eq=False)
class MergedRun:
    """The runs on all folds as one.

    Attributes:
        record: Record as of one run, with digests of the folds' digests.
        scores: Scores of all folds, in their order.
        folds: Runs in the order of the folds.
        unverified: A sentence for each run whose scores could not be verified.
    """

    record: RunRecord
    summary: DatasetSummary
    scores: pa.Table
    folds: tuple[RunFolder, ...]
    unverified: tuple[str, ...]

    def write(self, out: Path) -> None:
        """Write a run folder that ``prbench leaderboard export`` shows beside others, whole or not at all.

        Raises:
            StorageError: if the folder holds anything but the very same merged run, or cannot be written.
        """
        made_from = tuple(map(FoldRun.of, self.folds))
        with sole_writer(out):
            if out.exists() and (not out.is_dir() or any(out.iterdir())):
                if (out / FOLDS_FILE).is_file() and read_folds(out) == made_from:
                    return
                what = "something else than these runs merged"
                raise StorageError(f"{out}: holds {what}. Choose a new folder for --out.")
            with atomic_folder(out) as folder:
                self.record.write(folder)
                protocol = self.folds[0].protocol
                if protocol is not None:
                    write_protocol(folder, protocol)
                dataset = self.summary.dataset
                files = RunFolder(folder, self.record).dataset(dataset)
                write_scores(files.scores, [self.scores])
                total_cost([RunCost.read(run.dataset(dataset).cost) for run in self.folds]).write(files.cost)
                write_json(folder / FOLDS_FILE, {"folds": msgspec.to_builtins(made_from)})
                self.summary.write(files.path)


def run_folds(request: RunRequest, *, engine: Engine | None = None, progress: ProgressCallback = silent) -> RunReport:
    """Test a method on every participant of a table in turn, and merge the runs; goes on where it was interrupted.

    The runs stand in ``fold-K-of-N`` of the run folder, and what they are together in ``merged``.

    Args:
        request: One table, and ``fold`` of any value. ``{fold}`` in the weights stands for the number of the fold.
        engine: See :func:`prbench.harness.run.run_method`.
        progress: See there.

    Returns:
        The merged run.

    Raises:
        UsageError: if there is more than one table, or it has no participants.
        TableError: see :func:`prbench.sequences.folds.participant_folds`.
        RunError: if a run folder belongs to another run.
    """
    if request.benchmark != PROTOCOL_NAME or len(request.data) != 1:
        raise UsageError(f"--folds {ALL_FOLDS}: expected one table of {PROTOCOL_NAME}, found {len(request.data)}.")
    table = SequenceTable.open(request.data[0]).with_sequences()
    count = max(len(set(participant_units(table).values())), 2)
    out = request.out or DEFAULT_PARENT / f"{request.method_label}-{table.info.dataset}-folds".replace(" ", "_")
    reports = []
    with sole_writer(out):
        for number in range(1, count + 1):
            weights = request.weights and Path(str(request.weights).replace("{fold}", str(number)))
            place = out / f"fold-{number}-of-{count}"
            one = replace(request, fold=f"{number}/{count}", weights=weights, out=place)
            reports.append(run_method(one, engine=engine, progress=progress))
        merged = merge_folds([report.folder.path for report in reports])
        merged.write(out / MERGED)
    made = sum(report.batches_made for report in reports)
    found = sum(report.batches_found for report in reports)
    return RunReport(RunFolder.open(out / MERGED), (merged.summary,), made, found)


def merge_folds(paths: Sequence[Path], *, checker: RunChecker | None = None) -> MergedRun:
    """Summarise the scores of several runs as if they were one.

    Weights and tables differ between folds; all else has to agree.

    Args:
        paths: Finished runs of one dataset each, one a fold.
        checker: Holds the tables at hand, on which motions are scored again; by default none.

    Raises:
        RunError: if runs are unfinished, of more than one dataset, of different methods, conditions or protocols, are
            not on the folds of one table, or a fold is missing or there twice.
    """
    runs = [RunFolder.open(path) for path in paths]
    if len(runs) < 2:
        raise RunError(f"expected a run of each fold, found {len(runs)}.")
    expected = _design(runs[0].record)
    for run in runs:
        if len(run.record.tables) != 1:
            raise RunError(f"{run.path}: expected a run of one dataset, found {len(run.record.tables)}.")
        for name, found in _design(run.record).items():
            if found != expected[name]:
                raise RunError(f"{run.path}: expected {name} {expected[name]} as in {runs[0].path}, found {found}.")
    runs = _in_order(runs)
    unverified = []
    scores = []
    findings: dict[str, Diagnosis] = {}
    owner: dict[str, Path] = {}
    for run in runs:
        table = run.record.tables[0]
        files = run.dataset(table.dataset)
        if not files.finished:
            raise RunError(f"{run.path}: not finished on {table.dataset}; run it again, it resumes.")
        checked = (checker or RunChecker()).check(run, table)
        if checked.unverified:
            unverified.append(f"{run.path}: {checked.unverified}")
        findings |= {found.kind: found for found in checked.summary.findings}
        scores.append(read_scores(files.scores))
        for name in set(scores[-1]["sequence_id"].to_pylist()):
            if name in owner:
                raise RunError(f"{run.path}: sequence {name} is scored in {owner[name]}, too; folds share no sequence.")
            owner[name] = run.path
    # Whatever differs between folds becomes the digest of all of theirs.
    records = [run.record for run in runs]
    tables = [record.tables[0] for record in records]
    plans = [table.batch_plan for table in tables]
    plan_digest = text_digest(*(plan.digest for plan in plans))
    batches = sum(plan.batches for plan in plans)
    same = ("dataset", "title", "synthetic", "redistribution", "whole_table")
    together = TableRecord(
        **{name: getattr(tables[0], name) for name in same},
        identity_digest=text_digest(*(table.identity_digest for table in tables)),
        content_digest=text_digest(*(table.content_digest for table in tables)),
        sequences=sum(table.sequences for table in tables),
        unsupported=sum(table.unsupported for table in tables),
        selection_digest=text_digest(*sorted(owner)),
        batch_plan=BatchPlanRecord(batch_size=plans[0].batch_size, batches=batches, digest=plan_digest),
        units={name: unit for table in tables for name, unit in table.units.items()},
    )
    method = records[0].method
    weights = [record.method.weights_digest for record in records]
    if len(set(weights)) > 1:  # each was trained on the other folds
        digest = text_digest(*(each or "" for each in weights))
        method = msgspec.structs.replace(method, weights=f"{len(runs)} folds", weights_digest=digest)
    elif method.weights_digest is not None:
        method = msgspec.structs.replace(method, weights=f"{method.weights or 'its own'}, {SAME_WEIGHTS}")
    record = msgspec.structs.replace(records[0], split=f"{len(runs)} folds", method=method, tables=(together,))
    merged = pa.concat_tables(scores)
    recording_of = {name: recording_key(name) for name in owner}
    summary = summary_of(record, together, merged, recording_of, tuple(findings.values()))
    return MergedRun(record, summary, merged, tuple(runs), tuple(unverified))


def _design(record: RunRecord) -> dict[str, object]:
    """Everything in which the runs on all folds have to agree."""
    method = {name: getattr(record.method, name) for name in ("name", "kind", "options", "gaze", "wants_obstacles")}
    same = ("protocol_digest", "condition", "control", "samples", "split", "limit")
    return {
        **{name: getattr(table, name) for table in record.tables[:1] for name in ("dataset", "whole_table")},
        **{f"method {name}": value for name, value in method.items()},
        **{name: getattr(record, name) for name in same},
    }


def _in_order(runs: list[RunFolder]) -> list[RunFolder]:
    """Sort runs by their folds, each of which has to be there once.

    Raises:
        RunError: naming the run that is no fold or is there twice, or the folds that are missing.
    """
    found: dict[int, RunFolder] = {}
    folds = 0
    for run in runs:
        text = run.record.tables[0].fold
        if text is None:
            found_one = "found one on a table that is no fold. Run the method with --fold K/N"
            raise RunError(f"{run.path}: expected a run on a fold of participants, {found_one}.")
        number, _, count = text.partition("/")
        if not (number.isdecimal() and count.isdecimal() and len(text) < 16):
            raise RunError(f"{run.path}: expected a fold such as 2/6 in run.json, found {text[:16]!r}.")
        if int(number) in found and int(count) == (folds or int(count)):
            raise RunError(f"{run.path}: fold {text} is that of {found[int(number)].path}, too.")
        if folds and int(count) != folds:
            raise RunError(f"{run.path}: expected one of {folds} folds as in {runs[0].path}, found fold {text}.")
        folds = int(count)
        found[int(number)] = run
    missing = [str(number) for number in range(1, folds + 1) if number not in found]
    if missing:
        raise RunError(f"expected a run of each of the {folds} folds, found none of {', '.join(missing)}.")
    return [found[number] for number in sorted(found)]
