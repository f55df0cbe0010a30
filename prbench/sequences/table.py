"""Open a built dataset, stream its tables, and compute the study's statistics: Table 1, Table S2, Figure S2.

The goal's distance, elevation and azimuth are those of its location as seen from the pelvis of the first frame, in the
canonical frame: azimuth 0 straight ahead and positive to the left, elevation 0 at the height of the pelvis. The page
names the three and defines none of them.
"""

from __future__ import annotations

import difflib
import hashlib
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float

from prbench.datasets import OWN, layout_of
from prbench.errors import TableError, UsageError
from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import Joint
from prbench.protocol.own_protocol import DescribedTable
from prbench.protocol.published import QUANTITIES, Spread
from prbench.sequences import schema as table_schema
from prbench.sequences.dataset_info import DatasetInfo, Provenance
from prbench.sequences.sequence import SequenceChunk
from prbench.shown import quoted

SPLITS = ("train", "validation", "test")
_SHOWN = 8  # ids that an error message lists


Info = TypeVar("Info", bound=Provenance)


Columns = SequenceOf[str] | None  # names of columns; None for all


def require_unchanged(
    info: Provenance,
    folder: Path,
    columns: pa.Schema,
    identity: SequenceOf[str],
    *,
    main: str,
    others: Iterable[str],
    rows: int = 256,
) -> None:
    """Hold all tables of a folder against the digests of its description; every folder is opened with this.

    Args:
        info: The description.
        folder: Folder that it stands in.
        columns: Columns of the main table.
        identity: Those that make its identity.
        main: Name of the table whose values the content digest is of.
        others: Names of the further tables; where one is absent, whoever wants to read it says so.
        rows: Rows of the main table that are read at once.

    Raises:
        TableError: naming the first file that was edited.
    """
    for path, found in table_schema.digests_of_files(folder, others).items():
        if found != info.file_digests.get(path):
            known = info.file_digests.get(path)
            described = "no such file" if known is None else f"SHA-256 {quoted(known[:12])}…"
            why = f"({described}), found another one ({found[:12]}…)."
            remedy = "It was changed after the build: copy the folder again, or build it again."
            raise TableError(f"{folder / path}: expected the file that {info.file_name} describes {why} {remedy}")
    paths = table_schema.table_parts(folder, main)
    digest = table_schema.ContentDigest(columns.names)
    for path in paths:
        with table_schema.naming(path):
            for batch in table_schema.open_parquet(path).iter_batches(batch_size=rows, columns=columns.names):
                table_schema.require_form(batch, columns, path)
                digest.update(batch)
    names = pa.concat_tables(table_schema.read_parquet(path, list(identity)) for path in paths)
    ids = table_schema.identity_of_rows(names, protocol_version=info.protocol_version)
    told = (("content", digest.hexdigest(), info.content_digest), ("identity", ids, info.identity_digest))
    for kind, found, expected in told:
        if found != expected:
            why = f"({kind} digest {found[:12]}…, expected {quoted(expected[:12])}…)."
            remedy = f"A file was changed after the build; build the {info.described} again."
            raise TableError(f"{paths[0]}: the values are not the ones that {info.file_name} describes {why} {remedy}")


def require_told(info: Provenance, folder: Path, key: str, found: object, expected: object) -> None:
    """Refuse a description of which a number is not that of the table beside it.

    Args:
        info: The description.
        folder: Folder that it stands in.
        key: Name of the number.
        found: The number.
        expected: The one that the table has.

    Raises:
        TableError: if they differ.
    """
    if found != expected:
        problem = f"found {found}. The file was changed after the build; build the {info.described} again."
        raise TableError(f"{folder / info.file_name}, {key}: expected {expected}, as the table has it, {problem}")


@dataclass(frozen=True)
class BuiltTable(Generic[Info]):
    """The common part of the tables of a dataset and of a corpus: a folder, its provenance, and rows on demand.

    A subclass names the class of its provenance (``description``), the table that holds the motions (``main``), the
    columns of every table of the folder, the main one first (``schemas``), those of tables that not every folder has
    (``optional``), the columns of the main table that make its identity
    (:func:`prbench.sequences.schema.identity_of_rows`), and what refuses a file with other columns, or of an unknown
    version (``check``). ``rows_at_once`` of the main table are read together.
    """

    folder: Path
    info: Info
    description: ClassVar[type[Any]]
    main: ClassVar[str]
    schemas: ClassVar[Mapping[str, pa.Schema]]
    optional: ClassVar[Mapping[str, pa.Schema]] = {}
    identity_columns: ClassVar[tuple[str, ...]]
    check: ClassVar[Callable[..., None]]
    rows_at_once: ClassVar[int] = 256

    @classmethod
    @foreign_input()
    def open(cls, folder: Path | str) -> Self:
        """Open a built folder and check versions, columns, ids, numbers of rows, and that no file was edited.

        A dataset may hold events alone: HD-EPIC before EgoAllo has estimated bodies is one.

        Raises:
            TableError: naming the file, what was expected and what was found.
        """
        table = cls(Path(folder), cls.description.read(folder))
        paths = table.part_paths(cls.main)
        for path in paths:
            cls.check(table_schema.open_parquet(path).schema_arrow, cls.schemas[cls.main], source=str(path))
        # Before ids are read: a damaged file is reported as such, not as a wrong id.
        others = [name for name in (*cls.schemas, *cls.optional) if name != cls.main]
        columns = cls.schemas[cls.main]
        described = {"main": cls.main, "others": others, "rows": cls.rows_at_once}
        require_unchanged(table.info, table.folder, columns, cls.identity_columns, **described)
        table_schema.require_distinct_rows(paths, "sequence_id", f"{folder}, {cls.main}")
        counts: Any = getattr(table.info, "counts", None)
        require_told(table.info, table.folder, f"counts.{cls.main}", getattr(counts, cls.main), table.n_rows)
        return table

    @property
    def n_rows(self) -> int:
        """Number of rows of the main table, as the footers of the files tell it."""
        return sum(table_schema.open_parquet(path).metadata.num_rows for path in self.part_paths(self.main))

    @property
    def described_protocol(self) -> DescribedTable:
        """Return what the table says of the protocol that it was built with."""
        return DescribedTable(self.folder, self.info.protocol_digest, self.info.options)

    def part_paths(self, name: str) -> list[Path]:
        """Return the Parquet files of one of the tables, in order."""
        return table_schema.table_parts(self.folder, name)

    def chunks(
        self, *, split: str | None = None, columns: Columns = None, ids: Collection[str] | None = None, rows: int = 256
    ) -> Iterator[SequenceChunk]:
        """Stream the rows of the main table in table order.

        Args:
            split: Only this split.
            columns: Only these columns; ``sequence_id`` and ``n_frames`` always come along.
            ids: Only these sequences.
            rows: Largest number of rows read at once.
        """
        names = self.schemas[self.main].names
        wanted = list(names if columns is None else dict.fromkeys(["sequence_id", "n_frames", *columns]))
        return table_schema.stream_chunks(self.part_paths(self.main), wanted, split=split, ids=ids, rows=rows)

    @foreign_input()
    def scalars(self, *, split: str | None = None, columns: Columns = None) -> pa.Table:
        """Read the columns of the main table that hold one short value a row (no per-frame values, no poses).

        Args:
            split: Only this split.
            columns: Only these columns; all by default, which takes 1 kB a row.
        """
        names = list(columns or (field.name for field in self.schemas[self.main] if self._is_short(field)))
        read = list(dict.fromkeys([*names, "split"] if split is not None else names))
        table = pa.concat_tables(table_schema.read_parquet(path, read) for path in self.part_paths(self.main))
        if split is not None:
            table = table.filter(pc.field("split") == split)
        return table.select(names).combine_chunks()

    def _is_short(self, field: pa.Field) -> bool:
        return not table_schema.is_bulky(field.type)

    @property
    def identity(self) -> str:
        """Identity digest; opening has compared it with the rows."""
        return self.info.identity_digest

    @property
    def content(self) -> str:
        """Content digest; opening has compared it with the rows."""
        return self.info.content_digest

    @foreign_input()
    def _read(self, name: str) -> pa.Table:
        schema = {**self.schemas, **self.optional}[name]
        tables = []
        for path in self.part_paths(name):
            file = table_schema.open_parquet(path)
            type(self).check(file.schema_arrow, schema, source=str(path))
            with table_schema.naming(path):
                tables.append(file.read())
        return table_schema.with_added_columns(pa.concat_tables(tables), schema)


class SequenceTable(BuiltTable[DatasetInfo]):
    """A built dataset: its folder, its provenance, and its rows on demand."""

    description = DatasetInfo
    main = "sequences"
    schemas = table_schema.DATASET_TABLES
    optional = table_schema.OPTIONAL_TABLES
    identity_columns = ("sequence_id", "split", "action", "n_frames")
    check = staticmethod(table_schema.check_schema)

    @property
    def n_sequences(self) -> int:
        """Number of sequences, as the footers of the files tell it."""
        return self.n_rows

    def sequence_ids(self) -> list[str]:
        """Return the ids of all sequences in table order."""
        columns = (table_schema.read_parquet(path, ["sequence_id"]) for path in self.part_paths("sequences"))
        return [name for column in columns for name in column["sequence_id"].to_pylist()]

    @foreign_input()
    def row(self, wanted: str) -> SequenceChunk:
        """Read one row; of the files only the footers and the group of 256 rows that it stands in are read.

        Where no sequence has the very id that was given, the ids of all are read to find the one that is meant.

        Args:
            wanted: The sequence's id, or a beginning, end or part of it that fits one sequence only.

        Raises:
            UsageError: if no sequence fits, or several do.
            TableError: if the file is damaged.
        """
        found = next(self.chunks(ids=frozenset({wanted})), None)
        if found is None:
            name = find_sequence_id(wanted, self.sequence_ids(), among=self.info.dataset)
            found = next(self.chunks(ids=frozenset({name})))
        return found

    def with_sequences(self) -> SequenceTable:
        """Return this table if it has sequences, else say why it has none.

        Raises:
            TableError: if it holds none, saying what became of its recordings and events.
        """
        if self.n_sequences:
            return self
        raise TableError(f"{self.folder}: holds no sequences. {why_no_sequences(self.info)}")

    def events(self) -> pa.Table:
        """Return the ``events`` table."""
        events = self._read("events")
        table_schema.require_distinct(events["event_id"].to_pylist(), f"{self.folder}, events")
        return events

    def recordings(self) -> pa.Table:
        """Return the ``recordings`` table."""
        recordings = self._read("recordings")
        table_schema.require_distinct(recordings["recording_id"].to_pylist(), f"{self.folder}, recordings")
        return recordings

    @property
    def has_scenes(self) -> bool:
        """Whether the boxes of what stands around the people are known (docs/specification/scene.md)."""
        return any(table_schema.table_of(path) == "scenes" for path in self.info.file_digests)

    def scenes(self) -> pa.Table:
        """Return the ``scenes`` table: one row a box of each recording, world frame; without rows where none is known.

        Raises:
            TableError: if the file is missing that the description names, or is damaged.
        """
        return self._read("scenes") if self.has_scenes else table_schema.OPTIONAL_TABLES["scenes"].empty_table()


def why_no_sequences(info: DatasetInfo) -> str:
    """Say in one sentence or two what became of the recordings and events of a dataset."""
    counts = info.counts
    counted = f"{counts.recordings_read} of {counts.recordings_found} recordings were read"
    outcomes = sorted(info.outcomes.items(), key=lambda item: (-item[1], item[0]))
    became = ", ".join(f"{number} {outcome}" for outcome, number in outcomes if number)
    if not became:
        return f"{counted}, and no candidate event was found in them."
    bodies = " Bodies can be estimated: `prbench poses egoallo`." if info.outcomes.get("no_body") else ""
    if bodies and layout_of(info.dataset) == OWN:
        bodies = f" {counts.primed} events have prime times in events.parquet; sequences need bodies: a body table"
        bodies += " (docs/own-recordings.md)."
    return f"{counted}; what became of their {counts.events} events (`prbench explain`): {became}.{bodies}"


def by_share(sequence_ids: SequenceOf[str], recording_ids: SequenceOf[str]) -> list[str]:
    """Return the ids in the order in which a growing limit takes them up: every recording has its share at any limit.

    A recording of n sequences is taken up n times at equal distances, from a start that its hash decides, and its
    sequences by their hashes. So of 10 sequences from 7 recordings of about the same size one recording gives one or
    two, where the hash alone left out two recordings. Every sequence is as likely to be chosen as any other.

    Args:
        sequence_ids: All sequences of a split.
        recording_ids: The recording of each.
    """
    recording_of = dict(zip(sequence_ids, recording_ids, strict=True))
    sizes = Counter(recording_ids)
    starts = {name: int.from_bytes(_hash(name)[:6], "big") / 2**48 for name in sizes}
    taken: Counter[str] = Counter()
    turns: dict[str, float] = {}
    for name in sorted(sequence_ids, key=_hash):
        recording = recording_of[name]
        turns[name] = (taken[recording] + starts[recording]) / sizes[recording]
        taken[recording] += 1
    return sorted(turns, key=lambda name: (turns[name], _hash(name)))


def _hash(name: str) -> bytes:
    return hashlib.sha256(name.encode()).digest()


def find_sequence_id(wanted: str, known: SequenceOf[str], *, among: str, what: str = "sequence") -> str:
    """Return the id that is meant: itself, or the only one that begins or ends with, or else holds, what was typed.

    Args:
        wanted: What was typed.
        known: All ids.
        among: What they belong to, for the message.
        what: What has these ids, for the message.

    Raises:
        UsageError: if none or several fit; names the nearest ids, or those that fit.
    """
    if wanted in known:
        return wanted
    fitting: list[str] = []
    if wanted:
        ends = [name for name in known if name.startswith(wanted) or name.endswith(wanted)]
        fitting = ends or [name for name in known if wanted in name]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        shown = "\n".join(f"  {name}" for name in fitting[:_SHOWN])
        more = f"\n  … and {len(fitting) - _SHOWN} more" if len(fitting) > _SHOWN else ""
        remedy = f"give a longer part of one:\n{shown}{more}"
        raise UsageError(f"'{quoted(wanted)}' fits {len(fitting)} {what}s of {among}; {remedy}")
    hint = "".join(f"\n  {name}" for name in difflib.get_close_matches(wanted, known, n=3, cutoff=0.0))
    hint = f" Near it:{hint}" if hint else ""
    raise UsageError(f"no {what} '{quoted(wanted)}' among the {len(known)} of {among}.{hint}")


# Seconds before and after the prime time over which the gaze shift is averaged.
_GAZE_SHIFT_SPAN = (-2.0, 8.0)
_GAZE_SHIFT_STEP = 0.1
_COLUMNS = ("joints", "goal_location", "gaze_origin", "gaze_direction", "gaze_valid", "fps", "preroll", "split")


_SCALARS = ("split", "participant_id", "pose_source", "event_time", "start_time")
_MEASURED = tuple(name for name in QUANTITIES if name != "duration")


@dataclass(frozen=True)
class TableStatistics:
    """Numbers of one built dataset.

    ``participants_in_two_splits`` counts people of whom there are both training and test sequences: the study splits by
    recording, not by person. ``gaze_shift_times`` are left edges of bins, in seconds from the prime time;
    ``gaze_shift_deg`` holds the quartiles over all sequences of the angle between gaze and goal in each bin, NaN where
    nothing was measured.
    """

    dataset: str
    sequences: int
    by_split: dict[str, int]
    participants_in_two_splits: int
    pose_sources: tuple[str, ...]
    duration: Float[np.ndarray, " n"]
    prime_gap: Float[np.ndarray, " n"]
    body_movement: Float[np.ndarray, " n"]
    hand_movement: Float[np.ndarray, " n"]
    goal_distance: Float[np.ndarray, " n"]
    goal_elevation_deg: Float[np.ndarray, " n"]
    goal_azimuth_deg: Float[np.ndarray, " n"]
    gaze_shift_times: Float[np.ndarray, " k"]
    gaze_shift_deg: Float[np.ndarray, "k 3"]

    def spread(self, quantity: str) -> Spread:
        """Mean and standard deviation of one of the four quantities of Table 1; NaN without sequences."""
        values = getattr(self, quantity)
        if not len(values):
            return Spread(float("nan"), float("nan"))
        return Spread(float(values.mean()), float(values.std()))


def table_statistics(table: SequenceTable) -> TableStatistics:
    """Compute the statistics of a built dataset; rows are streamed.

    A sequence lasts from its first frame to the event: up to one frame less than from 2 s before the prime.
    """
    scalars = table.scalars(columns=(*_SCALARS, *_MEASURED))
    splits = np.array(scalars["split"].to_pylist(), dtype=object)
    people = np.array(scalars["participant_id"].to_pylist(), dtype=object)
    goals = [np.zeros((0, 3))]  # a dataset may hold events alone
    samples = [np.zeros((0, 2))]
    for chunk in table.chunks(columns=_COLUMNS):
        goals.append(chunk.vectors("goal_location") - chunk.joints[chunk.offsets[:-1], Joint.PELVIS])
        # Time from the prime, and angle between gaze and goal in degrees, of every frame with valid gaze.
        row = np.repeat(np.arange(len(chunk)), chunk.n_frames)
        frame = np.arange(len(row)) - chunk.offsets[row]
        time = frame / chunk.numbers("fps")[row] - chunk.numbers("preroll")[row]
        towards = chunk.vectors("goal_location")[row] - chunk.frames("gaze_origin")
        length = np.maximum(np.linalg.norm(towards, axis=1), 1e-9)
        cosine = np.einsum("nk,nk->n", towards, chunk.frames("gaze_direction")) / length
        angle = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
        # Invalid samples hold a filler direction that must not enter the quartiles.
        samples.append(np.column_stack([time, angle])[chunk.frames("gaze_valid")])
    # 1e-6 of a bin: frame times such as 0.30000000000000004 s stay in the bin that they begin.
    first, last = _GAZE_SHIFT_SPAN
    edges = np.round(np.arange(first, last, _GAZE_SHIFT_STEP), 6)
    times, angles = np.concatenate(samples).T
    bins = np.floor((times - first) / _GAZE_SHIFT_STEP + 1e-6).astype(int)
    quartiles = np.full((len(edges), 3), np.nan)
    for number in range(len(edges)):
        inside = angles[bins == number]
        if len(inside):
            quartiles[number] = np.quantile(inside, (0.25, 0.5, 0.75))
    goal = np.concatenate(goals)
    horizontal = np.hypot(goal[:, 0], goal[:, 2])
    return TableStatistics(
        dataset=table.info.dataset,
        sequences=len(splits),
        by_split={split: int((splits == split).sum()) for split in SPLITS},
        participants_in_two_splits=len(set(people[splits == "train"]) & set(people[splits == "test"])),
        pose_sources=tuple(sorted(set(scalars["pose_source"].to_pylist()))),
        duration=(scalars["event_time"].to_numpy() - scalars["start_time"].to_numpy()),
        **{name: scalars[name].to_numpy() for name in _MEASURED},
        goal_distance=np.linalg.norm(goal, axis=1),
        goal_elevation_deg=np.rad2deg(np.arctan2(goal[:, 1], horizontal)),
        goal_azimuth_deg=np.rad2deg(np.arctan2(goal[:, 0], goal[:, 2])),
        gaze_shift_times=edges,
        gaze_shift_deg=quartiles,
    )


def body_movement(joints: np.ndarray) -> float:
    """Largest 3-D distance of the pelvis from frame 0, metres; joints (n, 22, 3)."""
    pelvis = joints[:, Joint.PELVIS]
    return float(np.linalg.norm(pelvis - pelvis[0], axis=1).max())


def hand_movement(joints: np.ndarray, wrist: int) -> float:
    """Largest displacement of one wrist relative to the pelvis (translation removed, heading not), metres."""
    relative = joints[:, wrist] - joints[:, Joint.PELVIS]
    return float(np.linalg.norm(relative - relative[0], axis=1).max())
