"""``prbench adapters``: the installed methods, from metadata alone; beside it ``new``, ``check`` and ``converters``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, Group, command, note
from prbench.cli.options import ALL_CONDITIONS, SECONDS, benchmark_option, out_file_option, out_folder_option
from prbench.cli.terminal import print_columns

if TYPE_CHECKING:
    from prbench.harness.methods.describe import Description
    from prbench.harness.methods.installed import InstalledAdapter
    from prbench.protocol.benchmarks import AboutBenchmark

_CONVERTERS = Path("prbench_converters.py")

adapters = Group(
    "adapters",
    sections={
        "commands": {
            "list": "prbench.cli.adapters:list_methods",
            "new": "prbench.cli.adapters:new",
            "check": "prbench.cli.adapters_check:check",
            "converters": "prbench.cli.adapters:converters",
        }
    },
    example="prbench adapters list",
    help="List the installed methods, start a new one, check one.",
)


class MethodDetails(msgspec.Struct, frozen=True, kw_only=True):
    """The declarations of a method, found by importing it in a process of its own.

    Attributes:
        conditions: Conditions that it can be given, of those of its benchmark.
        trains: ``prbench train``, ``by the run`` or ``no``: where its network is trained.
        max_frames: Longest motion that it generates, in frames; null if there is no limit.
        native_fps: Rate of its motions in frames per second; null if it takes any.
        motionless: Whether its motions stand still.
        weights: Files or folders of weights that it brings.
        import_seconds: Seconds that importing its module took; null if it was not imported.
        load_seconds: Seconds that ``load()`` took after that; null if it was not loaded.
        printed_bytes: Bytes that it wrote to standard output and error meanwhile.
        error: Why it cannot be used, in one line; empty if it can.
    """

    conditions: list[str]
    trains: str
    max_frames: int | None
    native_fps: float | None
    motionless: bool
    weights: list[str]
    import_seconds: float | None
    load_seconds: float | None
    printed_bytes: int
    error: str


class InstalledMethod(msgspec.Struct, frozen=True, kw_only=True):
    """One installed method.

    Attributes:
        name: What ``--method`` is given.
        package: Package that offers it.
        version: Version of the package.
        target: Where its ``load`` stands: ``module:callable``.
        problem: What keeps it from being used, as far as the package's metadata tell; empty if nothing does.
        details: What it declares, with ``--details``; else null.
    """

    name: str
    package: str
    version: str
    target: str
    problem: str
    details: MethodDetails | None


class ControlMethod(msgspec.Struct, frozen=True, kw_only=True):
    """One control: motions that tell what a score is worth.

    Attributes:
        use: The option that asks for it: ``--method`` or ``--control``.
        name: The value of that option.
        summary: What it does.
    """

    use: str
    name: str
    summary: str


class MethodsReport(msgspec.Struct, frozen=True, kw_only=True):
    """The installed methods.

    Attributes:
        methods: One entry for each, by name.
        controls: Controls, which are part of prbench, with ``--details`` of all methods; else empty.
    """

    methods: list[InstalledMethod]
    controls: list[ControlMethod]


class NewMethodReport(msgspec.Struct, frozen=True, kw_only=True):
    """The files of a new method.

    Attributes:
        folder: The new folder.
        files: The files in it, relative to the folder, sorted.
        next_steps: Commands to try, in order.
    """

    folder: Path
    files: list[Path]
    next_steps: list[str]


class ConvertersReport(msgspec.Struct, frozen=True, kw_only=True):
    """The converters as one file.

    Attributes:
        out: The file.
        imports: The line by which a program imports from it.
    """

    out: Path
    imports: str


@command("list", example="prbench adapters list --details", report=MethodsReport, writes_report=True)
@click.argument("names", nargs=-1, metavar="[NAME...]")
@click.option(
    "--details",
    is_flag=True,
    help="Import each in a process of its own and show its conditions, whether it trains, its limits and weights, or"
    " its error.",
)
@click.option("--timeout", type=SECONDS, default=30, metavar="SECONDS", help="Time limit of each import (default 30).")
@benchmark_option
def list_methods(names: tuple[str, ...], details: bool, timeout: float, benchmark: str | None) -> Answer:
    """List the installed methods with their packages, without importing any of them.

    With NAME only these methods are listed.
    """
    from prbench.harness.methods.installed import list_adapters, no_such_method
    from prbench.protocol.benchmarks import default_benchmark, find_benchmark

    about = find_benchmark(benchmark or default_benchmark().name)
    found = list_adapters(about.entry_points)
    known = {adapter.name for adapter in found}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise no_such_method(unknown[0], known)
    if details:
        return _detailed(names, found, about, time_limit=timeout)
    shown = [_installed(adapter, found) for adapter in found if not names or adapter.name in names]
    return Answer(MethodsReport(methods=shown, controls=[]), lambda: _print_methods(shown))


@command("new", example="prbench adapters new glide --condition goal-loc", report=NewMethodReport)
@click.argument("name")
@out_folder_option("New folder (default: ./prbench-NAME, or ./NAME for a program).")
@click.option(
    "--condition",
    "conditions",
    type=click.Choice(ALL_CONDITIONS),
    multiple=True,
    help="What the method is given (default goal-loc; motion-prediction pose); repeatable.",
)
@click.option("--trainable", is_flag=True, help="Write fit(), too: a method that learns from a table.")
@click.option(
    "--program",
    is_flag=True,
    help="Write a program of its own instead of a package: one plain Python file and a TOML file.",
)
@benchmark_option
def new(
    name: str,
    out: Path | None,
    conditions: tuple[str, ...],
    trainable: bool,
    program: bool,
    benchmark: str | None,
) -> Answer:
    """Write a complete package with a new method that works at once, for you to change.

    NAME is that of the method, such as glide: what --method will be given.
    """
    from prbench.checking.scaffold import ScaffoldRequest, new_adapter
    from prbench.protocol.benchmarks import default_benchmark

    request = ScaffoldRequest(
        name=name,
        conditions=conditions,
        out=out,
        trainable=trainable,
        program=program,
        benchmark=benchmark or default_benchmark().name,
    )
    made = new_adapter(request)
    for warning in made.warnings:
        note(f"prbench: {warning}")
    report = NewMethodReport(folder=made.folder, files=list(made.files), next_steps=list(made.next_steps))
    return Answer(report, lambda: _print_new(report))


@command("converters", example="prbench adapters converters --out glide/prbench_converters.py", report=ConvertersReport)
@out_file_option(f"The file, beside the program (default ./{_CONVERTERS}).")
def converters(out: Path | None) -> Answer:
    """Write the converters as one file for a program: NumPy only, Python 3.8 or later."""
    from prbench.checking.scaffold.one_file import write_converters

    path = out or _CONVERTERS
    write_converters(path)
    report = ConvertersReport(out=path, imports=f"from {path.stem} import motions_from_features, placed_on")
    return Answer(report, lambda: print(f"{report.out}: {report.imports}"))


def _installed(
    adapter: InstalledAdapter, found: Sequence[InstalledAdapter], details: MethodDetails | None = None
) -> InstalledMethod:
    return InstalledMethod(
        name=adapter.name,
        package=adapter.package,
        version=adapter.version,
        target=adapter.target,
        problem=_problem(adapter, found),
        details=details,
    )


def _problem(adapter: InstalledAdapter, found: Sequence[InstalledAdapter]) -> str:
    """Say what keeps a method from being used, as far as metadata tell."""
    from prbench.harness.methods.installed import offered_twice

    if adapter.problem:
        return adapter.problem
    return "offered more than once: uninstall all but one" if adapter.name in offered_twice(found) else ""


def _print_methods(methods: Sequence[InstalledMethod]) -> None:
    rows = []
    for method in methods:
        remark = f"! {method.problem}" if method.problem else ""
        rows.append((method.name, method.package, method.version, method.target, remark))
    print_columns(("name", "package", "version", "target", ""), rows)


def _detailed(
    names: Sequence[str], found: Sequence[InstalledAdapter], about: AboutBenchmark, *, time_limit: float
) -> Answer:
    """Import the methods, each in a process of its own, and answer with what they declare or why they cannot be used.

    Args:
        names: Of methods; empty for all, and then the controls are listed, too.
        found: All installed methods of the benchmark.
        about: The benchmark.
        time_limit: Seconds for each.
    """
    from prbench.harness.methods.describe import describe_adapters
    from prbench.training.installed import list_tasks

    tasks = list_tasks()
    described = describe_adapters(names or None, benchmark=about.name, time_limit=time_limit)
    methods = [_installed(one.method, found, _details(one, tasks)) for one in described]
    report = MethodsReport(methods=methods, controls=_controls() if about.default and not names else [])
    return Answer(report, lambda: _print_details(report))


def _details(one: Description, tasks: Sequence[str]) -> MethodDetails:
    return MethodDetails(
        conditions=list(one.conditions),
        trains=_trains(one, tasks),
        max_frames=one.max_frames,
        native_fps=one.native_fps,
        motionless=one.motionless,
        weights=list(one.weights),
        import_seconds=one.import_seconds,
        load_seconds=one.load_seconds,
        printed_bytes=one.printed,
        error=one.error,
    )


def _trains(description: Description, tasks: Sequence[str]) -> str:
    if description.method.name in tasks and description.method.package == "prbench":
        return "prbench train"
    return "by the run" if description.fitted else "no"


def _controls() -> list[ControlMethod]:
    from prbench.harness.controls import CONTROLS

    return [ControlMethod(use=control.use, name=control.name, summary=control.summary) for control in CONTROLS]


def _print_details(report: MethodsReport) -> None:
    rows = []
    problems = []
    for method in report.methods:
        assert method.details is not None
        if method.details.error:
            problems.append(f"! {method.name} ({method.package} {method.version}): {method.details.error}")
        else:
            rows.append(_details_row(method, method.details))
    print_columns(("name", "package", "conditions", "trains", "frames", "rate", "weights", "import + load"), rows)
    for problem in problems:
        print(problem)
    if report.controls:
        print("\ncontrols, part of prbench:")
        print_columns(("", ""), [(f"{control.use} {control.name}", control.summary) for control in report.controls])


def _details_row(method: InstalledMethod, details: MethodDetails) -> tuple[str, ...]:
    return (
        method.name,
        f"{method.package} {method.version}",
        ", ".join(details.conditions),
        details.trains,
        f"<= {details.max_frames}" if details.max_frames else "any",
        f"{details.native_fps:g}/s" if details.native_fps else "any",
        ", ".join(details.weights) or "none",
        f"{details.import_seconds or 0:.1f} + {details.load_seconds or 0:.1f} s",
    )


def _print_new(report: NewMethodReport) -> None:
    print(f"{report.folder}: {len(report.files)} files. Next:")
    for step in report.next_steps:
        print(f"  {step}")
