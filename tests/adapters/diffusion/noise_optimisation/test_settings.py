from __future__ import annotations

import pytest

from prbench_adapters.diffusion.noise_optimisation import (
    KEYFRAME_OPTIONS,
    PRIME_AND_REACH_OPTIONS,
    OptimisationSettings,
    dno_paper,
    fast,
    optimisation_settings,
    paper,
)


def test_the_paper_mode_is_the_papers():
    settings = paper(50)
    assert (settings.ddim_steps, settings.iterations, settings.warmup) == (50, 400, 50)
    assert (settings.learning_rate, settings.jerk_weight, settings.decorrelation_weight) == (0.05, 0.5, 1000.0)
    assert (settings.keep, settings.stop_below, settings.guidance, settings.hand) == ("last", None, 1.0, "right")


@pytest.mark.parametrize(("trained", "kept"), [(10, 10), (50, 50), (1000, 10)])
def test_the_baseline_keeps_ten_steps_of_a_long_schedule(trained, kept):
    assert dno_paper(trained).ddim_steps == kept


@pytest.mark.parametrize("trained", [2, 10, 50, 1000])
def test_the_fast_mode_spends_at_most_400_passes(trained):
    settings = fast(trained)
    assert settings.ddim_steps <= trained
    assert settings.ddim_steps * (settings.iterations + 1) <= 400
    assert settings.checkpointing == 0


def test_options_change_a_preset_and_the_warmup_keeps_its_share():
    given = {"iterations": "200", "hand": "nearest", "decorrelation": "0", "alpha": "0.1"}
    settings = optimisation_settings(given, paper(50), diffusion_steps=50)
    assert (settings.iterations, settings.warmup) == (200, 25)
    assert (settings.hand, settings.decorrelation_weight, settings.jerk_weight) == ("nearest", 0.0, 0.1)
    assert settings.learning_rate == 0.05


def test_without_options_a_preset_stays_as_it_is():
    for preset in (paper(50), fast(50), dno_paper(1000)):
        assert optimisation_settings({}, preset, diffusion_steps=1000) == preset


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("ddim-steps", "51"),
        ("iterations", "0"),
        ("hand", "both"),
        ("alpha", "-1"),
    ],
)
def test_an_impossible_value_is_refused_by_name(key, value):
    with pytest.raises(ValueError, match=f"option '{key}'"):
        optimisation_settings({key: value}, paper(50), diffusion_steps=50)


def test_every_option_changes_something():
    other = {
        "ddim-steps": "3", "iterations": "9", "learning-rate": "1", "alpha": "2", "decorrelation": "3",
        "initial-velocity-weight": "4", "hand": "left", "bones": "initial", "reach": "goal",
    }  # fmt: skip
    assert set(other) == {*KEYFRAME_OPTIONS, *PRIME_AND_REACH_OPTIONS}
    preset = OptimisationSettings()
    for key, value in other.items():
        assert optimisation_settings({key: value}, preset, diffusion_steps=50) != preset, key
