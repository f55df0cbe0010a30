"""The records that become rows of tables: one sequence, one event, one recording, one box; and rows as Arrow columns.

The fields of these records are the columns of the tables, in their order (docs/table.md). A field's type says what
Python holds, what Parquet holds, and the unit: plain types stand for themselves, others carry Arrow type and unit.
``None`` among a field's types makes the column nullable. What a column means stands in the docstring of the record.
Rows are read as views of Arrow's buffers.
"""

from __future__ import annotations

import inspect
import itertools
import re
import types
from collections.abc import Collection, Iterable, Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import asdict, dataclass, field, fields
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int, Shaped

from prbench.geometry.skeleton import N_JOINTS

# A map, written as a list of pairs: readers that know no maps (Hugging Face ``datasets``) open it too.
KEY_VALUES = pa.list_(pa.struct([pa.field("key", pa.string()), pa.field("value", pa.string())]))
_POINT = pa.list_(pa.float32(), 3)
_POSE = pa.list_(pa.float32(), N_JOINTS * 3)

# Units are those of UCUM: "1" for numbers without dimension; "none" for what is no number.
Metres = Annotated[float, pa.float64(), "m"]
Seconds = Annotated[float, pa.float64(), "s"]
Degrees = Annotated[float, pa.float64(), "deg"]
Hertz = Annotated[float, pa.float64(), "Hz"]
Texts = Annotated[Mapping[str, str], KEY_VALUES, "none"]
PrecisePoint = Annotated[Float[np.ndarray, "3"], pa.list_(pa.float64(), 3), "m"]
Quaternion = Annotated[Float[np.ndarray, "4"], pa.list_(pa.float64(), 4), "1"]
Transform = Annotated[Float[np.ndarray, "4 4"], pa.list_(pa.float64(), 16), "1; m in the last column"]
Pose = Annotated[Float[np.ndarray, "22 3"], _POSE, "m"]
Poses = Annotated[Float[np.ndarray, "n 22 3"], pa.list_(_POSE), "m"]
Points = Annotated[Float[np.ndarray, "n 3"], pa.list_(_POINT), "m"]
Directions = Annotated[Float[np.ndarray, "n 3"], pa.list_(_POINT), "1"]
Rotations = Annotated[Float[np.ndarray, "n 4"], pa.list_(pa.list_(pa.float32(), 4)), "1"]
Flags = Annotated[Bool[np.ndarray, " n"], pa.list_(pa.bool_()), "none"]
# The number that decided an event.
Decisive = Annotated[float, pa.float64(), "m; s where clipping, body or lost tracking decided; 1 of a confidence"]
_PLAIN = {str: (pa.string(), "none"), float: (pa.float64(), "1"), int: (pa.int32(), "1"), bool: (pa.bool_(), "none")}
# A line of an ``Attributes:`` section, and the lines that go on with it.
_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


def column_field(name: str, kind: pa.DataType, *, nullable: bool = False) -> pa.Field:
    """Return a column of a table; unlike Arrow's own default, it holds no nulls unless it says so."""
    return pa.field(name, kind, nullable=nullable)


def schema_of(record: type, *, counted: Collection[str] = (), without: Collection[str] = ()) -> pa.Schema:
    """Return the columns of a table, one row of which is a record.

    Args:
        record: A data class. Its field ``outcomes``, if it has one, stands for one column of counts an outcome.
        counted: Names of these columns.
        without: Fields that the table does not hold.
    """
    hints = get_type_hints(record, include_extras=True)
    columns = []
    for each in fields(record):
        if each.name == "outcomes":
            columns += [column_field(outcome, pa.int32()) for outcome in counted]
        elif each.name not in without:
            kind, _, nullable = _typed(hints[each.name])
            columns.append(column_field(each.name, kind, nullable=nullable))
    return pa.schema(columns)


def _typed(hint: Any) -> tuple[pa.DataType, str, bool]:
    """Return the Arrow type of a field, its unit, and whether it may be None."""
    nullable = get_origin(hint) in (Union, types.UnionType)
    if nullable:
        (hint,) = (each for each in get_args(hint) if each is not types.NoneType)
    if get_origin(hint) is Annotated:
        kind, unit = hint.__metadata__
        return kind, unit, nullable
    return *_PLAIN[str if get_origin(hint) is Literal else hint], nullable


def described(schema: pa.Schema, record: type, *, counted: Mapping[str, str] = types.MappingProxyType({})) -> pa.Schema:
    """Return the columns of a record's table with ``description`` and ``unit`` as metadata of each.

    Args:
        schema: The columns (:func:`schema_of`).
        record: The data class; its docstring describes its attributes, their types name the units.
        counted: Maps each column that counts an outcome to what the outcome means.
    """
    # Parquet has nulls, and no markup.
    doc = (inspect.getdoc(record) or "").replace("None", "null").replace("``", "'")
    texts = {name: " ".join(text.split()) for name, text in _ATTRIBUTE.findall(doc)}
    texts |= {name: f"Number of events that ended as '{name}': {meaning}." for name, meaning in counted.items()}
    hints = dict.fromkeys(counted, int) | get_type_hints(record, include_extras=True)
    return pa.schema(
        each.with_metadata({"description": texts.get(each.name, ""), "unit": _typed(hints[each.name])[1]})
        for each in schema
    )


# Shapes of vectors that stand for more than a vector, by their length.
_SHAPES = {N_JOINTS * 3: (N_JOINTS, 3), 16: (4, 4)}


@dataclass(frozen=True)
class SequenceChunk:
    """Some rows of a sequence table. Columns that were not asked for are absent from ``batch``."""

    batch: pa.RecordBatch

    def __len__(self) -> int:
        return self.batch.num_rows

    @property
    def sequence_ids(self) -> list[str]:
        """One id a row."""
        return self.strings("sequence_id")

    @property
    def n_frames(self) -> Int[np.ndarray, " batch"]:
        """Frames of each row."""
        return self.numbers("n_frames").astype(np.int64)

    @property
    def offsets(self) -> Int[np.ndarray, " offsets"]:
        """First position of each row in the arrays that :meth:`frames` returns; one more than there are rows."""
        return np.concatenate(([0], np.cumsum(self.n_frames)))

    @property
    def joints(self) -> Float[np.ndarray, "total 22 3"]:
        """Joint positions of all rows after one another, canonical frames, metres, float32."""
        return self.frames("joints").reshape(-1, N_JOINTS, 3)

    def poses(self, name: str) -> Float[np.ndarray, "batch 22 3"]:
        """``previous_joints`` or ``next_joints``."""
        return self.vectors(name).reshape(-1, N_JOINTS, 3)

    def strings(self, name: str) -> list[str]:
        """Return a column of text; a missing value is an empty text."""
        return [value or "" for value in self.batch.column(name).to_pylist()]

    def numbers(self, name: str) -> Shaped[np.ndarray, " batch"]:
        """Return a column of numbers; a missing value is NaN."""
        return self.batch.column(name).to_numpy(zero_copy_only=False)

    def vectors(self, name: str) -> Float[np.ndarray, "batch size"]:
        """Return a column of fixed-size vectors."""
        column = self.batch.column(name)
        return column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), column.type.list_size)

    def frames(self, name: str) -> np.ndarray:
        """Return a column of per-frame values, (total frames, size) or (total frames,); a row without one adds none."""
        items = self.batch.column(name).flatten()
        if not pa.types.is_fixed_size_list(items.type):
            return items.to_numpy(zero_copy_only=False)
        return items.flatten().to_numpy(zero_copy_only=False).reshape(len(items), items.type.list_size)

    def take(self, rows: SequenceOf[int] | np.ndarray) -> SequenceChunk:
        """Return the given rows, in the given order (copies)."""
        return SequenceChunk(self.batch.take(pa.array(np.asarray(rows, dtype=np.int64))))


def row_batch(rows: Iterable[Any], schema: pa.Schema, *, counted: Collection[str] = ()) -> pa.RecordBatch:
    """Arrow rows of objects whose attributes bear the names of the columns, in the order given.

    Args:
        rows: The objects.
        schema: The columns.
        counted: Columns that are counts from the mapping ``outcomes`` of each object; 0 where it lacks one.
    """
    rows = list(rows)
    columns = []
    for each in schema:
        name = each.name
        values = [row.outcomes.get(name, 0) if name in counted else getattr(row, name) for row in rows]
        columns.append(column(values, each.type))
    return pa.RecordBatch.from_arrays(columns, schema=schema)


def column(values: list, kind: pa.DataType) -> pa.Array:
    """Values of one column as Arrow: arrays (n, size) or (size,) where the type is bulky, plain values otherwise."""
    if pa.types.is_fixed_size_list(kind):
        missing = [value is None for value in values]
        filler = np.zeros(kind.list_size)
        flat = [np.ravel(filler if value is None else value) for value in values]
        numbers = np.concatenate(flat) if flat else np.empty(0)
        mask = pa.array(missing, type=pa.bool_()) if any(missing) else None
        return pa.FixedSizeListArray.from_arrays(pa.array(numbers, type=kind.value_type), type=kind, mask=mask)
    if kind == KEY_VALUES:
        # Arrow takes pairs as structs of two fields.
        return pa.array([None if value is None else sorted(value.items()) for value in values], type=kind)
    if pa.types.is_list(kind) and pa.types.is_struct(kind.value_type):  # data classes with the fields of the struct
        return pa.array([[asdict(item) for item in value] for value in values], type=kind)
    if pa.types.is_list(kind) and not pa.types.is_string(kind.value_type):
        lengths = [0 if value is None else len(value) for value in values]
        # int32, because Arrow's list (unlike large_list) has such offsets.
        offsets = np.concatenate(([0], np.cumsum(lengths))).astype(np.int32)
        inner = kind.value_type
        present = [value for value in values if value is not None]
        if pa.types.is_fixed_size_list(inner):
            numbers = np.concatenate([np.ravel(value) for value in present]) if present else np.empty(0)
            items = pa.FixedSizeListArray.from_arrays(pa.array(numbers, type=inner.value_type), type=inner)
        else:
            items = pa.array(np.concatenate(present) if present else np.empty(0, dtype=bool), type=inner)
        mask = pa.array([value is None for value in values]) if len(present) < len(values) else None
        return pa.ListArray.from_arrays(pa.array(offsets), items, type=kind, mask=mask)
    return pa.array(values, type=kind)


def row_values(column: pa.Array) -> list[Any]:
    """Return a column's values as the records hold them, one a row; arrays are read-only views of the column.

    Args:
        column: A column of a table whose rows are records; nulls become None.
    """
    kind = column.type
    if kind == KEY_VALUES:
        return [{pair["key"]: pair["value"] for pair in row or ()} for row in column.to_pylist()]
    if pa.types.is_fixed_size_list(kind):
        # A null row has its place among the values, too, which flatten() would leave out.
        items = column.values.slice(column.offset * kind.list_size, len(column) * kind.list_size)
        array = _read_only(items).reshape(-1, *_SHAPES.get(kind.list_size, (kind.list_size,)))
        arrays = list(array)
    elif pa.types.is_list(kind):
        items = column.flatten()
        if pa.types.is_fixed_size_list(items.type):
            size = items.type.list_size
            array = _read_only(items.flatten()).reshape(-1, *_SHAPES.get(size, (size,)))
        else:
            array = _read_only(items)
        ends = np.cumsum(column.value_lengths().fill_null(0).to_numpy(zero_copy_only=False))
        arrays = [array[start:end] for start, end in itertools.pairwise([0, *ends.tolist()])]
    else:
        return column.to_pylist()
    if not column.null_count:
        return arrays
    return [array if valid else None for array, valid in zip(arrays, column.is_valid().to_pylist(), strict=True)]


def _read_only(items: pa.Array) -> np.ndarray:
    array = items.to_numpy(zero_copy_only=False)
    array.setflags(write=False)
    return array


FrameSource = Literal["recorded", "extrapolated", "copied"]
# Possible outcomes of a candidate event, and what they mean.
OUTCOMES = {
    "sequence": "became one",
    "no_location": "never came to rest, or no place annotated",
    "not_primed": "gaze never met the place in the window before",
    "too_short": "recording or body does not cover the sequence",
    "minimum_movement": "started beside the goal",
    "no_body": "no body poses",
    "other_wearer": "somebody else's hand was nearer",
    "excluded_category": "doors, drawers and the like",
    "tracking_lost": "object not tracked around the event",
    "excluded_by_dataset": "never tested by the dataset itself",
    "not_published": "the dataset publishes nothing about it",
    "unreadable_entry": "an entry of the dataset's annotations that cannot be read",
    "low_confidence": "less sure than --min-confidence asks",
    "annotation_only": "listed from the annotations alone (--events-only)",
    "dropped_by_person": "a person's correction says so",
}


@dataclass(frozen=True, eq=False, repr=False)
class Sequence:
    """One prime-and-reach sequence: from 2 s before the first look at the goal until the object is picked or put.

    Positions are in the sequence's own canonical frame unless a name says ``world``: metres, Y up, the pelvis of the
    first frame over the origin facing +Z, the lowest joint of the sequence at Y = 0. Times are in seconds.

    Attributes:
        sequence_id: Dataset, recording, object, action, native time of the event and pose source, joined by slashes.
        dataset: Name of the dataset; it begins with ``synthetic-`` where the people are synthetic.
        recording_id: Name of the recording.
        participant_id: Name of the person.
        split: ``train``, ``validation`` or ``test``.
        split_group: Recordings of one group share the split.
        action: ``pick`` or ``put``; ``unknown`` only in an imported release.
        object_id: The dataset's own id of the object.
        object_name: The dataset's name of the object.
        text: Sentence that a method conditioned on text is given.
        hand: The hand that reaches, ``left`` or ``right``; None where nothing decides.
        fps: Frames per second.
        n_frames: Number of frames; the last one lies exactly on the event.
        start_time: Time of the first frame, seconds on the recording's clock.
        prime_time: Time of the first look at the goal, seconds on the recording's clock.
        event_time: Time of the pick or put, seconds on the recording's clock.
        prime_frame: The frame nearest to the prime time; metrics count from ``prime_after`` instead.
        prime_gap: ``event_time - prime_time``, seconds.
        preroll: ``prime_time - start_time``, seconds.
        prime_kind: How gaze met the goal: ``hit`` or ``near_miss``; ``published`` or ``unknown`` where it was taken
            over.
        prime_time_uncertainty: Spacing of the gaze samples around the prime time, seconds.
        goal_location: Centre of the object's box at the event, canonical frame, metres; of a put the future resting
            place.
        goal_box_world_min: Lower end of that box along x, y and z of the world, metres.
        goal_box_world_max: Upper end of that box along x, y and z of the world, metres.
        body_movement: Largest distance of the pelvis from its first position, metres.
        hand_movement: Largest displacement of the reaching wrist relative to the pelvis, metres.
        pose_source: Source of the body.
        head_tilt_deg: Rest tilt of the neck-head bone of the body's skeleton, degrees; Prime Success needs it.
        joints: Positions (n, 22, 3) of the 22 joints of prbench.Joint in every frame, canonical frame, metres.
        previous_joints: The pose (22, 3) one frame before the first, canonical frame, metres.
        previous_source: How the pose before was got: ``recorded``, ``extrapolated`` or ``copied``.
        next_joints: The pose (22, 3) one frame after the last, canonical frame, metres.
        next_source: How the pose after was got: ``recorded``, ``extrapolated`` or ``copied``.
        head_position: Position (n, 3) of the glasses in every frame, between the eyes, canonical frame, metres; None
            where unknown.
        head_rotation: Rotation (n, 4) from the glasses (x left, y up, z forward) to the canonical frame, quaternions
            w x y z; None where unknown.
        gaze_origin: Start (n, 3) of each gaze ray, between the eyes, canonical frame, metres.
        gaze_direction: Direction (n, 3) of each gaze ray, canonical frame, unit vectors.
        gaze_valid: False (n,) where the eye tracker had no measurement; the ray then says nothing.
        world_from_canonical: Rigid transform (4, 4) from the canonical frame to the recording's world (Y up), metres.
        extra: What only this dataset has, by name.
    """

    sequence_id: str
    dataset: str
    recording_id: str
    participant_id: str
    split: str
    split_group: str
    action: str
    object_id: str
    object_name: str
    text: str
    hand: str | None
    fps: Hertz
    n_frames: int
    start_time: Seconds
    prime_time: Seconds
    event_time: Seconds
    prime_frame: int
    prime_gap: Seconds
    preroll: Seconds
    prime_kind: str
    prime_time_uncertainty: Seconds
    goal_location: PrecisePoint
    goal_box_world_min: PrecisePoint
    goal_box_world_max: PrecisePoint
    body_movement: Metres
    hand_movement: Metres
    pose_source: str
    head_tilt_deg: Degrees
    joints: Poses
    previous_joints: Pose
    previous_source: FrameSource
    next_joints: Pose
    next_source: FrameSource
    head_position: Points | None
    head_rotation: Rotations | None
    gaze_origin: Points
    gaze_direction: Directions
    gaze_valid: Flags
    world_from_canonical: Transform
    extra: Texts = field(default_factory=dict)

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Time of each frame, seconds after the first frame."""
        return np.arange(self.n_frames) / self.fps

    @property
    def prime_after(self) -> float:
        """Time of the first look at the goal, seconds after the first frame; what :func:`prbench.measure` takes."""
        return self.prime_time - self.start_time

    def __repr__(self) -> str:
        hand = f", {self.hand} hand" if self.hand else ""
        what = f"{self.action} of {self.object_name}{hand}, {self.n_frames} frames at {self.fps:g} Hz, {self.split}>"
        return f"<Sequence {self.sequence_id}: {what}"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Event:
    """One candidate event, an object picked or put, and what became of it; world frame, metres, seconds.

    Attributes:
        event_id: Dataset, recording, object, action and native time, joined by slashes.
        recording_id: Name of the recording.
        sequence_id: Id of the sequence that the event became; None if it was dropped.
        object_id: The dataset's own id of the object.
        object_name: The dataset's name of the object.
        action: ``pick`` or ``put``; ``unknown`` of an entry that could not be read.
        hand: The hand that reaches, ``left`` or ``right``; None where nothing decides.
        event_time: Time of the pick or put, seconds on the recording's clock; NaN of an entry that could not be read.
        prime_time: Time of the first look at the object's place, seconds on the recording's clock; None if there was
            none.
        prime_kind: How gaze met the place: ``hit``, ``near_miss`` or ``published``; None if it did not.
        location: Centre (3,) of the object's box, world; None where the object could not be placed.
        box_min: Lower end (3,) of the object's box along x, y and z of the world; None where the object could not be
            placed.
        box_max: Upper end (3,) of the object's box along x, y and z of the world; None where the object could not be
            placed.
        outcome: ``sequence`` if it became one, else why not (docs/table.md#events).
        stage: The stage of curation that decided.
        value: The number that decided.
        threshold: What the number was compared with.
        left_wrist: The left wrist (3,) at the event, world; None where nothing measured it.
        right_wrist: The right wrist (3,) at the event, world; None where nothing measured it.
        published_priming: ``primed``, ``not_primed`` or ``excluded`` where the dataset publishes priming of its own;
            else None.
        published_prime_time: The prime time that the dataset publishes, seconds on the recording's clock; None where it
            publishes none.
        hand_source: What told the hand (docs/table.md#which-hand-reached); None where the hand is unknown.
        prime_margin: Near-miss distance minus the distance at which gaze passed the place, metres: positive where it
            was met, negative by what was lacking; None without valid gaze and where only the dataset tells the prime.
        event_confidence: A number from 0 to 1 (docs/specification/curation.md#confidence); None for events
            without a place.
        corrected: What a person said of it, why and who (docs/review.md); None where nobody did.
        unreadable: File and key of an annotation that could not be read, what was expected and found; None otherwise.
        video: Its place in the video: ``event_time``, ``prime_time`` (seconds of the video), ``event_frame`` and
            ``prime_frame`` (from 0); None where the dataset does not tell.
    """

    event_id: str
    recording_id: str
    sequence_id: str | None = None
    object_id: str
    object_name: str
    action: str
    hand: str | None = None
    event_time: Seconds
    prime_time: Seconds | None = None
    prime_kind: str | None = None
    location: PrecisePoint | None = None
    box_min: PrecisePoint | None = None
    box_max: PrecisePoint | None = None
    outcome: str
    stage: str
    value: Decisive | None = None
    threshold: Decisive | None = None
    left_wrist: PrecisePoint | None = None
    right_wrist: PrecisePoint | None = None
    published_priming: str | None = None
    published_prime_time: Seconds | None = None
    hand_source: str | None = None
    prime_margin: Metres | None = None
    event_confidence: float | None = None
    corrected: str | None = None
    unreadable: str | None = None
    video: Texts | None = None

    def __repr__(self) -> str:
        return f"<Event {self.event_id}: {self.action} of {self.object_name}, {self.outcome}>"


@dataclass(frozen=True)
class Recording:
    """One recording that a build found.

    Attributes:
        recording_id: Name of the recording.
        participant_id: Name of the person.
        split: ``train``, ``validation`` or ``test``.
        split_group: Recordings of one group share the split.
        duration: Length of the part with ground truth, seconds.
        outcomes: Number of its candidate events by outcome.
        status: ``read``, ``failed`` or ``skipped``.
        message: Why it was not read, or what was noticed when it was.
        shortfalls: One message for each stream that ends before the recording does; they stand in ``message``, too.
        findings: What examining its streams found; stands in ``message``, too.
        lacks: Parts that it lacks to have events or sequences at all; stands in ``message``, too.
    """

    recording_id: str
    participant_id: str
    split: str
    split_group: str
    duration: Seconds
    outcomes: Mapping[str, int]
    status: str
    message: str
    shortfalls: tuple[str, ...] = field(default=(), repr=False)
    findings: tuple[str, ...] = field(default=(), repr=False)
    lacks: tuple[str, ...] = field(default=(), repr=False)

    @property
    def is_fruitless(self) -> bool:
        """Return True where it was read and gave no sequence, although sequences were asked for."""
        return self.status == "read" and not (self.outcomes.get("sequence") or self.outcomes.get("annotation_only"))

    @property
    def why_fruitless(self) -> str:
        """The outcomes of its events, the most frequent first, and what it lacks: why it gave no sequence."""
        outcomes = sorted(self.outcomes.items(), key=lambda item: (-item[1], item[0]))
        became = ", ".join(f"{number} {outcome}" for outcome, number in outcomes if number)
        events = f"of {sum(self.outcomes.values())} events {became}" if became else "no candidate event"
        return "; ".join((events, *self.lacks))


@dataclass(frozen=True, eq=False)
class SceneBox:
    """The box of a thing that stands still through a recording. World frame, metres.

    Attributes:
        recording_id: Name of the recording.
        object_id: The dataset's own id of the thing.
        name: The dataset's name of the thing.
        category: Kind of thing.
        centre: Middle of the box, world.
        rotation: World from box, quaternion w x y z.
        half_extents: Half the length of its edges.
        entered: Largest depth to which a joint of the recorded person comes into it, over the whole recording; None
            without a body.
    """

    recording_id: str
    object_id: str
    name: str
    category: str
    centre: PrecisePoint
    rotation: Quaternion
    half_extents: PrecisePoint
    entered: Metres | None


SEQUENCES = described(schema_of(Sequence), Sequence)
EVENTS = described(schema_of(Event), Event)
RECORDINGS = described(
    schema_of(Recording, counted=OUTCOMES, without=("shortfalls", "findings", "lacks")), Recording, counted=OUTCOMES
)
SCENES = described(schema_of(SceneBox), SceneBox)


def sequence_batch(sequences: Iterable[Sequence]) -> pa.RecordBatch:
    """Return Arrow rows of sequences, in the order given."""
    return row_batch(sequences, SEQUENCES)


def event_batch(events: Iterable[Event]) -> pa.RecordBatch:
    """Return Arrow rows of events, in the order given."""
    events = list(events)
    assert all(event.outcome in OUTCOMES for event in events), "curation has no other outcomes"
    return row_batch(events, EVENTS)


def recording_batch(recordings: Iterable[Recording]) -> pa.RecordBatch:
    """Return Arrow rows of recordings, in the order given."""
    return row_batch(recordings, RECORDINGS, counted=OUTCOMES)


def sequences_in(batch: pa.RecordBatch) -> Iterator[Sequence]:
    """Yield the sequences of rows with all columns; their arrays are views of the rows."""
    columns = [row_values(batch.column(name)) for name in SEQUENCES.names]
    return (Sequence(*values) for values in zip(*columns, strict=True))


def event_of(events: pa.Table, row: int) -> Event:
    """Return the event in one row of ``events``."""
    batch = events.slice(row, 1).combine_chunks().to_batches()[0]
    return Event(**{name: row_values(batch.column(name))[0] for name in EVENTS.names})


def recording_of(recordings: pa.Table, row: int) -> Recording:
    """Return the recording in one row of ``recordings``."""
    (values,) = recordings.slice(row, 1).select(RECORDINGS.names).to_pylist()
    outcomes = {name: values.pop(name) for name in OUTCOMES}
    return Recording(**values, outcomes=outcomes)


def recording_key(sequence_id: str) -> str:
    """Dataset and recording of a sequence: its id without object, action, event and pose source."""
    return sequence_id.rsplit("/", 4)[0]
