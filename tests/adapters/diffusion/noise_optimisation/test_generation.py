from __future__ import annotations

import numpy as np
import torch

from prbench_adapters.diffusion.generation import start_noise
from prbench_adapters.diffusion.noise_optimisation import OptimisationSettings, Targets
from prbench_adapters.diffusion.optimised_generation import optimise_noise
from tests.adapters.diffusion import tiny

SETTINGS = OptimisationSettings(ddim_steps=2, iterations=4, warmup=1, decorrelation_weight=100.0, batch_size=2)
LENGTHS, SEEDS = [30, 9, 12, 31], [7, 3, 5, 2]


def _solve(rows):
    model = tiny.model()
    n_frames = [LENGTHS[row] for row in rows]
    seeds = tuple(SEEDS[row] for row in rows)
    locations = torch.tensor([[0.1 * row, 1.0, 0.2] for row in rows])
    initial = torch.zeros(len(rows), 22, 3)
    return optimise_noise(
        model,
        model.encode(tiny.text_batch(n_frames), texts=tuple(tiny.TEXTS[row % 2] for row in rows)),
        Targets(initial_joints=initial, previous_joints=initial, goal_location=locations),
        torch.tensor(n_frames),
        start_noise(seeds, np.array(n_frames)),
        SETTINGS,
        seeds=seeds,
    )


def test_every_sequence_gets_what_it_would_get_alone_in_the_order_given():
    together = _solve([0, 1, 2, 3])
    for row, length in enumerate(LENGTHS):
        alone = _solve([row])
        torch.testing.assert_close(together.joints[row, :length], alone.joints[0], rtol=0, atol=1e-4)
        torch.testing.assert_close(together.noise[row, :length], alone.noise[0], rtol=0, atol=1e-3)
        np.testing.assert_allclose(together.goal[row], alone.goal[0], rtol=1e-3)
    assert together.network_passes.tolist() == [2 * 5] * 4
