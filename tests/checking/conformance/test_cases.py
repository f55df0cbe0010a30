"""What the checks are built from: synthetic people, memory growth, distances, the table to learn from."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.checking.conformance.cases import cases_of, kept_synthetic_cases, synthetic_sequences, write_training_table
from prbench.checking.conformance.checks.body import growth_per_round
from prbench.checking.conformance.findings import CheckRequest
from prbench.checking.conformance.subject import Subject
from prbench.geometry.skeleton import WRISTS, Joint, facing_yaw
from prbench.harness.methods.loading import method_spec
from prbench.harness.methods.training_split import TrainingSplit

MIB = 2**20


def test_synthetic_sequences_are_canonical_and_reach_their_goals(people):
    assert len({row.participant_id for row in people}) > 1
    for row in people:
        assert row.joints.shape == (row.n_frames, 22, 3)
        assert 41 <= row.n_frames <= 241
        assert row.joints[0, Joint.PELVIS, [0, 2]] == pytest.approx([0, 0], abs=1e-6)
        assert facing_yaw(row.joints[0].astype(float)) == pytest.approx(0, abs=1e-5)
        assert row.joints[..., 1].min() == pytest.approx(0, abs=1e-6)
        hand = WRISTS[row.hand == "right"]
        assert np.linalg.norm(row.joints[-1, hand] - row.goal_location) < 0.35
        step = np.linalg.norm(row.joints[0] - row.previous_joints, axis=1)
        assert step.max() < 0.3  # one frame of a walk
        assert np.linalg.norm(row.gaze_direction, axis=1) == pytest.approx(1)


def test_gaze_is_in_the_canonical_frame(people):
    row = people[0]
    at = round(row.preroll * row.fps) + 1
    to_goal = row.goal_location - row.gaze_origin[at]
    assert to_goal @ row.gaze_direction[at] / np.linalg.norm(to_goal) > 0.97


def test_the_synthetic_sequences_are_the_same_every_time(people):
    again = synthetic_sequences("test", 6)  # the first recording
    first = {row.sequence_id: row for row in people}
    assert all(np.array_equal(row.joints, first[row.sequence_id].joints) for row in again)


def test_cases_are_sorted_by_length_with_all_their_values(people):
    source = cases_of(people).source
    assert (np.diff(source.n_frames) >= 0).all()
    rows = {row.sequence_id: row for row in people}
    for place, name in enumerate(source.sequence_ids):
        assert source.n_frames[place] == rows[name].n_frames
        assert np.array_equal(source.goal_joints[place], rows[name].joints[-1])


def test_what_a_method_learns_from_is_disjoint_from_what_it_is_asked_about(people, tmp_path):
    table = TrainingSplit.open(write_training_table(tmp_path / "table"))
    learnt = {name for chunk in table.chunks() for name in chunk.sequence_ids}
    teachers = set(table.scalars()["participant_id"].to_pylist())
    assert len(learnt) == 12
    assert not learnt & {row.sequence_id for row in people}
    assert not teachers & {row.participant_id for row in people}


def test_steady_growth_is_measured_and_noise_is_not():
    rounds = np.arange(12)
    assert growth_per_round(200.0 * MIB + 2 * MIB * rounds) == pytest.approx(2 * MIB)
    noise = np.random.default_rng(0).normal(size=12) * 3 * MIB
    assert growth_per_round(200.0 * MIB + noise) == 0
    assert growth_per_round(200.0 * MIB + np.where(rounds < 1, 0, 8 * MIB)) == 0  # settles late
    assert growth_per_round(200.0 * MIB + 0.1 * MIB * rounds) == 0  # too little to tell


def test_a_request_survives_the_way_into_another_process(tmp_path):
    request = CheckRequest("cmd:python glide.py", options={"a": "b"}, data=tmp_path, threads=2, time_limit=3.0)
    assert CheckRequest.of_json(request.as_json()) == request


def test_a_slow_method_is_asked_about_few_and_short_sequences(site, people, tmp_path, monkeypatch):
    quick = Subject(method_spec("glide"), cases_of(people), tmp_path)
    assert quick.rows == tuple(range(12))
    monkeypatch.setattr("prbench.checking.conformance.subject._BATCH_SECONDS", 1e-6)
    slow = Subject(method_spec("glide"), cases_of(people), tmp_path)
    assert slow.rows == (0, 6)


def test_lengths_are_those_of_the_protocol_and_of_max_frames(site, cases, tmp_path):
    glide = Subject(method_spec("glide"), cases, tmp_path)
    assert (glide.shortest, glide.protocols_longest, glide.longest) == (41, 241, 241)
    assert Subject(method_spec("limited"), cases, tmp_path).longest == 196


def test_a_later_process_of_a_check_reads_the_cases_of_the_first_to_the_last_bit(tmp_path):
    made = kept_synthetic_cases(tmp_path).source
    read = kept_synthetic_cases(tmp_path).source
    for name, value in vars(made).items():
        again = getattr(read, name)
        assert type(again) is type(value), name
        if isinstance(value, np.ndarray):
            assert (again.dtype, again.tobytes()) == (value.dtype, value.tobytes()), name
        else:
            assert again == value, name


def test_a_training_table_is_written_once(tmp_path):
    folder = write_training_table(tmp_path / "table")
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert write_training_table(folder) == folder
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
