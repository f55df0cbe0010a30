"""The smallest network that exercises everything that a training is made of: noise, dropout, statistics, an adapter."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import torch
from torch import nn

from prbench.errors import UsageError
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.task import TrainingData, TrainingModule
from prbench_adapters.training.weights import read_weights

SIGNAL_VARIABLE = "PRBENCH_TOY_SIGNAL"
"""``7:SIGKILL`` sends that signal to the process when batch 7 is computed."""


class Toy(TrainingModule):
    """Reconstructs noisy features through a bottleneck."""

    def __init__(self, width: int, *, dropout: float = 0.2, std: float = 1.0) -> None:
        super().__init__()
        self.network = nn.Sequential(nn.Linear(263, width), nn.GELU(), nn.Dropout(dropout), nn.Linear(width, 263))
        self.register_buffer("std", torch.tensor([std]))
        self.frozen = nn.Linear(3, 3).requires_grad_(False)
        self.width = width

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        number, _, name = os.environ.get(SIGNAL_VARIABLE, "").partition(":")
        if name and int(number) == step:
            os.kill(os.getpid(), signal.Signals[name])
        valid = ~batch.padding
        clean = batch.features[valid] / self.get_buffer("std")
        noise = torch.randn(batch.features.shape, generator=self.generator(step)).to(clean.device)[valid]
        error = (self.network(clean + 0.1 * noise).float() - clean).square()
        return {"loss": error.mean(), "root": error[:, :4].mean()}

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        tensors = {f"toy.{name}": tensor for name, tensor in self.network.state_dict().items()}
        return tensors, {"kind": "toy", "configuration": f'{{"width":{self.width}}}'}

    origin = ("nothing much",)


@dataclass(frozen=True)
class ToyTask:
    name: str = "toy"
    configurations: str = "tests.adapters.training.configurations"

    def build(self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str) -> Toy:
        if set(model) - {"width", "dropout"}:
            raise UsageError(f"[model]: unknown keys in {sorted(model)}.")
        toy = Toy(**model, std=float(data.train.statistics().std.mean()))
        if initial is not None:
            read_weights(initial, kind="toy").load_into(toy.network, "toy")
        return toy


def entry_points_of(group: str) -> list[EntryPoint]:
    """In place of the installed ones."""
    return [EntryPoint("toy", "tests.adapters.training.toy:ToyTask", group)]


def random_batch(number: int, *, size: int = 4, frames: int = 5) -> MotionBatch:
    """A batch of noise, all rows of one length, that depends on its number alone."""
    draw = torch.Generator().manual_seed(number)
    poses = torch.randn(size, 22, 3, generator=draw)
    return MotionBatch(
        features=torch.randn(size, frames, 263, generator=draw),
        joints=torch.randn(size, frames, 22, 3, generator=draw),
        padding=torch.zeros(size, frames, dtype=torch.bool),
        n_frames=torch.full((size,), frames),
        text=("walk",) * size,
        initial_joints=poses,
        previous_joints=poses,
        goal_joints=poses,
        goal_location=poses[:, 0],
        fps=20.0,
        sequence_id=tuple(f"{number}/{row}" for row in range(size)),
    )


def random_batches(start: int) -> Iterator[MotionBatch]:
    """Endless batches from number ``start`` on."""
    while True:
        yield random_batch(start)
        start += 1


def toy(width: int = 6, *, dropout: float = 0.2) -> Toy:
    """A toy in its state before the first step."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return Toy(width, dropout=dropout)


def rows_of(batch: MotionBatch, part: slice) -> MotionBatch:
    """Some rows of a batch."""
    values = {field.name: getattr(batch, field.name) for field in fields(batch)}
    return MotionBatch(**{name: value if name == "fps" else value[part] for name, value in values.items()})
