"""Make methods, and keep the one that this process has made: called here, or a program that it has started."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from prbench.contract import Trainable
from prbench.errors import AdapterError
from prbench.harness.methods.adapters import load_adapter
from prbench.harness.methods.groups import MOTIONS, MethodGroup
from prbench.harness.methods.names import name_problem
from prbench.harness.methods.programs.words import short_name
from prbench.harness.methods.python_files import is_python_method
from prbench.harness.methods.remote.method import RemoteMethod
from prbench.harness.methods.remote.process import Program
from prbench.harness.methods.training_split import temporary_training_copy
from prbench.protocol.benchmarks import benchmark_of_group
from prbench.sequences import SequenceTable


@dataclass(frozen=True)
class MethodSpec:
    """Enough to make a method in any process."""

    name: str
    """Name of the installed adapter, or of the program's file until the program has introduced itself."""
    weights: Path | None
    options: tuple[tuple[str, str], ...]
    device: str
    threads: int
    fit_folder: Path | None = None
    """Folder of the fit, if the method is fitted by the run."""
    table_folder: Path | None = None
    """The dataset that it is fitted to."""
    program: Program | None = None
    """Program that runs the method in a process of its own; None to call it in this one."""
    package: str | None = None
    """The command of a program that the user named; None for an installed method."""
    expected_name: str | None = None
    """Name that such a program must introduce itself by."""
    isolation: str | None = None
    """``process`` or ``bubblewrap``, or ``container``, if the user asked for isolation."""
    timeout: float | None = None
    hidden: tuple[Path, ...] = ()
    group: MethodGroup = MOTIONS
    """The methods of the run's benchmark."""
    fit: Callable[[Any, MethodSpec], None] | None = None
    """Fits the method, once it is made in this process, to ``table_folder``; importable, since it goes to workers."""

    def load(self) -> LoadedMethod:
        """Return the method, ready to generate; it is made once a process."""
        return HELD.method(self)


@dataclass
class LoadedMethod:
    """A method in this process, or the program that this process has started for it."""

    name: str
    adapter: Any
    warmed_up: bool = False
    """True once it has generated a batch, and with it loaded whatever loads on first use."""

    @property
    def is_trainable(self) -> bool:
        """True if it learns from a table, here or in its own process."""
        return isinstance(self.adapter, Trainable) or getattr(self.adapter, "trainable", False)

    def program_bytes(self) -> int:
        """Return the memory of the method's program and of all that it has started, in bytes; 0 in process."""
        if not isinstance(self.adapter, RemoteMethod):
            return 0
        return sum(_resident_bytes(process) for process in psutil.Process().children(recursive=True))

    @property
    def restarts(self) -> int:
        """Number of times that the method's program was started again after a crash; 0 in process."""
        return self.adapter.restarts if isinstance(self.adapter, RemoteMethod) else 0

    def close(self) -> None:
        """End its program, if it has one."""
        if isinstance(self.adapter, RemoteMethod):
            self.adapter.close()


@dataclass
class _HeldMethods:
    """The method that this process has loaded last, and its copies of training rows."""

    spec: MethodSpec | None = None
    loaded: LoadedMethod | None = None
    copies: list[tempfile.TemporaryDirectory[str]] = field(default_factory=list)

    def method(self, spec: MethodSpec) -> LoadedMethod:
        """Return the method, made anew unless it was the last one; an earlier one's program is ended."""
        # One method at a time: two networks may not fit in the memory of a GPU.
        if self.loaded is None or self.spec != spec:
            self.unload()
            self.loaded = _loaded_program(spec, spec.program) if spec.program is not None else _loaded_here(spec)
            self.spec = spec
        return self.loaded

    def training_copy(self, table: SequenceTable) -> Path:
        """Copy a table's training rows; the folder stays until :meth:`forget`."""
        self.copies.append(temporary_training_copy(table))
        return Path(self.copies[-1].name).resolve()

    def forget(self) -> None:
        """Let go of everything."""
        self.unload()
        for copy in self.copies:
            copy.cleanup()
        self.copies.clear()

    def unload(self) -> None:
        """Let go of the method, and end its program if it has one."""
        if self.loaded is not None:
            self.loaded.close()
        self.spec = self.loaded = None


HELD = _HeldMethods()


def forget_loaded_methods() -> None:
    """End programs, and load afresh what is asked for next.

    A new run never meets the state that an earlier one left in a method.
    """
    HELD.forget()


def unload_method() -> None:
    """End the program of this process, if there is one; copies that were made for others are kept."""
    HELD.unload()


def _loaded_here(spec: MethodSpec) -> LoadedMethod:
    adapter = load_adapter(spec.name, spec.weights, dict(spec.options), spec.device, group=spec.group)
    if spec.fit is not None:
        spec.fit(adapter, spec)
    if not is_python_method(spec.name):
        return LoadedMethod(spec.name, adapter)
    _require_own_name(adapter.name, spec, f"'{short_name(spec.name)}'", "Give it another attribute 'name'.")
    return LoadedMethod(adapter.name, adapter)


def _loaded_program(spec: MethodSpec, program: Program) -> LoadedMethod:
    weights = spec.weights
    if weights is not None and weights.exists():
        weights = weights.absolute()
    adapter = spec.group.remote.start(
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
    """Refuse a name that is not the program's own: leaderboards show it."""
    if spec.expected_name is not None and name != spec.expected_name:
        raise AdapterError(
            f"method '{spec.expected_name}': expected the program to introduce itself by this name, found '{name}'."
            " Correct method.name in the TOML file, or start the right program."
        )
    _require_own_name(name, spec, f"program '{spec.name}'", "Let it introduce itself by another name in its hello.")


def _require_own_name(name: str, spec: MethodSpec, origin: str, remedy: str) -> None:
    """Refuse a name that belongs to prbench, or that cannot be shown."""
    if problem := name_problem(name, own=benchmark_of_group(spec.group.entry_points).methods):
        raise AdapterError(f"{origin}: {problem}. {remedy}")


def _resident_bytes(process: psutil.Process) -> int:
    try:
        return process.memory_info().rss
    except psutil.Error:
        return 0  # it has just ended
