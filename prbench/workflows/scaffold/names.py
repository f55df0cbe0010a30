"""The name of a new method, and every other name that follows from it."""

from __future__ import annotations

import builtins
import re
import sys
from dataclasses import dataclass

from prbench.errors import UsageError
from prbench.methods.installed import list_adapters
from prbench.methods.names import BUILT_IN_METHODS, name_problem

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_LONGEST = 40
_OURS = frozenset({"adapters", "benchmarks", "data-manifests"})  # prbench_NAME is a package of prbench itself
_MODULES = frozenset({"numpy", "pyarrow", "prbench_converters"})  # beside a program, or imported by it
_WORDS = frozenset({"cmd", "test", "tests"})
_WINDOWS = frozenset({"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))})
_IN_TEMPLATES = frozenset(
    {"Adapter", "Condition", "ConditionBatch", "Joint", "Mapping", "Motions", "Path", "SequenceTable", "TrainingRun"}
)


@dataclass(frozen=True)
class MethodNames:
    """What a method and its package are called."""

    method: str
    """What ``--method`` is given."""

    @property
    def distribution(self) -> str:
        """What pip installs."""
        return f"prbench-{self.method}"

    @property
    def module(self) -> str:
        """What Python imports."""
        return self.distribution.replace("-", "_")

    @property
    def class_name(self) -> str:
        """Of the adapter."""
        name = "".join(part.capitalize() for part in self.method.split("-"))
        taken = hasattr(builtins, name) or name in _IN_TEMPLATES
        return f"{name}Method" if taken else name

    @property
    def program(self) -> str:
        """File name of the program, without its suffix; it must not hide a module that the program imports."""
        name = self.method.replace("-", "_")
        return f"{name}_method" if name in _MODULES or name in sys.stdlib_module_names else name


def method_names(name: str) -> MethodNames:
    """The names that follow from that of a method.

    Raises:
        UsageError: if it is no name for a package, or belongs to prbench; it says which name would do.
    """
    proposal = re.sub(r"[-_.\s]+", "-", name.strip()).strip("-").lower()
    shortened = proposal.removeprefix("prbench-")
    if shortened != proposal and _NAME.fullmatch(shortened):
        raise UsageError(f"{name!r}: the package is called prbench-NAME by itself. Give '{shortened}'.")
    if not _NAME.fullmatch(name):
        hint = f" Would '{proposal}' do?" if _NAME.fullmatch(proposal) else ""
        raise UsageError(
            f"{name!r}: expected the name of a method in small letters and digits, its words joined by hyphens,"
            f" beginning with a letter.{hint}"
        )
    if len(name) > _LONGEST:
        raise UsageError(f"{name!r}: expected at most {_LONGEST} characters, found {len(name)}.")
    _refuse_reserved(name)
    return MethodNames(name)


def _refuse_reserved(name: str) -> None:
    """Refuse names that could never be used.

    Raises:
        UsageError: naming who has it.
    """
    if name in _OURS | _WORDS | _WINDOWS:
        raise UsageError(f"{name!r} is a reserved name. Choose another.")
    if problem := name_problem(name):
        hint = f", such as 'my-{name}'" if name in BUILT_IN_METHODS else ""
        raise UsageError(f"{problem}. Choose another{hint}.")


def taken_by(names: MethodNames) -> str | None:
    """A warning if an installed package offers a method of this name already, else None."""
    for adapter in list_adapters():
        if adapter.name == names.method:
            return (
                f"the installed package {adapter.package} {adapter.version} offers a method '{names.method}' already;"
                f" uninstall it before you install yours, or neither can be used."
            )
    return None
