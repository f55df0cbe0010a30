"""The harness's side of the wire protocol, written from docs/wire-protocol.md alone: an oracle for the examples."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from types import TracebackType

import numpy as np
import pyarrow as pa

from prbench.contract import GIVEN, ConditionBatch

POSES = ("initial_joints", "previous_joints", "goal_joints")


class ByHand:
    """One running program; ``log`` is its stderr, ``sent`` and ``got`` are the bytes of the exchange."""

    def __init__(self, command: list[str], log: Path, *, options: dict[str, str] | None = None) -> None:
        self._log = log.open("wb")
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log)
        self.sent: list[bytes] = []
        self.got: list[bytes] = []
        self._batch = 0
        hello = {"message": "hello", "wire": 1, "prbench": "0.4.0", "device": "cpu", "threads": 1}
        self.introduction, _ = self.exchange(hello | {"options": options or {}, "weights": None})

    def __enter__(self) -> ByHand:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None:
            self._process.kill()
        self.close()

    def close(self) -> int:
        """Close stdin; the exit status."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        status = self._process.wait(10)
        self._process.stdout.close()
        self._log.close()
        return status

    def exchange(self, header: dict, payload: bytes = b"") -> tuple[dict, bytes]:
        """Send one message, read one."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        if payload:
            header = {**header, "bytes": len(payload)}
        self.sent.append(json.dumps(header).encode() + b"\n" + payload)
        self._process.stdin.write(self.sent[-1])
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        answer = json.loads(line)
        returned = self._process.stdout.read(answer.get("bytes", 0))
        self.got.append(line + returned)
        return answer, returned

    def ask(self, batch: ConditionBatch) -> tuple[dict, bytes]:
        """Ask for the motions of one batch; the answer as it came."""
        header = {"message": "generate", "batch": self._batch, "condition": batch.condition.value, "rows": len(batch)}
        self._batch += 1
        return self.exchange(header | {"fps": batch.fps, "seed": 0}, conditions_payload(batch))

    def motions(self, batch: ConditionBatch) -> list[np.ndarray]:
        """Motions (n_frames, 22, 3) float32 in the order of the batch."""
        answer, payload = self.ask(batch)
        assert answer["message"] == "motions", answer
        found = pa.ipc.open_stream(payload).read_all()
        of_id = dict(zip(found["opaque_id"].to_pylist(), found["joints"]))
        flat = [of_id[name].values.to_numpy() for name in batch.opaque_id]
        assert all(values.dtype == np.float32 for values in flat)
        return [values.reshape(-1, 22, 3) for values in flat]


def conditions_payload(batch: ConditionBatch) -> bytes:
    """The Arrow stream of a request."""
    columns: dict[str, pa.Array] = {
        "opaque_id": pa.array(batch.opaque_id, pa.string()),
        "noise_seed": pa.array(batch.noise_seed, pa.int64()),
        "n_frames": pa.array(batch.n_frames, pa.int32()),
    }
    for name in sorted(GIVEN[batch.condition]):
        values = getattr(batch, name)
        if name == "text":
            columns[name] = pa.array(values, pa.string())
        elif name in POSES:
            columns[name] = _fixed(values.astype(np.float32), 66)
        else:
            columns[name] = _fixed(values.astype(np.float64), 3)
    rows = pa.record_batch(columns)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, rows.schema) as writer:
        writer.write_batch(rows)
    return sink.getvalue().to_pybytes()


def _fixed(values: np.ndarray, size: int) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), size)
