"""The rows of a table that a method may learn from, and a copy of them for methods that never get the table itself."""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import psutil
import pyarrow as pa
import pyarrow.compute as pc

from prbench.errors import AdapterError
from prbench.sequences import SequenceChunk, SequenceTable
from prbench.sequences.schema import DATASET_TABLES, SEQUENCES
from prbench.sequences.write import write_table

# Seed of a method that a run fits by itself; the run's own seed varies what is generated, not what is learnt
FIT_SEED = 0
_SPLIT = "train"
_PREFIX = "prbench-train-"


class TrainingSplit(SequenceTable):
    """A table that shows its ``train`` rows only, so that a method that forgets to ask for them learns no test row."""

    def chunks(self, *, split: str | None = None, **chosen: Any) -> Iterator[SequenceChunk]:
        """Stream the training rows.

        Raises:
            AdapterError: if another split is asked for.
        """
        return super().chunks(split=_of_training(split), **chosen)

    def scalars(self, *, split: str | None = None, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the short values of the training rows.

        Raises:
            AdapterError: if another split is asked for.
        """
        return super().scalars(split=_of_training(split), columns=columns)

    def events(self) -> pa.Table:
        """Return the events of the training recordings; the others would tell where the goals of test rows are."""
        events = super().events()
        known = self.recordings()["recording_id"].combine_chunks()
        return events.filter(pc.call_function("is_in", [events["recording_id"]], pc.SetLookupOptions(known)))

    def recordings(self) -> pa.Table:
        """Return the training recordings."""
        return super().recordings().filter(pc.field("split") == _SPLIT)


def temporary_copy(write: Callable[[Path], object]) -> tempfile.TemporaryDirectory[str]:
    """Make a training copy in a folder that vanishes with this process, or at the latest when the next one is made.

    Args:
        write: Writes the copy into an empty folder.

    Raises:
        StorageError: if it cannot be written.
    """
    # Remove the copies of processes that were killed.
    for left in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*-*"):
        owner = left.name.removeprefix(_PREFIX).partition("-")[0]
        if owner.isdecimal() and not psutil.pid_exists(int(owner)):
            shutil.rmtree(left, ignore_errors=True)
    folder = tempfile.TemporaryDirectory(prefix=f"{_PREFIX}{os.getpid()}-", ignore_cleanup_errors=True)
    try:
        write(Path(folder.name))
    except BaseException:
        folder.cleanup()
        raise
    return folder


def write_training_copy(table: SequenceTable, folder: Path) -> None:
    """Write the training rows of a table, and its events and recordings of that split.

    One part a chunk: whoever streams the copy adds up the same rows in the same order and portions as from the table,
    so that a fit ends with the same bytes.

    Args:
        table: The whole table.
        folder: Empty; made if it does not exist.

    Raises:
        StorageError: if the folder cannot be written.
    """
    version = table.info.protocol_version
    table.info.write(folder)
    shown = TrainingSplit(table.folder, table.info)
    portions = ([chunk.batch] for chunk in shown.chunks())
    for index, rows in enumerate(itertools.chain([[]], portions)):  # the first part is empty, so that there is one
        write_table(folder / "sequences" / f"part-{index:05d}.parquet", rows, SEQUENCES, protocol_version=version)
    for name, rows in (("recordings", shown.recordings()), ("events", shown.events())):
        batches = rows.combine_chunks().to_batches()
        write_table(folder / f"{name}.parquet", batches, DATASET_TABLES[name], protocol_version=version)


def _of_training(split: str | None) -> str:
    if split not in (None, _SPLIT):
        raise AdapterError(f"a method may learn from split '{_SPLIT}' only; it asked for '{split}'.")
    return _SPLIT
