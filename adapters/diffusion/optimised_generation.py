"""Motions for a batch of conditions by noise optimisation through an unrolled chain: the way of DNO, and of P&R."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import torch
from jaxtyping import Float, Int

from prbench.contract import ConditionBatch, Cost, Motions
from prbench_adapters.diffusion import generation, noise_optimisation
from prbench_adapters.diffusion.configuration import EncodedCondition
from prbench_adapters.diffusion.model import MotionModel, goal_frame
from prbench_adapters.diffusion.sampling import SCHEDULES, sample_ddim

Noise = Float[torch.Tensor, "batch frames features"]
Counts = Int[torch.Tensor, " batch"]


@dataclass
class UnrolledChain:
    """Noise to joints by ``settings.ddim_steps`` DDIM steps with all gradients kept.

    What the network takes from condition and step is computed once for each kept step and used in every iteration.
    Activations of ``settings.checkpointing`` steps at a time are computed again in the backward pass.

    Args:
        model: Frozen: its network and the joints of its features are taken from here.
        condition: B rows, on the device of the model.
        n_frames: Frames of each sequence, on the CPU.
        settings: Steps, guidance and checkpointing are taken from here.
        lengths: Lengths of each sequence's bones, metres, if the motions are to keep them.
        counter: Forward passes so far, one number.
    """

    model: Any
    condition: EncodedCondition
    n_frames: Counts
    settings: noise_optimisation.OptimisationSettings
    lengths: Float[torch.Tensor, "batch 21"] | None = None
    counter: list[int] = field(default_factory=lambda: [0])

    def __post_init__(self) -> None:
        denoiser, guidance = self.model.denoiser, self.settings.guidance
        shape = denoiser.configuration
        self._schedule = SCHEDULES[shape.noise_schedule](shape.diffusion_steps)
        self._guided = generation.Guided(denoiser, self.condition, self.n_frames, guidance, reuse=True)

    @property
    def network_passes(self) -> int:
        """Forward passes so far, a sequence: two a step with guidance, and those that are computed again."""
        return self.counter[0]

    def __call__(self, noise: Noise) -> noise_optimisation.Joints:
        """Joints of every sequence, canonical frame, metres."""
        walk = {name: getattr(self.settings, name) for name in ("spacing", "checkpointing")}
        clean = sample_ddim(self._denoise, self._schedule, noise, steps=self.settings.ddim_steps, **walk)
        joints = self.model.joints(clean, self.condition, self.n_frames, parts=self.settings.parts)
        return joints if self.lengths is None else generation.with_bone_lengths(joints, self.lengths)

    def rows(self, index: Int[torch.Tensor, " kept"]) -> UnrolledChain:
        """Return the chain of some of the sequences; passes are counted together."""
        lengths = None if self.lengths is None else self.lengths[index]
        return replace(self, condition=self.condition.rows(index), n_frames=self.n_frames[index.cpu()], lengths=lengths)

    def _denoise(self, noisy: Noise, step: int) -> Noise:
        self.counter[0] += 2 if self._guided.doubled else 1
        return self._guided(noisy, step)


def optimise_noise(
    model: Any,
    condition: EncodedCondition,
    targets: noise_optimisation.Targets,
    n_frames: Counts,
    noise: Noise,
    settings: noise_optimisation.OptimisationSettings,
    *,
    seeds: Sequence[int],
    objective: noise_optimisation.Objective = noise_optimisation.prime_and_reach,
    watch: noise_optimisation.Watch | None = None,
) -> noise_optimisation.OptimisedMotions:
    """Optimise the noise of B sequences, in parts of similar length.

    Args:
        model: The frozen model.
        condition: What the network is conditioned on.
        targets: What the motions are asked for, on the device of ``noise``.
        n_frames: Frames of each sequence; on the CPU, so that the host never waits for them.
        noise: Start noise of each sequence, normally distributed.
        settings: A preset of :mod:`~prbench_adapters.diffusion.noise_optimisation`, changed or not.
        seeds: One per sequence, usually its ``noise_seed``.
        objective: What is minimised: the paper's losses, or DNO's ``keyframes``.
        watch: Called in every iteration of each part.
    """
    batch, frames = noise.shape[:2]
    joints, passes = noise.new_zeros((batch, frames, 22, 3)), torch.zeros(batch, dtype=torch.int64)
    initial, goal = noise.new_zeros(batch), noise.new_zeros(batch)
    found = noise_optimisation.OptimisedMotions(joints, noise.clone(), initial, goal, passes)
    for rows in generation.parts_of_similar_length(n_frames.numpy(), settings.batch_size):
        own = n_frames[torch.as_tensor(rows)]
        index = torch.as_tensor(rows, device=noise.device)
        wanted = targets.rows(index)
        bones = generation.bone_lengths(wanted.initial_joints) if settings.bones == "initial" else None
        # A chain for each part, because the condition is prepared for its rows once and for all iterations.
        chain = UnrolledChain(model, condition.rows(index), own, settings, lengths=bones)
        start = noise[index, : int(own.max())]
        seeds_here = [seeds[row] for row in rows]
        lengths = own.to(noise.device)
        part = noise_optimisation.optimise(chain, objective, wanted, start, lengths, seeds_here, settings, watch=watch)
        found.joints[rows, : start.shape[1]] = part.joints
        found.noise[rows, : start.shape[1]] = part.noise
        found.initial[rows], found.goal[rows] = part.initial, part.goal
        found.network_passes[rows] = part.network_passes.cpu()
    return found


def generate_optimised(
    model: MotionModel,
    batch: ConditionBatch,
    settings: noise_optimisation.OptimisationSettings,
    *,
    objective: noise_optimisation.Objective = noise_optimisation.prime_and_reach,
    texts: tuple[str, ...] | None = None,
) -> Motions:
    """Sample one motion for each row and optimise its noise.

    Args:
        model: The frozen model.
        batch: Conditions with an initial state and a goal.
        settings: Settings of the optimisation.
        objective: What is minimised: the paper's losses, or DNO's ``keyframes``.
        texts: Instead of the batch's own.

    Raises:
        AdapterError: if a sequence is longer than the model knows.
    """
    generation.require_lengths(batch, model.configuration.max_frames)
    bodies = generation.ModelBodies.of(batch, model.configuration)
    condition = model.encode(bodies.batch, texts=texts)
    n_frames = torch.as_tensor(batch.n_frames)
    targets, seeds, columns = targets_of(bodies.batch, model.device), batch.noise_seed, model.configuration.n_features
    noise = generation.start_noise(seeds, batch.n_frames, model.device, columns=columns)
    found = optimise_noise(model, condition, targets, n_frames, noise, settings, seeds=seeds, objective=objective)
    joints = found.joints
    if settings.reach == "goal" and batch.goal_location is not None:
        frame = goal_frame(condition, joints)
        joints = frame.led_to_goal(joints, n_frames, model.configuration.fps, parts=settings.parts)
    cost = Cost(network_passes=int(found.network_passes.sum()))
    return Motions(bodies.own(joints.cpu().numpy()), batch.n_frames, cost)


def targets_of(batch: ConditionBatch, device: torch.device) -> noise_optimisation.Targets:
    """Return initial state and goal of a batch as tensors.

    Raises:
        ValueError: if the batch has no initial state.
    """
    if batch.initial_joints is None:
        raise ValueError(f"noise optimisation cannot use the condition '{batch.condition.value}'")
    names = ("initial_joints", "goal_joints", "goal_location")
    given = {name: value for name in names if (value := getattr(batch, name)) is not None}
    tensor = partial(torch.as_tensor, dtype=torch.float32, device=device)
    return noise_optimisation.Targets(**{name: tensor(value) for name, value in given.items()})
