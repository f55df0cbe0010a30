"""What a word behind ``--method`` is; methods found in package metadata or a Python file; who may use which name.

The one rule for names: prbench's own belong to prbench, and all others have a form that can be shown. A package, a
program, a file of motions and a run folder in a leaderboard are asked the same question by :func:`name_problem`. Names
are compared without case and punctuation, so that ``Ground_Truth`` passes for nothing.
"""

from __future__ import annotations

import ast
import contextlib
import importlib.util
import re
import sys
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from prbench.entry_points import ADAPTERS, PREDICTORS, InstalledEntry, installed_entries
from prbench.errors import AdapterError, PrbenchError, did_you_mean
from prbench.files.bounded import read_whole
from prbench.files.storage import file_digest
from prbench.limits import HARMLESS_SIZE
from prbench.protocol.manifests import benchmark_of_group, default_benchmark
from prbench.shown import quoted

GROUND_TRUTH = "ground-truth"
GROUND_TRUTH_RESAMPLED = "ground-truth-resampled"
GROUND_TRUTH_20_FPS = "ground-truth-20fps"
GROUND_TRUTH_30_FPS = "ground-truth-30fps"
SCRIPTED = "scripted"
SWAY = "sway"
NEAREST_NEIGHBOUR = "nearest-neighbour"
SHUFFLED_GOAL = "shuffled-goal"

# Motions that earn scores without doing what these are meant to reward (docs/audit.md)
CHEATS = (
    *("stare", "stare-late", "tremor", "teleport", "float"),
    *("heel-skater", "hover", "long-arms", "doll", "nodder", "stepper", SWAY),
)
# Controls that ``--method`` takes
METHOD_CONTROLS = (
    *(GROUND_TRUTH, GROUND_TRUTH_RESAMPLED, GROUND_TRUTH_20_FPS, GROUND_TRUTH_30_FPS),
    *(SCRIPTED, *CHEATS, NEAREST_NEIGHBOUR),
)
# Methods of the default benchmark that come with prbench, installed or not
BUILT_IN_METHODS = default_benchmark().methods

# Words that mean something else in commands and tables.
_WORDS = ("all", "prbench", "shuffled", "t2m-evaluator", "motion-tokens", "tm2t")
_LONGEST = 100
_FORM = re.compile(r"[A-Za-z0-9]([A-Za-z0-9 ._+()-]*[A-Za-z0-9.+)])?")
# Form of a name, in words. Other alphabets hold letters that look like these and are not.
NAME_FORM = f"1 to {_LONGEST} characters of A to Z, a to z, 0 to 9, space and . _ + - ( ), first a letter or a digit"


def has_form(name: object) -> bool:
    """Return True where a name has the form that every method's name has, prbench's own too."""
    return isinstance(name, str) and len(name) <= _LONGEST and _FORM.fullmatch(name) is not None


def name_problem(name: object, *, own: Collection[str] = ()) -> str | None:
    """Say what is wrong with the name that a package, a program or a file gives its method.

    Args:
        name: The name that was given.
        own: Further methods of prbench itself: those of the benchmark in question.

    Returns:
        A clause without a full stop, or None if the name can be used.
    """
    if not has_form(name):
        return f"expected a name of {NAME_FORM}, found {quoted(repr(name))}"
    owner = (_OWNERS | {_bare(each): _OWN_METHOD for each in own}).get(_bare(str(name)))
    return None if owner is None else f"'{name}' is {owner}; only prbench itself may use this name"


def _bare(name: str) -> str:
    """Return a name as a quick reader takes it in: small letters and digits."""
    return re.sub(r"[^a-z0-9]", "", name.casefold())


_OWN_METHOD = "a method of prbench itself"
_OWNERS = {
    **{_bare(name): "a reserved word of prbench" for name in _WORDS},
    **{_bare(name): _OWN_METHOD for name in BUILT_IN_METHODS},
    **{_bare(name): "a control of prbench" for name in (*METHOD_CONTROLS, SHUFFLED_GOAL)},
}


PREFIX = "cmd:"
_SUFFIX = ".toml"
_PYTHON = ".py"
_LONGEST_COMMAND = 60  # characters of a command in messages


def without_folders(word: str) -> str:
    """Cut an absolute path, also behind ``--key=``, to its last part; return any other word as it is."""
    key, equals, value = word.partition("=")
    if equals and key.startswith("-"):
        return f"{key}={without_folders(value)}"
    for kind in (PurePosixPath, PureWindowsPath):
        if kind(word).is_absolute() or word.startswith(("~/", "~\\")):
            return kind(word).name or word
    return word


def is_command(method: str) -> bool:
    """Return True for a command, such as ``cmd:python glide.py``."""
    return method.startswith(PREFIX)


def is_description(method: str) -> bool:
    """Return True for the path of a description, such as ``glide.toml``."""
    return not is_command(method) and method.lower().endswith(_SUFFIX)


def is_program(method: str) -> bool:
    """Return True for a program of its own, False for the name of an installed adapter or of a control."""
    return is_command(method) or is_description(method)


def short_name(method: str) -> str:
    """Return the name that a method has before it has introduced itself; never a path."""
    if is_command(method):
        words = [without_folders(word.strip("\"'")) for word in method.removeprefix(PREFIX).split()]
        return textwrap.shorten(" ".join(words), _LONGEST_COMMAND, placeholder=" …") or "nothing"
    file, _, name = method.rpartition(":")
    if name.isidentifier() and file.lower().endswith(_PYTHON):
        method = file
    return Path(method).stem if is_description(method) or method.lower().endswith(_PYTHON) else method


def list_adapters(entry_points: str = ADAPTERS) -> list[InstalledEntry]:
    """Return all installed methods by name, without importing any; those that cannot be used say why.

    Args:
        entry_points: Entry-point group, which is that of one benchmark.
    """
    own = benchmark_of_group(entry_points).methods
    found = set()
    for entry in installed_entries(entry_points):
        name = entry.name or "unknown"
        if entry.built_in and name in own:
            found.add(entry)
            continue
        problem = entry.problem or name_problem(name, own=own) or ""
        # A name that cannot be shown safely is quoted, so that a list stays readable.
        found.add(replace(entry, name=name if has_form(name) else quoted(name), problem=problem, built_in=False))
    return sorted(found)


def offered_twice(adapters: Iterable[InstalledEntry]) -> frozenset[str]:
    """Return names that several packages offer; such a name cannot be used until all but one are uninstalled."""
    names = [adapter.name for adapter in adapters if not adapter.problem]
    return frozenset(name for name in names if names.count(name) > 1)


def packages_of(names: Collection[str], entry_points: str = ADAPTERS) -> tuple[str, ...]:
    """Return the distributions that offer some methods, without prbench itself.

    Args:
        names: Names of methods; those that are not installed are passed over.
        entry_points: See :func:`list_adapters`.
    """
    installed = list_adapters(entry_points)
    return tuple(each.package for each in installed if each.name in names and not (each.built_in or each.problem))


def entry_points_of(group: str) -> Iterator[EntryPoint]:
    """Yield the readable entry points of a group, but none whose name belongs to prbench."""
    for entry in installed_entries(group):
        if entry.name and entry.target and (entry.built_in or name_problem(entry.name) is None):
            yield EntryPoint(entry.name, entry.target, group)


def no_such_method(name: str, known: Iterable[str]) -> AdapterError:
    """Return the error for an unknown method: it names the nearest known one, or how a program is given."""
    hint = did_you_mean(name, known) or " A program is given as 'cmd:COMMAND', or as a .toml file that holds it."
    return AdapterError(f"adapter '{name}' is not installed.{hint} `prbench adapters list` shows all of them.")


_LOAD = "load"
_FILE = re.compile(r"(?P<path>.+\.py)(?::(?P<name>[A-Za-z_]\w*))?", re.IGNORECASE)
_SHOWN_DIGEST = 12


def is_python_method(method: str) -> bool:
    """Return True for an existing Python file, with or without ``:NAME``."""
    found = _FILE.fullmatch(method)
    return found is not None and Path(found["path"]).expanduser().is_file()


def _source(method: str) -> tuple[Path, str]:
    """File and name of the function."""
    found = _FILE.fullmatch(method)
    assert found is not None
    return Path(found["path"]).expanduser().absolute(), found["name"] or _LOAD


def find_python_method(method: str) -> InstalledEntry:
    """Return what is known of a method in a Python file without importing it.

    Args:
        method: Text behind ``--method``: path of a Python file, with or without ``:NAME``.

    Raises:
        AdapterError: if the file is no Python, or has no such function.
    """
    path, name = _source(method)
    try:
        body = ast.parse(read_whole(path, largest=HARMLESS_SIZE)).body
    except (SyntaxError, ValueError) as error:
        raise AdapterError(f"{path}: expected Python, found: {error}.") from error
    names = set()
    for statement in body:
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            names.add(statement.name)
        elif isinstance(statement, ast.Assign):
            names |= {target.id for target in statement.targets if isinstance(target, ast.Name)}
        elif isinstance(statement, ast.Import | ast.ImportFrom):
            names |= {alias.asname or alias.name for alias in statement.names}
    if name not in names:
        problem = f"expected a function '{name}(weights, *, options, device)' that makes the method,"
        found = f"found none in this file. A program is given by its command, as 'cmd:python {path.name}'."
        raise AdapterError(f"{path}: {problem} {found}")
    return InstalledEntry(method, path.name, file_digest(path)[:_SHOWN_DIGEST], f"{path}:{name}")


def import_python_method(method: str) -> Callable[..., Any]:
    """Import the function that makes such a method; what its file imports from beside itself is found, as for a script.

    Args:
        method: Text behind ``--method``: path of a Python file, with or without ``:NAME``.
    """
    path, function = _source(method)
    name = f"prbench_method_{path.stem}_{file_digest(path)[:_SHOWN_DIGEST]}"
    if name in sys.modules:
        return getattr(sys.modules[name], function)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Before it runs: data classes look themselves up here.
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return getattr(module, function)


ENTRY_POINT_GROUP = "prbench.training_tasks"
# The callable without arguments that makes the task of a method, in the module of the method's ``load``
_BESIDE_THE_METHOD = "training_task"

_DEFINITION = re.compile(rf"^(?:def )?{_BESIDE_THE_METHOD}\b", re.MULTILINE)


def _tasks() -> list[EntryPoint]:
    """Return the entry points of all tasks; a task that stands beside a method gets one, as if it were declared."""
    found = list(entry_points_of(ENTRY_POINT_GROUP))
    named = {point.name for point in found}
    for method in (*entry_points_of(ADAPTERS), *entry_points_of(PREDICTORS)):
        module = method.value.partition(":")[0].strip()
        # The source is read, because a module may be broken; no such module, no source, no text: no task.
        with contextlib.suppress(ImportError, ValueError, OSError):
            spec = importlib.util.find_spec(module)
            source = Path(spec.origin).read_text(encoding="utf-8") if spec is not None and spec.origin else ""
            if method.name not in named and _DEFINITION.search(source):
                found.append(EntryPoint(method.name, f"{module}:{_BESIDE_THE_METHOD}", ENTRY_POINT_GROUP))
    return found


def list_tasks() -> tuple[str, ...]:
    """Return the names of all installed tasks, without importing any of them."""
    return tuple(sorted({point.name for point in _tasks()}))


def load_task(name: str) -> Any:
    """Import a task: what has a name, configurations and ``build``, as the training loop expects it.

    Raises:
        AdapterError: if there is none of this name (with those that there are), two packages offer it, or it cannot be
            imported.
    """
    found = [point for point in _tasks() if point.name == name]
    if len({point.value for point in found}) > 1:
        offers = ", ".join(point.value for point in found)
        raise AdapterError(f"training task '{name}' is offered more than once: {offers}. Uninstall all but one.")
    if not found:
        known = list_tasks()
        hint = did_you_mean(name, known)
        if any(method.name == name for method in list_adapters()):
            hint = f" The method '{name}' is not trained by this command;"
            hint += " if it learns, `prbench run` fits it by itself."
        raise AdapterError(f"nothing to train is called '{name}'.{hint} There are: {', '.join(known) or 'none'}.")
    point = found[0]
    origin = f"training task '{name}' ({point.value})"
    try:
        task = point.load()()
    except PrbenchError:
        raise
    except (Exception, SystemExit) as error:
        cause = f"{type(error).__name__}: {error}".rstrip(".")
        raise AdapterError(f"{origin}: cannot be loaded: {cause}. Repair or reinstall the package.") from error
    missing = [part for part in ("name", "configurations", "build") if not hasattr(task, part)]
    if missing:
        raise AdapterError(f"{origin}: expected name, configurations and build(), found no {', '.join(missing)}.")
    return task
