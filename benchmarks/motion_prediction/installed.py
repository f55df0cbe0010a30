"""The predictors without learning as packages offer theirs: entry points of the group ``prbench.predictors``.

An entry point is a function ``load(weights, *, options, device)`` that returns a
:class:`~prbench_benchmarks.motion_prediction.batch.Predictor`.
One that learns from a table has ``fit(train)`` as well, which a run
calls where the user gave no weights; it is shown the training split alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch
from prbench_benchmarks.motion_prediction.predictors import ConstantVelocity, NearestPast, ZeroVelocity
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import Truth, WindowsTable


@dataclass(frozen=True)
class TrainingWindows:
    """The windows of a table that a predictor may learn from."""

    folder: Path

    def batches(self, condition: Condition, *, size: int = 64) -> Iterator[tuple[ObservedBatch, Truth]]:
        """Yield the windows of the training split with what happened, as a run shows those of another split.

        Args:
            condition: What is known of the observed frames.
            size: Windows of a batch.

        Raises:
            UsageError: if there is none.
        """
        table = WindowsTable.open(self.folder)
        frame = load_prediction_protocol().evaluation.frame
        return table.batches(condition, table.chosen(split="train"), frame=frame, size=size)


@dataclass
class NearestPastOfTable:
    """:class:`NearestPast` of the training windows of the table that it is run on, under whatever condition."""

    name: str = "nearest-past"
    conditions: frozenset[Condition] = frozenset(Condition)
    train: TrainingWindows | None = None
    _remembered: dict[Condition, NearestPast] = field(default_factory=dict)

    def fit(self, train: TrainingWindows) -> None:
        """Remember which windows may be learnt from; they are read when the condition is known."""
        self.train = train

    def predict(self, batch: ObservedBatch, *, n_samples: int, seed: int) -> Futures:
        """See :class:`prbench_benchmarks.motion_prediction.batch.Predictor`.

        Raises:
            UsageError: if it was not fitted, or remembers fewer windows than samples are asked for.
        """
        if self.train is None:
            raise UsageError(f"{self.name}: expected to be fitted to a table of windows first; `prbench run` does so.")
        if batch.condition not in self._remembered:
            self._remembered[batch.condition] = NearestPast.fit(self.train.batches(batch.condition))
        return self._remembered[batch.condition].predict(batch, n_samples=n_samples, seed=seed)


def zero_velocity(weights: Path | None, *, options: Mapping[str, str], device: str) -> ZeroVelocity:
    """Entry point ``zero-velocity``."""
    _require_nothing("zero-velocity", weights, options, device)
    return ZeroVelocity()


def constant_velocity(weights: Path | None, *, options: Mapping[str, str], device: str) -> ConstantVelocity:
    """Entry point ``constant-velocity``."""
    _require_nothing("constant-velocity", weights, options, device)
    return ConstantVelocity()


def nearest_past(weights: Path | None, *, options: Mapping[str, str], device: str) -> NearestPastOfTable:
    """Entry point ``nearest-past``."""
    _require_nothing("nearest-past", weights, options, device)
    return NearestPastOfTable()


def _require_nothing(name: str, weights: Path | None, options: Mapping[str, str], device: str) -> None:
    del device  # they run anywhere
    if weights is not None:
        raise ValueError(f"{name} has no weights.")
    if options:
        raise ValueError(f"unknown option '{next(iter(options))}'; {name} has none.")
