"""Resolves the words of ``--method`` to a way of making the method, and fits it to a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from prbench.contract import Trainable, TrainingRun
from prbench.errors import UsageError
from prbench.files.storage import cache_folder, text_digest
from prbench.harness.methods.adapters import InstalledEntry, find_adapter
from prbench.harness.methods.groups import MOTIONS, MethodGroup
from prbench.harness.methods.isolation import fenced, isolated_environment, worker_program
from prbench.harness.methods.isolation.isolated import Fit
from prbench.harness.methods.loaded_methods import HELD, MethodSpec
from prbench.harness.methods.names import METHOD_CONTROLS
from prbench.harness.methods.programs import MethodProgram, is_program, own_environment, program_of
from prbench.harness.methods.programs.words import short_name
from prbench.harness.methods.python_files import is_python_method
from prbench.harness.methods.remote.process import Program
from prbench.harness.methods.training_split import FIT_SEED, TrainingSplit
from prbench.harness.methods.users_environment import users_environment
from prbench.protocol.benchmarks import benchmark_of_group
from prbench.sequences import SequenceTable


def method_spec(
    method: str,
    *,
    weights: Path | None = None,
    options: Mapping[str, str] | None = None,
    device: str = "cpu",
    threads: int = 1,
    isolate: bool = False,
    timeout: float | None = None,
    hidden: tuple[Path, ...] = (),
    group: MethodGroup = MOTIONS,
) -> MethodSpec:
    """Return how to make a method, whatever it is written in.

    Args:
        method: Name of an installed adapter, ``cmd:`` and a command, or path of a TOML file that describes a program.
        weights: File or folder, or the name of weights that the method knows; None for its default.
        options: ``--option key=value``, handed on as they are.
        device: ``cpu``, ``cuda`` …
        threads: Threads that the method computes with.
        isolate: Run an installed method in a process of its own that is given neither paths, objects nor environment;
            put a program behind the same fence.
        timeout: Seconds until a batch is answered by another process.
        hidden: Folders that an isolated method must not see, where the file system can be withheld; the cache folder
            is always one of them.
        group: The methods of one benchmark.

    Raises:
        AdapterError: if there is no such method, with the nearest one.
        InputFileError: if the TOML file does not say what it must.
        UsageError: if there is no such command, or the settings do not fit together.
    """
    hidden = tuple(path.absolute() for path in (*hidden, cache_folder())) if isolate else ()
    spec = MethodSpec(
        method,
        weights,
        tuple(sorted((options or {}).items())),
        device,
        threads,
        timeout=timeout,
        hidden=hidden,
        group=group,
    )
    if is_program(method):
        return _program_spec(spec, isolate)
    known = METHOD_CONTROLS if group is MOTIONS else ()
    installed = find_adapter(method, also_known=known, entry_points=group.entry_points)
    if isolate and is_python_method(method):
        raise UsageError(
            f"--isolate: {installed.package} is no package that another process could load. Install it as a package"
            " (`prbench adapters new`), or write it as a program."
        )
    if isolate:
        program = _worker(spec, installed, None)
        return replace(spec, program=program, isolation=program.fence)
    if timeout is not None:
        raise UsageError(
            f"--timeout: '{method}' runs in this process, which cannot be stopped in mid-batch. Add --isolate."
        )
    return spec


def fitted_to(spec: MethodSpec, table: SequenceTable) -> MethodSpec:
    """Return the same method, fitted to a table if it learns and brought no weights of its own.

    Fits are kept in the cache folder by method, version, options and both digests of the table; the method itself
    finds there what an earlier fit has left. One in a process of its own gets a copy of the training rows.
    """
    if spec.weights is not None or not spec.load().is_trainable:
        return spec
    installed = find_adapter(spec.name)
    key = text_digest(
        installed.package,
        installed.version,
        installed.target,
        *(part for option in spec.options for part in option),
        table.identity,
        table.content,
    )
    folder = cache_folder() / "fits" / f"{short_name(spec.name)}-{key[:16]}"
    if spec.program is None:
        return replace(spec, fit_folder=folder, table_folder=table.folder, fit=fit_to_training_rows)
    # Behind the fence the table itself is hidden, as it holds the test rows.
    copy = HELD.training_copy(table)
    program = _worker(spec, installed, Fit(copy, folder.absolute()))
    return replace(spec, fit_folder=folder, table_folder=copy, program=program)


def fit_to_training_rows(adapter: object, spec: MethodSpec) -> None:
    """Fit a method of prime-and-reach that was made in this process; it finds what an earlier fit has left."""
    if isinstance(adapter, Trainable) and spec.fit_folder is not None and spec.table_folder is not None:
        run = TrainingRun(folder=spec.fit_folder, seed=FIT_SEED, device=spec.device)
        adapter.fit(TrainingSplit.open(spec.table_folder), validation=None, run=run)


def _worker(spec: MethodSpec, installed: InstalledEntry, fit: Fit | None) -> Program:
    """Return the worker process that keeps an installed method at a distance."""
    return worker_program(
        spec.name,
        installed.target,
        weights=spec.weights,
        options=spec.options,
        hidden=spec.hidden,
        fit=fit,
        timeout=spec.timeout,
        benchmark=benchmark_of_group(spec.group.entry_points).name,
    )


def _program_spec(spec: MethodSpec, isolate: bool) -> MethodSpec:
    users = users_environment()
    environment = isolated_environment(users) if isolate else own_environment(users)
    found = program_of(
        spec.name, environment=environment, weights=spec.weights, timeout=spec.timeout, hidden=spec.hidden
    )
    program = found.program
    isolation = None
    if isolate:
        program, isolation = _isolated_program(found, spec)
    return replace(
        spec,
        name=program.name,
        program=program,
        package=found.package,
        expected_name=found.expected_name,
        isolation=isolation,
    )


def _isolated_program(found: MethodProgram, spec: MethodSpec) -> tuple[Program, str | None]:
    if found.in_container:
        return found.program, "container"  # which shows no more than its mounts, and has no network
    program = fenced(found.program, readable=found.readable, weights=spec.weights, hidden=spec.hidden)
    return program, program.fence
