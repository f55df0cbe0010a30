"""The columns of predictions and scores (docs/specification/protocol.md#run-folder)."""

from __future__ import annotations

import pyarrow as pa

from prbench.skeleton import N_JOINTS

RUN_SCHEMA_VERSION = 1

PREDICTIONS = pa.schema(
    [
        pa.field("sequence_id", pa.string(), nullable=False),
        pa.field("sample", pa.int32(), nullable=False),
        pa.field("seed", pa.int64(), nullable=False),
        pa.field("joints", pa.list_(pa.list_(pa.float32(), N_JOINTS * 3)), nullable=False),
    ]
)
"""One generated motion a row: canonical frame, metres, encoded like the sequence table."""

SCORES = pa.schema(
    [
        pa.field("sequence_id", pa.string(), nullable=False),
        pa.field("dataset", pa.string(), nullable=False),
        pa.field("sample", pa.int32(), nullable=False),
        pa.field("metric", pa.string(), nullable=False),
        pa.field("value", pa.float64(), nullable=False),
        pa.field("flag", pa.string(), nullable=True),
    ]
)
"""One value a row; rates are 0 or 1."""
