"""Intervals: hand-worked cases, SciPy as oracle, coverage by simulation, and what must never be claimed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from prbench.harness.clusters import (
    FEWEST_FOR_BOARD,
    degrees_of_freedom,
    effective_number,
    flip_bounds,
    flipped_means,
    flips,
    standard_error,
    units_needed,
)
from prbench.harness.intervals import (
    Comparison,
    Estimate,
    clustered,
    compare,
    compare_families,
    difference_interval,
    holm,
    metric_interval,
)
from prbench.harness.intervals import mean_interval as mean_of
from prbench.harness.intervals import rate_interval as rate_of
from prbench.metrics import METRICS


def names(*sizes: int) -> list[str]:
    """Recording of each sequence: sizes[0] times r0, sizes[1] times r1, …"""
    return [f"r{i:03d}" for i, size in enumerate(sizes) for _ in range(size)]


def rate_interval(*data) -> Estimate:
    return rate_of(clustered(*data))


def mean_interval(*data, **about: bool) -> Estimate:
    return mean_of(clustered(*data), **about)


def smallest_detectable(rows: np.ndarray, ids: list[str], *, comparisons: int) -> float | None:
    return clustered(rows, ids).detectable(comparisons)


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
def test_one_sequence_a_recording_gives_the_exact_interval(successes: int, n: int) -> None:
    # Clopper and Pearson's, where Wilson's stood: Wilson's covers 93 % at 2 % of 22, and less if sequences are alike.
    found = rate_interval(values(*[1] * successes, *[0] * (n - successes)), names(*[1] * n))
    exact = stats.binomtest(successes, n).proportion_ci(method="exact")
    assert (found.low, found.high) == pytest.approx((exact.low, exact.high))
    assert found.marks == ()


def test_two_unanimous_recordings_count_for_two_trials() -> None:
    found = rate_interval(values(1, 1, 0, 0), names(2, 2))
    exact = stats.binomtest(1, 2).proportion_ci(method="exact")  # Wilson's, 0.0945 to 0.9055, stood here
    assert (found.low, found.high) == pytest.approx((exact.low, exact.high))
    assert found.marks == ("few_recordings",)


def effective(rows: np.ndarray, *sizes: int) -> float:
    data = clustered(rows, names(*sizes))
    return float(effective_number(data.totals, data.sizes))


def test_effective_number_worked_by_hand() -> None:
    # Totals 1, 1, 2 of 2 sequences each: rate 2/3, residuals -1/3, -1/3, 2/3; CR2 divides their squares by 1 - 1/3:
    # variance (6/9) / (2/3) / 36 = 1/36, where (2/9) / 5 = 2/45 belongs to independent sequences: effect below 1.
    # Failures are the rarer, 1 and 1: two recordings hold them: assumed effect 1 + (2 - 1) * 0.3 / 4 = 1.075.
    few = (stats.t.ppf(0.975, 5) / stats.t.ppf(0.975, 2)) ** 2
    assert effective(values(1, 0, 0, 1, 1, 1), 2, 2, 2) == pytest.approx(max(6 / 1.075 * few, 3))
    # Ten totals of 7 and ten of 3, of 10 sequences each: variance 20 * 2^2 / (1 - 1/20) / 200^2 against (1/4) / 199.
    rows = np.repeat([1.0, 0.0] * 20, [7, 3] * 10 + [3, 7] * 10)
    few = (stats.t.ppf(0.975, 199) / stats.t.ppf(0.975, 19)) ** 2
    assert effective(rows, *[10] * 20) == pytest.approx(200 / 1.675789 * few, rel=1e-5)
    # Totals 3, 0 of 3: never below the two recordings that there are.
    assert effective(values(1, 1, 1, 0, 0, 0), 3, 3) == pytest.approx(2)


def test_events_of_one_recording_say_nothing_about_correlation() -> None:
    alone = effective(values(1, *[0] * 479), *[60] * 8)
    spread = effective(np.tile(values(1, *[0] * 59), 8), *[60] * 8)
    assert alone == pytest.approx(480 / (1 + 59 * 0.3) * (stats.t.ppf(0.975, 479) / stats.t.ppf(0.975, 7)) ** 2)
    assert spread > 200


def test_degrees_of_freedom_of_equal_recordings_are_one_less() -> None:
    assert degrees_of_freedom(np.full(9, 4)) == pytest.approx(8)
    assert degrees_of_freedom(np.array([100, 2, 2, 2])) < 1.5


def test_the_error_of_equal_recordings_is_that_of_their_means() -> None:
    means = np.random.default_rng(0).gamma(2, 1, 7)
    assert standard_error(4 * means, np.full(7, 4)) == pytest.approx(stats.sem(means))


def test_recordings_of_one_size_give_the_t_interval_of_their_means() -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(rng.normal(1, 0.3, (4, 1)), 0.1, (4, 7))
    found = mean_interval(rows.ravel(), names(7, 7, 7, 7))
    means = rows.mean(axis=1)
    assert (found.low, found.high) == pytest.approx(stats.t.interval(0.95, 3, means.mean(), stats.sem(means)))
    assert (found.method, found.marks) == ("student-cr2", ("few_recordings",))


def test_what_cannot_be_negative_may_have_a_long_tail_upwards() -> None:
    rows = np.random.default_rng(0).exponential(1, 40)
    plain, cut = (mean_interval(rows, names(*[1] * 40), nonnegative=each) for each in (False, True))
    assert cut.low == plain.low
    assert cut.high == pytest.approx(cut.mean * np.exp((plain.high - plain.mean) / plain.mean))


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


@pytest.mark.parametrize("sizes", [(3, 4), (100, 2, 2)])
def test_two_recordings_and_one_that_outweighs_all_others_give_no_mean(sizes: tuple[int, ...]) -> None:
    found = mean_interval(np.random.default_rng(0).random(sum(sizes)), names(*sizes))
    assert (found.low, found.high, found.method) == (None, None, "none")


def test_recordings_that_agree_by_chance_are_no_certainty() -> None:
    found = mean_interval(values(*[0, 1] * 12), names(*[2] * 12))
    assert found.high - found.low > 2 * 1.96 * 0.5 / np.sqrt(24)


def test_the_mean_is_over_sequences_and_the_interval_is_cut_where_nothing_can_be() -> None:
    rows = values(1, 1, 1, 3, 3, 2, 8)
    found = mean_interval(rows, names(3, 2, 2))
    assert found.mean == pytest.approx(19 / 7)  # not 3, the mean of the recording means
    assert found.low < 0
    assert mean_interval(rows, names(3, 2, 2), nonnegative=True).low == 0


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


def test_equal_values_show_no_spread() -> None:
    found = mean_interval(np.zeros(24), names(*[2] * 12))
    assert (found.mean, found.low, found.high) == (0.0, None, None)  # [0, 0] stood here, which claims certainty
    assert found.marks == ("all_equal",)


def test_what_only_arithmetic_tells_apart_is_equal() -> None:
    noise = np.random.default_rng(0).uniform(-1e-6, 1e-6, 24)
    assert mean_interval(1.0 + noise, names(*[2] * 12)).marks == ("all_equal",)
    found = rate_interval(np.abs(noise), names(*[2] * 12))
    assert found.method == "clopper-pearson-recordings"


def test_a_metric_brings_the_interval_of_its_unit() -> None:
    methods = {info.id: metric_interval(info, values(*[0.0, 1.0] * 12), names(*[2] * 12)).method for info in METRICS}
    assert methods["prime_success"] == methods["location_error"] == "clopper-pearson-cluster"
    assert methods["mpjpe"] == methods["foot_skating"] == "student-cr2"


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


def compared(rows: np.ndarray, *sizes: int, rate: bool = False) -> Comparison:
    """The one comparison of a method that differs from another by these rows."""
    return compare({"a": clustered(rows, names(*sizes), rate=rate)})["a"]


def p_of(rows: np.ndarray, *sizes: int) -> float:
    found = compared(rows, *sizes).p_value
    assert found is not None
    return found


@pytest.mark.parametrize("sizes", [(4,) * 6, (1, 9, 2, 5, 3, 3, 7), tuple(range(1, 13))])
def test_the_p_value_is_that_of_all_flips_of_the_totals(sizes: tuple[int, ...]) -> None:
    rows = np.random.default_rng(len(sizes)).normal(0.5, 1, sum(sizes))
    totals = np.add.reduceat(rows, np.cumsum(sizes) - sizes)
    oracle = stats.permutation_test((totals,), np.sum, permutation_type="samples", n_resamples=np.inf)
    assert p_of(rows, *sizes) == oracle.pvalue


def test_drawn_flips_agree_with_all_of_them() -> None:
    sizes = np.arange(1, 13)
    totals = np.random.default_rng(0).normal(1, 3, 12)
    units = tuple(names(*[1] * 12))
    drawn = flips(units, 2**11)
    assert drawn.shape == (12, 2**11 - 1)
    exact, close = (np.array(flip_bounds(flipped_means(totals, sizes, each))) for each in (flips(units), drawn))
    assert close == pytest.approx(exact, abs=0.05)
    # A further recording leaves the signs of the others as they are, and names alone decide.
    mixed = ~drawn.all(axis=0)
    assert (flips((*units, "z"), 2**11)[:12, mixed] == drawn[:, mixed]).all()
    assert drawn.mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("sizes", [(3,) * 9, (1, 9, 2, 5, 3, 3, 7, 4)])
def test_the_interval_holds_the_differences_that_the_test_does_not_reject(sizes: tuple[int, ...]) -> None:
    rows = np.random.default_rng(3).normal(0.5, 1, sum(sizes))
    found = compared(rows, *sizes).difference
    assert found.method == "sign-flip"
    for bound, inside in ((found.low, 1e-3), (found.high, -1e-3)):
        assert p_of(rows - bound - inside, *sizes) > 0.05
        assert p_of(rows - bound + inside, *sizes) <= 0.05


@pytest.mark.parametrize(
    ("bad", "value", "expected", "low"),
    [(1, -1, 24 / 2048, 1 / 3), (1, 0, 4 / 2048, 2 / 3), (2, 0, 8 / 2048, 1 / 2), (0, 0, 2 / 2048, None)],
)
def test_a_bad_recording_costs_as_much_as_in_a_sign_test(
    bad: int, value: float, expected: float, low: float | None
) -> None:
    rows = np.repeat([value] * bad + [1.0] * (11 - bad), 5)
    found = compared(rows, *[5] * 11, rate=True)
    assert found.p_value == expected
    assert low is None or (found.difference.low, found.difference.high) == pytest.approx((low, 1))


def test_more_counter_examples_make_less_sure() -> None:
    found = []
    for bad in range(5):
        rows = np.tile([1.0, 0.0, 0.0, 1.0], 22)
        rows[: 4 * bad] = -1.0
        found.append(p_of(rows, *[4] * 22))
    assert found == sorted(found)
    assert found[1] < 0.001 < 0.01 < found[3]


@pytest.mark.parametrize("recordings", [7, 12, 20])
@pytest.mark.parametrize("seed", range(10))
def test_more_evidence_never_raises_p(recordings: int, seed: int) -> None:
    rng = np.random.default_rng([recordings, seed])
    sizes = rng.integers(1, 6, recordings)
    rows = rng.choice([-1.0, 0.0, 1.0, 2.0], sizes.sum())
    rows = rows if rows.sum() > 0 else 0.1 - rows
    before = p_of(rows, *sizes)
    larger = rows + np.where(np.arange(len(rows)) == rng.integers(len(rows)), rng.exponential(), 0.0)
    assert p_of(larger, *sizes) <= before
    further = np.append(rows, rng.exponential(1, 3))
    assert p_of(further, *sizes, 3) <= before


@pytest.mark.parametrize("recordings", [15, 16, 17, 18, 30])
def test_unanimous_recordings_have_the_smallest_p_value_that_there_is(recordings: int) -> None:
    assert p_of(np.linspace(1, 2, recordings), *[1] * recordings) == 2.0 ** (1 - min(recordings, 16))


def test_differences_that_never_vary_may_still_vary() -> None:
    found = compared(np.zeros(22), *[1] * 22, rate=True).difference
    beyond = 1 - 0.025 ** (1 / 22)
    assert (found.low, found.high) == pytest.approx((-beyond, beyond))
    assert compared(np.zeros(22), *[1] * 22).difference.low is None


@pytest.mark.parametrize(("gain", "loss"), [(0.0, 0.0), (0.05, 0.0), (0.05, 0.05), (0.3, 0.1)])
def test_intervals_of_differences_of_rates_cover(gain: float, loss: float) -> None:
    rng = np.random.default_rng(7)
    covered = 0
    for _ in range(200):
        drawn = rng.choice([1.0, 0.0, -1.0], 40, p=[gain, 1 - gain - loss, loss])
        found, _ = difference_interval(clustered(drawn, names(*[2] * 20), rate=True))
        covered += found.low - 1e-9 <= gain - loss <= found.high + 1e-9
    assert covered / 200 >= 0.93


def test_units_needed_follow_from_the_smallest_p_value() -> None:
    assert [units_needed(count) for count in (1, 7, 21)] == [6, 9, 10]
    assert FEWEST_FOR_BOARD == 9
    rows = np.ones(40)
    five, six = compared(rows, *[8] * 5), compared(rows, *[8] * 4, 4, 4)
    assert (five.p_value, five.adjusted_p_value, five.detectable, five.conclusion) == (None,) * 3 + (
        "cannot be tested",
    )
    assert five.difference.mean == 1.0
    assert (six.p_value, six.conclusion) == (2 / 64, "higher")
    pair = clustered(rows, names(*[5] * 8))
    seven = compare({str(i): pair for i in range(7)})["0"]
    assert (seven.p_value, seven.conclusion, seven.needed) == (2 / 256, "cannot be tested", 9)


@pytest.mark.parametrize("sizes", [(4,) * 22, (1, 1, 2, 2, 3, 3, 4, 5, 6, 8, 9)])
def test_the_smallest_detectable_difference_is_found_as_often_as_said(sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    ids = names(*sizes)
    found = 0
    for _ in range(200):
        pilot, rows = np.repeat(rng.normal(0, 1, (2, len(sizes))), sizes, axis=1) + rng.normal(0, 1, (2, sum(sizes)))
        detectable = smallest_detectable(pilot, ids, comparisons=7)
        assert detectable is not None
        found += p_of(rows + detectable, *sizes) <= 0.05 / 7
    assert 0.72 <= found / 200 <= 0.88


def test_more_comparisons_make_less_detectable() -> None:
    rows = np.random.default_rng(0).normal(0, 1, 60)
    one, seven = (smallest_detectable(rows, names(*[3] * 20), comparisons=count) for count in (1, 7))
    assert one is not None
    assert seven is not None
    assert seven > 1.2 * one
    assert smallest_detectable(np.zeros(60), names(*[3] * 20), comparisons=1) is None
    assert smallest_detectable(rows, names(*[10] * 6), comparisons=7) is None


@pytest.mark.parametrize("recordings", [8, 30, 50])
def test_noise_of_a_micrometre_moves_no_p_value(recordings: int) -> None:
    rng = np.random.default_rng(recordings)
    sizes = [4] * recordings
    rows = rng.integers(-1, 2, 4 * recordings).astype(float)  # many flips are tied
    order = rng.permutation(len(rows))
    before = p_of(rows, *sizes)
    assert p_of(rows + rng.uniform(-1e-6, 1e-6, len(rows)), *sizes) == before
    shuffled = clustered(rows[order], np.array(names(*sizes))[order])
    assert compare({"a": shuffled})["a"].p_value == before
    assert p_of(rows * 0 + 1e-12, *sizes) == 1.0


def test_many_sequences_of_few_different_recordings_are_no_evidence() -> None:
    per_recording = np.array([0.5, -0.4, 0.3, -0.2, 0.4, -0.3])
    assert p_of(np.repeat(per_recording, 200), *[200] * 6) > 0.5


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == pytest.approx([0.03, 0.06, None, 0.06])
    assert holm([0.6, 0.7]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []


def test_the_direction_of_a_supported_difference_is_told() -> None:
    rows, ids = np.linspace(0.1, 0.2, 16), names(*[2] * 8)
    found = compare({"up": clustered(rows, ids), "down": clustered(-rows, ids)})
    assert (found["up"].conclusion, found["down"].conclusion) == ("higher", "lower")
    assert found["up"].adjusted_p_value == pytest.approx(2 * found["up"].p_value)
    assert found["up"].difference.mean == -found["down"].difference.mean


def test_a_family_is_compared_alike_alone_and_among_others_of_any_units():
    rng = np.random.default_rng(5)
    families = {
        str(n): {k: clustered(rng.normal(0.1, 1.0, 2 * units), names(*[2] * units)) for k, units in enumerate(sizes)}
        for n, sizes in enumerate(((12, 20, 4), (20, 12), (12,) * 70))
    }
    together = compare_families(families)
    assert together == {key: compare(differences) for key, differences in families.items()}
    assert list(together["0"]) == [0, 1, 2]
    assert together["0"][2].p_value is None
