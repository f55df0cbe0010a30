"""Solid boxes around the sequences of a table, and the penetration that runs report beside recorded people's."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.cli.summaries import print_scene
from prbench.contract import Condition
from prbench.errors import UsageError
from prbench.geometry.skeleton import Joint
from prbench.harness.conditions import SCENE_COLUMNS, SolidBoxes
from prbench.harness.run import run_method
from prbench.harness.run_folder import read_scores
from prbench.harness.run_folder.agreement import DatasetAgreement
from prbench.harness.run_folder.predictions import Predictions
from tests.fakes import fake_box, fake_dataset
from tests.harness.test_run import request

BOXES = (fake_box("rec001"), fake_box("rec005", entered=0.3), fake_box("rec009", entered=None))


@pytest.fixture(scope="module")
def table_of_boxes(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("boxes") / "table", 24, boxes=BOXES)


def test_a_box_that_the_person_entered_is_not_solid(table_of_boxes):
    scene = SolidBoxes.of(table_of_boxes)
    assert scene is not None
    for chunk in table_of_boxes.chunks(columns=SCENE_COLUMNS):
        counts = dict(zip(chunk.strings("recording_id"), np.diff(scene.around(chunk).offsets), strict=True))
        assert {name for name, count in counts.items() if count} == {"rec001", "rec009"}


def test_tables_without_boxes_have_no_scene(table):
    assert SolidBoxes.of(table) is None


def test_a_run_says_how_deep_motions_come_into_boxes_and_recorded_people_do(table_of_boxes, tmp_path, capsys):
    report = run_method(request(table_of_boxes, tmp_path / "out", "static"))
    part = report.folder.dataset("synthetic-adt")
    rows = [row for row in read_scores(part.scores).to_pylist() if row["metric"] == "scene_penetration"]
    assert {row["value"] for row in rows} == {0.0, 1.0}, "a body that stands in a box, and one without boxes"
    assert {row["flag"] for row in rows} == {"no_boxes", None}
    people = DatasetAgreement.read(part.path).scene
    assert people is not None
    assert (people.boxes, people.solid) == (3, 2)
    assert 0 < people.penetration < 1
    print_scene(report.summaries, [DatasetAgreement.read(part.path)])
    assert "2 of 3 boxes" in capsys.readouterr().out


def test_a_run_on_a_table_without_boxes_says_nothing_of_them(table, tmp_path, capsys):
    report = run_method(request(table, tmp_path / "out", "static"))
    agreement = DatasetAgreement.read(report.folder.dataset("synthetic-adt").path)
    assert agreement.scene is None
    assert report.summaries[0].metric("scene_penetration") is None
    print_scene(report.summaries, [agreement])
    assert capsys.readouterr().out == ""


ASKS = """
    import numpy as np
    from prbench.contract import Condition, Motions

    class Careful:
        name = "careful"
        conditions = frozenset({Condition.GOAL_LOCATION})
        wants_obstacles = True

        def generate(self, batch, *, seed):
            seen = np.diff(batch.obstacles.offsets).astype(np.float32)
            batch.obstacles.centre[:] = 7.0  # what a method does to its copy stays its own
            joints = np.repeat(batch.initial_joints[:, None], int(batch.n_frames.max()), axis=1)
            joints[:, 1:, 15, 0] += seen[:, None]
            return Motions(joints, batch.n_frames)

    def load(weights, *, options, device):
        return Careful()
"""


def test_a_method_that_asks_is_given_the_boxes_and_its_rows_are_marked_and_unranked(table_of_boxes, tmp_path, install):
    install("careful", ASKS)
    asked = request(table_of_boxes, tmp_path / "out", "careful", condition=Condition.GOAL_LOCATION, samples=2)
    report = run_method(asked)
    assert report.folder.record.method.wants_obstacles
    assert not report.folder.record.is_usual
    assert report.summaries[0].run_marks[0].startswith("◊ was given the scene's boxes")
    predictions = Predictions.open(report.folder.dataset("synthetic-adt").predictions)
    names = [name for chunk in table_of_boxes.chunks(split="test", columns=[]) for name in chunk.sequence_ids]
    for sample in (0, 1):
        rows = predictions.motions(names, sample)
        first = rows.values[rows.offsets[:-1], Joint.HEAD, 0]
        second = rows.values[rows.offsets[:-1] + 1, Joint.HEAD, 0]
        in_box = [float("rec005" not in name) for name in names]
        assert (second - first).tolist() == pytest.approx(in_box)


def test_a_table_without_boxes_refuses_a_method_that_asks_for_them(table, tmp_path, install):
    install("careful", ASKS)
    with pytest.raises(UsageError, match=r"expected the boxes of the scene \(scenes\.parquet\)"):
        run_method(request(table, tmp_path / "out", "careful", condition=Condition.GOAL_LOCATION))
