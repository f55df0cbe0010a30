"""Motions from files of any form, and what is compared with tables and conditions files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.checking.examine_file import DoctorRequest, examine_file, read_motions
from prbench.cli.main import main
from prbench.errors import InputFileError, UsageError
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def motions(crowds: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
    return [motion.astype(np.float32) for motion in crowds["adt"][:4]]


def kinds(path: Path) -> list[str]:
    return [each.kind for each in examine_file(DoctorRequest(path)).diagnoses]


def test_every_form_of_correct_motions_is_read_and_found_right(motions: list[np.ndarray], tmp_path: Path) -> None:
    lengths = [90, 80, 70, 60]
    cut = [motion[:length] for motion, length in zip(motions, lengths, strict=True)]
    padded = np.zeros((4, 90, 22, 3), np.float32)
    for row, motion in zip(padded, cut, strict=True):
        row[: len(motion)] = motion
    ids = ["a", "b", "c", "d"]
    np.save(tmp_path / "one.npy", motions[0])
    np.save(tmp_path / "batch.npy", padded)
    np.savez(tmp_path / "padded.npz", joints=padded, n_frames=lengths, opaque_id=ids)
    np.savez_compressed(tmp_path / "joined.npz", joints=np.concatenate(cut), n_frames=lengths, sequence_id=ids)
    np.savez(tmp_path / "named.npz", a=cut[0], b=cut[1], c=cut[2], d=cut[3])
    rows = pa.table({"sequence_id": ids, "joints": [motion.reshape(-1, 66).tolist() for motion in cut]})
    pq.write_table(rows, tmp_path / "rows.parquet")
    flat = pa.table({"opaque_id": ids, "joints": [motion.reshape(-1).tolist() for motion in cut]})
    pq.write_table(flat, tmp_path / "flat.parquet")
    (tmp_path / "release" / "motions").mkdir(parents=True)
    for number, motion in enumerate(cut):
        np.save(tmp_path / "release" / "motions" / f"{number:010d}.npy", motion)
    (tmp_path / "run" / "predictions").mkdir(parents=True)
    pq.write_table(rows, tmp_path / "run" / "predictions" / "part-00000.parquet")
    for path in sorted(tmp_path.iterdir()):
        read = read_motions(path)
        wanted = [90] if path.stem == "one" else lengths
        assert [values.shape for _, values in read] == [(length, 22, 3) for length in wanted], path.name
        assert kinds(path) == [], path.name


@pytest.mark.parametrize("shape", ["flat", "transposed", "mdm", "features", "parameters", "person axis"])
def test_other_shapes_are_named_and_not_refused(shape: str, motions: list[np.ndarray], tmp_path: Path) -> None:
    from prbench.representation import encode

    arrays = {
        "flat": motions[0].reshape(90, 66),
        "transposed": motions[0].transpose(0, 2, 1),
        "mdm": np.stack(motions).transpose(0, 2, 3, 1),
        "features": encode(motions[0]),
        "parameters": np.random.default_rng(0).normal(size=(90, 165)),
        "person axis": motions[0][:, None],
    }
    np.save(tmp_path / "motions.npy", arrays[shape])
    assert kinds(tmp_path / "motions.npy") == ["features" if shape == "features" else "shape"]


def test_what_is_no_file_of_numbers_is_refused_with_a_reason(tmp_path: Path) -> None:
    (tmp_path / "motions.pkl").write_bytes(b"\x80\x04.")
    np.save(tmp_path / "objects.npy", np.array([{}, {}], dtype=object), allow_pickle=True)
    np.savez(tmp_path / "nothing.npz", name=np.array("x"))
    np.savez(tmp_path / "conditions.npz", noise_seed=np.arange(2), initial_joints=np.zeros((2, 22, 3)))
    pq.write_table(pa.table({"positions": [[1.0]]}), tmp_path / "column.parquet")
    (tmp_path / "empty").mkdir()
    for name, message in (
        ("motions.pkl", "never opened"),
        ("objects.npy", "Python objects"),
        ("nothing.npz", "expected arrays of motions"),
        ("conditions.npz", "with --conditions"),
        ("column.parquet", "column 'joints'"),
        ("empty", "expected motions, found none"),
        ("missing.npy", "no such file"),
    ):
        with pytest.raises(InputFileError, match=message):
            read_motions(tmp_path / name)


def test_a_table_adds_what_was_asked_for(tmp_path: Path) -> None:
    table = fake_dataset(tmp_path / "data", 6)
    chunk = next(table.chunks(columns=["joints"]))
    motions = {
        name: chunk.joints[start:stop]
        for name, start, stop in zip(chunk.sequence_ids, chunk.offsets, chunk.offsets[1:])
    }
    np.savez(tmp_path / "long.npz", joints=np.concatenate([motion[:-3] for motion in motions.values()]),
             n_frames=[len(motion) - 3 for motion in motions.values()], sequence_id=list(motions))  # fmt: skip
    assert "length" not in kinds(tmp_path / "long.npz")
    report = examine_file(DoctorRequest(tmp_path / "long.npz", data=(tmp_path / "data",)))
    assert report.compared == 6
    assert "length" in [each.kind for each in report.diagnoses if each.certain]


def test_opaque_ids_are_resolved_by_their_seed(tmp_path: Path) -> None:
    from prbench.harness.conditions import opaque_ids, run_salt

    table = fake_dataset(tmp_path / "data", 3)
    ids = table.scalars()["sequence_id"].to_pylist()
    chunk = next(table.chunks(columns=["joints"]))
    hidden = opaque_ids(ids, run_salt(7, table.identity))
    np.savez(tmp_path / "m.npz", joints=chunk.joints, n_frames=chunk.n_frames, opaque_id=hidden)
    assert examine_file(DoctorRequest(tmp_path / "m.npz", data=(tmp_path / "data",), seed=7)).compared == 3
    with pytest.raises(UsageError, match="none of the 3 motions"):
        examine_file(DoctorRequest(tmp_path / "m.npz", data=(tmp_path / "data",), seed=8))


def test_numbered_motions_are_rows_of_the_conditions_file(tmp_path: Path) -> None:
    fake_dataset(tmp_path / "data", 12)
    conditions = tmp_path / "conditions.npz"
    data = str(tmp_path / "data")
    assert main(["export-conditions", "--data", data, "--condition", "goal-loc", "--out", str(conditions)]) == 0
    from prbench.harness.offline import read_conditions_file

    asked = read_conditions_file(conditions)
    assert asked.initial_joints is not None
    (tmp_path / "motions").mkdir()
    for row, length in enumerate(asked.n_frames):
        motion = np.repeat(asked.initial_joints[row][None], length + 10, axis=0)  # a constant tail is no rate
        np.save(tmp_path / "motions" / f"{row:010d}.npy", motion)
    report = examine_file(DoctorRequest(tmp_path / "motions", conditions=conditions))
    assert report.compared == len(asked)
    assert [each.kind for each in report.diagnoses if each.certain] == ["length"]


def test_the_command_prints_writes_json_and_ends_with_one_if_something_is_wrong(
    motions: list[np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "right.npy", motions[0])
    np.save(tmp_path / "wrong.npy", motions[0] * 1000)
    assert main(["doctor", str(tmp_path / "right.npy")]) == 0
    assert "nothing found" in capsys.readouterr().out
    assert main(["doctor", str(tmp_path / "wrong.npy"), "--out", str(tmp_path / "report.json")]) == 1
    printed = capsys.readouterr().out
    assert "wrong: unit" in printed
    assert "positions are in millimetres" in printed
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["report"]
    assert any(each["certain"] for each in report["diagnoses"])
    assert report["diagnoses"][0]["kind"] == "unit"
    assert set(report["diagnoses"][0]) == {"kind", "certain", "evidence", "cause", "remedy"}


def test_the_command_reports_the_same_as_json(
    motions: list[np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "wrong.npy", motions[0] * 1000)
    report = reported(["doctor", str(tmp_path / "wrong.npy")], capsys, code=1)
    assert (report.total, report.examined, report.compared) == (1, 1, 0)
    assert report.diagnoses[0].kind == "unit"
    refused(["doctor", str(tmp_path / "gone.npy")], capsys, code=3, message="gone.npy")


def test_of_more_than_200_motions_200_are_looked_at(motions: list[np.ndarray], tmp_path: Path) -> None:
    (tmp_path / "motions").mkdir()
    for row in range(203):
        np.save(tmp_path / "motions" / f"{row:010d}.npy", motions[row % 3])
    report = examine_file(DoctorRequest(path=tmp_path))
    assert (report.total, report.examined) == (203, 200)


def test_a_suspicion_alone_ends_with_zero(motions: list[np.ndarray], tmp_path: Path) -> None:
    np.save(tmp_path / "higher.npy", motions[0] + np.array([0, 0.06, 0], dtype=np.float32))
    assert kinds(tmp_path / "higher.npy") == ["floor"]
    assert main(["doctor", str(tmp_path / "higher.npy")]) == 0
