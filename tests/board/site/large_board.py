"""A large board from few real runs, to time a site: ``python -m tests.board.site.large_board RUNS OUT``.

Every run of OUT has the scores of one of RUNS, repeated under new names of recordings until there are enough sequences,
and moved by a share of their spread that is the run's own. The motions are left out, so that nothing can be verified.
"""

from __future__ import annotations

import sys
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa

from prbench.harness.results import summary_of
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import PACKAGE, RunCost, TableRecord
from prbench.harness.run_folder.scores import read_scores, write_scores
from prbench.metrics import METRICS
from prbench.sequences.sequence import recording_key

RATES = {info.id for info in METRICS if info.unit == "rate"}


def write_large_board(sources: list[Path], out: Path, *, runs: int = 50, sequences: int = 7000) -> None:
    opened = [RunFolder.open(path) for path in sources]
    for number in range(runs):
        source = opened[number % len(opened)]
        rng = np.random.default_rng(number)
        tables = [_larger(table, sequences // len(source.record.tables)) for table in source.record.tables]
        method = msgspec.structs.replace(
            source.record.method, name=f"{source.record.method.name}-like-{number}", kind=PACKAGE, package="elsewhere",
        )  # fmt: skip
        record = msgspec.structs.replace(source.record, method=method, tables=tuple(tables), limit=None)
        folder = out / f"run-{number:02d}"
        record.write(folder)
        for table in tables:
            own = source.dataset(table.dataset)
            scores = _repeated(read_scores(own.scores), table.sequences, 0.3 * rng.random(), rng)
            recordings = {name: recording_key(name) for name in scores["sequence_id"].unique().to_pylist()}
            summary_of(record, table, scores, recordings).write(folder / table.dataset)
            write_scores(folder / table.dataset / "scores.parquet", [scores])
            RunCost.read(own.cost).write(folder / table.dataset / "cost.json")


def _larger(table: TableRecord, sequences: int) -> TableRecord:
    return msgspec.structs.replace(table, sequences=sequences, unsupported=0)


def _repeated(scores: pa.Table, sequences: int, share: float, rng: np.random.Generator) -> pa.Table:
    """Rows of as many sequences; a share of the rates is drawn anew, and lengths are multiplied."""
    ids = scores["sequence_id"].unique().to_pylist()
    parts = []
    while sequences > 0:
        names = ids[:sequences]
        sequences -= len(names)
        part = scores.filter(pa.compute.is_in(scores["sequence_id"], pa.array(names)))
        renamed = [name.replace("/", f"/{len(parts):03d}-", 1) for name in part["sequence_id"].to_pylist()]
        values = part["value"].to_numpy().copy()
        is_rate = np.isin(part["metric"].to_numpy(zero_copy_only=False), list(RATES))
        drawn = is_rate & (rng.random(len(values)) < share)
        values[drawn] = rng.random(drawn.sum()) < 0.5
        values[~is_rate] *= 1 + share * rng.random((~is_rate).sum())
        part = part.set_column(0, "sequence_id", pa.array(renamed))
        parts.append(part.set_column(part.schema.get_field_index("value"), "value", pa.array(values)))
    return pa.concat_tables(parts).cast(scores.schema)


if __name__ == "__main__":
    *given, made = map(Path, sys.argv[1:])
    write_large_board(sorted(path for folder in given for path in folder.iterdir() if path.is_dir()), made)
