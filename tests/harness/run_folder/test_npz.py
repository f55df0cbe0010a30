"""Predictions in NumPy's formats: what is read, and what is refused by name before it can do harm."""

from __future__ import annotations

import io
import os
import pickle
import struct
import zipfile

import numpy as np
import pytest

from prbench.errors import InputFileError, PredictionsError
from prbench.files import arrays as array_files
from prbench.harness.run_folder import predictions as npz
from prbench.harness.run_folder.predictions import Predictions

LENGTHS = np.array([3, 5, 2])
IDS = np.array(["b", "a", "c"])
MOTIONS = [np.arange(n * 66.0).reshape(n, 22, 3) / 7 + 10 * i for i, n in enumerate(LENGTHS)]


def padded(width: int = 5, fill: float = np.nan) -> np.ndarray:
    joints = np.full((3, width, 22, 3), fill)
    for row, motion in enumerate(MOTIONS):
        joints[row, : len(motion)] = motion
    return joints


def arrays(**changes) -> dict[str, np.ndarray]:
    whole = {"opaque_id": IDS, "n_frames": LENGTHS, "joints": padded(), **changes}
    return {name: values for name, values in whole.items() if values is not None}


def saved(path, *, compressed: bool = False, **changes):
    (np.savez_compressed if compressed else np.savez)(path, **arrays(**changes))
    return path


def require_motions(path) -> Predictions:
    predictions = Predictions.open(path)
    rows = predictions.motions(["a", "c", "b"], 0)
    assert rows.values.dtype == np.float32
    assert np.array_equal(rows.values, np.concatenate([MOTIONS[1], MOTIONS[2], MOTIONS[0]]).astype(np.float32))
    assert list(rows.offsets) == [0, 5, 7, 10]
    return predictions


FORMS = {
    "padded": {},
    "padded wider than the longest": {"joints": padded(width=9)},
    "after one another": {"joints": np.concatenate(MOTIONS)},
    "float32": {"joints": padded().astype(np.float32)},
    "big-endian": {"joints": padded().astype(">f8")},
    "column by column": {"joints": np.asfortranarray(padded())},
    "66 numbers, padded": {"joints": padded().reshape(3, 5, 66)},
    "66 numbers, after one another": {"joints": np.concatenate(MOTIONS).reshape(-1, 66)},
    "ids as bytes": {"opaque_id": IDS.astype("S")},
    "unsigned lengths": {"n_frames": LENGTHS.astype(np.uint8)},
    "sequence ids": {"opaque_id": None, "sequence_id": IDS},
    "further arrays": {"noise_seed": np.zeros(3), "loss": np.array(0.5)},
}


@pytest.mark.parametrize("compressed", [False, True], ids=["stored", "compressed"])
@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_one_array_is_read(tmp_path, form, compressed):
    require_motions(saved(tmp_path / "p.npz", compressed=compressed, **FORMS[form]))


UNFIT = [
    ({"opaque_id": None}, r"expected the arrays opaque_id \(or sequence_id\), joints and n_frames, found joints, n_fr"),
    ({"n_frames": None}, "expected the arrays .*Copy opaque_id, sample and n_frames from the conditions file"),
    ({"joints": None}, "expected the arrays"),
    ({"opaque_id": IDS.astype(object)}, "'opaque_id': expected numbers or text, found Python objects.*dtype=object"),
    ({"joints": np.array([None, None])}, "'joints': expected numbers or text, found Python objects"),
    ({"opaque_id": np.arange(3)}, r"'opaque_id': expected one text a motion, found shape \(3,\) of int64"),
    ({"n_frames": LENGTHS[:2]}, r"'n_frames': expected 3 whole numbers, one a motion, found shape \(2,\)"),
    ({"n_frames": LENGTHS * 1.0}, "'n_frames': expected 3 whole numbers, .* of float64"),
    ({"n_frames": np.array([3, 0, 2])}, "'n_frames', row 1: expected 1 or more, found 0"),
    ({"sample": np.array([0, -1, 0])}, "'sample', row 1: expected 0 or more, found -1"),
    ({"joints": padded()[:2]}, "'joints': expected 3 motions, one an id, found 2"),
    ({"joints": padded()[:, :4]}, r"'joints', row 1: expected 5 frames \(n_frames\), found 4"),
    ({"joints": np.concatenate(MOTIONS)[:-1]}, "'joints': expected 10 frames, the sum of n_frames, found 9"),
    ({"joints": padded()[:, :, :21]}, r"'joints': expected \(n, N, 22, 3\) padded, .* found \(3, 5, 21, 3\)"),
    ({"joints": padded().transpose(0, 1, 3, 2)}, r"found \(3, 5, 3, 22\)"),
    ({"joints": padded().astype(np.float16)}, "found .* of float16"),
    ({"joints": np.zeros((3, 5, 22, 3), int)}, "found .* of int64"),
    ({"joints": np.zeros((3, 5, 22, 3), [("x", "f4")])}, r"found .* of \[\('x', '<f4'\)\]"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), UNFIT, ids=[message[:40] for _, message in UNFIT])
def test_what_does_not_fit_is_refused_with_file_and_array(tmp_path, changes, message):
    with pytest.raises(PredictionsError, match=message) as caught:
        Predictions.open(saved(tmp_path / "p.npz", **changes))
    assert str(tmp_path / "p.npz") in str(caught.value)


class Bomb:
    """Leaves a file behind if it is ever unpickled."""

    def __init__(self, target):
        self.target = target

    def __reduce__(self):
        return os.mkdir, (str(self.target),)


def test_pickles_are_never_loaded(tmp_path):
    target = tmp_path / "unpickled"
    evil = np.array([Bomb(target)], dtype=object)
    saved(tmp_path / "p.npz", opaque_id=evil)
    (tmp_path / "q.npz").write_bytes(pickle.dumps(Bomb(target)))
    for path in ("p.npz", "q.npz"):
        with pytest.raises(PredictionsError):
            Predictions.open(tmp_path / path).motions(["a"], 0)
    assert not target.exists()


def npy_header(shape, dtype="<f4") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue()


def with_member(path, name, content):
    """The file with one more member, whatever it holds."""
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{name}.npy", content)
    return path


def test_a_header_that_ends_in_the_middle_is_refused(tmp_path):
    text = b"{'descr': (" + b" " * 52 + b"\n"
    with zipfile.ZipFile(tmp_path / "p.npz", "w") as archive:
        archive.writestr("joints.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text)
    with pytest.raises(InputFileError, match=r"p\.npz, 'joints': expected an array as np\.save writes it"):
        array_files.Archive(tmp_path / "p.npz").header("joints")


@pytest.mark.parametrize("shape", [(10**9, 22, 3), (10, 22, 3, 0), (-1, 22, 3)])
def test_a_header_that_announces_another_size_than_there_is_is_refused_unread(tmp_path, shape):
    path = with_member(saved(tmp_path / "p.npz", joints=None), "joints", npy_header(shape) + bytes(640))
    with pytest.raises(PredictionsError, match="'joints': expected"):
        Predictions.open(path)


def test_ids_that_unpack_to_more_than_any_table_needs_are_refused_unread(tmp_path, monkeypatch):
    monkeypatch.setattr(npz, "_LARGEST_COLUMN", 2**20)
    path = saved(tmp_path / "p.npz", compressed=True, opaque_id=np.zeros(2**20, "U1"))
    assert path.stat().st_size < 2**14
    with pytest.raises(PredictionsError, match=r"'opaque_id': expected at most 1,048,576 bytes, found 4,194,304"):
        Predictions.open(path)


def test_padding_beyond_all_measure_is_refused_unread(tmp_path):
    path = saved(tmp_path / "p.npz", compressed=True, joints=padded(width=2000, fill=0.0))
    with pytest.raises(PredictionsError, match=r"expected at most 1000 frames, as n_frames needs 5, found 2000"):
        Predictions.open(path)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_flipped_bit_is_noticed(tmp_path, compressed):
    noise = np.random.default_rng(0).normal(size=(3, 900, 22, 3))
    path = saved(tmp_path / "p.npz", compressed=compressed, joints=noise)
    content = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        info = archive.getinfo("joints.npy")
    content[info.header_offset + 400 + info.compress_size // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(PredictionsError, match=r"expected a readable .npz file"):
        Predictions.open(path)


@pytest.mark.parametrize("cut", [10, 600, -30])
def test_a_file_that_was_cut_off_is_named(tmp_path, cut):
    path = saved(tmp_path / "p.npz")
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(PredictionsError, match=r"p.npz: expected a readable .npz file"):
        Predictions.open(path)


def test_an_array_that_stands_there_twice_is_refused(tmp_path):
    np.savez(tmp_path / "p.npz", a=MOTIONS[0])
    with pytest.warns(UserWarning, match="Duplicate name"):
        with_member(tmp_path / "p.npz", "a", npy_header((1, 22, 3)) + bytes(264))
    with pytest.raises(PredictionsError, match=r"'a': expected an array once, found it again"):
        Predictions.open(tmp_path / "p.npz")


def test_encrypted_and_foreign_members_are_refused(tmp_path):
    path = saved(tmp_path / "p.npz")
    content = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = content.find(signature)
        content[place + offset : place + offset + 2] = struct.pack("<H", 1)  # the flag of encryption
    path.write_bytes(content)
    with pytest.raises(PredictionsError, match=r"expected a readable .npz file.*encrypted"):
        Predictions.open(path)
    with_member(saved(tmp_path / "q.npz", joints=None), "joints", b"no array at all")
    with pytest.raises(PredictionsError, match=r"'joints': expected an array as np.save writes it"):
        Predictions.open(tmp_path / "q.npz")


@pytest.mark.parametrize("name", ["made.pkl", "made.pt", "made.npy", "made"])
def test_other_formats_are_refused_with_the_ones_there_are(tmp_path, name):
    (tmp_path / name).write_bytes(pickle.dumps(MOTIONS))
    with pytest.raises(PredictionsError, match=rf"{name}: expected Parquet, .npz, or a folder .*with np.savez"):
        Predictions.open(tmp_path / name)


def test_the_conditions_file_itself_is_recognised(tmp_path):
    np.savez(tmp_path / "c.npz", opaque_id=IDS, n_frames=LENGTHS, noise_seed=LENGTHS)
    with pytest.raises(PredictionsError, match="These look like conditions, not motions"):
        Predictions.open(tmp_path / "c.npz")


def test_a_missing_or_empty_file_is_named(tmp_path):
    with pytest.raises(PredictionsError, match=r"gone.npz: expected an .npz file, found no file"):
        Predictions.open(tmp_path / "gone.npz")
    np.savez(tmp_path / "p.npz")
    with pytest.raises(PredictionsError, match=r"p.npz: expected the arrays .*, found none"):
        Predictions.open(tmp_path / "p.npz")


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("after_one_another", [False, True])
def test_gaze_stands_beside_the_joints_in_the_same_form(tmp_path, compressed, after_one_another):
    joints = np.concatenate(MOTIONS) if after_one_another else padded()
    rays = joints[..., 15, :]
    path = saved(tmp_path / "p.npz", compressed=compressed, joints=joints, gaze_origin=rays, gaze_direction=rays + 1.0)
    found = require_motions(path).motions(["c", "b"], 0)
    assert found.gaze is not None
    heads = np.concatenate([MOTIONS[2], MOTIONS[0]])[:, 15]
    assert np.allclose(found.gaze[:, 0], heads)
    assert np.allclose(found.gaze[:, 1], heads + 1.0)


def test_gaze_of_another_shape_or_half_of_it_is_refused(tmp_path):
    rays = padded()[:, :, 15]
    with pytest.raises(PredictionsError, match="both arrays gaze_origin and gaze_direction, found gaze_origin alone"):
        Predictions.open(saved(tmp_path / "p.npz", gaze_origin=rays))
    with pytest.raises(PredictionsError, match=r"'gaze_direction': expected the shape \(3, 5, 3\)"):
        Predictions.open(saved(tmp_path / "p.npz", gaze_origin=rays, gaze_direction=rays[:, :4]))


def test_arrays_named_by_their_sequence_are_motions_and_samples_of_them(tmp_path):
    one = np.random.default_rng(0).normal(size=(4, 22, 3)).astype(np.float32)
    two = np.random.default_rng(1).normal(size=(2, 3, 22, 3))
    path = tmp_path / "named.npz"
    np.savez(path, **{"adt/a/1": one, "adt/b/2": two})
    predictions = Predictions.open(path)
    assert predictions.id_column == "sequence_id"
    assert list(predictions.ids) == ["adt/a/1", "adt/b/2", "adt/b/2"]
    assert list(predictions.samples) == [0, 0, 1]
    joints, _ = predictions.store.motions([2, 0])
    np.testing.assert_array_equal(joints[0], two[1].astype(np.float32))
    np.testing.assert_array_equal(joints[1], one)


def test_named_arrays_of_another_type_are_refused(tmp_path):
    path = tmp_path / "named.npz"
    np.savez(path, **{"adt/a/1": np.zeros((4, 22, 3), dtype=np.int32)})
    with pytest.raises(PredictionsError, match=r"'adt/a/1': expected float32 or float64, found int32"):
        Predictions.open(path)
