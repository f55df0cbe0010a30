"""``prbench run``: methods over tables, scored.

A method of another package runs in a child process: if the method ends that process, the exit code is right all the
same.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, note, progress, session
from prbench.cli.summaries import RunAnswer, run_answer
from prbench.engine import Engine, end_with_parent
from prbench.engine.choice import Cluster, EngineChoice
from prbench.entry_points import ADAPTERS, STUDY_ITEMS, load_built_in
from prbench.errors import AdapterError, UsageError
from prbench.protocol.manifests import default_benchmark, find_benchmark

if TYPE_CHECKING:
    from minisign import SecretKey

    from prbench.engine.shards import Shard
    from prbench.harness.request import Experiment, Progress, RunRequest
    from prbench.harness.run import RunReport
    from prbench.harness.run_folder import RunFolder

# Every method, or every condition: the rows of Table 2.
ALL = "all"


_FIRST_RUN_WORKERS = 2
PASSWORD_VARIABLE = "PRBENCH_SIGN_PASSWORD"


_METHOD = "An installed method; a program: 'cmd:python glide.py', or a .toml file that describes one; or a control:"
_METHOD += " ground-truth, scripted, nearest-neighbour, stare, … (docs/audit.md); all: the rows of the study's"
_METHOD += " Table 2."
_CONDITION = f"What the method is given (default: the only condition that it takes): {opt.conditions_by_benchmark()};"
_CONDITION += " all: every row that Table 2 has of it."
_CONFIG = "An experiment's TOML file (docs/experiments.md); --data, --out and the like replace what it says. Or a run"
_CONFIG += " folder: the run is repeated."
_SPLIT = "Split of the table (default test); published: that of a study of motion prediction."
_FOLDS = "Test on people whom the method did not learn from: participant: on everybody in turn, merged into one run;"
_FOLDS += " or on one fold of N, such as 2/6. {fold} in --weights stands for K."
_PROTOCOL = "the numbers of the metrics, stamped into the run; the table must have been built by the same rules."
_SAMPLES = f"Answers to each case: motions a sequence, futures a window (default {opt.usual_number('samples')})."
_ISOLATE = "Run the method in a process that is given neither paths, objects nor environment; with bubblewrap (Linux)"
_ISOLATE += " the file system is withheld too."
_REQUIRE_FENCE = "--isolate, and refuse to run where neither bubblewrap nor a container withholds the file system."
_SIGN = "Sign the finished run with this secret key of minisign (docs/firewall.md#signed-runs); its password is asked"
_SIGN += f" for, or taken from {PASSWORD_VARIABLE}."
_TIMEOUT = "For each batch, of a program or with --isolate (default 600); a program that is late is stopped."
_ENGINE = "Processes to use (default 1; without --data and with all: 2; with --engine ray all processors); changes"
_ENGINE += " no result."


@command(
    "run",
    example="prbench run --method static --condition none --data tables/adt --out runs/static",
    report=RunAnswer,
    resumes=True,
    first=(
        *("--method", "--condition", "--config", "--data", "--out", "--split", "--limit", "--sequence", "--view"),
        *("--weights", "--option", "--seed", "--workers", "--json"),
    ),
)
@opt.benchmark_option
@click.option("--method", metavar="NAME|cmd:…|FILE", shell_complete=opt.complete_method, help=_METHOD)
@click.option("--condition", type=click.Choice([*opt.ALL_CONDITIONS, ALL]), metavar="CONDITION", help=_CONDITION)
@opt.path_option("--config", _CONFIG)
@opt.flag("--show-config", "Print the experiment that the command line means, and stop.")
@opt.data_option(required=False, help="Built dataset folder(s), or a folder of such (default: small synthetic ones).")
@opt.out_folder_option("Run folder (default: one under ./runs); resumes. Several runs: the folder of their folders.")
@opt.split_option(help=_SPLIT, more=(opt.PUBLISHED,))
@click.option("--folds", "--fold", "fold", metavar="participant|K/N", help=_FOLDS)
@opt.limit_option(f"all; {opt.FIRST_RUN_SEQUENCES} without --data; with all: 5 of each dataset")
@opt.sequence_option("Run this one only")
@click.option("--view", type=opt.OUT_FILE, metavar="FILE", help="Show the motions: .html, .png, .svg, .pdf or .mp4.")
@opt.flag("--with-controls", "With all: the cheats of docs/audit.md and nearest-neighbour, too.")
@opt.protocol_option(_PROTOCOL)
@opt.permission_option
@opt.method_settings
@opt.control_option("Give every sequence another one's goal.")
@opt.seed_option("of the run")
@opt.number_option("--samples", _SAMPLES)
@opt.number_option("--batch-size", f"Cases a batch (default {opt.usual_number('batch_size')}).")
@opt.flag("--isolate", _ISOLATE)
@opt.flag("--require-fence", _REQUIRE_FENCE)
@click.option("--sign", type=opt.LOCAL_PATH, metavar="KEY", help=_SIGN)
@click.option("--timeout", type=opt.SECONDS, metavar="SECONDS", help=_TIMEOUT)
@opt.engine_options(help=_ENGINE)
@opt.shard_option("the batches")
@opt.scores_options
def run(
    config: Path | None,
    show_config: bool,
    view: Path | None,
    permission: tuple[str, ...],
    engine: EngineChoice,
    shard: str | None,
    require_fence: bool,
    sign: Path | None,
    **given: Any,
) -> Answer | int:
    """Run a method over tables and score what it generates.

    Without --data, five embedded synthetic datasets are used. The same command goes on with an interrupted run.
    With --benchmark motion-prediction, --data names tables of `prbench build-windows`.
    """
    of_table_two = ALL in (given["method"], given["condition"])
    # Conditions of another benchmark are refused, and what only the default one has: embedded tables and Table 2. A
    # file may name the benchmark; then the experiment is asked.
    own = default_benchmark()
    about = find_benchmark(given["benchmark"] or own.name)
    if config is None and given["condition"] not in (None, ALL, *about.conditions):
        known = ", ".join(about.conditions)
        raise UsageError(f"--condition {given['condition']}: expected one of the benchmark {about.name}: {known}.")
    if not about.default and of_table_two:
        raise UsageError(f"--method all: makes the rows of the study's Table 2, and belongs to {own.name}.")
    if not about.default and not given["data"]:
        raise UsageError(f"--data DIR: {about.name} has no embedded tables; `{about.build}` makes one.")
    part = opt.chosen_shard(shard, view=view, table_two=of_table_two, sign=sign)
    alone = {"config": config, "show-config": show_config, "view": view, "permission": permission, "sign": sign}
    of_all = {"with-controls": given["with_controls"]}
    for option, value in (alone if of_table_two else of_all).items():
        if value:
            needed = "a run of one method under one condition" if of_table_two else "--method all or --condition all"
            raise UsageError(f"--{option}: belongs to {needed}; leave it out.")
    if of_table_two:
        made = load_built_in(STUDY_ITEMS, "table-2-rows")(given, choice=engine)
        return replace(made, report=RunAnswer(table_two=msgspec.to_builtins(made.report, enc_hook=str)))
    if config is None and given["method"] is None:
        raise UsageError("--method NAME is needed, or --config FILE. `prbench adapters list` shows the methods.")
    repeated, experiment = read_command_line(config, given)
    if require_fence:
        from prbench.harness.methods import isolation

        isolation.require_fence(method.name for method in experiment.methods)
        experiment = msgspec.structs.replace(experiment, isolate=True)
    if show_config:
        print(experiment.as_toml(), end="")
        return 0
    if sign is not None and not experiment.isolate:
        from prbench.harness.methods.installed import METHOD_CONTROLS, short_name

        own = (*METHOD_CONTROLS, *find_benchmark(experiment.benchmark).methods)
        for name in {method.name for method in experiment.methods} - set(own):
            raise UsageError(f"--sign: '{short_name(name)}' could take the key. Add --isolate or --require-fence.")
    if session().from_shell:
        for method in experiment.methods:
            if calls_foreign_code(method.name, isolate=experiment.isolate, entry_points=_group(experiment)):
                from prbench.cli.main import main

                return supervised(main, sys.argv[1:], method=method.name)
    return _run_all(experiment, repeated, view=view, permission=permission, choice=engine, shard=part, sign=sign)


def _run_all(
    experiment: Experiment,
    repeated: RunFolder | None,
    *,
    view: Path | None,
    permission: tuple[str, ...],
    choice: EngineChoice,
    shard: Shard | None,
    sign: Path | None,
) -> Answer:
    from prbench.harness.methods.installed import list_adapters
    from prbench.sequences.folds import ALL_FOLDS

    first_run = not experiment.data
    if experiment.fold == ALL_FOLDS and (view is not None or shard is not None or len(experiment.data) != 1):
        raise UsageError(
            f"--folds {ALL_FOLDS}: merges runs on all folds of one table, which --data names; leave --view and --shard"
            " out, or run single folds (--fold K/N) and put them together by `prbench merge`."
        )
    if shard is not None:
        opt.chosen_shard(str(shard), first_run=first_run)
    if view is not None:
        from prbench.viewing.view import file_kind

        file_kind(view)  # what would fail after the run fails before it
    # Packages that offer a method under a name of prbench's own are named; theirs is never run.
    for adapter in list_adapters(_group(experiment)):
        if adapter.problem and adapter.name in {method.name for method in experiment.methods}:
            note(f"note: {adapter.package} {adapter.version} is not used: {adapter.problem}.")
    key = None if sign is None else _unlocked(sign)
    engine = _opened(choice, experiment)
    if first_run:
        experiment = _on_embedded_tables(experiment, engine)
    requests = [replace(request, hidden=(sign,) if sign else ()) for request in experiment.requests()]
    if view is not None and len(requests) > 1:
        raise UsageError("--view: belongs to one run; `prbench view RUN RUN … --out FILE` shows several.")
    if shard is not None:
        made = [_generated_shard(request, shard, engine) for request in requests]
        answers = [opt.shard_answer(each, each, unit="batches") for each in made]

        def show_shards() -> None:
            for answer in answers:
                answer.show()

        return Answer(RunAnswer(shards=made), show_shards)
    reports = [_generated(request, engine, key) for request in requests]
    folder = reports[0].folder
    if repeated is not None and folder.path.resolve() != repeated.path.resolve():
        from prbench.harness.first_run import same_scores

        differ = "scores differ."
        differ += f" `prbench leaderboard compare {repeated.path} {folder.path}` says where; other weights,"
        causes = "versions of packages, processors or numbers of threads can be the cause."
        verdict = "every score is the same." if same_scores(repeated, folder) else f"{differ} {causes}"
        note(f"repeats {repeated.path}: {verdict}")
    companions: list[RunReport] = []
    if first_run and len(requests) == 1:
        # Methods that tell what the scores of a first run are worth, under the condition that the method chose.
        from prbench.contract import Condition
        from prbench.harness.first_run import companions as companions_of

        chosen = replace(requests[0], condition=Condition(folder.record.condition))
        companions = [_generated(companion, engine) for companion in companions_of(chosen)]
    below: list[str] = []
    if view is not None:
        from prbench.viewing.view import ViewRequest
        from prbench.viewing.view import view as draw

        data = () if requests[0].fold else requests[0].data  # folds stand in the cache, where the run's own is found
        wanted = ViewRequest(
            out=view, runs=(folder.path,), data=data, sequences=requests[0].sequences, permitted=permission
        )
        with progress(f"drawing {view.name}") as show_drawing:
            below = [*draw(wanted, show_drawing).notices, f"view: {view}"]
    if first_run and not experiment.sequences:
        told = f"these are {requests[0].limit} sequences of each dataset (--limit N takes another number); for the same"
        told += f" ones elsewhere: prbench export-conditions --data {requests[0].data[0].parent}/* --limit"
        note(f"{told} {requests[0].limit} …")
    return run_answer(reports, companions, single=bool(experiment.sequences), data=requests[0].data, below=below)


def _unlocked(path: Path) -> SecretKey:
    """Read the key before the run, so that a wrong password is told at once."""
    from prbench.harness.run_folder.signature import secret_key

    def password() -> str:
        if PASSWORD_VARIABLE in os.environ:
            return os.environ.pop(PASSWORD_VARIABLE)  # no process that is started later finds it
        if not sys.stdin.isatty():
            raise UsageError(f"--sign: expected a terminal to ask for the key's password, or {PASSWORD_VARIABLE}.")
        return click.prompt("password of the key", hide_input=True, err=True)

    key = secret_key(path, password)
    if os.name == "posix" and path.stat().st_mode & 0o077:
        note(f"{path}: others of this machine can read the secret key; `chmod 600 {path}` ends that.")
    return key


def _generated_shard(request: RunRequest, shard: Shard, engine: Engine) -> opt.MadeShard:
    from prbench.harness.sharded import run_shard

    with _told(request, f"running shard {shard} of {request.method_label}") as tell:
        tables = [session().shown_place(str(folder.absolute())) for folder in request.data]
        report = run_shard(request, shard, tables_at=tables, engine=engine, progress=tell)
    made = report.batches_made + report.batches_found
    _note_found(report.batches_found)
    return opt.MadeShard(
        shard=str(shard), folder=report.folder, made_of=made, planned=report.planned, taken_over=report.batches_found
    )


def _generated(request: RunRequest, engine: Engine, key: SecretKey | None = None) -> RunReport:
    from prbench.board.merging import SAME_WEIGHTS, run_folds
    from prbench.harness.run import run_method
    from prbench.harness.run_folder.signature import sign_run
    from prbench.sequences.folds import ALL_FOLDS

    make = run_folds if request.fold == ALL_FOLDS else run_method
    with _told(request, f"running {request.method_label}") as tell:
        report = make(request, engine=engine, progress=tell)
    _note_found(report.batches_found)
    if key is not None:
        made, found = report.batches_made, report.batches_found
        signer = sign_run(report.folder, key, made=made, found=found)
        note(f"signed by {signer}: {report.folder.path}; {made} of {made + found} batches were made just now.")
    if SAME_WEIGHTS in (report.folder.record.method.weights or ""):
        told = "every fold ran the same weights, which may have learnt from the people tested on. `prbench train"
        told += " --fold` K/N trains without them, and --weights 'DIR-{fold}/weights.safetensors' names what it"
        note(f"{told} trained.")
    return report


def _note_found(batches: int) -> None:
    if batches:
        note(f"{batches} batches were taken over from an earlier run.")


@contextlib.contextmanager
def _told(request: RunRequest, what: str) -> Iterator[Callable[[Progress], None]]:
    """Print how a method is isolated, and show the progress of its run."""
    if request.isolate:
        from prbench.harness.methods.isolation import available_fence
        from prbench.harness.methods.programs import runs_in_container

        container = "isolated in its container, which shows what its TOML file mounts; tables in there are covered."
        note(container if runs_in_container(request.method) else available_fence().notice)
    with progress(what) as show:
        yield lambda step: show(step.done, step.total, f"{step.stage} {step.dataset}")


def _opened(choice: EngineChoice, experiment: Experiment) -> Engine:
    """Open the engine; on a cluster every node needs the tables, the run folder, and what the methods are made of."""
    from prbench.harness.first_run import default_folder
    from prbench.harness.methods.installed import packages_of
    from prbench.harness.request import DEFAULT_PARENT

    reads = [Path(folder) for folder in experiment.data]
    writes = [Path(experiment.out or DEFAULT_PARENT / "run")]
    if not experiment.data:
        writes.append(default_folder())
    # A weight that is no file is the name of a bundled one, and a method may be a program's file.
    for method in experiment.methods:
        reads += [Path(text) for text in (method.weights, method.name) if text and Path(text).exists()]
    names = {method.name for method in experiment.methods}
    return opt.opened(
        choice,
        usual=1 if experiment.data else _FIRST_RUN_WORKERS,
        threads=experiment.threads,
        reads=reads,
        writes=writes,
        packages=packages_of(names, _group(experiment)) if isinstance(choice, Cluster) else (),
    )


def _on_embedded_tables(experiment: Experiment, engine: Engine) -> Experiment:
    """Run on the embedded datasets, by default on a part of each, in batches that two workers can share."""
    from prbench.harness import first_run
    from prbench.harness.methods.installed import METHOD_CONTROLS, is_program
    from prbench.harness.methods.loading import chosen_condition, find_adapter, load_adapter

    # An unknown method, or one that needs --condition, is refused before tables are built for half a minute.
    for method in experiment.methods:
        if method.name in METHOD_CONTROLS or is_program(method.name):
            continue
        find_adapter(method.name, also_known=METHOD_CONTROLS)
        if not method.conditions:
            weights = None if method.weights is None else Path(method.weights)
            adapter = load_adapter(method.name, weights, method.option_texts, experiment.device)
            chosen_condition(method.name, adapter, None)
    changes: dict[str, Any] = {"data": tuple(map(str, opt.embedded_tables(engine)))}
    if not experiment.sequences:
        changes["limit"] = experiment.limit or first_run.SEQUENCES
        changes["batch_size"] = experiment.batch_size or first_run.BATCH_SIZE
    return msgspec.structs.replace(experiment, **changes)


def _group(experiment: Experiment) -> str:
    """Entry-point group of the methods of an experiment."""
    return find_benchmark(experiment.benchmark).entry_points


# Options whose place is in the file, where there is one.
_OF_AN_EXPERIMENT = ("benchmark", "method", "condition", "options", "control", "sequences")

# Options that all runs of an experiment share; their names are its keys, but for ``seeds``.
_SHARED = (
    *("data", "out", "split", "fold", "limit", "samples", "batch_size", "device", "threads", "isolate", "timeout"),
    *("seed", "protocol"),
)


def read_command_line(config: Path | None, given: Mapping[str, Any]) -> tuple[RunFolder | None, Experiment]:
    """Turn the command line into an experiment; also return the run that it repeats, if it repeats one.

    Raises:
        UsageError: for an option whose place is in the file or run that was named.
    """
    from prbench.harness.first_run import earlier_run, experiment_of_run
    from prbench.harness.request import Experiment, ExperimentMethod, read_experiment

    # Defaults do not replace what a file says.
    source = click.get_current_context().get_parameter_source
    own = {name: given[name] for name in _SHARED if source(name) is click.core.ParameterSource.COMMANDLINE}
    if "data" in own:
        own["data"] = tuple(map(str, own["data"]))
    own |= {name: str(own[name]) for name in ("out", "protocol") if name in own}
    if "seed" in own:
        own["seeds"] = (own.pop("seed"),)
    if config is None:
        method = ExperimentMethod(
            name=given["method"],
            conditions=(given["condition"],) if given["condition"] else (),
            weights=str(given["weights"]) if given["weights"] else None,
            options=given["options"],
            control=given["control"],
        )
        said = {"methods": [msgspec.to_builtins(method)], "sequences": given["sequences"], **own}
        if given["benchmark"]:
            said["benchmark"] = given["benchmark"]
        return None, msgspec.convert(said, Experiment)
    for name in _OF_AN_EXPERIMENT:
        if given.get(name):
            option = name.removesuffix("s") if name in ("options", "sequences") else name
            raise UsageError(f"--{option}: {config} says that already; write it there, or leave --config out.")
    repeated = earlier_run(config)
    if repeated is not None:
        decided = sorted(own.keys() - {"data", "out", "device", "threads", "timeout"})
        if decided:
            option = decided[0].removesuffix("s").replace("_", "-")
            raise UsageError(f"--{option}: {config} says that already; a repeated run is the same run.")
        experiment = experiment_of_run(repeated, data=given["data"], weights=given["weights"])
        own.pop("data", None)  # found by digest among the named ones
        return repeated, msgspec.structs.replace(experiment, **own)
    if given["weights"]:
        raise UsageError(f"--weights: write them into {config}, beside the method that they belong to.")
    return None, msgspec.structs.replace(read_experiment(config), **own)


_Command = Callable[[Sequence[str]], int]


def calls_foreign_code(method: str, *, isolate: bool, entry_points: str = ADAPTERS) -> bool:
    """Return True where an installed method of another package would be called in this process."""
    if isolate:
        return False
    from prbench.harness.methods.installed import list_adapters

    claims = (adapter for adapter in list_adapters(entry_points) if adapter.name == method)
    return any(not adapter.built_in and not adapter.problem for adapter in claims)


def supervised(command: _Command, arguments: Sequence[str], *, method: str) -> int:
    """Run a command in a child process and return its exit code.

    Args:
        command: Function that is called in the child; it can be imported.
        arguments: Words of the command line.
        method: Name of the method whose code runs there, for the message.

    Raises:
        AdapterError: if the child ends without having returned from the command.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_report, args=(command, list(arguments), sender))
    child.start()

    def pass_on(number: int, _: FrameType | None) -> None:
        if number == signal.SIGTERM:  # Ctrl-C reaches the child without us
            child.terminate()

    previous = {number: signal.signal(number, pass_on) for number in (signal.SIGINT, signal.SIGTERM)}
    child.join()  # not the end of the pipe: what the method has started may hold that open
    for number, handler in previous.items():
        signal.signal(number, handler)
    if receiver.poll():
        return int(receiver.recv_bytes())
    from prbench.harness.methods.process import exit_story

    status = child.exitcode or 0
    if -status in (signal.SIGINT, signal.SIGTERM):
        return 128 - status
    problem = f"method '{method}': the process that it ran in {exit_story(status)}, so there are no scores. A method"
    problem += " must not call os._exit() or leave the process from C; it raises an exception instead. Finished batches"
    raise AdapterError(f"{problem} are kept; --isolate runs it in a process of its own and shows what it wrote last.")


def _report(command: _Command, arguments: list[str], sender: Connection) -> None:
    """Run the command in the child, and say how it ended."""
    end_with_parent()
    code = 1  # of a traceback
    try:
        code = command(arguments)
    finally:
        sender.send_bytes(str(code).encode())
