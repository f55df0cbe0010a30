"""What docs/wire-protocol.md says that the harness takes beyond the specification is taken; wrong types are not."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from prbench.contract import Motions
from prbench.errors import AdapterError
from prbench.harness.methods.messages import motions_of, motions_payload, parse_header, shown_json
from prbench.harness.methods.process import Fault
from prbench.harness.methods.remote import Introduction, motions_in
from tests.docs.exchange import batch
from tests.docs.test_wire_protocol import section, table
from tests.fakes import STANDING

BATCH = dataclasses.replace(batch(), n_frames=np.array([4, 4]))  # of one length, for fixed_size_list
MOTIONS = Motions(
    np.stack([STANDING + 0.1 * frame for frame in range(8)]).reshape(2, 4, 22, 3).astype(np.float32), BATCH.n_frames
)
ROWS = pa.ipc.open_stream(motions_payload(BATCH.opaque_id, MOTIONS)).read_next_batch()
IDS, JOINTS = ROWS.columns
NUMBER = pa.float32()


def stream(joints: pa.Array = JOINTS, ids: pa.Array = IDS, options: pa.ipc.IpcWriteOptions | None = None) -> bytes:
    rows = pa.record_batch([ids, joints, pa.nulls(2)], ["opaque_id", "joints", "note"])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, rows.schema, options=options) as writer:
        writer.write_batch(rows)
    return sink.getvalue().to_pybytes()


def frames(kind: pa.DataType, shape: tuple[int, ...]) -> pa.Array:
    return pa.array([motion.reshape(4, *shape).tolist() for motion in MOTIONS.joints], pa.list_(kind))


def extended(column: pa.Array) -> pa.Array:
    """As a library with an extension type of its own would write it."""

    class Kind(pa.ExtensionType):
        def __init__(self) -> None:
            super().__init__(column.type, "tests.strictness")

        def __arrow_ext_serialize__(self) -> bytes:
            return b""

    return pa.ExtensionArray.from_storage(Kind(), column)


def options(**changes: Any) -> pa.ipc.IpcWriteOptions:
    return pa.ipc.IpcWriteOptions(**changes)


PAYLOADS = {
    "ids as `large_utf8`": [stream(ids=IDS.cast(pa.large_utf8()))],
    "ids as a dictionary of `utf8`": [stream(ids=IDS.dictionary_encode())],
    "`joints` of `float64`": [stream(JOINTS.cast(pa.list_(pa.float64())))],
    "`joints` as `large_list`": [stream(JOINTS.cast(pa.large_list(NUMBER)))],
    "`joints` as `fixed_size_list`": [stream(JOINTS.cast(pa.list_(NUMBER, 4 * 66)))],
    "frames of 66 numbers, a list each": [
        stream(frames(kind, (66,))) for kind in (pa.list_(NUMBER), pa.list_(NUMBER, 66))
    ],
    "frames of 22 lists of 3 numbers": [
        stream(frames(kind, (22, 3))) for kind in (pa.list_(pa.list_(NUMBER)), pa.list_(pa.list_(NUMBER, 3), 22))
    ],
    "extension types": [stream(extended(JOINTS))],
    "other columns": [stream()],
    "buffers compressed with LZ4 or ZSTD": [stream(options=options(compression=name)) for name in ("lz4", "zstd")],
    "a stream without its end marker": [stream()[:-8]],
    "the message format of before Arrow 0.15": [
        stream(options=options(use_legacy_format=True, metadata_version=pa.ipc.MetadataVersion.V4))
    ],
}  # fmt: skip
HEADERS = (
    "a header that ends with `\\r\\n`",
    "unknown keys in a header",
    "an `error` without `batch`",
    "an `error` without `text`",
    "a payload behind `hello`",
)


def test_the_page_lists_exactly_these() -> None:
    assert [row[0] for row in table("How strict the harness is")] == [*PAYLOADS, *HEADERS]


@pytest.mark.parametrize("form", PAYLOADS)
def test_payloads_that_the_page_accepts_are_read(form: str) -> None:
    for payload in PAYLOADS[form]:
        found = motions_of(payload, BATCH)
        np.testing.assert_array_equal(found.joints.astype(np.float32), MOTIONS.joints)
        assert found.n_frames.tolist() == [4, 4]


def test_headers_that_the_page_accepts_are_read() -> None:
    assert parse_header(b'{"message": "error", "colour": 1}\r\n') == {"message": "error", "colour": 1}
    with pytest.raises(Fault, match="reported an error: too hot"):
        motions_in({"message": "error", "text": "too hot"}, None, BATCH, 3)
    with pytest.raises(Fault, match="no reason given"):
        motions_in({"message": "error", "batch": 3}, None, BATCH, 3)


@pytest.mark.parametrize(
    "key", ["wire", "name", "version", "conditions", "max_frames", "native_fps", "motionless", "weights"]
)
def test_a_key_of_another_type_is_refused(key: str) -> None:
    right = {"wire": 1, "name": "n", "version": "1", "conditions": ["none"], "max_frames": 9, "native_fps": 30.5}
    right |= {"motionless": True, "weights": {}}
    Introduction.read({"message": "hello", **right}, origin="method 'n'")
    for wrong in ("1", 1.5, True, {"none": 1}, ["none"]):
        if type(wrong) is not type(right[key]) or key == "weights":
            with pytest.raises(AdapterError, match=f"'{key}'"):
                Introduction.read({"message": "hello", **right, key: wrong}, origin="method 'n'")


def test_shown_values_are_json_with_their_type() -> None:
    shown = [shown_json(value) for value in (7, "7", 7.0, True, None, [1], {"a": 1}, "x" * 99)]
    assert shown[:2] == ["7", '"7" (a string)']
    assert shown[2:7] == ["7.0 (a number with decimals)", "true", "null", "[1] (an array)", '{"a": 1} (an object)']
    assert len(shown[7]) < 60


def test_the_pose_for_methods_that_are_given_no_body_stands_in_the_canonical_frame() -> None:
    pose = np.array(json.loads(section("What the numbers mean").split("```json\n")[1].split("```")[0]))
    assert pose.shape == (22, 3)
    np.testing.assert_allclose(pose, STANDING - [0, STANDING[:, 1].min(), 0], atol=1e-9)
    assert pose[:, 1].min() == 0
    assert pose[0, [0, 2]].tolist() == [0, 0]
    across = pose[2] - pose[1] + pose[17] - pose[16]
    forward = np.cross([0, 1, 0], across)
    np.testing.assert_allclose(forward / np.linalg.norm(forward), [0, 0, 1], atol=1e-9)
