"""Objectives of optimised motions, and the solver that moves noise until the motion decoded from it meets them.

Sources: docs/specification/dno.md#the-optimiser, docs/specification/dno.md#decorrelation-loss.

Every objective reports the same three losses in the same units, so that methods can be compared, beside the sum that
it minimises. Frames behind a sequence's end are never looked at. Nothing couples the sequences of a batch: each has its
own gradient length, its own random stream and its own end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.geometry.skeleton import Joint
from prbench.randomness import named_generator
from prbench_adapters.diffusion.noise_optimisation.settings import Hand, OptimisationSettings

Joints = Float[torch.Tensor, "batch frames 22 3"]
_PerSequence = Float[torch.Tensor, " batch"]

_SOFTNESS = 0.01  # m² of the soft minimum over wrists: 10 cm apart counts as a decision


@dataclass(frozen=True)
class Losses:
    """Losses of each sequence; only ``minimised`` carries gradients that matter."""

    minimised: _PerSequence
    """Weighted sum that the optimiser lowers, without decorrelation."""
    initial: _PerSequence
    """Mean over joints of the squared distance to the recorded first frame, m²."""
    goal: _PerSequence
    """The same for the goal pose, or the squared distance of the chosen wrist to the goal location, m²."""
    jerk: _PerSequence
    """Largest third difference over frames and joints, metres per frame³."""


@dataclass(frozen=True, kw_only=True)
class Targets:
    """Initial states and goals of B motions, canonical frame, metres; exactly one of the two goals is given."""

    initial_joints: Float[torch.Tensor, "batch 22 3"]
    previous_joints: Float[torch.Tensor, "batch 22 3"]
    goal_joints: Float[torch.Tensor, "batch 22 3"] | None = None
    goal_location: Float[torch.Tensor, "batch 3"] | None = None

    def __post_init__(self) -> None:
        if (self.goal_joints is None) is (self.goal_location is None):
            raise ValueError("a motion is asked for either a goal pose or a goal location")

    def rows(self, index: Int[torch.Tensor, " kept"]) -> Targets:
        """The targets of some of the sequences."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return Targets(**{name: value[index] for name, value in given.items() if value is not None})


@runtime_checkable
class Objective(Protocol):
    """Losses of motions against targets of the same batch."""

    def __call__(self, joints: Joints, n_frames: Int[torch.Tensor, " batch"], targets: Targets) -> Losses:
        """Losses of each sequence."""
        ...


@dataclass(frozen=True)
class PrimeAndReach:
    """L_init + L_goal + alpha L_jerk.

    Source: *Prime and Reach*, section 4.2; docs/specification/pr-model.md#latent-noise-optimisation.
    """

    jerk_weight: float = 0.5
    hand: Hand = "right"
    initial_velocity_weight: float = 0.0
    jerk_power: float | None = None
    """Minimise this power norm of all jerks instead of the largest one; None is the paper's maximum."""

    def __call__(self, joints: Joints, n_frames: Int[torch.Tensor, " batch"], targets: Targets) -> Losses:
        """Losses of each sequence; squared distances are averaged over joints, so that 1 joint weighs as much as 22."""
        initial = _squared_distance(joints[:, 0], targets.initial_joints)
        goal, pursued = _goal_losses(joints, n_frames, targets, self.hand)
        jerk = largest_jerk(joints, n_frames)
        smooth = jerk if self.jerk_power is None else jerk_norm(joints, n_frames, self.jerk_power)
        minimised = initial + pursued + self.jerk_weight * smooth
        if self.initial_velocity_weight:
            velocity = _squared_distance(joints[:, 1] - joints[:, 0], targets.initial_joints - targets.previous_joints)
            minimised = minimised + self.initial_velocity_weight * velocity
        return Losses(minimised, initial, goal, jerk)


@dataclass(frozen=True)
class Keyframes:
    """DNO's criterion: mean absolute error over the coordinates that are asked for.

    Source: docs/specification/dno.md#the-optimiser.

    Asked for are the first frame (with ``initial_frames=2`` also the second, continued at the initial velocity) and in
    the last frame all joints or one wrist; every coordinate weighs the same, as in the published solver.
    """

    hand: Hand = "right"
    initial_frames: int = 1

    def __call__(self, joints: Joints, n_frames: Int[torch.Tensor, " batch"], targets: Targets) -> Losses:
        """Losses of each sequence; ``minimised`` in metres."""
        last = last_frame(joints, n_frames)
        errors = [(joints[:, 0] - targets.initial_joints).abs().flatten(1)]
        if self.initial_frames == 2:
            continued = 2.0 * targets.initial_joints - targets.previous_joints
            errors.append((joints[:, 1] - continued).abs().flatten(1))
        if targets.goal_joints is not None:
            errors.append((last - targets.goal_joints).abs().flatten(1))
        else:
            wrist = chosen_wrist(last, _location(targets), self.hand)
            errors.append((wrist - _location(targets)).abs())
        return Losses(
            minimised=torch.cat(errors, dim=1).mean(dim=1),
            initial=_squared_distance(joints[:, 0], targets.initial_joints).detach(),
            goal=_goal_losses(joints, n_frames, targets, self.hand)[0].detach(),
            # Reported only, so no graph is kept for it.
            jerk=largest_jerk(joints.detach(), n_frames),
        )


ObjectiveFromSettings = Callable[[OptimisationSettings], Objective]


def prime_and_reach(settings: OptimisationSettings) -> Objective:
    """The paper's objective."""
    return PrimeAndReach(settings.jerk_weight, settings.hand, settings.initial_velocity_weight, settings.jerk_power)


def keyframes(settings: OptimisationSettings) -> Objective:
    """The DNO baseline's objective."""
    return Keyframes(settings.hand, settings.initial_frames)


def _goal_losses(
    joints: Joints, n_frames: Int[torch.Tensor, " batch"], targets: Targets, hand: Hand
) -> tuple[_PerSequence, _PerSequence]:
    """The goal loss as reported and as minimised, m²; they differ for ``hand="nearest"`` only.

    Reported is then the nearer wrist's squared distance, minimised a soft minimum that is never above it, whose
    gradient is shared between wrists that are about equally near.
    """
    last = last_frame(joints, n_frames)
    if targets.goal_joints is not None:
        loss = _squared_distance(last, targets.goal_joints)
        return loss, loss
    location = _location(targets)
    if hand != "nearest":
        loss = (chosen_wrist(last, location, hand) - location).square().sum(-1)
        return loss, loss
    both = last[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]]
    squared = (both - location[:, None]).square().sum(-1)
    return squared.amin(dim=1), -_SOFTNESS * torch.logsumexp(-squared / _SOFTNESS, dim=1)


def chosen_wrist(
    pose: Float[torch.Tensor, "batch 22 3"], location: Float[torch.Tensor, "batch 3"], hand: Hand
) -> Float[torch.Tensor, "batch 3"]:
    """Position of the wrist named by ``hand``, or of the one nearer to ``location``."""
    left = pose[:, Joint.LEFT_WRIST]
    right = pose[:, Joint.RIGHT_WRIST]
    if hand != "nearest":
        return left if hand == "left" else right
    left_nearer = (left - location).square().sum(-1) < (right - location).square().sum(-1)
    return torch.where(left_nearer[:, None], left, right)


def _squared_distance(
    predicted: Float[torch.Tensor, "batch 22 3"], wanted: Float[torch.Tensor, "batch 22 3"]
) -> _PerSequence:
    """Mean over joints of the squared distance, m²."""
    return (predicted - wanted).square().sum(-1).mean(-1)


def last_frame(joints: Joints, n_frames: Int[torch.Tensor, " batch"]) -> Float[torch.Tensor, "batch 22 3"]:
    """The last pose of each sequence's own frames."""
    return joints[torch.arange(len(joints), device=joints.device), n_frames - 1]


def _jerk_lengths(joints: Joints, n_frames: Int[torch.Tensor, " batch"]) -> Float[torch.Tensor, "batch windows 22"]:
    """Lengths of x(n+3) - 3 x(n+2) + 3 x(n+1) - x(n), metres per frame³; 0 where a window leaves the sequence.

    The gradient of a length 0 is 0, not NaN.
    """
    third = joints[:, 3:] - 3.0 * joints[:, 2:-1] + 3.0 * joints[:, 1:-2] - joints[:, :-3]
    inside = torch.arange(third.shape[1], device=joints.device) < (n_frames - 3)[:, None]
    squared = torch.where(inside[..., None], third.square().sum(-1), 0.0)
    # The square root has an infinite slope at 0, which would be NaN times 0 in the gradient.
    moving = squared > 0.0
    return torch.where(moving, torch.where(moving, squared, 1.0).sqrt(), 0.0)


def largest_jerk(joints: Joints, n_frames: Int[torch.Tensor, " batch"]) -> _PerSequence:
    """The largest of :func:`_jerk_lengths`, 0 for fewer than four frames.

    Source: docs/specification/pr-model.md#latent-noise-optimisation.
    """
    lengths = _jerk_lengths(joints, n_frames).flatten(1)
    return lengths.amax(dim=1) if lengths.shape[1] else joints.new_zeros(len(joints))


def jerk_norm(joints: Joints, n_frames: Int[torch.Tensor, " batch"], power: float) -> _PerSequence:
    """(sum of jerk^power)^(1/power) over frames and joints: never below the largest jerk, near it for a high power.

    Its gradient reaches every place that is about as jerky as the worst one, where the maximum reaches one place only.
    """
    lengths = _jerk_lengths(joints, n_frames).flatten(1)
    # Divided by the largest before the power, which would overflow or vanish otherwise.
    largest = largest_jerk(joints, n_frames).detach().clamp_min(1e-12)
    return largest * (lengths / largest[:, None]).pow(power).sum(dim=1).clamp_min(1e-12).pow(1.0 / power)


def _location(targets: Targets) -> Float[torch.Tensor, "batch 3"]:
    if targets.goal_location is None:
        raise ValueError("no goal location was given")
    return targets.goal_location


_BETAS = (0.9, 0.999)
_EPSILON = 1e-8
_SHORTEST_GRADIENT = 1e-12

Noise = Float[torch.Tensor, "batch frames features"]


@dataclass(frozen=True)
class AdamState:
    """Moments of the gradients of each row's noise; all rows have done the same number of steps."""

    first: Noise
    second: Noise
    steps: int = 0

    @classmethod
    def start(cls, noise: Noise) -> AdamState:
        """Moments before the first step."""
        return cls(torch.zeros_like(noise), torch.zeros_like(noise))

    def rows(self, index: Int[torch.Tensor, " kept"]) -> AdamState:
        """The moments of some of the rows."""
        return AdamState(self.first[index], self.second[index], self.steps)

    def stepped(self, noise: Noise, gradient: Noise, learning_rate: float) -> tuple[Noise, AdamState]:
        """The noise after one step with default betas, and the moments that belong to it."""
        first = self.first.lerp(gradient, 1.0 - _BETAS[0])
        second = self.second * _BETAS[1] + gradient.square() * (1.0 - _BETAS[1])
        steps = self.steps + 1
        scale = second.sqrt() / (1.0 - _BETAS[1] ** steps) ** 0.5 + _EPSILON
        # Adam written out: torch's own keeps one state for a tensor, from which no finished row can be taken out.
        moved = noise - learning_rate / (1.0 - _BETAS[0] ** steps) * first / scale
        return moved, AdamState(first, second, steps)


def unit_gradient(gradient: Noise) -> tuple[Noise, Float[torch.Tensor, " batch"]]:
    """Each row's gradient at length 1 over frames and features, and the lengths that they had.

    A zero gradient stays zero: the divisor is at least 1e-12.
    """
    lengths = gradient.flatten(1).norm(dim=1)
    return gradient / lengths.clamp_min(_SHORTEST_GRADIENT)[:, None, None], lengths


def learning_rate_factor(step: int, *, warmup: int, iterations: int) -> float:
    """Factor on the learning rate at ``step``, from 0 to 1.

    The warm-up is ``step / warmup`` and starts at 0, so that the first step of the published schedule moves nothing;
    the cosine decays over the whole run and is 0 at ``step = iterations``.

    Args:
        step: Iterations done so far.
        warmup: Iterations of the warm-up; 0 switches it off.
        iterations: Iterations of the whole run.
    """
    ramp = step / warmup if step < warmup else 1.0
    return ramp * (math.cos(math.pi * step / iterations) + 1.0) / 2.0


def decorrelation(noise: Float[torch.Tensor, "batch frames features"]) -> Float[torch.Tensor, " batch"]:
    """Squared correlation of neighbouring frames, summed over a pyramid of averaged frames.

    At each size from ``frames`` down to 2: the mean over frames and features of z_t z_(t-1), cyclic in time, squared;
    then neighbouring pairs of frames are averaged.

    Args:
        noise: The number of frames must be a power of two; see :class:`DecorrelationPadding`.
    """
    total = noise.new_zeros(len(noise))
    while noise.shape[1] >= 2:
        # Cyclic as in the original: the last frame also neighbours the first.
        total = total + (noise * noise.roll(1, dims=1)).mean(dim=(1, 2)) ** 2
        noise = noise.unflatten(1, (-1, 2)).mean(dim=2)
    return total


class DecorrelationPadding:
    """Fills noise of any length up to the next power of two with fresh normal numbers, and takes the loss there.

    Each sequence draws from a stream of its own, made of its seed, so that neither the order nor the size of the batch
    changes what is drawn. Lengths that are a power of two are not padded.
    """

    def __init__(self, seeds: Sequence[int], n_frames: Int[torch.Tensor, " batch"]) -> None:
        self._lengths = [int(length) for length in n_frames]
        self._generators = [named_generator("prbench-decorrelation", seed) for seed in seeds]

    def rows(self, kept: Sequence[int]) -> DecorrelationPadding:
        """Hand on the streams of some of the sequences, where they stand now."""
        part = DecorrelationPadding((), torch.zeros(0, dtype=torch.int64))
        part._lengths = [self._lengths[row] for row in kept]
        part._generators = [self._generators[row] for row in kept]
        return part

    def loss(self, noise: Float[torch.Tensor, "batch frames features"]) -> Float[torch.Tensor, " batch"]:
        """Decorrelation loss of each sequence's own frames; what lies behind them leaves no trace."""
        sizes = np.array([power_of_two_above(length) for length in self._lengths])
        total = noise.new_zeros(len(noise))
        for size in np.unique(sizes):
            rows = np.flatnonzero(sizes == size)
            index = torch.as_tensor(rows, device=noise.device)
            total = total.index_put((index,), decorrelation(self._padded(noise, rows, int(size))))
        return total

    def _padded(self, noise: torch.Tensor, rows: np.ndarray, size: int) -> torch.Tensor:
        filling = np.zeros((len(rows), size, noise.shape[2]), dtype=np.float32)
        for place, row in enumerate(rows):
            tail = filling[place, self._lengths[row] :]
            tail[:] = self._generators[row].standard_normal(tail.shape, dtype=np.float32)
        shape = (len(rows), size, 1)
        own = torch.as_tensor(np.arange(size) < np.take(self._lengths, rows)[:, None]).reshape(shape)
        given = noise[torch.as_tensor(rows, device=noise.device), :size]
        given = torch.nn.functional.pad(given, (0, 0, 0, size - given.shape[1]))
        return torch.where(own.to(noise.device), given, torch.as_tensor(filling).to(noise))


def power_of_two_above(length: int) -> int:
    """The smallest power of two that is not below ``length``."""
    return 1 << max(length - 1, 0).bit_length()


_TERMS = ("minimised", "initial", "goal", "jerk", "decorrelation", "gradient_norm")
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
