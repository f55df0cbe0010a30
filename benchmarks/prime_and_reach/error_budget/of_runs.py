"""The budgets of runs: their motions diagnosed, counted and, if wanted, written one a row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from prbench.errors import RunError, TableError
from prbench.files.storage import atomic_path, remove_leftovers, sole_writer
from prbench.harness.run_folder import RunFolder
from prbench.harness.run_folder.record import TableRecord
from prbench.protocol.manifests import load_protocol
from prbench.sequences import SequenceTable
from prbench_benchmarks.prime_and_reach.error_budget.budget import RATES, Motions, gains, groups, paired_outcomes, parts
from prbench_benchmarks.prime_and_reach.error_budget.motions import BESIDE, METHOD, PEOPLE, diagnosed_motions
from prbench_benchmarks.prime_and_reach.error_budget.report import Beside, ErrorBudgetReport, RunBudget

FindTable = Callable[[TableRecord], SequenceTable | None]
Progress = Callable[[int, int, str], None]


def error_budget(
    runs: Sequence[Path], *, beside: Path | None, find_table: FindTable, out: Path | None, progress: Progress
) -> ErrorBudgetReport:
    """Say why the motions of runs fail.

    Args:
        runs: Run folders with their motions.
        beside: A run of the same sequences by other options, such as one without optimisation.
        find_table: Gives the very table that a run was made on.
        out: Folder for one row a motion; None writes nothing.
        progress: Called after each run.

    Raises:
        RunError: if a folder is no run or keeps no motions, or the run beside has no sequence in common with a run.
        TableError: if the table of a run is not at hand.
        StorageError: if the folder cannot be written.
    """
    other = None if beside is None else RunFolder.open(beside)
    budgets = []
    rows: list[pa.Table] = []
    for done, path in enumerate(runs):
        run = RunFolder.open(path)
        table = diagnosed_motions(run, _tables_of(run, find_table))
        if other is not None:
            table = pa.concat_tables([table, _beside(other, run, find_table)])
        budgets.append(_budget(run, path, other, table))
        rows.append(table.add_column(0, "run", pa.array([path.name] * len(table))))
        progress(done + 1, len(runs), path.name)
    if out is not None:
        _write(out, pa.concat_tables(rows))
    return ErrorBudgetReport(runs=budgets, out=out)


def _tables_of(run: RunFolder, find_table: FindTable) -> list[SequenceTable]:
    found = []
    for record in run.record.tables:
        table = find_table(record)
        if table is None:
            raise TableError(
                f"{run.path}: expected the table of {record.dataset} that it was made on, found none of that content."
                " Name it with --data DIR."
            )
        found.append(table)
    return found


def _beside(other: RunFolder, run: RunFolder, find_table: FindTable) -> pa.Table:
    """Diagnose the run beside on the tables that both runs were made on."""
    digests = {record.content_digest for record in run.record.tables}
    shared = [record for record in other.record.tables if record.content_digest in digests]
    tables = [table for table in map(find_table, shared) if table is not None]
    if not tables:
        raise RunError(
            f"{other.path}: expected a run on the same tables as {run.path}, found none in common. Run both methods on"
            " the same tables, or leave --beside out."
        )
    return diagnosed_motions(other, tables, who=BESIDE)


def _budget(run: RunFolder, path: Path, other: RunFolder | None, table: pa.Table) -> RunBudget:
    motions = Motions.of(table)
    protocol = run.protocol or load_protocol()
    return RunBudget(
        run=path,
        method=run.record.method.name,
        condition=run.record.condition,
        options=dict(run.record.method.options),
        split=run.record.split,
        samples=run.record.samples,
        synthetic=all(record.synthetic for record in run.record.tables),
        method_groups=groups(motions.of_who(METHOD), protocol),
        people_groups=groups(motions.of_who(PEOPLE), protocol),
        gains=gains(motions),
        parts=parts(motions, run.record.samples),
        beside=[] if other is None else _comparisons(other, run, motions),
    )


def _comparisons(other: RunFolder, run: RunFolder, motions: Motions) -> list[Beside]:
    found = []
    for metric, column in RATES.items():
        own, beside, sequences = paired_outcomes(motions, column)
        if not sequences:
            raise RunError(
                f"{other.path}: expected sequences of {run.path}, found none. Run both methods on the same split, and"
                " one with a --limit that includes the other's."
            )
        found.append(
            Beside(
                run=other.path,
                options=dict(other.record.method.options),
                metric=metric,
                sequences=sequences,
                rate=float(own.mean()),
                rate_beside=float(beside.mean()),
                gained=float((beside > own).mean()),
                lost=float((own > beside).mean()),
            )
        )
    return found


def _write(folder: Path, table: pa.Table) -> None:
    """Write one row a motion as Parquet and CSV."""
    writers = {"motions.parquet": pq.write_table, "motions.csv": pyarrow.csv.write_csv}
    with sole_writer(folder):
        for name, write in writers.items():
            remove_leftovers(folder / name)  # of a process that was killed while it wrote
            with atomic_path(folder / name) as path:
                write(table, path)
