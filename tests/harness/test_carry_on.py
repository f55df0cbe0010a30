"""Puts start where generated picks end: pairs, frames, seams, and rows that stand for themselves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pyarrow as pa
import pytest
from scipy.spatial.transform import Rotation

from prbench.contract import Condition
from prbench.errors import TableError, UsageError
from prbench.geometry.skeleton import Joint, transform_points
from prbench.harness.carry_on import Carrying
from prbench.harness.conditions import ConditionSource
from prbench.harness.pairs import find_pairs
from prbench.harness.planning import select
from prbench.harness.run import run_method
from prbench.harness.run_folder.carry_on import read_carried_on
from prbench.harness.run_folder.predictions import Predictions
from prbench.sequences import SequenceTable
from prbench.sequences.sequence import Recording, recording_batch, sequence_batch
from prbench.sequences.write import write_dataset
from tests.fakes import fake_info, fake_sequence
from tests.harness.test_run import reproducible_bytes, request

KEEPS_GOING = """
    import numpy as np
    from prbench.contract import Condition, Motions

    class Going:
        name = "going"
        conditions = frozenset({Condition.GOAL_LOCATION, Condition.TEXT})

        def generate(self, batch, *, seed):
            step = batch.initial_joints - batch.previous_joints
            step = step + np.float32([0.0, 0.0, 0.01]) * (np.abs(step).max(axis=(1, 2)) == 0)[:, None, None]
            frame = np.arange(int(batch.n_frames.max()), dtype=np.float32)
            return Motions(batch.initial_joints[:, None] + frame[:, None, None] * step[:, None], batch.n_frames)

    def load(weights, *, options, device):
        return Going()
"""
"""Goes on with the velocity that it is given, or with 0.2 m/s from a copied frame."""
LOOKS_ALONG_THE_HEAD = KEEPS_GOING.replace("import Condition, Motions", "import Condition, Gaze, Motions").replace(
    "return Motions(batch.initial_joints[:, None] + frame[:, None, None] * step[:, None], batch.n_frames)",
    """joints = batch.initial_joints[:, None] + frame[:, None, None] * step[:, None]
            up = joints[:, :, 15] - joints[:, :, 12]
            along = up / np.linalg.norm(up, axis=-1, keepdims=True)
            return Motions(joints, batch.n_frames, None, Gaze(joints[:, :, 15], along))

        gaze = True""",
)
"""The same with gaze along neck and head."""


def rows_of(*events: tuple[str, str, str, float, float]) -> pa.Table:
    """Sequences by recording, object, action, event time and start time."""
    columns = ("recording_id", "object_id", "action", "event_time", "start_time")
    values = dict(zip(columns, map(list, zip(*events, strict=True)), strict=True))
    return pa.table({"sequence_id": [str(number) for number in range(len(events))], **values})


def test_a_pair_is_a_pick_whose_object_is_put_next_and_soon() -> None:
    found = find_pairs(
        rows_of(
            ("r1", "cup", "pick", 10.0, 4.0),
            ("r1", "cup", "put", 14.0, 9.0),
            ("r1", "jug", "pick", 20.0, 15.0),
            ("r1", "jug", "put", 30.0, 22.5),
            ("r1", "bowl", "put", 40.0, 36.0),
            ("r1", "bowl", "pick", 50.0, 44.0),
            ("r2", "bowl", "put", 52.0, 51.0),
        )
    )
    assert [(pair.pick, pair.put, pair.gap) for pair in found] == [("0", "1", -1.0)], "2.5 s, put first, elsewhere"


@pytest.fixture(scope="module")
def pairs(tmp_path_factory) -> SequenceTable:
    """Three pairs in the test split, whose puts stand turned and apart in the world."""
    rows = []
    for number in range(3):
        recording = f"rec{4 * number + 1:03d}"
        turned = np.eye(4)
        turned[:3, :3] = Rotation.from_euler("y", 40 + 50 * number, degrees=True).as_matrix()
        turned[:3, 3] = (1.5, 0.01, -0.5)
        pick, put = fake_sequence(4 * number + 1, n_frames=60), fake_sequence(4 * number + 2, n_frames=70)
        same = {"recording_id": recording, "split_group": recording, "split": "test", "object_id": "77"}
        rows.append(dataclasses.replace(pick, sequence_id=f"d/{recording}/77/pick/1/f", action="pick", **same))
        start = pick.event_time + 0.5
        times = {"start_time": start, "prime_time": start + 2.0, "event_time": start + 69 / 20}
        rows.append(
            dataclasses.replace(
                put, sequence_id=f"d/{recording}/77/put/2/f", action="put", world_from_canonical=turned, **same, **times
            )
        )
    folder = tmp_path_factory.mktemp("pairs") / "table"
    names = [row.recording_id for row in rows[::2]]
    records = [Recording(name, "P0", "test", name, 60.0, {}, "read", "") for name in names]
    write_dataset(
        folder, fake_info(), sequences=[sequence_batch(rows)], events=[], recordings=[recording_batch(records)]
    )
    return SequenceTable.open(folder)


def carried(table, out, **changes):
    changes = {"condition": Condition.GOAL_LOCATION, "carry_on": True, **changes}
    return run_method(request(table, out, "going", **changes))


def in_world(table, report, sample=0) -> list[tuple[np.ndarray, np.ndarray]]:
    """The two motions of every pair, in the world."""
    carrying = Carrying.of(select(table, split="test", limit=None, carry_on=True))
    predictions = Predictions.open(report.folder.dataset("synthetic-adt").predictions)
    found = []
    for number, pair in enumerate(carrying.pairs):
        places = carrying.world_from_canonical[[carrying.picks[number], carrying.puts[number]]]
        motions = [predictions.motions([name], sample).values.astype(float) for name in (pair.pick, pair.put)]
        found.append(tuple(transform_points(place, motion) for place, motion in zip(places, motions, strict=True)))
    return found


def test_pick_and_put_are_one_motion_in_the_world(pairs, tmp_path, install):
    install("going", KEEPS_GOING)
    report = carried(pairs, tmp_path / "out", samples=2)
    for sample in (0, 1):
        for pick, put in in_world(pairs, report, sample):
            assert put[0] == pytest.approx(pick[-1], abs=1e-5)
            steps = np.diff(np.concatenate([pick, put[1:]]), axis=0)
            assert np.abs(steps - steps[0]).max() < 1e-4, "a body that keeps its velocity keeps it over the seam"
    assert report.summaries[0].run_marks[0].startswith("∥ each put starts where the generated pick")
    assert not report.folder.record.is_usual


def test_the_seam_and_both_halves_are_told(pairs, tmp_path, install):
    install("going", KEEPS_GOING)
    report = carried(pairs, tmp_path / "out")
    found = read_carried_on(report.folder.dataset("synthetic-adt").path)
    assert (found.pairs, found.share_of_picks, found.overlapping) == (3, 1.0, 0.0)
    assert found.median_gap == pytest.approx(0.5)
    assert found.largest_step < 1e-5
    assert found.speed_change < 1e-2
    assert {"prime_success", "reach_success", "mpjpe"} <= found.picks.keys() & found.puts.keys()
    whole = report.summaries[0].metric("mpjpe")
    assert whole is not None
    assert whole.mean == pytest.approx((found.picks["mpjpe"] + found.puts["mpjpe"]) / 2)


def test_gaze_of_a_put_is_brought_back_with_its_motion_and_such_rows_carry_both_signs(pairs, tmp_path, install):
    install("going", LOOKS_ALONG_THE_HEAD)
    report = carried(pairs, tmp_path / "out")
    predictions = Predictions.open(report.folder.dataset("synthetic-adt").predictions)
    rows = predictions.motions(predictions.ids, 0)
    assert rows.gaze is not None
    neck, head = rows.values[:, Joint.NECK], rows.values[:, Joint.HEAD]
    assert rows.gaze[:, 0] == pytest.approx(head, abs=1e-5)
    assert rows.gaze[:, 1] == pytest.approx((head - neck) / np.linalg.norm(head - neck, axis=1)[:, None], abs=1e-5)
    assert report.summaries[0].symbols == "¶ ∥"


def test_an_interrupted_run_goes_on_to_the_same_bytes(pairs, tmp_path, install):
    install("going", KEEPS_GOING)
    whole = carried(pairs, tmp_path / "whole", batch_size=2)
    carried(pairs, tmp_path / "cut", batch_size=2)
    for part in (0, 3):  # a batch of picks and one of puts
        (tmp_path / f"cut/predictions/part-{part:05d}.parquet").unlink()
    again = carried(pairs, tmp_path / "cut", batch_size=2)
    assert (whole.batches_made, again.batches_made) == (4, 2)
    assert reproducible_bytes(tmp_path / "whole") == reproducible_bytes(tmp_path / "cut")


def test_a_limit_takes_whole_pairs(pairs):
    assert len(select(pairs, split="test", limit=2, carry_on=True)) == 2
    assert len(select(pairs, split="test", limit=5, carry_on=True)) == 4


def test_the_put_keeps_its_goal_in_the_world_and_gets_the_frame_of_its_new_first_pose(pairs, tmp_path, install):
    install("going", KEEPS_GOING)
    report = carried(pairs, tmp_path / "out")
    selection = select(pairs, split="test", limit=None, carry_on=True)
    carrying = Carrying.of(selection)
    plain = ConditionSource.read(selection)
    predictions = Predictions.open(report.folder.dataset("synthetic-adt").predictions)
    source, placements = carrying.source(plain, predictions, 0)
    for put in carrying.puts:
        assert transform_points(placements[put], source.goal_location[put]) == pytest.approx(plain.goal_location[put])
        assert source.initial_joints[put, Joint.PELVIS, [0, 2]] == pytest.approx([0.0, 0.0], abs=1e-5)
    for pick in carrying.picks:
        assert np.array_equal(source.initial_joints[pick], plain.initial_joints[pick])


def test_what_cannot_be_carried_on_is_refused(pairs, table, tmp_path, install):
    install("going", KEEPS_GOING)
    with pytest.raises(TableError, match=r"--carry-on: expected picks .* found none among the 15 sequences"):
        carried(table, tmp_path / "out")
    with pytest.raises(UsageError, match="gives a method no first pose"):
        carried(pairs, tmp_path / "out", condition=Condition.TEXT)
    with pytest.raises(UsageError, match="controls make no motion"):
        request(pairs, tmp_path / "out", "stare", carry_on=True)
