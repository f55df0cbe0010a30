"""Predictions on disk: batches written whole, read back in any order."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import PredictionsError
from prbench.harness.run_folder import predictions as predictions_module
from prbench.harness.run_folder.folder import DatasetFolder
from prbench.harness.run_folder.predictions import PredictionRows, Predictions, write_part
from prbench.harness.run_folder.scores import predictions_schema


def motions(*lengths: int, start: float = 0.0) -> PredictionRows:
    joints = np.full((len(lengths), max(lengths), 22, 3), np.nan, dtype=np.float32)
    for row, n in enumerate(lengths):
        joints[row, :n] = start + row + np.arange(n)[:, None, None] / 100
    return PredictionRows.from_padded(joints, np.array(lengths))


@pytest.fixture
def folder(tmp_path) -> DatasetFolder:
    files = DatasetFolder(tmp_path)
    files.predictions.mkdir()
    samples = [motions(3, 5), motions(3, 5, start=10)]
    write_part(files.part(0), ["b", "a"], [(1, 2), (3, 4)], samples, protocol_version=1)
    write_part(files.part(1), ["c"], [(5,), (6,)], [motions(2, start=20), motions(2, start=30)], protocol_version=1)
    return files


def test_motions_come_back_in_the_order_asked_for(folder):
    rows = Predictions.open(folder.predictions).motions(["c", "a", "b"], 1)
    assert list(rows.offsets) == [0, 2, 7, 10]
    assert np.allclose(rows.values[:, 4, 2], [30, 30.01, 11, 11.01, 11.02, 11.03, 11.04, 10, 10.01, 10.02])
    assert ("a", 0) in Predictions.open(folder.predictions)
    assert ("a", 2) not in Predictions.open(folder.predictions)


def test_some_motions_are_those_of_the_whole_and_name_no_other(folder):
    whole = Predictions.open(folder.predictions)
    for some in (whole.only(["c", "b"], [0, 1]), whole.only(["c", "a", "b"], [1, 0]).only(["b", "c"], [0, 1])):
        for sample in (0, 1):
            expected = whole.motions(["b", "c"], sample)
            found = some.motions(["b", "c"], sample)
            assert np.array_equal(found.values, expected.values)
            assert np.array_equal(found.offsets, expected.offsets)
        assert some.where("c", 1) == whole.where("c", 1)
        assert ("a", 0) not in some
        assert set(some.ids) == {"b", "c"}


def test_a_row_that_was_lost_is_named_with_its_file(folder):
    rows = pq.read_table(folder.part(1))
    pq.write_table(rows.slice(1), folder.part(1))
    opened = Predictions.open(folder.predictions)
    for ask in (lambda: opened.motions(["a", "c"], 0), lambda: opened.only(["c"], [0]), lambda: opened.where("c", 0)):
        with pytest.raises(PredictionsError, match=r"predictions: expected a motion of c \(sample 0\), found none"):
            ask()


def test_a_small_cache_changes_nothing(folder, monkeypatch):
    whole = Predictions.open(folder.predictions).motions(["a", "c", "b"], 0).values
    monkeypatch.setattr(predictions_module, "_CACHED_BYTES", 1)
    assert np.array_equal(Predictions.open(folder.predictions).motions(["a", "c", "b"], 0).values, whole)


def test_files_have_the_columns_of_the_design_and_the_encoding_of_the_table(folder):
    file = pq.ParquetFile(folder.part(0))
    assert file.schema_arrow.equals(predictions_schema(), check_metadata=False)
    assert file.read()["seed"].to_pylist() == [1, 2, 3, 4]
    joints = file.metadata.row_group(0).column(3)
    assert joints.compression == "ZSTD"
    assert "BYTE_STREAM_SPLIT" in joints.encodings


def test_equal_motions_give_equal_bytes(folder):
    before = folder.part(0).read_bytes()
    write_part(
        folder.part(0), ["b", "a"], [(1, 2), (3, 4)], [motions(3, 5), motions(3, 5, start=10)], protocol_version=1
    )
    assert folder.part(0).read_bytes() == before


def test_padding_is_left_out():
    joints = np.arange(2 * 4 * 66.0).reshape(2, 4, 22, 3)
    rows = PredictionRows.from_padded(joints, np.array([4, 2]))
    assert list(rows.offsets) == [0, 4, 6]
    assert np.array_equal(rows.values, np.concatenate([joints[0], joints[1, :2]]))


def with_gaze(*lengths: int) -> PredictionRows:
    rows = motions(*lengths)
    gaze = np.random.default_rng(len(lengths)).normal(size=(len(rows.values), 2, 3)).astype(np.float32)
    return PredictionRows(rows.values, rows.offsets, gaze)


def test_gaze_comes_back_with_its_motions(tmp_path):
    samples = [with_gaze(3, 5), with_gaze(2, 4)]
    write_part(tmp_path / "part-0.parquet", ["b", "a"], [(1, 2), (3, 4)], samples, protocol_version=1)
    predictions = Predictions.open(tmp_path)
    assert predictions.has_gaze
    assert pq.read_schema(tmp_path / "part-0.parquet").equals(predictions_schema(gaze=True), check_metadata=False)
    found = predictions.motions(["a", "b"], 1).gaze
    assert samples[1].gaze is not None
    assert np.array_equal(found, np.concatenate([samples[1].gaze[2:], samples[1].gaze[:2]]))


def test_motions_without_gaze_are_the_same_bytes_as_before_and_have_none(folder):
    predictions = Predictions.open(folder.predictions)
    assert not predictions.has_gaze
    assert predictions.motions(["a"], 0).gaze is None


def test_parts_with_and_without_gaze_are_refused(folder):
    write_part(folder.part(2), ["d"], [(7,), (8,)], [with_gaze(2), with_gaze(2)], protocol_version=1)
    with pytest.raises(PredictionsError, match=r"part-00002.parquet: .* found gaze in one of the two"):
        Predictions.open(folder.predictions)


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"gaze_origin": [[[0.0, 0.0, 0.0]]]}, "both columns gaze_origin and gaze_direction, found gaze_origin alone"),
        (
            {"gaze_origin": [[[0.0, 0.0, 0.0]]], "gaze_direction": [[[0.0, 1.0]]]},
            "column 'gaze_direction': expected x y z for each frame",
        ),
        ({"gaze_origin": [[[0.0] * 3] * 2], "gaze_direction": [[[0.0] * 3] * 2]}, "in each of its 1 frames, found 2"),
        (
            {"gaze_origin": [[[0.0] * 3] * 2], "gaze_direction": [[[0.0] * 3]]},
            "in each of its 1 frames, found 2",
        ),
        ({"gaze_origin": [0.0], "gaze_direction": [0.0]}, "column 'gaze_origin': expected a list of frames"),
    ],
)
def test_gaze_of_another_form_is_refused_by_column_and_row(tmp_path, columns, reason):
    pq.write_table(pa.table({"sequence_id": ["a"], "joints": [[[0.0] * 66]], **columns}), tmp_path / "p.parquet")
    with pytest.raises(PredictionsError, match=reason):
        Predictions.open(tmp_path / "p.parquet").motions(["a"], 0)


def test_a_row_without_a_motion_is_refused(tmp_path):
    pq.write_table(pa.table({"sequence_id": ["a", "b"], "joints": [[[0.0] * 66], None]}), tmp_path / "p.parquet")
    with pytest.raises(PredictionsError, match=r"expected a list of frames, .* in every row, found a null"):
        Predictions.open(tmp_path / "p.parquet").motions(["a"], 0)
    pq.write_table(pa.table({"sequence_id": ["a", "b"], "joints": [[[0.0] * 66], []]}), tmp_path / "p.parquet")
    with pytest.raises(PredictionsError, match=r"b: expected a motion, found no frames"):
        Predictions.open(tmp_path / "p.parquet").motions(["b"], 0)


def test_a_part_counts_only_with_exactly_its_sequences_and_samples(folder):
    assert folder.has_part(0, ["b", "a"], 2)
    assert not folder.has_part(0, ["a", "b"], 2)
    assert not folder.has_part(0, ["b", "a"], 1)
    assert not folder.has_part(0, ["b", "a", "c"], 2)
    assert not folder.has_part(2, ["b", "a"], 2)
    folder.part(0).write_bytes(b"PAR1 and nothing more")
    assert not folder.has_part(0, ["b", "a"], 2)


def test_what_another_process_is_just_writing_is_not_read(folder):
    (folder.predictions / ".part-00002-x.partial.parquet").write_bytes(b"half")
    assert len(Predictions.open(folder.predictions).paths) == 2


def test_frames_of_unequal_size_are_refused_although_their_numbers_add_up(tmp_path):
    frames = [[0.0] * 66, [0.0] * 65, [0.0] * 67]
    joints = pa.array([[[0.0] * 66], frames], pa.list_(pa.list_(pa.float32())))
    pq.write_table(pa.table({"sequence_id": ["a", "b"], "joints": joints}), tmp_path / "p.parquet", row_group_size=1)
    with pytest.raises(PredictionsError, match=r"row 1, frame 1: expected a list of frames, .* found 65 numbers"):
        Predictions.open(tmp_path / "p.parquet").motions(["b"], 0)


@pytest.mark.parametrize(
    ("shape", "message"),
    [((21, 3), "row 0, frame 0: .* found 63 numbers"), ((3, 22), "expected x y z for each of 22 joints, found 22")],
)
def test_joints_and_axes_in_another_form_are_refused_however_they_are_nested(tmp_path, shape, message):
    joints = pa.array([np.zeros((2, *shape)).tolist()], pa.list_(pa.list_(pa.list_(pa.float64()))))
    pq.write_table(pa.table({"sequence_id": ["a"], "joints": joints}), tmp_path / "p.parquet")
    with pytest.raises(PredictionsError, match=message):
        Predictions.open(tmp_path / "p.parquet").motions(["a"], 0)


def test_a_single_flipped_bit_anywhere_in_the_numbers_is_noticed(tmp_path):
    values = np.random.default_rng(0).normal(size=(50, 22, 3)).astype(np.float32)
    folder = DatasetFolder(tmp_path)
    write_part(folder.part(0), ["a"], [(1,)], [PredictionRows(values, np.array([0, 50]))], protocol_version=1)
    assert folder.has_part(0, ["a"], 1)
    written = bytearray(folder.part(0).read_bytes())
    for place in range(2000, len(written) - 3000, 997):
        damaged = written.copy()
        damaged[place] ^= 1
        folder.part(0).write_bytes(damaged)
        assert not folder.has_part(0, ["a"], 1)
        with pytest.raises(PredictionsError, match="damaged"):
            Predictions.open(folder.part(0)).motions(["a"], 0)
