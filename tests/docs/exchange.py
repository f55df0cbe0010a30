"""The exchange of docs/wire-protocol.md: its bytes, and the listing that explains them.

``python -m tests.docs.exchange`` writes docs/examples/exchange/ anew.
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from prbench.contract import Condition, ConditionBatch
from prbench.harness.methods.messages import conditions_payload, encode_message, read_message
from tests.docs.interpreters import EXAMPLES, ROOT
from tests.fakes import STANDING

PAGE = ROOT / "docs" / "wire-protocol.md"
FOLDER = EXAMPLES / "exchange"
LISTING = FOLDER / "listing.txt"


@dataclass(frozen=True)
class Exchange:
    """All that goes through the two pipes."""

    stdin: bytes
    stdout: bytes

    @classmethod
    def shown(cls) -> Exchange:
        """As it lies beside the page."""
        return cls((FOLDER / "stdin.bin").read_bytes(), (FOLDER / "stdout.bin").read_bytes())

    @classmethod
    def made(cls) -> Exchange:
        """As the harness and the Python example of this checkout make it."""
        hello = {"message": "hello", "wire": 1, "prbench": "0.4.0", "device": "cpu", "threads": 1}
        asked = batch()
        generate = {"message": "generate", "batch": 0, "condition": "goal-loc", "rows": 2, "fps": 20.0, "seed": 0}
        pieces = [
            *encode_message({**hello, "options": {"stop-before": "0.5"}, "weights": None}),
            *encode_message(generate, conditions_payload(asked)),
        ]
        command = [sys.executable, str(EXAMPLES / "glide.py")]
        done = subprocess.run(command, input=b"".join(pieces), capture_output=True, check=True)
        return cls(b"".join(pieces), done.stdout)

    def listing(self) -> str:
        """Every message in order, payloads buffer by buffer."""
        sent, answered = _messages(self.stdin), _messages(self.stdout)
        lines = [line for pair in zip(sent, answered) for line in (*_lines(">", *pair[0]), *_lines("<", *pair[1]))]
        return "\n".join([*lines, "> end of file", "< exit status 0"]) + "\n"


def batch() -> ConditionBatch:
    """Two sequences, 4 and 3 frames long."""
    poses = np.tile(STANDING.astype(np.float32), (2, 1, 1))
    return ConditionBatch(
        condition=Condition.GOAL_LOCATION,
        n_frames=np.array([4, 3]),
        fps=20.0,
        opaque_id=("first", "second"),  # 64 hexadecimal digits in a run
        noise_seed=(1, 2**63 - 1),
        text=("The person picks a bowl.", "The person puts a cup."),
        initial_joints=poses,
        previous_joints=poses,
        goal_location=np.array([[0.3, 1.0, 0.5], [-0.25, 1.125, 0.75]]),
    )


def decoded(stream: bytes) -> list[tuple[dict, dict | None]]:
    """Headers without sizes, payloads as values."""
    found = []
    for line, payload in _messages(stream):
        header = json.loads(line)
        values = None if payload is None else pa.ipc.open_stream(payload).read_all().to_pydict()
        found.append(({**header, "bytes": 0} if "bytes" in header else header, values))
    return found


def _messages(stream: bytes) -> list[tuple[bytes, bytes | None]]:
    found, source = [], io.BytesIO(stream)
    while True:
        start = source.tell()
        message = read_message(source)
        if message is None:
            return found
        found.append((stream[start:].split(b"\n")[0], message[1]))


def _lines(arrow: str, header: bytes, payload: bytes | None) -> Iterator[str]:
    yield f"{arrow} {header.decode()}"
    if payload is not None:
        yield f"{arrow} {len(payload)} bytes of payload"
        for offset, what, found in _parts(payload):
            shown = " ".join(f"{byte:02x}" for byte in found[:12]) + (" …" if len(found) > 12 else "")
            yield f"  {offset:6}  {what:<36}{shown}"


def _parts(payload: bytes) -> Iterator[tuple[int, str, bytes]]:
    """Offset, name and bytes of everything in an Arrow stream of one record batch."""
    stream = pa.py_buffer(payload)
    reader = pa.ipc.open_stream(stream)
    rows = reader.read_next_batch()
    schema_end = 8 + int.from_bytes(payload[4:8], "little")
    body = schema_end + 8 + int.from_bytes(payload[schema_end + 4 : schema_end + 8], "little")
    yield 0, f"schema, {schema_end} bytes", payload[:schema_end]
    yield schema_end, f"record batch, {body - schema_end} bytes and body", payload[schema_end:body]
    for field, column in zip(rows.schema, rows.columns):
        for name, buffer in zip(_buffer_names(field.type), [found for found in column.buffers() if found is not None]):
            yield buffer.address - stream.address, f"{field.name}, {name}", buffer.to_pybytes()
    yield len(payload) - 8, "end of the stream", payload[-8:]


def _buffer_names(kind: pa.DataType) -> list[str]:
    if pa.types.is_string(kind):
        return ["offsets (int32)", "text"]
    if pa.types.is_list(kind):
        return ["offsets (int32)", f"values ({kind.value_type})"]
    return [f"values ({kind.value_type if pa.types.is_fixed_size_list(kind) else kind})"]


def main() -> None:
    """Write the exchange."""
    exchange = Exchange.made()
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / "stdin.bin").write_bytes(exchange.stdin)
    (FOLDER / "stdout.bin").write_bytes(exchange.stdout)
    LISTING.write_text(exchange.listing(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
