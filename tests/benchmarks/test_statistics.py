"""Fixed cells of the simulation of intervals and comparisons; all: ``python -m benchmarks.statistics``."""

from __future__ import annotations

import os

import numpy as np
import pytest

from benchmarks.statistics.__main__ import (
    EFFECTS,
    MEANS,
    MUST_FAIL,
    designs,
    detected,
    draw,
    flipped,
    main,
    measure,
    most_covered,
    p_values,
)
from prbench.harness.clusters import flip_bounds, mean_bounds, rate_bounds
from prbench.harness.intervals import clustered, compare
from prbench.harness.run_folder.summary import bounds_of_mean

pytestmark = pytest.mark.unchecked_shapes
_SETS = 1_000
_ERROR = 2 * (0.05 * 0.95 / _SETS) ** 0.5


def uneven(recordings: int, sequences: int, seed: int) -> np.ndarray:
    """Sizes of recordings with one sequence or more, the others shared out by exponential weights."""
    rng = np.random.default_rng(seed)
    weight = rng.exponential(1.0, recordings)
    return 1 + rng.multinomial(sequences - recordings, weight / weight.sum())


def drawn_rates(sizes: np.ndarray, rate: float, correlation: float, seed: int) -> tuple[np.ndarray, ...]:
    """Rates of data sets whose recordings' own rates follow a beta distribution, with the bounds of their intervals."""
    rng = np.random.default_rng(seed)
    strength = (1 - correlation) / correlation
    totals = rng.binomial(sizes, rng.beta(rate * strength, (1 - rate) * strength, (2 * _SETS, len(sizes)))) * 1.0
    mean = totals.sum(axis=1) / sizes.sum()
    beyond = 1 - 0.025 ** (1 / len(sizes))
    low = np.where(mean == 1, 1 - beyond, 0.0)
    high = np.where(mean == 0, beyond, 1.0)
    mixed = (mean > 0) & (mean < 1)
    low[mixed], high[mixed] = rate_bounds(totals[mixed], sizes)
    return mean, low, high


@pytest.mark.parametrize(
    ("sizes", "rate", "correlation"),
    [
        (np.full(3, 60), 0.5, 0.3),
        (np.full(8, 60), 0.02, 0.3),  # 88 % without an assumed correlation
        (np.full(22, 1), 0.98, 0.01),
        (np.full(47, 8), 0.02, 0.3),
        (uneven(47, 117, 3), 0.02, 0.1),
    ],
)
def test_rates_are_covered(sizes: np.ndarray, rate: float, correlation: float) -> None:
    _, low, high = drawn_rates(sizes, rate, correlation, 11)
    assert ((low <= rate) & (rate <= high)).mean() >= 0.93
    assert np.median(high - low) < 0.95


@pytest.mark.parametrize("kind", ["gamma", "exponential"])
@pytest.mark.parametrize("units", [3, 6, 22])
def test_means_of_what_cannot_be_negative_are_covered(kind: str, units: int) -> None:
    values = MEANS[kind](np.random.default_rng(12).uniform(size=(4 * _SETS, units)))
    low, high = mean_bounds(values, np.ones(units, dtype=int), values.var(axis=1, ddof=1), nonnegative=True)
    assert ((low <= 1) & (high >= 1)).mean() >= 0.93


@pytest.mark.parametrize("rates", [(0.02,) * 5, (0.1, 0.3, 0.5, 0.7, 0.9)])
def test_means_over_datasets_are_covered(rates: tuple[float, ...]) -> None:
    sizes = np.array([2, 2, 2, 1, 1, 1, 1])  # ten sequences, as a run without ``--data`` takes them
    found = [drawn_rates(sizes, rate, 0.1, seed) for seed, rate in enumerate(rates)]
    low, high = bounds_of_mean(*(np.stack(part) for part in zip(*found, strict=True)))
    assert ((low <= np.mean(rates)) & (np.mean(rates) <= high)).mean() >= 0.93


@pytest.mark.parametrize("kind", [kind for kind in EFFECTS if kind not in MUST_FAIL])
@pytest.mark.parametrize("uneven", [0, 1])
def test_differences_are_covered_and_families_find_nothing_where_nothing_is(kind: str, uneven: int) -> None:
    covered, family, _ = measure(kind, designs(11)[uneven], _SETS)
    assert covered >= 0.93 - _ERROR
    if kind != "skewed":
        # Standard error of the level at Holm's first step, of each of seven comparisons.
        assert family <= 0.05 + 2 * 7 * (0.05 / 7 / _SETS) ** 0.5


@pytest.mark.parametrize(("kind", "units", "equal"), [("correlated", 11, 0), ("independent", 22, 1), ("binary", 47, 0)])
def test_power_and_the_smallest_difference_are_as_printed(kind: str, units: int, equal: int) -> None:
    sizes = designs(units)[equal]
    totals, _ = draw(kind, sizes, _SETS, 7, shift=0.3)
    powers = {name: (p <= 0.05).mean() for name, p in p_values(totals, sizes).items()}
    assert powers["flips"] >= max(powers["CR2"], powers["sign"]) - 0.05
    assert detected(kind, sizes, 400) == pytest.approx(0.8, abs=0.09)


def test_too_few_units_have_no_smallest_difference() -> None:
    assert detected("correlated", designs(8)[0], 3) is None


def test_where_the_mean_is_carried_by_recordings_that_were_not_seen_no_test_can_cover_it() -> None:
    sizes = designs(9)[0]
    covered, _, _ = measure("rare", sizes, _SETS)
    assert covered < 0.7
    assert most_covered("rare", sizes, _SETS) == pytest.approx(covered, abs=0.05)
    assert most_covered("correlated", sizes, _SETS) > 0.95


def test_the_simulation_measures_the_functions_that_print() -> None:
    sizes = designs(11)[1]
    rows = np.random.default_rng(0).normal(0.4, 1, sizes.sum())
    totals = np.add.reduceat(rows, np.cumsum(sizes) - sizes)
    ids = np.repeat([f"r{i:02d}" for i in range(11)], sizes)
    printed = compare({"a": clustered(rows, ids)})["a"]
    low, high = flip_bounds(flipped(totals[None], sizes))
    assert (printed.difference.low, printed.difference.high) == pytest.approx((low[0], high[0]))
    assert printed.p_value == p_values(totals[None], sizes)["flips"][0]


@pytest.mark.parametrize("kind", EFFECTS)
def test_values_of_the_simulation_have_the_difference_that_they_claim(kind: str) -> None:
    totals, _ = draw(kind, designs(22)[0], 4_000, 0, shift=0.2)
    assert totals.mean() / 5 == pytest.approx(0.2, abs=0.05)


@pytest.mark.fuzz
@pytest.mark.skipif("PRBENCH_FUZZ" not in os.environ, reason="takes a minute: set PRBENCH_FUZZ to run it")
def test_the_whole_grid_is_as_promised(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(2_000) == 0, capsys.readouterr().out
