"""The work of a run of motion prediction on the windows of one table: batches and scores."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Int

from prbench.engine import Engine
from prbench.harness.benchmark import CaseWork
from prbench.harness.request import RunRequest
from prbench.harness.run_folder.folder import DatasetFolder
from prbench.harness.run_folder.predictions import read_part
from prbench.harness.run_folder.record import MethodRecord
from prbench.harness.run_folder.scores import SCORES
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch
from prbench_benchmarks.motion_prediction.cases import WindowCases
from prbench_benchmarks.motion_prediction.joint_sets import JointSet
from prbench_benchmarks.motion_prediction.metric_infos import prediction_metrics
from prbench_benchmarks.motion_prediction.protocol import PredictionProtocol
from prbench_benchmarks.motion_prediction.question import FutureQuestion
from prbench_benchmarks.motion_prediction.scoring import SimilarPasts, score_batch
from prbench_benchmarks.motion_prediction.table import Truth

NEAREST_PAST = "nearest-past"
"""The predictor that answers with recorded motion."""


class FutureWork(CaseWork):
    """See :class:`prbench.harness.benchmark.CaseWork`."""

    def __init__(
        self,
        request: RunRequest,
        cases: WindowCases,
        *,
        method: MethodRecord,
        condition: Condition,
        protocol: PredictionProtocol,
    ) -> None:
        self._request = request
        self._cases = cases
        self._method = method
        self._condition = condition
        self._protocol = protocol

    @property
    def holds_recordings(self) -> bool:
        """True for the predictor that answers with recorded futures."""
        return self._method.name == NEAREST_PAST

    @property
    def plan(self) -> list[Int[np.ndarray, "_"]]:
        """Windows after one another, in the order of the table; all are as long."""
        return self._plan

    @cached_property
    def _plan(self) -> list[Int[np.ndarray, "_"]]:
        size = self._request.batch_size
        return [np.arange(start, min(start + size, len(self._cases))) for start in range(0, len(self._cases), size)]

    def questions(self, wanted: frozenset[int]) -> Iterator[tuple[int, FutureQuestion]]:
        """See :meth:`CaseWork.questions`."""
        for index, batch, _ in self._batches(self._condition, sorted(wanted)):
            yield index, FutureQuestion(batch, self._request.samples)

    def _batches(self, condition: Condition, wanted: list[int]) -> Iterator[tuple[int, ObservedBatch, Truth]]:
        """Read some batches; runs are read once, however many batches they hold."""
        if not wanted:
            return
        table = self._cases.table
        places = self._cases.places[np.concatenate([self.plan[index] for index in wanted])]
        # All planned batches but the last one have this size, so those of the table are the planned ones.
        batches = table.batches(condition, places, frame=self._protocol.evaluation.frame, size=self._request.batch_size)
        for index, (batch, truth) in zip(wanted, batches, strict=True):
            yield index, batch, truth

    def scores(self, files: DatasetFolder, engine: Engine) -> Iterator[pa.Table]:
        """See :meth:`CaseWork.scores`."""
        rules = self._protocol.evaluation
        similar = SimilarPasts.of(self._cases.table, self._cases.pool, closer_than=rules.similar_past)
        everything = list(range(len(self.plan)))
        # Joints and truth are the same under every condition.
        parts = (
            _Part(
                dataset=self._cases.table.info.dataset,
                path=files.part(index),
                samples=self._request.samples,
                batch=batch,
                truth=truth,
                similar=_of_windows(similar, truth.window_ids),
                joints=self._cases.table.joints,
                protocol=self._protocol,
                one_design=self._method.one_design,
            )
            for index, batch, truth in self._batches(Condition.POSE, everything)
        )
        yield from engine.map(_score_part, parts)


@dataclass(frozen=True)
class _Part:
    """Scoring work for one worker."""

    dataset: str
    path: Path
    samples: int
    batch: ObservedBatch
    truth: Truth
    similar: SimilarPasts
    joints: JointSet
    protocol: PredictionProtocol
    one_design: bool


def _of_windows(similar: SimilarPasts, window_ids: tuple[str, ...]) -> SimilarPasts:
    """What some windows need of the similar pasts of all, so that little goes to a worker."""
    places = [similar.places[name] for name in window_ids]
    members = [similar.sets[place] for place in places] + [similar.canonical_sets[place] for place in places]
    kept = np.unique(np.concatenate([*members, places]))
    new_place = {int(place): number for number, place in enumerate(kept)}

    def renumbered(sets: list[np.ndarray]) -> list[np.ndarray]:
        found = [np.empty(0, dtype=np.int64)] * len(kept)
        for place in places:
            found[new_place[place]] = np.searchsorted(kept, sets[place])
        return found

    return SimilarPasts(
        places={name: new_place[place] for name, place in zip(window_ids, places, strict=True)},
        sets=renumbered(similar.sets),
        canonical_sets=renumbered(similar.canonical_sets),
        futures=similar.futures[kept],
        own_from_room=similar.own_from_room[kept],
    )


def _score_part(part: _Part) -> pa.Table:
    names = part.truth.window_ids
    joints = read_part(part.path, names, samples=part.samples, joints=len(part.joints.names))
    columns: dict[str, np.ndarray] = {}
    scored = score_batch(
        part.batch,
        Futures(joints=joints),
        part.truth,
        part.joints,
        part.protocol.evaluation,
        similar=part.similar,
        one_design=part.one_design,
    )
    for rows, values in scored:
        for name, value in values.items():
            columns.setdefault(name, np.full(len(names), np.nan))[rows] = value
    metrics = [info.id for info in prediction_metrics() if info.id in columns]
    values = np.stack([columns[name] for name in metrics], axis=1)
    # A window without a score in a metric, such as one that ends before a horizon, has no row of it.
    window, metric = np.nonzero(np.isfinite(values))
    return pa.Table.from_arrays(
        [
            pa.array([names[row] for row in window], pa.string()),
            pa.array([part.dataset] * len(window), pa.string()),
            pa.array(np.zeros(len(window), dtype=np.int32)),
            pa.array([metrics[column] for column in metric], pa.string()),
            pa.array(values[window, metric].astype(np.float64)),
            pa.nulls(len(window), pa.string()),
        ],
        schema=SCORES,
    )
