"""A method as a run needs it: named, versioned, loaded once a process, fitted once a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from prbench.errors import UsageError
from prbench.methods.adapters import InstalledAdapter, find_adapter
from prbench.methods.cache import cache_folder
from prbench.methods.isolation import fenced, isolated_environment, worker_program
from prbench.methods.isolation.isolated import Fit
from prbench.methods.loaded_methods import HELD, LoadedMethod
from prbench.methods.names import METHOD_CONTROLS
from prbench.methods.programs import MethodProgram, is_program, own_environment, program_of
from prbench.methods.remote.program import Program
from prbench.methods.users_environment import users_environment
from prbench.sequences import SequenceTable
from prbench.storage import text_digest

__all__ = ["LoadedMethod", "MethodSpec", "forget_loaded_methods", "method_spec", "unload_method"]


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
        return HELD.method(self)

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
        copy = HELD.training_copy(table)
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
    HELD.forget()


def unload_method() -> None:
    """End the program of this process, if there is one; what was prepared for others is kept."""
    HELD.unload()


def _program_spec(spec: MethodSpec, isolate: bool) -> MethodSpec:
    users = users_environment()
    environment = isolated_environment(users) if isolate else own_environment(users)
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
