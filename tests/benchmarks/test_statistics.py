"""Fifteen fixed cells of the simulation of intervals and comparisons; all: ``python -m benchmarks.statistics``."""

from __future__ import annotations

import os

import numpy as np
import pytest

from benchmarks.statistics.__main__ import LEAST_COVERAGE, MOST_FALSE_POSITIVES, main
from benchmarks.statistics.cells import (
    DESIGNS,
    FIRST_RUN,
    METRES,
    UNUSED_METRES,
    coverage_over_datasets,
    draw_metres,
    draw_rates,
    false_positives,
    mean_coverage,
    rate_coverage,
)
from prbench.harness.clusters import p_values, rate_bounds
from prbench.harness.intervals import clustered, paired_p_value, rate_interval

pytestmark = pytest.mark.unchecked_shapes
_SETS = 2_000


@pytest.mark.parametrize(
    ("design", "rate", "correlation"),
    [
        ("3 of 60", 0.5, 0.3),
        ("8 of 60", 0.02, 0.3),  # 88 % without an assumed correlation
        ("22 of 1", 0.98, 0.0),
        ("47 of 8", 0.02, 0.3),  # 88 % in version 0.5.0
        ("47 uneven of 117", 0.02, 0.1),
    ],
)
def test_rates_are_covered(design: str, rate: float, correlation: float) -> None:
    found = rate_coverage(DESIGNS[design], rate, correlation, sets=_SETS, seed=11)
    assert found.share >= LEAST_COVERAGE
    assert found.width < 0.95


@pytest.mark.parametrize(
    ("design", "kind"),
    [("3 of 10", "exponential"), ("11 uneven of 55", "gamma"), ("22 of 8", "lognormal")],
)
def test_means_are_covered(design: str, kind: str) -> None:
    found = mean_coverage(DESIGNS[design], kind, sets=_SETS, seed=12)
    assert found is not None
    assert found.share >= LEAST_COVERAGE


@pytest.mark.parametrize("kind", [(0.02,) * 5, (0.1, 0.3, 0.5, 0.7, 0.9), "lognormal"])
def test_means_over_datasets_are_covered(kind: str | tuple[float, ...]) -> None:
    found = coverage_over_datasets(FIRST_RUN, kind, sets=_SETS, seed=14)
    assert found.share >= LEAST_COVERAGE


@pytest.mark.parametrize(
    ("design", "kind"),
    [
        ("8 of 20", "lognormal"),  # 9 % before version 0.8.0
        ("22 of 8", "unequal-spread"),
        ("47 uneven of 117", "lognormal"),  # 12 % in version 0.5.0 even of a gamma distribution, by flipping signs
        ("22 of 8", "rates"),
    ],
)
def test_families_of_comparisons_find_nothing_where_nothing_is(design: str, kind: str) -> None:
    found = false_positives(DESIGNS[design], kind, families=_SETS, seed=13)
    assert found is not None
    assert found.share <= MOST_FALSE_POSITIVES + 2 * found.error


def test_too_few_recordings_are_no_cell() -> None:
    assert false_positives(DESIGNS["3 of 10"], "normal", families=10, seed=0) is None


def test_the_simulation_measures_the_functions_that_print() -> None:
    rng = np.random.default_rng(0)
    sizes = DESIGNS["11 uneven of 55"]
    ids = np.repeat([f"r{i:02d}" for i in range(len(sizes))], sizes)
    successes = draw_rates(rng, sizes, 0.3, 0.1, 1)[0]
    rows = np.concatenate([np.arange(size) < made for size, made in zip(sizes, successes)]).astype(float)
    printed = rate_interval(rows, ids)
    assert (printed.low, printed.high) == pytest.approx(tuple(map(float, rate_bounds(successes, sizes))))
    differences = rng.normal(0.1, 1, len(ids))
    assert paired_p_value(differences, ids) == pytest.approx(float(p_values(clustered(differences, ids).spread)))


def test_values_of_the_simulation_have_the_mean_that_they_claim() -> None:
    rng = np.random.default_rng(0)
    for kind in (*METRES, *UNUSED_METRES):
        totals, _ = draw_metres(rng, DESIGNS["22 of 1"], kind, 4_000)
        assert totals.mean() == pytest.approx(1, abs=0.05)


@pytest.mark.fuzz
@pytest.mark.skipif("PRBENCH_FUZZ" not in os.environ, reason="takes a minute: set PRBENCH_FUZZ to run it")
def test_the_whole_grid_is_as_promised(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(2_000) == 0, capsys.readouterr().out
