"""The value of the prime-and-reach benchmark: its tables and rules, the work on one table, the question to a method."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from prbench.checking.doctor.motion_set import Diagnosis
from prbench.contract import GIVEN, Condition, ConditionBatch, Motions
from prbench.engine import Engine
from prbench.errors import AdapterError
from prbench.files.storage import in_turn, text_digest
from prbench.harness import controls
from prbench.harness.agreement import agreement_with_people, require_agreement
from prbench.harness.benchmark import Answer, Benchmark, CaseWork
from prbench.harness.conditions import ConditionSource, ConditionStream, derangement, run_salt
from prbench.harness.methods import installed, loading, remote
from prbench.harness.methods.motions import generate_checked
from prbench.harness.planning import Selection, open_tables, plan_batches, select, supported
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import CONTROL, DatasetFolder, MethodRecord, PredictionRows, Predictions, RunFolder
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.scoring import ScoringRules, certain_faults, score_selection
from prbench.metrics import METRICS
from prbench.protocol.manifests import PROTOCOL_NAME, BenchmarkProtocol, load_protocol
from prbench.protocol.own_protocol import protocol_for
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import FILE_NAME
from prbench.sequences.folds import fold_tables
from prbench.sequences.schema import ROUNDING
from prbench.sequences.sequence import recording_key


@dataclass(frozen=True)
class MotionQuestion:
    """See :class:`prbench.harness.benchmark.Question`; the method sees nothing but ``conditions``.

    Attributes:
        conditions: One batch for each sample; they differ in their noise seeds only.
        given: Motions that the harness itself supplies (controls), instead of the method's.
    """

    conditions: tuple[ConditionBatch, ...]
    given: Motions | None

    @property
    def digest(self) -> str:
        """See :meth:`prbench.harness.benchmark.CaseWork.questions`; a table of equal content gives equal digests."""
        batch = self.conditions[0]
        arrays = [getattr(batch, name) for name in sorted(GIVEN[batch.condition] - {"text"})]
        rounded = [np.rint(values * np.float64(1 / ROUNDING)).astype(np.int64).tobytes().hex() for values in arrays]
        return text_digest(batch.condition, *batch.opaque_id, *(batch.text or ()), *rounded)

    def ask(self, method: loading.LoadedMethod | None, *, seed: int, sequence_ids: tuple[str, ...]) -> Answer:
        """See :class:`prbench.harness.benchmark.Question`."""
        seeds = [batch.noise_seed for batch in self.conditions]
        if method is None:
            assert self.given is not None
            return Answer([_rows(self.given)] * len(seeds), seeds)
        samples: list[PredictionRows] = []
        passes: list[int] = []
        for batch in self.conditions:
            motions, _ = generate_checked(
                method.adapter, batch, seed=seed, method=method.name, sequence_ids=sequence_ids
            )
            samples.append(_rows(motions))
            if motions.cost is not None:
                passes.append(motions.cost.network_passes)
        return Answer(samples, seeds, sum(passes) if passes else None)


def _rows(motions: Motions) -> PredictionRows:
    rays = None
    if motions.gaze is not None:
        rays = np.stack((motions.gaze.origin, motions.gaze.direction), axis=2)
    return PredictionRows.from_padded(motions.joints, motions.n_frames, gaze=rays)


@dataclass(eq=False)
class MotionWork(CaseWork):
    """See :class:`prbench.harness.benchmark.CaseWork`."""

    request: RunRequest
    selection: Selection
    method: MethodRecord
    condition: Condition
    protocol: BenchmarkProtocol

    def __post_init__(self) -> None:
        request = self.request
        self._source: ConditionSource | ConditionStream = ConditionStream(self.selection)
        self._scored_goals: Float[np.ndarray, "n 3"] | None = None
        # These put conditions of sequences together that lie anywhere in the table.
        if request.control == controls.SHUFFLED_GOAL or request.method == controls.NEAREST_NEIGHBOUR:
            whole = ConditionSource.read(self.selection)
            if request.control == controls.SHUFFLED_GOAL:
                whole = whole.with_goals_of(derangement(self.selection, seed=request.seed))
                if request.method in controls.RECORDED_MOTION:
                    self._scored_goals = whole.goal_location
            self._source = whole

    @property
    def holds_recordings(self) -> bool:
        """See :attr:`CaseWork.holds_recordings`."""
        return self.request.method in controls.HOLDS_RECORDINGS

    @cached_property
    def plan(self) -> list[Int[np.ndarray, "_"]]:
        """See :attr:`CaseWork.plan`; batches are of similar length."""
        return plan_batches(self.selection.n_frames, self.request.batch_size)

    def questions(self, wanted: frozenset[int]) -> Iterator[tuple[int, MotionQuestion]]:
        """See :meth:`CaseWork.questions`."""
        request = self.request
        salt = run_salt(request.seed, self.selection.table.identity)
        given = None
        if request.is_control:
            given = controls.control_motions(request.method, self.selection, self._source, self.plan)
        for index, rows in enumerate(self.plan):
            # Controls come in order: those of finished batches are made and passed over.
            motions = next(given) if given is not None else None
            if index not in wanted:
                continue
            source, places = self._source.around(rows)
            first = source.batch(places, self.condition, seed=request.seed, salt=salt, sample=0)
            samples = range(1, request.samples)
            others = (source.redrawn(first, places, seed=request.seed, sample=sample) for sample in samples)
            yield index, MotionQuestion((first, *others), motions)

    def scores(self, files: DatasetFolder, engine: Engine) -> Iterator[pa.Table]:
        """See :meth:`CaseWork.scores`."""
        rules = ScoringRules(
            self.protocol.metrics,
            recorded_motion=self.request.method in controls.RECORDED_MOTION,
            other_goals=self._scored_goals,
            pose_given=has_given_pose(self.method, self.condition),
            run_of=self.method.name,
        )
        samples = range(self.request.samples)
        yield from score_selection(self.selection, files.predictions, samples=samples, rules=rules, engine=engine)

    def findings(self, files: DatasetFolder) -> tuple[Diagnosis, ...]:
        """Examine the motions of a method; those of controls are the harness's own."""
        if self.method.kind == CONTROL:
            return ()
        return certain_faults(self.selection, Predictions.open(files.predictions), condition=self.condition.value)

    def write_beside(self, files: DatasetFolder, scores: CodedScores) -> None:
        """Write the agreement with recorded people."""
        agreement_with_people(self.selection, scores, protocol=self.protocol).write(files.path)

    def require_beside(self, files: DatasetFolder, scores: CodedScores) -> None:
        """Compare the agreement with what follows from the scores."""
        require_agreement(files, agreement_with_people(self.selection, scores, protocol=self.protocol))


def has_given_pose(method: MethodRecord, condition: str) -> bool:
    """Return True if Plausible compares the motions of a method with the recorded first pose."""
    # Controls know that pose under any condition; the nearest motion begins with a pose of its own.
    knows = method.kind == CONTROL and method.name != installed.NEAREST_NEIGHBOUR
    return knows or condition in {each for each in Condition if "initial_joints" in GIVEN[each]}


class PrimeAndReach(Benchmark[SequenceTable, Selection]):
    """See :class:`prbench.harness.benchmark.Benchmark`."""

    name = PROTOCOL_NAME
    metrics = METRICS
    methods = remote.MOTIONS
    table_file = FILE_NAME

    @property
    def present_rules(self) -> BenchmarkProtocol:
        """See :attr:`Benchmark.present_rules`."""
        return load_protocol()

    def rules_of(self, run: RunFolder) -> BenchmarkProtocol | None:
        """Return the user's own protocol, or prbench's."""
        return run.protocol

    def copied_rules(self, rules: BenchmarkProtocol) -> BenchmarkProtocol:
        """See :meth:`Benchmark.copied_rules`; a copy of prbench's own is never written."""
        return rules

    def settled(self, request: RunRequest) -> RunRequest:
        """Turn a fold of participants into the tables that it makes."""
        return replace(request, data=fold_tables(request.data, request.fold), fold=None)

    def open_table(self, folder: Path) -> SequenceTable:
        """See :meth:`Benchmark.open_table`."""
        return SequenceTable.open(folder)

    def open_tables(self, request: RunRequest) -> list[SequenceTable]:
        """See :meth:`Benchmark.open_tables`."""
        return open_tables(request.data)

    def rules(self, request: RunRequest, tables: Sequence[SequenceTable]) -> BenchmarkProtocol:
        """Return the user's own protocol, or prbench's."""
        return protocol_for(request.protocol, (table.described_protocol for table in tables))

    def cases(self, table: SequenceTable, *, split: str, limit: int | None) -> Selection:
        """See :meth:`Benchmark.cases`."""
        return select(table, split=split, limit=limit)

    def answerable(self, request: RunRequest, cases: Selection, method: MethodRecord) -> Selection:
        """Return the sequences that are no longer than the method can generate."""
        del request
        selection = supported(cases, max_frames=method.max_frames, native_fps=method.native_fps)
        if not len(selection):
            why = f"all {len(cases)} chosen sequences of {cases.table.info.dataset} are longer."
            raise AdapterError(f"adapter '{method.name}' generates at most {method.max_frames} frames; {why}")
        return selection

    def fitted(self, spec: loading.MethodSpec, table: SequenceTable, split: str) -> loading.MethodSpec:
        """See :meth:`Benchmark.fitted`."""
        del split  # it learns from training rows, whatever is run
        spec = loading.fitted_to(spec, table)
        with nullcontext() if spec.fit_folder is None else in_turn(spec.fit_folder):
            spec.load()  # a fit is made here, once, and found by every worker
        return spec

    def work(
        self, request: RunRequest, cases: Selection, *, method: MethodRecord, condition: StrEnum, rules: Any
    ) -> MotionWork:
        """See :meth:`Benchmark.work`."""
        return MotionWork(request, cases, method=method, condition=Condition(condition), protocol=rules)

    def recording_key(self, sequence_id: str) -> str:
        """Dataset and recording of a sequence."""
        return recording_key(sequence_id)

    def ids_tell_recordings(self, sequence_ids: Sequence[str]) -> bool:
        """Return True where ids have all six parts; those of an imported release have three."""
        parts = {name.count("/") + 1 for name in sequence_ids}
        return len(parts) == 1 and min(parts) >= 6


PRIME_AND_REACH = PrimeAndReach()
