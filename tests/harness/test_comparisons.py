"""Paired comparisons: SciPy as oracle, Holm by hand, power, and when no answer is the answer."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy import stats

from prbench.harness.clusters import power_of, recordings_needed
from prbench.harness.intervals import (
    POINTS,
    PairedValues,
    clustered,
    compare,
    holm,
    paired_p_value,
    smallest_detectable,
)
from tests.harness.test_intervals import names


def test_equal_differences_show_no_spread_and_are_a_sign_test() -> None:
    assert paired_p_value(np.full(12, 0.1), names(*[2] * 6)) == 2 / 64


def test_below_six_recordings_there_is_no_p_value() -> None:
    first, second = np.ones(500), np.zeros(500)
    found = compare({"a": PairedValues(first, second, names(*[100] * 5))})["a"]
    assert found.p_value is None
    assert found.adjusted_p_value is None
    assert found.detectable is None
    assert found.conclusion == "cannot be tested"
    assert found.difference.mean == 1.0


@pytest.mark.parametrize("recordings", [7, 10, 40])
def test_never_smaller_than_the_t_test_of_the_recordings_means(recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    rows = rng.normal(rng.normal(0.3, 1, (recordings, 1)), 1, (recordings, 4))
    oracle = stats.ttest_1samp(rows.mean(axis=1), 0).pvalue
    found = paired_p_value(rows.ravel(), names(*[4] * recordings))
    assert found is not None
    assert found >= oracle


def test_approaches_the_t_test_with_many_alike_recordings() -> None:
    rows = np.tile([-0.9, 1.1], 300) + 0.0
    oracle = stats.ttest_1samp(rows, 0).pvalue
    assert paired_p_value(rows, names(*[1] * 600)) == pytest.approx(oracle, rel=0.03)


def test_one_recording_that_outweighs_the_others_cannot_be_tested() -> None:
    assert paired_p_value(np.random.default_rng(0).normal(1, 1, 107), names(100, *[1] * 7)) is None


def test_a_difference_that_rests_on_one_recording_is_not_supported() -> None:
    rows = np.concatenate([np.full(3, 5.0), np.random.default_rng(0).normal(0.2, 0.2, 57)])
    assert paired_p_value(rows, names(*[3] * 20)) > 0.1


def test_the_smallest_detectable_difference_is_found_as_often_as_said() -> None:
    rng = np.random.default_rng(0)
    ids = names(*[2] * 40)
    found = 0
    for _ in range(300):
        noise = np.repeat(rng.normal(0, 1, 40), 2) + rng.normal(0, 1, 80)
        detectable = smallest_detectable(noise, ids, comparisons=6)
        assert detectable is not None
        found += paired_p_value(noise + detectable, ids) <= 0.05 / 6
    assert 0.7 <= found / 300 <= 0.95


def test_the_detectable_difference_has_the_power_that_it_is_named_for() -> None:
    rows = np.random.default_rng(0).normal(0, 0.3, 60)
    ids = names(*[3] * 20)
    found = smallest_detectable(rows, ids, comparisons=6)
    assert found is not None
    spread = clustered(rows, ids).spread
    assert power_of(spread, found, comparisons=6) == pytest.approx(0.8)
    assert power_of(spread, -found, comparisons=6) == pytest.approx(0.8)
    assert power_of(spread, 0.0, comparisons=6) <= 0.05 / 6
    assert np.isnan(power_of(clustered(rows[:9], ids[:9]).spread, found, comparisons=6))


def test_rates_are_told_with_their_power_and_lengths_are_not() -> None:
    rng = np.random.default_rng(0)
    first, second = (rng.random((2, 60)) < 0.4).astype(float)
    ids = names(*[3] * 20)
    found = compare({"rate": PairedValues(first, second, ids, rate=True), "length": PairedValues(first, second, ids)})
    assert len(found["rate"].power) == len(POINTS)
    assert list(found["rate"].power) == sorted(found["rate"].power)
    assert found["length"].power == ()


@pytest.mark.parametrize("recordings", [6, 11, 47])
def test_the_recordings_needed_are_those_there_are_where_they_find_it(recordings: int) -> None:
    same = partial(recordings_needed, 0.2, recordings=recordings, comparisons=7, power=0.8)
    assert same(0.2) == recordings
    assert same(0.1) > 3 * recordings * (0.8 if recordings > 6 else 0.5)
    assert same(0.05) > same(0.1) > same(0.2) >= same(0.4)


def test_more_comparisons_make_less_detectable() -> None:
    rows = np.random.default_rng(0).normal(0, 1, 60)
    one, six = (smallest_detectable(rows, names(*[3] * 20), comparisons=count) for count in (1, 6))
    assert one is not None
    assert six is not None
    assert six > 1.2 * one
    assert smallest_detectable(np.zeros(60), names(*[3] * 20), comparisons=1) is None


@pytest.mark.parametrize("recordings", [8, 30, 50])
def test_noise_of_a_micrometre_moves_no_p_value(recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    ids = names(*[4] * recordings)
    rows = rng.integers(-1, 2, len(ids)).astype(float) + 0.3  # many patterns are tied
    order = rng.permutation(len(rows))
    noise = rng.uniform(-1e-6, 1e-6, len(rows))
    before = paired_p_value(rows, ids)
    assert paired_p_value(rows + noise, ids) == pytest.approx(before, abs=1e-4)
    assert paired_p_value(rows[order], np.array(ids)[order]) == before


def test_arithmetic_alone_is_no_difference() -> None:
    assert paired_p_value(np.full(20, 1e-12), names(*[2] * 10)) == 1.0


def test_many_sequences_of_few_different_recordings_are_no_evidence() -> None:
    per_recording = np.array([0.5, -0.4, 0.3, -0.2, 0.4, -0.3])
    assert paired_p_value(np.repeat(per_recording, 200), names(*[200] * 6)) > 0.5


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == pytest.approx([0.03, 0.06, None, 0.06])
    assert holm([0.6, 0.7]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []


def test_the_direction_of_a_supported_difference_is_told() -> None:
    better, worse = np.full(16, 0.3), np.linspace(0.1, 0.2, 16)
    ids = names(*[2] * 8)
    found = compare({"up": PairedValues(better, worse, ids), "down": PairedValues(worse, better, ids)})
    assert (found["up"].conclusion, found["down"].conclusion) == ("higher", "lower")
    assert found["up"].adjusted_p_value == pytest.approx(2 * found["up"].p_value)
    assert found["up"].difference.mean == -found["down"].difference.mean


def test_the_number_of_comparisons_can_undo_a_finding() -> None:
    ids = names(*[1] * 6)
    pairs = {str(i): PairedValues(np.ones(6), np.zeros(6), ids) for i in range(2)}
    assert compare({"0": pairs["0"]})["0"].conclusion == "higher"
    assert {found.conclusion for found in compare(pairs).values()} == {"not supported by the data"}


def test_unequal_numbers_of_sequences_are_refused() -> None:
    with pytest.raises(ValueError, match="pr vs mdm: 3 values of the first method, 2 of the second"):
        compare({"pr vs mdm": PairedValues(np.ones(3), np.ones(2), names(3))})
