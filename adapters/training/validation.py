"""Validation while training goes on: losses on part of the validation split.

The noise of the losses is the same every time, so two validations differ by the weights alone. The benchmark's metrics
of a state of the weights come from ``prbench run --split validation --weights FOLDER/weights.safetensors``.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import torch

from prbench.engine import IN_PROCESS, Engine
from prbench.errors import UsageError
from prbench.sequences.table import by_share
from prbench_adapters.training.batches import Items, WindowsDataset
from prbench_adapters.training.configuration import TrainingConfiguration
from prbench_adapters.training.dataset import configured_dataset
from prbench_adapters.training.state import Row
from prbench_adapters.training.store import Table
from prbench_adapters.training.task import TrainingModule

_SPLIT = "validation"


@dataclass(frozen=True)
class Validation:
    """Chosen sequences and settings of a validation, the same at every step of a training.

    Attributes:
        places: Places of the chosen items in ``data``, by length.
    """

    data: Items
    places: tuple[int, ...]
    batch_size: int

    @classmethod
    def prepare(
        cls, tables: Iterable[Table], configuration: TrainingConfiguration, *, engine: Engine = IN_PROCESS
    ) -> Validation:
        """Choose the sequences. Tables without validation sequences are left out.

        Raises:
            UsageError: if no table has validation sequences.
        """
        wanted = configuration.validation
        usable = [table for table in tables if table.scalars(split=_SPLIT, columns=["split"]).num_rows]
        if not usable:
            remedy = "Build more recordings, or train without: --set validation.every=0."
            raise UsageError(f"no table has sequences in split 'validation'. {remedy}")
        data = configured_dataset(usable, configuration, split=_SPLIT, engine=engine)
        chosen: set[str] = set()
        for table in usable:
            rows = table.scalars(split=_SPLIT, columns=["sequence_id", "recording_id"])
            names = by_share(rows["sequence_id"].to_pylist(), rows["recording_id"].to_pylist())
            chosen.update(names[: wanted.sequences])
        places = [place for place, name in enumerate(data.sequence_ids) if name in chosen]
        return cls(data, tuple(sorted(places, key=lambda place: (int(data.lengths[place]), place))), wanted.batch_size)

    @classmethod
    def of_windows(cls, train: WindowsDataset, configuration: TrainingConfiguration) -> Validation:
        """Choose windows of the split ``validation`` of the tables that are learnt from.

        Raises:
            TableError: if a table has no validation windows.
        """
        wanted = configuration.validation
        data = WindowsDataset(train.tables, split=_SPLIT, choice=train.choice, seed=configuration.training.seed)
        return cls(data, data.spread(wanted.sequences), wanted.batch_size)

    @torch.no_grad()
    def measure(self, module: TrainingModule, device: torch.device) -> Row:
        """Losses of a module in evaluation mode, by name; what has no value on these sequences is left out."""
        totals: dict[str, float] = defaultdict(float)
        for number, start in enumerate(range(0, len(self.places), self.batch_size)):
            places = self.places[start : start + self.batch_size]
            batch = self.data.collate([self.data[place] for place in places]).to(device)  # pyright: ignore[reportArgumentType]
            # Negative steps draw the same noise at every validation and none that training has drawn.
            for name, loss in module(batch, -1 - number).items():
                totals[name] += float(loss) * len(places)
        means = {name: total / len(self.places) for name, total in totals.items()}
        return {name: value for name, value in means.items() if math.isfinite(value)}
