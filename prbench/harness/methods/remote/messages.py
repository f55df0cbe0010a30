"""Messages of the wire protocol (docs/wire-protocol.md), read and written by both sides.

A message is one header line, a JSON object in UTF-8, followed by exactly ``bytes`` bytes if the header has that key.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa

from prbench.contract import GIVEN, Condition, ConditionBatch, Motions
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.methods.remote.received import GAZE_COLUMNS, ReceivedMotions

_POSE = pa.list_(pa.float32(), N_JOINTS * 3)
_POINT = pa.list_(pa.float64(), 3)
_POSES = ("initial_joints", "previous_joints", "goal_joints")
__all__ = [
    "HEADER_LIMIT",
    "WIRE_VERSION",
    "Header",
    "arrow_stream",
    "batch_of",
    "conditions_payload",
    "encode_message",
    "motions_of",
    "motions_payload",
    "parse_header",
    "read_message",
    "shown_json",
    "write_message",
]
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
