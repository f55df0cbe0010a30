"""Options that several commands share: the same name has the same meaning in every command.

Beside them stand what commands do with these options: the report of a shard, the engine that is closed when the command
ends, tables that finished runs are held against, and the embedded synthetic datasets.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli.commands import Answer, SeveralValues, in_session, note, progress
from prbench.cli.places import PlaceType
from prbench.engine import Engine, close_engine, engine_for
from prbench.engine.choice import DEFAULT_SPILL_LIMIT_GB, LOCAL, RAY, Cluster, EngineChoice, open_engine
from prbench.errors import UsageError
from prbench.protocol.manifests import benchmarks, default_benchmark, find_benchmark

if TYPE_CHECKING:
    from prbench.board.collect import CollectedRuns
    from prbench.engine.shards import Shard
    from prbench.harness.results import RunChecker

# Conditions that a method of the default benchmark can be given.
CONDITIONS = tuple(default_benchmark().conditions)
ALL_CONDITIONS = tuple(name for about in benchmarks().values() for name in about.conditions)
# Limit of a run on the embedded datasets, of each (``prbench.harness.first_run``); spelt out for quick help.
FIRST_RUN_SEQUENCES = 10
Paths = Sequence[Path]
SPLITS = ("train", "validation", "test")
# Value of ``--split`` that means the test split of a published evaluation, where windows have one.
PUBLISHED = "published"
PATH = PlaceType("input")  # of a file or folder that is read
LOCAL_PATH = PlaceType("local")  # of one that has to lie on this machine
NATIVE = PlaceType("native")  # of a folder with a dataset's own files
OUT_FILE = PlaceType("file")
_OUT_FOLDER = PlaceType("folder")
_TABLE_FILE = "dataset.json"  # prbench.sequences.dataset_info.FILE_NAME, whose module is not needed for help
POSITIVE = click.IntRange(min=1)


class NumberRange(click.FloatRange):
    """A range of numbers; NaN, which click finds in every range, lies in none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse a number."""
        number = super().convert(value, param, ctx)
        if number != number:
            self.fail("expected a number, found nan.", param, ctx)
        return number


SECONDS = NumberRange(min=0, min_open=True)  # a time limit
RATE = NumberRange(min=0, min_open=True, max=1000)  # frames a second
Pairs = dict[str, str]


class KeyValue(click.ParamType):
    """Words of the form ``key=value``, parsed into a pair."""

    name = "key=value"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        """Parse ``key=value``."""
        if isinstance(value, tuple):
            return value
        key, separator, text = str(value).partition("=")
        if not separator or not key:
            self.fail(f"expected key=value, found '{value}'.", param, ctx)
        return key, text


def usual_number(of: str) -> str:
    """Return the usual number of answers or cases a batch, of each benchmark that has another than the default one."""
    usual = getattr(default_benchmark(), of)
    others = [f"{about.name} {getattr(about, of)}" for about in benchmarks().values() if not about.default]
    return "; ".join([str(usual), *others])


def conditions_by_benchmark() -> str:
    """Return the conditions of each benchmark."""
    return "; ".join(f"{', '.join(about.conditions)} with {about.name}" for about in benchmarks().values())


def option(*words: str, **settings: Any) -> Callable:
    """Add an option: its name, that of the command's argument where it is another, and its help."""
    *names, help = words
    return click.option(*names, help=help, **settings)


def flag(*words: str) -> Callable:
    """Add an option without a value; see :func:`option`."""
    return option(*words, is_flag=True)


def number_option(*words: str, **settings: Any) -> Callable:
    """Add an option whose value is a whole number of 1 or more; see :func:`option`."""
    return option(*words, type=POSITIVE, metavar="N", **settings)


def path_option(*words: str, metavar: str = "FILE", **settings: Any) -> Callable:
    """Add an option whose value is a file or folder that is read; see :func:`option`."""
    return option(*words, type=PATH, metavar=metavar, **settings)


def choice_option(name: str, choices: Sequence[str], help: str, **settings: Any) -> Callable:
    """Add an option whose value is one of some words."""
    return option(name, help, type=click.Choice(choices), **settings)


def pairs_option(*words: str, metavar: str) -> Callable:
    """Add an option of the form ``key=value``, repeatable, whose values make a dictionary; see :func:`option`."""

    def paired(_ctx: click.Context, _param: click.Parameter, pairs: tuple[tuple[str, str], ...]) -> Pairs:
        return dict(pairs)

    return option(*words, type=KeyValue(), multiple=True, metavar=metavar, callback=paired)


_ASKED = f"What is asked of the method: {', '.join(benchmarks())} (default {default_benchmark().name})."
benchmark_option = choice_option("--benchmark", list(benchmarks()), _ASKED, metavar="NAME")
weights_option = click.option(
    "--weights", type=PATH, metavar="NAME|FILE", help="The method's weights: bundled ones by name, a file or a folder."
)
device_option = click.option("--device", default="cpu", help="cpu (default), cuda, cuda:1 ….")
threads_option = click.option("--threads", type=POSITIVE, default=1, metavar="N", help="Threads a process (default 1).")
# The user's word for data whose licence keeps recorded motion.
_PERMISSION = "I have the licensor's permission to pass on recorded motion and goals of DATASET (only needed where its"
_PERMISSION += " licence forbids it; `prbench datasets` says which); repeatable."
permission_option = click.option("--permission", multiple=True, metavar="DATASET", help=_PERMISSION)


def data_option(*, required: bool, help: str = "Built dataset folder(s), or a folder of such.") -> Callable:
    """Add ``--data DIR…``, repeatable; a folder that is no table stands for the tables in it."""

    def each_table(_ctx: click.Context, _param: click.Parameter, folders: tuple[Any, ...]) -> tuple[Any, ...]:
        found = []
        for folder in folders:
            own = isinstance(folder, Path) and not (folder / _TABLE_FILE).exists()
            inner = sorted(file.parent for file in folder.glob(f"*/{_TABLE_FILE}")) if own else []
            found += inner or [folder]
        return tuple(found)

    return path_option("--data", help, cls=SeveralValues, metavar="DIR...", required=required, callback=each_table)


_TABLES = "The tables of the runs: scores are held against the motions on them, and called unverified without"
tables_option = data_option(required=False, help=f"{_TABLES}; the embedded tables need not be named.")
_SIGNED = "Refuse runs that `prbench run --sign` has not signed with this key of minisign, or that were changed then."
signed_option = option("--require-signed", _SIGNED, type=LOCAL_PATH, metavar="PUBLIC_KEY")


def out_folder_option(help: str, *, required: bool = False) -> Callable:
    """Add ``--out DIR``, the folder that the command writes."""
    return click.option("--out", type=_OUT_FOLDER, metavar="DIR", required=required, help=help)


def out_file_option(help: str, *, required: bool = False, metavar: str = "FILE") -> Callable:
    """Add ``--out FILE``, the file that the command writes."""
    return click.option("--out", type=OUT_FILE, metavar=metavar, required=required, help=help)


def workers_option(default: int | None = 1, *, help: str = "") -> Callable:
    """Add ``--workers N``; results do not depend on it."""
    help = help or f"Processes to use (default {default}); changes no result."
    return click.option("--workers", type=POSITIVE, default=default, metavar="N", help=help)


_SPILL_LIMIT = "With ray: work that may wait in Ray's memory, and be spilled to its disk, at a time"
_GPUS = "With ray: GPUs that a worker occupies, for example 0.5 (default 0)."
_ADDRESS = "With ray: the cluster's head, or auto (default: RAY_ADDRESS, else a Ray on this machine alone)."
_ENGINE = "Where to work: here (default), or on a Ray cluster, such as --engine ray --address 10.0.0.1:6379"
_LIMIT = f"{_SPILL_LIMIT} (default {DEFAULT_SPILL_LIMIT_GB:g})."
_WHERE = f"{_ENGINE} (docs/cluster.md#ray); changes no result."
_RAY_OPTIONS = (
    click.option("--spill-limit", type=SECONDS, default=DEFAULT_SPILL_LIMIT_GB, metavar="GB", help=_LIMIT),
    click.option("--gpus-per-worker", type=NumberRange(min=0), default=0.0, metavar="N", help=_GPUS),
    click.option("--address", metavar="HOST:PORT", help=_ADDRESS),
    click.option("--engine", type=click.Choice([LOCAL, RAY]), default=LOCAL, help=_WHERE),
)


def engine_options(*, help: str = "") -> Callable:
    """Add where work runs: ``--workers``, ``--engine``, ``--address`` …; the command gets one value, ``engine``.

    Args:
        help: What ``--workers`` says in place of the default.
    """

    def add(function: Callable) -> Callable:
        @functools.wraps(function)
        def with_choice(**given: Any) -> Any:
            chosen = {name: given.pop(name) for name in ("workers", "address", "gpus_per_worker", "spill_limit")}
            if given.pop("engine") == RAY:
                return function(**given, engine=Cluster(**chosen))
            if chosen["address"] is not None or chosen["gpus_per_worker"]:
                raise UsageError("--address and --gpus-per-worker belong to --engine ray; add it, or leave them out.")
            return function(**given, engine=chosen["workers"])

        said = help or "Processes to use (default 1; with --engine ray all processors); changes no result."
        for option in (*_RAY_OPTIONS, workers_option(None, help=said)):
            with_choice = option(with_choice)
        return with_choice

    return add


def split_option(default: str | None = "test", *, help: str = "", more: tuple[str, ...] = ()) -> Callable:
    """Add ``--split``; the test split unless another is named."""
    help = help or f"Split of the table (default {default})."
    return click.option("--split", type=click.Choice((*SPLITS, *more)), default=default, help=help)


fold_option = click.option(
    "--fold", metavar="K/N", help="Test on the people of this fold of N, such as 2/6, and learn from all others."
)


def scores_options(function: Callable) -> Callable:
    """Add ``--all`` and ``--strict``, for commands that print scores."""
    more = "Print all metrics: without it the study's six and Plausible. Files and --json hold all."
    strict = "End with exit code 1 where motions are certainly wrong, such as Z up (docs/doctor.md)."
    for name, variable, help in (("--strict", "strict", strict), ("--all", "all_metrics", more)):
        settings = {"is_flag": True, "expose_value": False, "callback": in_session}
        function = click.option(name, variable, help=help, **settings)(function)
    return function


def limit_option(default: str = "all") -> Callable:
    """Add ``--limit N`` sequences of each dataset; equal limits mean the same sequences in every command."""
    share = "of every recording its share, for every command the same"
    return number_option("--limit", f"At most N sequences of each dataset, {share} (default: {default}).")


def root_option(
    help: str = "Your copy of the dataset.", *, required: bool = True, type: PlaceType = NATIVE
) -> Callable:
    """Add ``--root DIR``, a folder with a dataset's own files."""
    return click.option("--root", type=type, metavar="DIR", required=required, help=help)


def count_option(help: str) -> Callable:
    """Add ``--count N``, how many synthetic recordings to make; ``--recordings`` chooses among recordings there are."""
    return number_option("--count", help)


def recordings_options(function: Callable) -> Callable:
    """Add ``--recordings GLOB`` and ``--max-recordings N``, which choose recordings of a copy of a dataset."""
    glob = "Only recordings whose name matches (default: all)."
    limited = number_option("--max-recordings", "At most N recordings: the first by name.")(function)
    return click.option("--recordings", default="*", metavar="GLOB", help=glob)(limited)


def sequence_option(help: str) -> Callable:
    """Add ``--sequence ID``, repeatable."""
    help = f"{help}; the id, or a beginning, end or part that fits one only; repeatable."
    return click.option("--sequence", "sequences", multiple=True, metavar="ID", help=help)


def option_option(whose: str = "method's", *, metavar: str = "KEY=VALUE", remark: str = "") -> Callable:
    """Add ``--option KEY=VALUE``, repeatable, for a method or a reader."""
    help = f"An option of the {whose}; repeatable{f' ({remark})' if remark else ''}."
    return pairs_option("--option", "options", help, metavar=metavar)


def reader_options(whose: str = "dataset's", *, remark: str = "a wrong name lists them") -> Callable:
    """Add ``--option NAME=VALUE`` for a reader."""
    return option_option(f"{whose} reader", metavar="NAME=VALUE", remark=remark)


def stream_options(function: Callable) -> Callable:
    """Add ``--shift STREAM=SECONDS`` and ``--scale STREAM=FACTOR``."""
    streams = "gaze, camera, head, body, hands or objects"
    shift = f"Add seconds to the times of a stream ({streams}), such as gaze=-5.0; `prbench inspect --thorough` says"
    shift += " which. P01*:gaze=-5.0 means recordings by id."
    scale = "Multiply the positions of a stream, such as objects=0.001 where its file holds millimetres."
    function = pairs_option("--scale", scale, metavar="STREAM=FACTOR")(function)
    return pairs_option("--shift", shift, metavar="STREAM=SECONDS")(function)


def method_settings(function: Callable) -> Callable:
    """Add what a method is loaded with: ``--weights``, ``--option``, ``--device`` and ``--threads``."""
    return weights_option(option_option("method")(device_option(threads_option(function))))


def seed_option(of: str, *, default: int | None = 0) -> Callable:
    """Add ``--seed N``."""
    return click.option("--seed", type=int, default=default, metavar="N", help=f"Seed {of} (default 0).")


def control_option(help: str) -> Callable:
    """Add ``--control shuffled-goal``."""
    return click.option("--control", type=click.Choice(["shuffled-goal"]), help=help)


def protocol_option(help: str) -> Callable:
    """Add ``--protocol FILE``, a protocol of the user's own."""
    return path_option("--protocol", f"Your own protocol.toml: {help}")


def on_error_option(*, what: str = "a recording", them: str = "it") -> Callable:
    """Add ``--on-error skip|fail``."""
    help = f"Go on without {what} that cannot be read and name {them} (default), or fail at once."
    return click.option("--on-error", type=click.Choice(["skip", "fail"]), default="skip", help=help)


def replace_option(what: str = "table") -> Callable:
    """Add ``--replace``, which loses what an earlier result holds."""
    help = f"Replace an earlier {what} even where the new one lacks recordings that it holds (refused by default)."
    return flag("--replace", help)


def complete_method(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[str]:  # noqa: ARG001
    """Return the installed methods and the controls that begin with what was typed, for the shell's completion."""
    from prbench.harness.methods.installed import METHOD_CONTROLS, list_adapters

    about = find_benchmark(ctx.params.get("benchmark") or default_benchmark().name)
    names = {adapter.name for adapter in list_adapters(about.entry_points) if not adapter.problem}
    controls = METHOD_CONTROLS if about.default else ()
    return sorted(name for name in {*names, *controls} if name.startswith(incomplete))


class MadeShard(msgspec.Struct, frozen=True, kw_only=True):
    """One shard that was made, with ``--shard``.

    Attributes:
        shard: Which one it is, such as ``3/16``.
        folder: Its folder, for `prbench merge`.
        made_of: Number of its recordings (of a corpus: groups of them, of a run: batches).
        planned: Number of those of all shards.
        taken_over: Number of recordings or batches that an interrupted call had already finished.
    """

    shard: str
    folder: Path
    made_of: int
    planned: int
    taken_over: int


def shard_option(of: str) -> Callable:
    """Add ``--shard K/N``.

    Args:
        of: What is dealt out to the shards.
    """
    what = f"Work on shard K of N, such as 3/16: every N-th of {of}; --out is the shard's own folder"
    help = f"{what}, and `prbench merge` puts all of them together (docs/cluster.md)."
    return click.option("--shard", metavar="K/N", help=help)


def chosen_shard(text: str | None, **refused: object) -> Shard | None:
    """Return the shard that was asked for.

    Args:
        text: What ``--shard`` says.
        refused: Values of options that do not go with it, by the option's name.

    Raises:
        UsageError: for another text, or an option that does not go with it.
    """
    if text is None:
        return None
    from prbench.engine.shards import Shard

    shard = Shard.parse(text)
    for name, value in refused.items():
        if value:
            raise UsageError(f"--shard {shard}: does not go with {_REFUSED[name]}.")
    return shard


# What is wrong with an option beside ``--shard``, and what to do.
_REFUSED = {
    "replace": "--replace: a shard replaces nothing; give the option to `prbench merge`",
    "dry_run": "--dry-run, which is of the whole build; leave one of them out",
    "everything": "'all': each dataset is merged by itself; name one",
    "data": "--data: windows of a built table are made in one go; leave --shard out",
    "view": "--view: the motions are whole after `prbench merge`",
    "sign": "--sign: sign the merged run, by this command without --shard and --out of the merged folder",
    "first_run": "a run without --data: name the tables",
    "table_two": "all: name one method and one condition",
}


def shard_answer(report: Any, made: MadeShard, *, unit: str, exit_code: int = 0) -> Answer:
    """Answer a command that has made one shard.

    Args:
        report: The command's report.
        made: The shard.
        unit: What it consists of.
        exit_code: Exit code of the command.
    """

    def show() -> None:
        print(f"shard {made.shard}: {made.made_of} of {made.planned} {unit}")
        print(f"shard folder: {made.folder}")

    if not made.made_of:
        note(f"there are fewer {unit} than shards: shard {made.shard} is empty, and is merged like the others.")
    return Answer(report, show, exit_code)


def opened(choice: EngineChoice, **needs: Any) -> Engine:
    """Open an engine for the rest of the command.

    Args:
        choice: What :func:`engine_options` gave the command.
        needs: See :func:`prbench.engine.choice.open_engine`.
    """
    engine = open_engine(choice, **needs, tell=note)
    click.get_current_context().call_on_close(lambda: close_engine(engine))
    return engine


def run_checker(data: Paths, workers: int) -> RunChecker:
    """Make what scores again on the named tables and the embedded ones."""
    from prbench.harness.first_run import table_finder
    from prbench.harness.results import RunChecker

    return RunChecker(table_finder(data), engine_for(workers))


def collected_runs(
    runs: Paths, data: Paths, workers: int, *, any_benchmark: bool = False, require_signed: Path | None = None
) -> CollectedRuns:
    """Collect finished runs, whose scores are held against their motions, and tell what was left out or not checked.

    Args:
        runs: Run folders, folders that hold some, or a board, whose submissions were verified before.
        data: Tables of the runs.
        workers: Number of processes.
        any_benchmark: The command knows runs of every benchmark.
        require_signed: File of the public key that every run must be signed by.
    """
    from prbench.board import collect_runs
    from prbench.board.folder import INFO
    from prbench.board.pages import collect_board
    from prbench.board.upkeep import sound_board

    if len(runs) == 1 and (runs[0] / INFO).is_file() and require_signed is None:
        collected = collect_board(sound_board(runs[0]))
    else:
        check = run_checker(data, workers).check
        collected = collect_runs(runs, check=check, any_benchmark=any_benchmark, signed_by=require_signed)
    for reason in collected.left_out:
        note(f"left out: {reason}")
    for row in collected.rows:
        if row.unverified:
            note(f"unverified: {row.run}: {row.unverified}")
        if row.unverified_cost:
            note(f"unverified (cost): {row.run}, {row.table.dataset}, cost.json: {row.unverified_cost}")
    return collected


def embedded_tables(engine: Engine) -> tuple[Path, ...]:
    """Return the folders of the embedded synthetic datasets, which are built on the first call."""
    from prbench.harness.first_run import LAYOUTS, default_folder, default_tables, default_tables_are_built

    folder = default_folder()
    what = f"building {len(LAYOUTS)} small synthetic datasets in {folder} (once)"
    if default_tables_are_built():
        what = f"using the {len(LAYOUTS)} embedded synthetic datasets in {folder}"
    note(f"no --data given: {what}")
    with progress("building synthetic data") as show:
        return tuple(table.folder for table in default_tables(engine, show, tell=note))
