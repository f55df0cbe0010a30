"""A WANDR network of random weights that is quick to run, as a network and as a weights file."""

from __future__ import annotations

from pathlib import Path

import torch

from prbench.contract import Condition, ConditionBatch
from prbench_adapters.training.weights import write_weights
from prbench_adapters.wandr.network import WandrConfiguration, WandrNetwork, contents
from tests.adapters.diffusion.goal_batches import conditions

TINY = {"layers": 3, "widest": 32, "latent": 8}
_STANDING_STILL = torch.tensor([1.0, 0, 0, 0, 1, 0]).repeat(22)


def network(*, seed: int = 0, **changes: object) -> WandrNetwork:
    """In evaluation mode; its changes are small ones around standing still."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        made = WandrNetwork(WandrConfiguration(**{**TINY, **changes}))
    made.delta.mean[3:] = _STANDING_STILL
    made.delta.std[:] = 0.02
    made.seen.std[:] = 0.5
    return made.eval().requires_grad_(False)


def write(path: Path, *, seed: int = 0, metadata: dict[str, str] | None = None, **changes: object) -> Path:
    """The same as a weights file."""
    tensors, header = contents(network(seed=seed, **changes))
    write_weights(path, tensors, {**header, **(metadata or {})}, {})
    return path


def batch(n: int = 3, *, frames: tuple[int, ...] = (24, 17, 30)) -> ConditionBatch:
    """People with goals, at the rate of the network."""
    from dataclasses import replace

    return replace(conditions(Condition.GOAL_LOCATION, n, frames=frames), fps=30.0)
