"""Noise optimisation: its settings, the objectives of motions, and the solver that moves noise until they are met.

Sources: docs/specification/dno.md#the-optimiser, docs/specification/dno.md#decorrelation-loss,
docs/specification/pr-model.md#latent-noise-optimisation. The options (``--option key=value``) are shared by the methods
that optimise noise.

Every objective reports the same two losses in the same units, so that methods can be compared, beside the sum that it
minimises. Frames behind a sequence's end are never looked at. Nothing couples the sequences of a batch: each has its
own gradient length, its own random stream and its own end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, cast, get_args

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.geometry.skeleton import Joint
from prbench.randomness import named_generator
from prbench_adapters.diffusion.generation import choice, number, whole_number
from prbench_adapters.diffusion.goal_frame import TRAINED_WITH
from prbench_adapters.diffusion.sampling import Spacing
from prbench_adapters.tensors import TensorRecord

Counts = Int[torch.Tensor, " batch"]
Poses = Float[torch.Tensor, "batch 22 3"]  # metres
Values = Float[torch.Tensor, " batch"]  # one number a motion
Latent = Float[torch.Tensor, "batch frames features"]

Hand = Literal["right", "left", "nearest"]
Bones = Literal["predicted", "initial"]
Reach = Literal["predicted", "goal"]

_FAST_PASSES = 400
_FAST_STEPS = 4
_QUICK_ITERATIONS = 50
# Options that go with the objective ``keyframes``.
KEYFRAME_OPTIONS = ("ddim-steps", "iterations", "learning-rate", "decorrelation", "hand", "bones")
# Options that go with the objective ``prime_and_reach``.
PRIME_AND_REACH_OPTIONS = (*KEYFRAME_OPTIONS, "reach", "alpha")
_MOST_ITERATIONS = 100_000


@dataclass(frozen=True, kw_only=True)
class OptimisationSettings:
    """Settings of one noise optimisation; the defaults are the paper's mode with DNO's solver.

    Sources: docs/specification/pr-model.md#latent-noise-optimisation (*Prime and Reach*, sections 4.2 and 5.1) and
    docs/specification/dno.md#inference-for-the-benchmark.

    Attributes:
        ddim_steps: Steps of the deterministic chain from noise to motion, of equal stride, in every iteration and at
            the end.
        spacing: End from which they are counted: the cleanest step, as DNO does, or the noisiest.
        warmup: Iterations over which the learning rate grows from 0.
        jerk_weight: The paper's alpha.
        jerk_power: Power norm of the jerks that is minimised instead of the largest jerk, which is reported; None
            minimises it.
        decorrelation_weight: DNO's; the paper does not mention this term, so 0 is its literal reading.
        hand: Wrist that a goal location is meant for; ``nearest`` leaves the choice to the motion.
        bones: Lengths of the bones: as the network predicts them, or those of the initial pose (not in the study).
        reach: ``goal`` leads the nearer wrist of the result to a goal location in closed form, as far as it has not
            come there yet; goal-frame features alone.
        parts: What decoding of goal-frame features constructs in every iteration (:data:`.goal_frame.PARTS`).
        guidance: Scale of classifier-free guidance; anything but 1 doubles the network passes.
        keep: Iterate that is the result: the last, or the one with the lowest initial plus goal loss.
        stop_below: Initial and goal loss, m², below which a sequence is finished; None runs all iterations.
        checkpointing: Steps a block whose activations are computed again instead of kept; 0 keeps all.
        batch_size: Most sequences that are optimised side by side; no result depends on it beyond rounding.
        gradient_smoothing: Standard deviation, in frames, of the bell curve that the gradient is averaged with over
            time; 0 leaves it.
    """

    ddim_steps: int = 50
    spacing: Spacing = "leading"
    iterations: int = 400
    learning_rate: float = 0.05
    warmup: int = 50
    jerk_weight: float = 0.5
    jerk_power: float | None = None
    decorrelation_weight: float = 1000.0
    hand: Hand = "right"
    bones: Bones = "predicted"
    reach: Reach = "predicted"
    parts: frozenset[str] = TRAINED_WITH
    guidance: float = 1.0
    keep: Literal["last", "best"] = "last"
    stop_below: float | None = None
    checkpointing: int = 0
    batch_size: int = 16
    gradient_smoothing: float = 0.0


def paper(diffusion_steps: int) -> OptimisationSettings:
    """All T steps of the training schedule, M = 400, learning rate 0.05, alpha 0.5 (*Prime and Reach*, section 5.1).

    Solver and decorrelation are DNO's. Blocks of about sqrt(T) steps are computed twice, so that memory stays small.
    """
    return OptimisationSettings(ddim_steps=diffusion_steps, checkpointing=math.ceil(math.sqrt(diffusion_steps)))


def dno_paper(diffusion_steps: int) -> OptimisationSettings:
    """Return the baseline with the same budget: S = 400; K = T up to 50 steps, else 10.

    Source: docs/specification/dno.md#inference-for-the-benchmark.
    """
    return replace(paper(diffusion_steps), ddim_steps=diffusion_steps if diffusion_steps <= 50 else 10)


def fast(diffusion_steps: int) -> OptimisationSettings:
    """Spend at most 400 network passes a sequence, the last decoding included.

    Found on small models of synthetic data: with a fixed number of passes, fewer steps and more iterations lower all
    losses; so do twice the learning rate, a decorrelation term that does not outweigh the others, and a power norm of
    all jerks with a smaller weight instead of the largest jerk, which pulls at one place of the motion at a time. The
    chain starts at the noisiest step: started later, it takes the noise for a motion and hardly asks the condition.
    """
    steps = min(_FAST_STEPS, diffusion_steps)
    # One chain is kept for decoding the result.
    iterations = _FAST_PASSES // steps - 1
    chain = OptimisationSettings(ddim_steps=steps, spacing="trailing", keep="best", stop_below=1e-6)
    weighted = replace(chain, jerk_weight=0.1, jerk_power=8.0, decorrelation_weight=10.0)
    return replace(weighted, iterations=iterations, learning_rate=0.1, warmup=iterations // 8)


def dno_fast(diffusion_steps: int) -> OptimisationSettings:
    """Spend at most 160 network passes a sequence on DNO's criterion, through a short chain, without a tremble.

    The criterion asks for two frames, and a gradient that reaches their noise alone makes these frames jump. Smoothed
    over time it changes the motion as a whole, and with a norm of the jerks in the criterion the wrists' median
    acceleration is a fifth of what it was. More iterations through fewer steps come nearer to the goal.
    """
    short = replace(fast(diffusion_steps), ddim_steps=min(2, diffusion_steps), iterations=_QUICK_ITERATIONS)
    short = replace(short, warmup=_QUICK_ITERATIONS // 8, learning_rate=0.2)
    return replace(short, gradient_smoothing=6.0, jerk_weight=0.05)


def finishing(diffusion_steps: int) -> OptimisationSettings:
    """Lead a motion to its goal that starts in the initial pose by construction, and change it no further.

    For goal-frame features. Longer and harder pursuit costs priming: with an early state of the weights, 99 iterations
    of :func:`fast` lowered Prime Success from 77 to 60 % (30 validation sequences), and these left it (73 and 75 %, 60
    sequences). It stops when the wrist is 5 cm from the goal, because a hand holds an object, not the wrist. What is
    left after 20 iterations is the arm's.
    """
    short = replace(fast(diffusion_steps), iterations=20, warmup=2, learning_rate=0.03, decorrelation_weight=0.0)
    return replace(short, hand="nearest", reach="goal", stop_below=0.0025)


def optimisation_settings(
    options: Mapping[str, str], preset: OptimisationSettings, *, diffusion_steps: int
) -> OptimisationSettings:
    """Return a preset with the options that were given; the warm-up keeps its share of the iterations.

    Args:
        options: The options that were given; keys that are in neither list above are not looked at.
        preset: What holds for options that are not given.
        diffusion_steps: Steps that the model was trained with.

    Raises:
        ValueError: naming the option with a value that is not possible.
    """
    iterations = whole_number(options, "iterations", most=_MOST_ITERATIONS) or preset.iterations
    return replace(
        preset,
        ddim_steps=whole_number(options, "ddim-steps", most=diffusion_steps) or preset.ddim_steps,
        iterations=iterations,
        # The warm-up keeps its share of the whole, or a short run would be nothing else.
        warmup=round(preset.warmup * iterations / preset.iterations),
        learning_rate=number(options, "learning-rate", preset.learning_rate),
        jerk_weight=number(options, "alpha", preset.jerk_weight),
        decorrelation_weight=number(options, "decorrelation", preset.decorrelation_weight),
        hand=cast(Hand, choice(options, "hand", get_args(Hand), preset.hand)),
        bones=cast(Bones, choice(options, "bones", get_args(Bones), preset.bones)),
        reach=cast(Reach, choice(options, "reach", get_args(Reach), preset.reach)),
    )


Joints = Float[torch.Tensor, "batch frames 22 3"]

_SOFTNESS = 0.01  # m² of the soft minimum over wrists: 10 cm apart counts as a decision


@dataclass(frozen=True)
class Losses:
    """Losses of each sequence; only ``minimised`` carries gradients that matter.

    Attributes:
        minimised: Weighted sum that the optimiser lowers, without decorrelation.
        initial: Mean over joints of the squared distance to the recorded first frame, m².
        goal: The same for the goal pose, or the squared distance of the chosen wrist to the goal location, m².
    """

    minimised: Values
    initial: Values
    goal: Values


@dataclass(frozen=True, kw_only=True)
class Targets(TensorRecord):
    """Initial states and goals of B motions, canonical frame, metres; exactly one of the two goals is given."""

    initial_joints: Poses
    goal_joints: Poses | None = None
    goal_location: Float[torch.Tensor, "batch 3"] | None = None

    def __post_init__(self) -> None:
        if (self.goal_joints is None) is (self.goal_location is None):
            raise ValueError("a motion is asked for either a goal pose or a goal location")


# Losses of motions against targets of the same batch.
Objective = Callable[[Joints, Counts, Targets, OptimisationSettings], Losses]


def prime_and_reach(joints: Joints, n_frames: Counts, targets: Targets, settings: OptimisationSettings) -> Losses:
    """L_init + L_goal + alpha L_jerk; squared distances are averaged over joints, so that 1 weighs as much as 22.

    Source: *Prime and Reach*, section 4.2; docs/specification/pr-model.md#latent-noise-optimisation.
    """
    initial = _squared_distance(joints[:, 0], targets.initial_joints)
    goal, pursued = _goal_losses(joints, n_frames, targets, settings.hand)
    power = settings.jerk_power
    jerk = largest_jerk(joints, n_frames) if power is None else jerk_norm(joints, n_frames, power)
    minimised = initial + pursued + settings.jerk_weight * jerk
    return Losses(minimised, initial, goal)


def keyframes(joints: Joints, n_frames: Counts, targets: Targets, settings: OptimisationSettings) -> Losses:
    """DNO's criterion: mean absolute error over the coordinates that are asked for, metres.

    Source: docs/specification/dno.md#the-optimiser. Asked for are the first frame, and in the last frame all joints or
    one wrist; every coordinate weighs the same, as in the published solver. Where the settings have a power norm of the
    jerks, that is added.
    """
    last = last_frame(joints, n_frames)
    errors = [(joints[:, 0] - targets.initial_joints).abs().flatten(1)]
    if targets.goal_joints is not None:
        errors.append((last - targets.goal_joints).abs().flatten(1))
    else:
        assert targets.goal_location is not None
        wrist = chosen_wrist(last, targets.goal_location, settings.hand)
        errors.append((wrist - targets.goal_location).abs())
    minimised = torch.cat(errors, dim=1).mean(dim=1)
    if settings.jerk_power is not None:
        minimised = minimised + settings.jerk_weight * jerk_norm(joints, n_frames, settings.jerk_power)
    initial = _squared_distance(joints[:, 0], targets.initial_joints)
    goal, _ = _goal_losses(joints, n_frames, targets, settings.hand)
    return Losses(minimised, initial.detach(), goal.detach())


def _goal_losses(joints: Joints, n_frames: Counts, targets: Targets, hand: Hand) -> tuple[Values, Values]:
    """Return the goal loss as reported and as minimised, m²; they differ for ``hand="nearest"`` only.

    Reported is then the nearer wrist's squared distance, minimised a soft minimum that is never above it, whose
    gradient is shared between wrists that are about equally near.
    """
    last = last_frame(joints, n_frames)
    if targets.goal_joints is not None:
        loss = _squared_distance(last, targets.goal_joints)
        return loss, loss
    location = targets.goal_location
    assert location is not None
    if hand != "nearest":
        loss = (chosen_wrist(last, location, hand) - location).square().sum(-1)
        return loss, loss
    squared = (last[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]] - location[:, None]).square().sum(-1)
    return squared.amin(dim=1), -_SOFTNESS * torch.logsumexp(-squared / _SOFTNESS, dim=1)


def chosen_wrist(pose: Poses, location: Float[torch.Tensor, "batch 3"], hand: Hand) -> Float[torch.Tensor, "batch 3"]:
    """Position of the wrist named by ``hand``, or of the one nearer to ``location``."""
    left = pose[:, Joint.LEFT_WRIST]
    right = pose[:, Joint.RIGHT_WRIST]
    if hand != "nearest":
        return left if hand == "left" else right
    left_nearer = (left - location).square().sum(-1) < (right - location).square().sum(-1)
    return torch.where(left_nearer[:, None], left, right)


def _squared_distance(predicted: Poses, wanted: Poses) -> Values:
    """Mean over joints of the squared distance, m²."""
    return (predicted - wanted).square().sum(-1).mean(-1)


def last_frame(joints: Joints, n_frames: Counts) -> Poses:
    """Return the last pose of each sequence's own frames."""
    return joints[torch.arange(len(joints), device=joints.device), n_frames - 1]


def _jerk_lengths(joints: Joints, n_frames: Counts) -> Float[torch.Tensor, "batch windows 22"]:
    """Lengths of x(n+3) - 3 x(n+2) + 3 x(n+1) - x(n), metres per frame³; 0 where a window leaves the sequence.

    The gradient of a length 0 is 0, not NaN.
    """
    third = joints[:, 3:] - 3.0 * joints[:, 2:-1] + 3.0 * joints[:, 1:-2] - joints[:, :-3]
    inside = torch.arange(third.shape[1], device=joints.device) < (n_frames - 3)[:, None]
    squared = torch.where(inside[..., None], third.square().sum(-1), 0.0)
    # The square root has an infinite slope at 0, which would be NaN times 0 in the gradient.
    moving = squared > 0.0
    return torch.where(moving, torch.where(moving, squared, 1.0).sqrt(), 0.0)


def largest_jerk(joints: Joints, n_frames: Counts) -> Values:
    """Return the largest of :func:`_jerk_lengths`, 0 for fewer than four frames.

    Source: docs/specification/pr-model.md#latent-noise-optimisation.
    """
    lengths = _jerk_lengths(joints, n_frames).flatten(1)
    return lengths.amax(dim=1) if lengths.shape[1] else joints.new_zeros(len(joints))


def jerk_norm(joints: Joints, n_frames: Counts, power: float) -> Values:
    """(sum of jerk^power)^(1/power) over frames and joints: never below the largest jerk, near it for a high power.

    Its gradient reaches every place that is about as jerky as the worst one, where the maximum reaches one place only.
    """
    lengths = _jerk_lengths(joints, n_frames).flatten(1)
    # Divided by the largest before the power, which would overflow or vanish otherwise.
    largest = largest_jerk(joints, n_frames).detach().clamp_min(1e-12)
    return largest * (lengths / largest[:, None]).pow(power).sum(dim=1).clamp_min(1e-12).pow(1.0 / power)


_BETAS = (0.9, 0.999)
_EPSILON = 1e-8
_SHORTEST_GRADIENT = 1e-12


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


def decorrelation(noise: Latent) -> Values:
    """Squared correlation of neighbouring frames, summed over a pyramid of averaged frames.

    At each size from ``frames`` down to 2: the mean over frames and features of z_t z_(t-1), cyclic in time, squared;
    then neighbouring pairs of frames are averaged.

    Args:
        noise: The number of frames must be a power of two; see :func:`padded_decorrelation`.
    """
    total = noise.new_zeros(len(noise))
    while noise.shape[1] >= 2:
        # Cyclic as in the original: the last frame also neighbours the first.
        total = total + (noise * noise.roll(1, dims=1)).mean(dim=(1, 2)) ** 2
        noise = noise.unflatten(1, (-1, 2)).mean(dim=2)
    return total


def padded_decorrelation(noise: Latent, n_frames: Counts, generators: Sequence[np.random.Generator]) -> Values:
    """Decorrelation loss of each sequence's own frames; what lies behind them leaves no trace.

    Noise of any length is filled up to the next power of two with fresh normal numbers. Each sequence draws from a
    stream of its own, so that neither the order nor the size of the batch changes what is drawn.
    """
    lengths = n_frames.cpu().numpy()
    sizes = np.array([1 << max(int(length) - 1, 0).bit_length() for length in lengths])
    total = noise.new_zeros(len(noise))
    for size in np.unique(sizes):
        rows = np.flatnonzero(sizes == size)
        filling = np.zeros((len(rows), int(size), noise.shape[2]), dtype=np.float32)
        for place, row in enumerate(rows):
            tail = filling[place, lengths[row] :]
            tail[:] = generators[int(row)].standard_normal(tail.shape, dtype=np.float32)
        own = torch.as_tensor(np.arange(size) < lengths[rows][:, None])[..., None].to(noise.device)
        index = torch.as_tensor(rows, device=noise.device)
        given = noise[index, : int(size)]
        given = torch.nn.functional.pad(given, (0, 0, 0, int(size) - given.shape[1]))
        total = total.index_put((index,), decorrelation(torch.where(own, given, torch.as_tensor(filling).to(noise))))
    return total


def smoothed_over_time(gradient: Latent, n_frames: Counts, deviation: float) -> Latent:
    """Average each frame with its neighbours, weighted by a bell curve; each sequence's own frames alone.

    Args:
        gradient: Anything that is 0 behind a sequence's end.
        n_frames: Frames of each sequence.
        deviation: Standard deviation of the curve, frames.
    """
    frame = torch.arange(gradient.shape[1], device=gradient.device)
    curve = torch.exp(-0.5 * ((frame[:, None] - frame) / deviation).square())
    weights = curve * (frame < n_frames[:, None])[:, None]
    return (weights / weights.sum(dim=2, keepdim=True)) @ gradient


@dataclass(frozen=True)
class OptimisedMotions:
    """Optimised motions of B sequences, in the order in which they were given.

    Attributes:
        joints: Canonical frame, metres; decoded from ``noise`` by as many steps as it was optimised with.
        initial: L_init of ``joints``, m².
        goal: L_goal of ``joints``, m².
        network_passes: Forward passes of the denoiser spent on each sequence, guidance and recomputed ones included.
    """

    joints: Float[torch.Tensor, "batch frames 22 3"]
    noise: Latent
    initial: Values
    goal: Values
    network_passes: Counts


# Is told the noise, the losses and other numbers of each iteration before its step.
Watch = Callable[[Latent, Losses, dict[str, Any]], None]


def optimise(
    decoder: Any,
    objective: Objective,
    targets: Targets,
    noise: Latent,
    n_frames: Counts,
    seeds: Sequence[int],
    settings: OptimisationSettings,
    *,
    watch: Watch | None = None,
) -> OptimisedMotions:
    """Optimise the noise of each sequence by Adam on unit gradients with warm-up and cosine.

    Args:
        decoder: The map from noise to joints whose input is sought, as ``UnrolledChain``: its ``rows`` is the map for
            some of the sequences, its ``network_passes`` the passes so far. It must not depend on what lies behind a
            sequence's end.
        objective: What is minimised, decorrelation apart.
        targets: What each motion is asked for.
        noise: Start, normally distributed.
        n_frames: Frames of each sequence.
        seeds: One per sequence: its own random stream, for the padding of the decorrelation loss.
        settings: Everything else.
        watch: Called in every iteration.

    Returns:
        The motions decoded from the last noise, or from the best one, as ``settings.keep`` says.
    """
    batch, frames = noise.shape[:2]
    joints = noise.new_zeros((batch, frames, 22, 3))
    initial, goal = noise.new_full((2, batch), torch.inf)
    passes = torch.zeros(batch, dtype=torch.int64, device=noise.device)
    found = OptimisedMotions(joints, noise.detach().clone(), initial, goal, passes)
    # The rows that are still optimised; a sequence that is finished leaves, and the others go on as before.
    rows = torch.arange(batch, device=noise.device)
    noise = noise.detach()
    first = torch.zeros_like(noise)
    second = torch.zeros_like(noise)
    generators = [named_generator("prbench-decorrelation", seed) for seed in seeds]
    for iteration in range(settings.iterations + 1):
        is_last = iteration == settings.iterations  # decodes what the last step has made
        before = decoder.network_passes
        with torch.set_grad_enabled(not is_last):
            # A fresh leaf in every iteration, so that no graph outlives it.
            leaf = noise.detach().requires_grad_(not is_last)
            joints = decoder(leaf)
            losses = objective(joints, n_frames, targets, settings)
            gradient = torch.zeros_like(noise)
            decorrelated = torch.zeros_like(losses.initial)
            if not is_last:
                minimised = losses.minimised
                if settings.decorrelation_weight:
                    decorrelated = padded_decorrelation(leaf, n_frames, generators)
                    minimised = minimised + settings.decorrelation_weight * decorrelated
                (gradient,) = torch.autograd.grad(minimised.sum(), leaf)
        found.network_passes[rows] += decoder.network_passes - before
        finished = torch.zeros(len(rows), dtype=torch.bool, device=rows.device)
        if settings.stop_below is not None:
            finished = (losses.initial < settings.stop_below) & (losses.goal < settings.stop_below)
        chosen = torch.ones_like(finished) if is_last else finished
        if settings.keep == "best":
            # Written as `not worse`, because a comparison with NaN is always false: NaN counts, so it is never hidden.
            chosen = ~(losses.initial + losses.goal >= found.initial[rows] + found.goal[rows])
        places = rows[chosen]
        found.noise[places] = noise[chosen]
        found.joints[places] = joints.detach()[chosen]
        found.initial[places] = losses.initial.detach()[chosen]
        found.goal[places] = losses.goal.detach()[chosen]
        if is_last:
            break
        if settings.gradient_smoothing:
            gradient = smoothed_over_time(gradient, n_frames, settings.gradient_smoothing)
        # A length of 1 makes the learning rate the same for every sequence, whatever its loss.
        lengths = gradient.flatten(1).norm(dim=1)
        factor = learning_rate_factor(iteration, warmup=settings.warmup, iterations=settings.iterations)
        rate = settings.learning_rate * factor
        if watch is not None:
            numbers = {"decorrelation": decorrelated, "gradient_norm": lengths, "learning_rate": rate, "rows": rows}
            watch(noise, losses, numbers)
        gradient = gradient / lengths.clamp_min(_SHORTEST_GRADIENT)[:, None, None]
        # Adam written out: torch's own keeps one state for a tensor, from which no finished row can be taken out.
        first = first.lerp(gradient, 1.0 - _BETAS[0])
        second = second * _BETAS[1] + gradient.square() * (1.0 - _BETAS[1])
        scale = second.sqrt() / (1.0 - _BETAS[1] ** (iteration + 1)) ** 0.5 + _EPSILON
        noise = noise - rate / (1.0 - _BETAS[0] ** (iteration + 1)) * first / scale
        if finished.any():
            kept = (~finished).nonzero()[:, 0]
            rows, noise, first, second, n_frames = (part[kept] for part in (rows, noise, first, second, n_frames))
            targets = targets.rows(kept)
            generators = [generators[row] for row in kept.tolist()]
            if not len(rows):
                break
            decoder = decoder.rows(kept)
    return found
