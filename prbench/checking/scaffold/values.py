"""The names of a new method and its package, and the values with which they fill the templates.

Templates have two marks: ``<<name>>`` is replaced, ``%if`` … ``%else`` … ``%end`` keeps or drops whole lines.
"""

from __future__ import annotations

import builtins
import re
import sys
import textwrap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files

import prbench
from prbench.contract import GIVEN, Condition
from prbench.errors import UsageError
from prbench.harness.methods.installed import name_problem
from prbench.protocol.manifests import benchmarks, default_benchmark

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_LONGEST = 40
_OURS = frozenset({"adapters", "benchmarks", "data-manifests"})  # prbench_NAME is a package of prbench itself
_MODULES = frozenset({"numpy", "pyarrow", "prbench_converters"})  # beside a program, or imported by it
_WORDS = frozenset({"cmd", "test", "tests"})
_WINDOWS = frozenset({"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))})
_IN_TEMPLATES = frozenset(
    {
        *("Adapter", "Condition", "ConditionBatch", "Futures", "Joint", "Mapping", "Motions", "ObservedBatch", "Path"),
        *("SequenceTable", "TrainingRun", "TrainingWindows"),
    }
)
_PACKAGE = "prbench.checking.scaffold.templates"
_MARK = re.compile(r"<<(\w+)>>")
_ROW_FIELDS = {
    "text": 'text=("The person walks to the table and picks the cup.",),',
    "initial_joints": "initial_joints=POSE,",
    "previous_joints": "previous_joints=POSE,",
    "goal_joints": "goal_joints=POSE + (0.0, 0.0, 3.0),",
    "goal_location": "goal_location=np.array([[0.5, 1.0, 3.0]]),",
}
_LEARNS = "It learns one number, how fast people walk: a run fits it to the training split by itself."
_NEVER = "Never unpickle: safetensors, or `numpy.load(path, allow_pickle=False)`."
_OWN_WEIGHTS = (
    "The template's weights are one number in `speed.json`, which `fit` writes; `--weights speed.json` uses it again,"
    " and `weights_for` names it, so that run.json records its digest. A real model writes its own files in its place."
)
_NO_WEIGHTS = (
    "This template has none and says so. A model reads its own on first use, from the path in `--weights` or from files"
    " in its package (`importlib.resources`), and names them in a method `weights_for(condition) -> Path | None`, so"
    " that run.json records their digest."
)


@dataclass(frozen=True)
class MethodNames:
    """The names of a method and its package."""

    method: str
    """The name that ``--method`` is given."""

    @property
    def distribution(self) -> str:
        """Name of the distribution that pip installs."""
        return f"prbench-{self.method}"

    @property
    def module(self) -> str:
        """Name of the package that Python imports."""
        return self.distribution.replace("-", "_")

    @property
    def class_name(self) -> str:
        """Name of the adapter's class."""
        name = "".join(part.capitalize() for part in self.method.split("-"))
        # A method called `map` or `path` would otherwise hide what the template itself uses.
        taken = hasattr(builtins, name) or name in _IN_TEMPLATES
        return f"{name}Method" if taken else name

    @property
    def program(self) -> str:
        """File name of the program, without its suffix; it must not hide a module that the program imports."""
        name = self.method.replace("-", "_")
        # Python puts a script's folder first on its path: a program numpy.py would import itself.
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
    if name in _OURS | _WORDS | _WINDOWS:
        raise UsageError(f"{name!r} is a reserved name. Choose another.")
    own = {method for about in benchmarks().values() for method in about.methods}
    if problem := name_problem(name, own=own):
        hint = f", such as 'my-{name}'" if name in own else ""
        raise UsageError(f"{problem}. Choose another{hint}.")
    return MethodNames(name)


def read_template(name: str) -> str:
    """The text of ``NAME.template``."""
    return files(_PACKAGE).joinpath(f"{name}.template").read_text(encoding="utf-8")


def filled(template: str, values: Mapping[str, str], flags: Collection[str]) -> str:
    """A template with its values put in and the lines kept whose conditions hold; an empty value leaves no empty line.

    Args:
        template: Lines; ``%if a and not b`` begins a part that is kept if flag ``a`` is set and ``b`` is not. Parts do
            not nest.
        values: What stands for each ``<<name>>``.
        flags: Those that are set.
    """
    kept = []
    keep = True
    for line in template.splitlines():
        word, _, condition = line.partition(" ")
        if word == "%if":
            keep = all(_holds(term.split(), flags) for term in condition.split(" and "))
        elif word == "%else":
            keep = not keep
        elif word == "%end":
            keep = True
        elif keep:
            text = _MARK.sub(lambda mark: values[mark[1]], line)
            # A line that held a value only, and the value is empty, goes; an empty line of the template stays.
            kept += [text] if text or not line else []
    return "\n".join(kept) + "\n"


def _holds(term: list[str], flags: Collection[str]) -> bool:
    return (term[-1] in flags) != (term[0] == "not")


def template_flags(conditions: Sequence[str], *, trainable: bool) -> frozenset[str]:
    """Return the names of the templates' optional parts that are kept.

    ``goal`` and ``free`` tell whether the method takes conditions with a first pose and a goal, and without.
    """
    chosen = [Condition(name) for name in conditions]
    given = frozenset[str]().union(*(GIVEN[condition] for condition in chosen))
    flags = {"trainable"} if trainable else set()
    flags |= given & {"text", "goal_location"}
    flags |= {"goal_pose"} if "goal_joints" in given else set()
    flags |= {"goal"} if "initial_joints" in given else set()
    flags |= {"free"} if any("initial_joints" not in GIVEN[condition] for condition in chosen) else set()
    return frozenset(flags)


def common_values(names: MethodNames, conditions: Sequence[StrEnum], does: str) -> dict[str, str]:
    """The text for the places that templates of all benchmarks have."""
    return {
        "name": names.method,
        "distribution": names.distribution,
        "module": names.module,
        "class": names.class_name,
        "program": names.program,
        "prbench_version": prbench.__version__.partition("+")[0],
        "condition": conditions[0].value,
        "conditions": ", ".join(f"Condition.{condition.name}" for condition in conditions),
        "condition_words": ", ".join(f'"{condition.value}"' for condition in conditions),
        "what": f"{does[0].upper()}{does[1:]}.",
        "does": does,
    }


def template_values(
    names: MethodNames, conditions: Sequence[str], *, trainable: bool, program: bool = False
) -> dict[str, str]:
    """The text for every place in the templates."""
    chosen = list(dict.fromkeys(Condition(name) for name in conditions))
    does = _does("goal" in template_flags(conditions, trainable=trainable))
    return common_values(names, chosen, does) | {
        "described": f"The motion generator '{names.method}' for the prime-and-reach benchmark prbench.",
        "entry_points": default_benchmark().entry_points,
        "run": f"prbench run --method {names.program}.toml --condition {chosen[0].value}",
        "learns": _LEARNS if trainable else "It has learnt nothing and has no weights.",
        "weights": textwrap.fill(f"**Weights.** {_OWN_WEIGHTS if trainable else _NO_WEIGHTS} {_NEVER}", 120),
        "commands": aligned(command_lines(names, chosen[0].value, program=program)),
        "row_fields": "\n".join(f"        {_ROW_FIELDS[name]}" for name in _ROW_FIELDS if name in GIVEN[chosen[0]]),
        "standing": _standing_rows(),
    }


def command_lines(names: MethodNames, condition: str, *, program: bool) -> list[tuple[str, str]]:
    """The commands to try in the new folder, in order, each with what it is for."""
    method = f"{names.program}.toml" if program else names.method
    return [
        *first_commands(program=program),
        (f"prbench adapters check {method}", "the contract, with a report to read"),
        (f"prbench run --method {method} --condition {condition}", "scores, on embedded synthetic data"),
    ]


def first_commands(*, program: bool) -> list[tuple[str, str]]:
    """The commands before prbench is asked anything."""
    if program:
        return [("pip install numpy pyarrow", "for the `python` that runs the program")]
    return [
        ('pip install -e ".[test]"', "install; prbench finds it by its entry point"),
        ("python -m pytest", "the contract, and what this method promises itself"),
    ]


def aligned(lines: Sequence[tuple[str, str]]) -> str:
    """Return commands as text, what each is for one below the other."""
    width = max(len(command) for command, _ in lines)
    return "\n".join(f"{command:<{width}}  # {comment}" for command, comment in lines)


def _does(goal: bool) -> str:
    if goal:
        return "glides the first pose towards the goal, in a straight line"
    return "glides a standing pose two metres ahead"


def _standing_rows() -> str:
    """The rows of the standing pose, as the package's own file has them."""
    return "\n".join(line for line in read_template("standing.py").splitlines() if line.startswith("        ["))
