from __future__ import annotations

import pytest
import torch

from prbench_adapters.diffusion.generation import Guided
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddim
from tests.adapters.diffusion import golden

NAMES = ["mdm_encoder", "mdm_decoder_one_token", "mdm_decoder_word_tokens"]
TOLERANCE = 5e-6


@pytest.fixture(params=NAMES)
def arrays(request, samples):
    return golden.load(samples, request.param)


def _assert_valid_frames_equal(actual, expected, lengths):
    for row, n in enumerate(lengths):
        torch.testing.assert_close(actual[row, :n], expected[row, :n], rtol=0, atol=TOLERANCE)


def test_a_pass_gives_the_clean_features_of_the_reference(arrays):
    network = golden.denoiser(arrays)
    lengths = torch.from_numpy(arrays["lengths"])
    clean = network(golden.features(arrays["x"]), torch.from_numpy(arrays["t"]), golden.condition(arrays), lengths)
    _assert_valid_frames_equal(clean, golden.features(arrays["x0"]), lengths)


def test_a_guided_pass_gives_the_clean_features_of_the_reference(arrays):
    """The file has another step in each row, so each row is guided by itself."""
    network, condition = golden.denoiser(arrays), golden.condition(arrays)
    noisy, expected = golden.features(arrays["x"]), golden.features(arrays["x0_guided"])
    lengths = torch.from_numpy(arrays["lengths"])
    for row in range(2):
        one = slice(row, row + 1)
        denoise = Guided(network, condition.rows(one), lengths[one], 2.5)
        _assert_valid_frames_equal(denoise(noisy[one], int(arrays["t"][row])), expected[one], lengths[one])


@pytest.mark.parametrize("reuse", [False, True])
def test_ten_guided_ddim_steps_give_the_features_of_the_reference(arrays, reuse):
    lengths = torch.from_numpy(arrays["lengths"])
    denoise = Guided(golden.denoiser(arrays), golden.condition(arrays), lengths, 2.5, reuse=reuse)
    clean = sample_ddim(denoise, CosineSchedule(10), golden.features(arrays["z"]))
    _assert_valid_frames_equal(clean, golden.features(arrays["ddim10_guided"]), lengths)
    assert denoise.passes == 10 * 2 * 2
