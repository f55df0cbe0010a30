"""All that decides an optimisation, as one record: its published and fast presets, and the options that change them.

The options (``--option key=value``) are shared by the methods that optimise noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

from prbench_adapters.diffusion.generation import choice, number, whole_number
from prbench_adapters.diffusion.model import Reach
from prbench_adapters.diffusion.sampling import Spacing

Hand = Literal["right", "left", "nearest"]
Bones = Literal["predicted", "initial"]

_FAST_PASSES = 400
_FAST_STEPS = 4
KEYFRAME_OPTIONS = ("ddim-steps", "iterations", "learning-rate", "decorrelation", "hand", "bones")
"""Options that go with the objective ``keyframes``."""
PRIME_AND_REACH_OPTIONS = (*KEYFRAME_OPTIONS, "reach", "alpha", "initial-velocity-weight")
"""Options that go with the objective ``prime_and_reach``."""
_MOST_ITERATIONS = 100_000


@dataclass(frozen=True, kw_only=True)
class OptimisationSettings:
    """Settings of one noise optimisation; the defaults are the paper's mode with DNO's solver.

    Sources: docs/specification/pr-model.md#latent-noise-optimisation (*Prime and Reach*, sections 4.2 and 5.1) and
    docs/specification/dno.md#inference-for-the-benchmark.
    """

    ddim_steps: int = 50
    """Steps of the deterministic chain from noise to motion, of equal stride, in every iteration and at the end."""
    spacing: Spacing = "leading"
    """End from which they are counted: the cleanest step, as DNO does, or the noisiest."""
    iterations: int = 400
    learning_rate: float = 0.05
    warmup: int = 50
    """Iterations over which the learning rate grows from 0."""
    jerk_weight: float = 0.5
    """The paper's alpha."""
    jerk_power: float | None = None
    """Power norm of the jerks that is minimised instead of the largest jerk, which is reported; None minimises it."""
    decorrelation_weight: float = 1000.0
    """DNO's; the paper does not mention this term, so 0 is its literal reading."""
    initial_velocity_weight: float = 0.0
    hand: Hand = "right"
    """Wrist that a goal location is meant for; ``nearest`` leaves the choice to the motion."""
    bones: Bones = "predicted"
    """Lengths of the bones: as the network predicts them, or those of the initial pose (not in the study)."""
    reach: Reach = "predicted"
    """``goal`` leads the nearer wrist of the result to a goal location in closed form, as far as it has not come there
    yet; goal-frame features alone."""
    guidance: float = 1.0
    """Scale of classifier-free guidance; anything but 1 doubles the network passes."""
    keep: Literal["last", "best"] = "last"
    """Iterate that is the result: the last, or the one with the lowest initial plus goal loss."""
    stop_below: float | None = None
    """Initial and goal loss, m², below which a sequence is finished; None runs all iterations."""
    checkpointing: int = 0
    """Steps a block whose activations are computed again instead of kept; 0 keeps all."""
    batch_size: int = 16
    """Most sequences that are optimised side by side; no result depends on it beyond rounding."""

    def __post_init__(self) -> None:
        if min(self.ddim_steps, self.iterations) < 1:
            raise ValueError(
                f"'ddim_steps', 'iterations': expected 1 or more, found {self.ddim_steps}, {self.iterations}."
            )


def paper(diffusion_steps: int) -> OptimisationSettings:
    """All T steps of the training schedule, M = 400, learning rate 0.05, alpha 0.5 (*Prime and Reach*, section 5.1).

    Solver and decorrelation are DNO's. Blocks of about sqrt(T) steps are computed twice, so that memory stays small.
    """
    return OptimisationSettings(ddim_steps=diffusion_steps, checkpointing=math.ceil(math.sqrt(diffusion_steps)))


def dno_paper(diffusion_steps: int) -> OptimisationSettings:
    """The baseline with the same budget: S = 400; K = T up to 50 steps, else 10.

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
    return OptimisationSettings(
        ddim_steps=steps,
        spacing="trailing",
        iterations=iterations,
        learning_rate=0.1,
        warmup=iterations // 8,
        jerk_weight=0.1,
        jerk_power=8.0,
        decorrelation_weight=10.0,
        keep="best",
        stop_below=1e-6,
    )


def finishing(diffusion_steps: int) -> OptimisationSettings:
    """Lead a motion to its goal that starts in the initial pose by construction, and change it no further.

    For goal-frame features. Longer and harder pursuit costs priming: with an early state of the weights, 99 iterations
    of :func:`fast` lowered Prime Success from 77 to 60 % (30 validation sequences), and these left it (73 and 75 %, 60
    sequences). It stops when the wrist is 5 cm from the goal, because a hand holds an object, not the wrist. What is
    left after 20 iterations is the arm's.
    """
    return replace(
        fast(diffusion_steps),
        iterations=20,
        warmup=2,
        learning_rate=0.03,
        decorrelation_weight=0.0,
        hand="nearest",
        reach="goal",
        stop_below=0.0025,
    )


def optimisation_settings(
    options: Mapping[str, str], preset: OptimisationSettings, *, diffusion_steps: int
) -> OptimisationSettings:
    """A preset with the options that were given; the warm-up keeps its share of the iterations.

    Args:
        options: As given; keys that are in neither list above are not looked at.
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
        initial_velocity_weight=number(options, "initial-velocity-weight", preset.initial_velocity_weight),
        hand=cast(Hand, choice(options, "hand", get_args(Hand), preset.hand)),
        bones=cast(Bones, choice(options, "bones", get_args(Bones), preset.bones)),
        reach=cast(Reach, choice(options, "reach", get_args(Reach), preset.reach)),
    )
