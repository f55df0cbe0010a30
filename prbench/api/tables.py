"""Tables of prime-and-reach sequences: opened, iterated, looked up, turned into pandas frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, overload

from prbench.api.arguments import PathLike, as_path, as_texts, require_positive
from prbench.api.events import Events, Recordings, Story
from prbench.api.frames import frame_of, notebook_table
from prbench.api.pictures import Picture
from prbench.api.progress import progress
from prbench.api.sequences import Sequence, sequences_of
from prbench.errors import UsageError
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.columns import KEY_VALUES
from prbench.sequences.rows import is_bulky
from prbench.sequences.sequence import SEQUENCES
from prbench.sequences.table import SPLITS, by_share, why_no_sequences

if TYPE_CHECKING:
    import pandas as pd

_SHOWN_COLUMNS = ("action", "object_name", "hand", "n_frames", "prime_gap", "split", "sequence_id")
_SHOWN_ROWS = 10


class Table:
    """A built dataset: its sequences, candidate events and recordings.

    ``len(table)`` is the number of sequences, ``for sequence in table`` reads them one group of rows after the other,
    ``table[0]`` and ``table["a part of an id"]`` look one up, and ``table[:3]`` gives a list. A table may hold events
    alone, and no sequence.
    Make one with :func:`prbench.open_table`, :func:`prbench.embedded_tables` or :func:`prbench.build_dataset`.
    """

    def __init__(self, table: SequenceTable) -> None:
        self._table = table

    @property
    def folder(self) -> Path:
        """The dataset folder."""
        return self._table.folder

    @property
    def info(self) -> DatasetInfo:
        """The content of ``dataset.json``: title, licence, citation, versions, options, counts and digests."""
        return self._table.info

    @property
    def dataset(self) -> str:
        """Name of the dataset; it begins with ``synthetic-`` where the people are synthetic."""
        return self._table.info.dataset

    def sequence_ids(self, *, split: str | None = None, limit: int | None = None) -> tuple[str, ...]:
        """Return the ids of the sequences in table order.

        Args:
            split: ``train``, ``validation`` or ``test``; all by default.
            limit: At most so many, of every recording its share: with ``split`` the same that ``limit`` means for
                :func:`prbench.run` and :func:`prbench.score`.

        Raises:
            UsageError: for an unknown split or a limit below 1.
        """
        _require_split(split)
        require_positive(limit=limit)
        if split is None and limit is None:
            return tuple(self._table.sequence_ids())
        rows = self._table.scalars(split=split, columns=["sequence_id", "recording_id"])
        ids = rows["sequence_id"].to_pylist()
        if limit is None:
            return tuple(ids)
        chosen = set(by_share(ids, rows["recording_id"].to_pylist())[:limit])
        return tuple(name for name in ids if name in chosen)

    def sequences(self, *, split: str | None = None, limit: int | None = None) -> Iterator[Sequence]:
        """Read sequences in table order; only two groups of 256 rows are held in memory at a time.

        Arrays are views of such a group. A sequence that you keep soon gets arrays of its own; where you keep an array
        without its sequence, keep ``array.copy()``, or the same arrays of the whole group stay in memory.

        Args:
            split: See :meth:`sequence_ids`.
            limit: See :meth:`sequence_ids`.

        Returns:
            An iterator over the sequences.

        Raises:
            UsageError: for an unknown split or a limit below 1.
            TableError: if a file is damaged.
        """
        _require_split(split)
        chosen = None if limit is None else frozenset(self.sequence_ids(split=split, limit=limit))
        return sequences_of(self._table.chunks(split=split, ids=chosen), self._table)

    def sequence(self, wanted: str) -> Sequence:
        """Return one sequence.

        Args:
            wanted: Its id, or a beginning, end or part of it that fits one sequence only, as ``--sequence`` of the
                command line takes it.

        Raises:
            UsageError: if no sequence fits (names the nearest ids), or several do (names them).
            TableError: if the file is damaged.
        """
        return next(sequences_of([self._table.row(wanted)], self._table))

    @property
    def events(self) -> Events:
        """All candidate events, those that became sequences and those that did not."""
        return Events(self._table.events())

    @property
    def recordings(self) -> Recordings:
        """All recordings that the build found."""
        return Recordings(self._table.recordings())

    def explain(self, event: str, *, permission: str | Iterable[str] = ()) -> Story:
        """Tell what became of one event and why, as ``prbench explain`` does.

        Args:
            event: Its id, its sequence's id, or any part of the event's id or of
                ``recording/object name/action/time`` that fits one event only.
            permission: Datasets whose licensor has given you permission to pass recorded motion on; without it the
                story of one whose licence keeps it has no motion to draw.

        Raises:
            UsageError: if no event fits (names the nearest ids), or several do.
        """
        from prbench.viewing.explain import explain_event

        if not event:  # every event would fit
            raise UsageError("expected an event's id or a part of one, found an empty text.")
        return Story(explain_event(self.folder, event, permitted=as_texts(permission)))

    def plot(self) -> Picture:
        """Draw what the sequences of the table have in common, as ``prbench study figure-s2`` does.

        Where goals lie as seen from the start (distance, elevation, azimuth), how far bodies move, how gaze comes to
        the goal around the prime time, and how long before the event that is.

        Returns:
            The picture; a notebook shows it, :meth:`Picture.save` writes it as PNG.

        Raises:
            TableError: if the table holds no sequence.
        """
        from prbench.sequences.table_one import table_statistics
        from prbench.viewing.distributions import draw_table_one

        statistics = table_statistics(self._table.with_sequences())
        return Picture(f"{self.dataset}, {len(self)} sequences", lambda path: draw_table_one([statistics], path))

    def to_pandas(self, *, arrays: bool = False) -> pd.DataFrame:
        """Return one row a sequence, with the columns of docs/table.md#sequences.

        Args:
            arrays: Also read the large columns: ``joints`` holds an array (n, 22, 3) in each cell, ``gaze_origin``
                (n, 3) and so on. This holds the whole table in memory.

        Returns:
            A frame; it has its columns without a row, too. Vectors such as ``goal_location`` hold one array (3,) a
            cell; ``numpy.stack(frame.goal_location)`` makes one array of them.
        """
        import pandas as pd

        scalars = self._table.scalars()
        # Without the map of what only one dataset has: Sequence.extra holds it.
        frame = frame_of(scalars.select([field.name for field in scalars.schema if field.type != KEY_VALUES]))
        large = [field.name for field in SEQUENCES if is_bulky(field.type) and field.type != KEY_VALUES]
        if arrays:
            rows = [[getattr(sequence, name) for name in large] for sequence in self]
            for place, name in enumerate(large):
                frame[name] = pd.Series([row[place] for row in rows], dtype=object, index=frame.index)
        return frame

    def events_to_pandas(self) -> pd.DataFrame:
        """Return ``table.events.to_pandas()``: one row a candidate event."""
        return self.events.to_pandas()

    def recordings_to_pandas(self) -> pd.DataFrame:
        """Return ``table.recordings.to_pandas()``: one row a recording."""
        return self.recordings.to_pandas()

    def __len__(self) -> int:
        return self._table.n_sequences

    def __iter__(self) -> Iterator[Sequence]:
        return self.sequences()

    def __contains__(self, sequence_id: object) -> bool:
        if not isinstance(sequence_id, str):
            return False
        return any(self._table.chunks(columns=["sequence_id"], ids=frozenset({sequence_id})))

    @overload
    def __getitem__(self, key: int | str) -> Sequence: ...
    @overload
    def __getitem__(self, key: slice) -> list[Sequence]: ...
    def __getitem__(self, key: int | str | slice) -> Sequence | list[Sequence]:
        if isinstance(key, str):
            return self.sequence(key)
        count = len(self)
        if isinstance(key, slice):
            return [self[place] for place in range(count)[key]]
        if not -count <= key < count:
            raise IndexError(f"{self.folder}: expected a number below {count}, found {key}")
        return next(sequences_of([self._table.row_at(key % count)], self._table))

    def __repr__(self) -> str:
        return f"<Table {self.info.title}: {len(self)} sequences, {self.folder}>"

    def _repr_html_(self) -> str:
        counts = self.info.counts
        title = (
            f"{self.info.title}: {len(self)} sequences of {counts.recordings_read} recordings,"
            f" from {counts.events} candidate events"
        )
        remarks = [f"licence: {self.info.licence}", f"folder: {self.folder}"]
        if not len(self):
            remarks.insert(0, why_no_sequences(self.info))
        scalars = self._table.scalars(columns=_SHOWN_COLUMNS)
        if scalars.num_rows > _SHOWN_ROWS:
            remarks.insert(0, f"the first {_SHOWN_ROWS} of {scalars.num_rows} rows; .to_pandas() gives all")
        return notebook_table(title, frame_of(scalars.slice(0, _SHOWN_ROWS)), remarks)


def _require_split(split: str | None) -> None:
    if split is not None and split not in SPLITS:
        raise UsageError(f"unknown split '{split}'; the splits are: {', '.join(SPLITS)}.")


def open_table(path: PathLike) -> Table:
    """Open a built dataset; versions, columns and digests of its files are checked, and nothing else is read.

    Args:
        path: The dataset folder that ``prbench build-dataset --out`` or :func:`prbench.build_dataset` wrote.

    Returns:
        The table.

    Raises:
        TableError: if the folder holds no dataset, or one that is damaged, edited or of another version; names the
            file, what was expected and what was found.
    """
    return Table(SequenceTable.open(as_path(path)))


def embedded_tables(*, workers: int = 1) -> tuple[Table, ...]:
    """Return prbench's own small tables of synthetic people; they are built on the first call, in about a minute.

    They are what :func:`prbench.run` uses when it is given no table. Scores on them must never be compared with
    published ones.

    Args:
        workers: Processes that build them; changes no result. A script that asks for several needs
            ``if __name__ == "__main__":``.

    Returns:
        Five tables, each in the layout of another dataset; ``table.dataset`` names it.

    Raises:
        StorageError: if prbench's cache folder cannot be written.
    """
    from prbench.engine import engine_for
    from prbench.harness.first_run import default_tables

    require_positive(workers=workers)
    with progress("building synthetic data") as show:
        return tuple(map(Table, default_tables(engine_for(workers), show)))


def table_folders(data: PathLike | Table | Iterable[PathLike | Table]) -> tuple[Path, ...]:
    """Return the folders of one table or several.

    Args:
        data: A table, its folder, or several of either.
    """
    if isinstance(data, str | Path | Table) or hasattr(data, "__fspath__"):
        data = (data,)  # type: ignore[assignment] - one of them, as was just asked
    return tuple(each.folder if isinstance(each, Table) else as_path(each) for each in data)  # type: ignore[union-attr]
