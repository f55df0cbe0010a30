from __future__ import annotations

from dataclasses import replace

import pytest

from prbench.synthetic.people import perform
from prbench.synthetic.performance import OtherPerson, Performance


@pytest.fixture(scope="session")
def performance() -> Performance:
    """One pick and one put."""
    return perform("adt", seed=11, index=3, n_events=2, provocations={})


@pytest.fixture(scope="session")
def performance_for_two(performance) -> Performance:
    """The same with a second person a metre beside the first."""
    beside = (1.0, 0.0, 0.0)
    other = OtherPerson("S777", performance.joints + beside, performance.finger_bases + beside)
    return replace(performance, other_people=(other,))
