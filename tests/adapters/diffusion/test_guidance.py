from __future__ import annotations

import dataclasses

import pytest
import torch

from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.guidance import guided
from tests.adapters.diffusion import tiny


@pytest.fixture
def network():
    return tiny.denoiser(goal="location").double()


def _condition(rows: int = 2) -> EncodedCondition:
    generator = torch.Generator().manual_seed(1)
    text = torch.randn((rows, 3, 64), generator=generator, dtype=torch.float64)
    padding = torch.tensor([[False, False, True], [False, False, False]])[:rows]
    return EncodedCondition(text, padding, torch.randn((rows, 135), generator=generator, dtype=torch.float64))


NOISY = torch.randn((2, 6, 263), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
N_FRAMES = torch.tensor([6, 4])


def test_one_pass_of_twice_the_batch_is_two_passes_combined(network):
    condition, step = _condition(), torch.tensor([3, 3])
    conditional = network(NOISY, step, condition, N_FRAMES)
    unconditional = network(NOISY, step, condition.without_text(), N_FRAMES)
    expected = unconditional + 2.5 * (conditional - unconditional)
    denoise = guided(network, condition, N_FRAMES, 2.5)
    torch.testing.assert_close(denoise(NOISY, 3), expected, rtol=0, atol=1e-12)
    assert (conditional - unconditional).abs().max() > 1e-3


def test_the_unconditional_half_keeps_the_vector_and_the_padding():
    condition = _condition()
    silent = condition.without_text()
    assert not silent.text.any()
    assert silent.vector is condition.vector
    assert silent.padding is condition.padding


def test_without_guidance_there_is_one_pass(network):
    condition, calls = _condition(), []
    network.register_forward_hook(lambda *_: calls.append(1))
    denoise = guided(network, condition, N_FRAMES, 1.0)
    expected = network(NOISY, torch.tensor([3, 3]), condition, N_FRAMES)
    torch.testing.assert_close(denoise(NOISY, 3), expected, rtol=0, atol=1e-12)
    assert denoise.passes == 2


def test_passes_are_counted_by_sequence(network):
    denoise = guided(network, _condition(), N_FRAMES, 2.5)
    for step in (5, 3, 0):
        denoise(NOISY, step)
    assert denoise.passes == 3 * 2 * 2


def test_scale_zero_does_not_hear_the_text(network):
    condition = _condition()
    other = dataclasses.replace(condition, text=-condition.text)
    one, two = (guided(network, each, N_FRAMES, 0.0)(NOISY, 3) for each in (condition, other))
    torch.testing.assert_close(one, two, rtol=0, atol=1e-12)


def test_what_is_reused_gives_the_same_bytes_and_is_made_once_a_step(network, monkeypatch):
    prepared, prepare = [], network.prepare
    monkeypatch.setattr(network, "prepare", lambda *given: prepared.append(given) or prepare(*given))
    anew = guided(network, _condition(), N_FRAMES, 2.5)
    reusing = guided(network, _condition(), N_FRAMES, 2.5, reuse=True)
    for step in (3, 5, 3, 5, 3):
        assert torch.equal(anew(NOISY, step), reusing(NOISY, step))
    assert len(prepared) == 5 + 2


def test_conditions_with_and_without_a_vector_do_not_mix():
    condition = _condition()
    with pytest.raises(ValueError, match="cannot share a batch"):
        condition.then(dataclasses.replace(condition, vector=None))


def test_rows_of_a_condition_by_slice_list_and_tensor():
    condition = _condition()
    for index in (slice(1, 2), [1], torch.tensor([1])):
        row = condition.rows(index)
        assert len(row) == 1
        assert torch.equal(row.text[0], condition.text[1])
        assert torch.equal(row.padding[0], condition.padding[1])
        assert torch.equal(row.vector[0], condition.vector[1])


def test_bfloat16_is_inside_the_network_only():
    """What comes out is float32 that was computed more coarsely; nothing of it stays on."""
    network = tiny.denoiser(goal="location")
    condition = _condition()
    condition = EncodedCondition(condition.text.float(), condition.padding, condition.vector.float())
    plain, rough = (
        guided(network, condition, N_FRAMES, 2.5, precision=precision)(NOISY.float(), 3)
        for precision in ("float32", "bfloat16")
    )
    assert rough.dtype == torch.float32
    assert not torch.equal(rough, plain)
    torch.testing.assert_close(rough, plain, rtol=0, atol=0.1)
    assert not torch.is_autocast_enabled("cpu")
