"""Intervals: hand-worked cases, SciPy as oracle, coverage by simulation, and what must never be claimed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from prbench.evaluation.intervals import clustered, effective_sample_size, mean_interval, metric_interval, rate_interval
from prbench.metrics import METRICS


def names(*sizes: int) -> list[str]:
    """Recording of each sequence: sizes[0] times r0, sizes[1] times r1, …"""
    return [f"r{i:03d}" for i, size in enumerate(sizes) for _ in range(size)]


def values(*rows: float) -> np.ndarray:
    return np.array(rows, dtype=float)


@pytest.mark.parametrize("count", [2, 3, 10, 22, 60])
@pytest.mark.parametrize("rate", [0.0, 1.0])
def test_a_rate_of_0_or_100_percent_never_claims_certainty(rate: float, count: int) -> None:
    found = rate_interval(np.full(5 * count, rate), names(*[5] * count))
    exact = stats.binomtest(int(rate * count), count).proportion_ci(method="exact")
    assert (found.low, found.high) == pytest.approx((exact.low, exact.high))  # one trial a recording, not a sequence
    assert found.method == "clopper-pearson-recordings"
    assert "all_equal" in found.marks


@pytest.mark.parametrize(("successes", "n"), [(1, 22), (11, 22), (3, 60), (59, 60)])
def test_one_sequence_a_recording_gives_the_plain_wilson_interval(successes: int, n: int) -> None:
    found = rate_interval(values(*[1] * successes, *[0] * (n - successes)), names(*[1] * n))
    wilson = stats.binomtest(successes, n).proportion_ci(method="wilson")
    assert (found.low, found.high) == pytest.approx((wilson.low, wilson.high))
    assert found.marks == ()


def test_two_unanimous_recordings_count_for_two_trials() -> None:
    found = rate_interval(values(1, 1, 0, 0), names(2, 2))
    assert (found.low, found.high) == pytest.approx((0.0945, 0.9055), abs=1e-4)
    assert found.marks == ("few_recordings",)


def test_design_effect_worked_by_hand() -> None:
    # Totals 1, 1, 2 of 2 sequences each: rate 4/6; without one recording 3/4, 3/4, 2/4;
    # jackknife variance 2/3 * (1/144 + 1/144 + 1/36) = 1/36; independent: (2/9) / 5 = 2/45; effect below 1, so 1.
    data = clustered(values(1, 0, 0, 1, 1, 1), names(2, 2, 2))
    few = (stats.t.ppf(0.975, 5) / stats.t.ppf(0.975, 2)) ** 2
    assert effective_sample_size(data) == pytest.approx(max(6 * few, 3))
    # Ten totals of 7 and ten of 3, of 10 sequences each: variance 20/19 * 20 * 2^2 / 200^2 against (1/4) / 199.
    rows = np.repeat([1.0, 0.0] * 20, [7, 3] * 10 + [3, 7] * 10)
    few = (stats.t.ppf(0.975, 199) / stats.t.ppf(0.975, 19)) ** 2
    assert effective_sample_size(clustered(rows, names(*[10] * 20))) == pytest.approx(200 / 1.675789 * few, rel=1e-5)
    # Totals 3, 0 of 3: rate 1/2 and 1/4 against (1/4) / 5: effect 5. Never below the two recordings that there are.
    assert effective_sample_size(clustered(values(1, 1, 1, 0, 0, 0), names(3, 3))) == pytest.approx(2)


def test_correlation_within_recordings_widens_a_rate() -> None:
    alternating, unanimous = values(*[0, 1] * 100), values(*[0] * 100, *[1] * 100)
    spread, alone = (rate_interval(v, names(*[10] * 20)) for v in (alternating, unanimous))
    assert spread.mean == alone.mean == 0.5
    assert alone.high - alone.low > 2.5 * (spread.high - spread.low)


def test_one_recording_is_worth_one_trial_and_gives_no_mean() -> None:
    rate = rate_interval(values(*[1] * 40, *[0] * 60), names(100))
    assert rate.low < 0.1 < 0.85 < rate.high
    metres = mean_interval(values(0.1, 0.2, 0.3), names(3))
    assert (metres.low, metres.high, metres.method) == (None, None, "none")
    assert rate.marks == metres.marks == ("one_recording", "few_recordings")


def test_few_recordings_of_one_size_give_the_t_interval_of_their_means() -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(rng.normal(1, 0.3, (4, 1)), 0.1, (4, 7))
    found = mean_interval(rows.ravel(), names(7, 7, 7, 7))
    means = rows.mean(axis=1)
    expected = stats.t.interval(0.95, 3, means.mean(), stats.sem(means))
    assert (found.low, found.high) == pytest.approx(expected)
    assert (found.method, found.marks) == ("t-jackknife", ("few_recordings",))


def test_the_interval_is_centred_on_the_printed_mean_over_sequences() -> None:
    found = mean_interval(values(1, 1, 1, 3), names(3, 1))
    assert found.mean == 1.5  # not 2, the mean of the two recording means
    reach = stats.t.ppf(0.975, 1) * np.sqrt(0.5 * (1.5**2 + 0.5**2))
    assert (found.low, found.high) == pytest.approx((1.5 - reach, 1.5 + reach))
    cut = mean_interval(values(1, 1, 1, 3), names(3, 1), nonnegative=True)
    assert (cut.low, cut.high) == (0.0, found.high)


def test_bootstrap_agrees_with_scipy_on_recording_means() -> None:
    rng = np.random.default_rng(1)
    rows = rng.gamma(2.0, 0.2, (25, 1)) + rng.gamma(2.0, 0.1, (25, 4))
    found = mean_interval(rows.ravel(), names(*[4] * 25))
    tail = stats.norm.cdf(-stats.t.ppf(0.975, 24) * np.sqrt(25 / 24))
    oracle = stats.bootstrap(
        (rows.mean(axis=1),), np.mean, confidence_level=1 - 2 * tail, method="percentile", n_resamples=20_000, rng=rng
    ).confidence_interval
    width = oracle.high - oracle.low
    assert found.method == "bootstrap"
    assert found.low == pytest.approx(oracle.low, abs=0.06 * width)
    assert found.high == pytest.approx(oracle.high, abs=0.06 * width)


@pytest.mark.parametrize("interval", [rate_interval, mean_interval])
@pytest.mark.parametrize("recordings", [4, 15])
def test_the_order_of_the_rows_does_not_change_a_bit(interval, recordings: int) -> None:
    rng = np.random.default_rng(2)
    ids = np.array(names(*rng.integers(1, 9, recordings)))
    rows = rng.random(len(ids))
    expected = interval(rows, ids)
    for _ in range(3):
        order = rng.permutation(len(ids))
        assert interval(rows[order], ids[order]) == expected


def test_samples_count_once_a_sequence() -> None:
    rows, recordings, sequences = values(0.0, 0.4, 1.0), ["r0"] * 3, ["a", "a", "b"]
    found = mean_interval(rows, recordings, sequences)
    assert (found.mean, found.n_sequences, found.n_recordings) == (0.6, 2, 1)


def test_samples_are_drawn_inside_sequences_and_recordings_outside() -> None:
    rng = np.random.default_rng(3)
    n_recordings, n_sequences, n_samples = 30, 4, 3
    sequences = np.repeat([f"s{i:03d}" for i in range(n_recordings * n_sequences)], n_samples)
    recordings = np.repeat(names(*[n_sequences] * n_recordings), n_samples)
    between = np.repeat(rng.normal(0, 1, n_recordings), n_sequences * n_samples)
    noise = rng.normal(0, 6, len(sequences))

    def width(rows: np.ndarray) -> float:
        found = mean_interval(rows, recordings, sequences)
        return found.high - found.low

    def expected_width(rows: np.ndarray) -> float:
        by_sample = rows.reshape(n_recordings, n_sequences, n_samples)
        inside = by_sample.var(axis=2).mean() / (n_samples * n_sequences)  # of a recording's mean, its sequences fixed
        variance = (by_sample.mean(axis=(1, 2)).var() + inside) / n_recordings
        return 2 * stats.t.ppf(0.975, 29) * np.sqrt(30 / 29) * np.sqrt(variance)

    found = mean_interval(between + noise, recordings, sequences)
    assert (found.low + found.high) / 2 == pytest.approx(found.mean, abs=0.1 * (found.high - found.low))
    assert width(between) == pytest.approx(expected_width(between), rel=0.08)
    assert width(between + noise) == pytest.approx(expected_width(between + noise), rel=0.08)


def test_equal_values_are_marked() -> None:
    found = mean_interval(np.zeros(24), names(*[2] * 12))
    assert (found.mean, found.low, found.high) == (0.0, 0.0, 0.0)
    assert found.marks == ("all_equal",)


def test_what_only_arithmetic_tells_apart_is_equal() -> None:
    noise = np.random.default_rng(0).uniform(-1e-6, 1e-6, 24)
    assert mean_interval(1.0 + noise, names(*[2] * 12)).marks == ("all_equal",)
    found = rate_interval(np.abs(noise), names(*[2] * 12))
    assert found.method == "clopper-pearson-recordings"


def test_a_metric_brings_the_interval_of_its_unit() -> None:
    methods = {info.id: metric_interval(info, values(*[0.0, 1.0] * 12), names(*[2] * 12)).method for info in METRICS}
    assert methods["prime_success"] == methods["location_error"] == "wilson-cluster"
    assert methods["mpjpe"] == methods["foot_skating"] == "bootstrap"


REALISTIC = {
    "metres": lambda rng, n: rng.gamma(2, 0.2, n),
    "far": lambda rng, n: rng.gamma(40, 0.15, n),
    "mostly 0": lambda rng, n: (rng.random(n) < 0.3) * rng.gamma(2, 0.1, n),
    "one outlier": lambda rng, n: 0.1 + 3.0 * (np.arange(n) == 0),
    "steps": lambda rng, n: rng.integers(0, 3, n) / 2,
}


@pytest.mark.parametrize("kind", REALISTIC)
@pytest.mark.parametrize("recordings", [5, 11, 40])
def test_noise_of_a_micrometre_moves_no_bound_by_more_than_ten(kind: str, recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    ids = names(*rng.integers(1, 9, recordings))
    rows = 0.01 + REALISTIC[kind](rng, len(ids))
    before = mean_interval(rows, ids, nonnegative=True)
    for _ in range(5):
        after = mean_interval(rows + rng.uniform(-1e-6, 1e-6, len(rows)), ids, nonnegative=True)
        assert (after.low, after.high) == pytest.approx((before.low, before.high), abs=1e-5)
        assert after.marks == before.marks


@pytest.mark.parametrize("kind", REALISTIC)
def test_other_names_of_the_recordings_give_the_same_interval(kind: str) -> None:
    rng = np.random.default_rng(0)
    ids = names(*[4] * 12)
    rows = REALISTIC[kind](rng, len(ids))
    before = mean_interval(rows, ids)
    after = mean_interval(rows, [name[::-1] for name in ids])
    assert (after.low, after.high) == pytest.approx((before.low, before.high), abs=1e-5)


@pytest.mark.parametrize("kind", REALISTIC)
@pytest.mark.parametrize("recordings", [10, 40])
def test_the_computed_bootstrap_is_that_of_very_many_replicates(kind: str, recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    sizes = rng.integers(1, 9, recordings)
    rows = REALISTIC[kind](rng, int(sizes.sum()))
    totals = np.add.reduceat(rows, np.cumsum(sizes) - sizes)
    drawn = rng.multinomial(recordings, np.full(recordings, 1 / recordings), size=100_000).astype(float)
    tail = stats.norm.cdf(-stats.t.ppf(0.975, recordings - 1) * np.sqrt(recordings / (recordings - 1)))
    low, high = np.quantile((drawn @ totals) / (drawn @ sizes), [tail, 1 - tail])
    found = mean_interval(rows, names(*sizes))
    assert found.low == pytest.approx(low, abs=0.02 * (high - low))
    assert found.high == pytest.approx(high, abs=0.02 * (high - low))


def test_a_recording_with_nearly_all_sequences_does_not_blur_the_others() -> None:
    rng = np.random.default_rng(1)
    sizes = np.array([200, *[3] * 11])
    rows = rng.gamma(2, 0.2, 12)[np.repeat(np.arange(12), sizes)] * rng.gamma(4, 0.25, int(sizes.sum()))
    totals = np.add.reduceat(rows, np.cumsum(sizes) - sizes)
    drawn = rng.multinomial(12, np.full(12, 1 / 12), size=100_000).astype(float)
    tail = stats.norm.cdf(-stats.t.ppf(0.975, 11) * np.sqrt(12 / 11))
    low, high = np.quantile((drawn @ totals) / (drawn @ sizes), [tail, 1 - tail])
    found = mean_interval(rows, names(*sizes))
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.05 * (high - low))


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ValueError, match="no values"):
        mean_interval(values(), [])
    with pytest.raises(ValueError, match="row 1: the value is not finite"):
        mean_interval(values(1, np.nan), names(2))
    with pytest.raises(ValueError, match="differ in number"):
        mean_interval(values(1, 2), names(3))
    with pytest.raises(ValueError, match="two recordings"):
        mean_interval(values(1, 2, 3), ["r0", "r1", "r1"], ["a", "a", "b"])
    with pytest.raises(ValueError, match="from 0 to 1"):
        rate_interval(values(0, 50), names(2))


def correlated_rates(rng: np.random.Generator, rate: float, correlation: float, recordings: int) -> tuple:
    sizes = rng.integers(2, 20, recordings)
    strength = (1 - correlation) / correlation
    own_rate = rng.beta(rate * strength, (1 - rate) * strength, recordings)
    ids = names(*sizes)
    return (rng.random(len(ids)) < np.repeat(own_rate, sizes)).astype(float), ids


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "recordings"), [(0.1, 6), (0.5, 6), (0.05, 25), (0.5, 25), (0.9, 25)])
@pytest.mark.parametrize("correlation", [0.001, 0.2])
def test_rate_intervals_cover_the_true_rate(rate: float, recordings: int, correlation: float) -> None:
    rng = np.random.default_rng(int(1000 * rate) + recordings)
    found = [rate_interval(*correlated_rates(rng, rate, correlation, recordings)) for _ in range(300)]
    assert np.mean([one.low <= rate <= one.high for one in found]) >= 0.90


@pytest.mark.slow
def test_a_plain_wilson_interval_would_not_cover() -> None:
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(300):
        rows, _ids = correlated_rates(rng, 0.5, 0.2, 25)
        plain = stats.binomtest(int(rows.sum()), len(rows)).proportion_ci(method="wilson")
        covered += plain.low <= 0.5 <= plain.high
    assert covered / 300 < 0.80  # the simulation can tell a wrong interval from a right one


@pytest.mark.slow
@pytest.mark.unchecked_shapes
@pytest.mark.parametrize("recordings", [3, 6, 10, 25])
def test_mean_intervals_cover_the_true_mean(recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    covered = 0
    for _ in range(300):
        sizes = rng.integers(2, 20, recordings)
        rows = np.repeat(rng.gamma(4, 0.25, recordings), sizes) * rng.gamma(4, 0.25, sizes.sum())
        found = mean_interval(rows, names(*sizes))
        covered += found.low <= 1.0 <= found.high
    assert covered / 300 >= 0.90
