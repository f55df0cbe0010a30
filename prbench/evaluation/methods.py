"""A method as a run needs it: named, versioned, loaded once a process, fitted once a table."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import psutil

from prbench.contract import Adapter, Trainable, TrainingRun
from prbench.errors import AdapterError, UsageError
from prbench.evaluation.adapters import InstalledAdapter, find_adapter, load_adapter
from prbench.evaluation.cache import cache_folder
from prbench.evaluation.controls import METHOD_CONTROLS
from prbench.evaluation.isolation import fenced, isolated_environment, worker_program
from prbench.evaluation.isolation.isolated import Fit
from prbench.evaluation.isolation.training_copy import temporary_training_copy
from prbench.evaluation.programs import MethodProgram, is_program, own_environment, program_of
from prbench.evaluation.remote.adapter import RemoteAdapter
from prbench.evaluation.remote.program import Program
from prbench.evaluation.training_split import FIT_SEED, TrainingSplit
from prbench.sequences import SequenceTable
from prbench.storage import text_digest


@dataclass
class LoadedMethod:
    """A method in this process, or the program that this process has started for it."""

    name: str
    adapter: Adapter
    warmed_up: bool = False
    """It has generated a batch, and with it loaded whatever loads on first use."""

    @property
    def is_trainable(self) -> bool:
        """Whether it learns from a table, here or in its own process."""
        return isinstance(self.adapter, Trainable) or getattr(self.adapter, "trainable", False)

    def program_bytes(self) -> int:
        """Memory of the method's program and of all that it has started; 0 in process."""
        if not isinstance(self.adapter, RemoteAdapter):
            return 0
        return sum(_resident_bytes(process) for process in psutil.Process().children(recursive=True))

    def close(self) -> None:
        """End its program, if it has one."""
        if isinstance(self.adapter, RemoteAdapter):
            self.adapter.close()


@dataclass(frozen=True)
class MethodSpec:
    """Enough to make a method in any process."""

    name: str
    """Of the installed adapter; what a program is called before it has introduced itself."""
    weights: Path | None
    options: tuple[tuple[str, str], ...]
    device: str
    threads: int
    fit_folder: Path | None = None
    """Where a fit is kept, if the method is fitted by the run."""
    table_folder: Path | None = None
    """The dataset that it is fitted to."""
    program: Program | None = None
    """What runs the method in a process of its own; None to call it in this one."""
    package: str | None = None
    """The command of a program that the user named; None for an installed method."""
    expected_name: str | None = None
    """What such a program must call itself."""
    isolation: str | None = None
    """``process`` or ``bubblewrap``, or ``container``, if the user asked for isolation."""
    timeout: float | None = None
    hidden: tuple[Path, ...] = ()

    def load(self) -> LoadedMethod:
        """The method, ready to generate; made once a process."""
        return _HELD.method(self)

    def fitted_to(self, table: SequenceTable) -> MethodSpec:
        """The same method, fitted to a table if it learns and brought no weights of its own.

        Fits are kept in the cache folder by method, version, options and both digests of the table; the method itself
        finds there what an earlier fit has left. One in a process of its own gets a copy of the training rows.
        """
        if self.weights is not None or not self.load().is_trainable:
            return self
        installed = find_adapter(self.name)
        key = text_digest(
            installed.package,
            installed.version,
            installed.target,
            *(part for option in self.options for part in option),
            table.identity,
            table.content,
        )
        folder = cache_folder() / "fits" / f"{self.name}-{key[:16]}"
        if self.program is None:
            return replace(self, fit_folder=folder, table_folder=table.folder)
        copy = _HELD.training_copy(table)
        program = self._worker(installed, Fit(copy, folder.absolute()))
        return replace(self, fit_folder=folder, table_folder=copy, program=program)

    def isolated(self, installed: InstalledAdapter) -> MethodSpec:
        """The same installed method, run by a worker that keeps it at a distance."""
        program = self._worker(installed, None)
        return replace(self, program=program, isolation=program.fence)

    def _worker(self, installed: InstalledAdapter, fit: Fit | None) -> Program:
        return worker_program(
            self.name,
            installed.target,
            weights=self.weights,
            options=self.options,
            hidden=self.hidden,
            fit=fit,
            timeout=self.timeout,
        )


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
) -> MethodSpec:
    """How to make a method, whatever it is written in.

    Args:
        method: Name of an installed adapter, ``cmd:`` and a command, or path of a TOML file that describes a program.
        weights: File or folder, or the name of weights that the method knows; None for its default.
        options: ``--option key=value``, handed on as they are.
        device: ``cpu``, ``cuda`` …
        threads: Of the method.
        isolate: Run an installed method in a process of its own that is given neither paths, objects nor environment;
            put a program behind the same fence.
        timeout: Seconds until a batch is answered by another process.
        hidden: Folders that an isolated method must not see, where the file system can be withheld; the cache folder
            is always one of them.

    Raises:
        AdapterError: if there is no such method, with the nearest one.
        InputFileError: if the TOML file does not say what it must.
        UsageError: if there is no such command, or the settings do not fit together.
    """
    hidden = tuple(path.absolute() for path in (*hidden, cache_folder())) if isolate else ()
    spec = MethodSpec(
        method, weights, tuple(sorted((options or {}).items())), device, threads, timeout=timeout, hidden=hidden
    )
    if is_program(method):
        return _program_spec(spec, isolate)
    installed = find_adapter(method, also_known=METHOD_CONTROLS)
    if isolate:
        return spec.isolated(installed)
    if timeout is not None:
        raise UsageError(
            f"--timeout: '{method}' runs in this process, which cannot be stopped in mid-batch. Add --isolate."
        )
    return spec


def forget_loaded_methods() -> None:
    """End programs, and load afresh what is asked for next.

    A new run never meets the state that an earlier one left in a method.
    """
    _HELD.forget()


def unload_method() -> None:
    """End the program of this process, if there is one; what was prepared for others is kept."""
    _HELD.unload()


def _program_spec(spec: MethodSpec, isolate: bool) -> MethodSpec:
    environment = isolated_environment(os.environ) if isolate else own_environment(os.environ)
    found = program_of(
        spec.name, environment=environment, weights=spec.weights, timeout=spec.timeout, hidden=spec.hidden
    )
    program, isolation = found.program, None
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


@dataclass
class _Held:
    """What this process holds for the sake of methods: the one loaded last, and copies of training rows."""

    spec: MethodSpec | None = None
    loaded: LoadedMethod | None = None
    copies: list[tempfile.TemporaryDirectory[str]] = field(default_factory=list)

    def method(self, spec: MethodSpec) -> LoadedMethod:
        if self.loaded is None or self.spec != spec:
            self.unload()
            self.loaded = _loaded_program(spec, spec.program) if spec.program is not None else _loaded_here(spec)
            self.spec = spec
        return self.loaded

    def training_copy(self, table: SequenceTable) -> Path:
        self.copies.append(temporary_training_copy(table))
        return Path(self.copies[-1].name).resolve()

    def forget(self) -> None:
        self.unload()
        for copy in self.copies:
            copy.cleanup()
        self.copies.clear()

    def unload(self) -> None:
        if self.loaded is not None:
            self.loaded.close()
        self.spec = self.loaded = None


_HELD = _Held()


def _loaded_here(spec: MethodSpec) -> LoadedMethod:
    adapter = load_adapter(spec.name, spec.weights, dict(spec.options), spec.device)
    if spec.fit_folder is not None and spec.table_folder is not None and isinstance(adapter, Trainable):
        run = TrainingRun(folder=spec.fit_folder, seed=FIT_SEED, device=spec.device)
        adapter.fit(TrainingSplit.open(spec.table_folder), validation=None, run=run)
    return LoadedMethod(spec.name, adapter)


def _loaded_program(spec: MethodSpec, program: Program) -> LoadedMethod:
    weights = spec.weights
    if weights is not None and weights.exists():
        weights = weights.absolute()
    adapter = RemoteAdapter.start(
        program,
        weights=None if weights is None else str(weights),
        options=dict(spec.options),
        device=spec.device,
        threads=spec.threads,
    )
    if spec.package is None:
        return LoadedMethod(spec.name, adapter)
    try:
        _require_name(adapter.name, spec)
    except AdapterError:
        adapter.close()
        raise
    return LoadedMethod(adapter.name, adapter)


def _require_name(name: str, spec: MethodSpec) -> None:
    """What a program calls itself must be its own: it is what leaderboards show."""
    if spec.expected_name is not None and name != spec.expected_name:
        raise AdapterError(
            f"method '{spec.expected_name}': expected the program to introduce itself by this name, found '{name}'."
            " Correct method.name in the TOML file, or start the right program."
        )
    if name.casefold() in METHOD_CONTROLS:
        raise AdapterError(
            f"program '{spec.name}': expected a name of its own in its hello, found '{name}', which is a control of"
            " the harness. Let it introduce itself by another name."
        )


def _resident_bytes(process: psutil.Process) -> int:
    try:
        return process.memory_info().rss
    except psutil.Error:
        return 0  # it has just ended
