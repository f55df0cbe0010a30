"""Open a corpus and stream its clips; write one whole."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import pyarrow as pa

from prbench.errors import TableError
from prbench.files.bounded import foreign_input
from prbench.files.storage import atomic_folder, require_replaceable
from prbench.sequences.corpus import CLIPS, CORPUS_TABLES, check_corpus_schema
from prbench.sequences.dataset_info import CORPUS_FILE, CorpusInfo
from prbench.sequences.replacing import Holdings, require_no_loss
from prbench.sequences.rows import open_parquet
from prbench.sequences.table import BuiltTable
from prbench.sequences.write import write_tables


class CorpusTable(BuiltTable[CorpusInfo]):
    """A built corpus: its folder, its provenance, and its clips on demand."""

    main = "clips"
    schemas = CORPUS_TABLES
    identity_columns = ("sequence_id", "split", "kind", "n_frames")
    check = staticmethod(check_corpus_schema)

    @classmethod
    @foreign_input()
    def open(cls, folder: Path | str) -> CorpusTable:
        """Open a corpus folder and check version, columns, that it holds clips, and that no file was edited.

        Raises:
            TableError: naming the file, what was expected and what was found.
        """
        folder = Path(folder)
        table = cls(folder, CorpusInfo.read(folder))
        rows = 0
        for path in table.part_paths("clips"):
            file = open_parquet(path)
            check_corpus_schema(file.schema_arrow, CLIPS, source=str(path))
            rows += file.metadata.num_rows
        if rows == 0:
            raise TableError(
                f"{folder}: the corpus has no clips. `{folder / CORPUS_FILE}` holds the counts that say why;"
                " the table 'annotations' tells it of every text."
            )
        table.require_unchanged()
        return table

    def _is_short(self, field: pa.Field) -> bool:
        return super()._is_short(field) or field.name == "captions"

    def annotations(self) -> pa.Table:
        """The ``annotations`` table: every text of the source and what became of it."""
        return self._read("annotations")

    def recordings(self) -> pa.Table:
        """The ``recordings`` table."""
        return self._read("recordings")


def write_corpus(
    folder: Path, info: CorpusInfo, tables: Mapping[str, Iterable[pa.RecordBatch]], *, replace: bool = False
) -> CorpusInfo:
    """Write a corpus folder whole or not at all; a corpus that was there is replaced, anything else is not touched.

    Args:
        folder: The corpus folder.
        info: Provenance; its digests are filled in here.
        tables: Rows of ``clips`` (sorted by ``sequence_id`` within each recording), ``annotations``, ``recordings``.
        replace: Replace a corpus that holds recordings which this one lacks.

    Returns:
        The provenance as written.

    Raises:
        StorageError: if the folder holds something that is no corpus, or cannot be written.
        RecordingsWouldBeLost: if the corpus that was there holds more, and ``replace`` is not set.
    """
    require_replaceable(folder, CORPUS_FILE, kind="corpus")
    recordings = list(tables["recordings"])
    if not replace:
        require_no_loss(folder, CORPUS_FILE, Holdings.of(recordings, "clip"), outcome="clip", what="clips")
    with atomic_folder(folder) as temporary:
        info = write_tables(
            temporary, info, {**tables, "recordings": recordings}, CORPUS_TABLES, CorpusTable.identity_columns
        )
    return info
