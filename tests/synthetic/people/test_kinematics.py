"""The filter of which turned trunks are made, against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from prbench.synthetic.people.kinematics import two_pole_low_pass


def _by_scipy(values: np.ndarray, time_constant: float, rate: float) -> np.ndarray:
    decay = np.exp(-1.0 / (time_constant * rate))
    for _ in range(2):
        values = lfilter([1.0 - decay], [1.0, -decay], values, zi=[decay * values[0]])[0]
    return values


@pytest.mark.parametrize("n", [1, 2, 7, 4000])
@pytest.mark.parametrize("rate", [20.0, 60.0, 1000.0])
def test_the_low_pass_is_scipys_and_rests_on_the_first_value(n, rate):
    values = np.random.default_rng(n).normal(size=n)
    filtered = two_pole_low_pass(values, 0.3, rate)
    np.testing.assert_allclose(filtered, _by_scipy(values, 0.3, rate), rtol=1e-12, atol=0)
    assert filtered[0] == pytest.approx(values[0], rel=1e-12)
    assert two_pole_low_pass(np.full(n, 0.7), 0.3, rate) == pytest.approx(0.7)
