"""Paired comparisons: exact small cases, SciPy as oracle, Holm by hand, and when no answer is the answer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from prbench.evaluation import comparisons
from prbench.evaluation.comparisons import PairedValues, compare, holm, sign_flip_p_value
from tests.evaluation.test_intervals import names


def test_six_recordings_that_agree_have_the_smallest_p_value_there_is() -> None:
    assert sign_flip_p_value(np.full(12, 0.1), names(*[2] * 6)) == 2 / 64


def test_below_six_recordings_there_is_no_p_value() -> None:
    first, second = np.ones(500), np.zeros(500)
    found = compare({"a": PairedValues(first, second, names(*[100] * 5))})["a"]
    assert found.p_value is None
    assert found.adjusted_p_value is None
    assert found.conclusion == "not supported by the data"
    assert found.difference.mean == 1.0


@pytest.mark.parametrize("recordings", [7, 10])
def test_agrees_with_scipy_on_recording_totals(recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    rows = rng.normal(0.3, 1, (recordings, 4))
    oracle = stats.permutation_test(
        (rows.sum(axis=1), np.zeros(recordings)),
        lambda a, b: (a - b).sum(),
        permutation_type="samples",
        n_resamples=np.inf,
    )
    assert sign_flip_p_value(rows.ravel(), names(*[4] * recordings)) == pytest.approx(oracle.pvalue)


@pytest.mark.parametrize("recordings", [6, 7, 18])
def test_counted_patterns_are_all_patterns(recordings: int) -> None:
    totals = np.random.default_rng(recordings).normal(0.4, 1, recordings)
    signs = 1 - 2 * (np.arange(2**recordings)[:, None] >> np.arange(recordings) & 1)
    exact = (np.abs(signs @ totals) >= abs(totals.sum()) - 1e-9).mean()
    assert sign_flip_p_value(totals, names(*[1] * recordings)) == pytest.approx(exact, abs=1e-12)


def test_random_patterns_agree_with_all_patterns(monkeypatch: pytest.MonkeyPatch) -> None:
    totals = np.random.default_rng(0).normal(0.4, 1, 18)
    exact = sign_flip_p_value(totals, names(*[1] * 18))
    monkeypatch.setattr(comparisons, "LARGEST_ENUMERATION", 10)
    assert sign_flip_p_value(totals, names(*[1] * 18)) == pytest.approx(exact, abs=0.005)


@pytest.mark.parametrize("recordings", [8, 30, 50])
def test_noise_of_a_micrometre_moves_no_p_value(recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    ids = names(*[4] * recordings)
    rows = rng.integers(-1, 2, len(ids)).astype(float) + 0.3  # many patterns are tied
    order = rng.permutation(len(rows))
    noise = rng.uniform(-1e-6, 1e-6, len(rows))
    before = sign_flip_p_value(rows, ids)
    assert sign_flip_p_value(rows + noise, ids) == pytest.approx(before, abs=1e-4)
    assert sign_flip_p_value(rows[order], np.array(ids)[order]) == before


def test_arithmetic_alone_is_no_difference() -> None:
    assert sign_flip_p_value(np.full(20, 1e-12), names(*[2] * 10)) == 1.0


def test_many_sequences_of_few_different_recordings_are_no_evidence() -> None:
    per_recording = np.array([0.5, -0.4, 0.3, -0.2, 0.4, -0.3])
    assert sign_flip_p_value(np.repeat(per_recording, 200), names(*[200] * 6)) > 0.5


def test_a_difference_by_chance_is_rarely_supported() -> None:
    rng = np.random.default_rng(4)
    found = [
        sign_flip_p_value(np.repeat(rng.normal(0, 1, 12), 5) + rng.normal(0, 1, 60), names(*[5] * 12))
        for _ in range(300)
    ]
    assert np.mean(np.array(found) <= 0.05) <= 0.08


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == pytest.approx([0.03, 0.06, None, 0.06])
    assert holm([0.6, 0.7]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []


def test_the_direction_of_a_supported_difference_is_told() -> None:
    better, worse = np.full(16, 0.3), np.linspace(0.1, 0.2, 16)
    ids = names(*[2] * 8)
    found = compare({"up": PairedValues(better, worse, ids), "down": PairedValues(worse, better, ids)})
    assert (found["up"].conclusion, found["down"].conclusion) == ("higher", "lower")
    assert found["up"].p_value == 2 / 256
    assert found["up"].adjusted_p_value == 4 / 256
    assert found["up"].difference.mean == -found["down"].difference.mean


def test_the_number_of_comparisons_can_undo_a_finding() -> None:
    ids = names(*[1] * 6)
    pairs = {str(i): PairedValues(np.ones(6), np.zeros(6), ids) for i in range(2)}
    assert compare({"0": pairs["0"]})["0"].conclusion == "higher"
    assert {found.conclusion for found in compare(pairs).values()} == {"not supported by the data"}


def test_unequal_numbers_of_sequences_are_refused() -> None:
    with pytest.raises(ValueError, match="pr vs mdm: 3 values of the first method, 2 of the second"):
        compare({"pr vs mdm": PairedValues(np.ones(3), np.ones(2), names(3))})
