"""A predictor behind the wire protocol (docs/wire-protocol.md#motion-prediction)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from prbench.methods.motions import asked_for
from prbench.methods.remote.answers import answer_in
from prbench.methods.remote.messages import Header, arrow_stream
from prbench.methods.remote.method import Exchange, RemoteMethod
from prbench.methods.remote.received import numbers_by_id
from prbench.prediction.batch import Condition, Futures, ObservedBatch


class RemotePredictor(RemoteMethod):
    """Satisfies :class:`prbench.prediction.batch.Predictor`."""

    all_conditions = Condition
    said: ClassVar[Mapping[str, Any]] = {"benchmark": "motion-prediction"}

    def predict(self, batch: ObservedBatch, *, n_samples: int, seed: int) -> Futures:
        """Ask the program for the futures of a batch.

        Raises:
            AdapterError: see :meth:`RemoteMethod.exchange`.
            MemoryError: see :meth:`RemoteMethod.exchange`.
        """
        ids = tuple(f"{key:016x}" for key in batch.key)
        shape = (len(batch), n_samples, batch.n_future, len(batch.joint_names), 3)
        header = {
            "message": "predict",
            "condition": batch.condition.value,
            "rows": len(batch),
            "fps": float(batch.fps),
            "seed": seed,
            "n_samples": n_samples,
            "n_observed": batch.shape[1],
            "n_future": batch.n_future,
            "joint_names": list(batch.joint_names),
        }
        asked = Exchange(
            header=header,
            payload=_observed_payload(batch, ids),
            # Twice the size in float64: room for any list type, and still a bound on what is read.
            largest=2 * int(np.prod(shape)) * 8,
            read=partial(_futures_in, ids=ids, shape=shape),
            asked_for=asked_for(ids),
        )
        return Futures(joints=self.exchange(asked))


def _observed_payload(batch: ObservedBatch, ids: tuple[str, ...]) -> bytes:
    """Arrow stream of what a program may know, one row a window."""

    def rows(values: np.ndarray, kind: pa.DataType) -> pa.Array:
        size = int(np.prod(values.shape[1:]))
        flat = pa.array(values.reshape(-1), kind)
        return pa.FixedSizeListArray.from_arrays(flat, size)

    columns = {
        "opaque_id": pa.array(ids, pa.utf8()),
        "key": pa.array(batch.key, pa.int64()),
        "observed_joints": rows(batch.observed_joints, pa.float32()),
    }
    if batch.gaze is not None and batch.gaze_valid is not None:
        columns["gaze"] = rows(batch.gaze, pa.float32())
        columns["gaze_valid"] = rows(batch.gaze_valid, pa.bool_())
    return arrow_stream(columns)


def _futures_in(
    header: Header, payload: bytes | None, number: int, *, ids: tuple[str, ...], shape: tuple[int, ...]
) -> Float[np.ndarray, "batch samples future joints 3"]:
    size = int(np.prod(shape[1:]))
    read = partial(numbers_by_id, asked=ids, name="joints", size=size)
    return answer_in(header, payload, number, due="futures", read=read).reshape(shape)
