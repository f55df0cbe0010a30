"""Motions for a batch of conditions by noise optimisation through an unrolled chain: the way of DNO, and of P&R."""

from __future__ import annotations

import copy
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import nn

from prbench.contract import ConditionBatch, Cost, Motions
from prbench_adapters.diffusion.configuration import EncodedCondition
from prbench_adapters.diffusion.denoiser import Denoiser, FrameDenoiser
from prbench_adapters.diffusion.generation import (
    Guided,
    ModelBodies,
    bone_lengths,
    parts_of_similar_length,
    require_lengths,
    start_noise,
    with_bone_lengths,
)
from prbench_adapters.diffusion.model import MotionModel, led_to_goal
from prbench_adapters.diffusion.noise_optimisation.optimise import (
    History,
    Joints,
    NoiseDecoder,
    ObjectiveFromSettings,
    OptimisedMotions,
    Targets,
    optimise,
    prime_and_reach,
)
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddim

Noise = Float[torch.Tensor, "batch frames features"]
Network = TypeVar("Network", bound=Denoiser | FrameDenoiser)
_COMPILED: weakref.WeakKeyDictionary[nn.Module, Any] = weakref.WeakKeyDictionary()


@runtime_checkable
class FrozenModel(Protocol):
    """The part of a ``MotionModel`` that the optimisation needs."""

    @property
    def denoiser(self) -> Denoiser | FrameDenoiser:
        """The network, in evaluation mode, its weights without gradients."""
        ...

    def joints(self, normalised: Noise, condition: EncodedCondition, n_frames: Int[torch.Tensor, " batch"]) -> Joints:
        """Joints of standardised features, canonical frame, metres."""
        ...


@dataclass
class _Counter:
    passes: int = 0


class UnrolledChain:
    """Noise to joints by ``settings.ddim_steps`` DDIM steps with all gradients kept.

    What the network takes from condition and step is computed once for each kept step and used in every iteration.
    Activations of ``settings.checkpointing`` steps at a time are computed again in the backward pass.

    Args:
        model: Frozen.
        condition: B rows, on the device of the model.
        n_frames: Frames of each sequence, on the CPU.
        settings: Steps, guidance, precision and checkpointing are taken from here.
    """

    def __init__(
        self,
        model: FrozenModel,
        condition: EncodedCondition,
        n_frames: Int[torch.Tensor, " batch"],
        settings: OptimisationSettings,
        *,
        counter: _Counter | None = None,
    ) -> None:
        self._model, self._condition, self._n_frames = model, condition, n_frames
        self._settings, self._counter = settings, counter or _Counter()
        self._schedule = CosineSchedule(model.denoiser.configuration.diffusion_steps)
        denoiser = compiled(model.denoiser) if settings.compiled else model.denoiser
        self._guided = Guided(
            denoiser, condition, n_frames, settings.guidance, reuse=True, precision=settings.precision
        )

    @property
    def network_passes(self) -> int:
        """Forward passes so far, a sequence: two a step with guidance, and those that are computed again."""
        return self._counter.passes

    def __call__(self, noise: Noise) -> Joints:
        """Joints of every sequence, canonical frame, metres."""
        settings = self._settings
        clean = sample_ddim(
            self._denoise,
            self._schedule,
            noise,
            steps=settings.ddim_steps,
            spacing=settings.spacing,
            checkpointing=settings.checkpointing,
        )
        return self._model.joints(clean, self._condition, self._n_frames)

    def rows(self, index: Int[torch.Tensor, " kept"]) -> UnrolledChain:
        """The chain of some of the sequences; passes are counted together."""
        return UnrolledChain(
            self._model,
            self._condition.rows(index),
            self._n_frames[index.cpu()],
            self._settings,
            counter=self._counter,
        )

    def _denoise(self, noisy: Noise, step: int) -> Noise:
        self._counter.passes += 2 if self._guided.doubled else 1
        return self._guided(noisy, step)


class OnOwnBones:
    """A decoder whose motions keep bone lengths that are given (:mod:`prbench_adapters.diffusion.generation`).

    Args:
        decoder: Whose motions.
        lengths: Of each sequence's bones, metres.
    """

    def __init__(self, decoder: NoiseDecoder, lengths: Float[torch.Tensor, "batch 21"]) -> None:
        self._decoder, self._lengths = decoder, lengths

    @property
    def network_passes(self) -> int:
        """Passes of the decoder."""
        return self._decoder.network_passes

    def __call__(self, noise: Noise) -> Joints:
        """Joints of every sequence, canonical frame, metres."""
        return with_bone_lengths(self._decoder(noise), self._lengths)

    def rows(self, index: Int[torch.Tensor, " kept"]) -> OnOwnBones:
        """The same for some of the sequences."""
        return OnOwnBones(self._decoder.rows(index), self._lengths[index])


def compiled(denoiser: Network) -> Network:
    """Send the passes of a network through ``torch.compile``, for any batch and length; compiled at most once.

    Weights are shared. The first pass takes a minute or more, and on a processor needs a C++ compiler.
    """
    if denoiser not in _COMPILED:
        twin = copy.copy(denoiser)  # shares parameters and buffers
        object.__setattr__(twin, "denoise", torch.compile(denoiser.denoise, dynamic=True))
        _COMPILED[denoiser] = twin
    return _COMPILED[denoiser]


def optimise_noise(
    model: FrozenModel,
    condition: EncodedCondition,
    targets: Targets,
    n_frames: Int[torch.Tensor, " batch"],
    noise: Float[torch.Tensor, "batch frames features"],
    settings: OptimisationSettings,
    *,
    seeds: Sequence[int],
    objective: ObjectiveFromSettings = prime_and_reach,
) -> OptimisedMotions:
    """Optimise the noise of B sequences, in parts of similar length.

    Args:
        model: The frozen model.
        condition: What the network is conditioned on.
        targets: What the motions are asked for, on the device of ``noise``.
        n_frames: Frames of each sequence; on the CPU, so that the host never waits for them.
        noise: Start noise of each sequence, normally distributed.
        settings: A preset of :mod:`~prbench_adapters.diffusion.noise_optimisation.settings`, changed or not.
        seeds: One per sequence, usually its ``noise_seed``.
        objective: What is minimised: the paper's losses, or DNO's ``keyframes``.
    """
    parts = []
    for rows in parts_of_similar_length(n_frames.numpy(), settings.batch_size):
        lengths = n_frames[torch.as_tensor(rows)]
        index = torch.as_tensor(rows, device=noise.device)
        wanted = targets.rows(index)
        # A chain for each part, because the condition is prepared for its rows once and for all iterations.
        decoder: NoiseDecoder = UnrolledChain(model, condition.rows(index), lengths, settings)
        if settings.bones == "initial":
            decoder = OnOwnBones(decoder, bone_lengths(wanted.initial_joints))
        part = optimise(
            decoder,
            objective(settings),
            wanted,
            noise[index, : int(lengths.max())],
            lengths.to(noise.device),
            [seeds[row] for row in rows],
            settings,
        )
        parts.append((rows, part))
    batch, frames = noise.shape[:2]
    joints = noise.new_zeros((batch, frames, 22, 3))
    found = noise.clone()
    initial, goal, jerk = (noise.new_zeros(batch) for _ in range(3))
    passes, iterations = (torch.zeros(batch, dtype=torch.int64) for _ in range(2))
    history = History.empty(settings.iterations, batch)
    for rows, part in parts:
        own = part.joints.shape[1]
        joints[rows, :own], found[rows, :own] = part.joints, part.noise
        initial[rows], goal[rows], jerk[rows] = part.initial, part.goal, part.jerk
        passes[rows], iterations[rows] = part.network_passes.cpu(), part.iterations.cpu()
        history.put_rows(rows, part.history)
    return OptimisedMotions(joints, found, n_frames, initial, goal, jerk, passes, iterations, history)


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
    require_lengths(batch, model.configuration.max_frames)
    bodies = ModelBodies.of(batch, model.configuration)
    found = optimise_batch(model, bodies.batch, settings, objective=objective, texts=texts)
    joints = found.joints
    if settings.reach == "goal" and batch.goal_location is not None:
        joints = led_to_goal(model, joints, model.encode(bodies.batch, texts=texts), found.n_frames)
    cost = Cost(network_passes=int(found.network_passes.sum()))
    return Motions(bodies.own(joints.cpu().numpy()), batch.n_frames, cost)


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
        start_noise(batch.noise_seed, batch.n_frames, model.device, columns=model.configuration.n_features),
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
