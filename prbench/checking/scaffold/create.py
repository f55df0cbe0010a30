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
    template_flags,
    template_values,
)
from prbench.contract import Condition
from prbench.errors import StorageError, UsageError
from prbench.files.storage import atomic_folder, sole_writer
from prbench.harness.methods.installed import list_adapters
from prbench.protocol.manifests import default_benchmark, find_benchmark

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
        # An empty folder may be replaced, for example a fresh clone, but not the current one; a link may lead anywhere.
        empty = folder.is_dir() and not folder.is_symlink() and not any(folder.iterdir())
        if os.path.lexists(folder) and (not empty or folder.resolve() == Path.cwd()):
            raise StorageError(f"{folder}: exists already; nothing was written. Name a new folder with --out DIR.")
        contents = _contents(names, request)
        with atomic_folder(folder) as temporary:
            for path, text in contents.items():
                target = temporary / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(text, encoding="utf-8", newline="\n")
    warnings = [
        f"the installed package {adapter.package} {adapter.version} offers a method '{names.method}' already; uninstall"
        " it before you install yours, or neither can be used."
        for adapter in list_adapters(find_benchmark(request.benchmark).entry_points)
        if adapter.name == names.method and not request.program
    ]
    lines = predictors.commands if request.benchmark == predictors.BENCHMARK else command_lines
    commands = [command for command, _ in lines(names, request.conditions[0], program=request.program)]
    return ScaffoldReport(
        folder,
        files=tuple(sorted(map(Path, contents))),
        next_steps=(f"cd {shlex.quote(str(folder))}", *commands),
        warnings=tuple(warnings[:1]),
    )


def _contents(names: MethodNames, request: ScaffoldRequest) -> dict[str, str]:
    """Return path and text of every file of an installable package, or of a program of its own.

    Raises:
        UsageError: if a program should also be trainable.
    """
    chosen = {"trainable": request.trainable}
    if request.benchmark == predictors.BENCHMARK:
        own, method = "predictor_", "predictor.py"
        values = predictors.values(names, request.conditions, **chosen, program=request.program)
        flags = predictors.flags(request.conditions, **chosen)
    else:
        own, method = "", "adapter.py"
        values = template_values(names, request.conditions, **chosen, program=request.program)
        flags = template_flags(request.conditions, **chosen)
    source = f"src/{names.module}"
    more = {f"{source}/py.typed": ""}
    templates = {
        "pyproject.toml": "pyproject.toml",
        "README.md": f"{own}README.md",
        ".gitignore": "gitignore",
        ".github/workflows/test.yml": "workflow.yml",
        f"{source}/__init__.py": f"{own}init.py",
        f"{source}/{method}": method,
        "tests/test_conformance.py": f"{own}test_conformance.py",
        "tests/test_method.py": f"{own}test_method.py",
    }
    if request.program:
        if request.trainable:
            raise UsageError(
                "--trainable --program: a program is not fitted by a run. Train it yourself and give it the result with"
                " --weights, or write a package."
            )
        more = {} if own else {ONE_FILE: converters_file()}
        templates = {
            "README.md": f"{own}program_README.md",
            f"{names.program}.py": f"{own}program.py",
            f"{names.program}.toml": "method.toml",
        }
    elif "free" in flags:
        templates[f"{source}/standing.py"] = "standing.py"
    return {path: filled(read_template(name), values, flags) for path, name in templates.items()} | more
