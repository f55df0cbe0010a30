"""Gaze for finished motions of a batch: the joints stay as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from prbench.contract import ConditionBatch, Gaze, Motions
from prbench.harness.best_of import goal_of
from prbench.randomness import named_generator
from prbench_adapters.pr.gaze.network import GazeNetwork, Seen


def with_gaze(motions: Motions, batch: ConditionBatch, network: GazeNetwork) -> Motions:
    """Add gaze to motions.

    Args:
        motions: Canonical frame, metres.
        batch: What they were made from, with a goal; each row's ``noise_seed`` decides what its eyes do.
        network: In evaluation mode, in double precision.

    Returns:
        The same joints with one ray a frame; the cost is that of the motions and one pass for each frame.
    """
    weight = next(network.parameters())
    joints = torch.from_numpy(motions.joints).to(weight)
    n_frames = torch.from_numpy(np.asarray(motions.n_frames, dtype=np.int64)).to(weight.device)
    goal = torch.from_numpy(goal_of(batch)).to(weight)
    noise = np.stack([named_generator("prbench-gaze", seed).random((joints.shape[1], 3)) for seed in batch.noise_seed])
    with torch.no_grad():
        seen = Seen.of(joints, n_frames, goal, batch.fps)
        direction = network.sampled(seen, torch.from_numpy(noise).to(weight))
        origin = network.eyes(seen)
    gaze = Gaze(origin.cpu().numpy().astype(np.float32), direction.cpu().numpy().astype(np.float32))
    return replace(motions, gaze=gaze)
