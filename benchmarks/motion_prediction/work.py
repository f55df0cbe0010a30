"""The work of a run of motion prediction on the windows of one table: questions, answers and scores."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from prbench.engine import Engine, is_out_of_memory
from prbench.errors import AdapterError, PrbenchError
from prbench.files.storage import text_digest
from prbench.harness.benchmark import Answer, CaseWork
from prbench.harness.methods.loading import LoadedMethod
from prbench.harness.methods.motions import release_memory, told
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import SCORES, DatasetFolder, MethodRecord
from prbench.harness.run_folder.predictions import PredictionRows, read_part
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, ask
from prbench_benchmarks.motion_prediction.cases import WindowCases
from prbench_benchmarks.motion_prediction.joint_sets import JointSet
from prbench_benchmarks.motion_prediction.metric_infos import prediction_metrics
from prbench_benchmarks.motion_prediction.protocol import EvaluationRules, PredictionProtocol
from prbench_benchmarks.motion_prediction.scoring import SimilarPasts, score_batch
from prbench_benchmarks.motion_prediction.table import Truth

NEAREST_PAST = "nearest-past"  # The predictor that answers with recorded motion.


@dataclass(frozen=True)
class FutureQuestion:
    """See :meth:`prbench.harness.benchmark.CaseWork.questions`; the predictor sees nothing but ``batch``."""

    batch: ObservedBatch
    n_samples: int

    @property
    def digest(self) -> str:
        """See :meth:`prbench.harness.benchmark.CaseWork.questions`; turned poses may differ in the last digits."""
        return text_digest(self.batch.condition, *map(str, self.batch.key))

    def ask(self, method: LoadedMethod | None, *, seed: int, sequence_ids: tuple[str, ...]) -> Answer:
        """See :meth:`prbench.harness.benchmark.CaseWork.questions`."""
        assert method is not None, "no control of this benchmark"
        joints = self._futures(self.batch, method, seed, sequence_ids)
        n_frames = np.full(len(joints), self.batch.n_future)
        samples = [PredictionRows.from_padded(joints[:, sample], n_frames) for sample in range(self.n_samples)]
        return Answer(samples, [self.batch.key] * self.n_samples)

    def _futures(
        self, batch: ObservedBatch, method: LoadedMethod, seed: int, ids: tuple[str, ...]
    ) -> Float[np.ndarray, "batch samples future joints 3"]:
        """Return the answer; a batch that does not fit in memory is cut in two."""
        try:
            futures = ask(method.adapter, batch, n_samples=self.n_samples, seed=seed)
        except PrbenchError:
            raise
        except (Exception, SystemExit) as error:
            if not is_out_of_memory(error):
                where = f"among windows {ids[0]} to {ids[-1]}"
                raise AdapterError(f"method '{method.name}' failed: {told(error)}, {where}.") from error
            if len(batch) == 1:
                raise AdapterError(
                    f"method '{method.name}' ran out of memory on the single window {ids[0]}"
                    f" ({self.n_samples} samples). Use a device with more memory, or fewer --samples."
                ) from error
        else:
            return np.asarray(futures.joints, dtype=np.float32)
        # Outside of the handler: its traceback would hold the tensors of the failed batch.
        release_memory()
        middle = len(batch) // 2
        first = self._futures(batch.chosen(range(middle)), method, seed, ids[:middle])
        second = self._futures(batch.chosen(range(middle, len(batch))), method, seed, ids[middle:])
        return np.concatenate((first, second))


@dataclass(frozen=True, eq=False)
class FutureWork(CaseWork):
    """See :class:`prbench.harness.benchmark.CaseWork`."""

    request: RunRequest
    cases: WindowCases
    method: MethodRecord
    condition: Condition
    protocol: PredictionProtocol

    @property
    def holds_recordings(self) -> bool:
        """True for the predictor that answers with recorded futures."""
        return self.method.name == NEAREST_PAST

    @cached_property
    def plan(self) -> list[Int[np.ndarray, "_"]]:
        """Windows after one another, in the order of the table; all are as long."""
        size = self.request.batch_size
        return [np.arange(start, min(start + size, len(self.cases))) for start in range(0, len(self.cases), size)]

    def questions(self, wanted: frozenset[int]) -> Iterator[tuple[int, FutureQuestion]]:
        """See :meth:`CaseWork.questions`."""
        for index, batch, _ in self._batches(self.condition, sorted(wanted)):
            yield index, FutureQuestion(batch, self.request.samples)

    def _batches(self, condition: Condition, wanted: list[int]) -> Iterator[tuple[int, ObservedBatch, Truth]]:
        """Read some batches; runs are read once, however many batches they hold."""
        if not wanted:
            return
        table = self.cases.table
        places = self.cases.places[np.concatenate([self.plan[index] for index in wanted])]
        # All planned batches but the last one have this size, so those of the table are the planned ones.
        batches = table.batches(condition, places, frame=self.protocol.evaluation.frame, size=self.request.batch_size)
        for index, (batch, truth) in zip(wanted, batches, strict=True):
            yield index, batch, truth

    def scores(self, files: DatasetFolder, engine: Engine) -> Iterator[pa.Table]:
        """See :meth:`CaseWork.scores`."""
        table = self.cases.table
        similar = SimilarPasts.of(table, self.cases.pool, closer_than=self.protocol.evaluation.similar_past)
        asked = (table.info.dataset, self.request.samples, table.joints)
        score = partial(_score_part, *asked, self.protocol.evaluation, self.method.one_design)
        # Joints and truth are the same under every condition.
        parts = (
            (files.part(index), batch, truth, _of_windows(similar, truth.window_ids))
            for index, batch, truth in self._batches(Condition.POSE, list(range(len(self.plan))))
        )
        yield from engine.map(score, parts)


def _of_windows(similar: SimilarPasts, window_ids: tuple[str, ...]) -> SimilarPasts:
    """Return what some windows need of the similar pasts of all, so that little goes to a worker."""
    places = [similar.places[name] for name in window_ids]
    members = [similar.sets[place] for place in places] + [similar.canonical_sets[place] for place in places]
    kept = np.unique(np.concatenate([*members, places]))
    new_places = np.searchsorted(kept, places).tolist()

    def renumbered(sets: list[np.ndarray]) -> list[np.ndarray]:
        found = [np.empty(0, dtype=np.int64)] * len(kept)
        for place, new_place in zip(places, new_places, strict=True):
            found[new_place] = np.searchsorted(kept, sets[place])
        return found

    return SimilarPasts(
        places=dict(zip(window_ids, new_places, strict=True)),
        sets=renumbered(similar.sets),
        canonical_sets=renumbered(similar.canonical_sets),
        futures=similar.futures[kept],
        own_from_room=similar.own_from_room[kept],
    )


_Part = tuple[Path, ObservedBatch, Truth, SimilarPasts]


def _score_part(
    dataset: str, samples: int, joints: JointSet, rules: EvaluationRules, one_design: bool, part: _Part
) -> pa.Table:
    path, batch, truth, similar = part
    names = truth.window_ids
    futures = Futures(joints=read_part(path, names, samples=samples, joints=len(joints.names)))
    columns = score_batch(batch, futures, truth, joints, rules, similar=similar, one_design=one_design)
    metrics = [info.id for info in prediction_metrics() if info.id in columns]
    values = np.stack([columns[name] for name in metrics], axis=1)
    # A window without a score in a metric, such as one that ends before a horizon, has no row of it.
    window, metric = np.nonzero(np.isfinite(values))
    return pa.Table.from_arrays(
        [
            pa.array([names[row] for row in window], pa.string()),
            pa.array([dataset] * len(window), pa.string()),
            pa.array(np.zeros(len(window), dtype=np.int32)),
            pa.array([metrics[column] for column in metric], pa.string()),
            pa.array(values[window, metric].astype(np.float64)),
            pa.nulls(len(window), pa.string()),
        ],
        schema=SCORES,
    )
