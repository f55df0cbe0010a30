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

import msgspec
import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq

from prbench.harness.run_folder.scores import predictions_schema
from prbench.sequences import SequenceTable
from prbench.sequences.schema import open_parquet
from prbench.sequences.write import write_dataset, write_table


def peak_megabytes() -> float:
    """Peak of the resident memory, 10^6 bytes; pages of mapped files count too."""
    if sys.platform == "win32":
        return psutil.Process().memory_info().peak_wset / 1e6
    if sys.platform == "linux":
        # Not getrusage's, which counts what the parent held when it started this process.
        status = Path("/proc/self/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # bytes on macOS


def repeat_table(source: str, out: str, sequences: str) -> None:
    """Write a table of the test split that holds the sequences of another one again and again under new ids.

    Args:
        source: Folder of a built table.
        out: Folder of the new table.
        sequences: Number of sequences of the new table.
    """
    table = SequenceTable.open(source)
    wanted = int(sequences)
    schema = table.schemas["sequences"]
    rows = _read(table, "sequences").select(schema.names)
    copies = -(-wanted // rows.num_rows)
    write_dataset(
        Path(out),
        msgspec.structs.replace(table.info, file_digests={}),
        sequences=_first(_copies(rows, copies), wanted),
        events=_copies(_read(table, "events"), copies),
        recordings=_copies(_read(table, "recordings"), copies),
    )


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
            joints = _straight(chunk.frames("joints"), chunk.offsets)
            poses = pa.FixedSizeListArray.from_arrays(pa.array(joints.reshape(-1)), type=kind.value_type)
            motions = pa.ListArray.from_arrays(pa.array(chunk.offsets.astype(np.int32)), poses, type=kind)
            zeros = np.zeros(len(chunk), dtype=np.int64)
            columns = [chunk.batch.column("sequence_id"), pa.array(zeros.astype(np.int32)), pa.array(zeros), motions]
            yield pa.RecordBatch.from_arrays(columns, schema=schema)

    write_table(Path(out), batches(), schema, protocol_version=opened.info.protocol_version)


def _straight(poses: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return poses (total, 66) on the straight way from the first to the last one of each motion."""
    n_frames = np.diff(offsets)
    row = np.repeat(np.arange(len(n_frames)), n_frames)
    share = (np.arange(len(poses)) - offsets[row]) / (n_frames[row] - 1)
    first = poses[offsets[:-1]][row]
    last = poses[offsets[1:] - 1][row]
    return (first + share[:, None] * (last - first)).astype(np.float32)


def iterate(folder: str) -> None:
    """Take every sequence of a table by the public API, and every array of it as NumPy's."""
    import prbench

    frames = 0
    for sequence in prbench.open_table(folder):
        arrays = [
            sequence.joints, sequence.previous_joints, sequence.next_joints, sequence.gaze.origin,
            sequence.gaze.direction, sequence.gaze.valid, sequence.goal.location, sequence.goal.box_world_min,
            sequence.goal.box_world_max, sequence.world_from_canonical,
        ]  # fmt: skip
        if sequence.head is not None:
            arrays += [sequence.head.position, sequence.head.rotation]
        frames += len(arrays[0])
    print(frames)


def read_with_pyarrow(folder: str) -> None:
    """Read the same arrays with pyarrow alone, and no other column, where :func:`iterate` reads all columns."""
    frames = 0
    for path in SequenceTable.open(folder).part_paths("sequences"):
        for batch in pq.ParquetFile(path, pre_buffer=False).iter_batches(batch_size=256, columns=list(_ARRAYS)):
            arrays = [_numpy_rows(batch.column(name), width) for name, width in _ARRAYS.items()]
            frames += sum(len(row) for row in arrays[0])
    print(frames)


_ARRAYS = {
    "joints": 66, "gaze_origin": 3, "gaze_direction": 3, "gaze_valid": 1, "head_position": 3, "head_rotation": 4,
    "previous_joints": 66, "next_joints": 66, "goal_location": 3, "goal_box_world_min": 3, "goal_box_world_max": 3,
    "world_from_canonical": 16,
}  # fmt: skip
"""Columns of arrays, and numbers of one row of each."""


def _numpy_rows(column: pa.Array, width: int) -> list[np.ndarray]:
    """Return the array of each row as a view."""
    if pa.types.is_fixed_size_list(column.type):
        return list(column.flatten().to_numpy(zero_copy_only=False).reshape(-1, width))
    ends = np.cumsum(column.value_lengths().fill_null(0).to_numpy(zero_copy_only=False))
    values = column.flatten()
    values = values.flatten() if pa.types.is_fixed_size_list(values.type) else values
    return np.split(values.to_numpy(zero_copy_only=False).reshape(-1, width), ends[:-1])


def find_one(folder: str) -> None:
    """Look one sequence up by its id a hundred times."""
    import prbench

    table = prbench.open_table(folder)
    wanted = table[len(table) // 2].sequence_id
    for _ in range(100):
        assert table[wanted].sequence_id == wanted


def rewrite(folder: str, out: str) -> None:
    """Write a table anew from its own rows, as a build puts its recordings together."""
    table = SequenceTable.open(folder)
    write_dataset(
        Path(out),
        table.info,
        sequences=(chunk.batch for chunk in table.chunks()),
        events=table.events().to_batches(),
        recordings=table.recordings().to_batches(),
    )


def store(folder: str, cache: str) -> None:
    """Make the feature store of a table and read every item once."""
    from prbench_adapters.training import SequenceDataset

    data = SequenceDataset(folder, split="test", max_frames=60, cache=Path(cache))
    frames = 0
    for index in range(len(data)):
        frames += len(data[index].features)
    print(frames)


def _read(table: SequenceTable, name: str) -> pa.Table:
    return pa.concat_tables(open_parquet(path).read() for path in table.part_paths(name)).combine_chunks()


def _copies(rows: pa.Table, copies: int) -> Iterator[pa.RecordBatch]:
    """Yield the rows again and again; those of a copy get its number before the name of their recording."""
    plain = {
        name: rows[name].to_pylist()
        for name in ("sequence_id", "event_id", "recording_id", "split")
        if name in rows.column_names
    }
    for copy in range(copies):
        changed = rows
        for name, values in plain.items():
            new = ["test"] * len(values) if name == "split" else [_renamed(value, name, copy) for value in values]
            place = changed.column_names.index(name)
            changed = changed.set_column(place, changed.schema.field(name), pa.array(new, pa.string()))
        yield from changed.to_batches(max_chunksize=256)


def _renamed(value: str | None, name: str, copy: int) -> str | None:
    if value is None:
        return None
    if name == "recording_id":
        return f"{copy:06d}-{value}"
    dataset, rest = value.split("/", 1)
    return f"{dataset}/{copy:06d}-{rest}"


def _first(batches: Iterator[pa.RecordBatch], rows: int) -> Iterator[pa.RecordBatch]:
    for batch in batches:
        if rows <= 0:
            return
        yield batch.slice(0, rows)
        rows -= batch.num_rows


WORKS = {
    work.__name__: work for work in (repeat_table, repeat_motions, iterate, read_with_pyarrow, find_one, rewrite, store)
}
"""What a child can do besides the commands of prbench, by name."""


def main() -> int:
    """Run the work and write processor time, duration and peak of memory."""
    report, name, *words = sys.argv[1:]
    start = time.perf_counter()
    code = _run(name, words)
    taken = {
        "megabytes": peak_megabytes(),
        "processor_s": time.process_time(),
        "seconds": time.perf_counter() - start,
        "code": code,
    }
    Path(report).write_text(json.dumps(taken))
    return code


def _run(name: str, words: list[str]) -> int:
    work = WORKS.get(name)
    if work is not None:
        work(*words)
        return 0
    from prbench.cli.main import main as prbench

    return int(prbench([name, *words]) or 0)


if __name__ == "__main__":
    sys.exit(main())
