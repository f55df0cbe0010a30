"""Runs and windows of one recording as a part of a build that can be resumed.

Parts are described in :mod:`prbench.sequences.parts`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from prbench.sequences import parts
from prbench.sequences.sequence import row_batch
from prbench_benchmarks.motion_prediction.joint_sets import JointSet
from prbench_benchmarks.motion_prediction.table import WINDOWS, CutRun, Window, run_of, streams_schema


def write_cut_runs(folder: Path, runs: Sequence[CutRun], joints: JointSet, receipt: Mapping[str, object]) -> None:
    """Write the runs of one recording, whole or not at all.

    Args:
        folder: The part.
        runs: In table order.
        joints: Their joint set.
        receipt: What tells of the part without opening it.
    """
    windows = [window.row(each.run, row) for row, each in enumerate(runs) for window in each.windows]
    batches = {
        "streams": row_batch([each.run for each in runs], streams_schema(joints)),
        "windows": pa.RecordBatch.from_pylist(windows, schema=WINDOWS),
    }
    parts.write_part(folder, batches, receipt)


def read_cut_runs(folder: Path) -> Iterator[CutRun]:
    """Read the runs of one part in their order."""
    windows: dict[int, list[Window]] = {}
    for batch in parts.read_batches([folder], "windows"):
        for row in batch.to_pylist():
            windows.setdefault(row["row"], []).append(Window.of(row))
    number = 0
    for batch in parts.read_batches([folder], "streams"):
        for row in range(batch.num_rows):
            yield CutRun(run_of(batch.slice(row, 1)), tuple(windows.get(number, ())))
            number += 1
