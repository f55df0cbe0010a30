"""Write a whole built dataset at once: three tables, ``dataset.json`` with its digests, and ``croissant.json``."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

import msgspec
import pyarrow as pa

from prbench.sequences.croissant import write_croissant
from prbench.sequences.dataset_info import FILE_NAME, DatasetInfo
from prbench.sequences.digests import ContentDigest, identity_digest
from prbench.sequences.replacing import Holdings, require_no_loss
from prbench.sequences.schema import EVENTS, RECORDINGS, SEQUENCES
from prbench.sequences.unchanged import digests_of_files
from prbench.sequences.write import write_table, write_table_in_parts
from prbench.storage import atomic_folder, require_replaceable

_ROWS = {
    "sequences": "One prime-and-reach sequence: from 2 s before the first look at the goal to the pick or put.",
    "events": "One candidate pick or put, with what became of it and the number that decided.",
    "recordings": "One recording that was found, with counts of its events by outcome.",
}


def write_dataset(
    folder: Path,
    info: DatasetInfo,
    *,
    sequences: Iterable[pa.RecordBatch],
    events: Iterable[pa.RecordBatch],
    recordings: Iterable[pa.RecordBatch],
    replace: bool = False,
    incomplete: Collection[str] = (),
) -> DatasetInfo:
    """Write the folder whole or not at all; a dataset that was there is replaced, anything else is not touched.

    Args:
        folder: The dataset folder.
        info: Provenance; its digests are filled in here.
        sequences: Rows in table order (sorted by ``sequence_id``).
        events: Rows of ``events``.
        recordings: Rows of ``recordings``.
        replace: Replace a dataset that holds recordings which this one lacks.
        incomplete: Ids of recordings of which a part could not be read, or a file ends early.

    Returns:
        The provenance as written.

    Raises:
        StorageError: if the folder holds something that is no dataset, or cannot be written.
        RecordingsWouldBeLost: if the dataset that was there holds more, and ``replace`` is not set.
    """
    require_replaceable(folder, FILE_NAME, kind="dataset")
    recordings = list(recordings)
    if not replace:
        new = Holdings.of(recordings, "sequence")
        require_no_loss(folder, FILE_NAME, new, outcome="sequence", what="sequences", incomplete=incomplete)
    version = info.protocol_version
    with atomic_folder(folder) as temporary:
        seen = _Digesting(info.protocol_version)
        write_table_in_parts(temporary, "sequences", seen.pass_on(sequences), SEQUENCES, protocol_version=version)
        write_table(temporary / "events.parquet", events, EVENTS, protocol_version=version)
        write_table(temporary / "recordings.parquet", recordings, RECORDINGS, protocol_version=version)
        tables = {"sequences": SEQUENCES, "events": EVENTS, "recordings": RECORDINGS}
        info = msgspec.structs.replace(
            info,
            identity_digest=seen.identity(),
            content_digest=seen.content.hexdigest(),
            file_digests=digests_of_files(temporary, tables),
        )
        info.write(temporary)
        write_croissant(temporary, info, tables, _ROWS)
    return info


class _Digesting:
    """Passes batches on and remembers what the two digests need."""

    def __init__(self, protocol_version: int) -> None:
        self.content = ContentDigest()
        self._protocol_version = protocol_version
        self._columns: dict[str, list] = {"sequence_id": [], "split": [], "action": [], "n_frames": []}

    def pass_on(self, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        for batch in batches:
            self.content.update(batch)
            for name, values in self._columns.items():
                values.extend(batch.column(name).to_pylist())
            yield batch

    def identity(self) -> str:
        return identity_digest(
            self._columns["sequence_id"],
            self._columns["split"],
            self._columns["action"],
            self._columns["n_frames"],
            protocol_version=self._protocol_version,
        )
