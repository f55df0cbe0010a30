"""Validation while training goes on: losses, and the benchmark's metrics, on part of the validation split.

The noise of the losses is the same every time, so two validations differ by the weights alone. Motions are generated
and scored exactly as ``prbench run`` does it (*Prime and Reach*, section 5.2), by the module's own adapter.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from prbench.contract import Adapter, Condition
from prbench.engine import Engine, InProcess
from prbench.errors import UsageError
from prbench.harness.conditions import ConditionSource, run_salt
from prbench.harness.methods.motions import Declared, generate_checked
from prbench.harness.planning import Selection, plan_batches, select, supported
from prbench.harness.run_folder.predictions import PredictionRows, write_part
from prbench.harness.scoring import ScoringRules, score_selection
from prbench.metrics import MAIN_METRICS
from prbench.protocol.manifests import load_protocol
from prbench.sequences import SequenceTable
from prbench.sequences.table import by_share
from prbench_adapters.training.batches import WindowBatch, WindowsDataset
from prbench_adapters.training.configuration import TrainingConfiguration
from prbench_adapters.training.dataset import MotionBatch, SequenceDataset, configured_dataset
from prbench_adapters.training.state import Row
from prbench_adapters.training.store import Table
from prbench_adapters.training.task import TrainingModule

_IN_PROCESS = InProcess()
_SPLIT = "validation"
_SCORES = tuple(info.id for info in MAIN_METRICS)


@dataclass(frozen=True)
class Validation:
    """Chosen sequences and settings of a validation, the same at every step of a training."""

    data: SequenceDataset | WindowsDataset
    places: tuple[int, ...]
    """Places of the chosen items in ``data``, by length."""
    selections: tuple[Selection, ...]
    """Sequences of the tables that motions are generated for."""
    condition: Condition | None
    batch_size: int
    seed: int

    @classmethod
    def prepare(
        cls, tables: Iterable[Table], configuration: TrainingConfiguration, *, engine: Engine = _IN_PROCESS
    ) -> Validation | None:
        """Choose the sequences; None if the configuration asks for no validation.

        Tables without validation sequences are left out, and corpora, which have no goals, give losses only.

        Raises:
            UsageError: if no table has validation sequences.
        """
        wanted = configuration.validation
        if not wanted.every:
            return None
        usable = [table for table in tables if table.scalars(split=_SPLIT, columns=["split"]).num_rows]
        if not usable:
            raise UsageError(
                "no table has sequences in split 'validation'. Build more recordings, or train without:"
                " --set validation.every=0."
            )
        dataset = configured_dataset(usable, configuration, split=_SPLIT, engine=engine)
        return cls(
            dataset,
            _chosen(dataset, usable, wanted.sequences),
            _selections(usable, wanted.sequences) if wanted.condition is not None else (),
            Condition(wanted.condition) if wanted.condition is not None else None,
            wanted.batch_size,
            configuration.training.seed,
        )

    @classmethod
    def of_windows(cls, train: WindowsDataset, configuration: TrainingConfiguration) -> Validation | None:
        """Choose windows of the split ``validation`` of the tables that are learnt from.

        Raises:
            UsageError: if a condition for generated motions is asked for.
            TableError: if a table has no validation windows.
        """
        wanted = configuration.validation
        if not wanted.every:
            return None
        if wanted.condition is not None:
            raise UsageError(
                "validation.condition: generates prime-and-reach motions; a network of motion prediction validates by"
                " its losses and errors. Leave it out."
            )
        data = WindowsDataset(train.tables, split=_SPLIT, choice=train.choice, seed=configuration.training.seed)
        seed = configuration.training.seed
        return cls(data, data.spread(wanted.sequences), (), None, wanted.batch_size, seed)

    @torch.no_grad()
    def measure(
        self, module: TrainingModule, device: torch.device, autocast: AbstractContextManager | None = None
    ) -> Row:
        """Losses and metrics of a module as it is, by name; what has no value on these sequences is left out.

        Args:
            module: In evaluation mode.
            device: Where it is.
            autocast: Entered for the losses: the precision of the training.
        """
        with autocast or contextlib.nullcontext():
            measured = self._losses(module, device)
        adapter = module.adapter(str(device)) if self.condition is not None else None
        if adapter is not None:
            measured |= self._metrics(adapter)
        return {name: value for name, value in measured.items() if math.isfinite(value)}

    def _losses(self, module: TrainingModule, device: torch.device) -> Row:
        totals: dict[str, float] = defaultdict(float)
        for number, start in enumerate(range(0, len(self.places), self.batch_size)):
            places = self.places[start : start + self.batch_size]
            batch = self._batch(places).to(device)
            # Negative steps draw the same noise at every validation and none that training has drawn.
            for name, loss in module(batch, -1 - number).items():
                totals[name] += float(loss) * len(places)
        return {name: total / len(self.places) for name, total in totals.items()}

    def _batch(self, places: Sequence[int]) -> MotionBatch | WindowBatch:
        if isinstance(self.data, WindowsDataset):
            return self.data.collate([self.data[place] for place in places])
        return self.data.collate([self.data[place] for place in places])

    def _metrics(self, adapter: Adapter) -> Row:
        """Mean of every metric over the sequences of all tables."""
        values: dict[str, list[np.ndarray]] = defaultdict(list)
        declared = Declared.by(adapter, origin="the network in training")
        for selection in self.selections:
            kept = supported(selection, max_frames=declared.max_frames, native_fps=declared.native_fps)
            if len(kept):
                for name, found in self._scored(adapter, kept).items():
                    values[name].append(found)
        joined = {name: np.concatenate(values[name]) for name in _SCORES if name in values}
        return {name: float(np.nanmean(found)) for name, found in joined.items() if not np.isnan(found).all()}

    def _scored(self, adapter: Adapter, selection: Selection) -> dict[str, np.ndarray]:
        protocol = load_protocol()
        with tempfile.TemporaryDirectory(prefix="prbench-validation-") as folder:
            for number, rows in enumerate(plan_batches(selection.n_frames, self.batch_size)):
                self._generate(adapter, selection, rows, Path(folder) / f"part-{number:05d}.parquet")
            rules = ScoringRules(protocol.metrics, farthest=math.inf)
            tables = list(score_selection(selection, Path(folder), samples=(0,), rules=rules, engine=_IN_PROCESS))
        metrics = np.concatenate([np.array(table["metric"].to_pylist()) for table in tables])
        values = np.concatenate([table["value"].to_numpy() for table in tables])
        return {name: values[metrics == name] for name in np.unique(metrics).tolist()}

    def _generate(self, adapter: Adapter, selection: Selection, rows: np.ndarray, path: Path) -> None:
        assert self.condition is not None
        ids = tuple(selection.sequence_ids[row] for row in rows)
        salt = run_salt(self.seed, selection.table.info.identity_digest)
        source = ConditionSource.read(selection)
        batch = source.batch(rows, self.condition, seed=self.seed, salt=salt, sample=0)
        motions, _ = generate_checked(
            adapter,
            batch,
            seed=self.seed,
            method="the network in training",
            sequence_ids=ids,
            farthest=math.inf,  # what a network that has learnt little throws far shall end no training
        )
        write_part(
            path,
            ids,
            [batch.noise_seed],
            [PredictionRows.from_padded(motions.joints, motions.n_frames)],
            protocol_version=load_protocol().version,
        )


def _chosen(dataset: SequenceDataset, tables: Iterable[Table], limit: int) -> tuple[int, ...]:
    """Places of the rows of each table that the limit takes up, in order of length."""
    chosen: set[str] = set()
    for table in tables:
        rows = table.scalars(split=_SPLIT, columns=["sequence_id", "recording_id"])
        chosen.update(by_share(rows["sequence_id"].to_pylist(), rows["recording_id"].to_pylist())[:limit])
    places = [place for place, name in enumerate(dataset.sequence_ids) if name in chosen]
    return tuple(sorted(places, key=lambda place: (int(dataset.lengths[place]), place)))


def _selections(tables: Iterable[Table], limit: int) -> tuple[Selection, ...]:
    scorable = (table for table in tables if isinstance(table, SequenceTable) and table.info.why_not_scored is None)
    return tuple(select(table, split=_SPLIT, limit=limit) for table in scorable)
