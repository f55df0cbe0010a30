"""Payloads of the wire protocol: conditions out, motions back, each an Arrow IPC stream of one record batch.

Conditions are written here in one form only; motions are read in every form that Arrow libraries of other languages
make of them (docs/wire-protocol.md, "motions").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from prbench.contract import GIVEN, Condition, ConditionBatch, Motions
from prbench.methods.remote.received import ReceivedMotions
from prbench.skeleton import N_JOINTS

_POSE = pa.list_(pa.float32(), N_JOINTS * 3)
_POINT = pa.list_(pa.float64(), 3)
_POSES = ("initial_joints", "previous_joints", "goal_joints")


def conditions_payload(batch: ConditionBatch) -> bytes:
    """What a program may know about the sequences of a batch, one row each."""
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
    return _stream(columns)


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
    joints, n_frames = np.asarray(motions.joints), np.asarray(motions.n_frames)
    if joints.ndim != 4 or joints.shape[2:] != (N_JOINTS, 3):
        raise ValueError(f"expected joints of shape (batch, frames, {N_JOINTS}, 3), found {joints.shape}")
    if len(ids) != len(joints) or n_frames.shape != (len(ids),):
        raise ValueError(
            f"expected {len(ids)} motions with a length each, found {len(joints)} and lengths of shape {n_frames.shape}"
        )
    lengths = np.clip(n_frames, 0, joints.shape[1])
    offsets = np.concatenate([[0], np.cumsum(lengths)]) * (N_JOINTS * 3)
    valid = [motion[:length] for motion, length in zip(joints, lengths, strict=True)]
    with np.errstate(over="ignore"):
        flat = np.concatenate([joints[:0].reshape(0, N_JOINTS, 3), *valid]).astype(np.float32, copy=False).reshape(-1)
    return _stream(
        {
            "opaque_id": pa.array(ids, pa.utf8()),
            "joints": pa.ListArray.from_arrays(pa.array(offsets.astype(np.int32)), pa.array(flat)),
        }
    )


def motions_of(payload: bytes, batch: ConditionBatch) -> Motions:
    """The motions of a payload, in the order of the batch and with the lengths found.

    Whether these are the lengths asked for, and whether the positions are finite, is for the caller to check.

    Raises:
        ValueError: expected, found and what to do, if they are not one motion for each sequence of the batch.
    """
    return ReceivedMotions.read(payload).in_order_of(batch.opaque_id)


def _stream(columns: Mapping[str, pa.Array]) -> bytes:
    rows = pa.record_batch(list(columns.values()), names=list(columns))
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, rows.schema) as writer:
        writer.write_batch(rows)
    return sink.getvalue().to_pybytes()
