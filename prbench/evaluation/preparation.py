"""Everything that is known before the first motion is generated: the methods, sequences, batches, and ``run.json``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

import prbench
from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench.evaluation.best_of import require_goal
from prbench.evaluation.carry_on import Carrying, require_goal_to_carry, whole_pairs
from prbench.evaluation.conditions import ConditionSource, derangement
from prbench.evaluation.controls import RECORDED_MOTION, SHUFFLED_GOAL
from prbench.evaluation.planning import (
    Selection,
    open_tables,
    plan_batches,
    plan_digest,
    select,
    select_sequences,
)
from prbench.evaluation.request import RunRequest
from prbench.locks import in_turn
from prbench.manifests import BenchmarkProtocol
from prbench.methods.adapters import chosen_condition, find_adapter, require_weights, used_weights, weights_digest
from prbench.methods.declared import Declared
from prbench.methods.loaded_methods import LoadedMethod, MethodSpec, forget_loaded_methods
from prbench.methods.methods import fitted_to, method_spec
from prbench.methods.motions import native_frames
from prbench.methods.remote.adapter import RemoteAdapter
from prbench.own_protocol import protocol_for
from prbench.runs.record import (
    BUILT_IN,
    CONTROL,
    PACKAGE,
    PROGRAM,
    BatchPlanRecord,
    MethodRecord,
    RunRecord,
    TableRecord,
)
from prbench.runs.scores import RUN_SCHEMA_VERSION
from prbench.sequences import SequenceTable
from prbench.sequences.folds import OPTION, WHOLE_TABLE, fold_table
from prbench.storage import text_digest

DEFAULT_PARENT = Path("runs")
"""Folder of run folders for which the user names none."""
_NAMED_DATASETS = 2
"""Number of datasets, at most, that the name of a run folder spells out."""
_RECORDED_PACKAGES = ("numpy", "pyarrow", "scipy", "torch")  # those on which a result's last digits may depend


@dataclass(frozen=True)
class PreparedDataset:
    """One table, ready to be run."""

    chosen: Selection
    """The sequences of split and limit."""
    selection: Selection
    """The chosen sequences that the method can generate."""
    source: ConditionSource
    plan: list[Int[np.ndarray, "_"]]
    method: MethodSpec | None
    """None for a control."""
    scored_goals: Float[np.ndarray, "n 3"] | None
    """Goals of other sequences that the recorded motion is scored against; None for each sequence's own."""
    carrying: Carrying | None = None
    """Pairs whose puts carry on from generated picks; None where every sequence starts as recorded."""
    pick_batches: int = 0
    """Number of batches, the first of the plan, that hold the picks of :attr:`carrying`."""

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.selection.table.info.dataset

    def ids(self, rows: Int[np.ndarray, " rows"]) -> tuple[str, ...]:
        """Ids of a planned batch."""
        return tuple(self.selection.sequence_ids[row] for row in rows)


@dataclass(frozen=True)
class PreparedRun:
    """A request with everything that follows from it."""

    request: RunRequest
    condition: Condition
    """The condition asked for, or the only one that the method takes."""
    record: RunRecord
    datasets: tuple[PreparedDataset, ...]
    out: Path
    protocol: BenchmarkProtocol


def prepare_run(request: RunRequest) -> PreparedRun:
    """Load the method, choose and plan the sequences, and put down what decides the result.

    Raises:
        AdapterError: if the method is unknown, cannot be loaded, does not take the condition, or can generate none of
            the sequences.
        TableError: if a table is missing, empty, changed or of an unknown version.
        UsageError: if datasets repeat, a path or split does not exist, a table follows another protocol, or motions are
            to be chosen by a goal that the condition does not give.
        InputFileError: if the user's own protocol lacks a key or has one too many.
    """
    # A method that an earlier run of this process has loaded may hold its state.
    forget_loaded_methods()
    if request.fold is not None:
        folds = tuple(fold_table(folder, request.fold).folder for folder in request.data)
        request = replace(request, data=folds, fold=None)
    tables = open_tables(request.data)
    protocol = protocol_for(request.protocol, (table.described_protocol for table in tables))
    spec = None if request.is_control else _spec(request)
    condition = _condition(request, spec)
    require_goal(condition, best_of=request.best_of)
    if request.carry_on:
        require_goal_to_carry(condition)
    method = _control(request) if spec is None else _method(request, spec, condition)
    datasets = tuple(_dataset(request, chosen, spec, method) for chosen in _chosen_sequences(request, tables))
    record = _record(request, condition, method, datasets, protocol)
    if request.repeats is not None:
        record.require_same_inputs(request.repeats)
    return PreparedRun(request, condition, record, datasets, request.out or _default_folder(record), protocol)


def _spec(request: RunRequest) -> MethodSpec:
    require_weights(request.weights)
    return method_spec(
        request.method,
        weights=request.weights,
        options=request.options,
        device=request.device,
        threads=request.threads,
        isolate=request.isolate,
        timeout=request.timeout,
        hidden=(*request.data, request.out or DEFAULT_PARENT),
    )


def _condition(request: RunRequest, spec: MethodSpec | None) -> Condition:
    """Return the condition that is asked for, or the only one that the method takes."""
    if spec is None:
        return request.condition or Condition.NONE
    method = spec.load()
    return chosen_condition(method.name, method.adapter, request.condition)


def _control(request: RunRequest) -> MethodRecord:
    own = {"package": "prbench", "version": prbench.__version__, "weights": None, "weights_digest": None}
    limits = {"options": {}, "max_frames": None, "native_fps": None, "motionless": False}
    return MethodRecord(name=request.method, kind=CONTROL, **own, **limits)


def _method(request: RunRequest, spec: MethodSpec, condition: Condition) -> MethodRecord:
    """Load an adapter or a program, and return what is recorded about it."""
    method = spec.load()
    origin = f"adapter '{method.name}'"
    declared = Declared.by(method.adapter, origin=origin)
    weights, digest = _weights(request.weights, method, condition, origin)
    kind, package, version = _source(spec, method)
    return MethodRecord(
        name=method.name,
        kind=kind,
        package=package,
        version=version,
        weights=weights,
        weights_digest=digest,
        options=dict(spec.options),
        max_frames=declared.max_frames,
        native_fps=declared.native_fps,
        motionless=declared.motionless,
        gaze=declared.gaze,
        wants_obstacles=declared.wants_obstacles,
        isolation=spec.isolation,
    )


def _source(spec: MethodSpec, method: LoadedMethod) -> tuple[str, str, str]:
    """Kind of a method, where it comes from, and its version: of the installed package, or as the program says."""
    if spec.package is not None and isinstance(method.adapter, RemoteAdapter):
        return PROGRAM, spec.package, method.adapter.version
    installed = find_adapter(spec.name)
    return (BUILT_IN if installed.built_in else PACKAGE), installed.package, installed.version


def _weights(
    given: Path | None, method: LoadedMethod, condition: Condition, origin: str
) -> tuple[str | None, str | None]:
    """Name and digest of the weights in use: those that the method declares, else those that the user gave."""
    if isinstance(method.adapter, RemoteAdapter):
        declared = method.adapter.weights.get(condition)
        if declared is not None:
            return declared.name, declared.sha256
        return (given.name, weights_digest(given) if given.exists() else None) if given else (None, None)
    used = used_weights(method.adapter, condition, given, origin=origin)
    return (used.name, weights_digest(used)) if used else (None, None)


def _chosen_sequences(request: RunRequest, tables: list[SequenceTable]) -> list[Selection]:
    """Select sequences of each table; where single ones are asked for, only of the tables that hold one."""
    if request.sequences:
        return select_sequences(tables, request.sequences, split=request.split)
    return [select(table, split=request.split, limit=request.limit, carry_on=request.carry_on) for table in tables]


def _dataset(
    request: RunRequest,
    chosen: Selection,
    spec: MethodSpec | None,
    method: MethodRecord,
) -> PreparedDataset:
    table = chosen.table
    selection = supported(chosen, max_frames=method.max_frames, native_fps=method.native_fps)
    if request.carry_on:
        selection = whole_pairs(selection)
    if not len(selection):
        raise AdapterError(
            f"adapter '{method.name}' generates at most {method.max_frames} frames; all {len(chosen)} chosen sequences"
            f" of {table.info.dataset} are longer."
        )
    if spec is not None:
        spec = fitted_to(spec, table)
        with nullcontext() if spec.fit_folder is None else in_turn(spec.fit_folder):
            spec.load()  # a fit is made here, once, and found by every worker
    source = ConditionSource.read(selection, obstacles=method.wants_obstacles)
    scored_goals = None
    if request.control == SHUFFLED_GOAL:
        shuffled = source.with_goals_of(derangement(selection, seed=request.seed))
        if request.method in RECORDED_MOTION:
            scored_goals = shuffled.goal_location
        source = shuffled
    if not request.carry_on:
        plan = plan_batches(selection.n_frames, request.batch_size)
        return PreparedDataset(chosen, selection, source, plan, spec, scored_goals)
    carrying = Carrying.of(selection)
    # Picks first: a put cannot start before its pick has ended.
    halves = [_plan_of(np.sort(rows), selection, request.batch_size) for rows in (carrying.picks, carrying.puts)]
    plan = halves[0] + halves[1]
    return PreparedDataset(chosen, selection, source, plan, spec, scored_goals, carrying, len(halves[0]))


def _plan_of(rows: Int[np.ndarray, " rows"], selection: Selection, batch_size: int) -> list[Int[np.ndarray, "_"]]:
    """Plan the batches of some sequences of a selection."""
    return [rows[batch] for batch in plan_batches(selection.n_frames[rows], batch_size)]


def supported(selection: Selection, *, max_frames: int | None, native_fps: float | None) -> Selection:
    """The sequences that a method can generate in full; none is ever cut.

    Args:
        selection: The chosen sequences.
        max_frames: The method's limit, at its own rate; None for none.
        native_fps: The method's own rate; None for the table's.
    """
    if max_frames is None:
        return selection
    n_frames = selection.n_frames
    if native_fps is not None:
        n_frames = native_frames(n_frames, fps=selection.fps, native_fps=native_fps)
    return selection.chosen(n_frames <= max_frames)


def _record(
    request: RunRequest,
    condition: Condition,
    method: MethodRecord,
    datasets: tuple[PreparedDataset, ...],
    protocol: BenchmarkProtocol,
) -> RunRecord:
    return RunRecord(
        schema_version=RUN_SCHEMA_VERSION,
        prbench_version=prbench.__version__,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        method=method,
        condition=condition.value,
        control=request.control,
        split=request.split,
        limit=request.limit,
        sequences=tuple(sorted(name for one in datasets for name in one.chosen.sequence_ids))
        if request.sequences
        else (),
        seed=request.seed,
        samples=request.samples,
        best_of=request.best_of,
        carry_on=request.carry_on,
        device=request.device,
        threads=request.threads,
        packages=package_versions(_RECORDED_PACKAGES),
        tables=tuple(
            table_record(dataset.chosen, dataset.selection, _plan_record(dataset, request)) for dataset in datasets
        ),
    )


def _plan_record(dataset: PreparedDataset, request: RunRequest) -> BatchPlanRecord:
    return BatchPlanRecord(
        batch_size=request.batch_size,
        batches=len(dataset.plan),
        digest=plan_digest(dataset.selection.sequence_ids, dataset.plan),
    )


def table_record(chosen: Selection, selection: Selection, plan: BatchPlanRecord) -> TableRecord:
    """Return what a run's record says about a table.

    Args:
        chosen: The sequences of split and limit.
        selection: Those of them that the method can generate.
        plan: Its batches.
    """
    info = selection.table.info
    return TableRecord(
        dataset=info.dataset,
        title=info.title,
        synthetic=info.synthetic,
        redistribution=info.redistribution,
        identity_digest=selection.table.identity,
        content_digest=selection.table.content,
        sequences=len(chosen),
        unsupported=len(chosen) - len(selection),
        selection_digest=chosen.digest,
        batch_plan=plan,
        fold=info.options.get(OPTION),
        whole_table=info.options.get(WHOLE_TABLE),
    )


def package_versions(names: Iterable[str]) -> dict[str, str]:
    """Map Python and those of some packages that are installed to their versions."""
    found = {"python": ".".join(map(str, sys.version_info[:3]))}
    for name in names:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _default_folder(record: RunRecord) -> Path:
    """``runs/<method>-<condition>-<datasets>-<digest>``; the same request finds its folder again."""
    control = f"-{record.control}" if record.control else ""
    # Five names would make a folder's name too long to be typed; the digest tells which datasets they are.
    several = len(record.tables) > _NAMED_DATASETS
    datasets = f"{len(record.tables)}-datasets" if several else "+".join(table.dataset for table in record.tables)
    best_of = f"-best-of-{record.best_of}" if record.best_of > 1 else ""
    name = f"{record.method.name}{control}-{record.condition}{best_of}-{datasets}-{text_digest(repr(record))[:8]}"
    return DEFAULT_PARENT / re.sub(r"[^\w.+-]", "_", name)
