"""Statistics of a built table: hand-worked values and the published rows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.protocol.published import QUANTITIES, load_table_one
from prbench.sequences import SequenceTable
from prbench.sequences.sequence import event_batch, recording_batch, sequence_batch
from prbench.sequences.table import table_statistics
from prbench.sequences.write import write_dataset
from tests.fakes import fake_dataset, fake_info, fake_sequence


def statistics_of(folder, rows):
    rows = sorted(rows, key=lambda row: row.sequence_id)
    write_dataset(
        folder,
        fake_info(),
        sequences=[sequence_batch(rows)],
        events=[event_batch([])],
        recordings=[recording_batch([])],
    )
    return table_statistics(SequenceTable.open(folder))


def test_the_study_kept_23728_sequences_of_which_the_splits_are_parts() -> None:
    rows = load_table_one()
    assert sum(row.sequences for row in rows.values()) == 23728
    assert all(row.train + row.test == row.sequences for row in rows.values())


def test_means_and_spreads_are_those_of_the_columns(tmp_path) -> None:
    table = fake_dataset(tmp_path / "t", n=20)
    statistics, scalars = table_statistics(table), table.scalars()
    assert statistics.sequences == 20
    assert statistics.by_split == {s: scalars["split"].to_pylist().count(s) for s in ("train", "validation", "test")}
    for name in QUANTITIES:
        assert statistics.spread(name).mean == pytest.approx(float(np.mean(getattr(statistics, name))))
    assert statistics.spread("prime_gap").mean == pytest.approx(np.mean(scalars["prime_gap"].to_pylist()))


def test_people_on_both_sides_of_the_split_are_counted(tmp_path) -> None:
    rows = [
        dataclasses.replace(fake_sequence(index), split=split, participant_id=person)
        for index, (split, person) in enumerate([("train", "a"), ("test", "a"), ("train", "b"), ("validation", "b")])
    ]
    assert statistics_of(tmp_path / "t", rows).participants_in_two_splits == 1


def test_the_goal_is_seen_from_the_pelvis_of_the_first_frame(tmp_path) -> None:
    row = fake_sequence(0)
    pelvis = row.joints[0, 0]
    left_and_up = pelvis + np.array([2.0, np.sqrt(8.0), 2.0])
    statistics = statistics_of(tmp_path / "t", [dataclasses.replace(row, goal_location=left_and_up)])
    assert statistics.goal_distance == pytest.approx([4.0])
    assert statistics.goal_elevation_deg == pytest.approx([45.0])
    assert statistics.goal_azimuth_deg == pytest.approx([45.0])


def test_gaze_on_the_goal_has_no_shift_and_invalid_gaze_does_not_count(tmp_path) -> None:
    row = fake_sequence(0)
    towards = row.goal_location - row.gaze_origin
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    after = np.arange(row.n_frames) / row.fps >= row.preroll
    aside = np.cross(towards, np.array([0.0, 1.0, 0.0]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    direction = np.where(after[:, None], towards, aside)
    valid = np.arange(row.n_frames) >= 4  # at 20 frames a second two frames fall into each tenth of a second
    statistics = statistics_of(tmp_path / "t", [dataclasses.replace(row, gaze_direction=direction, gaze_valid=valid)])
    median = statistics.gaze_shift_deg[:, 1]
    assert median[(statistics.gaze_shift_times >= 0) & np.isfinite(median)] == pytest.approx(0.0, abs=0.1)
    before = median[(statistics.gaze_shift_times < -0.2) & np.isfinite(median)]
    assert before == pytest.approx(90.0, abs=0.1)
    first_bin = int(np.floor((-row.preroll + 2.0) / 0.1 + 1e-6))
    assert np.isnan(median[first_bin])
    assert np.isfinite(median[first_bin + 3])
