"""A benchmark as a value: all that runs, resuming, intervals, comparisons and boards know of one.

What is written once (runs, run folders and boards) asks these objects and
nothing else. What a case is say :class:`Cases`, what a method may know :meth:`CaseWork.questions`, what it answers
:class:`Answer`, who judges :meth:`CaseWork.scores` and :attr:`Benchmark.metrics`. docs/architecture.md, "Adding a
benchmark", shows how one is added.
"""

from __future__ import annotations

import contextlib
import importlib
import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import pyarrow as pa
from jaxtyping import Int

from prbench.checking.doctor.motion_set import Diagnosis
from prbench.engine import Engine
from prbench.errors import PrbenchError, UsageError, did_you_mean
from prbench.harness.methods.loading import MethodSpec
from prbench.harness.methods.remote import MethodGroup
from prbench.harness.planning import of_distinct_datasets
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import CodedScores, DatasetFolder, MethodRecord, PredictionRows, RunFolder
from prbench.metrics import MetricInfo
from prbench.protocol.manifests import AboutBenchmark, BenchmarkProtocol, find_benchmark
from prbench.sequences.table import find_sequence_id

# A table that cases are chosen from: ``folder``, ``info`` (what it is and where it came from, a
# :class:`~prbench.sequences.dataset_info.Provenance`), and two digests, ``identity`` of which cases there are and
# ``content`` of all values.
CaseTable = Any
# The chosen cases of one ``table``, in its order; files call a case a sequence, whatever it is. ``sequence_ids`` and
# ``recording_ids`` hold one entry a case (recordings are independent, cases of one are not), ``digest`` is over the
# ids, ``len()`` counts them, and ``chosen(keep)`` returns those where an array is true.
Cases = Any
Table = TypeVar("Table")
Chosen = TypeVar("Chosen")


@dataclass(frozen=True)
class Answer:
    """What a method answered to the cases of one batch, as it is kept.

    Attributes:
        samples: Motions of the batch, one entry a sample.
        seeds: Noise seed of each case, one list a sample.
        network_passes: Number that the method declares; None where it declares none.
    """

    samples: list[PredictionRows]
    seeds: list[tuple[int, ...]]
    network_passes: int | None = None


class CaseWork(ABC):
    """The work of a run on the cases of one table."""

    @cached_property
    @abstractmethod
    def plan(self) -> list[Int[np.ndarray, "_"]]:
        """Return the places of the cases of each batch; floating-point results may depend on them."""

    @property
    def holds_recordings(self) -> bool:
        """Return True if the answers are recorded motion, for the notice that the data's terms may ask for."""
        return False

    @abstractmethod
    def questions(self, wanted: frozenset[int]) -> Iterator[tuple[int, Any]]:
        """Yield some batches with their numbers, in the order of the plan.

        A question holds the cases of one batch as a method may see them, and nothing else, since it goes to a worker as
        it is. ``ask(method, *, seed, sequence_ids)`` asks the method (None for a control, whose answer the question
        holds), checks what it answers, and returns an :class:`Answer`. ``seed`` is that of the run, and the ids are for
        messages alone. ``digest`` is over what the method is given, and stands beside the answer.
        """

    @abstractmethod
    def scores(self, files: DatasetFolder, engine: Engine) -> Iterator[pa.Table]:
        """Yield rows of ``scores.parquet`` for what was answered, in the order of the table.

        Args:
            files: Files of the dataset, which hold the answers.
            engine: Processes or cluster that scores.
        """

    def findings(self, files: DatasetFolder) -> tuple[Diagnosis, ...]:
        """Return what is certainly wrong with the motions in a folder (docs/doctor.md); nothing where nobody looks."""
        del files
        return ()

    def write_beside(self, files: DatasetFolder, scores: CodedScores) -> None:
        """Write the benchmark's own files beside the scores, where it has some."""
        del files, scores

    def require_beside(self, files: DatasetFolder, scores: CodedScores) -> None:
        """Compare the benchmark's own files with what follows from the scores.

        Raises:
            RunError: naming the first value that differs.
        """
        del files, scores


class Benchmark(ABC, Generic[Table, Chosen]):
    """One benchmark; its value stands in ``benchmark.toml``.

    Attributes:
        metrics: All metrics, in the order in which they are printed.
        methods: How its methods are found and loaded.
        table_file: Name of the file that describes a table, by which a folder is known to hold one.
    """

    name: str
    metrics: tuple[MetricInfo, ...]
    methods: MethodGroup
    table_file: str

    @property
    def about(self) -> AboutBenchmark:
        """Return its description."""
        return find_benchmark(self.name)

    @property
    @abstractmethod
    def present_rules(self) -> Any:
        """Return the protocol of this version of prbench, which has a ``version`` and a ``digest``."""

    def rules_of(self, run: RunFolder) -> Any:
        """Return the rules that a finished run followed; None for those of another version, which are not known."""
        present = self.present_rules
        return present if present.digest == run.record.protocol_digest else None

    def copied_rules(self, rules: Any) -> BenchmarkProtocol | None:
        """Return the user's own protocol, of which a copy is laid beside the run; None for prbench's."""
        del rules
        return None

    @property
    def conditions(self) -> type[StrEnum]:
        """Return what a method may know."""
        return self.methods.conditions

    def condition(self, name: str) -> StrEnum:
        """Return a condition by name.

        Raises:
            UsageError: for one of another benchmark.
        """
        known = [condition.value for condition in self.conditions]
        if name not in known:
            problem = f"expected one of the benchmark {self.name}: {', '.join(known)}.{did_you_mean(name, known)}"
            raise UsageError(f"--condition {name}: {problem}")
        return self.conditions(name)

    @property
    def main_metrics(self) -> tuple[MetricInfo, ...]:
        """Return the columns of leaderboards."""
        return tuple(info for info in self.metrics if info.main)

    @property
    def ranked_metrics(self) -> tuple[MetricInfo, ...]:
        """Return the main metrics by which methods are ranked."""
        return tuple(info for info in self.main_metrics if info.ranked)

    @property
    def compared_metrics(self) -> tuple[MetricInfo, ...]:
        """Return the main metrics by which two methods are compared, all of them steps of one correction."""
        return tuple(info for info in self.main_metrics if info.compared)

    def settled(self, request: RunRequest) -> RunRequest:
        """Refuse options that the benchmark does not know: those of prime-and-reach alone.

        Raises:
            UsageError: naming the option.
        """
        unknown = {f"--method {request.method}": request.is_control}
        unknown |= {f"--{name}": getattr(request, name) is not None for name in ("control", "fold", "protocol")}
        for option, given in unknown.items():
            if given:
                raise UsageError(f"{option}: the benchmark {self.name} does not have it yet; leave it out.")
        return request

    @abstractmethod
    def open_table(self, folder: Path) -> Table:
        """Open one table.

        Raises:
            TableError: if it is missing, empty or of an unknown version.
        """

    def open_tables(self, request: RunRequest) -> list[Table]:
        """Open the tables that are asked for.

        Raises:
            TableError: if one is missing, empty or of an unknown version.
            UsageError: if two are of one dataset.
        """
        return of_distinct_datasets([self.open_table(folder) for folder in request.data])

    def rules(self, request: RunRequest, tables: Sequence[Any]) -> Any:
        """Return the rules of a run on some tables: prbench's own protocol.

        Raises:
            UsageError: if a table follows other rules.
        """
        del request
        protocol = self.present_rules
        for table in tables:
            if table.info.protocol_version != protocol.version:
                problem = f"expected a {table.info.described} of version {protocol.version} of the protocol,"
                found = f"found version {table.info.protocol_version}. Build it again."
                raise UsageError(f"{table.folder}: {problem} {found}")
        return protocol

    @abstractmethod
    def cases(self, table: Table, *, split: str, limit: int | None) -> Chosen:
        """Choose the cases of a split; with ``limit`` every recording's share.

        Raises:
            UsageError: for an unknown split.
            TableError: if there is none.
        """

    def choose(self, request: RunRequest, tables: Sequence[Any]) -> list[Chosen]:
        """Choose the cases of each table; where single ones are asked for, only of the tables that hold one.

        Raises:
            UsageError: for an unknown split, or a name that none or several cases fit.
            TableError: if there is none.
        """
        if not request.sequences:
            return [self.cases(table, split=request.split, limit=request.limit) for table in tables]
        recordings = [self.recordings_of(table) for table in tables]
        known = [name for each in recordings for name in each]
        among = ", ".join(table.info.dataset for table in tables)
        ids = {find_sequence_id(name, known, among=among) for name in request.sequences}
        chosen: list[Any] = []
        for table, own in zip(tables, recordings, strict=True):
            if ids & own.keys():
                cases: Any = self.cases(table, split=request.split, limit=None)
                chosen.append(cases.chosen(np.isin(cases.sequence_ids, sorted(ids))))
        for name in sorted(ids.difference(*(each.sequence_ids for each in chosen))):
            remedy = "Name its split with --split."
            for table, split in itertools.product(tables, ("train", "validation", "test")):
                with contextlib.suppress(PrbenchError):  # a split without cases
                    others: Any = self.cases(table, split=split, limit=None)
                    if name in others.sequence_ids:
                        remedy = f"Give --split {split}."
            raise UsageError(f"{name}: expected a case of split '{request.split}', found one of another. {remedy}")
        return chosen

    def answerable(self, request: RunRequest, cases: Chosen, method: MethodRecord) -> Chosen:
        """Return the cases that a method can answer in full; none is ever cut.

        Raises:
            AdapterError: if it can answer none.
        """
        del request, method
        return cases

    def fitted(self, spec: MethodSpec, table: Table, split: str) -> MethodSpec:
        """Return the method fitted to a table whose ``split`` is run, where it learns and brought no weights."""
        del table, split
        return spec

    @abstractmethod
    def work(
        self, request: RunRequest, cases: Chosen, *, method: MethodRecord, condition: StrEnum, rules: Any
    ) -> CaseWork:
        """Return the work on the cases of one table."""

    @property
    def offline(self) -> Any:
        """Return the module that writes what a method may see and scores what was made elsewhere.

        Raises:
            UsageError: of a benchmark whose methods run here alone; so do :meth:`measure` and :meth:`view`.
        """
        raise self._lacks("files of conditions and answers")

    def measure(self, predicted: np.ndarray, recorded: np.ndarray, **given: Any) -> dict[str, float]:
        """Return the scores of one answer that is given as arrays, as a run computes them."""
        del predicted, recorded, given
        raise self._lacks("scores of single answers")

    def view(self, request: Any) -> Any:
        """Draw what methods answered; request and report are those of :func:`prbench.viewing.view.view`."""
        del request
        raise self._lacks("pictures of runs")

    def _lacks(self, what: str) -> UsageError:
        return UsageError(
            f"the benchmark {self.name} does not have {what}; `prbench run` makes and scores its answers."
        )

    @abstractmethod
    def recording_key(self, sequence_id: str) -> str:
        """Return what cases of one recording have in common, from the id alone."""

    def recordings_of(self, table: Any) -> dict[str, str]:
        """Map each case of a table to its recording."""
        rows = table.scalars(columns=["sequence_id", "recording_id"])
        return dict(zip(rows["sequence_id"].to_pylist(), rows["recording_id"].to_pylist(), strict=True))

    def ids_tell_recordings(self, sequence_ids: Sequence[str]) -> bool:
        """Return True where the ids alone tell which cases are of one recording."""
        del sequence_ids
        return True


@cache
def load_benchmark(name: str) -> Benchmark[Any, Any]:
    """Load the value of a benchmark.

    Raises:
        UsageError: for an unknown name.
    """
    module, _, attribute = find_benchmark(name).value.partition(":")
    return getattr(importlib.import_module(module), attribute)
