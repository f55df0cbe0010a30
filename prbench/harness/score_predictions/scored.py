"""The scores of one table: what was chosen of it, the long form, and the summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import prbench
from prbench.engine import Engine
from prbench.engine.memory import give_back
from prbench.errors import StorageError
from prbench.files.storage import file_digest, remove_half_written, text_digest
from prbench.harness.agreement import agreement_with_people
from prbench.harness.planning import Selection
from prbench.harness.preparation import table_record
from prbench.harness.request import ProgressCallback, reported
from prbench.harness.results import ScoredSet, summarise
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.agreement import DatasetAgreement
from prbench.harness.run_folder.coded_scores import CodedScores
from prbench.harness.run_folder.cost import total_cost
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.record import FILE, BatchPlanRecord, MethodRecord, RunRecord
from prbench.harness.run_folder.scores import RUN_SCHEMA_VERSION
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.harness.score_predictions.request import Stated
from prbench.harness.scoring import ScoringRules, score_selection
from prbench.metrics import METRICS
from prbench.protocol.manifests import BenchmarkProtocol
from prbench.protocol.own_protocol import write_protocol

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


@dataclass(frozen=True, kw_only=True)
class About:
    """Facts on the motions that a summary holds beside their scores."""

    method: str
    condition: str
    control: str | None
    obstacles: bool = False
    """The method was given the solid boxes around each sequence, as far as a run's record says."""


@dataclass(frozen=True)
class Scored:
    """The results of one table."""

    chosen: Selection
    """The sequences of split and limit."""
    selection: Selection
    """The chosen sequences that were scored."""
    scores: CodedScores
    summary: DatasetSummary
    agreement: DatasetAgreement

    @classmethod
    def of(
        cls,
        chosen: Selection,
        selection: Selection,
        predictions: Predictions,
        *,
        samples: Sequence[int],
        rules: ScoringRules,
        protocol: BenchmarkProtocol,
        about: About,
        work: Work,
    ) -> Scored:
        """Score the motions of a table and summarise them."""
        windows = score_selection(selection, predictions, samples=samples, rules=rules, engine=work.engine)
        dataset = selection.table.info.dataset
        scores = CodedScores.of(reported(windows, dataset, len(selection), work.progress))
        give_back()
        agreement = agreement_with_people(selection, scores, protocol=protocol)
        give_back()
        scored = ScoredSet(
            info=selection.table.info,
            metrics=METRICS,
            recording_of=dict(zip(selection.sequence_ids, selection.recording_ids)),
            chosen=len(chosen),
            method=about.method,
            condition=about.condition,
            control=about.control,
            split=selection.split,
            samples=len(samples),
            gaze=predictions.has_gaze,
            obstacles=about.obstacles,
        )
        return cls(chosen, selection, scores, summarise(scores, scored), agreement)


def offline_record(
    name: str, stated: Stated, scored: tuple[Scored, ...], *, package: str, digest: str, protocol: BenchmarkProtocol
) -> RunRecord:
    """Return what is known of a submission as a run's record.

    Args:
        name: Name of the method.
        stated: How its motions were made.
        scored: Their scores, one a table.
        package: Name of the file that the motions came as.
        digest: Digest of the motions; its beginning is the version of the method.
        protocol: Rules by which they were scored.
    """
    return RunRecord(
        schema_version=RUN_SCHEMA_VERSION,
        prbench_version=prbench.__version__,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        method=MethodRecord(
            name=name,
            kind=FILE,
            package=package,
            version=digest[:12],
            weights=None,
            weights_digest=None,
            options={},
            max_frames=stated.max_frames,
            native_fps=stated.native_fps,
            motionless=False,
            gaze=any(one.summary.gaze for one in scored),
        ),
        condition=stated.condition.value if stated.condition else UNSTATED,
        control=stated.control,
        split=stated.split,
        limit=stated.limit,
        seed=stated.seed,
        samples=scored[0].summary.samples,
        device=_ELSEWHERE,
        threads=0,
        packages={},
        tables=tuple(table_record(one.chosen, one.selection, _NO_BATCHES) for one in scored),
    )


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
