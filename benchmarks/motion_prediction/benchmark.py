"""The value of the motion prediction benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from prbench.errors import UsageError
from prbench.harness.benchmark import Benchmark
from prbench.harness.methods.loading import MethodSpec
from prbench.harness.methods.remote import MethodGroup, RemoteMethod
from prbench.harness.request import RunRequest
from prbench.harness.run_folder.record import MethodRecord
from prbench.metrics import MetricInfo
from prbench_benchmarks.motion_prediction.batch import Condition, Predictor
from prbench_benchmarks.motion_prediction.cases import WindowCases, open_windows, single_windows
from prbench_benchmarks.motion_prediction.metric_infos import prediction_metrics
from prbench_benchmarks.motion_prediction.predictors import TrainingWindows
from prbench_benchmarks.motion_prediction.protocol import PredictionProtocol, load_prediction_protocol
from prbench_benchmarks.motion_prediction.remote import RemotePredictor, serve_futures
from prbench_benchmarks.motion_prediction.scoring import score_window
from prbench_benchmarks.motion_prediction.table import FILE_NAME, WindowsTable
from prbench_benchmarks.motion_prediction.work import FutureWork

if TYPE_CHECKING:
    from prbench_benchmarks.motion_prediction.futures import FuturesReport

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
        unknown = {
            f"--method {request.method}": request.is_control,
            "--control": request.control is not None,
            "--fold": request.fold is not None,
            "--protocol": request.protocol is not None,
        }
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
