from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.harness.intervals import compare
from prbench_benchmarks.motion_prediction.scoring import Scores
from prbench_benchmarks.motion_prediction.study_tables import estimates, paired


def scores(shift: float = 0.0, recordings: int = 8) -> Scores:
    rng = np.random.default_rng(0)
    found = Scores()
    for number in range(recordings):
        values = 20 + rng.normal(size=5) + 3 * rng.normal()
        names = [f"{number}/{place}" for place in range(5)]
        ade = values + shift + 0.01 * rng.normal()
        found.add({"window_id": names, "recording_id": [str(number)] * 5, "ade": ade, "wrist_to_goal": [np.nan] * 5})
    return found


def test_intervals_are_over_recordings():
    estimate = estimates(scores())["ade"]
    assert (estimate.n_recordings, estimate.n_sequences) == (8, 40)
    assert estimate.low is not None
    assert estimate.high is not None
    of_windows = 1.96 * np.std(scores().columns["ade"]) / np.sqrt(40)
    assert estimate.high - estimate.low > 2 * 2 * of_windows
    assert "wrist_to_goal" not in estimates(scores())


def test_no_interval_of_a_distance_reaches_below_zero():
    few = Scores()
    for number in range(8):
        values = [0.0, 0.0, 6.0 if number == 0 else 0.0]
        few.add({"window_id": [f"{number}/{k}" for k in range(3)], "recording_id": [str(number)] * 3, "mmade": values})
    assert estimates(few)["mmade"].low == 0.0


def test_differences_are_paired():
    pair = paired(scores(-0.1), scores(), "ade")
    assert pair is not None
    found = compare({"ade": pair})["ade"]
    assert found.difference.mean == pytest.approx(-0.1)
    assert found.difference.high is None  # the differences are equal: they show no spread
    assert paired(scores(-0.1), scores(), "wrist_to_goal") is None


def test_scores_of_other_windows_are_refused():
    with pytest.raises(UsageError, match="same windows"):
        paired(scores(), scores(recordings=7), "ade")
