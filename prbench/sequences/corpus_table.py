"""Write a corpus whole, open it, and stream its clips."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from prbench.boundary import foreign_input
from prbench.errors import TableError
from prbench.sequences.chunk import SequenceChunk
from prbench.sequences.corpus import CLIPS, CORPUS_TABLES, check_corpus_schema
from prbench.sequences.dataset_info import CORPUS_FILE, CorpusInfo
from prbench.sequences.digests import ContentDigest, digests_of_files, identity_digest, require_unchanged
from prbench.sequences.replacing import Holdings, require_no_loss
from prbench.sequences.rows import is_bulky, naming, open_parquet, read_parquet, stream_chunks, table_parts
from prbench.sequences.write import write_table, write_table_in_parts
from prbench.storage import atomic_folder, require_replaceable


@dataclass(frozen=True)
class CorpusTable:
    """A built corpus: its folder, its provenance, and its clips on demand."""

    folder: Path
    info: CorpusInfo

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
        for path in table_parts(folder, "clips"):
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

    def require_unchanged(self) -> None:
        """Hold the files against ``corpus.json``.

        Raises:
            TableError: if one was edited; names it.
        """
        require_unchanged(
            self.folder,
            self.folder / CORPUS_FILE,
            self.info.file_digests,
            main="clips",
            others=("annotations", "recordings"),
            require_same_values=lambda: self.content,
        )

    def chunks(
        self,
        *,
        split: str | None = None,
        columns: SequenceOf[str] | None = None,
        ids: frozenset[str] | None = None,
        rows: int = 256,
    ) -> Iterator[SequenceChunk]:
        """Stream clips in table order (arguments as for :meth:`prbench.sequences.SequenceTable.chunks`)."""
        wanted = list(CLIPS.names if columns is None else dict.fromkeys(["sequence_id", "n_frames", *columns]))
        return stream_chunks(table_parts(self.folder, "clips"), wanted, split=split, ids=ids, rows=rows)

    @foreign_input()
    def scalars(self, *, split: str | None = None) -> pa.Table:
        """Read all columns of the clips that hold one short value a row, and their captions."""
        names = [field.name for field in CLIPS if not is_bulky(field.type) or field.name == "captions"]
        table = pa.concat_tables(read_parquet(path, names) for path in table_parts(self.folder, "clips"))
        if split is not None:
            table = table.filter(pc.field("split") == split)
        return table.combine_chunks()

    def annotations(self) -> pa.Table:
        """The ``annotations`` table: every text of the source and what became of it."""
        return self._read("annotations")

    def recordings(self) -> pa.Table:
        """The ``recordings`` table."""
        return self._read("recordings")

    @cached_property
    def identity(self) -> str:
        """Identity digest, computed from the rows."""
        rows = self.scalars()
        columns = (rows[name].to_pylist() for name in _IDENTITY)
        return identity_digest(*columns, protocol_version=self.info.protocol_version)

    @cached_property
    def content(self) -> str:
        """Content digest, computed from the rows.

        Raises:
            TableError: if the rows are no longer those that the corpus was built with.
        """
        digest = ContentDigest(CLIPS.names)
        for chunk in self.chunks():
            digest.update(chunk.batch)
        if digest.hexdigest() != self.info.content_digest:
            raise TableError(
                f"{table_parts(self.folder, 'clips')[0]}: the clips are not the ones that {CORPUS_FILE} describes"
                f" (content digest {digest.hexdigest()[:12]}…, expected {self.info.content_digest[:12]}…)."
                " A file was changed after the build; build the corpus again."
            )
        return digest.hexdigest()

    @foreign_input()
    def _read(self, name: str) -> pa.Table:
        tables = []
        for path in table_parts(self.folder, name):
            file = open_parquet(path)
            check_corpus_schema(file.schema_arrow, CORPUS_TABLES[name], source=str(path))
            with naming(path):
                tables.append(file.read())
        return pa.concat_tables(tables)


_IDENTITY = ("sequence_id", "split", "kind", "n_frames")


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
    version = info.protocol_version
    content = ContentDigest(CLIPS.names)
    keys = {name: [] for name in _IDENTITY}

    def digested(batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        for batch in batches:
            content.update(batch)
            for name, values in keys.items():
                values.extend(batch.column(name).to_pylist())
            yield batch

    with atomic_folder(folder) as temporary:
        write_table_in_parts(temporary, "clips", digested(tables["clips"]), CLIPS, protocol_version=version)
        for name, rows in (("annotations", tables["annotations"]), ("recordings", recordings)):
            path = temporary / f"{name}.parquet"
            write_table(path, rows, CORPUS_TABLES[name], protocol_version=version)
        identity = identity_digest(*keys.values(), protocol_version=version)
        info = msgspec.structs.replace(
            info,
            identity_digest=identity,
            content_digest=content.hexdigest(),
            file_digests=digests_of_files(temporary, CORPUS_TABLES),
        )
        info.write(temporary)
    return info
