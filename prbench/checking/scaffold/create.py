"""Write the package, or the program, of a new method: complete, and working before anything is changed."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass
from pathlib import Path

from prbench.checking.scaffold import predictors
from prbench.checking.scaffold.one_file import ONE_FILE, converters_file
from prbench.checking.scaffold.values import (
    MethodNames,
    command_lines,
    filled,
    method_names,
    read_template,
    taken_by,
    template_flags,
    template_values,
)
from prbench.contract import Condition
from prbench.errors import StorageError, UsageError
from prbench.files.locks import sole_writer
from prbench.files.storage import atomic_folder
from prbench.protocol.benchmarks import default_benchmark, find_benchmark

_USUAL = {default_benchmark().name: Condition.GOAL_LOCATION.value, predictors.BENCHMARK: "pose"}
"""The condition of a new method of which nothing is said, by benchmark."""


@dataclass(frozen=True)
class ScaffoldRequest:
    """The method that is to be written."""

    name: str
    """Name of the method."""
    conditions: tuple[str, ...] = ()
    """Conditions that it takes; none for the benchmark's usual one."""
    out: Path | None = None
    """The new folder; None for one in the current folder, named after the package or the program."""
    trainable: bool = False
    program: bool = False
    """A program of its own instead of an installable package."""
    benchmark: str = default_benchmark().name
    """The benchmark that it is a method of: the default one, or motion-prediction."""

    def __post_init__(self) -> None:
        if self.benchmark not in _USUAL:
            raise UsageError(
                f"--benchmark {self.benchmark}: expected one with templates, which are {', '.join(_USUAL)}."
            )
        known = find_benchmark(self.benchmark).conditions
        unknown = [name for name in self.conditions if name not in known]
        if unknown:
            raise UsageError(
                f"--condition {unknown[0]}: expected one of the benchmark {self.benchmark}: {', '.join(known)}."
            )
        if not self.conditions:
            object.__setattr__(self, "conditions", (_USUAL[self.benchmark],))


@dataclass(frozen=True)
class ScaffoldReport:
    """The files that were written."""

    folder: Path
    """The new folder."""
    files: tuple[Path, ...]
    """Relative to the folder, sorted."""
    next_steps: tuple[str, ...]
    """Commands to try, in order."""
    warnings: tuple[str, ...]
    """What may keep the method from being used."""


def new_adapter(request: ScaffoldRequest) -> ScaffoldReport:
    """Write a new method's folder, whole or not at all.

    Raises:
        UsageError: if the name cannot be used, or the choices do not go together.
        StorageError: if the folder exists and holds something, or cannot be written.
    """
    names = method_names(request.name)
    folder = request.out or Path(names.method if request.program else names.distribution)
    # Whole or not at all: a half-written package would install and fail later.
    with sole_writer(folder):
        _require_new(folder)
        contents = _program(names, request) if request.program else _package(names, request)
        with atomic_folder(folder) as temporary:
            for path, text in contents.items():
                target = temporary / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(text, encoding="utf-8", newline="\n")
    warning = None if request.program else taken_by(names, request.benchmark)
    return ScaffoldReport(
        folder,
        files=tuple(sorted(map(Path, contents))),
        next_steps=_next_steps(names, request, folder),
        warnings=() if warning is None else (warning,),
    )


def _require_new(folder: Path) -> None:
    """Refuse a folder that holds something, and the current one, which cannot be replaced by a finished one.

    Raises:
        StorageError: if it is there.
    """
    # An empty folder may be replaced, for example a fresh clone; a link may lead anywhere.
    empty = folder.is_dir() and not folder.is_symlink() and not any(folder.iterdir())
    if os.path.lexists(folder) and (not empty or folder.resolve() == Path.cwd()):
        raise StorageError(f"{folder}: exists already; nothing was written. Name a new folder with --out DIR.")


def _next_steps(names: MethodNames, request: ScaffoldRequest, folder: Path) -> tuple[str, ...]:
    lines = predictors.commands if request.benchmark == predictors.BENCHMARK else command_lines
    commands = lines(names, request.conditions[0], program=request.program)
    return (f"cd {shlex.quote(str(folder))}", *(command for command, _ in commands))


def _package(names: MethodNames, request: ScaffoldRequest) -> dict[str, str]:
    """Path and text of every file of an installable package."""
    if request.benchmark == predictors.BENCHMARK:
        return _filled(predictors.package_templates(names), names, request) | {f"src/{names.module}/py.typed": ""}
    source = f"src/{names.module}"
    templates = {
        "pyproject.toml": "pyproject.toml",
        "README.md": "README.md",
        ".gitignore": "gitignore",
        ".github/workflows/test.yml": "workflow.yml",
        f"{source}/__init__.py": "init.py",
        f"{source}/adapter.py": "adapter.py",
        "tests/test_conformance.py": "test_conformance.py",
        "tests/test_method.py": "test_method.py",
    }
    if "free" in template_flags(request.conditions, trainable=request.trainable):
        templates[f"{source}/standing.py"] = "standing.py"
    return _filled(templates, names, request) | {f"{source}/py.typed": ""}


def _program(names: MethodNames, request: ScaffoldRequest) -> dict[str, str]:
    """Path and text of every file of a program of its own.

    Raises:
        UsageError: if it should also be trainable.
    """
    if request.trainable:
        raise UsageError(
            "--trainable --program: a program is not fitted by a run. Train it yourself and give it the result with"
            " --weights, or write a package."
        )
    if request.benchmark == predictors.BENCHMARK:
        return _filled(predictors.program_templates(names), names, request)
    templates = {
        "README.md": "program_README.md",
        f"{names.program}.py": "program.py",
        f"{names.program}.toml": "method.toml",
    }
    return _filled(templates, names, request) | {ONE_FILE: converters_file()}


def _filled(templates: dict[str, str], names: MethodNames, request: ScaffoldRequest) -> dict[str, str]:
    chosen = {"trainable": request.trainable}
    if request.benchmark == predictors.BENCHMARK:
        values = predictors.values(names, request.conditions, **chosen, program=request.program)
        flags = predictors.flags(request.conditions, **chosen)
    else:
        values = template_values(names, request.conditions, **chosen, program=request.program)
        flags = template_flags(request.conditions, **chosen)
    return {path: filled(read_template(name), values, flags) for path, name in templates.items()}
