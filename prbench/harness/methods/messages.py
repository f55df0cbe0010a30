"""Motions as a program sent them: whatever form its Arrow library gave them, and whatever is wrong with them."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int, Shaped

from prbench.contract import GIVEN, Condition, ConditionBatch, Gaze, Motions
from prbench.geometry.skeleton import N_JOINTS

_NUMBERS = N_JOINTS * 3  # a frame
_FILE_MAGIC = b"ARROW1"
GAZE_COLUMNS = ("gaze_origin", "gaze_direction")
_SHAPES = ((), (_NUMBERS,), (N_JOINTS, 3))  # of what a row's list may hold: numbers, or frames in either nesting


@dataclass(frozen=True)
class ReceivedMotions:
    """Rows in the order of the program."""

    ids: tuple[str, ...]
    joints: Shaped[np.ndarray, "total 22 3"]
    offsets: Int[np.ndarray, " offsets"]
    """Row i is ``joints[offsets[i]:offsets[i + 1]]``."""
    gaze: tuple[Float[np.ndarray, "total 3"], ...] = ()
    """Origins and directions in the same rows; empty for motions without gaze."""

    @classmethod
    def read(cls, payload: bytes, *, gaze: bool = False) -> ReceivedMotions:
        """Read the payload of a ``motions`` message.

        Args:
            payload: As received.
            gaze: There have to be columns of gaze; otherwise they are not looked at.

        Raises:
            ValueError: if it is no Arrow IPC stream of one record batch with ``opaque_id`` and ``joints``, and those
                of gaze.
        """
        rows = _record_batch(payload)
        wanted = ("opaque_id", "joints", *(GAZE_COLUMNS if gaze else ()))
        ids = tuple(_texts(_column(rows, "opaque_id", wanted)))
        # All frames (total, 22, 3) and the offsets of the rows.
        column = _column(rows, "joints", wanted)
        if not _is_list(column.type):
            raise ValueError(f"expected 'joints' as list<float32>, found {column.type}")
        offsets, values = _unwrapped(column)
        shape: tuple[int, ...] = ()
        while _is_list(values.type):
            inner, within = _unwrapped(values)
            lengths = np.unique(np.diff(inner))
            if len(lengths) > 1 or values.null_count:
                raise ValueError(f"expected {_NUMBERS} numbers in every frame of 'joints', found {_some(lengths)}")
            # The size of a level that no frame shows, since there are none.
            shape += (int(lengths[0]) if len(lengths) else (3 if shape else _NUMBERS),)
            values = within
        if values.type not in (pa.float32(), pa.float64()):
            raise ValueError(f"expected 'joints' as list<float32>, found {column.type}")
        if values.null_count:
            raise ValueError("expected 'joints' without nulls, found some among its numbers")
        if shape not in _SHAPES:
            raise ValueError(f"expected {_NUMBERS} numbers a frame in 'joints', found frames of shape {shape}")
        if not shape:
            lengths = np.diff(offsets)
            broken = np.flatnonzero(lengths % _NUMBERS)
            if broken.size:
                row = int(broken[0])
                raise ValueError(
                    f"expected a multiple of {_NUMBERS} numbers for sequence {ids[row][:64]}, found {lengths[row]:,}"
                )
            offsets = offsets // _NUMBERS
        joints, offsets = values.to_numpy().reshape(-1, N_JOINTS, 3), offsets
        rays = tuple(_points(_column(rows, name, wanted), name, ids, offsets) for name in wanted[2:])
        return cls(ids, joints, offsets, rays)

    def in_order_of(self, asked: Sequence[str]) -> Motions:
        """The motions padded, row by row as asked for.

        Raises:
            ValueError: if an id is missing, repeated or unknown.
        """
        _require_same_ids(asked, self.ids)
        rows = {name: row for row, name in enumerate(self.ids)}
        places = np.array([rows[name] for name in asked])
        n_frames = np.diff(self.offsets)[places]
        longest = int(n_frames.max(initial=0))

        def padded(values: np.ndarray) -> np.ndarray:
            whole = np.zeros((len(asked), longest, *values.shape[1:]), dtype=values.dtype)
            for row, (place, length) in enumerate(zip(places, n_frames, strict=True)):
                whole[row, :length] = values[self.offsets[place] : self.offsets[place + 1]]
            return whole

        gaze = Gaze(*map(padded, self.gaze)) if self.gaze else None
        return Motions(padded(self.joints), n_frames, gaze=gaze)


def numbers_by_id(payload: bytes, asked: Sequence[str], *, name: str, size: int) -> Float[np.ndarray, "rows size"]:
    """Read rows of as many numbers each, in the order asked for.

    Args:
        payload: As received.
        asked: Opaque id of each row.
        name: The column of the numbers, in lists of any nesting.
        size: Numbers in each row.

    Raises:
        ValueError: expected, found and what to do, if it holds something else.
    """
    rows = _record_batch(payload)
    wanted = ("opaque_id", name)
    ids = _texts(_column(rows, "opaque_id", wanted))
    _require_same_ids(asked, ids)
    column = _column(rows, name, wanted)
    ends = np.arange(len(column) + 1)
    values = column
    while _is_list(values.type):
        inner, values = _unwrapped(values)
        ends = inner[ends]
    if values is column or values.type not in (pa.float32(), pa.float64()) or values.null_count:
        raise ValueError(f"expected '{name}' as list<float32> without nulls, found {column.type}")
    wrong = np.flatnonzero(np.diff(ends) != size)
    if wrong.size:
        row = int(wrong[0])
        raise ValueError(
            f"expected {size:,} numbers in '{name}' of {ids[row][:64]}, found {ends[row + 1] - ends[row]:,}"
        )
    place = {identity: row for row, identity in enumerate(ids)}
    return values.to_numpy().reshape(len(ids), size)[[place[identity] for identity in asked]]


def _record_batch(payload: bytes) -> pa.RecordBatch:
    if payload.startswith(_FILE_MAGIC):
        raise ValueError(
            "expected an Arrow IPC stream as payload, found an Arrow file (it begins with ARROW1). Write the stream"
            " format: RecordBatchStreamWriter, new_stream"
        )
    source = pa.BufferReader(payload)
    try:
        with pa.ipc.open_stream(source) as reader:
            batches = list(reader)
            behind = len(payload) - source.tell()
        for batch in batches:
            batch.validate(full=True)  # offsets that point outside would be read as they are
    except (pa.ArrowException, OSError, EOFError) as error:
        cause = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise ValueError(f"expected an Arrow IPC stream as payload, found none that can be read: {cause}") from error
    if behind:
        raise ValueError(f"expected nothing behind the end of the Arrow stream, found {behind:,} bytes")
    if len(batches) != 1:
        raise ValueError(f"expected one record batch, found {len(batches)}")
    return batches[0]


def _points(column: pa.Array, name: str, ids: Sequence[str], offsets: np.ndarray) -> np.ndarray:
    """Return x y z of all frames, (total, 3), which has to be as many as there are frames of joints."""
    if not _is_list(column.type):
        raise ValueError(f"expected '{name}' as list<float32>, found {column.type}")
    ends, values = _unwrapped(column)
    while _is_list(values.type):
        inner, values = _unwrapped(values)
        ends = inner[ends]
    if values.type not in (pa.float32(), pa.float64()) or values.null_count:
        raise ValueError(f"expected '{name}' as list<float32> without nulls, found {column.type}")
    wrong = np.flatnonzero(np.diff(ends) != 3 * np.diff(offsets))
    if wrong.size:
        row = int(wrong[0])
        raise ValueError(
            f"expected {3 * (offsets[row + 1] - offsets[row]):,} numbers in '{name}' of sequence {ids[row][:64]}, three"
            f" a frame, found {ends[row + 1] - ends[row]:,}"
        )
    return values.to_numpy().reshape(-1, 3)


def _column(rows: pa.RecordBatch, name: str, wanted: Sequence[str]) -> pa.Array:
    found = rows.schema.get_all_field_indices(name)
    if len(found) != 1:
        columns = ", ".join(f"{field.name}: {field.type}" for field in rows.schema)
        expected = f"{', '.join(wanted[:-1])} and {wanted[-1]}"
        raise ValueError(f"expected the columns {expected}, once each, found {columns or 'none'}"[:400])
    column = rows.column(found[0])
    if column.null_count:
        row = int(np.flatnonzero(column.is_null().to_numpy(zero_copy_only=False))[0])
        raise ValueError(f"expected '{name}' without nulls, found one in row {row}")
    return column


def _texts(column: pa.Array) -> list[str]:
    if pa.types.is_dictionary(column.type):  # what some libraries make of a few strings
        column = column.dictionary_decode()
    if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        raise ValueError(f"expected 'opaque_id' as utf8, found {column.type}")
    return column.to_pylist()


def _is_list(type_: pa.DataType) -> bool:
    return pa.types.is_list(type_) or pa.types.is_large_list(type_) or pa.types.is_fixed_size_list(type_)


def _unwrapped(column: pa.Array) -> tuple[np.ndarray, pa.Array]:
    """Return offsets from 0 and the values between first and last, whatever slice of its buffers a column is."""
    if pa.types.is_fixed_size_list(column.type):
        return np.arange(len(column) + 1) * column.type.list_size, column.flatten()
    offsets = column.offsets.to_numpy().astype(np.int64)
    return offsets - offsets[0], column.values.slice(int(offsets[0]), int(offsets[-1] - offsets[0]))


def _require_same_ids(asked: Sequence[str], found: Sequence[str]) -> None:
    repeated = [name for name, times in Counter(found).items() if times > 1]
    present = set(found)
    unknown = sorted(present - set(asked))
    missing = [name for name in asked if name not in present]
    if repeated or unknown or missing:
        raise ValueError(
            f"expected each of the {len(asked)} ids of the batch once, found {len(found)} rows: missing"
            f" {_some(missing)}, repeated {_some(repeated)}, unknown {_some(unknown)}."
            " Copy opaque_id from the conditions to the motions, one row a sequence"
        )


def _some(values: Sequence[object] | np.ndarray) -> str:
    """A count with the first of them, or the few numbers themselves."""
    if isinstance(values, np.ndarray):
        return " and ".join(str(value) for value in values[:2])
    return f"{len(values)} ({str(values[0])[:100]})" if values else "0"


_POSE = pa.list_(pa.float32(), N_JOINTS * 3)
_POINT = pa.list_(pa.float64(), 3)
_POSES = ("initial_joints", "previous_joints", "goal_joints")
WIRE_VERSION = 1
HEADER_LIMIT = 65_536
"""Bytes of a header line, its end included."""
Header = dict[str, Any]


def conditions_payload(batch: ConditionBatch) -> bytes:
    """Return as Arrow stream what a program may know about the sequences of a batch, one row each."""
    columns: dict[str, pa.Array] = {
        "opaque_id": pa.array(batch.opaque_id, pa.utf8()),
        "noise_seed": pa.array(batch.noise_seed, pa.int64()),
        "n_frames": pa.array(batch.n_frames.astype(np.int32)),
    }
    if batch.text is not None:
        columns["text"] = pa.array(batch.text, pa.utf8())
    for name in _POSES:
        poses = getattr(batch, name)
        if poses is not None:
            flat = pa.array(np.asarray(poses, dtype=np.float32).reshape(-1))
            columns[name] = pa.FixedSizeListArray.from_arrays(flat, type=_POSE)
    if batch.goal_location is not None:
        flat = pa.array(np.asarray(batch.goal_location, dtype=np.float64).reshape(-1))
        columns["goal_location"] = pa.FixedSizeListArray.from_arrays(flat, type=_POINT)
    return arrow_stream(columns)


def batch_of(header: Mapping[str, Any], payload: bytes) -> ConditionBatch:
    """The batch that a ``generate`` message asks for; its arrays may be written to.

    Args:
        header: With ``condition`` and ``fps``.
        payload: Of :func:`conditions_payload`.
    """
    with pa.ipc.open_stream(payload) as reader:
        rows = reader.read_next_batch()
    condition = Condition(header["condition"])
    given: dict[str, Any] = {}
    for name in GIVEN[condition]:
        if name == "text":
            given[name] = tuple(rows["text"].to_pylist())
        else:
            shape = (-1, 3) if name == "goal_location" else (-1, N_JOINTS, 3)
            given[name] = rows[name].flatten().to_numpy().reshape(shape).copy()
    return ConditionBatch(
        condition=condition,
        n_frames=rows["n_frames"].to_numpy().astype(np.int64),
        fps=float(header["fps"]),
        opaque_id=tuple(rows["opaque_id"].to_pylist()),
        noise_seed=tuple(rows["noise_seed"].to_pylist()),
        **given,
    )


def motions_payload(ids: Sequence[str], motions: Motions) -> bytes:
    """Motions as float32, one row a sequence.

    Args:
        ids: Opaque id of each row of ``motions``.
        motions: Frames beyond those that its array holds are left out, for the reader to miss.

    Raises:
        ValueError: if the array is not (batch, frames, 22, 3), or there is not one id and length for each row.
    """
    joints = np.asarray(motions.joints)
    n_frames = np.asarray(motions.n_frames)
    if joints.ndim != 4 or joints.shape[2:] != (N_JOINTS, 3):
        raise ValueError(f"expected joints of shape (batch, frames, {N_JOINTS}, 3), found {joints.shape}")
    if len(ids) != len(joints) or n_frames.shape != (len(ids),):
        raise ValueError(
            f"expected {len(ids)} motions with a length each, found {len(joints)} and lengths of shape {n_frames.shape}"
        )
    # A method may claim more frames than its array holds; the harness then says which are missing.
    lengths = np.clip(n_frames, 0, joints.shape[1])
    offsets = np.concatenate([[0], np.cumsum(lengths)]) * (N_JOINTS * 3)
    valid = [motion[:length] for motion, length in zip(joints, lengths, strict=True)]
    with np.errstate(over="ignore"):
        flat = np.concatenate([joints[:0].reshape(0, N_JOINTS, 3), *valid]).astype(np.float32, copy=False).reshape(-1)
    columns: dict[str, pa.Array] = {
        "opaque_id": pa.array(ids, pa.utf8()),
        "joints": pa.ListArray.from_arrays(pa.array(offsets.astype(np.int32)), pa.array(flat)),
    }
    if motions.gaze is not None:
        points = pa.array((offsets // N_JOINTS).astype(np.int32))
        for name in GAZE_COLUMNS:
            values = getattr(motions.gaze, name.removeprefix("gaze_"))
            rays = np.concatenate([ray[:length] for ray, length in zip(values, lengths, strict=True)])
            columns[name] = pa.ListArray.from_arrays(points, pa.array(rays.astype(np.float32).reshape(-1)))
    return arrow_stream(columns)


def motions_of(payload: bytes, batch: ConditionBatch, *, gaze: bool = False) -> Motions:
    """The motions of a payload, in the order of the batch and with the lengths found.

    Whether these are the lengths asked for, and whether the positions are finite, is for the caller to check.

    Args:
        payload: Of a ``motions`` message.
        batch: What was asked for.
        gaze: The program declares gaze, so that its columns are read, too.

    Raises:
        ValueError: expected, found and what to do, if they are not one motion for each sequence of the batch.
    """
    return ReceivedMotions.read(payload, gaze=gaze).in_order_of(batch.opaque_id)


def encode_message(header: Header, payload: bytes | None = None) -> list[bytes]:
    """The bytes of a message, in one or two pieces so that a payload is not copied.

    Raises:
        ValueError: if the header is longer than the protocol allows, or holds what JSON cannot.
    """
    if payload is not None:
        header = {**header, "bytes": len(payload)}
    line = json.dumps(header, allow_nan=False).encode() + b"\n"
    if len(line) > HEADER_LIMIT:
        raise ValueError(f"expected a header of at most {HEADER_LIMIT:,} bytes, found {len(line):,}")
    return [line] if payload is None else [line, payload]


def parse_header(line: bytes) -> Header:
    """The JSON object of a header line; it has the key ``bytes`` only if a payload follows.

    Raises:
        ValueError: if the line is no header; says why.
    """
    try:
        header = json.loads(line.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"no JSON in UTF-8: {error}") from error
    if not isinstance(header, dict) or not isinstance(header.get("message"), str):
        raise ValueError("no JSON object with a text under 'message'")
    if "bytes" in header and not (type(header["bytes"]) is int and header["bytes"] >= 0):
        raise ValueError(f"'bytes' is {shown_json(header['bytes'])}, no whole number of 0 or more")
    return header


def shown_json(value: object) -> str:
    """A value of a header as JSON, with its type where the eye may take it for another.

    >>> shown_json(7), shown_json("7"), shown_json(None)
    ('7', '"7" (a string)', 'null')
    """
    text = json.dumps(value)
    text = text if len(text) <= 40 else f"{text[:40]}…"
    names = {str: "a string", float: "a number with decimals", list: "an array", dict: "an object"}
    return f"{text} ({names[type(value)]})" if type(value) in names else text


def write_message(stream: BinaryIO | io.BufferedIOBase, header: Header, payload: bytes | None = None) -> None:
    """Write one message and flush.

    Raises:
        ValueError: see :func:`encode_message`.
    """
    for piece in encode_message(header, payload):
        stream.write(piece)
    stream.flush()


def read_message(stream: BinaryIO | io.BufferedIOBase) -> tuple[Header, bytes | None] | None:
    """Read one message; waits for it.

    Returns:
        Header and payload (None if the header announces none); None where the stream ends between messages.

    Raises:
        ValueError: if what comes is no message.
        EOFError: if the stream ends in mid-message.
    """
    line = stream.readline(HEADER_LIMIT)
    if not line:
        return None
    if not line.endswith(b"\n"):
        if len(line) == HEADER_LIMIT:
            raise ValueError(f"expected a header of at most {HEADER_LIMIT:,} bytes, found no line end in as many")
        raise EOFError(f"the stream ended inside a header, after {len(line):,} bytes")
    header = parse_header(line)
    if "bytes" not in header:
        return header, None
    payload = stream.read(header["bytes"])
    if len(payload) < header["bytes"]:
        raise EOFError(f"the stream ended after {len(payload):,} of {header['bytes']:,} bytes of payload")
    return header, payload


def arrow_stream(columns: Mapping[str, pa.Array]) -> bytes:
    """Return columns as an Arrow IPC stream of one record batch."""
    rows = pa.record_batch(list(columns.values()), names=list(columns))
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, rows.schema) as writer:
        writer.write_batch(rows)
    return sink.getvalue().to_pybytes()


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")
