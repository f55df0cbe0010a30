"""A predictor under examination."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from prbench.checking.conformance.answer import STATE_SEED
from prbench.checking.conformance.method_subject import MethodSubject
from prbench.checking.conformance.predictors.answer import FuturesAnswer, ask_predictor
from prbench.checking.conformance.predictors.cases import AskedWindows
from prbench.checking.conformance.report import Remedy
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.loading import LoadedMethod, MethodSpec, unload_method
from prbench.harness.methods.remote import RemoteMethod
from prbench.prediction.batch import Condition, ObservedBatch
from prbench.prediction.protocol import load_prediction_protocol
from prbench.prediction.table import WindowsTable
from prbench.protocol.manifests import find_benchmark

BENCHMARK = "motion-prediction"
RICHEST_FIRST = (Condition.POSE_GAZE, Condition.POSE_HEAD, Condition.POSE)
"""The condition that most checks use is the first of these that works."""
_FEW = 5
_OTHER_KEYS = 7919
"""Added to the keys of windows for other ones."""


class PredictorSubject(MethodSubject):
    """A predictor, and the windows that it is asked about.

    Args:
        spec: How to make it.
        cases: What it is asked about.
        folder: Of this check.
    """

    case = "window"
    answer = "window"
    asks = "predicts"
    own_generators = Remedy(
        "Draw from one generator a sample: prbench.prediction.sample_generator(seed, batch.key[row], k), or"
        " torch.Generator().manual_seed(…) of a number drawn from it.",
        "Draw from one generator a sample, made of seed, the key of its row and the number k of the sample alone"
        " (numpy.random.default_rng([seed, key, k])).",
    )
    own_row = (
        "Every row is complete in itself: draw from seed, its own key and k, and let no statistic (batch normalisation,"
        " a common stopping rule) run over rows."
    )

    def __init__(self, spec: MethodSpec, cases: AskedWindows, folder: Path) -> None:
        super().__init__(spec, folder)
        self.cases = cases
        self._as_given = spec
        self._observed: dict[Condition, ObservedBatch] = {}

    @property
    def samples(self) -> int:
        """Futures that most checks ask for: few, or the benchmark's usual number of those that are one design."""
        return find_benchmark(BENCHMARK).samples if self.declared.one_design else _FEW

    @property
    def many_samples(self) -> int:
        """The benchmark's usual number of futures."""
        return find_benchmark(BENCHMARK).samples

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions that it declares and the windows can be shown under, the richest first."""
        shown = [each for each in RICHEST_FIRST if each is not Condition.POSE_GAZE or self.cases.table.info.has_gaze]
        return tuple(condition for condition in shown if condition in self.declared.conditions)

    @property
    def n_cases(self) -> int:
        """Number of windows."""
        return len(self.cases.table.chosen(split="test"))

    @property
    def limits(self) -> str:
        """Say whether its samples are one design."""
        return "its samples are one design" if self.declared.one_design else "fewer samples are a prefix of more"

    def learns(self, loaded: LoadedMethod) -> bool:
        """Return True if a run would fit it to the training windows."""
        if isinstance(loaded.adapter, RemoteMethod):
            return loaded.adapter.trainable
        return hasattr(loaded.adapter, "fit")

    def fitted_spec(self) -> MethodSpec:
        """Fit it as a run does: it is shown the training windows of the table."""
        return self._fitted_to(self.cases.table)

    def _fitted_to(self, table: WindowsTable) -> MethodSpec:
        return load_benchmark(BENCHMARK).fitted(self._as_given, table, Condition.POSE)

    def observed(self, condition: Condition, table: WindowsTable | None = None) -> ObservedBatch:
        """Return all windows as a run shows them.

        Args:
            condition: What is known of them.
            table: Where they are; by default the one with their futures.
        """
        if table is None:
            if condition not in self._observed:
                self._observed[condition] = self.observed(condition, self.cases.table)
            return self._observed[condition]
        places = table.chosen(split="test")
        frame = load_prediction_protocol().evaluation.frame
        return next(table.batches(condition, places, frame=frame, size=len(places)))[0]

    def batch(self, rows: Sequence[int], condition: Condition, *, sample: int = 0) -> ObservedBatch:
        """See :meth:`MethodSubject.batch`; another sample has other keys."""
        batch = self.rows_of(self.observed(condition), rows)
        return self.with_keys(batch, sample * _OTHER_KEYS) if sample else batch

    @staticmethod
    def with_keys(batch: ObservedBatch, added: int) -> ObservedBatch:
        """Return the batch with other keys."""
        return dataclasses.replace(batch, key=tuple((key + added) % 2**63 for key in batch.key))

    def rows_of(self, batch: ObservedBatch, rows: Sequence[int]) -> ObservedBatch:
        """See :meth:`MethodSubject.rows_of`."""
        return batch.chosen(rows)

    def nudged(self, batch: ObservedBatch, by: np.float32) -> ObservedBatch:
        """Move the observed poses."""
        return dataclasses.replace(batch, observed_joints=batch.observed_joints + by)

    def ask(
        self, batch: ObservedBatch, *, seed: int = 0, state_seed: int = STATE_SEED, n_samples: int | None = None
    ) -> FuturesAnswer:
        """See :meth:`MethodSubject.ask`.

        Args:
            batch: What it is asked.
            seed: Of the run.
            state_seed: Of the global generators.
            n_samples: Futures of each window; :attr:`samples` by default.
        """
        return self._asked(self.adapter, batch, seed=seed, state_seed=state_seed, n_samples=n_samples or self.samples)

    def ask_without_futures(self, condition: Condition, rows: Sequence[int]) -> FuturesAnswer:
        """Make the predictor anew where no future is to be found, fit it there if it learns, and ask it.

        Args:
            condition: What it knows.
            rows: Numbers of the windows.
        """
        samples = self.samples
        learns = self.learns(self.loaded) and self.spec.weights is None
        # Whatever the predictor has kept from before is gone with it.
        unload_method()
        spec = self._fitted_to(self.cases.blind) if learns else self._as_given
        batch = self.rows_of(self.observed(condition, self.cases.blind), rows)
        answer = self._asked(spec.load().adapter, batch, seed=0, state_seed=STATE_SEED, n_samples=samples)
        unload_method()
        vars(self).pop("loaded", None)
        return answer

    def _asked(self, predictor: Any, batch: ObservedBatch, *, seed: int, state_seed: int, n_samples: int) -> Any:
        of_one = "1 window" if len(batch) == 1 else f"{len(batch)} windows"
        self.asking(f"while it predicted {n_samples} futures of {of_one} under {batch.condition.value}")
        answer = ask_predictor(
            predictor, batch, n_samples=n_samples, seed=seed, state_seed=state_seed, threads=self.spec.threads
        )
        self.drew_from.update(answer.drew_from)
        return answer


def anchored(batch: ObservedBatch) -> ObservedBatch:
    """Return a batch at the rate of anchored windows, 20 frames a second, made of the last observed frames."""
    rules = load_prediction_protocol().windows.at(20.0)
    last = slice(-rules.observed_frames, None)
    return replace(
        batch,
        fps=rules.fps,
        n_future=rules.future_frames,
        observed_joints=batch.observed_joints[:, last],
        gaze=None if batch.gaze is None else batch.gaze[:, last],
        gaze_valid=None if batch.gaze_valid is None else batch.gaze_valid[:, last],
    )
