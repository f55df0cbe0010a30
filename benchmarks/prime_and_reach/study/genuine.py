"""Finished runs whose scores were held against their motions, with their tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from prbench.engine import Engine
from prbench.errors import RunError, UsageError
from prbench.harness.first_run import tables_of_runs
from prbench.harness.results import RunChecker
from prbench.harness.run_folder import RunFolder, TableRecord
from prbench.protocol.manifests import BenchmarkProtocol, load_protocol
from prbench.sequences import SequenceTable
from prbench.shown import clean


@dataclass(frozen=True, eq=False)
class GenuineRun:
    """One run on one table, whose scores follow from its motions.

    Attributes:
        label: Method and condition, with the folder's name where several runs share them.
    """

    label: str
    run: RunFolder
    record: TableRecord
    table: SequenceTable

    @property
    def title(self) -> str:
        """Run and dataset in words, with the name of a user's own protocol."""
        own = f", own protocol {self.protocol.label}" if self.protocol.is_own else ""
        return f"{self.label}, {clean(self.record.dataset)}{own}"

    @property
    def protocol(self) -> BenchmarkProtocol:
        """Rules by which it was scored."""
        return self.run.protocol or load_protocol()


def genuine_runs(paths: Sequence[Path], data: Sequence[Path], engine: Engine) -> list[GenuineRun]:
    """Open runs and their tables, and score every motion again.

    Raises:
        UsageError: without runs, or if two of them have no dataset in common.
        TableError: if a table was not named and is not the embedded one.
        RunError: if a run is unfinished, its scores are not those of its motions, or runs follow different protocols.
    """
    if not paths:
        raise UsageError("name a run folder or more.")
    runs = [RunFolder.open(path) for path in paths]
    for run in runs[1:]:
        if run.record.protocol_digest != runs[0].record.protocol_digest:
            raise RunError(f"{run.path} and {runs[0].path} follow different protocols. Draw them one by one.")
    plain = [f"{clean(run.record.method.name)}, {clean(run.record.condition)}" for run in runs]
    found = []
    for table in tables_of_runs(runs, data):
        for run, label in zip(runs, plain, strict=True):
            record = next(each for each in run.record.tables if each.dataset == table.info.dataset)
            if not run.dataset(record.dataset).finished:
                raise RunError(f"{run.path}: is not finished on {record.dataset}. Run it again, it resumes.")
            unverified = RunChecker(lambda _, own=table: own, engine).check(run, record).unverified
            if unverified:
                raise RunError(f"{run.path}: cannot be drawn, because {unverified}.")
            own_label = label if plain.count(label) == 1 else f"{label} ({clean(run.path.name)})"
            found.append(GenuineRun(own_label, run, record, table))
    return found
