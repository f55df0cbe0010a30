"""Everything that is known before the first case is answered: the methods, cases, batches, and ``run.json``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from jaxtyping import Int

import prbench
from prbench.harness.benchmark import Benchmark, Cases, CaseWork, Rules, load_benchmark
from prbench.harness.methods.loading import (
    LoadedMethod,
    MethodSpec,
    chosen_condition,
    find_adapter,
    forget_loaded_methods,
    method_spec,
    require_weights,
    used_weights,
    weights_digest,
)
from prbench.harness.methods.motions import Declared
from prbench.harness.methods.remote import RemoteMethod
from prbench.harness.planning import plan_digest
from prbench.harness.request import RunRequest
from prbench.harness.run_folder.record import (
    BUILT_IN,
    CONTROL,
    PACKAGE,
    PROGRAM,
    BatchPlanRecord,
    MethodRecord,
    RunRecord,
    TableRecord,
)
from prbench.harness.run_folder.scores import RUN_SCHEMA_VERSION
from prbench.sequences.folds import OPTION, WHOLE_TABLE

DEFAULT_PARENT = Path("runs")
"""Folder of run folders for which the user names none."""
_NAMED_DATASETS = 2
"""Number of datasets, at most, that the name of a run folder spells out."""
_RECORDED_PACKAGES = ("numpy", "pyarrow", "scipy", "torch")  # those on which a result's last digits may depend


@dataclass(frozen=True)
class PreparedDataset:
    """One table, ready to be run."""

    chosen: Cases
    """The cases of split and limit."""
    cases: Cases
    """The chosen cases that the method can answer."""
    method: MethodSpec | None
    """None for a control."""
    work: CaseWork

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.cases.table.info.dataset

    def ids(self, rows: Int[np.ndarray, " rows"]) -> tuple[str, ...]:
        """Ids of a planned batch."""
        return tuple(self.cases.sequence_ids[row] for row in rows)


@dataclass(frozen=True)
class PreparedRun:
    """A request with everything that follows from it."""

    request: RunRequest
    benchmark: Benchmark
    record: RunRecord
    datasets: tuple[PreparedDataset, ...]
    out: Path
    rules: Rules


def prepare_run(request: RunRequest) -> PreparedRun:
    """Load the method, choose and plan the sequences, and put down what decides the result.

    Raises:
        AdapterError: if the method is unknown, cannot be loaded, does not take the condition, or can generate none of
            the sequences.
        TableError: if a table is missing, empty, changed or of an unknown version.
        UsageError: if datasets repeat, a path or split does not exist, or a table follows another protocol.
        InputFileError: if the user's own protocol lacks a key or has one too many.
    """
    # A method that an earlier run of this process has loaded may hold its state.
    forget_loaded_methods()
    benchmark = load_benchmark(request.benchmark)
    request = benchmark.settled(request)
    tables = benchmark.open_tables(request)
    rules = benchmark.rules(request, tables)
    spec = None if request.is_control else _spec(request, benchmark)
    condition = _condition(request, benchmark, spec)
    method = _control(request) if spec is None else _method(request, spec, condition)
    datasets = tuple(
        _dataset(benchmark, request, chosen, spec, method, condition, rules)
        for chosen in benchmark.choose(request, tables)
    )
    record = run_record(request, condition, method, datasets, rules)
    if request.repeats is not None:
        record.require_same_inputs(request.repeats)
    return PreparedRun(request, benchmark, record, datasets, request.out or _default_folder(record), rules)


def prepare_recorded(request: RunRequest, earlier: RunRecord, out: Path) -> PreparedRun:
    """:func:`prepare_run` for motions that are there: the method is not loaded, and nothing of it is needed.

    Args:
        request: The run.
        earlier: What is recorded about it, of which method and condition are taken over.
        out: The run folder.

    Raises:
        TableError: see :func:`prepare_run`.
        UsageError: see :func:`prepare_run`.
    """
    benchmark = load_benchmark(request.benchmark)
    request = benchmark.settled(request)
    tables = benchmark.open_tables(request)
    rules = benchmark.rules(request, tables)
    condition = benchmark.condition(earlier.condition)
    datasets = tuple(
        _dataset(benchmark, request, chosen, None, earlier.method, condition, rules)
        for chosen in benchmark.choose(request, tables)
    )
    record = run_record(request, condition, earlier.method, datasets, rules)
    return PreparedRun(request, benchmark, record, datasets, out, rules)


def _spec(request: RunRequest, benchmark: Benchmark) -> MethodSpec:
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
        group=benchmark.methods,
    )


def _condition(request: RunRequest, benchmark: Benchmark, spec: MethodSpec | None) -> StrEnum:
    """Return the condition that is asked for, or the only one that the method takes; of a control the first."""
    asked = None if request.condition is None else benchmark.condition(request.condition)
    if spec is None:
        return asked or next(iter(benchmark.conditions))
    method = spec.load()
    return chosen_condition(method.name, method.adapter, asked, group=benchmark.methods)


def _control(request: RunRequest) -> MethodRecord:
    own = {"package": "prbench", "version": prbench.__version__, "weights": None, "weights_digest": None}
    limits = {"options": {}, "max_frames": None, "native_fps": None, "motionless": False}
    return MethodRecord(name=request.method, kind=CONTROL, **own, **limits)


def _method(request: RunRequest, spec: MethodSpec, condition: StrEnum) -> MethodRecord:
    """Load an adapter or a program, and return what is recorded about it."""
    method = spec.load()
    origin = f"adapter '{method.name}'"
    declared = Declared.by(method.adapter, origin=origin, conditions=spec.group.conditions)
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
        one_design=declared.one_design,
        isolation=spec.isolation,
    )


def _source(spec: MethodSpec, method: LoadedMethod) -> tuple[str, str, str]:
    """Kind of a method, where it comes from, and its version: of the installed package, or as the program says."""
    if spec.package is not None and isinstance(method.adapter, RemoteMethod):
        return PROGRAM, spec.package, method.adapter.version
    installed = find_adapter(spec.name, entry_points=spec.group.entry_points)
    return (BUILT_IN if installed.built_in else PACKAGE), installed.package, installed.version


def _weights(
    given: Path | None, method: LoadedMethod, condition: StrEnum, origin: str
) -> tuple[str | None, str | None]:
    """Name and digest of the weights in use: those that the method declares, else those that the user gave."""
    if isinstance(method.adapter, RemoteMethod):
        declared = method.adapter.weights.get(condition)
        if declared is not None:
            return declared
        return (given.name, weights_digest(given) if given.exists() else None) if given else (None, None)
    used = used_weights(method.adapter, condition, given, origin=origin)
    return (used.name, weights_digest(used)) if used else (None, None)


def _dataset(
    benchmark: Benchmark,
    request: RunRequest,
    chosen: Cases,
    spec: MethodSpec | None,
    method: MethodRecord,
    condition: StrEnum,
    rules: Rules,
) -> PreparedDataset:
    cases = benchmark.answerable(request, chosen, method)
    if spec is not None:
        spec = benchmark.fitted(spec, cases.table, condition)
    work = benchmark.work(request, cases, method=method, condition=condition, rules=rules)
    return PreparedDataset(chosen, cases, spec, work)


def run_record(
    request: RunRequest,
    condition: StrEnum,
    method: MethodRecord,
    datasets: tuple[PreparedDataset, ...],
    rules: Rules,
) -> RunRecord:
    """Put down what decides the result of a run.

    Args:
        request: The run.
        condition: What the method is given.
        method: The method.
        datasets: Its tables and plans.
        rules: The benchmark's rules.
    """
    return RunRecord(
        schema_version=RUN_SCHEMA_VERSION,
        prbench_version=prbench.__version__,
        protocol_version=rules.version,
        protocol_digest=rules.digest,
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
        device=request.device,
        threads=request.threads,
        packages=package_versions(_RECORDED_PACKAGES),
        tables=tuple(
            table_record(dataset.chosen, dataset.cases, _plan_record(dataset, request)) for dataset in datasets
        ),
        benchmark=request.benchmark,
    )


def _plan_record(dataset: PreparedDataset, request: RunRequest) -> BatchPlanRecord:
    return BatchPlanRecord(
        batch_size=request.batch_size,
        batches=len(dataset.work.plan),
        digest=plan_digest(dataset.cases.sequence_ids, dataset.work.plan),
    )


def table_record(chosen: Cases, cases: Cases, plan: BatchPlanRecord) -> TableRecord:
    """Return what a run's record says about a table.

    Args:
        chosen: The cases of split and limit.
        cases: Those of them that the method can answer.
        plan: Its batches.
    """
    info = cases.table.info
    return TableRecord(
        dataset=info.dataset,
        title=info.title,
        synthetic=info.synthetic,
        redistribution=info.redistribution,
        identity_digest=cases.table.identity,
        content_digest=cases.table.content,
        sequences=len(chosen),
        unsupported=len(chosen) - len(cases),
        selection_digest=chosen.digest,
        batch_plan=plan,
        fold=info.options.get(OPTION),
        whole_table=info.options.get(WHOLE_TABLE),
        estimated_bodies=getattr(info, "estimated_bodies", False),
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
    name = f"{record.method.name}{control}-{record.condition}-{datasets}-{record.short_digest}"
    return DEFAULT_PARENT / re.sub(r"[^\w.+-]", "_", name)
