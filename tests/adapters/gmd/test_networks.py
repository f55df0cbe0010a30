"""Sizes, padding and the first step of the U-Nets."""

from __future__ import annotations

import pytest
import torch

from prbench_adapters.gmd.model import GMDConfiguration, GMDNetworks
from tests.adapters.gmd import tiny


def _inputs(frames: int = 12, batch: int = 2) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    noisy = torch.randn(batch, frames, 263, generator=generator)
    return noisy, torch.arange(batch), torch.randn(batch, 64, generator=generator)


def test_what_stands_behind_the_last_frame_leaves_no_trace():
    network, (noisy, step, text) = tiny.networks().motion, _inputs()
    n_frames = torch.tensor([12, 7])
    expected = network(noisy, step, text, n_frames, window=16)
    noisy[1, 7:] = 1e3
    found = network(noisy, step, text, n_frames, window=16)
    assert torch.equal(found[0], expected[0])
    assert torch.equal(found[1, :7], expected[1, :7])


def test_a_row_does_not_depend_on_how_long_its_mates_are():
    network, (noisy, step, text) = tiny.networks().motion, _inputs()
    together = network(noisy, step, text, torch.tensor([12, 7]), window=16)
    alone = network(noisy[1:, :7], step[1:], text[1:], torch.tensor([7]), window=16)
    assert torch.allclose(alone[0], together[1, :7], atol=1e-5)


def test_the_padded_length_changes_the_result():
    """Group normalisation takes its statistics over the padding; the length is therefore part of the model."""
    network, (noisy, step, text) = tiny.networks().motion, _inputs()
    n_frames = torch.tensor([12, 12])
    short, long = (network(noisy, step, text, n_frames, window=window) for window in (16, 64))
    assert (short - long).abs().max() > 1e-3


def test_text_and_step_reach_the_output():
    network, (noisy, step, text) = tiny.networks().motion, _inputs()
    n_frames = torch.tensor([12, 12])
    expected = network(noisy, step, text, n_frames, window=16)
    for changed in ((step, text + 1), (step + 20, text)):
        assert (network(noisy, *changed, n_frames, window=16) - expected).abs().max() > 1e-4


def test_before_training_blocks_pass_their_input_on():
    """Conditions and second convolutions start at zero: then text and step cannot reach the output."""
    torch.manual_seed(0)
    network, (noisy, step, text) = GMDNetworks(tiny.configuration()).motion, _inputs()
    n_frames = torch.tensor([12, 12])
    outputs = [network(noisy, step, words, n_frames, window=16) for words in (text, -text)]
    assert torch.equal(*outputs)


@pytest.mark.parametrize(
    ("n_frames", "padded", "step", "window"),
    [(40, 224, 8, 224), (224, 224, 8, 224), (225, 224, 8, 232), (241, 224, 8, 248), (65, 64, 32, 96)],
)
def test_motions_are_padded_to_one_length_and_longer_ones_as_little_as_possible(n_frames, padded, step, window):
    configuration = GMDConfiguration(padded_frames=padded, padding_step=step)
    assert configuration.window(n_frames) == window


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motion_widths": [12]}, "'motion_widths' must be one or more positive multiples of 8"),
        ({"trajectory_widths": []}, "'trajectory_widths' must be one or more"),
        ({"padded_frames": 100}, "'padded_frames' must be a multiple of 8"),
        ({"padding_step": 4}, "'padding_step' must be a multiple of 8"),
        ({"condition_width": 7}, "'condition_width' must be even"),
        ({"emphasis": 0.0}, "'emphasis' and 'fps' must be positive"),
        ({"diffusion_steps": 0}, "'diffusion_steps' must be at least 1"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        GMDConfiguration(**{name: tuple(v) if isinstance(v, list) else v for name, v in change.items()})
