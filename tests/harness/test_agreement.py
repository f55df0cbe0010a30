"""Agreement with recorded people, rates by the goal's place, and the file of both, which cannot be edited."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from prbench.errors import RunError
from prbench.harness.agreement import goal_places, phi_coefficient, phi_interval, rarest_pair
from prbench.harness.results import RunChecker
from prbench.harness.run import run_method
from prbench.harness.run_folder import RunFolder, read_scores
from prbench.harness.run_folder.summary import DatasetAgreement
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from prbench.metrics import METRICS
from prbench.protocol.manifests import load_protocol
from tests.harness.test_run import request

RATES = [info.id for info in METRICS if info.unit == "rate"]


def outcomes(both: int, only_method: int, only_people: int, neither: int) -> tuple[np.ndarray, np.ndarray]:
    counts = (both, only_method, only_people, neither)
    return np.repeat([1.0, 1.0, 0.0, 0.0], counts), np.repeat([1.0, 0.0, 1.0, 0.0], counts)


def test_phi_by_hand():
    # (6 * 4 - 2 * 3) / sqrt(8 * 7 * 9 * 6) with 6 both, 2 and 3 alone, 4 neither
    assert phi_coefficient(*outcomes(6, 2, 3, 4)) == pytest.approx(18 / np.sqrt(8 * 7 * 9 * 6))


def test_phi_is_that_of_the_two_by_two_table():
    method, people = outcomes(11, 5, 7, 20)
    table = stats.contingency.crosstab(method, people).count
    assert phi_coefficient(method, people) == pytest.approx(stats.contingency.association(table, "cramer"))


def test_equal_opposite_unrelated_and_single_outcomes():
    assert phi_coefficient(*outcomes(5, 0, 0, 7)) == pytest.approx(1.0)
    assert phi_coefficient(*outcomes(0, 5, 7, 0)) == pytest.approx(-1.0)
    assert phi_coefficient(*outcomes(4, 4, 4, 4)) == pytest.approx(0.0)
    assert phi_coefficient(*outcomes(4, 0, 6, 0)) is None
    assert phi_coefficient(*outcomes(4, 6, 0, 0)) is None


def test_the_interval_is_students_of_the_jackknife_on_fishers_scale():
    generator = np.random.default_rng(4)
    people = (generator.random(40) < 0.5).astype(float)
    method = np.where(generator.random(40) < 0.7, people, 1 - people)
    recordings = np.repeat([f"r{i}" for i in range(8)], 5)
    left_out = []
    for name in sorted(set(recordings)):  # the slow way
        kept = [i for i in range(40) if recordings[i] != name]
        left_out.append(np.arctanh(np.corrcoef(method[kept], people[kept])[0, 1]))
    error = np.sqrt(7 / 8 * sum((value - np.mean(left_out)) ** 2 for value in left_out))
    middle = np.arctanh(np.corrcoef(method, people)[0, 1])
    half = stats.t.ppf(0.975, 7) * error
    assert phi_interval(method, people, recordings) == pytest.approx((np.tanh(middle - half), np.tanh(middle + half)))


def test_no_interval_where_a_recording_alone_holds_an_outcome_or_all_agree():
    method, people = outcomes(1, 9, 0, 10)
    recordings = np.array(["a"] * 10 + ["b"] * 10)
    assert phi_interval(method, people, recordings) is None
    assert phi_interval(people, people, recordings) is None


def test_the_rarest_pair_is_the_smallest_expected_count():
    method, people = outcomes(11, 5, 7, 20)
    table = stats.contingency.crosstab(method, people).count
    assert rarest_pair(method, people) == pytest.approx(stats.contingency.expected_freq(table).min())


@pytest.mark.parametrize(("p", "recordings", "each"), [((0.5, 0.6), 8, 4), ((0.9, 0.6), 47, 5), ((0.5, 0.6), 22, 2)])
def test_given_intervals_cover_unrelated_outcomes(p, recordings, each):
    generator = np.random.default_rng(1)
    names = np.repeat([f"r{i}" for i in range(recordings)], each)
    covered = []
    for _ in range(200):
        method, people = ((generator.random(recordings * each) < share).astype(float) for share in p)
        if rarest_pair(method, people) < load_protocol().breakdown.fewest_expected:
            continue
        found = phi_interval(method, people, names)
        if found is not None:
            covered.append(found[0] <= 0.0 <= found[1])
    assert len(covered) > 50
    assert np.mean(covered) > 0.92 - 3 * np.sqrt(0.92 * 0.08 / len(covered))


def test_places_of_goals():
    goals = np.array([[0.0, 1.0, 2.0], [1.0, 0.5, 0.0], [-1.0, 1.5, 0.0], [0.0, 0.2, -3.0], [-1.0, 0.0, -1.0]])
    places = goal_places(goals)
    assert places["bearing"] == pytest.approx([0, 90, 90, 180, 135])
    assert places["distance"] == pytest.approx([2, 1, 1, 3, np.sqrt(2)])
    assert places["height"] == pytest.approx([1.0, 0.5, 1.5, 0.2, 0.0])


def test_a_run_holds_every_rate_and_each_breakdown_covers_every_sequence_once(table, tmp_path):
    run_method(request(table, tmp_path / "out", "scripted"))
    found = DatasetAgreement.read(tmp_path / "out" / "synthetic-adt")
    assert [rate.metric for rate in found.rates] == [
        info.id for info in METRICS if info.id in RATES and not info.compares_with_recorded and "gaze" not in info.id
    ]
    scores = read_scores(tmp_path / "out/synthetic-adt/scores.parquet").to_pylist()
    for metric in {row["metric"] for row in scores} & set(RATES):
        values = [row["value"] for row in scores if row["metric"] == metric]
        for by in ("bearing", "distance", "height"):
            bins = [entry for entry in found.breakdown if (entry.metric, entry.by) == (metric, by)]
            assert [entry.begin for entry in bins] == [0.0, *getattr(load_protocol().breakdown, by)]
            assert sum(entry.sequences for entry in bins) == len(values)
            total = sum(entry.sequences * entry.mean for entry in bins if entry.mean is not None)
            assert total == pytest.approx(sum(values))


def test_recorded_motion_agrees_with_itself_and_a_method_without_success_with_nobody(table, tmp_path):
    run_method(request(table, tmp_path / "recorded", "ground-truth"))
    run_method(request(table, tmp_path / "stare", "stare"))
    own = {rate.metric: rate for rate in DatasetAgreement.read(tmp_path / "recorded" / "synthetic-adt").rates}
    assert own["reach_success"].phi == pytest.approx(1.0)
    assert own["reach_success"].low is None
    staring = {rate.metric: rate for rate in DatasetAgreement.read(tmp_path / "stare" / "synthetic-adt").rates}
    assert staring["prime_success"].phi is None
    assert "the same outcome" in staring["prime_success"].remark


def test_batches_and_samples_leave_no_trace_and_scored_files_say_the_same(table, tmp_path):
    run_method(request(table, tmp_path / "one", "scripted", batch_size=1))
    run_method(request(table, tmp_path / "all", "scripted", samples=3))
    one, three = (DatasetAgreement.read(tmp_path / name / "synthetic-adt") for name in ("one", "all"))
    assert one.rates == three.rates
    scored = ScoreRequest(predictions=tmp_path / "one", data=(table.folder,), out=tmp_path / "again")
    (report,) = score_predictions(scored)
    assert report.agreement == one == DatasetAgreement.read(tmp_path / "again" / "synthetic-adt")


def checked(run, table) -> None:
    opened = RunFolder.open(run)
    RunChecker(lambda _: table).check(opened, opened.record.tables[0])


@pytest.mark.parametrize(
    ("part", "row", "key", "value"),
    [
        ("rates", 0, "people", 0.99),
        ("rates", 1, "phi", 0.5),
        ("breakdown", 3, "mean", 0.123),
        ("breakdown", 0, "sequences", 7),
    ],
)
def test_an_edited_agreement_is_refused_wherever_the_table_is_at_hand(table, tmp_path, part, row, key, value):
    run_method(request(table, tmp_path / "out", "scripted", control="shuffled-goal"))
    checked(tmp_path / "out", table)
    file = tmp_path / "out/synthetic-adt/agreement.json"
    entries = json.loads(file.read_text())
    entries[part][row][key] = value
    file.write_text(json.dumps(entries))
    with pytest.raises(RunError, match=rf"agreement\.json, {part}\[{row}\]\.{key}: expected .* found {value}"):
        checked(tmp_path / "out", table)
    with pytest.raises(RunError, match=r"agreement\.json"):
        run_method(request(table, tmp_path / "out", "scripted", control="shuffled-goal"))
