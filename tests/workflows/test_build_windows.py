from __future__ import annotations

import pytest

from prbench.engine import InProcess
from prbench.errors import InputFileError, UsageError
from prbench.prediction.batch import Condition
from prbench.prediction.table import WindowsTable
from prbench.workflows.build_windows import build_windows
from tests.corpora.suits import walking_suit, write_arrays

NAME = "20230607_s0_james_johnson_act0_e72nhq"


def build(root, out, **changes):
    """Build windows of everything, and stop at the first error."""
    given = {"joints": None, "recordings": "*", "limit": None, "reader": (), "on_error": "fail", "engine": InProcess()}
    return build_windows("nymeria", root, out, **given | changes)  # type: ignore[arg-type]


@pytest.fixture
def root(tmp_path):
    folder = tmp_path / "nymeria" / NAME / "body"
    folder.mkdir(parents=True)
    write_arrays(folder / "xdata.npz", walking_suit(240 * 4))
    return tmp_path / "nymeria"


def test_a_suit_becomes_windows_on_the_22_joints_without_gaze_where_there_is_none(root, tmp_path):
    report = build(root, tmp_path / "w")
    assert (report.info.joint_set, report.info.has_gaze, report.info.outcomes) == ("smpl22", False, {"window": 3})
    table = WindowsTable.open(tmp_path / "w")
    assert table.runs["participant_id"].to_pylist() == ["james_johnson"]
    batch, truth = next(table.batches(Condition.POSE, table.chosen()))
    # The body glides at 0.8 m/s, and faces where it goes: +Z in the frame of its last pose.
    assert truth.joints[0, 29, 0, 2] == pytest.approx(0.8, abs=1e-3)
    with pytest.raises(UsageError, match="recorded gaze"):
        next(table.batches(Condition.POSE_GAZE, table.chosen()))
    assert batch.fps == 30.0


def test_native_joints_and_names_that_do_not_exist_are_refused(root, tmp_path):
    with pytest.raises(UsageError, match="native"):
        build(root, tmp_path / "w", joints="native")
    with pytest.raises(InputFileError, match="matches 'x'"):
        build(root, tmp_path / "w", recordings="x")
