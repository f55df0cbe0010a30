"""``prbench adapters``: list the installed methods, start a new one, check one; ``prbench doctor``: judge motions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from prbench.cli import options as opt
from prbench.cli.commands import Answer, Group, command, note, progress
from prbench.cli.terminal import print_columns
from prbench.entry_points import InstalledEntry
from prbench.errors import UsageError
from prbench.protocol.manifests import default_benchmark, find_benchmark
from prbench.shown import clean

if TYPE_CHECKING:
    from prbench.checking.conformance import Report
    from prbench.checking.examine_file import DoctorReport
    from prbench.checking.scaffold.create import ScaffoldReport
    from prbench.harness.methods.loading import Description


_HELP = "List the installed methods, start a new one, check one."
_COMMANDS = {"list": f"{__name__}:list_methods", "new": f"{__name__}:new", "check": f"{__name__}:check"}
adapters = Group("adapters", sections={"commands": _COMMANDS}, example="prbench adapters list", help=_HELP)
_CONVERTERS = "List nothing, but write the converters as one file for a program, such as prbench_converters.py"
_CONVERTERS += ": NumPy only, Python 3.8 or later."
_LISTED = {"": [InstalledEntry], "--details": ["prbench.harness.methods.loading:Description"]}


@command("list", example="prbench adapters list --details", report=_LISTED)
@click.argument("names", nargs=-1, metavar="[NAME...]")
@opt.flag("--details", "Import each and show its conditions, whether it trains, its limits and weights, or its error.")
@click.option("--converters", type=opt.OUT_FILE, metavar="FILE", help=_CONVERTERS)
@opt.benchmark_option
def list_methods(names: tuple[str, ...], details: bool, converters: Path | None, benchmark: str | None) -> Answer:
    """List the installed methods with their packages, without importing any of them.

    With NAME only these methods are listed.
    """
    if converters is not None:
        from prbench.checking.scaffold.one_file import write_converters

        write_converters(converters)
        line = f"{converters}: from {converters.stem} import motions_from_features, placed_on"
        return Answer([], lambda: print(line))
    from prbench.harness.methods.installed import list_adapters, no_such_method, offered_twice

    about = find_benchmark(benchmark or default_benchmark().name)
    found = list_adapters(about.entry_points)
    twice = offered_twice(found)
    known = {adapter.name for adapter in found}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise no_such_method(unknown[0], known)
    problem = "offered more than once: uninstall all but one"
    methods = [adapter for adapter in found if not names or adapter.name in names]
    methods = [replace(each, problem=problem) if each.name in twice else each for each in methods]
    if not details:
        rows = []
        for each in methods:
            remark = f"! {each.problem}" if each.problem else ""
            rows.append((each.name, each.package, each.version, each.target, remark))
        return Answer(methods, lambda: print_columns(("name", "package", "version", "target", ""), rows))
    from prbench.harness.methods.loading import describe_adapters

    described = describe_adapters(names or None, benchmark=about.name)
    return Answer(described, lambda: _print_details(described, with_controls=about.default and not names))


def _print_details(described: list[Description], *, with_controls: bool) -> None:
    from prbench.harness.controls import CONTROLS
    from prbench.harness.methods.installed import list_tasks

    tasks = list_tasks()
    rows = []
    problems = []
    for each in described:
        method = each.method
        if each.error:
            problems.append(f"! {method.name} ({method.package} {method.version}): {each.error}")
            continue
        trains = "by the run" if each.fitted else "no"
        if method.name in tasks and method.package == "prbench":
            trains = "prbench train"
        frames = f"<= {each.max_frames}" if each.max_frames else "any"
        rate = f"{each.native_fps:g}/s" if each.native_fps else "any"
        about = (method.name, f"{method.package} {method.version}", ", ".join(each.conditions), trains)
        rows.append((*about, frames, rate, ", ".join(each.weights) or "none"))
    print_columns(("name", "package", "conditions", "trains", "frames", "rate", "weights"), rows)
    for problem in problems:
        print(problem)
    if with_controls:
        print("\ncontrols, part of prbench:")
        print_columns(("", ""), [(f"{control.use} {control.name}", control.summary) for control in CONTROLS])


_EXAMPLE = "prbench adapters new glide --condition goal-loc"
_GIVEN = f"What the method is given: {opt.conditions_by_benchmark()} (default goal-loc; of motion-prediction pose)"
_SOURCES = ("joints22", "hml263", "smplx", "program")
_FROM = "Write the block of docs/wrapping.md for a model of 22 joints, 263 features or SMPL-X parameters, with made-up"
_FROM += " weights; or a program of its own instead of a package: one plain Python file and a TOML file."
_CONDITION = {"type": click.Choice(opt.ALL_CONDITIONS), "metavar": "CONDITION", "multiple": True}


@command("new", example=_EXAMPLE, report="prbench.checking.scaffold.create:ScaffoldReport")
@click.argument("name")
@opt.out_folder_option("New folder (default: ./prbench-NAME, or ./NAME for a program).")
@click.option("--condition", "conditions", **_CONDITION, help=f"{_GIVEN}; repeatable.")
@opt.flag("--trainable", "Write fit(), too: a method that learns from a table.")
@click.option("--from", "source", type=click.Choice(_SOURCES), help=_FROM)
@click.option("--program", is_flag=True, hidden=True)
@opt.benchmark_option
def new(*, benchmark: str | None, program: bool, source: str | None, **given: Any) -> Answer:
    """Write a complete package with a new method that works at once, for you to change.

    NAME is that of the method, such as glide: what --method will be given.
    """
    from prbench.checking.scaffold import ScaffoldRequest, new_adapter

    if program:
        note("--program goes in prbench 0.13.0; use --from program.")
        if source not in (None, "program"):
            raise UsageError(f"--program --from {source}: expected one of them.")
        source = "program"
    given["source"] = source
    return scaffold_answer(new_adapter(ScaffoldRequest(benchmark=benchmark or default_benchmark().name, **given)))


def scaffold_answer(made: ScaffoldReport) -> Answer:
    """Return a new package with the commands to try in it."""

    def show() -> None:
        print(f"{made.folder}: {len(made.files)} files. Next:")
        for step in made.next_steps:
            print(f"  {step}")

    return Answer(made, show)


_OUTCOMES = ("passed", "skipped", "warning", "failed")
_FAILED = 5  # as for every other breach of the adapter contract


def _limit_option(name: str, field: str, default: int, of: str) -> Callable:
    help = f"Time limit of {of} (default {default})."
    return opt.option(name, field, help, type=opt.SECONDS, default=default, metavar="SECONDS")


@command("check", example="prbench adapters check static", report="prbench.checking.conformance.findings:Report")
@click.argument("method")
@opt.benchmark_option
@opt.path_option("--data", "Ask about 12 test cases of this table (default: synthetic people).", metavar="DIR")
@opt.method_settings
@_limit_option("--timeout", "time_limit", 600, "each call of the method")
@_limit_option("--start-timeout", "start_limit", 120, "importing an installed method, and of loading it")
@opt.flag("--isolate", "Run an installed method in a process of its own.")
def check(*, method: str, benchmark: str | None, **given: Any) -> Answer:
    """Check that a method keeps the contract, and say what to change where it does not.

    METHOD is an installed method, cmd:'python glide.py', or a .toml file that describes a program.
    """
    from prbench.checking import conformance

    request = conformance.CheckRequest(method, benchmark=benchmark or default_benchmark().name, **given)
    with progress(f"checking {method}") as show:
        found = conformance.check(request, lambda name, place, total: show(place, total, name))
    return Answer(found, lambda: print_report(found), _FAILED if found.failed else 0)


def print_report(report: Report) -> None:
    """Print a line a finding, and one for all checks that wait for the same one."""
    waiting: dict[str, list[str]] = {}
    for finding in report.findings:
        if finding.outcome.value == "skipped" and " before " in finding.said:
            waiting.setdefault(finding.said, []).append(finding.check)
            continue
        # Behind a log the remedy has a line of its own.
        between = "\n    " if "\n" in finding.said else " "
        sentences = f"{finding.said}{between}{finding.remedy}".strip()
        print(f"{finding.outcome.value:<8} {finding.check:<16} {clean(sentences, keep=chr(10))}")
    for reason, names in waiting.items():
        print(f"skipped  {reason} {len(names)}: {', '.join(names)}.")
    found = Counter(finding.outcome.value for finding in report.findings)
    counts = ", ".join(f"{found[outcome]} {outcome}" for outcome in _OUTCOMES)
    verdict = "does not keep the contract" if report.failed else "keeps the contract"
    print(f"{report.method} {verdict}: {counts}; {report.seconds:.1f} s.")


@command("doctor", example="prbench doctor motions.npy", report="prbench.checking.examine_file:DoctorReport")
@click.argument("motions", type=opt.PATH, metavar="FILE")
@opt.data_option(required=False, help="Built dataset folder(s): compare with their initial poses and lengths.")
@opt.path_option("--conditions", "Compare with this file of `prbench export-conditions`.")
@opt.seed_option("behind the opaque ids, with --data")
@click.option("--fps", type=opt.RATE, metavar="F", help="Rate of the motions (default: that asked for, else 20).")
def doctor(*, motions: Path, **given: Any) -> Answer:
    """Say what is wrong with motions (unit, axes, order of joints, place, clock …), from the numbers.

    FILE is .npy, .npz or Parquet of any shape, a folder of motions/*.npy, or a run folder. The exit code is 1 where a
    fault is certain.
    """
    from prbench.checking.examine_file import DoctorRequest, examine_file

    report = examine_file(DoctorRequest(path=motions, **given))
    return Answer(report, lambda: _print(report), int(report.certain))


def _print(report: DoctorReport) -> None:
    some = f"{report.examined} of {report.total}" if report.examined < report.total else f"{report.total}"
    compared = f", {report.compared} compared with what was asked for" if report.compared else ""
    print(f"{report.path}: {some} motion(s), {', '.join(report.shapes)}, at {report.fps:g} frames a second{compared}")
    for diagnosis in report.diagnoses:
        print(f"\n{'wrong' if diagnosis.certain else 'suspicious'}: {diagnosis.kind}")
        print(f"  evidence  {diagnosis.evidence}")
        print(f"  cause     {diagnosis.cause}")
        print(f"  remedy    {diagnosis.remedy}")
    if not report.diagnoses:
        print("nothing found; docs/doctor.md says what numbers cannot tell")
