"""Everything that is known before the first case is answered: the methods, cases, batches, and ``run.json``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

import prbench
from prbench.harness.benchmark import Benchmark, Cases, CaseWork, load_benchmark
from prbench.harness.methods import loading
from prbench.harness.methods.motions import Declared
from prbench.harness.methods.remote import RemoteMethod
from prbench.harness.planning import plan_digest
from prbench.harness.request import DEFAULT_PARENT, RunRequest
from prbench.harness.run_folder.folder import run_folder_of
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
from prbench.sequences.folds import OPTION, WHOLE_TABLE, tested_units

# Folder of run folders for which the user names none.
# Number of datasets, at most, that the name of a run folder spells out.
_NAMED_DATASETS = 2
_RECORDED_PACKAGES = ("numpy", "pyarrow", "scipy", "torch")  # those on which a result's last digits may depend


@dataclass(frozen=True)
class PreparedDataset:
    """One table, ready to be run.

    Attributes:
        chosen: The cases of split and limit.
        cases: The chosen cases that the method can answer.
        method: None for a control.
    """

    chosen: Cases
    cases: Cases
    method: loading.MethodSpec | None
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
    rules: Any


def prepare_run(request: RunRequest, *, earlier: RunRecord | None = None) -> PreparedRun:
    """Load the method, choose and plan the sequences, and put down what decides the result.

    Args:
        request: The run.
        earlier: What is recorded about motions that are there: method and condition are taken over, the method is not
            loaded, and nothing of it is needed.

    Raises:
        AdapterError: if the method is unknown, cannot be loaded, does not take the condition, or can generate none of
            the sequences.
        TableError: if a table is missing, empty, changed or of an unknown version.
        UsageError: if datasets repeat, a path or split does not exist, or a table follows another protocol.
        InputFileError: if the user's own protocol lacks a key or has one too many.
    """
    benchmark = load_benchmark(request.benchmark)
    spec = None
    if earlier is None:
        # A method that an earlier run of this process has loaded may hold its state.
        loading.forget_loaded_methods()
    request = benchmark.settled(request)
    tables = benchmark.open_tables(request)
    rules = benchmark.rules(request, tables)
    if earlier is not None:
        condition = benchmark.condition(earlier.condition)
        method = earlier.method
    elif request.is_control:
        asked = request.condition
        condition = next(iter(benchmark.conditions)) if asked is None else benchmark.condition(asked)
        method = MethodRecord.bare(request.method, CONTROL, "prbench", prbench.__version__)
    else:
        loading.require_weights(request.weights)
        same = ("weights", "options", "device", "threads", "isolate", "timeout")
        given = {name: getattr(request, name) for name in same}
        hidden = (*request.data, request.out or DEFAULT_PARENT, *request.hidden)
        spec = loading.method_spec(request.method, **given, hidden=hidden, group=benchmark.methods)
        asked = request.condition
        loaded = spec.load()
        condition = loading.chosen_condition(
            loaded.name, loaded.adapter, None if asked is None else benchmark.condition(asked), group=benchmark.methods
        )
        method = _method(request, spec, condition)
    datasets = []
    for chosen in benchmark.choose(request, tables):
        cases = benchmark.answerable(request, chosen, method)
        fitted = None if spec is None else benchmark.fitted(spec, cases.table, request.split)
        work = benchmark.work(request, cases, method=method, condition=condition, rules=rules)
        datasets.append(PreparedDataset(chosen, cases, fitted, work))
    record = run_record(request, condition, method, tuple(datasets), rules)
    if request.out is None:
        # runs/<method>-<condition>-<datasets>-<digest>, where the same request finds its folder again. Five names would
        # make a folder's name too long to be typed; the digest tells which datasets they are.
        several = len(record.tables) > _NAMED_DATASETS
        named = f"{len(record.tables)}-datasets" if several else "+".join(table.dataset for table in record.tables)
        control = f"-{record.control}" if record.control else ""
        name = f"{record.method.name}{control}-{record.condition}-{named}-{record.short_digest}"
        out = DEFAULT_PARENT / re.sub(r"[^\w.+-]", "_", name)
    else:
        out = run_folder_of(request.out)
    return PreparedRun(request, benchmark, record, tuple(datasets), out, rules)


def _method(request: RunRequest, spec: loading.MethodSpec, condition: StrEnum) -> MethodRecord:
    """Return what is recorded about an adapter or a program."""
    method = spec.load()
    origin = f"adapter '{method.name}'"
    declared = Declared.by(method.adapter, origin=origin, conditions=spec.group.conditions)
    remote = method.adapter if isinstance(method.adapter, RemoteMethod) else None
    given = request.weights
    # Weights that the method declares come before those that the user gave.
    weights: tuple[str | None, str | None] = (None, None)
    if remote is not None and condition in remote.weights:
        weights = remote.weights[condition]
    elif remote is not None:
        weights = (given.name, loading.weights_digest(given) if given.exists() else None) if given else weights
    elif used := loading.used_weights(method.adapter, condition, given, origin=origin):
        weights = (used.name, loading.weights_digest(used))
    if remote is not None and spec.package is not None:
        kind, package, version = PROGRAM, spec.package, remote.version
    else:
        installed = loading.find_adapter(spec.name, entry_points=spec.group.entry_points)
        kind = BUILT_IN if installed.built_in else PACKAGE
        package, version = installed.package, installed.version
    same = ("max_frames", "native_fps", "motionless", "gaze", "one_design")
    return MethodRecord(
        name=method.name,
        kind=kind,
        package=package,
        version=version,
        weights=weights[0],
        weights_digest=weights[1],
        options=dict(spec.options),
        **{name: getattr(declared, name) for name in same},
        isolation=spec.isolation,
    )


def run_record(
    request: RunRequest, condition: StrEnum, method: MethodRecord, datasets: tuple[PreparedDataset, ...], rules: Any
) -> RunRecord:
    """Put down what decides the result of a run.

    Args:
        request: The run.
        condition: What the method is given.
        method: The method.
        datasets: Its tables and plans.
        rules: The benchmark's rules.
    """
    same = ("benchmark", "control", "split", "limit", "seed", "samples", "device", "threads")
    chosen = (name for one in datasets for name in one.chosen.sequence_ids)
    return RunRecord(
        schema_version=RUN_SCHEMA_VERSION,
        prbench_version=prbench.__version__,
        protocol_version=rules.version,
        protocol_digest=rules.digest,
        method=method,
        condition=condition.value,
        **{name: getattr(request, name) for name in same},
        sequences=tuple(sorted(chosen)) if request.sequences else (),
        packages=package_versions(_RECORDED_PACKAGES),
        tables=tuple(table_record(one.chosen, one.cases, one.work.plan, request.batch_size) for one in datasets),
    )


def table_record(
    chosen: Cases, cases: Cases, plan: Sequence[Int[np.ndarray, "_"]] = (), batch_size: int = 0
) -> TableRecord:
    """Return what a run's record says about a table.

    Args:
        chosen: The cases of split and limit.
        cases: Those of them that the method can answer.
        plan: Places of the cases of each batch; none for motions that came as a file.
        batch_size: Cases of a batch at most.
    """
    info = cases.table.info
    digest = plan_digest(cases.sequence_ids, plan) if plan else ""
    return TableRecord(
        **{name: getattr(info, name) for name in ("dataset", "title", "synthetic", "redistribution")},
        identity_digest=cases.table.identity,
        content_digest=cases.table.content,
        sequences=len(chosen),
        unsupported=len(chosen) - len(cases),
        selection_digest=chosen.digest,
        batch_plan=BatchPlanRecord(batch_size=batch_size, batches=len(plan), digest=digest),
        fold=info.options.get(OPTION),
        whole_table=info.options.get(WHOLE_TABLE),
        units=tested_units(cases.table) if OPTION in info.options else {},
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
