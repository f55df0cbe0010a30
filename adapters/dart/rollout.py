"""Primitive after primitive, plainly or steered by guidance or by optimised noise (docs/specification/dart.md).

Each primitive begins with the last frames of the one before, seen from the first of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from prbench_adapters.dart import model as dart
from prbench_adapters.diffusion.denoiser import Counts, TransformerLayer
from prbench_adapters.diffusion.generation import Guidance
from prbench_adapters.diffusion.noise_optimisation import Targets, chosen_wrist, last_frame
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddim, sample_ddpm

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
        done.append(Primitive(history, latent, features, placement, placement.points(future.joints)))
        # Each primitive starts in a frame of reference of its own, as the networks have learnt it.
        frames, inner = next_history(future)
        history = model.scaling.standardised(frames)
        placement = placement.then(inner)
    return done


def next_history(future: dart.Frames) -> tuple[dart.Frames, dart.Placement]:
    """Return a primitive's last frames as the history of the next, and the next one's frame of reference in this one.

    That frame of reference is taken from the predicted joints.
    """
    n = future.joints.shape[1]
    return future.part(n - dart.HISTORY_FRAMES, n).canonical()


_CONTEXT = slice(1, 2 + dart.HISTORY_FRAMES)  # places of text and history among the tokens
_LATENT = 2 + dart.HISTORY_FRAMES


class PreparedDenoiser:
    """Computes :class:`LatentDenoiser` up to rounding, with gradients, in about three quarters of the time.

    Only the last token changes within a primitive, besides the one for the step: the others are embedded, and projected
    for the first layer's attention, once. Only the last token is read, so the last layer has no other queries.

    Args:
        denoiser: The denoiser, in evaluation mode.
        text: One vector each; zeros for no text.
        history: Standardised features.
    """

    def __init__(self, denoiser: dart.LatentDenoiser, text: Float[Tensor, "batch dimension"], history: History) -> None:
        self.denoiser, self.places = denoiser, denoiser.sinusoid
        self.layers = cast(list[TransformerLayer], list(denoiser.layers))
        self.project = self.layers[0].self_attention.query_key_value
        context = (denoiser.text_embedding(text)[:, None], denoiser.history_embedding(history))
        self.context = torch.cat(context, dim=1) + self.places[_CONTEXT]
        self.times = denoiser.time_embedding(self.places[: denoiser.configuration.diffusion_steps]) + self.places[0]
        self.projected_context, self.projected_times = self.project(self.context), self.project(self.times)

    def __call__(self, noisy: Latents, step: int) -> Latents:
        """Return the clean latent from a noisy one at a diffusion step."""
        rows = len(noisy)
        latent = self.denoiser.latent_embedding(noisy[:, 0]) + self.places[_LATENT]
        stream = _tokens(self.times[step], self.context, latent)
        projected = _tokens(self.projected_times[step], self.projected_context, self.project(latent))
        # TransformerLayer written out without dropout: the layers' own forward would compute all tokens anew.
        for number, layer in enumerate(self.layers):
            if number:
                projected = layer.self_attention.query_key_value(stream)
            of_heads = projected.view(rows, _LATENT + 1, 3, layer.self_attention.heads, -1)
            query, key, value = of_heads.permute(2, 0, 3, 1, 4).unbind()
            # Nobody reads the other tokens behind the last layer.
            if number == len(self.layers) - 1:
                query = query[:, :, -1:]
                stream = stream.view(rows, _LATENT + 1, -1)[:, -1]
            looked = functional.scaled_dot_product_attention(query, key, value).transpose(1, 2).reshape(stream.shape)
            stream = layer.self_attention_norm(stream + layer.self_attention.output(looked))
            hidden = functional.gelu(layer.feed_forward.expand(stream))
            stream = layer.feed_forward_norm(stream + layer.feed_forward.contract(hidden))
        return self.denoiser.head(stream)[:, None]


def _tokens(
    time: Float[Tensor, " width"], context: Float[Tensor, "batch context width"], latent: Float[Tensor, "batch width"]
) -> Float[Tensor, "rows width"]:
    """All tokens of all rows below each other: linear layers take a matrix quicker than a stack of them."""
    return torch.cat((time.expand(len(latent), 1, -1), context, latent[:, None]), dim=1).flatten(0, 1)


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
        prepared = PreparedDenoiser(self.denoiser, self.both(text, torch.zeros_like(text)), self.both(history, history))
        return lambda noisy, step: self.estimate(lambda rows: prepared(rows, step), noisy)


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
