"""Time sampling, noise optimisation and training steps: ``python -m benchmarks.speed.bench_generation``.

Run from the repository's root. Every product of matrices is recorded and repeated alone: nothing written in PyTorch is
faster than that here.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from benchmarks.speed.work import print_rows
from prbench.contract import Condition, ConditionBatch
from prbench.text import EncodedText
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.generation import SamplingSettings, generate, start_noise
from prbench_adapters.diffusion.model import MotionModel, TextVectors
from prbench_adapters.diffusion.noise_optimisation import OptimisationSettings, Targets, keyframes
from prbench_adapters.diffusion.optimised_generation import optimise_noise

# Beginnings of the names of operations that multiply matrices.
_PRODUCTS = ("mm", "addmm", "bmm", "baddbmm", "_scaled_dot_product")
_PROMPT = "The person moves across and picks an object."
_DIFFUSION_STEPS = 50
# Steps of the deterministic chain in one iteration of noise optimisation.
_OPTIMISATION_STEPS = 10
_GUIDANCE = 2.5
# Word pieces of the prompt in DistilBERT's vocabulary, the two special ones included.
_WORD_PIECES = 11
SIZES = {
    "paper": {"width": 512, "heads": 4, "layers": 8, "feed_forward": 1024},
    "small": {"width": 128, "heads": 4, "layers": 4, "feed_forward": 448},
}


class _Recorder(TorchDispatchMode):
    """Records every matrix product that runs inside the block."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[Callable[[], object]] = []
        self._inputs: dict[tuple[object, ...], torch.Tensor] = {}

    def __torch_dispatch__(
        self, func: Any, types: object, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> object:
        kwargs = kwargs or {}
        if func.overloadpacket.__name__.startswith(_PRODUCTS):
            own = [self._like(value) for value in args]
            named = {name: self._like(value) for name, value in kwargs.items()}
            self.calls.append(lambda: func(*own, **named))
        return func(*args, **kwargs)

    def _like(self, value: Any) -> Any:
        """Return random numbers in the place of a tensor; products of equal sizes share theirs."""
        if not isinstance(value, torch.Tensor) or not value.is_floating_point():
            return value
        key = (tuple(value.shape), value.stride(), value.dtype, value.device)
        if key not in self._inputs:
            # An expanded tensor has fewer numbers than places.
            size = 1 + sum((n - 1) * step for n, step in zip(value.shape, value.stride(), strict=True))
            numbers = torch.randn(size, dtype=value.dtype, device=value.device) * 0.01
            self._inputs[key] = numbers.as_strided(value.shape, value.stride())
        return self._inputs[key]


def products_of(work: Callable[[], object]) -> Callable[[], None]:
    """Return a function that repeats the matrix products of some work, in their order.

    Args:
        work: Runs once, to see what it multiplies.
    """
    recorder = _Recorder()
    with recorder:
        work()

    @torch.no_grad()
    def repeat() -> None:
        for call in recorder.calls:
            call()

    return repeat


class FixedText:
    """A text encoder in place of a real one: the same random vectors for every text."""

    def __init__(self, dimension: int, tokens: int) -> None:
        self.name = "fixed"
        self.dimension = dimension
        self.vectors = np.random.default_rng(0).normal(size=(tokens, dimension)).astype(np.float32)

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """Return the same vectors for every text."""
        tokens = np.tile(self.vectors, (len(texts), 1, 1))
        return EncodedText(tokens, np.zeros(tokens.shape[:2], dtype=bool))


def _model(architecture: Any, options: argparse.Namespace, *, frames_per_token: int = 1) -> MotionModel:
    """Return a frozen, random model: a decoder of DistilBERT's word pieces, or an encoder of CLIP's one vector."""
    torch.manual_seed(0)
    text = FixedText(768, _WORD_PIECES) if architecture == "decoder" else FixedText(512, 1)
    configuration = DenoiserConfiguration(
        architecture=architecture,
        frames_per_token=frames_per_token,
        text_dimension=text.dimension,
        diffusion_steps=_DIFFUSION_STEPS,
        max_frames=options.frames,
        **SIZES[options.size],
    )
    denoiser = Denoiser(configuration).to(options.device)
    return MotionModel(denoiser, mean=torch.zeros(263), std=torch.ones(263), scaling=None, texts=TextVectors(text))


def main() -> None:
    """Print one table a job."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--size", choices=SIZES, default="paper")
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--batch", type=int, default=1, help="sequences at once")
    parser.add_argument("--iterations", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    batch = ConditionBatch(
        condition=Condition.TEXT,
        n_frames=np.full(options.batch, options.frames),
        fps=20.0,
        opaque_id=tuple(map(str, range(options.batch))),
        noise_seed=tuple(range(options.batch)),
        text=(_PROMPT,) * options.batch,
    )
    print(f"{options.threads} threads, {options.device}, torch {torch.__version__}, processor time of a sequence")
    for measure in (time_sampling, time_optimisation, time_training):
        measure(batch, options)


def time_sampling(batch: ConditionBatch, options: argparse.Namespace) -> None:
    """Text vectors to joints: 50 guided DDPM steps of the decoder, as ``--method mdm`` does."""

    def sampling(frames_per_token: int = 1) -> Callable[[], object]:
        model = _model("decoder", options, frames_per_token=frames_per_token)
        return lambda: generate(model, batch, SamplingSettings(guidance=_GUIDANCE))

    jobs = {
        "float32": sampling(),
        "float32, two frames a token (another network)": sampling(2),
        "matrix products of float32 alone": products_of(sampling()),
    }
    title = f"one sequence of {options.frames} frames by {_DIFFUSION_STEPS} guided steps"
    print_rows(title, shortest(jobs, options.repeats, len(batch)))


def time_optimisation(batch: ConditionBatch, options: argparse.Namespace) -> None:
    """One guided iteration of DNO over 10 steps of the encoder: forward, backward, Adam."""
    model = _model("encoder", options)
    poses = torch.randn((2, len(batch), 22, 3), generator=torch.Generator().manual_seed(1)).to(options.device)
    targets = Targets(initial_joints=poses[0], previous_joints=poses[0], goal_joints=poses[1])
    condition = model.encode(batch)

    def search(iterations: int) -> Callable[[], object]:
        settings = OptimisationSettings(
            ddim_steps=_OPTIMISATION_STEPS, iterations=iterations, guidance=_GUIDANCE, batch_size=len(batch)
        )
        noise = start_noise(batch.noise_seed, batch.n_frames, options.device)
        n_frames = torch.as_tensor(batch.n_frames)
        return lambda: optimise_noise(
            model, condition, targets, n_frames, noise, settings, seeds=batch.noise_seed, objective=keyframes
        )

    jobs = {}
    # The difference to one iteration leaves out what is done once.
    for iterations in (1, 1 + options.iterations):
        jobs["float32", iterations] = search(iterations)
        jobs["matrix products of float32 alone", iterations] = products_of(search(iterations))
    seconds = shortest(jobs, options.repeats, options.iterations * len(batch))
    names = [name for name, iterations in jobs if iterations == 1]
    rows = {name: seconds[name, 1 + options.iterations] - seconds[name, 1] for name in names}
    print_rows(f"one guided iteration over {_OPTIMISATION_STEPS} steps, {options.frames} frames", rows)


def time_training(batch: ConditionBatch, options: argparse.Namespace) -> None:
    """One training step of the decoder: forward, squared error, backward, AdamW."""
    model = _model("decoder", options)
    condition = model.encode(batch)
    denoiser = model.denoiser.train().requires_grad_(True)
    optimiser = torch.optim.AdamW(denoiser.parameters(), lr=1e-4)
    generator = torch.Generator().manual_seed(2)
    clean = torch.randn((len(batch), options.frames, 263), generator=generator).to(options.device)
    steps = torch.zeros(len(batch), dtype=torch.long, device=options.device)

    def step() -> object:
        optimiser.zero_grad(set_to_none=True)
        loss = (denoiser(clean, steps, condition, torch.as_tensor(batch.n_frames)) - clean).square().mean()
        loss.backward()
        optimiser.step()
        return loss

    jobs = {"float32": step, "matrix products of float32 alone": products_of(step)}
    print_rows(f"one training step, {options.frames} frames", shortest(jobs, options.repeats, len(batch)))


def shortest(jobs: dict[Any, Callable[[], object]], repeats: int, parts: int) -> dict[Any, float]:
    """Return the shortest time of each job, divided by ``parts``.

    Jobs take turns, so that a busy moment meets all of them alike. Time is that of the processor, except on a GPU.
    """
    clock = time.perf_counter if torch.cuda.is_available() else time.process_time
    best = dict.fromkeys(jobs, float("inf"))
    for turn in range(repeats + 1):  # the first turn warms up
        for name, work in jobs.items():
            start = clock()
            work()
            if torch.cuda.is_available():
                torch.cuda.synchronize()
            best[name] = min(best[name], clock() - start) if turn else best[name]
    return {name: seconds / parts for name, seconds in best.items()}


if __name__ == "__main__":
    main()
