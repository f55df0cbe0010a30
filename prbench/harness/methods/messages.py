"""Motions as a program sent them: whatever form its Arrow library gave them, and whatever is wrong with them."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from prbench.contract import GIVEN, Condition, ConditionBatch, Gaze, Motions
from prbench.geometry.skeleton import N_JOINTS

_NUMBERS = N_JOINTS * 3  # a frame
_FILE_MAGIC = b"ARROW1"
GAZE_COLUMNS = ("gaze_origin", "gaze_direction")
_SHAPES = ((), (_NUMBERS,), (N_JOINTS, 3))  # of what a row's list may hold: numbers, or frames in either nesting


def _expected(expected: str, found: str) -> ValueError:
    return ValueError(f"expected {expected}, found {found}")


def motions_of(payload: bytes, batch: ConditionBatch, *, gaze: bool = False) -> Motions:
    """Read the motions of a ``motions`` message in the order of the batch, with lengths as they were sent.

    Args:
        payload: Arrow IPC stream of one record batch with ``opaque_id`` and ``joints``, and columns of gaze if wanted.
        batch: What was asked for.
        gaze: There have to be columns of gaze; otherwise they are not looked at.

    Raises:
        ValueError: expected, found and what to do, if it holds something else.
    """
    rows = _record_batch(payload)
    wanted = ("opaque_id", "joints", *(GAZE_COLUMNS if gaze else ()))
    ids = _texts(_column(rows, "opaque_id", wanted))
    numbers, ends, levels = _flattened(_column(rows, "joints", wanted), "joints")
    uneven = next((sizes for sizes in levels if len(sizes) > 1), None)
    if uneven is not None:
        raise _expected(f"{_NUMBERS} numbers in every frame of 'joints'", " and ".join(map(str, uneven[:2])))
    shape = sum(levels, ())
    if shape not in _SHAPES and len(numbers):
        raise ValueError(f"expected {_NUMBERS} numbers a frame in 'joints', found frames of shape {shape}")
    lengths = np.diff(ends)
    broken = np.flatnonzero(lengths % _NUMBERS)
    if broken.size:
        row = int(broken[0])
        raise _expected(f"a multiple of {_NUMBERS} numbers for sequence {ids[row][:64]}", f"{lengths[row]:,}")
    offsets = ends // _NUMBERS
    columns: list[np.ndarray] = [numbers.reshape(-1, N_JOINTS, 3)]
    for name in wanted[2:]:
        rays, ray_ends, _ = _flattened(_column(rows, name, wanted), name)
        wrong = np.flatnonzero(np.diff(ray_ends) != 3 * np.diff(offsets))
        if wrong.size:
            row = int(wrong[0])
            due = f"{3 * (offsets[row + 1] - offsets[row]):,} numbers in '{name}' of sequence {ids[row][:64]}"
            raise _expected(f"{due}, three a frame", f"{ray_ends[row + 1] - ray_ends[row]:,}")
        columns.append(rays.reshape(-1, 3))
    places = _places_of(batch.opaque_id, ids)
    n_frames = np.diff(offsets)[places]
    padded = [np.zeros((len(places), n_frames.max(initial=0), *each.shape[1:]), each.dtype) for each in columns]
    for whole, values in zip(padded, columns, strict=True):
        for row, (place, length) in enumerate(zip(places, n_frames, strict=True)):
            whole[row, :length] = values[offsets[place] : offsets[place] + length]
    return Motions(padded[0], n_frames, gaze=Gaze(*padded[1:]) if gaze else None)


def numbers_by_id(payload: bytes, asked: Sequence[str], *, name: str, size: int) -> Float[np.ndarray, "rows size"]:
    """Read rows of as many numbers each, in the order asked for.

    Args:
        payload: Payload as it was received.
        asked: Opaque id of each row.
        name: The column of the numbers, in lists of any nesting.
        size: Numbers in each row.

    Raises:
        ValueError: expected, found and what to do, if it holds something else.
    """
    rows = _record_batch(payload)
    wanted = ("opaque_id", name)
    ids = _texts(_column(rows, "opaque_id", wanted))
    places = _places_of(asked, ids)
    numbers, ends, _ = _flattened(_column(rows, name, wanted), name)
    wrong = np.flatnonzero(np.diff(ends) != size)
    if wrong.size:
        row = int(wrong[0])
        raise _expected(f"{size:,} numbers in '{name}' of {ids[row][:64]}", f"{ends[row + 1] - ends[row]:,}")
    return numbers.reshape(len(ids), size)[places]


def _flattened(column: pa.Array, name: str) -> tuple[np.ndarray, np.ndarray, list[tuple[int, ...]]]:
    """Return the numbers of all rows, where each row begins and ends, and the sizes of each level of lists in rows."""
    ends = np.arange(len(column) + 1)
    levels: list[tuple[int, ...]] = []
    values = column
    while pa.types.is_list(values.type) or pa.types.is_large_list(values.type) or _is_fixed(values.type):
        if _is_fixed(values.type):
            offsets = np.arange(len(values) + 1) * values.type.list_size
            inner = values.flatten()
        else:
            # From 0, whatever slice of its buffers the column is.
            offsets = values.offsets.to_numpy().astype(np.int64)
            inner = values.values.slice(int(offsets[0]), int(offsets[-1] - offsets[0]))
            offsets = offsets - offsets[0]
        if values is not column:
            levels.append(tuple(np.unique(np.diff(offsets)).tolist()))
        ends = offsets[ends]
        values = inner
    if values is column or values.type not in (pa.float32(), pa.float64()):
        raise ValueError(f"expected '{name}' as list<float32>, found {column.type}")
    if values.null_count:
        raise ValueError(f"expected '{name}' without nulls, found some among its numbers")
    return values.to_numpy(), ends, levels


def _is_fixed(kind: pa.DataType) -> bool:
    return pa.types.is_fixed_size_list(kind)


def _record_batch(payload: bytes) -> pa.RecordBatch:
    if payload.startswith(_FILE_MAGIC):
        why = "(it begins with ARROW1). Write the stream format: RecordBatchStreamWriter, new_stream"
        raise ValueError(f"expected an Arrow IPC stream as payload, found an Arrow file {why}")
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


def _places_of(asked: Sequence[str], found: Sequence[str]) -> Int[np.ndarray, " rows"]:
    """Return the row of each id that was asked for.

    Raises:
        ValueError: if an id is missing, repeated or unknown.
    """
    place = {name: row for row, name in enumerate(found)}
    repeated = [name for name, times in Counter(found).items() if times > 1]
    unknown = sorted(set(found) - set(asked))
    missing = [name for name in asked if name not in place]
    if repeated or unknown or missing:
        problem = f"{len(found)} rows: missing {_some(missing)}, repeated {_some(repeated)}, unknown {_some(unknown)}"
        remedy = "Copy opaque_id from the conditions to the motions, one row a sequence"
        raise ValueError(f"expected each of the {len(asked)} ids of the batch once, found {problem}. {remedy}")
    return np.array([place[name] for name in asked], dtype=np.int64)


def _some(names: Sequence[str]) -> str:
    return f"{len(names)} ({names[0][:100]})" if names else "0"


_POSE = pa.list_(pa.float32(), N_JOINTS * 3)
_POINT = pa.list_(pa.float64(), 3)
_POSES = ("initial_joints", "previous_joints", "goal_joints")
WIRE_VERSION = 1
HEADER_LIMIT = 65_536  # bytes of a header line, its end included
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
    """Read the batch that a ``generate`` message asks for; its arrays may be written to.

    Args:
        header: Header of the message, which holds ``condition`` and ``fps``.
        payload: Payload that :func:`conditions_payload` made.
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
    """Write motions as float32, one row a sequence.

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
        found = f"{len(joints)} and lengths of shape {n_frames.shape}"
        raise _expected(f"{len(ids)} motions with a length each", found)
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


def encode_message(header: Header, payload: bytes | None = None) -> list[bytes]:
    """Return the bytes of a message, in one or two pieces so that a payload is not copied.

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
    """Read the JSON object of a header line; it has the key ``bytes`` only if a payload follows.

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
    """Show a value of a header as JSON, with its type where the eye may take it for another.

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
