from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.evaluation.prediction_summary import differences, summarise
from prbench.prediction.scoring import Scores


def scores(shift: float = 0.0, recordings: int = 8) -> Scores:
    rng = np.random.default_rng(0)
    found = Scores()
    for number in range(recordings):
        values = rng.normal(size=5) + 3 * rng.normal()
        names = [f"{number}/{place}" for place in range(5)]
        ade = values + shift + 0.01 * rng.normal()
        found.add({"window_id": names, "recording_id": [str(number)] * 5, "ade": ade, "wrist_to_goal": [np.nan] * 5})
    return found


def test_intervals_are_over_recordings():
    estimate = summarise(scores())["ade"]
    assert (estimate.n_recordings, estimate.n_sequences) == (8, 40)
    assert estimate.low is not None
    assert estimate.high is not None
    of_windows = 1.96 * np.std(scores().columns["ade"]) / np.sqrt(40)
    assert estimate.high - estimate.low > 2 * 2 * of_windows
    assert "wrist_to_goal" not in summarise(scores())


def test_differences_are_paired():
    found = differences(scores(), scores(-0.1))["ade"]
    assert found.estimate.mean == pytest.approx(-0.1)
    assert found.estimate.high == pytest.approx(-0.1, abs=1e-6) or found.estimate.high is None


def test_scores_of_other_windows_are_refused():
    with pytest.raises(UsageError, match="same windows"):
        differences(scores(), scores(recordings=7))
