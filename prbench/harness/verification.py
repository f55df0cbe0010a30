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
from prbench.harness.benchmark import CaseTable, load_benchmark
from prbench.harness.results import cases_of_run, require_scores, require_summary, summary_of, work_of_run
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import TableRecord
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.shown import quoted

_OTHER_PROTOCOL = (
    "it was scored under another protocol than this version's, so metrics and limits that are newer are missing;"
    " `prbench score RUN --data DIR` scores its motions by this version's"
)


@dataclass(frozen=True)
class CheckedSummary:
    """The summary of one dataset of a run, as it follows from the scores.

    Attributes:
        unverified: Reason why the scores could not be held against the motions; empty where they were.
        scored: What a summary of some of the sequences is made from; None where a test gives a summary alone.
    """

    summary: DatasetSummary
    unverified: str
    scored: ScoredSequences | None = None


@dataclass(frozen=True)
class ScoredSequences:
    """The sequences behind a summary, to make one of some of them.

    Attributes:
        recording_of: Maps each sequence that was scored to its recording.
    """

    run: RunFolder
    record: TableRecord
    recording_of: Mapping[str, str]

    @property
    def ids(self) -> frozenset[str]:
        """Ids of the sequences that were scored."""
        return frozenset(self.recording_of)

    def summary_over(self, ids: frozenset[str]) -> DatasetSummary:
        """Summarise the scores of some sequences alone; none of them counts as unsupported.

        Args:
            ids: Sequences that were scored.
        """
        kept = CodedScores.read(self.run.dataset(self.record.dataset).scores).only(ids)
        record = msgspec.structs.replace(self.record, sequences=len(ids), unsupported=0)
        return summary_of(self.run.record, record, kept, {name: self.recording_of[name] for name in ids})


@dataclass(frozen=True)
class RunChecker:
    """Checks runs against the tables that are at hand.

    Attributes:
        find_table: Gives the very table that a run was made on, if it is at hand.
    """

    find_table: Callable[[TableRecord], CaseTable | None] = lambda _: None
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
        benchmark = load_benchmark(run.record.benchmark)
        # Without the table, ids tell which recording a sequence is of, and so which intervals follow.
        names = sorted(scores.sequence_ids)
        known = {} if table is None else benchmark.recordings_of(table)
        grouped = benchmark.ids_tell_recordings(names) if table is None else all(name in known for name in names)
        recording_of = {name: known.get(name) or benchmark.recording_key(name) for name in names}
        made = summary_of(run.record, record, scores, recording_of)
        require_summary(files, made, grouped=grouped)
        if not grouped:
            made = DatasetSummary.read(files.path)
        scored = ScoredSequences(run, record, recording_of)
        has_motions = any(files.predictions.glob("part-*.parquet"))
        unverified = ""
        if not has_motions:
            unverified = "its folder holds no motions"
        elif benchmark.rules_of(run) is None:
            unverified = _OTHER_PROTOCOL
        elif table is None:
            unverified = f"its table of {record.dataset} is not at hand: name it with --data DIR"
        if table is not None and benchmark.rules_of(run) is not None:
            request, _, cases = cases_of_run(run, table)
            unknown = sorted(set(names) - set(cases.sequence_ids))
            if unknown:
                raise RunError(
                    f"{files.scores}: expected sequences that the run was made on, found {quoted(unknown[0])}."
                )
            if has_motions:
                work = work_of_run(run, request, cases, table)
                require_scores(files, scores, CodedScores.of(work.scores(files, self.engine)))
            cases = cases.chosen(np.isin(cases.sequence_ids, names))
            work_of_run(run, request, cases, table).require_beside(files, scores)
        return CheckedSummary(made, unverified, scored)
