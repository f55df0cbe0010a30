"""The value of the motion prediction benchmark: the windows that are chosen, the work on them, and the rules."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property, partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from jaxtyping import Int

from prbench.contract import TrainingRun
from prbench.engine import Engine
from prbench.errors import RunError
from prbench.files.storage import text_digest
from prbench.harness.benchmark import Answer, Benchmark, CaseWork
from prbench.harness.methods.loading import LoadedMethod, MethodSpec, fitted_apart
from prbench.harness.methods.motions import in_halves
from prbench.harness.methods.remote import MethodGroup, RemoteMethod
from prbench.harness.planning import Selection, consecutive, limited
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import DatasetFolder, MethodRecord, RunFolder, long_form
from prbench.harness.run_folder.predictions import PredictionRows, read_part
from prbench.metrics import MetricInfo
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, Predictor, ask
from prbench_benchmarks.motion_prediction.joint_sets import JointSet
from prbench_benchmarks.motion_prediction.metrics import prediction_metrics
from prbench_benchmarks.motion_prediction.predictors import TrainingWindows
from prbench_benchmarks.motion_prediction.protocol import EvaluationRules, PredictionProtocol, load_prediction_protocol
from prbench_benchmarks.motion_prediction.remote import RemotePredictor, serve_futures
from prbench_benchmarks.motion_prediction.scoring import SimilarPasts, score_batch, score_window
from prbench_benchmarks.motion_prediction.table import FILE_NAME, Truth, WindowsTable

if TYPE_CHECKING:
    from prbench_benchmarks.motion_prediction.futures import FuturesReport

PUBLISHED = "published"  # Value of ``--split`` that means the test split of the published evaluation.


@dataclass(frozen=True)
class WindowCases(Selection):
    """See :class:`prbench.harness.benchmark.Cases`; a window is a case.

    Attributes:
        places: Places of the windows in the table, ascending.
    """

    places: Int[np.ndarray, " n"]


def places_of(table: WindowsTable, split: str) -> Int[np.ndarray, " all"]:
    """Return the places of the windows of a split of the dataset, or of the published test split."""
    return table.chosen(published_split="test") if split == PUBLISHED else table.chosen(split=split)


def run_on(path: Path, table: WindowsTable) -> tuple[RunFolder, DatasetFolder]:
    """Open a run, and its files of a table of windows.

    Raises:
        RunError: for a run of another benchmark, or on other windows.
    """
    run = RunFolder.open(path, any_benchmark=True)
    if run.record.benchmark != "motion-prediction":
        raise RunError(f"{path}: expected a run of motion-prediction, found one of {run.record.benchmark}.")
    for each in run.record.tables:
        if each.content_digest == table.info.content_digest:
            return run, run.dataset(each.dataset)
    raise RunError(f"{path}: expected a run on {table.folder}, found one on other windows.")


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
        answers = in_halves(
            lambda batch, _: ask(method.adapter, batch, n_samples=self.n_samples, seed=seed).joints,
            self.batch,
            sequence_ids,
            method=method.name,
            case="window",
            remedy=", or fewer --samples",
        )
        joints = np.concatenate(answers).astype(np.float32)
        n_frames = np.full(len(joints), self.batch.n_future)
        samples = [PredictionRows.from_padded(joints[:, sample], n_frames) for sample in range(self.n_samples)]
        return Answer(samples, [self.batch.key] * self.n_samples)


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
        return consecutive(len(self.cases), self.request.batch_size)

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
        # Among all windows of the split, whatever the limit.
        pool = places_of(table, self.cases.split)
        similar = SimilarPasts.of(table, pool, closer_than=self.protocol.evaluation.similar_past)
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

    named = dict(zip(window_ids, new_places, strict=True))
    sets = (renumbered(similar.sets), renumbered(similar.canonical_sets))
    return SimilarPasts(named, *sets, similar.futures[kept], similar.own_from_room[kept])


_Part = tuple[Path, ObservedBatch, Truth, SimilarPasts]


def _score_part(
    dataset: str, samples: int, joints: JointSet, rules: EvaluationRules, one_design: bool, part: _Part
) -> pa.Table:
    path, batch, truth, similar = part
    names = truth.window_ids
    futures = Futures(joints=read_part(path, names, samples=samples, joints=len(joints.names)))
    columns = score_batch(batch, futures, truth, joints, rules, similar=similar, one_design=one_design)
    known = {info.id: columns[info.id] for info in prediction_metrics() if info.id in columns}
    return long_form(names, dataset, known)


def fit_to_copy(adapter: Any, train: Path, run: TrainingRun) -> None:
    """Fit a predictor in a process of its own, which nothing is kept of, to a copy of the training windows."""
    del run
    adapter.fit(TrainingWindows(train))


class MotionPrediction(Benchmark[WindowsTable, WindowCases]):
    """See :class:`prbench.harness.benchmark.Benchmark`."""

    name = "motion-prediction"
    methods = MethodGroup(
        "prbench.predictors",
        Predictor,
        "name, conditions and predict()",
        Condition,
        RemotePredictor,
        serve_futures,
        fit_to_copy,
    )
    table_file = FILE_NAME

    @property
    def metrics(self) -> tuple[MetricInfo, ...]:
        """Displacement errors and what stands beside them."""
        return prediction_metrics()

    @property
    def present_rules(self) -> PredictionProtocol:
        """See :attr:`Benchmark.present_rules`."""
        return load_prediction_protocol()

    def open_table(self, folder: Path) -> WindowsTable:
        """See :meth:`Benchmark.open_table`."""
        return WindowsTable.open(folder)

    def cases(self, table: WindowsTable, *, split: str, limit: int | None) -> WindowCases:
        """See :meth:`Benchmark.cases`."""
        places = places_of(table, split)
        rows = table.windows.take(places)
        recordings = tuple(table.runs["recording_id"].take(rows["row"]).to_pylist())
        lengths = rows["n_scored"].to_numpy()
        ids = tuple(rows["window_id"].to_pylist())
        return limited(WindowCases(table, split, ids, lengths, recordings, table.info.fps, places), limit)

    def fitted(self, spec: MethodSpec, table: WindowsTable, split: str) -> MethodSpec:
        """Show the training windows of the table to a predictor that learns and brought no weights of its own.

        One in a process of its own gets a copy of them, since the table holds the futures of all others.
        """
        if spec.weights is not None or not learns_from_table(spec.load().adapter):
            return spec
        published = split == PUBLISHED
        if spec.program is not None:
            return fitted_apart(spec, partial(table.write_training_copy, published=published))
        return replace(spec, fit=FitToWindows(published), table_folder=table.folder)

    def work(
        self, request: RunRequest, cases: WindowCases, *, method: MethodRecord, condition: StrEnum, rules: Any
    ) -> FutureWork:
        """See :meth:`Benchmark.work`."""
        return FutureWork(request, cases, method=method, condition=Condition(condition), protocol=rules)

    def recordings_of(self, table: WindowsTable) -> dict[str, str]:
        """See :meth:`Benchmark.recordings_of`."""
        windows = table.windows
        recordings = table.runs["recording_id"].take(windows["row"])
        return dict(zip(windows["window_id"].to_pylist(), recordings.to_pylist(), strict=True))

    @property
    def offline(self) -> ModuleType:
        """See the base class."""
        from prbench_benchmarks.motion_prediction import offline

        return offline

    def measure(self, predicted: np.ndarray, recorded: np.ndarray, **given: Any) -> dict[str, float]:
        """See the base class, and :func:`prbench_benchmarks.motion_prediction.scoring.score_window`."""
        return score_window(predicted, recorded, **given)

    def view(self, request: Any) -> FuturesReport:
        """See the base class."""
        from prbench_benchmarks.motion_prediction.futures import view_futures

        return view_futures(request)

    def recording_key(self, sequence_id: str) -> str:
        """Id of a window without segment, anchor and first frame; of an anchored one without its sequence's end."""
        run, anchor, _ = sequence_id.rsplit("/", 2)
        if anchor == "sliding":
            return run.rpartition("/")[0]
        return run.rsplit("/", 4)[0]


def learns_from_table(adapter: Any) -> bool:
    """Return True if a run fits the predictor, here or in its own process, where it brought no weights."""
    return adapter.trainable if isinstance(adapter, RemoteMethod) else hasattr(adapter, "fit")


@dataclass(frozen=True)
class FitToWindows:
    """Fits a predictor that was made in this process; see :class:`TrainingWindows`."""

    published: bool

    def __call__(self, adapter: Any, spec: MethodSpec) -> None:
        """Fit it to the table of the spec."""
        assert spec.table_folder is not None
        adapter.fit(TrainingWindows(spec.table_folder, self.published))


MOTION_PREDICTION = MotionPrediction()
