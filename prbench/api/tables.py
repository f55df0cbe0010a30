"""Tables of prime-and-reach sequences: opened, iterated, looked up, drawn, turned into pandas frames.

Columns and units: docs/table.md; frames: docs/specification/sequence-table.md#encoding.
"""

from __future__ import annotations

import base64
import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from prbench import sequences
from prbench.api import arguments as args
from prbench.api import pictures
from prbench.api.pictures import Picture, Replay
from prbench.errors import UsageError
from prbench.geometry.skeleton import Joint, invert_rigid, transform_points
from prbench.sequences import DatasetInfo, Event, Recording, SequenceChunk, SequenceTable
from prbench.sequences.schema import is_bulky
from prbench.sequences.sequence import EVENTS, KEY_VALUES, SEQUENCES, recording_of, row_values
from prbench.sequences.table import SPLITS, by_share, why_no_sequences
from prbench.shown import html

if TYPE_CHECKING:
    import pandas as pd

    from prbench.viewing.explain import EventStory
    from prbench.viewing.replay.scene import Scene


@dataclass(frozen=True, eq=False, repr=False)
class Goal:
    """The place of the object at the event: for a pick where it lies, for a put where it will lie.

    Attributes:
        location: Centre of the object's box, canonical frame, metres (column ``goal_location``).
        box_world_min: Lower end of the box along x, y and z of the world, metres (column ``goal_box_world_min``).
        box_world_max: Upper end of the box along x, y and z of the world, metres (column ``goal_box_world_max``).
    """

    location: Float[np.ndarray, "3"]
    box_world_min: Float[np.ndarray, "3"]
    box_world_max: Float[np.ndarray, "3"]
    _world_from_canonical: Float[np.ndarray, "4 4"]

    @cached_property
    def box_corners(self) -> Float[np.ndarray, "8 3"]:
        """The eight corners of the box, canonical frame, metres; the last axis of the world changes fastest."""
        ends = zip(self.box_world_min, self.box_world_max, strict=True)
        corners = np.array(list(itertools.product(*ends)), dtype=np.float64)
        return pictures.frozen(transform_points(invert_rigid(self._world_from_canonical), corners))

    def __repr__(self) -> str:
        x, y, z = self.location
        return f"<Goal at ({x:.3f}, {y:.3f}, {z:.3f}) m>"


@dataclass(frozen=True, eq=False, repr=False)
class Gaze:
    """The direction of the eyes: one ray a frame.

    Attributes:
        origin: Start of each ray, between the eyes, canonical frame, metres (column ``gaze_origin``).
        direction: Direction of each ray, unit vectors, canonical frame (column ``gaze_direction``).
        valid: False where the eye tracker had no measurement; the ray then says nothing (column ``gaze_valid``).
    """

    origin: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    valid: Bool[np.ndarray, " n"]

    def __repr__(self) -> str:
        return f"<Gaze: {len(self.valid)} rays, {int(self.valid.sum())} of them valid>"


@dataclass(frozen=True, eq=False, repr=False)
class Head:
    """Pose of the glasses that the person wears: x points left, y up and z forward, between the eyes.

    Attributes:
        position: Position of the glasses in each frame, canonical frame, metres (column ``head_position``).
        rotation: Rotation from the glasses to the canonical frame, unit quaternions w x y z (column ``head_rotation``).
    """

    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]

    def __repr__(self) -> str:
        return f"<Head: {len(self.position)} positions and rotations>"


@dataclass(frozen=True, eq=False, repr=False)
class Sequence(sequences.Sequence):
    """One prime-and-reach sequence: from 2 s before the first look at the goal until the object is picked or put.

    Every column of the table (docs/table.md#sequences) is an attribute of that name; ``goal``, ``gaze`` and ``head``
    hold the columns that belong together. Positions are in the sequence's own canonical frame unless a name says
    ``world``: metres, Y up, the pelvis of the first frame over the origin facing +Z, the lowest joint of the sequence
    at Y = 0. All arrays are read-only.
    """

    _table: SequenceTable | None = None

    @cached_property
    def goal(self) -> Goal:
        """Position and box of the object at the event."""
        box = self.goal_box_world_min, self.goal_box_world_max
        return Goal(self.goal_location, *box, self.world_from_canonical)

    @cached_property
    def gaze(self) -> Gaze:
        """Origin, direction and validity of the gaze in every frame."""
        return Gaze(self.gaze_origin, self.gaze_direction, self.gaze_valid)

    @cached_property
    def head(self) -> Head | None:
        """Pose of the glasses in every frame; None where it is unknown."""
        if self.head_position is None or self.head_rotation is None:
            return None
        return Head(self.head_position, self.head_rotation)

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a frame.

        Returns:
            Columns ``frame``, ``time`` (seconds after the first frame), for each joint ``left_wrist_x``,
            ``left_wrist_y``, ``left_wrist_z`` and so on, ``gaze_origin_x`` …, ``gaze_direction_x`` …, ``gaze_valid``
            and, where the glasses are known, ``head_position_x`` … and ``head_rotation_w`` …. Canonical frame, metres.
        """
        import pandas as pd

        columns: dict[str, np.ndarray] = {"frame": np.arange(self.n_frames), "time": self.times}

        def add(name: str, values: np.ndarray, axes: str = "xyz") -> None:
            columns.update({f"{name}_{axis}": values[:, number] for number, axis in enumerate(axes)})

        for joint in Joint:
            add(joint.name.lower(), self.joints[:, joint])
        add("gaze_origin", self.gaze_origin)
        add("gaze_direction", self.gaze_direction)
        columns["gaze_valid"] = self.gaze_valid
        if self.head is not None:
            add("head_position", self.head.position)
            add("head_rotation", self.head.rotation, axes="wxyz")
        return pd.DataFrame(columns)

    def plot(self, *, permission: str | Iterable[str] = ()) -> Picture:
        """Draw the sequence: poses over time, the way from above, distances of gaze, head and wrists from the goal.

        Args:
            permission: Datasets whose licensor has given you permission to pass recorded motion on; needed only where
                the licence forbids it, because a notebook is easily passed on.

        Returns:
            The picture; a notebook shows it, :meth:`Picture.save` writes it.

        Raises:
            RedistributionError: if the dataset's licence keeps recorded motion and no permission is stated.
        """
        return pictures.picture_of((self._scene(permission),))

    def replay(self, *, permission: str | Iterable[str] = ()) -> Replay:
        """Show the sequence in 3-D, to turn and play.

        Args:
            permission: See :meth:`plot`.

        Returns:
            The replay; a notebook shows it, :meth:`Replay.save` writes it.

        Raises:
            RedistributionError: if the dataset's licence keeps recorded motion and no permission is stated.
        """
        return pictures.replay_of((self._scene(permission),))

    def _scene(self, permission: str | Iterable[str]) -> Scene:
        from prbench.sequences.dataset_info import require_may_pass_on
        from prbench.viewing.replay.read import scene_of

        assert self._table is not None, "sequences are made by tables"
        permitted = args.as_texts(permission)
        info = self._table.info
        require_may_pass_on(info, "the view", permitted)
        return scene_of(self._table.row(self.sequence_id), info, permitted=permitted)

    def _repr_html_(self) -> str:
        rows = [
            ("sequence_id", self.sequence_id),
            ("recording, split", f"{self.recording_id}, {self.split}"),
            ("text", self.text),
            ("hand", self.hand or "unknown"),
            ("frames", f"{self.n_frames} at {self.fps:g} Hz ({self.n_frames / self.fps:.2f} s)"),
            ("first look at the goal", f"{self.prime_after:.2f} s after the first frame ({self.prime_kind})"),
            ("gaze", f"valid in {int(self.gaze.valid.sum())} of {self.n_frames} frames"),
        ]
        frame = pictures.frame_from_rows(rows, ["", "value"])
        return pictures.notebook_table(f"{self.action} of {self.object_name} ({self.dataset})", frame)


def sequences_of(chunks: Iterable[SequenceChunk], table: SequenceTable) -> Iterator[Sequence]:
    """Yield rows as sequences with arrays of their own, so that none keeps the chunk that it was read with.

    Args:
        chunks: Rows with all columns.
        table: The table that they come from.
    """
    for chunk in chunks:
        columns = [row_values(chunk.batch.column(name)) for name in SEQUENCES.names]
        for row in zip(*columns, strict=True):
            values: list[Any] = [pictures.frozen(each.copy()) if isinstance(each, np.ndarray) else each for each in row]
            yield Sequence(*values, _table=table)


_Record = TypeVar("_Record")


class _Records(list[_Record]):
    """Rows of a table as records, in table order."""

    def __init__(self, rows: pa.Table, records: Iterable[_Record]) -> None:
        super().__init__(records)
        self._rows = rows

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a record, with the columns of docs/table.md.

        Vectors (``location``, ``box_min`` …) hold one array (3,) a cell, world frame, metres.
        """
        return pictures.frame_of(self._rows)


class Events(_Records[Event]):
    """A list of all candidate events of a table, accepted or not, in table order."""

    def __repr__(self) -> str:
        return f"<{len(self)} events: {self._counted()}>"

    def _repr_html_(self) -> str:
        shown = ["object_name", "action", "hand", "event_time", "prime_time", "outcome", "stage", "event_id"]
        return pictures.notebook_table(
            f"{len(self)} candidate events: {self._counted()}", pictures.frame_of(self._rows.select(shown))
        )

    def _counted(self) -> str:
        """Return how many events have each outcome, the most frequent first."""
        ordered = sorted(Counter(self._rows["outcome"].to_pylist()).items(), key=lambda pair: (-pair[1], pair[0]))
        return ", ".join(f"{count} {name}" for name, count in ordered) or "none"


class Recordings(_Records[Recording]):
    """A list of all recordings that a build found, in table order."""

    def __repr__(self) -> str:
        statuses = self._rows["status"].to_pylist()
        return f"<{len(self)} recordings, {statuses.count('read')} of them read>"

    def _repr_html_(self) -> str:
        return pictures.notebook_table(f"{len(self)} recordings", self.to_pandas())


@dataclass(frozen=True, eq=False, repr=False)
class Story:
    """The story of one event: how far it came through curation, and the numbers that decided."""

    _story: EventStory

    @property
    def text(self) -> str:
        """The story in lines: each stage of curation with its verdict and its numbers."""
        return self._story.text()

    @property
    def outcome(self) -> str:
        """``sequence`` if the event became one, else why not."""
        return self._story.event.outcome

    @property
    def stages(self) -> Mapping[str, str]:
        """Verdict of each stage of curation by its name: ``passed``, ``stopped here`` or ``not reached``."""
        return {stage.name: stage.verdict for stage in self._story.stages}

    @cached_property
    def picture(self) -> Picture:
        """The story as a picture; the motion is drawn if the event became a sequence."""
        return Picture(self._story.title, self._draw)

    def save(self, path: args.PathLike) -> Path:
        """Write the picture into a PNG file; one that exists is replaced.

        Args:
            path: The file; it ends in ``.png``.

        Returns:
            The file.

        Raises:
            UsageError: for another ending.
            StorageError: if the file cannot be written.
        """
        return self.picture.save(path)

    def _draw(self, path: Path) -> None:
        from prbench.viewing.explain import draw_event_story

        draw_event_story(self._story, path)

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"<Story of {self._story.title}: {self.outcome}>"

    def _repr_html_(self) -> str:
        png = base64.b64encode(self.picture.png).decode("ascii")
        picture = f'<img alt="{html(self._story.title)}" style="max-width:100%" src="data:image/png;base64,{png}">'
        lines = "\n".join(html(line) for line in self.text.splitlines())  # the line breaks stay
        return f"<pre>{lines}</pre>{picture}"


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
            limit: Number of sequences, of every recording its share: with ``split`` the same that ``limit`` means for
                :func:`prbench.run` and :func:`prbench.score`.

        Raises:
            UsageError: for an unknown split or a limit below 1.
        """
        _require_split(split)
        args.require_positive(limit=limit)
        if split is None and limit is None:
            return tuple(self._table.sequence_ids())
        rows = self._table.scalars(split=split, columns=["sequence_id", "recording_id"])
        ids = rows["sequence_id"].to_pylist()
        if limit is None:
            return tuple(ids)
        chosen = set(by_share(ids, rows["recording_id"].to_pylist())[:limit])
        return tuple(name for name in ids if name in chosen)

    def sequences(self, *, split: str | None = None, limit: int | None = None) -> Iterator[Sequence]:
        """Read sequences in table order; a group of 256 rows is held in memory at a time.

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
        rows = self._table.events()
        columns = [row_values(rows[name].combine_chunks()) for name in EVENTS.names]
        named = (dict(zip(EVENTS.names, values, strict=True)) for values in zip(*columns, strict=True))
        return Events(rows, (Event(**values) for values in named))

    @property
    def recordings(self) -> Recordings:
        """All recordings that the build found."""
        rows = self._table.recordings()
        return Recordings(rows, (recording_of(rows, place) for place in range(len(rows))))

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
        return Story(explain_event(self.folder, event, permitted=args.as_texts(permission)))

    def plot(self) -> Picture:
        """Draw what the sequences of the table have in common, as ``prbench study figure-s2`` does.

        Where goals lie as seen from the start (distance, elevation, azimuth), how far bodies move, how gaze comes to
        the goal around the prime time, and how long before the event that is.

        Returns:
            The picture; a notebook shows it, :meth:`Picture.save` writes it as PNG.

        Raises:
            TableError: if the table holds no sequence.
        """
        from prbench.sequences.table import table_statistics
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
        frame = pictures.frame_of(scalars.select([field.name for field in scalars.schema if field.type != KEY_VALUES]))
        large = [field.name for field in SEQUENCES if is_bulky(field.type) and field.type != KEY_VALUES]
        if arrays:
            rows = [[getattr(sequence, name) for name in large] for sequence in self]
            for place, name in enumerate(large):
                frame[name] = pd.Series([row[place] for row in rows], dtype=object, index=frame.index)
        return frame

    def __len__(self) -> int:
        return self._table.n_sequences

    def __iter__(self) -> Iterator[Sequence]:
        return self.sequences()

    def __contains__(self, sequence_id: object) -> bool:
        return sequence_id in self.sequence_ids()

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
        return self.sequence(self.sequence_ids()[key])

    def __repr__(self) -> str:
        return f"<Table {self.info.title}: {len(self)} sequences, {self.folder}>"

    def _repr_html_(self) -> str:
        counts = self.info.counts
        title = f"{self.info.title}:"
        title += f" {len(self)} sequences of {counts.recordings_read} recordings, from {counts.events} candidate events"
        remarks = [f"licence: {self.info.licence}", f"folder: {self.folder}"]
        if not len(self):
            remarks.insert(0, why_no_sequences(self.info))
        scalars = self._table.scalars(columns=_SHOWN_COLUMNS)
        if scalars.num_rows > _SHOWN_ROWS:
            remarks.insert(0, f"the first {_SHOWN_ROWS} of {scalars.num_rows} rows; .to_pandas() gives all")
        return pictures.notebook_table(title, pictures.frame_of(scalars.slice(0, _SHOWN_ROWS)), remarks)


def _require_split(split: str | None) -> None:
    if split is not None and split not in SPLITS:
        raise UsageError(f"unknown split '{split}'; the splits are: {', '.join(SPLITS)}.")


def open_table(path: args.PathLike) -> Table:
    """Open a built dataset; versions, columns and digests of its files are checked, and nothing else is read.

    Args:
        path: The dataset folder that ``prbench build-dataset --out`` or :func:`prbench.build_dataset` wrote.

    Returns:
        The table.

    Raises:
        TableError: if the folder holds no dataset, or one that is damaged, edited or of another version; names the
            file, what was expected and what was found.
    """
    return Table(SequenceTable.open(args.as_path(path)))


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

    args.require_positive(workers=workers)
    with pictures.progress("building synthetic data") as show:
        return tuple(map(Table, default_tables(engine_for(workers), show)))


Tables = args.PathLike | Table | Iterable[args.PathLike | Table]


def table_folders(data: Tables) -> tuple[Path, ...]:
    """Return the folders of one table or several.

    Args:
        data: A table, its folder, or several of either.
    """
    if isinstance(data, str | Path | Table) or hasattr(data, "__fspath__"):
        data = (data,)  # type: ignore[assignment] - one of them, as was just asked
    return tuple(each.folder if isinstance(each, Table) else args.as_path(each) for each in data)  # type: ignore[union-attr]
