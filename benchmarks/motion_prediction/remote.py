"""A predictor behind the wire protocol (docs/wire-protocol.md#motion-prediction)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa

from prbench.harness.methods.messages import Header, arrow_stream, numbers_by_id
from prbench.harness.methods.remote import RemoteMethod, answer_in
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, Predictor, require_futures


class RemotePredictor(RemoteMethod):
    """Satisfies :class:`prbench_benchmarks.motion_prediction.batch.Predictor`."""

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
        size = int(np.prod(shape[1:]))
        header = {"message": "predict", "condition": batch.condition.value, "rows": len(batch)}
        header |= {"fps": float(batch.fps), "seed": seed, "n_samples": n_samples, "n_observed": batch.shape[1]}
        header |= {"n_future": batch.n_future, "joint_names": list(batch.joint_names)}

        def rows(values: np.ndarray, kind: pa.DataType) -> pa.Array:
            return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1), kind), int(np.prod(values.shape[1:])))

        # What the program may know, one row a window.
        columns = {
            "opaque_id": pa.array(ids, pa.utf8()),
            "key": pa.array(batch.key, pa.int64()),
            "observed_joints": rows(batch.observed_joints, pa.float32()),
        }
        if batch.gaze is not None and batch.gaze_valid is not None:
            columns["gaze"] = rows(batch.gaze, pa.float32())
            columns["gaze_valid"] = rows(batch.gaze_valid, pa.bool_())
        joints = self.exchange(
            header,
            arrow_stream(columns),
            partial(answer_in, due="futures", read=partial(numbers_by_id, asked=ids, name="joints", size=size)),
            # Twice the size in float64: room for any list type, and still a bound on what is read.
            largest=2 * len(batch) * size * 8,
            ids=ids,
        )
        return Futures(joints=joints.reshape(shape))


def serve_futures(name: str, adapter: Predictor, header: Header, payload: bytes) -> tuple[Header, bytes]:
    """Answer a ``predict`` message for an installed predictor.

    Args:
        name: Name of the predictor.
        adapter: The predictor.
        header: The message's header.
        payload: The message's bytes behind the header.

    Returns:
        Header, without the number of the batch, and payload of the answer.
    """
    with pa.ipc.open_stream(payload) as reader:
        rows = reader.read_next_batch()
    observed = (len(rows), header["n_observed"])

    def column(column_name: str, *shape: int) -> np.ndarray | None:
        if column_name not in rows.schema.names:
            return None
        return rows[column_name].flatten().to_numpy(zero_copy_only=False).reshape(*observed, *shape)

    joints = column("observed_joints", len(header["joint_names"]), 3)
    assert joints is not None
    asked: dict[str, Any] = {"condition": Condition(header["condition"]), "observed_joints": joints}
    asked |= {"joint_names": tuple(header["joint_names"]), "key": tuple(rows["key"].to_pylist())}
    asked |= {"gaze": column("gaze", 3), "gaze_valid": column("gaze_valid")}
    batch = ObservedBatch(fps=header["fps"], n_future=header["n_future"], **asked)
    n_samples = header["n_samples"]
    answer = adapter.predict(batch, n_samples=n_samples, seed=header["seed"])
    futures = require_futures(answer, batch, n_samples, predictor=name)
    joints = np.asarray(futures.joints, dtype=np.float32).reshape(len(batch), -1)
    sent = pa.FixedSizeListArray.from_arrays(pa.array(joints.reshape(-1)), joints.shape[1])
    return {"message": "futures"}, arrow_stream({"opaque_id": rows["opaque_id"], "joints": sent})
