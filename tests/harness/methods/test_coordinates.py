"""Coordinates that no motion in metres holds are refused at every door, with the place and the likely unit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError, PredictionsError, TableError
from prbench.harness.methods.motions import coordinate_problem
from prbench.harness.planning import select
from prbench.harness.run import run_method
from prbench.harness.score_predictions import score_predictions
from prbench.harness.score_request import ScoreRequest
from tests import fakes
from tests.fakes import fake_sequence, smooth_motion
from tests.harness.test_run import request
from tests.harness.test_score_predictions import write
from tests.method_fixtures import adapter_source

MILLIMETRES = "positions are in millimetres. Multiply the joints by 0.001"


def with_value(value: float) -> np.ndarray:
    motion = smooth_motion("a", 12)
    motion[7, 20, 1] = value
    return motion


@pytest.mark.parametrize("value", [100.5, -1e30, np.float32(3e38)])
def test_a_coordinate_beyond_100_m_is_named_with_frame_and_joint(value):
    problem = coordinate_problem(with_value(value))
    assert problem is not None
    assert problem.startswith("frame 7: expected coordinates within 100 m of the origin, found [")
    assert problem.endswith("at joint 20 (left wrist).")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_named_with_frame_and_joint(value):
    assert "frame 7: expected finite positions, found [" in str(coordinate_problem(with_value(value)))


@pytest.mark.parametrize(("factor", "unit"), [(1000, "millimetres"), (100, "centimetres")])
def test_the_unit_that_the_body_has_is_said(factor, unit):
    assert f"positions are in {unit}. Multiply the joints by {1 / factor:g}" in str(
        coordinate_problem(factor * smooth_motion("a", 12))
    )


def test_whatever_a_room_holds_is_let_through():
    assert coordinate_problem(smooth_motion("a", 12) + np.array([97.0, 0.0, -97.0])) is None
    assert coordinate_problem(with_value(99.9)) is None  # much too fast, which is for the scores to tell


@pytest.mark.parametrize("isolate", [False, True])
def test_a_run_refuses_millimetres_with_method_sequence_and_frame(install, table, tmp_path, isolate):
    body = "joints[:] = batch.initial_joints[:, None] * 1000"
    install("made", adapter_source(body=body))
    asked = request(table, tmp_path / "out", "made", condition=Condition.GOAL_LOCATION, limit=2, isolate=isolate)
    with pytest.raises(AdapterError, match=rf"made'.*synthetic-adt/rec.*, frame 0: expected .* 100 m .*{MILLIMETRES}"):
        run_method(asked)


def motions_of(table, factor: float) -> dict[str, np.ndarray]:
    ids = select(table, split="test", limit=None).sequence_ids
    return {name: factor * fake_sequence(int(name.split("/obj")[1].split("/")[0])).joints for name in ids}


def test_scoring_a_file_refuses_millimetres_and_names_file_sequence_and_frame(table, tmp_path):
    file = write(tmp_path / "mine.parquet", motions_of(table, 1000.0))
    with pytest.raises(PredictionsError, match=rf"mine\.parquet, synthetic-adt/.*, frame 0: .*{MILLIMETRES}"):
        score_predictions(ScoreRequest(predictions=file, data=(table.folder,)))


def spoil_part(folder, change) -> None:
    """Rewrite the first part of a run and forget its scores."""
    part = sorted((folder / "synthetic-adt/predictions").glob("*.parquet"))[0]
    rows = pq.read_table(part)
    joints = [change(np.array(row)).tolist() for row in rows["joints"].to_pylist()]
    column = rows.schema.get_field_index("joints")
    field = rows.schema.field(column)
    spoilt = rows.set_column(column, field, pa.array(joints, field.type))
    pq.write_table(spoilt, part, write_page_checksum=True)
    (folder / "synthetic-adt/scores.parquet").unlink()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda motion: motion[:1], "expected [0-9]+ frames, found 1 .*A run keeps no such motion of a method"),
        (lambda motion: motion * 1e30, "frame 0: expected coordinates within 100 m .*A run keeps no such motion"),
    ],
)
def test_a_kept_motion_that_no_run_would_keep_is_told_with_its_method(table, tmp_path, change, message):
    run_method(request(table, tmp_path / "out"))
    spoil_part(tmp_path / "out", change)
    for again in (
        lambda: run_method(request(table, tmp_path / "out")),
        lambda: score_predictions(ScoreRequest(predictions=tmp_path / "out", data=(table.folder,))),
    ):
        with pytest.raises(PredictionsError, match=rf"^method 'static', sequence .* in .*part-00000.*{message}"):
            again()


def test_a_recording_of_one_frame_is_blamed_on_the_table(tmp_path, monkeypatch):
    monkeypatch.setattr(fakes, "fake_sequence", partial(fakes.fake_sequence, n_frames=1))
    short = fakes.fake_dataset(tmp_path / "table", 8)
    with pytest.raises(TableError, match=r"table, synthetic-adt/.*: expected 2 frames or more, found 1\. Build"):
        run_method(request(short, tmp_path / "out"))
