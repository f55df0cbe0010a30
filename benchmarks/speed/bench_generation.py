"""Time sampling, noise optimisation and training data, beside the public code of MDM and DNO where it is given.

Run from the repository's root, on an otherwise idle machine:

    python -m benchmarks.speed.bench_generation [--reference DIR]... [--threads 2] [--data TABLE]...

``--reference`` names a checkout of github.com/GuyTevet/motion-diffusion-model (compared by sampling and training) or
of github.com/korrawe/Diffusion-Noise-Optimization (compared by noise optimisation); give it twice for both. Theirs and
ours then run in turn in this process: random weights, the same number of parameters, frames, sequences at once,
guidance, text vectors and threads. Seconds are per sequence, the shortest of some repetitions. Beside them stand the
matrix products of our own work alone, which no way of writing it can go below.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from benchmarks.speed.generation_cases import (
    DIFFUSION_STEPS,
    GUIDANCE,
    OPTIMISATION_STEPS,
    SIZES,
    Problem,
    n_parameters,
    our_model,
    our_optimisation,
    our_sampling,
    our_training,
    sentence,
    word_pieces,
)
from benchmarks.speed.matrix_products import products_of
from benchmarks.speed.reference_checkout import Checkout
from benchmarks.speed.timing import Row, print_rows
from benchmarks.speed.training_data import time_training_data

Work = Callable[[], object]
Clock = Callable[[], float]


def main() -> None:
    """One table a size and job, then the training data."""
    options = _options()
    torch.set_num_threads(options.threads)
    clock: Clock = time.process_time if options.processor_time else time.perf_counter
    checkouts = {checkout.name: checkout for checkout in map(Checkout, options.reference)}
    print(f"{options.threads} threads, {options.device}, torch {torch.__version__}, guidance {GUIDANCE}")
    for size in options.sizes:
        for batch in options.batch:
            problem = Problem(SIZES[size], options.frames, batch, options.device)
            if "sampling" in options.jobs:
                time_sampling(problem, checkouts.get("MDM"), options.repeats, clock)
            if "optimisation" in options.jobs:
                time_optimisation(problem, checkouts.get("DNO"), options.repeats, options.iterations, clock)
            if "training" in options.jobs:
                time_training(problem, checkouts.get("MDM"), options.repeats, clock)
    if "data" in options.jobs:
        time_training_data(options.data, batch_size=64)


def time_sampling(problem: Problem, reference: Checkout | None, repeats: int, clock: Clock) -> None:
    """50 guided DDPM steps of the decoder with DistilBERT's word pieces, text vectors to joints."""
    ours = n_parameters(our_model(problem, "decoder", word_pieces()).denoiser)
    jobs: dict[str, Work] = {
        "prbench, float32": our_sampling(problem),
        "prbench, bfloat16": our_sampling(problem, precision="bfloat16"),
        "prbench, float32, two frames a token (another network)": our_sampling(problem, frames_per_token=2),
    }
    jobs["its matrix products alone, float32"] = products_of(jobs["prbench, float32"])
    if reference is not None:
        theirs, sample = reference.sampling(problem)
        _require_equal_size(ours, theirs)
        jobs["MDM's public code"] = sample
    title = f"one sequence of {problem.frames} frames by {DIFFUSION_STEPS} guided steps"
    rows = [Row(name, seconds / problem.batch) for name, seconds in shortest(jobs, repeats, clock).items()]
    _print(title, problem, ours, rows)


def time_optimisation(
    problem: Problem, reference: Checkout | None, repeats: int, iterations: int, clock: Clock
) -> None:
    """One guided iteration of noise optimisation over 10 steps of the encoder with one sentence vector."""
    ours = n_parameters(our_model(problem, "encoder", sentence()).denoiser)
    searches = {
        "prbench, float32": our_optimisation(problem),
        "prbench, bfloat16": our_optimisation(problem, precision="bfloat16"),
    }
    if reference is not None:
        theirs, searches["DNO's public code"] = reference.optimisation(problem)
        _require_equal_size(ours, theirs)
    first: dict[str, Work] = {name: lambda search=search: search(1) for name, search in searches.items()}
    more: dict[str, Work] = {
        f"{name}, more": lambda search=search: search(1 + iterations) for name, search in searches.items()
    }
    alone = "its matrix products alone, float32"
    first[alone] = products_of(first["prbench, float32"])
    more[f"{alone}, more"] = products_of(more["prbench, float32, more"])
    seconds = shortest(first | more, repeats, clock)
    rows = [Row(name, (seconds[f"{name}, more"] - seconds[name]) / (iterations * problem.batch)) for name in first]
    title = f"one guided iteration over {OPTIMISATION_STEPS} steps, {problem.frames} frames"
    _print(title, problem, ours, rows)


def time_training(problem: Problem, reference: Checkout | None, repeats: int, clock: Clock) -> None:
    """One training step of the decoder with DistilBERT's word pieces."""
    ours = n_parameters(our_model(problem, "decoder", word_pieces()).denoiser)
    jobs: dict[str, Work] = {"prbench, float32": our_training(problem)}
    jobs["its matrix products alone, float32"] = products_of(jobs["prbench, float32"])
    if reference is not None:
        theirs, jobs["MDM's public code"] = reference.training(problem)
        _require_equal_size(ours, theirs)
    rows = [Row(name, seconds / problem.batch) for name, seconds in shortest(jobs, repeats, clock).items()]
    _print(f"one training step, {problem.frames} frames", problem, ours, rows)


def shortest(jobs: dict[str, Work], repeats: int, clock: Clock) -> dict[str, float]:
    """The shortest time of each job; they take turns, so that a busy moment meets all of them alike."""
    best = dict.fromkeys(jobs, float("inf"))
    for turn in range(repeats + 1):  # the first turn warms up
        for name, work in jobs.items():
            seconds = _seconds(work, clock)
            best[name] = min(best[name], seconds) if turn else best[name]
    return best


def _seconds(work: Work, clock: Clock) -> float:
    start = clock()
    work()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return clock() - start


def _require_equal_size(ours: int, theirs: torch.nn.Module) -> None:
    if ours != n_parameters(theirs):
        raise SystemExit(f"networks of different size: ours {ours:,} parameters, theirs {n_parameters(theirs):,}.")


def _print(title: str, problem: Problem, parameters: int, rows: Sequence[Row]) -> None:
    together = f"{problem.batch} at once" if problem.batch > 1 else "one at a time"
    print_rows(f"{title}, {parameters / 1e6:.1f} M parameters, {together}", rows)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reference", type=Path, action="append", default=[], metavar="DIR")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument(
        "--processor-time", action="store_true", help="of all threads; for one thread on a busy machine"
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES))
    parser.add_argument("--jobs", nargs="+", default=["sampling", "optimisation", "training", "data"])
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--batch", type=int, nargs="+", default=[1, 8], help="sequences at once")
    parser.add_argument("--iterations", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--data", type=Path, nargs="+", default=[], help="tables for the training data; else synthetic")
    return parser.parse_args()


if __name__ == "__main__":
    main()
