from __future__ import annotations

import pytest

from prbench_adapters.diffusion.generation import SamplingSettings, require_known, sampling_settings


def _settings(**options: str) -> SamplingSettings:
    return sampling_settings(options, guidance=2.5, diffusion_steps=50)


def test_the_methods_own_values_stand_unless_others_are_given():
    assert _settings() == SamplingSettings(guidance=2.5, sampler="ddpm", steps=None)
    assert _settings(guidance="1", sampler="ddim", steps="10") == SamplingSettings(1.0, "ddim", 10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"guidance": "-1"}, "option 'guidance': expected a number of 0 or more, found '-1'"),
        ({"guidance": "nan"}, "option 'guidance'"),
        ({"guidance": "much"}, "option 'guidance'"),
        ({"sampler": "euler"}, "option 'sampler': expected ddpm or ddim, found 'euler'"),
        ({"steps": "0"}, "option 'steps': expected a whole number from 1 to 50, found '0'"),
        ({"steps": "51"}, "option 'steps'"),
        ({"steps": "2.5"}, "option 'steps'"),
        ({"steps": "-3"}, "option 'steps'"),
    ],
)
def test_impossible_values_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        _settings(**options)


def test_an_unknown_option_is_answered_with_the_nearest():
    with pytest.raises(
        ValueError, match=r"unknown option 'guidence'\. Did you mean 'guidance'\? Known options: guidance, "
    ):
        require_known({"guidence": "1"}, ("guidance", "steps"))
    require_known({"steps": "1"}, ("guidance", "steps"))
