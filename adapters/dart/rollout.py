"""Primitive after primitive, plainly or steered by guidance or by optimised noise (docs/specification/dart.md).

Each primitive begins with the last frames of the one before, seen from the first of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from prbench_adapters.dart import model as dart
from prbench_adapters.diffusion.denoiser import Counts
from prbench_adapters.diffusion.generation import Guidance
from prbench_adapters.diffusion.noise_optimisation import Targets, chosen_wrist, last_frame
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddim, sample_ddpm
from prbench_adapters.finishing import Finishing
from prbench_adapters.kinematics import forward_kinematics, rest_offsets, to_floor

Numbers = Float[Tensor, " batch"]
History = Float[Tensor, "batch history 276"]
Latents = Float[Tensor, "batch 1 latent"]
Poses = Float[Tensor, "batch 22 3"]  # metres

# Maps number and standardised history of a primitive to its clean latent, divided by the latents' std.
SampleLatent = Callable[[int, History], Latents]


@dataclass(frozen=True)
class Primitive:
    """One primitive of B motions.

    Attributes:
        history: Standardised, in the primitive's frame of reference.
        latent: Divided by the latents' std.
        features: Standardised features of the future frames, in the same frame of reference.
        placement: Placement of its frame of reference in the world.
        joints: Joints of the future frames, in the world, metres.
    """

    history: History
    latent: Latents
    features: Float[Tensor, "batch future 276"]
    placement: dart.Placement
    joints: Float[Tensor, "batch future 22 3"]


def first_history(previous: Poses, initial: Poses) -> tuple[dart.Frames, dart.Placement]:
    """Return the history that a motion starts from: the frame before it and its first, in the world with Z up, metres.

    What leads on from the first frame is not known; the body is taken to go on as it came.
    """
    frames = dart.Frames.of_joints(torch.stack((previous, initial, initial), dim=1))
    came = {
        name: getattr(frames, name)[:, :1].expand_as(getattr(frames, name))
        for name in ("translation_delta", "orientation_delta", "joints_delta")
    }
    return replace(frames, **came).canonical()


def roll_out(
    model: dart.DartModel,
    history: History,
    placement: dart.Placement,
    sample: SampleLatent,
    primitives: int,
    *,
    going_on: Sequence[int] | None = None,
    keep: Callable[[dart.Frames, dart.Placement], dart.Frames] | None = None,
) -> list[Primitive]:
    """Generate primitives; differentiable from the latents' noise to the last joint.

    Args:
        model: The frozen model.
        history: Standardised, of the first primitive (:func:`first_history`).
        placement: Placement of its frame of reference in the world.
        sample: Makes the latents.
        primitives: How many.
        going_on: How many motions, the first ones, have each primitive; None if all have all. What motions are to be
            shorter come last, and cost nothing behind their end.
        keep: Changes the future frames of a primitive before they lead on to the next (:func:`kept`).
    """
    done: list[Primitive] = []
    for number in range(primitives):
        if going_on is not None:
            # Sequences that have ended cost nothing more.
            history = history[: going_on[number]]
            placement = placement.first(going_on[number])
        latent = sample(number, history)
        features = model.vae.decode(latent * model.latent_std, history)
        future = model.scaling.frames(features)
        if keep is not None:
            future = keep(future, placement)
        done.append(Primitive(history, latent, features, placement, placement.points(future.joints)))
        # Each primitive starts in a frame of reference of its own, as the networks have learnt it.
        frames, inner = next_history(future)
        history = model.scaling.standardised(frames)
        placement = placement.then(inner)
    return done


def kept(future: dart.Frames, placement: dart.Placement, first: Poses, finishing: Finishing) -> dart.Frames:
    """Return predicted frames with the bones of a pose, and with a foot on the floor.

    Networks predict joints beside rotations, and the next primitive starts from them: without this, errors of bones and
    height add up. The original shows the body of the rotations, whose bones are constant.

    Args:
        future: Frames of a primitive.
        placement: Its frame of reference in the world, where the floor is at 0.
        first: Poses that have the bones, those of motions that have ended behind the others; world.
        finishing: Which of both is done.
    """
    first = first[: len(future.joints), None]
    if finishing.bones:
        bodies = forward_kinematics(future.rotations(), future.translation, rest_offsets(first))
        future = replace(future, joints=bodies)
    if finishing.feet:
        move = to_floor(placement.points(future.joints), first)
        future = replace(future, translation=future.translation + move, joints=future.joints + move[:, :, None])
    return future


def next_history(future: dart.Frames) -> tuple[dart.Frames, dart.Placement]:
    """Return a primitive's last frames as the history of the next, and the next one's frame of reference in this one.

    That frame of reference is taken from the predicted joints.
    """
    n = future.joints.shape[1]
    return future.part(n - dart.HISTORY_FRAMES, n).canonical()


class GuidedDenoiser(Guidance):
    """A denoiser under B texts.

    Args:
        denoiser: The denoiser of latents, in evaluation mode.
        text: One vector each.
        scale: Weight of the guidance; 1 is the conditional estimate alone, in one pass, anything else takes two.
    """

    def __init__(self, denoiser: dart.LatentDenoiser, text: Float[Tensor, "batch dimension"], scale: float) -> None:
        super().__init__(scale)
        self.denoiser, self.text = denoiser, text

    def under(self, history: History) -> Callable[[Tensor, int], Tensor]:
        """Return the guided estimate of clean latents as the samplers take it: of noisy latents and diffusion step.

        Where there are fewer histories than texts, they are those of the first motions.
        """
        # Rows stand longest first, so the sequences that go on are always the first rows.
        text = self.text[: len(history)]
        given = (self.both(text, torch.zeros_like(text)), self.both(history, history))

        def predict(noisy: Tensor, step: int) -> Tensor:
            return self.denoiser(noisy, torch.full((len(noisy),), step, device=noisy.device), *given)

        return lambda noisy, step: self.estimate(lambda rows: predict(rows, step), noisy)


def by_ddim(
    denoiser: GuidedDenoiser, schedule: CosineSchedule, noise: Noise, *, steps: int | None = None
) -> SampleLatent:
    """Return a fixed, differentiable map from each primitive's noise to its latent: η = 0, all steps unless given."""
    return lambda number, history: sample_ddim(
        denoiser.under(history), schedule, noise[number, : len(history)], steps=steps
    )


def by_ddpm(denoiser: GuidedDenoiser, schedule: CosineSchedule, draw: Callable[[], Latents]) -> SampleLatent:
    """Ancestral sampling with all steps; ``draw`` is called for the start and once a step but the last."""

    def sample(number: int, history: Tensor) -> Tensor:  # noqa: ARG001 - every primitive draws
        n = len(history)
        return sample_ddpm(denoiser.under(history), schedule, draw()[:n], lambda _: draw()[:n])

    return sample


Noise = Float[Tensor, "primitives batch 1 latent"]
Joints = Float[Tensor, "batch frames 22 3"]

_SHORTEST_GRADIENT = 1e-6


def optimise(
    motion: Callable[[Noise], Joints], start: Noise, targets: Targets, n_frames: Counts, settings: dart.DartSettings
) -> tuple[Noise, Joints]:
    """Lower the loss of every sequence by Adam on its noise.

    The gradient of each primitive has length 1, so that the learning rate says how far each moves; a primitive behind a
    sequence's end has no gradient and stays. No sequence notices the others.

    Args:
        motion: A differentiable map from noise to joints, metres, canonical frame; first frame first.
        start: The first noise.
        targets: Initial state and goal of each sequence, of which the goal is asked for.
        n_frames: Frames of each sequence; its last one is the goal's.
        settings: Iterations, learning rate and what else belongs to the loss.

    Returns:
        The last noise and its joints.
    """
    noise = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([noise])
    for iteration in range(settings.iterations):
        for group in optimiser.param_groups:
            # Linear to 0: the last steps settle, the first ones search.
            group["lr"] = settings.learning_rate * (1.0 - iteration / settings.iterations)
        with torch.enable_grad():
            # Summed over sequences, none of which depends on another, so each gets its own gradient.
            (gradient,) = torch.autograd.grad(goal_loss(motion(noise), n_frames, targets, settings).sum(), noise)
        # Length 1 over the latent of each primitive of each sequence.
        lengths = torch.linalg.vector_norm(gradient, dim=(2, 3), keepdim=True)
        noise.grad = gradient / lengths.clamp_min(_SHORTEST_GRADIENT)
        optimiser.step()
    with torch.no_grad():
        return noise.detach(), motion(noise)


def goal_loss(joints: Joints, n_frames: Counts, targets: Targets, settings: dart.DartSettings) -> Numbers:
    """Huber loss (δ = 1 m) of the last frame, averaged over the coordinates that are asked for.

    Asked for are all joints of a goal pose, or one wrist for a goal location.
    """
    last = last_frame(joints, n_frames)
    if targets.goal_joints is not None:
        error = last - targets.goal_joints
    else:
        assert targets.goal_location is not None
        error = (chosen_wrist(last, targets.goal_location, settings.hand) - targets.goal_location)[:, None]
    return functional.huber_loss(error, torch.zeros_like(error), reduction="none").mean(dim=(1, 2))
