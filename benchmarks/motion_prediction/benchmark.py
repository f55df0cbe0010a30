"""The value of the motion prediction benchmark: the windows that are chosen, the work on them, and the rules."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property, partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from prbench.engine import Engine, is_out_of_memory
from prbench.errors import AdapterError, PrbenchError, RunError, UsageError
from prbench.files.storage import text_digest
from prbench.harness.benchmark import Answer, Benchmark, CaseWork
from prbench.harness.methods.loading import LoadedMethod, MethodSpec
from prbench.harness.methods.motions import release_memory, told
from prbench.harness.methods.remote import MethodGroup, RemoteMethod
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import SCORES, DatasetFolder, MethodRecord, RunFolder
from prbench.harness.run_folder.predictions import PredictionRows, read_part
from prbench.metrics import MetricInfo
from prbench.sequences.table import by_share, find_sequence_id
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
class WindowCases:
    """See :class:`prbench.harness.benchmark.Cases`; a window is a case.

    Attributes:
        places: Places of the windows in the table, ascending.
        pool: Places of all windows of the split, among which similar pasts are looked for, whatever the limit.
    """

    table: WindowsTable
    split: str
    places: Int[np.ndarray, " n"]
    pool: Int[np.ndarray, " all"]

    @classmethod
    def of(cls, table: WindowsTable, *, split: str, limit: int | None) -> WindowCases:
        """Choose the windows of a split; with ``limit`` every recording's share.

        Args:
            table: The table.
            split: A split of the dataset, or ``published``.
            limit: Number of windows at most; None for all.

        Raises:
            UsageError: if there is none.
        """
        places = table.chosen(published_split="test") if split == PUBLISHED else table.chosen(split=split)
        everything = cls(table, split, places, places)
        if limit is None:
            return everything
        kept = set(by_share(everything.sequence_ids, everything.recording_ids)[:limit])
        return everything.chosen(np.array([name in kept for name in everything.sequence_ids]))

    def chosen(self, keep: np.ndarray) -> WindowCases:
        """See :meth:`prbench.harness.benchmark.Cases.chosen`."""
        return replace(self, places=self.places[keep])

    @cached_property
    def sequence_ids(self) -> tuple[str, ...]:
        """Ids of the windows."""
        return tuple(self.table.windows["window_id"].take(self.places).to_pylist())

    @cached_property
    def recording_ids(self) -> tuple[str, ...]:
        """The recording of each window."""
        return tuple(self.table.runs["recording_id"].take(self.table.windows["row"].take(self.places)).to_pylist())

    @property
    def digest(self) -> str:
        """Digest of the ids."""
        return text_digest(*self.sequence_ids)

    def __len__(self) -> int:
        return len(self.places)


def single_windows(tables: Sequence[WindowsTable], wanted: Sequence[str], *, split: str) -> list[WindowCases]:
    """Choose single windows; tables that hold none of them are left out.

    Args:
        tables: The tables to look in.
        wanted: Ids, or parts of ids that fit one window of the split only.
        split: The run's split.

    Raises:
        UsageError: if none or several fit.
    """
    cases = [WindowCases.of(table, split=split, limit=None) for table in tables]
    known = [name for each in cases for name in each.sequence_ids]
    among = ", ".join(table.info.dataset for table in tables)
    ids = [find_sequence_id(name, known, among=f"split '{split}' of {among}") for name in wanted]
    chosen = [each.chosen(np.isin(each.sequence_ids, ids)) for each in cases]
    return [each for each in chosen if len(each)]


def open_windows(folders: Sequence, *, benchmark: str) -> list[WindowsTable]:
    """Open tables of windows.

    Args:
        folders: Their folders.
        benchmark: Name of the benchmark, for messages.

    Raises:
        TableError: if one is missing, edited or of an unknown version.
        UsageError: if two are of one dataset, or there is none.
    """
    if not folders:
        raise UsageError(f"--data DIR: {benchmark} needs a table of windows; `prbench build-windows` makes one.")
    tables = [WindowsTable.open(folder) for folder in folders]
    names = [table.info.dataset for table in tables]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise UsageError(f"--data: expected different datasets, found {repeated[0]} more than once.")
    return tables


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
    metrics = [info.id for info in prediction_metrics() if info.id in columns]
    values = np.stack([columns[name] for name in metrics], axis=1)
    # A window without a score in a metric, such as one that ends before a horizon, has no row of it.
    window, metric = np.nonzero(np.isfinite(values))
    columns = ([names[row] for row in window], [dataset] * len(window), np.zeros(len(window), dtype=np.int32))
    columns += ([metrics[column] for column in metric], values[window, metric], [None] * len(window))
    return pa.Table.from_arrays([pa.array(each, kind) for each, kind in zip(columns, SCORES.types)], schema=SCORES)


_PREDICTORS = MethodGroup(
    "prbench.predictors", Predictor, "name, conditions and predict()", Condition, RemotePredictor, serve_futures
)


class MotionPrediction(Benchmark[WindowsTable, WindowCases]):
    """See :class:`prbench.harness.benchmark.Benchmark`."""

    name = "motion-prediction"

    @property
    def metrics(self) -> tuple[MetricInfo, ...]:
        """Displacement errors and what stands beside them."""
        return prediction_metrics()

    @property
    def methods(self) -> MethodGroup:
        """Methods that predict futures."""
        return _PREDICTORS

    @property
    def present_rules(self) -> PredictionProtocol:
        """See :attr:`Benchmark.present_rules`."""
        return load_prediction_protocol()

    def settled(self, request: RunRequest) -> RunRequest:
        """Refuse options of prime-and-reach."""
        unknown = {f"--method {request.method}": request.is_control}
        unknown |= {f"--{name}": getattr(request, name) is not None for name in ("control", "fold", "protocol")}
        for option, given in unknown.items():
            if given:
                raise UsageError(f"{option}: the benchmark {self.name} does not have it yet; leave it out.")
        return request

    @property
    def table_file(self) -> str:
        """See :attr:`Benchmark.table_file`."""
        return FILE_NAME

    def open_table(self, folder: Path) -> WindowsTable:
        """See :meth:`Benchmark.open_table`."""
        return WindowsTable.open(folder)

    def open_tables(self, request: RunRequest) -> list[WindowsTable]:
        """See :meth:`Benchmark.open_tables`."""
        return open_windows(request.data, benchmark=self.name)

    def rules(self, request: RunRequest, tables: Sequence[WindowsTable]) -> PredictionProtocol:
        """Prbench's own protocol; tables of another version are refused."""
        del request
        protocol = load_prediction_protocol()
        for table in tables:
            if table.info.protocol_version != protocol.version:
                problem = f"expected windows of version {protocol.version} of the protocol,"
                found = f"found version {table.info.protocol_version}. Build the windows again."
                raise UsageError(f"{table.folder}: {problem} {found}")
        return protocol

    def choose(self, request: RunRequest, tables: Sequence[WindowsTable]) -> list[WindowCases]:
        """Choose windows of each table; where single ones are asked for, only of the tables that hold one."""
        if request.sequences:
            return single_windows(tables, request.sequences, split=request.split)
        return [WindowCases.of(table, split=request.split, limit=request.limit) for table in tables]

    def fitted(self, spec: MethodSpec, table: WindowsTable, condition: StrEnum) -> MethodSpec:
        """Show the training windows of the table to a predictor that learns and brought no weights of its own."""
        del condition
        adapter = spec.load().adapter
        if spec.weights is None and isinstance(adapter, RemoteMethod) and adapter.trainable:
            why = "which it is not shown at a distance yet; leave it out."
            raise UsageError(f"--isolate: {adapter.name} learns from the table, {why}")
        if spec.weights is not None or not hasattr(adapter, "fit"):
            return spec
        return replace(spec, fit=fit_to_training_windows, table_folder=table.folder)

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


def fit_to_training_windows(adapter: object, spec: MethodSpec) -> None:
    """Fit a predictor that was made in this process."""
    fit = getattr(adapter, "fit", None)
    if fit is not None and spec.table_folder is not None:
        fit(TrainingWindows(spec.table_folder))


MOTION_PREDICTION = MotionPrediction()
