"""What the release leaves open is inferred right, and how surely is said; where nothing tells, nothing is guessed."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import InputFileError, TableError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.sequences import SequenceTable
from tests.release.imports import imported, motions, table_values, value
from tests.release.releases import Style, in_world, plain_entry, rows

ROWS = rows(6)


@pytest.mark.parametrize("factor", [7, 100, 1000])
def test_sizes_of_nobody_in_metres_are_refused(factor, tmp_path) -> None:
    with pytest.raises(InputFileError, match=r"pelvis to head of 0\.35 to 0\.85 m"):
        imported(tmp_path, motion=lambda row: row.joints * factor)


@pytest.mark.parametrize(("unit", "certainty"), [("m", "certain"), ("cm", None), ("furlongs", "likely")])
def test_a_stated_unit_is_checked(unit, certainty, tmp_path) -> None:
    def stated(row, style):
        return plain_entry(row, style) | {"units": unit}

    if certainty is None:
        with pytest.raises(InputFileError, match="stated as 'cm'"):
            imported(tmp_path, entry=stated)
    else:
        assert value(imported(tmp_path, entry=stated), "units") == ("metres", certainty)


def test_canonical_motions_are_not_touched(tmp_path) -> None:
    report = imported(tmp_path)
    assert value(report, "motion_frame") == ("canonical", "certain")
    for motion, row in zip(motions(tmp_path), ROWS):
        np.testing.assert_array_equal(motion, row.joints)
    for transform in table_values(tmp_path, "world_from_canonical"):
        np.testing.assert_array_equal(transform.reshape(4, 4), np.eye(4))


def test_world_motions_are_canonicalised_and_goal_and_gaze_with_them(tmp_path) -> None:
    report = imported(tmp_path, [in_world(row) for row in ROWS])
    assert value(report, "motion_frame") == ("world (canonicalised here)", "certain")
    assert value(report, "goal_frame") == ("as the motions", "likely")
    for motion, row in zip(motions(tmp_path), ROWS):
        np.testing.assert_allclose(motion, row.joints, atol=1e-5)
    for goal, row in zip(table_values(tmp_path, "goal_location"), ROWS):
        np.testing.assert_allclose(goal, row.goal_location, atol=1e-5)
    for transform, row in zip(table_values(tmp_path, "world_from_canonical"), ROWS):
        np.testing.assert_allclose(transform.reshape(4, 4), row.world_from_canonical, atol=1e-5)
    chunk = next(SequenceTable.open(tmp_path / "table").chunks())
    np.testing.assert_allclose(
        chunk.frames("gaze_direction")[ROWS[0].gaze_valid.nonzero()[0]],
        ROWS[0].gaze_direction[ROWS[0].gaze_valid],
        atol=1e-5,
    )


def test_goals_that_fit_nowhere_are_imported_but_never_scored(tmp_path) -> None:
    report = imported(tmp_path, style=Style(goal=lambda goal: [axis + 20 for axis in goal]))
    assert value(report, "goal_frame") == ("unknown", "unknown")
    with pytest.raises(TableError, match=r"cannot be scored: .*goals are in an unknown frame"):
        run_method(RunRequest(method="ground-truth", data=(tmp_path / "table",), out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_without_a_frame_before_the_motion_is_continued_backwards(tmp_path) -> None:
    imported(tmp_path)
    chunk = next(SequenceTable.open(tmp_path / "table").chunks())
    joints = chunk.joints[: ROWS[0].n_frames]
    np.testing.assert_allclose(chunk.poses("previous_joints")[0], 2 * joints[0] - joints[1], atol=1e-6)
    assert set(chunk.strings("previous_source")) == {"extrapolated"}


def test_sequences_of_unknown_recordings_are_not_taken_for_independent(tmp_path) -> None:
    imported(tmp_path)
    table = SequenceTable.open(tmp_path / "table")
    assert set(table.recordings()["recording_id"].to_pylist()) == {"unknown-train", "unknown-test"}
    report = run_method(RunRequest(method="ground-truth", data=(table.folder,), out=tmp_path / "run"))
    assert report.summaries[0].recordings == 1


def test_source_recordings_are_taken_where_they_are_told(tmp_path) -> None:
    imported(tmp_path, entry=lambda row, style: plain_entry(row, style) | {"video": row.recording_id})
    names = SequenceTable.open(tmp_path / "table").scalars()["recording_id"].to_pylist()
    assert names == [row.recording_id for row in ROWS]
