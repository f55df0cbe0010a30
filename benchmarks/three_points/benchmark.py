"""The value of the benchmark of bodies from head and wrists: its tracks, the work on them, and the rules."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Int

from prbench.engine import Engine
from prbench.errors import UsageError
from prbench.files.storage import text_digest
from prbench.harness.benchmark import Answer, Benchmark, CaseWork
from prbench.harness.methods.loading import LoadedMethod
from prbench.harness.methods.motions import in_halves
from prbench.harness.methods.remote import MethodGroup, RemoteMethod
from prbench.harness.planning import Selection, consecutive, select
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import DatasetFolder, MethodRecord, PredictionRows, long_form
from prbench.harness.run_folder.predictions import read_part
from prbench.sequences.sequence import SequenceChunk
from prbench_benchmarks.three_points.batch import Condition, TrackedBatch, Tracker, ask
from prbench_benchmarks.three_points.metrics import METRICS, tracking_errors
from prbench_benchmarks.three_points.protocol import ThreePointsProtocol, load_three_points_protocol
from prbench_benchmarks.three_points.table import FILE_NAME, GIVEN, TracksTable, padded, tracked_batch


@dataclass(frozen=True)
class TrackQuestion:
    """See :meth:`prbench.harness.benchmark.CaseWork.questions`; the tracker sees nothing but ``batch``."""

    batch: TrackedBatch

    @property
    def digest(self) -> str:
        """See :meth:`prbench.harness.benchmark.CaseWork.questions`."""
        return text_digest(self.batch.condition, *map(str, self.batch.key))

    def ask(self, method: LoadedMethod | None, *, seed: int, sequence_ids: tuple[str, ...]) -> Answer:
        """See :meth:`prbench.harness.benchmark.CaseWork.questions`."""
        assert method is not None, "no control of this benchmark"
        answers = in_halves(
            lambda batch, _: ask(method.adapter, batch, seed=seed).joints,
            self.batch,
            sequence_ids,
            method=method.name,
            case="track",
        )
        joints = np.concatenate(answers).astype(np.float32)
        return Answer([PredictionRows.from_padded(joints, self.batch.n_frames)], [self.batch.key])


@dataclass(frozen=True, eq=False)
class TrackWork(CaseWork):
    """See :class:`prbench.harness.benchmark.CaseWork`."""

    request: RunRequest
    cases: Selection
    condition: Condition

    @cached_property
    def plan(self) -> list[Int[np.ndarray, "_"]]:
        """Tracks after one another, in the order of the table; most are as long."""
        return consecutive(len(self.cases), self.request.batch_size)

    def questions(self, wanted: frozenset[int]) -> Iterator[tuple[int, TrackQuestion]]:
        """See :meth:`CaseWork.questions`."""
        for index, (_, chunk) in enumerate(self.cases.windows(GIVEN, rows=self.request.batch_size)):
            if index in wanted:
                yield index, TrackQuestion(tracked_batch(chunk, self.condition))

    def scores(self, files: DatasetFolder, engine: Engine) -> Iterator[pa.Table]:
        """See :meth:`CaseWork.scores`."""
        chunks = self.cases.windows(["fps", "joints"], rows=self.request.batch_size)
        parts = ((files.part(index), chunk) for index, (_, chunk) in enumerate(chunks))
        yield from engine.map(partial(_score_part, self.cases.table.info.dataset), parts)


def _score_part(dataset: str, part: tuple[Path, SequenceChunk]) -> pa.Table:
    path, chunk = part
    recorded = padded(chunk, "joints", 22, 3)
    predicted = read_part(path, chunk.sequence_ids, samples=1, joints=22, n_frames=chunk.n_frames)[:, 0]
    values = tracking_errors(predicted, recorded, chunk.n_frames, float(chunk.numbers("fps")[0]))
    return long_form(chunk.sequence_ids, dataset, {info.id: values[info.id] for info in METRICS})


def _refuse(*_: Any) -> Any:
    raise UsageError("the benchmark three-points does not speak the wire protocol: run an installed tracker.")


class ThreePoints(Benchmark[TracksTable, Selection]):
    """See :class:`prbench.harness.benchmark.Benchmark`."""

    name = "three-points"
    metrics = METRICS
    methods = MethodGroup("prbench.trackers", Tracker, "name, conditions and track()", Condition, RemoteMethod, _refuse)
    table_file = FILE_NAME

    @property
    def present_rules(self) -> ThreePointsProtocol:
        """See :attr:`Benchmark.present_rules`."""
        return load_three_points_protocol()

    def settled(self, request: RunRequest) -> RunRequest:
        """Refuse what a tracker cannot be asked for: several bodies, and programs apart."""
        unknown = {"--samples": request.samples != 1, "--isolate": request.isolate}
        unknown["--method cmd:…"] = request.method.startswith("cmd:")
        for option, given in unknown.items():
            if given:
                raise UsageError(f"{option}: an installed tracker answers with one body a track; leave it out.")
        return super().settled(request)

    def open_table(self, folder: Path) -> TracksTable:
        """See :meth:`Benchmark.open_table`."""
        return TracksTable.open(folder)

    def cases(self, table: TracksTable, *, split: str, limit: int | None) -> Selection:
        """See :meth:`Benchmark.cases`."""
        return select(table, split=split, limit=limit)

    def work(
        self, request: RunRequest, cases: Selection, *, method: MethodRecord, condition: StrEnum, rules: Any
    ) -> TrackWork:
        """See :meth:`Benchmark.work`."""
        del method, rules
        return TrackWork(request, cases, Condition(condition))

    def recording_key(self, sequence_id: str) -> str:
        """Dataset and recording of a track."""
        return sequence_id.rsplit("/", 2)[0]


THREE_POINTS = ThreePoints()
