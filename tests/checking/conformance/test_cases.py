"""What the checks are built from: synthetic people, memory growth, distances, the table to learn from."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.checking.conformance.cases import synthetic_cases
from prbench.checking.conformance.checks.body import growth_per_round
from prbench.checking.conformance.findings import CheckRequest
from prbench.checking.conformance.subject import Subject
from prbench.harness.methods.loading import method_spec
from prbench.harness.methods.training_split import TrainingSplit
from prbench.sequences import SequenceTable

MIB = 2**20


def test_cases_are_sorted_by_length_and_of_two_people(people):
    source = people.source
    assert len(source.n_frames) == 12
    assert (np.diff(source.n_frames) >= 0).all()
    table = SequenceTable.open(people.folder)
    rows = table.scalars(split="test").to_pylist()
    assert len({row["participant_id"] for row in rows if row["sequence_id"] in source.sequence_ids}) == 2


def test_what_a_method_learns_from_is_disjoint_from_what_it_is_asked_about(people):
    table = TrainingSplit.open(people.folder)
    learnt = {name for chunk in table.chunks() for name in chunk.sequence_ids}
    teachers = set(table.scalars()["participant_id"].to_pylist())
    assert len(learnt) >= 12
    assert not learnt & set(people.source.sequence_ids)
    asked = SequenceTable.open(people.folder).scalars(split="test")["participant_id"].to_pylist()
    assert not teachers & set(asked)


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
    quick = Subject(method_spec("glide"), people, tmp_path)
    assert quick.rows == tuple(range(12))
    monkeypatch.setattr("prbench.checking.conformance.subject._BATCH_SECONDS", 1e-6)
    slow = Subject(method_spec("glide"), people, tmp_path)
    assert slow.rows == (0, 6)


def test_lengths_are_those_of_the_protocol_and_of_max_frames(site, cases, tmp_path):
    glide = Subject(method_spec("glide"), cases, tmp_path)
    assert (glide.shortest, glide.protocols_longest, glide.longest) == (41, 241, 241)
    assert Subject(method_spec("limited"), cases, tmp_path).longest == 196


def test_the_table_of_a_check_is_written_once(cases):
    before = {path: path.stat().st_mtime_ns for path in cases.folder.rglob("*")}
    again = synthetic_cases(cases.folder.parent, limit=3)
    assert again.source.sequence_ids == cases.source.sequence_ids
    assert {path: path.stat().st_mtime_ns for path in cases.folder.rglob("*")} == before
