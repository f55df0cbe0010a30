"""The value of the prime-and-reach benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from enum import StrEnum
from pathlib import Path

from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench.files.storage import in_turn
from prbench.harness.benchmark import Benchmark
from prbench.harness.best_of import require_goal
from prbench.harness.carry_on import require_goal_to_carry, whole_pairs
from prbench.harness.methods.groups import MOTIONS, MethodGroup
from prbench.harness.methods.loaded_methods import MethodSpec
from prbench.harness.methods.methods import fitted_to
from prbench.harness.planning import Selection, open_tables, select, select_sequences, supported
from prbench.harness.prime_and_reach.work import MotionWork
from prbench.harness.request import RunRequest
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import MethodRecord
from prbench.metrics import METRICS, MetricInfo
from prbench.protocol.manifests import PROTOCOL_NAME, BenchmarkProtocol, load_protocol
from prbench.protocol.own_protocol import protocol_for
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import FILE_NAME
from prbench.sequences.folds import fold_table
from prbench.sequences.ids import names_its_recording, recording_key


class PrimeAndReach(Benchmark[SequenceTable, Selection]):
    """See :class:`prbench.harness.benchmark.Benchmark`."""

    name = PROTOCOL_NAME

    @property
    def metrics(self) -> tuple[MetricInfo, ...]:
        """The study's metrics and their variants."""
        return METRICS

    @property
    def methods(self) -> MethodGroup:
        """Methods that generate motions."""
        return MOTIONS

    @property
    def present_rules(self) -> BenchmarkProtocol:
        """See :attr:`Benchmark.present_rules`."""
        return load_protocol()

    def rules_of(self, run: RunFolder) -> BenchmarkProtocol | None:
        """The user's own protocol, or prbench's."""
        return run.protocol

    def copied_rules(self, rules: BenchmarkProtocol) -> BenchmarkProtocol:
        """See :meth:`Benchmark.copied_rules`; a copy of prbench's own is never written."""
        return rules

    def settled(self, request: RunRequest) -> RunRequest:
        """Turn a fold of participants into the tables that it makes."""
        if request.fold is None:
            return request
        folds = tuple(fold_table(folder, request.fold).folder for folder in request.data)
        return replace(request, data=folds, fold=None)

    @property
    def table_file(self) -> str:
        """See :attr:`Benchmark.table_file`."""
        return FILE_NAME

    def open_table(self, folder: Path) -> SequenceTable:
        """See :meth:`Benchmark.open_table`."""
        return SequenceTable.open(folder)

    def open_tables(self, request: RunRequest) -> list[SequenceTable]:
        """See :meth:`Benchmark.open_tables`."""
        return open_tables(request.data)

    def rules(self, request: RunRequest, tables: Sequence[SequenceTable]) -> BenchmarkProtocol:
        """The user's own protocol, or prbench's."""
        return protocol_for(request.protocol, (table.described_protocol for table in tables))

    def require_condition(self, request: RunRequest, condition: StrEnum) -> None:
        """Refuse to choose motions, or to carry them on, where the method is given no goal."""
        require_goal(Condition(condition), best_of=request.best_of)
        if request.carry_on:
            require_goal_to_carry(Condition(condition))

    def choose(self, request: RunRequest, tables: Sequence[SequenceTable]) -> list[Selection]:
        """Select sequences of each table; where single ones are asked for, only of the tables that hold one."""
        if request.sequences:
            return select_sequences(tables, request.sequences, split=request.split)
        return [select(table, split=request.split, limit=request.limit, carry_on=request.carry_on) for table in tables]

    def answerable(self, request: RunRequest, cases: Selection, method: MethodRecord) -> Selection:
        """The sequences that are no longer than the method can generate, in whole pairs where puts carry on."""
        selection = supported(cases, max_frames=method.max_frames, native_fps=method.native_fps)
        if request.carry_on:
            selection = whole_pairs(selection)
        if not len(selection):
            raise AdapterError(
                f"adapter '{method.name}' generates at most {method.max_frames} frames; all {len(cases)} chosen"
                f" sequences of {cases.table.info.dataset} are longer."
            )
        return selection

    def fitted(self, spec: MethodSpec, table: SequenceTable, condition: StrEnum) -> MethodSpec:
        """See :meth:`Benchmark.fitted`."""
        del condition
        spec = fitted_to(spec, table)
        with nullcontext() if spec.fit_folder is None else in_turn(spec.fit_folder):
            spec.load()  # a fit is made here, once, and found by every worker
        return spec

    def work(
        self,
        request: RunRequest,
        cases: Selection,
        *,
        method: MethodRecord,
        condition: StrEnum,
        rules: BenchmarkProtocol,
    ) -> MotionWork:
        """See :meth:`Benchmark.work`."""
        return MotionWork(request, cases, method=method, condition=Condition(condition), protocol=rules)

    def recording_key(self, sequence_id: str) -> str:
        """Dataset and recording of a sequence."""
        return recording_key(sequence_id)

    def recordings_of(self, table: SequenceTable) -> dict[str, str]:
        """See :meth:`Benchmark.recordings_of`."""
        rows = table.scalars(columns=["sequence_id", "recording_id"])
        return dict(zip(rows["sequence_id"].to_pylist(), rows["recording_id"].to_pylist(), strict=True))

    def ids_tell_recordings(self, sequence_ids: Sequence[str]) -> bool:
        """Return True where ids have all six parts; those of an imported release have three."""
        return names_its_recording(sequence_ids)


PRIME_AND_REACH = PrimeAndReach()
