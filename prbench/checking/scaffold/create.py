"""Create the folder of a new method or dataset from templates: names, texts, and the first commands to try."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from pathlib import Path

import prbench
from prbench.checking.scaffold.one_file import ONE_FILE, converters_file
from prbench.contract import GIVEN, Condition
from prbench.datasets import dataset_name_problem, own_datasets, readable_datasets
from prbench.errors import StorageError, UsageError
from prbench.files.bounded import read_text
from prbench.files.storage import atomic_folder, sole_writer
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.installed import name_problem
from prbench.protocol.manifests import benchmarks, default_benchmark, find_benchmark

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_LONGEST = 40
_RESERVED = frozenset(
    {
        *("adapters", "benchmarks", "data-manifests"),  # prbench_NAME is a package of prbench itself
        *("cmd", "test", "tests"),
        *("con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))),  # Windows
    }
)
_MODULES = frozenset({"numpy", "pyarrow", "prbench_converters"})  # beside a program, or imported by it
_PACKAGE = "prbench.checking.scaffold.templates"
_MARK = re.compile(r"<<(\w+)>>")
_PREDICTION = "motion-prediction"
PROGRAM = "program"
# By what a model puts out, whose block of docs/wrapping.md is written: how to give the new package its made-up weights.
MADE_UP_WEIGHTS = {
    "joints22": "--weights weights/model.pt",
    "hml263": "--weights weights",
    "smplx": "--weights weights --option smplx_model=weights/SMPLX_NEUTRAL.npz",
}
# Condition of a new method for which none is chosen, by benchmark
_USUAL = {default_benchmark().name: Condition.GOAL_LOCATION.value, _PREDICTION: "pose"}
_ROW_FIELDS = {
    "text": 'text=("The person walks to the table and picks the cup.",),',
    "initial_joints": "initial_joints=POSE,",
    "previous_joints": "previous_joints=POSE,",
    "goal_joints": "goal_joints=POSE + (0.0, 0.0, 3.0),",
    "goal_location": "goal_location=np.array([[0.5, 1.0, 3.0]]),",
}


@dataclass(frozen=True)
class MethodNames:
    """The names of a method, or of a dataset, and its package.

    Attributes:
        method: The name that ``--method``, or `prbench build-dataset`, is given.
    """

    method: str

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
        """Name of the adapter's class; its last word keeps a method called `map` from hiding what its file needs."""
        return "".join(part.capitalize() for part in self.method.split("-")) + "Method"

    @property
    def program(self) -> str:
        """File name of the program, without its suffix; it must not hide a module that the program imports."""
        name = self.method.replace("-", "_")
        # Python puts a script's folder first on its path: a program numpy.py would import itself.
        return f"{name}_method" if name in _MODULES or name in sys.stdlib_module_names else name


def method_names(name: str, *, of: str = "method") -> MethodNames:
    """Return the names that follow from that of a method, or of a dataset.

    Raises:
        UsageError: if it is no name for a package, or belongs to prbench; it says which name would do.
    """
    proposal = re.sub(r"[-_.\s]+", "-", name.strip()).strip("-").lower()
    shortened = proposal.removeprefix("prbench-")
    if shortened != proposal and _NAME.fullmatch(shortened):
        raise UsageError(f"{name!r}: the package is called prbench-NAME by itself. Give '{shortened}'.")
    if not _NAME.fullmatch(name):
        hint = f" Would '{proposal}' do?" if _NAME.fullmatch(proposal) else ""
        expected = f"expected the name of a {of} in small letters and digits, its words joined by hyphens"
        raise UsageError(f"{name!r}: {expected}, beginning with a letter.{hint}")
    if len(name) > _LONGEST:
        raise UsageError(f"{name!r}: expected at most {_LONGEST} characters, found {len(name)}.")
    if name in _RESERVED:
        raise UsageError(f"{name!r} is a reserved name. Choose another.")
    own = {method for about in benchmarks().values() for method in about.methods}
    if problem := name_problem(name, own=own):
        hint = f", such as 'my-{name}'" if name in own else ""
        raise UsageError(f"{problem}. Choose another{hint}.")
    return MethodNames(name)


def read_template(name: str) -> str:
    """Return the text of ``NAME.template``."""
    return files(_PACKAGE).joinpath(f"{name}.template").read_text(encoding="utf-8")


def filled(template: str, values: Mapping[str, str], flags: Collection[str]) -> str:
    """Fill in the values of a template and keep the lines whose conditions hold; an empty value leaves no empty line.

    Args:
        template: Lines; ``%if a and not b`` begins a part that is kept if flag ``a`` is set and ``b`` is not. Parts do
            not nest.
        values: Text for each ``<<name>>``.
        flags: Names of the flags that are set.
    """
    kept = []
    keep = True
    for line in template.splitlines():
        word, _, condition = line.partition(" ")
        if word == "%if":
            terms = [term.split() for term in condition.split(" and ")]
            keep = all((term[-1] in flags) != (term[0] == "not") for term in terms)
        elif word == "%else":
            keep = not keep
        elif word == "%end":
            keep = True
        elif keep:
            text = _MARK.sub(lambda mark: values[mark[1]], line)
            # A line that held a value only, and the value is empty, goes; an empty line of the template stays.
            kept += [text] if text or not line else []
    return "\n".join(kept) + "\n"


@dataclass(frozen=True)
class ScaffoldRequest:
    """The method that is to be written.

    Attributes:
        name: Name of the method.
        conditions: Conditions that it takes; none for the benchmark's usual one.
        out: The new folder; None for one in the current folder, named after the package or the program.
        source: What it is made from: an output of :data:`MADE_UP_WEIGHTS`, or :data:`PROGRAM` for a program of its own
            instead of an installable package; None for a package that needs no weights.
        benchmark: The benchmark that it is a method of: the default one, or motion-prediction.
    """

    name: str
    conditions: tuple[str, ...] = ()
    out: Path | None = None
    trainable: bool = False
    source: str | None = None
    benchmark: str = default_benchmark().name

    def __post_init__(self) -> None:
        if self.benchmark not in _USUAL:
            known = ", ".join(_USUAL)
            raise UsageError(f"--benchmark {self.benchmark}: expected one with templates, which are {known}.")
        conditions = find_benchmark(self.benchmark).conditions
        if unknown := [name for name in self.conditions if name not in conditions]:
            known = ", ".join(conditions)
            raise UsageError(f"--condition {unknown[0]}: expected one of the benchmark {self.benchmark}: {known}.")
        if self.source and self.trainable:
            kind = "a program" if self.program else "a model that brings its weights"
            remedy = "Train it yourself and give it the result with --weights, or leave one of the options away."
            raise UsageError(f"--trainable --from {self.source}: {kind} is not fitted by a run. {remedy}")
        if not self.conditions:
            object.__setattr__(self, "conditions", (_USUAL[self.benchmark],))
        if self.source in MADE_UP_WEIGHTS and self.benchmark == _PREDICTION:
            known = f"expected {PROGRAM}, or no --from, for the benchmark {_PREDICTION}"
            raise UsageError(f"--from {self.source}: {known}.")
        if self.source in MADE_UP_WEIGHTS and (len(self.chosen) > 1 or Condition.NONE in self.chosen):
            expected = f"expected one --condition, {Condition.TEXT}, {Condition.GOAL_LOCATION} or {Condition.GOAL_POSE}"
            remedy = "Take one, and add others in `generate` of the new adapter.py."
            raise UsageError(f"--from {self.source}: {expected}, found {', '.join(self.chosen)}. {remedy}")

    @property
    def program(self) -> bool:
        """Says whether it becomes a program of its own."""
        return self.source == PROGRAM

    @property
    def chosen(self) -> list[StrEnum]:
        """Its conditions, each once and in the given order."""
        own = Condition if self.benchmark != _PREDICTION else load_benchmark(_PREDICTION).condition
        return list(dict.fromkeys(own(name) for name in self.conditions))


@dataclass(frozen=True)
class ScaffoldReport:
    """The files that were written.

    Attributes:
        folder: The new folder.
        files: Relative to the folder, sorted.
        next_steps: Commands to try, in order.
    """

    folder: Path
    files: tuple[Path, ...]
    next_steps: tuple[str, ...]


def new_adapter(request: ScaffoldRequest) -> ScaffoldReport:
    """Write a new method's folder, whole or not at all.

    Raises:
        UsageError: if the name cannot be used, or the choices do not go together.
        StorageError: if the folder exists and holds something, or cannot be written.
    """
    names = method_names(request.name)
    folder = request.out or Path(names.method if request.program else names.distribution)
    return _written(folder, _contents(names, request), command_lines(names, request))


def new_dataset(name: str, out: Path | None = None) -> ScaffoldReport:
    """Write the folder of a new dataset: manifest, reader, example recordings and tests, whole or not at all.

    Args:
        name: Name of the dataset; NAME-tracked becomes that of the same recordings without annotated events.
        out: The new folder; None for one in the current folder, named after the package.

    Raises:
        UsageError: if the name cannot be used.
        StorageError: if the folder exists and holds something, or cannot be written.
    """
    names = method_names(name, of="dataset")
    if problem := dataset_name_problem(name, known=(*own_datasets(), *readable_datasets())):
        raise UsageError(f"{problem}.")
    values = {"name": name, "distribution": names.distribution, "module": names.module}
    made = {f"src/{names.module}/__init__.py": "", ".gitignore": read_template("gitignore")}
    templates = Path(__file__).with_name("dataset")  # as the package will stand, but for two names
    for template in templates.rglob("*.template"):
        path = template.relative_to(templates).with_suffix("").as_posix().replace("MODULE", names.module)
        made[path.replace("NAME", name)] = filled(read_text(template), values, ())
    commands = (
        *('pip install -e ".[test]"', "python -m pytest", "python make_example.py example"),
        f"prbench datasets check {name} --root example",
        f"prbench build-dataset {name} --root example --out tables/{name}",
    )
    return _written(out or Path(names.distribution), made, commands)


def _written(folder: Path, contents: Mapping[str, str], commands: Iterable[str]) -> ScaffoldReport:
    """Write a new folder, whole or not at all: a half-written package would install and fail later."""
    with sole_writer(folder):
        # An empty folder may be replaced, for example a fresh clone, but not the current one; a link may lead anywhere.
        empty = folder.is_dir() and not folder.is_symlink() and not any(folder.iterdir())
        if os.path.lexists(folder) and (not empty or folder.resolve() == Path.cwd()):
            raise StorageError(f"{folder}: exists already; nothing was written. Name a new folder with --out DIR.")
        with atomic_folder(folder) as temporary:
            for path, text in contents.items():
                target = temporary / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(text, encoding="utf-8", newline="\n")
    return ScaffoldReport(folder, tuple(sorted(map(Path, contents))), (f"cd {shlex.quote(str(folder))}", *commands))


def command_lines(names: MethodNames, request: ScaffoldRequest) -> dict[str, str]:
    """Return the commands to try in the new folder, in order, each with its purpose."""
    method = f"{names.program}.toml" if request.program else names.method
    condition = request.chosen[0].value
    lines = {
        'pip install -e ".[test]"': "install; prbench finds it by its entry point",
        "python -m pytest": "the contract, and what this method promises itself",
    }
    if request.program:
        lines = {"pip install numpy pyarrow": "for the `python` that runs the program"}
    if request.source in MADE_UP_WEIGHTS:
        lines["python make_weights.py weights"] = "made-up weights, until yours are there"
        method = f"{method} {MADE_UP_WEIGHTS[request.source]}"
    if request.benchmark != _PREDICTION:
        return lines | {
            f"prbench adapters check {method}": "the contract, with a report to read",
            f"prbench run --method {method} --condition {condition}": "scores, on embedded synthetic data",
        }
    return lines | {
        f"prbench adapters check {method} --benchmark {_PREDICTION}": "the contract, with a report to read",
        "prbench synthesize adt --table --out adt": "synthetic people, if you have no recordings",
        "prbench build-windows --data adt --out windows": "windows up to their primes and events",
        f"prbench run --benchmark {_PREDICTION} --method {method} --condition {condition} --data windows": "scores",
    }


def template_flags(request: ScaffoldRequest) -> frozenset[str]:
    """Return the names of the templates' optional parts that are kept.

    ``goal`` and ``free`` tell whether the method takes conditions with a first pose and a goal, and without; ``gaze``
    whether a predictor takes gaze; ``made_up`` whether there are made-up weights.
    """
    flags = {"trainable"} if request.trainable else set()
    if request.source in MADE_UP_WEIGHTS:
        flags |= {"made_up", request.source}
    if request.benchmark == _PREDICTION:
        return frozenset(flags | ({"gaze"} if set(request.conditions) - {"pose"} else set()))
    givens = [GIVEN[Condition(name)] for name in request.conditions]
    given = frozenset[str]().union(*givens)
    flags |= given & {"text", "goal_location"}
    flags |= {"goal_pose"} if "goal_joints" in given else set()
    flags |= {"goal"} if "initial_joints" in given else set()
    flags |= {"free"} if any("initial_joints" not in each for each in givens) else set()
    return frozenset(flags)


def template_values(names: MethodNames, request: ScaffoldRequest) -> dict[str, str]:
    """Return the text for every place in the templates."""
    chosen = request.chosen
    first = chosen[0].value
    lines = command_lines(names, request)
    width = max(map(len, lines))
    run = f"prbench run --method {names.program}.toml --condition {first}"
    described = f"The motion generator '{names.method}' for the prime-and-reach benchmark prbench."
    if request.benchmark == _PREDICTION:
        run = f"prbench run --benchmark {_PREDICTION} --method {names.program}.toml --condition {first} --data WINDOWS"
        described = f"The predictor '{names.method}' for the motion prediction benchmark of prbench."
    given = GIVEN[chosen[0]] if isinstance(chosen[0], Condition) else ()
    return {
        "name": names.method,
        "distribution": names.distribution,
        "module": names.module,
        "class": names.class_name,
        "model": f"{names.module}.model",
        "goal": "goal_joints" if first == Condition.GOAL_POSE else "goal_location",
        "goal_shape": "(22, 3)" if first == Condition.GOAL_POSE else "(3,)",
        "program": names.program,
        "prbench_version": prbench.__version__.partition("+")[0],
        "condition": first,
        "conditions": ", ".join(f"Condition.{condition.name}" for condition in chosen),
        "condition_words": ", ".join(f'"{condition.value}"' for condition in chosen),
        "described": described,
        "entry_points": find_benchmark(request.benchmark).entry_points,
        "run": run,
        "commands": "\n".join(f"{command:<{width}}  # {comment}" for command, comment in lines.items()),
        "row_fields": "\n".join(f"        {line}" for name, line in _ROW_FIELDS.items() if name in given),
        # The rows of the standing pose, as the package's own file has them.
        "standing": "\n".join(line for line in read_template("standing.py").splitlines() if line[:9] == "        ["),
    }


def _contents(names: MethodNames, request: ScaffoldRequest) -> dict[str, str]:
    """Return path and text of every file of an installable package, or of a program of its own."""
    own = "predictor_" if request.benchmark == _PREDICTION else ""
    method = "predictor.py" if own else "adapter.py"
    flags = template_flags(request)
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
        more = {} if own else {ONE_FILE: converters_file()}
        templates = {
            "README.md": f"{own}program_README.md",
            f"{names.program}.py": f"{own}program.py",
            f"{names.program}.toml": "method.toml",
        }
    elif request.source is not None:
        del templates["tests/test_method.py"]
        templates |= {
            "README.md": "from_README.md",
            "make_weights.py": "from_make_weights.py",
            f"{source}/{method}": f"from_{request.source}.py",
            f"{source}/model.py": "from_model.py",
            f"{source}/standing.py": "standing.py",
            "tests/test_conformance.py": "from_test_conformance.py",
        }
    elif "free" in flags:
        templates[f"{source}/standing.py"] = "standing.py"
    values = template_values(names, request)
    return {path: filled(read_template(name), values, flags) for path, name in templates.items()} | more
