"""Check that the files of a run follow from one another: summary from scores, scores from motions and table.

The summary is made anew from ``scores.parquet`` wherever a run is read, and one that says something else is refused.
The scores are made anew where the motions and their table are at hand (about 1 s for 7,000 sequences); where they are
not, the run is called unverified.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import msgspec
import numpy as np

from prbench.engine import Engine, InProcess
from prbench.errors import RunError
from prbench.harness.agreement import agreement_with_people, require_agreement
from prbench.harness.benchmark import CaseTable, load_benchmark
from prbench.harness.results import require_scores, require_summary, scored_again, summary_of
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import RunRecord, TableRecord
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.harness.score_predictions import scored_sequences
from prbench.sequences import SequenceTable
from prbench.shown import quoted

_OTHER_PROTOCOL = (
    "it was scored under another protocol than this version's, so metrics and limits that are newer are missing;"
    " `prbench score RUN --data DIR` scores its motions by this version's"
)


@dataclass(frozen=True)
class CheckedSummary:
    """The summary of one dataset of a run, as it follows from the scores."""

    summary: DatasetSummary
    unverified: str
    """Reason why the scores could not be held against the motions; empty where they were."""
    scored: ScoredSequences | None = None
    """What a summary of some of the sequences is made from; None where a test gives a summary alone."""


@dataclass(frozen=True)
class ScoredSequences:
    """The sequences behind a summary, to make one of some of them."""

    run: RunFolder
    record: TableRecord
    recording_of: Mapping[str, str]
    """Maps each sequence that was scored to its recording."""

    @property
    def ids(self) -> frozenset[str]:
        """Ids of the sequences that were scored."""
        return frozenset(self.recording_of)

    def summary_over(self, ids: frozenset[str]) -> DatasetSummary:
        """Summarise the scores of some sequences alone; none of them counts as unsupported.

        Args:
            ids: Sequences that were scored.
        """
        kept = CodedScores.read(self.run.dataset(self.record.dataset).scores).only(ids.__contains__)
        record = msgspec.structs.replace(self.record, sequences=len(ids), unsupported=0)
        return summary_of(self.run.record, record, kept, {name: self.recording_of[name] for name in ids})


@dataclass(frozen=True)
class RunChecker:
    """Checks runs against the tables that are at hand."""

    find_table: Callable[[TableRecord], CaseTable | None] = lambda _: None
    """Gives the very table that a run was made on, if it is at hand."""
    engine: Engine = field(default_factory=InProcess)

    def check(self, run: RunFolder, record: TableRecord) -> CheckedSummary:
        """Check one dataset of a finished run.

        Raises:
            RunError: if the summary does not follow from the scores, or the scores from motions and table; names the
                file and the first value that differs.
        """
        files = run.dataset(record.dataset)
        scores = CodedScores.read(files.scores)
        table = self.find_table(record)
        recording_of, grouped = _recordings_of(run.record, scores, table)
        made = _require_summary_of(run, record, scores, recording_of, grouped=grouped)
        scored = ScoredSequences(run, record, recording_of)
        if not any(files.predictions.glob("part-*.parquet")):
            _require_agreement_of(run, scores, table)
            return CheckedSummary(made, "its folder holds no motions", scored)
        if load_benchmark(run.record.benchmark).rules_of(run) is None:
            return CheckedSummary(made, _OTHER_PROTOCOL, scored)
        if table is None:
            why = f"its table of {record.dataset} is not at hand: name it with --data DIR"
            return CheckedSummary(made, why, scored)
        require_scores(files, scores, scored_again(run, table, self.engine))
        _require_agreement_of(run, scores, table)
        return CheckedSummary(made, "", scored)


def _recordings_of(record: RunRecord, scores: CodedScores, table: CaseTable | None) -> tuple[dict[str, str], bool]:
    """Map each sequence that was scored to its recording; False where nothing says which ones belong together."""
    names = sorted(scores.sequence_ids)
    benchmark = load_benchmark(record.benchmark)
    if table is None:
        # Without the table, ids tell which recording a sequence is of, and so which intervals follow.
        return {name: benchmark.recording_key(name) for name in names}, benchmark.ids_tell_recordings(names)
    known = benchmark.recordings_of(table)
    recording_of = {name: known.get(name, benchmark.recording_key(name)) for name in names}
    return recording_of, all(name in known for name in names)


def _require_summary_of(
    run: RunFolder, record: TableRecord, scores: CodedScores, recording_of: Mapping[str, str], *, grouped: bool
) -> DatasetSummary:
    """The summary that follows from the scores; the stored one where nothing says which sequences belong together."""
    files = run.dataset(record.dataset)
    made = summary_of(run.record, record, scores, recording_of)
    require_summary(files, made, grouped=grouped)
    return made if grouped else DatasetSummary.read(files.path)


def _require_agreement_of(run: RunFolder, scores: CodedScores, table: CaseTable | None) -> None:
    """Compare the agreement with recorded people with what follows from the scores, where the table is at hand.

    Raises:
        RunError: if it says something else, or the scores are of sequences that the run was not made on.
    """
    if not isinstance(table, SequenceTable):  # other benchmarks have no such file
        return
    protocol = run.protocol
    if protocol is None:
        return
    files = run.dataset(table.info.dataset)
    selection = scored_sequences(run, table)
    scored = frozenset(scores.sequence_ids)
    unknown = sorted(scored - frozenset(selection.sequence_ids))
    if unknown:
        raise RunError(f"{files.scores}: expected sequences that the run was made on, found {quoted(unknown[0])}.")
    selection = selection.chosen(np.array([name in scored for name in selection.sequence_ids]))
    require_agreement(files, agreement_with_people(selection, scores, protocol=protocol))
