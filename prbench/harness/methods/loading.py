"""Make a method from the words of ``--method``, fit it to a table, and keep the one that this process has made."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from prbench.contract import Trainable, TrainingRun
from prbench.entry_points import ADAPTERS
from prbench.errors import AdapterError, PrbenchError, UsageError
from prbench.files.storage import cache_folder, file_digest, text_digest
from prbench.harness.methods import isolation, motions, process, programs, training_split
from prbench.harness.methods.installed import (
    METHOD_CONTROLS,
    InstalledEntry,
    find_python_method,
    import_python_method,
    is_program,
    is_python_method,
    list_adapters,
    name_problem,
    no_such_method,
    offered_twice,
    short_name,
)
from prbench.harness.methods.remote import MOTIONS, MethodGroup, RemoteMethod, group_of
from prbench.protocol.manifests import PROTOCOL_NAME, benchmark_of_group, benchmarks
from prbench.sequences import SequenceTable


def find_adapter(name: str, *, also_known: Iterable[str] = (), entry_points: str = ADAPTERS) -> InstalledEntry:
    """Find the installed method of this name: prbench's own, or the one that a single package offers.

    A Python file and ``module:function`` are found without being installed
    (:mod:`prbench.harness.methods.installed`).

    Args:
        name: Text behind ``--method``.
        also_known: Further names that may be meant, such as those of controls.
        entry_points: Entry-point group, which is that of one benchmark.

    Raises:
        AdapterError: if there is none (with the nearest name), two packages offer it, or its metadata are damaged.
    """
    if is_python_method(name):
        return find_python_method(name)
    installed = list_adapters(entry_points)
    claims = [adapter for adapter in installed if adapter.name == name]
    found = [adapter for adapter in claims if not adapter.problem]
    if len(found) > 1:
        offers = ", ".join(f"{adapter.target} of {adapter.package} {adapter.version}" for adapter in found)
        raise AdapterError(f"adapter '{name}' is offered more than once: {offers}. Uninstall all but one.")
    if found:
        return found[0]
    if claims:
        remedy = "Repair the entry point, or reinstall the package."
        raise AdapterError(f"adapter '{name}' (package {claims[0].package}): {claims[0].problem}. {remedy}")
    for other in benchmarks().values():
        elsewhere = {adapter.name for adapter in list_adapters(other.entry_points) if not adapter.problem}
        if other.entry_points != entry_points and name in elsewhere:
            problem = "which is not the one asked for here"
            why = f"`prbench run --benchmark {other.name} --method {name}` runs it."
            raise AdapterError(f"'{name}' is a method of the benchmark {other.name}, {problem}: {why}")
    raise no_such_method(name, [*(adapter.name for adapter in installed), *also_known])


def load_adapter(
    name: str, weights: Path | None, options: Mapping[str, str], device: str, *, group: MethodGroup = MOTIONS
) -> Any:
    """Import a method and make it.

    Args:
        name: Name of the entry point.
        weights: File or folder, or None for the method's default.
        options: ``--option key=value``, handed on as they are.
        device: ``cpu``, ``cuda`` …
        group: The methods of one benchmark.

    Raises:
        AdapterError: if it is not installed, cannot be imported, refuses an option, or is no adapter; the message
            names the package and the cause.
    """
    installed = find_adapter(name, entry_points=group.entry_points)
    point = EntryPoint(installed.name, installed.target, group.entry_points)
    origin = f"adapter '{name}' (package {installed.package} {installed.version}, {installed.target})"
    try:
        load = import_python_method(name) if is_python_method(name) else point.load()
    except (Exception, SystemExit) as error:
        remedy = "Repair or reinstall the package."
        raise AdapterError(f"{origin}: cannot be imported: {_cause(error)}. {remedy}") from error
    try:
        adapter = load(weights, options=dict(options), device=device)
    except PrbenchError:
        raise
    except ValueError as error:
        raise AdapterError(f"{origin}: refused its settings: {error}") from error
    except (Exception, SystemExit) as error:
        raise AdapterError(f"{origin}: cannot be loaded: {_cause(error)}.") from error
    if not isinstance(adapter, group.interface):
        raise AdapterError(f"{origin}: expected an object with {group.members}, found {type(adapter).__name__}.")
    motions.Declared.by(adapter, origin=origin, conditions=group.conditions)
    return adapter


def chosen_condition(name: str, adapter: Any, condition: StrEnum | None, *, group: MethodGroup = MOTIONS) -> Any:
    """Return the condition that a method is run under: the one asked for, or the only one that it takes.

    Raises:
        AdapterError: if the method does not take it, or none is asked for and it takes several; names those that it
            takes.
    """
    conditions = motions.Declared.by(adapter, origin=f"adapter '{name}'", conditions=group.conditions).conditions
    if condition is not None and condition in conditions:
        return condition
    if condition is None and len(conditions) == 1:
        return next(iter(conditions))
    taken = ", ".join(sorted(item.value for item in conditions))
    if condition is None:
        raise AdapterError(f"adapter '{name}' takes several conditions. Choose one with --condition: {taken}.")
    raise AdapterError(f"adapter '{name}' does not take the condition '{condition.value}'. Choose one of: {taken}.")


def used_weights(adapter: Any, condition: StrEnum, given: Path | None, *, origin: str) -> Path | None:
    """Return the weights used under a condition: those the method names itself (``weights_for``), else those given.

    Raises:
        AdapterError: if it names something that is no path.
    """
    weights_for = getattr(adapter, "weights_for", None)
    if weights_for is None:
        return given
    weights = weights_for(condition)
    if weights is None or isinstance(weights, Path):
        return weights
    raise AdapterError(f"{origin}: expected weights_for() to return a pathlib.Path or None, found {weights!r}.")


def require_weights(weights: Path | None) -> None:
    """Refuse a path that does not exist; a single word may be a name that the method knows.

    Raises:
        UsageError: if it is neither.
    """
    if weights is not None and not weights.exists() and (len(weights.parts) > 1 or weights.suffix):
        raise UsageError(f"--weights {weights}: expected a file or folder, found neither.")


def weights_digest(weights: Path | None) -> str | None:
    """Return the SHA-256 of a weights file, or of the names and contents of a folder.

    Raises:
        UsageError: if the path does not exist.
    """
    if weights is None:
        return None
    if weights.is_file():
        return file_digest(weights)
    if not weights.is_dir():
        raise UsageError(f"--weights {weights}: expected a file or folder, found neither.")
    total = hashlib.sha256()
    # Sorted, so that the digest does not depend on the file system.
    for path in sorted(path for path in weights.rglob("*") if path.is_file()):
        total.update(f"{path.relative_to(weights).as_posix()}\t{file_digest(path)}\n".encode())
    return total.hexdigest()


def _cause(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}".rstrip(".")


@dataclass(frozen=True)
class MethodSpec:
    """Enough to make a method in any process.

    Attributes:
        name: Name of the installed adapter, or of the program's file until the program has introduced itself.
        fit_folder: Folder of the fit, if the method is fitted by the run.
        table_folder: The dataset that it is fitted to.
        program: Program that runs the method in a process of its own; None to call it in this one.
        group: The methods of the run's benchmark.
        fit: Fits the method, once it is made in this process, to ``table_folder``; importable, since it goes to
            workers.
    """

    name: str
    weights: Path | None
    options: tuple[tuple[str, str], ...]
    device: str
    threads: int
    fit_folder: Path | None = None
    table_folder: Path | None = None
    program: process.Program | None = None
    timeout: float | None = None
    hidden: tuple[Path, ...] = ()
    group: MethodGroup = MOTIONS
    fit: Callable[[Any, MethodSpec], None] | None = None

    @property
    def package(self) -> str | None:
        """The command of a program that the user named; None for an installed method."""
        return None if self.program is None else self.program.package

    @property
    def isolation(self) -> str | None:
        """``process``, ``bubblewrap`` or ``container``, if the user asked for isolation."""
        return None if self.program is None else self.program.fence

    def load(self) -> LoadedMethod:
        """Return the method, ready to generate; it is made once a process."""
        if _HELD.loaded is None or _HELD.spec != self:
            # One method at a time: two networks may not fit in the memory of a GPU.
            unload_method()
            if self.program is not None:
                _HELD.loaded = _loaded_program(self, self.program)
            else:
                adapter = load_adapter(self.name, self.weights, dict(self.options), self.device, group=self.group)
                if self.fit is not None:
                    self.fit(adapter, self)
                name = self.name
                if is_python_method(name):  # nobody has given it a name but its author
                    name = adapter.name
                    _require_own_name(name, self, f"'{short_name(self.name)}'", "Give it another attribute 'name'.")
                _HELD.loaded = LoadedMethod(name, adapter)
            _HELD.spec = self
        return _HELD.loaded


@dataclass
class LoadedMethod:
    """A method in this process, or the program that this process has started for it.

    Attributes:
        warmed_up: True once it has generated a batch, and with it loaded whatever loads on first use.
    """

    name: str
    adapter: Any
    warmed_up: bool = False

    @property
    def is_trainable(self) -> bool:
        """True if it learns from a table, here or in its own process."""
        return isinstance(self.adapter, Trainable) or getattr(self.adapter, "trainable", False)


@dataclass
class _HeldMethods:
    """The method that this process has loaded last, and its copies of training rows."""

    spec: MethodSpec | None = None
    loaded: LoadedMethod | None = None
    copies: list[tempfile.TemporaryDirectory[str]] = field(default_factory=list)


_HELD = _HeldMethods()


def forget_loaded_methods() -> None:
    """End programs, and load afresh what is asked for next.

    A new run never meets the state that an earlier one left in a method.
    """
    unload_method()
    for copy in _HELD.copies:
        copy.cleanup()
    _HELD.copies.clear()


def unload_method() -> None:
    """End the program of this process, if there is one; copies that were made for others are kept."""
    if _HELD.loaded is not None and isinstance(_HELD.loaded.adapter, RemoteMethod):
        _HELD.loaded.adapter.close()
    _HELD.spec = _HELD.loaded = None


def _loaded_program(spec: MethodSpec, program: process.Program) -> LoadedMethod:
    weights = spec.weights
    if weights is not None and weights.exists():
        weights = weights.absolute()
    given = None if weights is None else str(weights)
    adapter = spec.group.remote.start(
        program, weights=given, options=dict(spec.options), device=spec.device, threads=spec.threads
    )
    if program.package is None:
        return LoadedMethod(spec.name, adapter)
    try:
        # Leaderboards show the name, so it has to be the program's own.
        if program.expected_name not in (None, adapter.name):
            problem = f"expected the program to introduce itself by this name, found '{adapter.name}'."
            advice = "Correct method.name in the TOML file, or start the right program."
            raise AdapterError(f"method '{program.expected_name}': {problem} {advice}")
        remedy = "Let it introduce itself by another name in its hello."
        _require_own_name(adapter.name, spec, f"program '{spec.name}'", remedy)
    except AdapterError:
        adapter.close()
        raise
    return LoadedMethod(adapter.name, adapter)


def _require_own_name(name: str, spec: MethodSpec, origin: str, remedy: str) -> None:
    """Refuse a name that belongs to prbench, or that cannot be shown."""
    if problem := name_problem(name, own=benchmark_of_group(spec.group.entry_points).methods):
        raise AdapterError(f"{origin}: {problem}. {remedy}")


_DEEPEST = 6  # attributes of attributes; the built-in methods hold their networks at most three deep


def count_parameters(method: object) -> int | None:
    """Return the number of parameters of all PyTorch modules that are reachable from an object's attributes.

    A module counts once, however often it is held; buffers do not count. None without PyTorch and without modules, as
    for a method that runs as a program of its own.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        return None
    parameters: dict[int, int] = {}
    seen: set[int] = set()
    waiting: list[tuple[Any, int]] = [(method, 0)]
    while waiting:
        held, depth = waiting.pop(0)
        # Neither classes nor code hold the networks of this method alone.
        if id(held) in seen or depth > _DEEPEST or isinstance(held, type | ModuleType | FunctionType):
            continue
        seen.add(id(held))
        if isinstance(held, torch.nn.Module):
            parameters |= {id(parameter): parameter.numel() for parameter in held.parameters()}
            continue
        inner = held if isinstance(held, list | tuple) else getattr(held, "__dict__", {}).values()
        slots = [name for name in getattr(type(held), "__slots__", ()) if hasattr(held, name)]
        inner = held.values() if isinstance(held, Mapping) else [*inner, *(getattr(held, name) for name in slots)]
        waiting += [(each, depth + 1) for each in inner]
    return sum(parameters.values()) if parameters else None


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
    given = tuple(sorted((options or {}).items()))
    spec = MethodSpec(method, weights, given, device, threads, timeout=timeout, hidden=hidden, group=group)
    if is_program(method):
        environment = process.users_environment()
        if isolate:
            environment = isolation.isolated_environment(environment)
        else:  # a program of the user's own gets all of their variables, and none of the harness's
            withheld = [name for name in environment if name.upper().startswith("PRBENCH_")]
            environment = {name: value for name, value in environment.items() if name not in withheld}
        program = programs.program_of(method, environment=environment, weights=weights, timeout=timeout, hidden=hidden)
        if isolate and program.in_container:  # it shows no more than its mounts, and has no network
            program = replace(program, fence="container")
        elif isolate:
            program = isolation.fenced(program, weights=weights, hidden=hidden)
        return replace(spec, name=program.name, program=program)
    known = METHOD_CONTROLS if group is MOTIONS else ()
    installed = find_adapter(method, also_known=known, entry_points=group.entry_points)
    if isolate and is_python_method(method):
        remedy = "Install it as a package (`prbench adapters new`), or write it as a program."
        raise UsageError(f"--isolate: {installed.package} is no package that another process could load. {remedy}")
    if isolate:
        return replace(spec, program=worker_program(spec, installed.target))
    if timeout is not None:
        why = "which cannot be stopped in mid-batch. Add --isolate."
        raise UsageError(f"--timeout: '{method}' runs in this process, {why}")
    return spec


def fitted_to(spec: MethodSpec, table: SequenceTable) -> MethodSpec:
    """Return the same method, fitted to a table if it learns and brought no weights of its own.

    Fits are kept in the cache folder by method, version, options and both digests of the table; the method itself
    finds there what an earlier fit has left. One in a process of its own gets a copy of the training rows.
    """
    if spec.weights is not None or not spec.load().is_trainable:
        return spec
    installed = find_adapter(spec.name)
    options = (part for option in spec.options for part in option)
    key = text_digest(installed.package, installed.version, installed.target, *options, table.identity, table.content)
    folder = cache_folder() / "fits" / f"{short_name(spec.name)}-{key[:16]}"
    if spec.program is None:
        return replace(spec, fit_folder=folder, table_folder=table.folder, fit=fit_to_training_rows)
    apart = fitted_apart(spec, partial(training_split.write_training_copy, table), folder.absolute())
    return replace(apart, fit_folder=folder)


def fitted_apart(spec: MethodSpec, write: Callable[[Path], object], fit_folder: Path | None = None) -> MethodSpec:
    """Return a method in a process of its own that is fitted there to a copy of what it may learn from.

    Behind the fence the table itself is hidden, as it holds what the method is tested on.

    Args:
        spec: The method.
        write: Writes the copy into an empty folder.
        fit_folder: Absolute path of what the fit leaves; None where nothing is kept.
    """
    target = find_adapter(spec.name, entry_points=spec.group.entry_points).target
    _HELD.copies.append(training_split.temporary_copy(write))
    copy = Path(_HELD.copies[-1].name).resolve()
    return replace(spec, table_folder=copy, program=worker_program(spec, target, (copy, fit_folder)))


def fit_to_training_rows(adapter: object, spec: MethodSpec) -> None:
    """Fit a method of prime-and-reach that was made in this process; it finds what an earlier fit has left."""
    if isinstance(adapter, Trainable) and spec.fit_folder is not None and spec.table_folder is not None:
        run = TrainingRun(folder=spec.fit_folder, seed=training_split.FIT_SEED, device=spec.device)
        adapter.fit(training_split.TrainingSplit.open(spec.table_folder), validation=None, run=run)


_FIT_TIMEOUT = 7 * 24 * 3600.0  # seconds: fitting takes as long as it takes, as it does in this process
_WORKER = "prbench.harness.methods.worker"


def worker_program(spec: MethodSpec, target: str, fit: tuple[Path, Path | None] | None = None) -> process.Program:
    """Return the worker that runs an installed method at a distance.

    Args:
        spec: The method; files that values of its options name by absolute paths are shown to it.
        target: ``module:callable`` of its entry point.
        fit: Folders of a copy of the training rows and of the result (None where none is kept), if the run fits the
            method; else None.
    """
    environment = isolation.isolated_environment(process.users_environment()) | isolation.text_encoder(os.environ)
    # The worker finds prbench where this process found it, installed or not; it drops the variable again.
    environment["PYTHONPATH"] = os.pathsep.join(isolation.import_path())
    benchmark = benchmark_of_group(spec.group.entry_points).name
    words = [sys.executable, "-P", "-m", _WORKER, spec.name, "--benchmark", benchmark]
    shown = [
        isolation.Shown(path) for path in (*isolation.python_folders(target), *isolation.readable_folders(environment))
    ]
    shown += [isolation.Shown(Path(value)) for _, value in spec.options if Path(value).is_absolute()]
    if spec.weights is not None:
        shown.append(isolation.Shown(spec.weights.absolute(), essential=True))
    program = process.Program(spec.name, (), None, tuple(sorted(environment.items())))
    if spec.timeout is not None:
        program = replace(program, batch_timeout=spec.timeout)
    if fit is not None:
        train, folder = fit
        words += ["--train", str(train)]
        shown.append(isolation.Shown(train, essential=True))
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            words += ["--fit", str(folder)]
            shown.append(isolation.Shown(folder, writable=True, essential=True))
        program = replace(program, start_timeout=_FIT_TIMEOUT)
    return isolation.behind_fence(replace(program, words=tuple(words)), shown, spec.hidden)


_LONGEST_LINE = 300  # characters


@dataclass(frozen=True)
class Description:
    """One installed method, imported and asked, or the reason why it could not be.

    Attributes:
        method: Its package metadata.
        conditions: Conditions that it can be given, of those of its benchmark.
        fitted: It learns from a table (``fit``), so a run fits it by itself when it is given no weights.
        max_frames: Longest motion that it generates, in frames; None if there is no limit.
        native_fps: Rate of its motions in frames per second; None if it takes any.
        motionless: Its motions stand still.
        weights: Files or folders that it brings, over all its conditions.
        error: Reason in one line; empty if there is none.
    """

    method: InstalledEntry
    conditions: tuple[str, ...] = ()
    fitted: bool = False
    max_frames: int | None = None
    native_fps: float | None = None
    motionless: bool = False
    weights: tuple[str, ...] = ()
    error: str = ""


def describe_adapters(names: Iterable[str] | None = None, *, benchmark: str = PROTOCOL_NAME) -> list[Description]:
    """Import the installed methods and say what each declares; one that cannot be imported costs one line.

    Args:
        names: Names of methods; None for all.
        benchmark: Whose methods are meant.

    Returns:
        One description a method, in the order of :func:`~prbench.harness.methods.installed.list_adapters`.
    """
    group = group_of(benchmark)
    installed = list_adapters(group.entry_points)
    wanted = None if names is None else frozenset(names)
    twice = offered_twice(installed)
    found = []
    for method in installed:
        if wanted is not None and method.name not in wanted:
            continue
        if method.problem or method.name in twice:
            found.append(Description(method, error=method.problem or "another package offers the same name"))
            continue
        try:
            # What a package prints while it is imported is no part of the list.
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                adapter = load_adapter(method.name, None, {}, "cpu", group=group)
                declared = motions.Declared.by(adapter, origin="it", conditions=group.conditions)
                weights_for = getattr(adapter, "weights_for", None)
                paths = [weights_for(each) for each in sorted(declared.conditions)] if weights_for is not None else []
        except PrbenchError as error:
            origin = f"adapter '{method.name}' (package {method.package} {method.version}, {method.target}): "
            line = " ".join(str(error).removeprefix(origin).rstrip(".").split())
            shown = line if len(line) <= _LONGEST_LINE else line[: _LONGEST_LINE - 2] + " …"
            found.append(Description(method, error=shown))
            continue
        description = Description(
            method,
            conditions=tuple(sorted(condition.value for condition in declared.conditions)),
            fitted=hasattr(adapter, "fit"),
            **{name: getattr(declared, name) for name in ("max_frames", "native_fps", "motionless")},
            weights=tuple(sorted({Path(path).name for path in paths if path is not None})),
        )
        found.append(description)
    return found
