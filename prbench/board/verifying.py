"""Submissions scored again from their motions, on anybody's own tables of the same sequences."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

import prbench
from prbench.board.collect import collect_runs
from prbench.board.submission import RUNS, Submission
from prbench.engine import Engine, InProcess
from prbench.errors import PredictionsError, RunError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.first_run import table_finder
from prbench.harness.results import CheckedSummary, MetricDrift, RunChecker
from prbench.harness.run_folder.folder import FOLDS_FILE, RunFolder
from prbench.harness.run_folder.record import CONTROL, TableRecord
from prbench.harness.run_folder.summary import FILE_NAME as SUMMARY_FILE
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.metrics.registry import printed_scale, printed_unit


class VerifiedDataset(msgspec.Struct, frozen=True, kw_only=True):
    """One run on one dataset.

    Attributes:
        run: Name of the run.
        dataset: Name of the dataset.
        identity_digest: Digest of the ids of the table, the same here and there.
        content_digest: Digest of the values of the table at hand.
        same_values: The submission was scored on a table of the same values.
        sequences: Number of sequences.
        declared: What the run says and nothing here can show.
        metrics: Each metric as stated and as scored again.
    """

    run: str
    dataset: str
    identity_digest: str
    content_digest: str
    same_values: bool
    sequences: int
    declared: tuple[str, ...]
    metrics: tuple[MetricDrift, ...]


class Verification(msgspec.Struct, frozen=True, kw_only=True):
    """What re-scoring a submission found; made only where nothing was refused. Holds no time, host or path.

    Attributes:
        submission: Name of the submission with the first digits of its digest.
        digest: Its digest.
        prbench_version: Version of prbench that scored it.
        verdict: The result in one sentence.
        training: What its methods learned from: ``not declared``, ``declared none``, ``declared …`` or ``overlaps N
            test recordings``.
        datasets: Each run on each dataset.
    """

    submission: str
    digest: str
    prbench_version: str
    verdict: str
    training: str
    datasets: tuple[VerifiedDataset, ...]


def verify_submission(
    submission: Submission, folder: Path, data: Sequence[Path], *, engine: Engine | None = None
) -> Verification:
    """Score a submission again on tables at hand.

    Args:
        submission: The submission.
        folder: The folder that it was unpacked into.
        data: Folders of tables.
        engine: Processes that score; changes no value.

    Raises:
        RunError: if scores do not follow from the motions, or what a run says of itself is contradicted; if motions are
            copies of recorded ones; if a table or protocol is not at hand.
        PredictionsError: if motions are missing, repeated, unknown, not finite or of another length.
    """
    checker = RunChecker(table_finder(data, same_values=False), engine or InProcess(), same_values=False)
    found: list[VerifiedDataset] = []
    learnt: set[tuple[str, str]] = set()

    def check(run: RunFolder, record: TableRecord) -> CheckedSummary:
        checked = checker.check(run, record)
        if checked.unverified:  # a merged run has the motions of its folds
            return checked
        _require_own_motions(run, record, checked)
        table = checker.find_table(record)
        assert table is not None, "else it would be unverified"
        if submission.training is not None and checked.scored is not None:
            recording_of = load_benchmark(run.record.benchmark).recordings_of(table)
            tested = {recording_of[name] for name in checked.scored.ids}
            learnt.update((record.dataset, name) for name in submission.training.used(table) & tested)
        about = {"run": run.path.name, "dataset": record.dataset, "sequences": record.sequences - record.unsupported}
        about |= {"identity_digest": table.identity, "content_digest": table.content}
        same_values = table.content == record.content_digest
        found.append(
            VerifiedDataset(**about, same_values=same_values, declared=checked.declared, metrics=checked.drifts)
        )
        return checked

    try:
        collected = collect_runs([folder / RUNS], check=check, any_benchmark=True)
    except (RunError, PredictionsError) as error:
        # The folder may be gone when people read this; what stands in it has the names that it has in the archive.
        reason = str(error).replace(f"{os.path.realpath(folder)}/", "")
        raise type(error)(f"submission {submission.id} is refused: {reason}") from error
    problems = [*collected.left_out, *(f"{row.run}: {row.unverified}" for row in collected.rows if row.unverified)]
    expected = {(name, table.dataset) for name, run in submission.runs.items() for table in run.tables}
    # What was merged of folds has no motions of its own; it was held against theirs.
    expected -= {pair for pair in expected if (folder / RUNS / pair[0] / FOLDS_FILE).is_file()}
    for name, dataset in sorted(expected - {(each.run, each.dataset) for each in found}):
        problems.append(f"{name}: expected a run on {dataset}, found none")
    if problems:
        raise RunError(f"submission {submission.id} cannot be verified: {'; '.join(problems)}.")
    about = {"submission": submission.id, "digest": submission.digest, "prbench_version": prbench.__version__}
    about |= {"training": f"overlaps {len(learnt)} test recordings" if learnt else submission.training_words}
    return Verification(**about, verdict=_verdict(found), datasets=tuple(found))


def _require_own_motions(run: RunFolder, record: TableRecord, checked: CheckedSummary) -> None:
    """Refuse copies of recorded motion that are not called so, and faults of the motions that the summary conceals."""
    summary = checked.summary
    if run.record.method.kind != CONTROL and summary.hands_in_recordings:
        counts = f"{summary.recorded_motions} of {summary.sequences - summary.unsupported} sequences"
        said = f"{run.path.name}, {record.dataset}: expected motions of the method, found the recorded ones in {counts}"
        raise RunError(f"{said}. Recorded motion is submitted as the control ground-truth alone.")
    stated = sorted(each.kind for each in DatasetSummary.read(run.dataset(record.dataset).path).findings)
    found = sorted(each.kind for each in summary.findings)
    if stated != found:
        expected, conceals = (", ".join(kinds) or "none" for kinds in (found, stated))
        said = f"findings: expected {expected}, which the motions show, found {conceals}"
        raise RunError(f"{run.dataset(record.dataset).path / SUMMARY_FILE}, {said}. The file was edited.")


def _verdict(found: Sequence[VerifiedDataset]) -> str:
    """Say in one sentence what was found."""
    runs = len({each.run for each in found})
    drifting = [(drift.drift / drift.accepted, each, drift) for each in found for drift in each.metrics]
    counts = f"{runs} run{'s' if runs > 1 else ''}, {sum(each.sequences for each in found)} sequences scored again"
    if all(each.same_values for each in found):
        return f"verified on tables of the same values: {counts}; every score follows from its motion"
    _, each, drift = max(drifting, key=lambda entry: entry[0])
    size = f"{drift.drift * printed_scale(drift.unit):.3g}{printed_unit(drift.unit)}"
    sentence = "verified on tables of the same sequences with other values:"
    return f"{sentence} {counts}; largest drift {size} in {drift.title} ({each.run}, {each.dataset})"
