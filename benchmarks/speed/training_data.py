"""Time the data of a training: making the feature store, opening it, batches a second, and waiting beside a network."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path

import torch

from benchmarks.speed.timing import Row, print_rows
from prbench.harness.synthetic_table import build_synthetic_table
from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.training import LengthBatches, MotionBatch, SequenceDataset
from prbench_adapters.training.batches import WaitingClock, load_batches

BATCHES = 100
STEPS = 4


def time_training_data(tables: Sequence[Path], *, batch_size: int) -> None:
    """Print the times for some tables; for a small synthetic one if none is given."""
    with tempfile.TemporaryDirectory() as folder:
        if not tables:
            tables = [Path(folder) / "table"]
            build_synthetic_table("adt", recordings=8, seed=0, out=tables[0])
        _run(tables, Path(folder) / "cache", batch_size)


def _run(tables: Sequence[Path], cache: Path, batch_size: int) -> None:
    making = _seconds(lambda: SequenceDataset(tables, cache=cache))
    opening = min(_seconds(lambda: SequenceDataset(tables, cache=cache)) for _ in range(3))
    data = SequenceDataset(tables, cache=cache)
    batches = list(islice(load_batches(data, LengthBatches(data, batch_size)), BATCHES))
    loading = min(
        _seconds(lambda: list(islice(load_batches(data, LengthBatches(data, batch_size)), BATCHES))) for _ in range(3)
    )
    frames = sum(int(batch.n_frames.sum()) for batch in batches)
    padded = sum(batch.padding.numel() for batch in batches)
    rows = [
        Row(f"a batch of {batch_size}, memory-mapped", loading / BATCHES),
        Row(f"making the store of {len(data):,} rows, once", making),
        Row("opening tables and store", opening),
    ]
    print_rows(f"training data: {frames / loading:,.0f} frames a second, {1 - frames / padded:.1%} padding", rows)
    for name, layers, width in (("1 M", 4, 128), ("26 M", 8, 512)):
        print(f"waiting for data beside a network of {name} parameters on the CPU: {_waiting(data, layers, width):.2%}")


def _waiting(data: SequenceDataset, layers: int, width: int) -> float:
    """Fraction of the time of some training steps, batches of 8."""
    denoiser = Denoiser(DenoiserConfiguration(layers=layers, width=width, text_dimension=64))
    optimiser = torch.optim.AdamW(denoiser.parameters())
    clock = WaitingClock()
    for batch in islice(clock.timed(load_batches(data, LengthBatches(data, 8))), STEPS):
        loss = (_estimate(denoiser, batch) - batch.features).square()[~batch.padding].mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return clock.fraction


def _estimate(denoiser: Denoiser, batch: MotionBatch) -> torch.Tensor:
    text = EncodedCondition(torch.zeros(len(batch), 1, 64), torch.zeros(len(batch), 1, dtype=torch.bool), None)
    return denoiser(batch.features, torch.zeros(len(batch), dtype=torch.long), text, batch.n_frames)


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
