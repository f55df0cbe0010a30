"""Do their sequences resemble the datasets? Targets: docs/specification/synthetic-recordings.md#statistics."""

from __future__ import annotations

import pytest

from prbench.synthetic.people import PRESETS
from prbench.synthetic.performance import Performance
from tests.synthetic.behaviour import TARGETS, sequence_statistics
from tests.synthetic.plausibility import truth_scores
from tests.synthetic.true_clips import clips_of

TRIAL = {
    "hd-epic": (0.75, 0.61),
    "mogaze": (0.80, 0.64),
    "hot3d": (0.82, 0.62),
    "adt": (0.59, 0.49),
    "gimo": (0.69, 0.59),
}
"""Prime Success of the trial's own motion, `equation` and `onset`.

Source: docs/specification/synthetic-recordings.md#statistics.
"""


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_means_lie_within_a_third_of_the_targets_spread(crowds: dict[str, list[Performance]], preset: str) -> None:
    deviations = sequence_statistics(clips_of(crowds[preset])).deviations(TARGETS[preset])
    assert {name: value for name, value in deviations.items() if abs(value) > 1 / 3} == {}


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_heads_prime_about_as_often_as_in_the_trial(crowds: dict[str, list[Performance]], preset: str) -> None:
    scores = truth_scores(clips_of(crowds[preset]))
    assert (scores.prime_equation, scores.prime_onset) == pytest.approx(TRIAL[preset], abs=0.15)


@pytest.mark.slow
def test_adt_hands_hold_boxes_by_the_fingertips_and_the_others_wrap_them(
    crowds: dict[str, list[Performance]],
) -> None:
    reach = {preset: truth_scores(clips_of(crowds[preset])) for preset in PRESETS}
    assert reach["adt"].reach_final == 0.0
    assert reach["gimo"].reach_final == 1.0
    assert all(reach[preset].reach_any > 0.6 for preset in ("hd-epic", "mogaze", "hot3d"))


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_few_goals_are_given_up(crowds: dict[str, list[Performance]], preset: str) -> None:
    events = sum(len(performance.events) for performance in crowds[preset])
    assert events > 0.75 * 6 * len(crowds[preset])
