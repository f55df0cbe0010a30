"""From a batch of conditions to motions whose starting noise is optimised towards first pose and goal."""

from __future__ import annotations

import numpy as np
import torch
from prbench_adapters.diffusion.generation import require_lengths
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.noise import start_noise
from prbench_adapters.diffusion.noise_optimisation import OptimisationSettings, Targets, optimise_noise
from prbench_adapters.diffusion.skeletons import ModelBodies

from prbench.contract import ConditionBatch, Cost, Motions


def generate_optimised(model: MotionModel, batch: ConditionBatch, settings: OptimisationSettings) -> Motions:
    """Generate one motion for each row (*Prime and Reach*, section 4.2; ``methods/pr-model.md`` section 6).

    Raises:
        AdapterError: if a sequence is longer than the model knows.
    """
    require_lengths(batch, model)
    bodies = ModelBodies.of(batch, model.configuration)
    found = optimise_noise(
        model,
        model.encode(bodies.batch),
        targets_of(bodies.batch, model.device),
        torch.as_tensor(batch.n_frames),
        start_noise(batch.noise_seed, batch.n_frames, model.device),
        settings,
        seeds=batch.noise_seed,
    )
    joints = bodies.own(found.joints.detach().cpu().numpy().astype(np.float32))
    return Motions(joints, batch.n_frames, Cost(int(found.network_passes.sum())))


def targets_of(batch: ConditionBatch, device: torch.device) -> Targets:
    """First frame, the frame before it, and the goal, as tensors."""
    names = ("initial_joints", "previous_joints", "goal_joints", "goal_location")
    given = {name: getattr(batch, name) for name in names if getattr(batch, name) is not None}
    return Targets(
        **{name: torch.as_tensor(value, dtype=torch.float32, device=device) for name, value in given.items()}
    )
