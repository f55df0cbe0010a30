"""One command of prbench in a process of its own, which says at its end what it took; a child of ``bench_growth``.

``python -m benchmarks.speed.measured_child REPORT WORDS…`` runs ``prbench WORDS…`` and writes a line of JSON to REPORT.
``WORDS`` may begin with the name of one of :data:`WORKS` instead.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from prbench.harness.run_folder.scores import predictions_schema
from prbench.sequences import SequenceTable
from prbench.sequences.schema import open_parquet
from prbench.sequences.write import write_dataset, write_table


def repeat_table(source: str, out: str, sequences: str) -> None:
    """Write a table of the test split that holds the sequences of another one again and again under new ids.

    Args:
        source: Folder of a built table.
        out: Folder of the new table.
        sequences: Number of sequences of the new table.
    """
    table = SequenceTable.open(source)
    left = int(sequences)
    parts = {
        name: pa.concat_tables(open_parquet(path).read() for path in table.part_paths(name)).combine_chunks()
        for name in ("sequences", "events", "recordings")
    }
    parts["sequences"] = parts["sequences"].select(table.schemas["sequences"].names)
    copies = -(-left // parts["sequences"].num_rows)

    def first() -> Iterator[pa.RecordBatch]:
        nonlocal left
        for batch in _copies(parts["sequences"], copies):
            yield batch.slice(0, left)
            left -= min(left, batch.num_rows)

    info = msgspec.structs.replace(table.info, file_digests={})
    others: dict[str, Any] = {name: _copies(parts[name], copies) for name in ("events", "recordings")}
    write_dataset(Path(out), info, sequences=first(), **others)


def _copies(rows: pa.Table, copies: int) -> Iterator[pa.RecordBatch]:
    """Yield the rows again and again; those of a copy get its number before the name of their recording."""
    names = [name for name in ("sequence_id", "event_id", "recording_id", "split") if name in rows.column_names]

    def renamed(value: str | None, name: str, copy: int) -> str | None:
        if name == "split":
            return "test"
        if value is None or name == "recording_id":
            return None if value is None else f"{copy:06d}-{value}"
        dataset, rest = value.split("/", 1)
        return f"{dataset}/{copy:06d}-{rest}"

    for copy in range(copies):
        changed = rows
        for name in names:
            new = pa.array([renamed(value, name, copy) for value in rows[name].to_pylist()], pa.string())
            changed = changed.set_column(changed.column_names.index(name), changed.schema.field(name), new)
        yield from changed.to_batches(max_chunksize=256)


def repeat_motions(table: str, out: str) -> None:
    """Write a file of finished motions for a table: every joint goes straight from its first to its last place.

    Args:
        table: Folder of a built table.
        out: The Parquet file.
    """
    opened = SequenceTable.open(table)
    schema = predictions_schema()
    kind = schema.field("joints").type

    def batches() -> Iterator[pa.RecordBatch]:
        for chunk in opened.chunks(columns=["joints"]):
            poses = chunk.frames("joints")
            row = np.repeat(np.arange(len(chunk)), np.diff(chunk.offsets))
            share = (np.arange(len(poses)) - chunk.offsets[row]) / (np.diff(chunk.offsets)[row] - 1)
            first = poses[chunk.offsets[:-1]][row]
            joints = first + share[:, None] * (poses[chunk.offsets[1:] - 1][row] - first)
            values = pa.array(joints.astype(np.float32).reshape(-1))
            flat = pa.FixedSizeListArray.from_arrays(values, type=kind.value_type)
            motions = pa.ListArray.from_arrays(pa.array(chunk.offsets.astype(np.int32)), flat, type=kind)
            zeros = np.zeros(len(chunk), dtype=np.int64)
            columns = [chunk.batch.column("sequence_id"), pa.array(zeros.astype(np.int32)), pa.array(zeros), motions]
            yield pa.RecordBatch.from_arrays(columns, schema=schema)

    write_table(Path(out), batches(), schema, protocol_version=opened.info.protocol_version)


def iterate(folder: str) -> None:
    """Take every sequence of a table by the public API, and its larger arrays as NumPy's."""
    import prbench

    frames = 0
    for sequence in prbench.open_table(folder):
        arrays = [sequence.joints, sequence.gaze.origin, sequence.gaze.direction, sequence.world_from_canonical]
        frames += len(arrays[0])
    print(frames)


def store(folder: str, cache: str) -> None:
    """Make the feature store of a table and read every item once."""
    from prbench_adapters.training import SequenceDataset

    data = SequenceDataset(folder, split="test", max_frames=60, cache=Path(cache))
    print(sum(len(data[index].features) for index in range(len(data))))


# What a child can do besides the commands of prbench, by name.
WORKS = {work.__name__: work for work in (repeat_table, repeat_motions, iterate, store)}


def main() -> int:
    """Run the work and write processor time and peak of memory."""
    from prbench.cli.main import main as prbench

    report, name, *words = sys.argv[1:]
    code = 0
    if name in WORKS:
        WORKS[name](*words)
    else:
        code = int(prbench([name, *words]) or 0)
    # Linux only. Not getrusage's, which counts what the parent held when it started this process.
    megabytes = int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
    Path(report).write_text(json.dumps({"megabytes": megabytes, "processor_s": time.process_time()}))
    return code


if __name__ == "__main__":
    sys.exit(main())
