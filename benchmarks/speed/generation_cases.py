"""What is timed when motions are generated: sizes, one prompt, and our own code on random weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.text import EncodedText
from prbench_adapters.diffusion.batches import start_noise
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.generation import SamplingSettings, generate
from prbench_adapters.diffusion.model import MotionModel, TextVectors
from prbench_adapters.diffusion.noise_optimisation.generation import optimise_noise
from prbench_adapters.diffusion.noise_optimisation.objective import Targets, keyframes
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings

Precision = Literal["float32", "bfloat16"]

PROMPT = "The person moves across and picks an object."
DIFFUSION_STEPS = 50
OPTIMISATION_STEPS = 10
"""Of the deterministic chain, in one iteration of noise optimisation."""
GUIDANCE = 2.5
WORD_PIECES = 11
"""Of the prompt in DistilBERT's vocabulary, its two special ones included."""


@dataclass(frozen=True)
class Size:
    """A network, the same for everybody."""

    name: str
    width: int
    heads: int
    layers: int
    feed_forward: int


SIZES = {
    size.name: size
    for size in (
        Size("paper", width=512, heads=4, layers=8, feed_forward=1024),
        Size("small", width=128, heads=4, layers=4, feed_forward=448),
    )
}


@dataclass(frozen=True)
class Problem:
    """How many motions of how many frames are made at once, by which network, where."""

    size: Size
    frames: int
    batch: int
    device: str = "cpu"


class FixedText:
    """Stands for a text encoder whose vectors are known: random ones, the same for every text and for everybody."""

    def __init__(self, dimension: int, tokens: int) -> None:
        self.name, self.dimension = "fixed", dimension
        self.vectors = np.random.default_rng(0).normal(size=(tokens, dimension)).astype(np.float32)

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The one answer, once a text."""
        tokens = np.tile(self.vectors, (len(texts), 1, 1))
        return EncodedText(tokens, np.zeros(tokens.shape[:2], dtype=bool))


def word_pieces() -> FixedText:
    """Stand in for DistilBERT: one vector a word piece."""
    return FixedText(768, WORD_PIECES)


def sentence() -> FixedText:
    """Stand in for CLIP: one vector a text."""
    return FixedText(512, 1)


def our_model(
    problem: Problem, architecture: Literal["decoder", "encoder"], text: FixedText, *, frames_per_token: int = 1
) -> MotionModel:
    """A frozen model with random weights."""
    torch.manual_seed(0)
    configuration = DenoiserConfiguration(
        architecture=architecture,
        width=problem.size.width,
        heads=problem.size.heads,
        layers=problem.size.layers,
        feed_forward=problem.size.feed_forward,
        frames_per_token=frames_per_token,
        text_dimension=text.dimension,
        diffusion_steps=DIFFUSION_STEPS,
        max_frames=problem.frames,
    )
    denoiser = Denoiser(configuration).to(problem.device)
    return MotionModel(denoiser, mean=torch.zeros(263), std=torch.ones(263), scaling=None, texts=TextVectors(text))


def n_parameters(model: torch.nn.Module) -> int:
    """Count the parameters of a network."""
    return sum(parameter.numel() for parameter in model.parameters())


def our_sampling(
    problem: Problem, *, precision: Precision = "float32", frames_per_token: int = 1
) -> Callable[[], object]:
    """Text to joints: 50 guided DDPM steps of the decoder with DistilBERT's word pieces, as ``--method mdm`` does."""
    model = our_model(problem, "decoder", word_pieces(), frames_per_token=frames_per_token)
    batch, settings = _conditions(problem), SamplingSettings(guidance=GUIDANCE, precision=precision)
    return lambda: generate(model, batch, settings)


def our_optimisation(problem: Problem, *, precision: Precision = "float32") -> Callable[[int], object]:
    """So many guided iterations of DNO on the encoder with one sentence vector: forward, backward, Adam."""
    model = our_model(problem, "encoder", sentence())
    batch = _conditions(problem)
    targets, n_frames = _targets(problem), torch.as_tensor(batch.n_frames)
    condition = model.encode(batch)

    def optimise(iterations: int) -> object:
        settings = OptimisationSettings(
            ddim_steps=OPTIMISATION_STEPS,
            iterations=iterations,
            guidance=GUIDANCE,
            batch_size=problem.batch,
            precision=precision,
        )
        noise = start_noise(batch.noise_seed, batch.n_frames, problem.device)
        return optimise_noise(
            model, condition, targets, n_frames, noise, settings, seeds=batch.noise_seed, objective=keyframes
        )

    return optimise


def our_training(problem: Problem) -> Callable[[], object]:
    """One training step of the decoder with DistilBERT's word pieces: forward, squared error, backward, AdamW."""
    model = our_model(problem, "decoder", word_pieces())
    batch = _conditions(problem)
    condition = model.encode(batch)
    denoiser = model.denoiser.train().requires_grad_(True)
    clean = random_features(problem)
    steps = torch.zeros(problem.batch, dtype=torch.long, device=problem.device)
    n_frames = torch.as_tensor(batch.n_frames)
    return training_step(denoiser, lambda: denoiser(clean, steps, condition, n_frames), clean)


def random_features(problem: Problem) -> torch.Tensor:
    """The same motions for everybody, (batch, frames, 263)."""
    generator = torch.Generator().manual_seed(2)
    return torch.randn((problem.batch, problem.frames, 263), generator=generator).to(problem.device)


def training_step(
    network: torch.nn.Module, forward: Callable[[], torch.Tensor], clean: torch.Tensor
) -> Callable[[], object]:
    """Forward, mean squared error, backward and AdamW."""
    optimiser = torch.optim.AdamW(network.parameters(), lr=1e-4)

    def step() -> object:
        optimiser.zero_grad(set_to_none=True)
        loss = (forward() - clean).square().mean()
        loss.backward()
        optimiser.step()
        return loss

    return step


def _conditions(problem: Problem) -> ConditionBatch:
    return ConditionBatch(
        condition=Condition.TEXT,
        n_frames=np.full(problem.batch, problem.frames),
        fps=20.0,
        opaque_id=tuple(map(str, range(problem.batch))),
        noise_seed=tuple(range(problem.batch)),
        text=(PROMPT,) * problem.batch,
    )


def _targets(problem: Problem) -> Targets:
    poses = torch.randn((2, problem.batch, 22, 3), generator=torch.Generator().manual_seed(1)).to(problem.device)
    return Targets(initial_joints=poses[0], previous_joints=poses[0], goal_joints=poses[1])
