"""Mean by feature, standard deviation by block, portion by portion."""

from __future__ import annotations

import numpy as np

from prbench.representation import BLOCKS, Statistics, StatisticsAccumulator


def features(seed: int, rows: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    scale, shift = generator.uniform(0.1, 2.0, (2, 263))
    return (generator.normal(size=(rows, 263)) * scale + 50 * shift).astype(np.float32)


def of(*portions: np.ndarray) -> Statistics:
    accumulator = StatisticsAccumulator()
    for portion in portions:
        accumulator.add(portion)
    return accumulator.result()


def test_mean_of_each_feature_and_average_deviation_of_each_block():
    rows = features(0, 500)
    statistics = of(rows)
    assert np.allclose(statistics.mean, rows.mean(axis=0, dtype=np.float64), rtol=1e-6)
    for block in BLOCKS.values():
        assert np.allclose(statistics.std[block], rows[:, block].std(axis=0, dtype=np.float64).mean(), rtol=1e-6)
    assert statistics.mean.dtype == statistics.std.dtype == np.float32
    assert len(np.unique(statistics.std)) == 7


def test_portions_do_not_matter_even_far_from_zero():
    rows = features(1, 300) + np.float32(1e3)
    whole, parts = of(rows), of(rows[:1], rows[1:7], rows[7:7], rows[7:])
    assert np.allclose(whole.mean, parts.mean, rtol=1e-7)
    assert np.allclose(whole.std, parts.std, rtol=1e-6)


def test_motions_with_nan_are_left_out_and_counted():
    rows, spoilt = features(2, 50), features(3, 50)
    spoilt[7, 100] = np.nan
    accumulator = StatisticsAccumulator()
    assert [accumulator.add(part) for part in (rows, spoilt, spoilt * np.inf)] == [True, False, False]
    assert (accumulator.skipped, accumulator.count) == (2, 50)
    assert np.array_equal(accumulator.result().mean, of(rows).mean)


def test_a_constant_block_is_not_scaled():
    rows = features(4, 50)
    rows[:, BLOCKS["root_yaw_velocity"]] = 0.25
    rows[:, BLOCKS["foot_contacts"]] = 1.0
    statistics = of(rows)
    assert statistics.std[0] == 1.0
    assert np.array_equal(statistics.std[259:], np.ones(4))
    assert np.isfinite(statistics.standardise(rows)).all()


def test_standardised_features_come_back():
    rows = features(5, 50)
    statistics = of(rows)
    assert np.allclose(statistics.restore(statistics.standardise(rows)), rows, rtol=1e-5)
    assert np.allclose(statistics.standardise(rows).mean(axis=0), 0.0, atol=1e-4)


def test_evaluators_weigh_root_and_contacts_up():
    statistics = of(features(6, 50))
    ratio = statistics.std / statistics.for_evaluator().std
    assert np.allclose(ratio[np.r_[0:4, 259:263]], 25.0)
    assert np.array_equal(ratio[4:259], np.ones(255))
    assert np.array_equal(statistics.for_evaluator().mean, statistics.mean)


def test_published_deviations_are_one_number_a_block(samples):
    """The convention itself: the released Std.npy is constant inside exactly these seven blocks."""
    std = np.load(samples / "humanml3d" / "Std.npy")
    expected = (0.0128256, 0.0169271, 0.1537659, 0.1222436, 0.2996918, 0.0194703, 0.3559327)
    for block, value in zip(BLOCKS.values(), expected, strict=True):
        assert np.allclose(std[block], value, atol=5e-8)


def test_golden_motions_have_means_of_the_order_of_the_published_ones(samples):
    """Same columns, same units: a permuted or rescaled feature would leave the published spread by far."""
    published = {name: np.load(samples / "humanml3d" / f"{name}.npy") for name in ("Mean", "Std")}
    files = sorted((samples / "humanml3d" / "golden").glob("*.npz"))
    own = of(*(np.load(file)["features"] for file in files))
    away = np.abs(own.mean - published["Mean"]) / published["Std"]
    assert away[3:67].max() < 4.0
    assert np.median(away) < 1.0
