from __future__ import annotations

import numpy as np
import torch

from prbench.randomness import sequence_generator
from prbench_adapters.diffusion.noise import SequenceNoise, start_noise


def test_the_noise_of_a_sequence_depends_on_its_seed_alone():
    alone = start_noise([7], np.array([5]))[0]
    first, second = start_noise([9, 7], np.array([8, 5])), start_noise([7, 9], np.array([5, 8]))
    assert torch.equal(first[1, :5], alone)
    assert torch.equal(second[0, :5], alone)
    assert torch.equal(second[1], first[0])
    assert not torch.equal(first[0, :5], alone)


def test_the_noise_is_that_of_the_sequences_generator_and_padding_is_zero():
    noise = SequenceNoise([3, 4], np.array([2, 4]))
    first, second = noise.draw(), noise.draw()
    generator = sequence_generator(3)
    for drawn in (first, second):
        expected = generator.standard_normal((2, 263), dtype=np.float32)
        assert np.array_equal(drawn[0, :2].numpy(), expected)
        assert not drawn[0, 2:].any()


def test_a_longer_sequence_of_the_same_seed_begins_alike():
    assert torch.equal(start_noise([5], np.array([9]))[0, :4], start_noise([5], np.array([4]))[0])


def test_the_noise_is_standard_normal():
    noise = start_noise([1, 2], np.array([200, 200]))
    assert abs(float(noise.mean())) < 0.01
    assert abs(float(noise.std()) - 1) < 0.01
    assert abs(float((noise[0] * noise[1]).mean())) < 0.01
