"""The solver: noise is moved until the motion decoded from it meets its objective.

Source: docs/specification/dno.md#the-optimiser.

Nothing couples the sequences of a batch: each has its own gradient length, its own random stream and its own end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench_adapters.diffusion.noise_optimisation.objective import Joints, Losses, Objective, Targets
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings
from prbench_adapters.diffusion.noise_optimisation.solver import (
    AdamState,
    DecorrelationPadding,
    learning_rate_factor,
    unit_gradient,
)

_TERMS = ("minimised", "initial", "goal", "jerk", "decorrelation", "gradient_norm")
Noise = Float[torch.Tensor, "batch frames features"]
Index = Int[torch.Tensor, " kept"]


@dataclass(frozen=True)
class History:
    """Scalars of every iteration; NaN where a sequence was finished. Iterates themselves are not kept.

    Row i is measured before the i-th step of the optimiser.
    """

    minimised: Float[np.ndarray, "iterations batch"]
    """The objective with its weighted terms, without decorrelation."""
    initial: Float[np.ndarray, "iterations batch"]
    goal: Float[np.ndarray, "iterations batch"]
    jerk: Float[np.ndarray, "iterations batch"]
    decorrelation: Float[np.ndarray, "iterations batch"]
    gradient_norm: Float[np.ndarray, "iterations batch"]
    """Length of the gradient of all terms before it is brought to 1."""
    learning_rate: Float[np.ndarray, " iterations"]

    @classmethod
    def empty(cls, iterations: int, batch: int) -> History:
        """A history of NaN."""
        return cls(
            **{name: np.full((iterations, batch), np.nan) for name in _TERMS},
            learning_rate=np.full(iterations, np.nan),
        )

    def put_rows(self, rows: np.ndarray, other: History) -> None:
        """Take the columns of another history of as many iterations."""
        for name in _TERMS:
            getattr(self, name)[:, rows] = getattr(other, name)
        done = ~np.isnan(other.learning_rate)
        self.learning_rate[done] = other.learning_rate[done]


@dataclass(frozen=True)
class OptimisedMotions:
    """Optimised motions of B sequences, in the order in which they were given."""

    joints: Float[torch.Tensor, "batch frames 22 3"]
    """Canonical frame, metres; decoded from ``noise`` by as many steps as it was optimised with."""
    noise: Float[torch.Tensor, "batch frames features"]
    n_frames: Int[torch.Tensor, " batch"]
    initial: Float[torch.Tensor, " batch"]
    """L_init of ``joints``, m²."""
    goal: Float[torch.Tensor, " batch"]
    """L_goal of ``joints``, m²."""
    jerk: Float[torch.Tensor, " batch"]
    """L_jerk of ``joints``, metres per frame³."""
    network_passes: Int[torch.Tensor, " batch"]
    """Forward passes of the denoiser spent on each sequence, guidance and recomputed ones included."""
    iterations: Int[torch.Tensor, " batch"]
    history: History


@runtime_checkable
class NoiseDecoder(Protocol):
    """A deterministic, differentiable map from noise to motions."""

    @property
    def network_passes(self) -> int:
        """Forward passes of the network so far, a sequence; recomputation in a backward pass counts."""
        ...

    def __call__(self, noise: Noise) -> Joints:
        """Joints of every sequence, canonical frame, metres."""
        ...

    def rows(self, index: Index) -> NoiseDecoder:
        """The map for some of the sequences, counting on the same counter."""
        ...


@dataclass(frozen=True)
class _Active:
    """The sequences that are still being optimised."""

    rows: Index
    """Their places in the batch that was given."""
    decoder: NoiseDecoder
    noise: Noise
    n_frames: Int[torch.Tensor, " kept"]
    targets: Targets
    adam: AdamState
    padding: DecorrelationPadding

    def part(self, kept: Index) -> _Active:
        """Keep the sequences at the places ``kept`` among the active ones; the others are finished."""
        return _Active(
            self.rows[kept],
            self.decoder.rows(kept),
            self.noise[kept],
            self.n_frames[kept],
            self.targets.rows(kept),
            self.adam.rows(kept),
            self.padding.rows(kept.tolist()),
        )


@dataclass(frozen=True)
class _Evaluation:
    """One forward and backward pass of all active sequences."""

    joints: Joints
    losses: Losses
    decorrelation: Float[torch.Tensor, " kept"]
    gradient: Noise


def optimise(
    decoder: NoiseDecoder,
    objective: Objective,
    targets: Targets,
    noise: Noise,
    n_frames: Int[torch.Tensor, " batch"],
    seeds: Sequence[int],
    settings: OptimisationSettings,
) -> OptimisedMotions:
    """Optimise the noise of each sequence by Adam on unit gradients with warm-up and cosine.

    Args:
        decoder: The map whose input is sought; it must not depend on what lies behind a sequence's end.
        objective: What is minimised, decorrelation apart.
        targets: What each motion is asked for.
        noise: Start, normally distributed.
        n_frames: Frames of each sequence.
        seeds: One per sequence: its own random stream, for the padding of the decorrelation loss.
        settings: Everything else.

    Returns:
        The motions decoded from the last noise, or from the best one, as ``settings.keep`` says.
    """
    search = _Search(objective, settings, noise, n_frames)
    everything = torch.arange(len(noise), device=noise.device)
    active = _Active(
        everything,
        decoder,
        noise.detach(),
        n_frames,
        targets,
        AdamState.start(noise),
        DecorrelationPadding(seeds, n_frames),
    )
    for iteration in range(settings.iterations):
        active = search.iterate(active, iteration)
        if not len(active.rows):
            break
    search.finish(active)
    return search.result()


class _Search:
    """The course of one optimisation, and the best that it has seen of each sequence."""

    def __init__(
        self, objective: Objective, settings: OptimisationSettings, noise: Noise, n_frames: Int[torch.Tensor, " batch"]
    ) -> None:
        self._objective, self._settings, self._n_frames = objective, settings, n_frames
        batch, frames = noise.shape[:2]
        self._noise = noise.detach().clone()
        self._joints = noise.new_zeros((batch, frames, 22, 3))
        self._kept = {name: noise.new_full((batch,), torch.inf) for name in ("initial", "goal", "jerk")}
        self._passes = torch.zeros(batch, dtype=torch.int64, device=noise.device)
        self._iterations = torch.zeros(batch, dtype=torch.int64, device=noise.device)
        self._history = History.empty(settings.iterations, batch)

    def iterate(self, active: _Active, iteration: int) -> _Active:
        """Evaluate all active sequences, let the finished ones go and move the others."""
        settings = self._settings
        before = active.decoder.network_passes
        found = self._evaluate(active)
        self._passes[active.rows] += active.decoder.network_passes - before
        self._iterations[active.rows] += 1
        # A length of 1 makes the learning rate the same for every sequence, whatever its loss.
        gradient, lengths = unit_gradient(found.gradient)
        factor = learning_rate_factor(iteration, warmup=settings.warmup, iterations=settings.iterations)
        self._write_history(iteration, active, found, lengths, settings.learning_rate * factor)
        finished = self._finished(found.losses)
        if settings.keep == "best":
            self._offer(active.rows, active.noise, found.joints, found.losses)
        elif finished.any():
            self._take(active.rows, finished, active.noise, found.joints, found.losses)
        moved, adam = active.adam.stepped(
            active.noise, gradient if settings.unit_gradient else found.gradient, settings.learning_rate * factor
        )
        active = _Active(active.rows, active.decoder, moved, active.n_frames, active.targets, adam, active.padding)
        return active.part((~finished).nonzero()[:, 0]) if finished.any() else active

    def finish(self, active: _Active) -> None:
        """Decode the last noise of the sequences that were never finished."""
        if not len(active.rows):
            return
        before = active.decoder.network_passes
        with torch.no_grad():
            joints = active.decoder(active.noise)
            losses = self._objective(joints, active.n_frames, active.targets)
        self._passes[active.rows] += active.decoder.network_passes - before
        if self._settings.keep == "best":
            self._offer(active.rows, active.noise, joints, losses)
        else:
            everything = torch.ones_like(active.rows, dtype=torch.bool)
            self._take(active.rows, everything, active.noise, joints, losses)

    def result(self) -> OptimisedMotions:
        """Return what was kept of every sequence, in the order given."""
        return OptimisedMotions(
            joints=self._joints,
            noise=self._noise,
            n_frames=self._n_frames,
            initial=self._kept["initial"],
            goal=self._kept["goal"],
            jerk=self._kept["jerk"],
            network_passes=self._passes,
            iterations=self._iterations,
            history=self._history,
        )

    def _evaluate(self, active: _Active) -> _Evaluation:
        # A fresh leaf in every iteration, so that no graph outlives it.
        noise = active.noise.detach().requires_grad_()
        joints = active.decoder(noise)
        losses = self._objective(joints, active.n_frames, active.targets)
        minimised = losses.minimised
        decorrelation = torch.zeros_like(minimised)
        if self._settings.decorrelation_weight:
            decorrelation = active.padding.loss(noise)
            minimised = minimised + self._settings.decorrelation_weight * decorrelation
        (gradient,) = torch.autograd.grad(minimised.sum(), noise)
        return _Evaluation(joints.detach(), losses, decorrelation.detach(), gradient)

    def _finished(self, losses: Losses) -> torch.Tensor:
        if self._settings.stop_below is None:
            return torch.zeros_like(losses.goal, dtype=torch.bool)
        return (losses.initial < self._settings.stop_below) & (losses.goal < self._settings.stop_below)

    def _offer(self, rows: Index, noise: Noise, joints: Joints, losses: Losses) -> None:
        """Keep the iterates that have a lower initial plus goal loss than any before."""
        before = self._kept["initial"][rows] + self._kept["goal"][rows]
        # Written as `not worse`, because a comparison with NaN is always false.
        better = ~(losses.initial + losses.goal >= before)  # NaN counts, so that it is never hidden
        self._take(rows, better, noise, joints, losses)

    def _take(self, rows: Index, chosen: torch.Tensor, noise: Noise, joints: Joints, losses: Losses) -> None:
        places = rows[chosen]
        self._noise[places] = noise[chosen]
        self._joints[places] = joints[chosen]
        for name, kept in self._kept.items():
            kept[places] = getattr(losses, name).detach()[chosen]

    def _write_history(
        self, iteration: int, active: _Active, found: _Evaluation, lengths: torch.Tensor, learning_rate: float
    ) -> None:
        rows = active.rows.cpu().numpy()
        values = {
            "minimised": found.losses.minimised,
            "initial": found.losses.initial,
            "goal": found.losses.goal,
            "jerk": found.losses.jerk,
            "decorrelation": found.decorrelation,
            "gradient_norm": lengths,
        }
        for name, value in values.items():
            getattr(self._history, name)[iteration, rows] = value.detach().cpu().numpy()
        self._history.learning_rate[iteration] = learning_rate
