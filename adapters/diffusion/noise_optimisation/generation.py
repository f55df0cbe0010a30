"""From a batch of conditions to motions by noise optimisation: the way of DNO, and of P&R."""

from __future__ import annotations

import numpy as np
import torch

from prbench.contract import ConditionBatch, Cost, Motions
from prbench_adapters.diffusion.generation import require_lengths
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.noise import start_noise
from prbench_adapters.diffusion.noise_optimisation.entry import optimise_noise
from prbench_adapters.diffusion.noise_optimisation.objective import ObjectiveFromSettings, Targets, prime_and_reach
from prbench_adapters.diffusion.noise_optimisation.result import OptimisedMotions
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings
from prbench_adapters.diffusion.skeletons import ModelBodies


def generate_optimised(
    model: MotionModel,
    batch: ConditionBatch,
    settings: OptimisationSettings,
    *,
    objective: ObjectiveFromSettings = prime_and_reach,
    texts: tuple[str, ...] | None = None,
) -> Motions:
    """Sample one motion for each row and optimise its noise.

    Args:
        model: The frozen model.
        batch: Conditions with an initial state and a goal.
        settings: Of the optimisation.
        objective: What is minimised: the paper's losses, or DNO's ``keyframes``.
        texts: Instead of the batch's own.

    Raises:
        AdapterError: if a sequence is longer than the model knows.
    """
    require_lengths(batch, model)
    bodies = ModelBodies.of(batch, model.configuration)
    found = optimise_batch(model, bodies.batch, settings, objective=objective, texts=texts)
    cost = Cost(network_passes=int(found.network_passes.sum()))
    return Motions(bodies.own(found.joints.cpu().numpy()), batch.n_frames, cost)


def optimise_batch(
    model: MotionModel,
    batch: ConditionBatch,
    settings: OptimisationSettings,
    *,
    objective: ObjectiveFromSettings = prime_and_reach,
    texts: tuple[str, ...] | None = None,
) -> OptimisedMotions:
    """:func:`generate_optimised` with all that the optimisation reports; the batch is on the model's skeleton."""
    return optimise_noise(
        model,
        model.encode(batch, texts=texts),
        targets_of(batch, model.device),
        torch.as_tensor(batch.n_frames),
        start_noise(batch.noise_seed, batch.n_frames, model.device),
        settings,
        seeds=batch.noise_seed,
        objective=objective,
    )


def targets_of(batch: ConditionBatch, device: torch.device) -> Targets:
    """Initial state and goal of a batch as tensors.

    Raises:
        ValueError: if the batch has no initial state.
    """
    if batch.initial_joints is None or batch.previous_joints is None:
        raise ValueError(f"noise optimisation cannot use the condition '{batch.condition.value}'")
    return Targets(
        initial_joints=_tensor(batch.initial_joints, device),
        previous_joints=_tensor(batch.previous_joints, device),
        goal_joints=None if batch.goal_joints is None else _tensor(batch.goal_joints, device),
        goal_location=None if batch.goal_location is None else _tensor(batch.goal_location, device),
    )


def _tensor(values: np.ndarray, device: torch.device) -> torch.Tensor:
    return torch.as_tensor(values, dtype=torch.float32, device=device)
