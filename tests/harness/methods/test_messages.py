"""Messages: a header line and the bytes that it announces; motions in every form of Arrow that says the same."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import random
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from prbench.contract import Condition, ConditionBatch, Gaze, Motions
from prbench.harness.methods.messages import (
    GAZE_COLUMNS,
    HEADER_LIMIT,
    batch_of,
    conditions_payload,
    motions_of,
    motions_payload,
    parse_header,
    read_message,
    write_message,
)
from tests.harness.methods.made_programs import standard_batch, standing_motions, under


def test_messages_follow_one_another_without_anything_in_between() -> None:
    stream = io.BytesIO()
    write_message(stream, {"message": "hello", "name": "gleiten ↗"})
    write_message(stream, {"message": "motions", "batch": 0}, b"\n{payload}\n")
    write_message(stream, {"message": "motions", "batch": 1}, b"")
    assert stream.getvalue().count(b"\n") == 5
    stream.seek(0)
    assert read_message(stream) == ({"message": "hello", "name": "gleiten ↗"}, None)
    assert read_message(stream) == ({"message": "motions", "batch": 0, "bytes": 11}, b"\n{payload}\n")
    assert read_message(stream) == ({"message": "motions", "batch": 1, "bytes": 0}, b"")
    assert read_message(stream) is None
    assert parse_header(b'{"message": "hello", "colour": 1}\r\n') == {"message": "hello", "colour": 1}


@pytest.mark.parametrize("size", ["null", "2.0", "true", '"2"', "-2"])
def test_a_size_is_a_whole_number_or_left_out(size: str) -> None:
    with pytest.raises(ValueError, match=f"'bytes' is {size}.*, no whole number of 0 or more"):
        parse_header(f'{{"message": "hello", "bytes": {size}}}\n'.encode())


def test_a_stream_that_ends_in_mid_message_is_told_from_one_that_ends() -> None:
    with pytest.raises(EOFError, match="inside a header, after 5 bytes"):
        read_message(io.BytesIO(b'{"mes'))
    with pytest.raises(EOFError, match="after 3 of 9 bytes of payload"):
        read_message(io.BytesIO(b'{"message": "motions", "bytes": 9}\nabc'))


def test_a_header_has_at_most_64_kib_on_either_side() -> None:
    frame = len(b'{"message": ""}\n')
    stream = io.BytesIO()
    write_message(stream, {"message": "x" * (HEADER_LIMIT - frame)})
    assert len(stream.getvalue()) == HEADER_LIMIT == 65536
    stream.seek(0)
    assert read_message(stream) is not None
    with pytest.raises(ValueError, match="at most 65,536 bytes, found 65,537"):
        write_message(stream, {"message": "x" * (HEADER_LIMIT - frame + 1)})
    with pytest.raises(ValueError, match="at most 65,536 bytes, found no line end"):
        read_message(io.BytesIO(b"x" * HEADER_LIMIT + b"\n"))


def test_what_is_no_json_is_never_written() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_message(io.BytesIO(), {"message": "generate", "fps": float("nan")})


BATCH = standard_batch()
MOTIONS = standing_motions(BATCH)
FLAT = MOTIONS.ragged().reshape(-1)
OFFSETS = np.array([0, 4, 9, 15])


def stream(*batches: pa.RecordBatch, **options: Any) -> bytes:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batches[0].schema, **options) as writer:
        for batch in batches:
            writer.write_batch(batch)
    return sink.getvalue().to_pybytes()


def rows(joints: pa.Array, ids: object = BATCH.opaque_id) -> pa.RecordBatch:
    return pa.record_batch([ids if isinstance(ids, pa.Array) else pa.array(ids), joints], names=["opaque_id", "joints"])


def flat_rows(ids: object = BATCH.opaque_id) -> pa.RecordBatch:
    return rows(pa.ListArray.from_arrays(pa.array(OFFSETS * 66, pa.int32()), pa.array(FLAT)), ids)


@pytest.mark.parametrize("condition", list(Condition))
def test_a_program_reads_exactly_the_batch_that_was_sent(condition: Condition) -> None:
    sent = dataclasses.replace(under(condition, BATCH), noise_seed=(0, 1, 2**63 - 1))
    received = batch_of({"condition": condition.value, "fps": 20.0}, conditions_payload(sent))
    for field in dataclasses.fields(ConditionBatch):
        before, after = getattr(sent, field.name), getattr(received, field.name)
        if isinstance(before, np.ndarray):
            np.testing.assert_array_equal(before, after)
            assert before.dtype == after.dtype
            assert after.flags.writeable
        else:
            assert before == after


def test_poses_are_written_joint_by_joint() -> None:
    batch = pa.ipc.open_stream(conditions_payload(BATCH)).read_next_batch()
    assert BATCH.initial_joints is not None
    wrist = np.array(batch["initial_joints"][1].as_py()[63:66], dtype=np.float32)
    np.testing.assert_array_equal(wrist, BATCH.initial_joints[1, 21])


def extended(column: pa.Array) -> pa.Array:
    """The column as a library with an extension type of its own would write it."""

    class Kind(pa.ExtensionType):
        def __init__(self) -> None:
            super().__init__(column.type, "tests.extended")

        def __arrow_ext_serialize__(self) -> bytes:
            return b""

    return pa.ExtensionArray.from_storage(Kind(), column)


def _frames(type_: pa.DataType) -> pa.Array:
    return pa.array([motion[:n].reshape(n, *FRAME[type_.value_type]).tolist() for motion, n in _each()], type_)


def _each() -> list[tuple[np.ndarray, int]]:
    return list(zip(MOTIONS.joints, BATCH.n_frames, strict=True))


JOINT = pa.list_(pa.float32(), 3)
FRAME = {
    pa.list_(pa.float32(), 66): (66,),
    pa.list_(pa.float32()): (66,),
    pa.list_(JOINT, 22): (22, 3),
    pa.list_(pa.list_(pa.float64())): (22, 3),
}
FORMS = {
    "flat": flat_rows(),
    "float64": rows(pa.ListArray.from_arrays(pa.array(OFFSETS * 66, pa.int32()), pa.array(FLAT.astype(np.float64)))),
    "large_list": rows(pa.LargeListArray.from_arrays(pa.array(OFFSETS * 66), pa.array(FLAT))),
    "large_utf8": flat_rows(pa.array(BATCH.opaque_id, pa.large_utf8())),
    "dictionary": flat_rows(pa.array(BATCH.opaque_id).dictionary_encode()),
    "another column": flat_rows().append_column("note", pa.array(["a", None, "c"])),
    "another order": flat_rows().take(pa.array([2, 0, 1])),
    "an extension type": rows(extended(flat_rows()["joints"])),
    "a slice": pa.concat_batches([flat_rows(), flat_rows()]).slice(3, 3),
    **{str(frame): rows(_frames(pa.list_(frame))) for frame in FRAME},
}


LEGACY = pa.ipc.IpcWriteOptions(use_legacy_format=True, metadata_version=pa.ipc.MetadataVersion.V4)
STREAMS = {name: stream(form) for name, form in FORMS.items()} | {
    "LZ4": stream(flat_rows(), options=pa.ipc.IpcWriteOptions(compression="lz4")),
    "ZSTD": stream(flat_rows(), options=pa.ipc.IpcWriteOptions(compression="zstd")),
    "before Arrow 0.15": stream(flat_rows(), options=LEGACY),
    "without its end marker": stream(flat_rows())[:-8],
}


@pytest.mark.parametrize("form", STREAMS)
def test_motions_are_read_in_every_form_that_says_the_same(form: str) -> None:
    motions = motions_of(STREAMS[form], BATCH)
    np.testing.assert_array_equal(motions.n_frames, BATCH.n_frames)
    np.testing.assert_array_equal(motions.ragged(), MOTIONS.ragged())


def test_motions_survive_the_way_to_the_harness() -> None:
    back = motions_of(motions_payload(BATCH.opaque_id, MOTIONS), BATCH)
    np.testing.assert_array_equal(back.ragged(), MOTIONS.ragged())
    assert back.joints.dtype == np.float32


GAZE = Gaze(
    MOTIONS.joints[:, :, 15], np.random.default_rng(3).normal(size=(*MOTIONS.joints.shape[:2], 3)).astype(np.float32)
)


def test_gaze_survives_the_way_to_the_harness() -> None:
    payload = motions_payload(BATCH.opaque_id, dataclasses.replace(MOTIONS, gaze=GAZE))
    back = motions_of(payload, BATCH, gaze=True)
    assert back.gaze is not None
    for row, n in enumerate(BATCH.n_frames):
        np.testing.assert_array_equal(back.gaze.origin[row, :n], GAZE.origin[row, :n])
        np.testing.assert_array_equal(back.gaze.direction[row, :n], GAZE.direction[row, :n])
    np.testing.assert_array_equal(back.ragged(), MOTIONS.ragged())


def test_gaze_that_was_not_declared_is_another_column() -> None:
    payload = motions_payload(BATCH.opaque_id, dataclasses.replace(MOTIONS, gaze=GAZE))
    assert motions_of(payload, BATCH).gaze is None
    with pytest.raises(ValueError, match="expected the columns opaque_id, joints, gaze_origin and gaze_direction"):
        motions_of(motions_payload(BATCH.opaque_id, MOTIONS), BATCH, gaze=True)


def test_gaze_may_be_nested_by_frame_and_is_refused_with_another_length() -> None:
    points = [GAZE.direction[row, :n].tolist() for row, n in enumerate(BATCH.n_frames)]
    columns = {name: pa.array(points, pa.list_(pa.list_(pa.float64(), 3))) for name in GAZE_COLUMNS}
    told = flat_rows()
    for name, column in columns.items():
        told = told.append_column(name, column)
    back = motions_of(stream(told), BATCH, gaze=True)
    assert back.gaze is not None
    np.testing.assert_array_equal(back.gaze.origin[1, :5], GAZE.direction[1, :5])
    short = pa.array([frames[:-1] for frames in points], pa.list_(pa.list_(pa.float64(), 3)))
    wrong = flat_rows().append_column("gaze_origin", columns["gaze_origin"]).append_column("gaze_direction", short)
    with pytest.raises(ValueError, match=r"expected 12 numbers in 'gaze_direction' of sequence .*, three a frame"):
        motions_of(stream(wrong), BATCH, gaze=True)


def test_rows_of_equal_length_may_be_fixed_size_lists() -> None:
    batch = dataclasses.replace(BATCH, n_frames=np.array([4, 4, 4]))
    values = pa.array(MOTIONS.joints[:, :4].reshape(-1))
    motions = motions_of(stream(rows(pa.FixedSizeListArray.from_arrays(values, 4 * 66))), batch)
    np.testing.assert_array_equal(motions.joints, MOTIONS.joints[:, :4])


def test_wrong_lengths_are_passed_on_as_found() -> None:
    shorter = Motions(MOTIONS.joints, np.array([4, 3, 6]))
    assert motions_of(motions_payload(BATCH.opaque_id, shorter), BATCH).n_frames.tolist() == [4, 3, 6]
    assert motions_of(
        motions_payload(BATCH.opaque_id, Motions(MOTIONS.joints[:, :2], BATCH.n_frames)), BATCH
    ).n_frames.tolist() == [2, 2, 2]


NULLS = pa.array([None, FLAT[:66].tolist(), FLAT[:66].tolist()], pa.list_(pa.float32()))
BACKWARDS = pa.ListArray.from_arrays(pa.array([0, 594, 264, 990], pa.int32()), pa.array(FLAT))
A, B, C = BATCH.opaque_id
BAD = {
    "two batches": (stream(flat_rows(), flat_rows()), "one record batch, found 2"),
    "no batch": (stream(flat_rows())[:0] + stream(pa.RecordBatch.from_pylist([], flat_rows().schema)), "found 0 rows"),
    "no joints": (stream(flat_rows().select(["opaque_id"])), "the columns opaque_id and joints, once each, found o"),
    "joints twice": (stream(flat_rows().append_column("joints", pa.array([1, 2, 3]))), "once each, found opaque_id: "),
    "integer ids": (stream(flat_rows(pa.array([1, 2, 3]))), "'opaque_id' as utf8, found int64"),
    "null id": (stream(flat_rows(pa.array([A, None, C]))), "'opaque_id' without nulls, found one in row 1"),
    "a missing id": (stream(flat_rows().slice(0, 2)), rf"missing 1 \({C}\), repeated 0, unknown 0. Copy opaque_id"),
    "a repeated id": (stream(flat_rows([A, B, B])), rf"missing 1 \({C}\), repeated 1 \({B}\), unknown 0"),
    "a row too many": (stream(pa.concat_batches([flat_rows(), flat_rows().slice(2)])), "found 4 rows: .*repeated 1"),
    "offsets that run back": (stream(rows(BACKWARDS)), "expected an Arrow IPC stream as payload, found none"),
    "an unknown id": (stream(flat_rows([A, B, "x"])), rf"missing 1 \({C}\), repeated 0, unknown 1 \(x\)"),
    "integers": (stream(rows(pa.array([[1], [2], [3]]))), "'joints' as list<float32>, found list<item: int64>"),
    "half precision": (stream(rows(pa.array([[], [], []], pa.list_(pa.float16())))), "found list<item: halffloat>"),
    "texts": (stream(rows(pa.array(["1", "2", "3"]))), "'joints' as list<float32>, found string"),
    "null row": (stream(rows(NULLS)), "without nulls, found one in row 0"),
    "null number": (stream(rows(pa.array([[None], [], []], pa.list_(pa.float32())))), "nulls, found some among"),
    "63 numbers": (stream(rows(pa.array([[0.0] * 63] * 3))), f"a multiple of 66 numbers for sequence {A}, found 63"),
    "frames of 63": (stream(rows(pa.array([[[0.0] * 63]] * 3))), r"66 numbers a frame in 'joints', found .*\(63,\)"),
    "uneven frames": (stream(rows(pa.array([[[0.0] * 66, [0.0]]] * 3))), "numbers in every frame of 'joints', found 1"),
    "axes first": (stream(rows(pa.array(np.zeros((3, 1, 3, 22)).tolist()))), r"found frames of shape \(3, 22\)"),
    "an Arrow file": (b"ARROW1\0\0" + stream(flat_rows()), "found an Arrow file .*ARROW1.*stream format"),
    "bytes behind": (stream(flat_rows()) + b"\0", "nothing behind the end of the Arrow stream, found 1 bytes"),
    "JSON": (b'{"joints": []}', "expected an Arrow IPC stream as payload, found none"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_motions_that_cannot_be_used_are_refused_with_what_was_found(case: str) -> None:
    payload, says = BAD[case]
    with pytest.raises(ValueError, match=says):
        motions_of(payload, BATCH)


def test_damaged_bytes_are_read_or_refused_but_never_worse() -> None:
    draw = random.Random(0)
    whole = stream(flat_rows())
    for _ in range(300):
        damaged = bytearray(whole)
        for _ in range(draw.randint(1, 4)):
            damaged[draw.randrange(len(damaged))] = draw.randrange(256)
        cut = draw.choice([len(damaged), draw.randrange(len(damaged))])
        with contextlib.suppress(ValueError):
            motions_of(bytes(damaged[:cut]), BATCH)


def test_an_array_that_is_no_motion_is_not_sent() -> None:
    with pytest.raises(ValueError, match=r"expected joints of shape \(batch, frames, 22, 3\), found \(3, 6, 66\)"):
        motions_payload(BATCH.opaque_id, _unchecked(MOTIONS.joints.reshape(3, 6, 66), BATCH.n_frames))
    with pytest.raises(ValueError, match="expected 2 motions with a length each, found 3"):
        motions_payload(BATCH.opaque_id[:2], MOTIONS)


def _unchecked(joints: np.ndarray, n_frames: np.ndarray) -> Motions:
    """Motions of a wrong shape, which the test suite would refuse to make."""
    motions = object.__new__(Motions)
    for name, value in (("joints", joints), ("n_frames", n_frames), ("cost", None)):
        object.__setattr__(motions, name, value)
    return motions
