"""``prbench study``: the tables and figures of the study on one's own tables and runs, and its ablations."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import msgspec
from click.core import ParameterSource

from prbench.cli import options as opt
from prbench.cli.commands import Answer, SeveralValues, command, note, progress, session
from prbench.cli.places import PlaceType, Remote
from prbench.cli.terminal import print_tables
from prbench.entry_points import STUDY_ITEMS, load_built_in
from prbench.errors import RunError, TableError, UsageError

if TYPE_CHECKING:  # help is quick: tables load NumPy
    from prbench.tables import Table


Paths = tuple[Path, ...]
_SUFFIXES = (".csv", ".tex", ".md")  # of the tables that --train writes


class StudyReport(msgspec.Struct, frozen=True, kw_only=True):
    """What was made.

    Attributes:
        tables: The tables, or the numbers behind a figure.
        files: The files that were written.
        out: The picture of a figure; null for a table.
        caption: Text below that picture in a paper; empty for a table.
        sequences: Ids of the sequences in a picture of motions.
        notices: Sentences that the datasets' terms ask for, as they stand in such a picture.
        folder: Folder of the configuration, its trainings and runs; null without ``--train``.
        runs: Run folders that are finished, with --train.
        failed: Maps rows that failed to the reason, with --train; suits that are corrupt or cannot be read.
    """

    tables: list[Table] = []
    files: list[Path] = []
    out: Path | None = None
    caption: str = ""
    sequences: list[str] = []
    notices: list[str] = []
    folder: Path | None = None
    runs: list[Path] = []
    failed: dict[str, str] = {}


def _answer(
    tables: Sequence[Table], files: Sequence[Path], drawn: Path | None = None, lines: Sequence[str] = (), **more: Any
) -> Answer:
    """Write the tables, and answer with their numbers, further lines, and the written files.

    ``more`` are fields of the report, and ``between``, which stands between a number and its interval, and
    ``pictures`` that were drawn of the tables.
    """
    from prbench.tables import write_tables

    between = more.pop("between", " ")
    pictures = more.pop("pictures", ())
    for path in files:
        write_tables(tables, path)
    written = [*([] if drawn is None else [drawn]), *files, *pictures]
    report = StudyReport(tables=list(tables), files=written, out=drawn, **more)

    def show() -> None:
        print_tables(report.tables, between=between)
        caption = [f"caption: {report.caption}"] if report.caption else []
        for line in (*lines, *caption, *(f"written: {path}" for path in written)):
            print(line)

    return Answer(report, show, exit_code=1 if report.failed else 0)


def _number(item: str) -> str:
    """Return the number that a table has in the study, such as ``S3``."""
    return item.removeprefix("table-").upper()


def _sizes(item: str, folders: Paths, *, out: Paths) -> Answer:
    from prbench.sequences import SequenceTable
    from prbench_benchmarks.prime_and_reach.study.sizes import table_one, table_s2

    make = table_one if item == "table-1" else table_s2
    return _answer([make([SequenceTable.open(folder) for folder in folders])], out)


def _methods(item: str, runs: Paths, *, data: Paths, with_published: bool, out: Paths, workers: int) -> Answer:
    from prbench.board import make_leaderboard
    from prbench.sequences import SequenceTable
    from prbench_benchmarks.prime_and_reach.study.methods import methods_table, poses_table

    collected = opt.collected_runs(runs, data, workers)
    if not collected.rows:
        raise RunError("no finished run was found.")
    board = make_leaderboard(collected)
    if item != "table-s1":
        return _answer(methods_table(board, _number(item), with_published=with_published), out)
    # Where the bodies of a table come from is not in its runs: they name the table by the digest of its content.
    opened = [SequenceTable.open(folder) for folder in data]
    sources = {table.content: sorted(set(table.scalars()["pose_source"].to_pylist())) for table in opened}
    tables = poses_table(board, lambda table: sources.get(table.key[2], []), with_published=with_published)
    return _answer(tables, out)


def _ablation(item: str, folders: Paths, *, data: Paths, with_published: bool, out: Paths, workers: int) -> Answer:
    from prbench_benchmarks.prime_and_reach.ablation import ablation_table

    if len(folders) != 1:
        raise UsageError(f"study {item}: name one DIR, the folder of one configuration, such as ablations/paper.")
    check = opt.run_checker(data, workers).check
    return _answer(ablation_table(_number(item), folders[0], check, with_published=with_published), out)


def _evaluations(item: str, reports: Paths, *, with_published: bool, out: Paths) -> Answer:
    return _answer([load_built_in(STUDY_ITEMS, item)(reports, with_published=with_published)], out)


def _tokens(item: str, weights: Paths, *, data: Paths, out: Paths, **settings: Any) -> Answer:
    if not data:
        raise UsageError(f"study {item}: --data DIR is needed, whose split 'test' is reconstructed.")
    with progress("reconstructing") as tell:
        return _answer([load_built_in(STUDY_ITEMS, item)(weights, data, **settings, progress=tell)], out)


def _mapping(item: str, inputs: Paths, *, root: Path | None, smpl: Path | None, out: Paths) -> Answer:
    if root is None or inputs:
        raise UsageError(f"study {item}: name one --root DIR, your copy of Nymeria, and no DIR else.")
    tables, failed = load_built_in(STUDY_ITEMS, item)(root, smpl)
    return _answer(tables, out, lines=_failures(failed), failed=failed)


def _prediction(item: str, inputs: Paths, *, out: Paths, **settings: Any) -> Answer:
    """Score the rows of the study of motion prediction on the first input, windows; the others are finished runs."""
    from prbench.viewing.figures import FORMATS

    pictures = [path for path in out if path.suffix.lower() in FORMATS]
    files = [path for path in out if path not in pictures]
    with progress("scoring") as tell:
        made = load_built_in(STUDY_ITEMS, item)(inputs[0], inputs[1:], **settings, progress=tell)
    caption = ""
    for path in pictures:
        caption = load_built_in(STUDY_ITEMS, "prediction-figure")(made, path)
    return _answer(made, files, pictures[0] if pictures else None, between="\n", caption=caption)


def _train(item: str, folders: Paths, *, data: Paths, workers: int, **settings: Any) -> Answer:
    """Train and run the rows of a table of ablations, and write it in all formats beside them."""
    from prbench.engine import engine_for
    from prbench_benchmarks.prime_and_reach.ablation import AblationRequest, ablation_table, run_ablation

    if folders or not data:
        raise UsageError(f"study {item} --train: expected --data DIR..., and no DIR else.")
    named = {name: settings.pop(name) for name in ("nymeria", "humanml3d")}
    settings["corpora"] = {name: folder for name, folder in named.items() if folder is not None}
    request = AblationRequest(table=_number(item), data=data, **settings)
    runs, failed = run_ablation(request, engine=engine_for(workers), say=note)
    tables = []
    files = []
    if runs:
        check = opt.run_checker(data, workers).check
        tables = ablation_table(_number(item), request.folder, check, with_published=True)
        files = [request.folder / f"{item.replace('-', '_')}{suffix}" for suffix in _SUFFIXES]
    return _answer(tables, files, lines=_failures(failed), folder=request.folder, runs=runs, failed=failed)


def _train_prediction(item: str, windows: Paths, *, workers: int, **settings: Any) -> Answer:
    """Train and run the rows of the study of motion prediction; write its tables, and a picture a dataset."""
    from prbench.engine import engine_for
    from prbench_adapters.training.rows import RowsRequest

    if not windows:
        raise UsageError(f"study {item} --train: name WINDOWS..., tables of `prbench build-windows`, one a dataset.")
    request = RowsRequest(data=windows, **settings)
    with progress(f"study {item}") as tell:
        made = load_built_in(STUDY_ITEMS, "prediction-training")(
            request, engine=engine_for(workers), say=note, tell=tell
        )
    pictures = [request.folder / f"prediction-{dataset}.png" for dataset in made.tables]
    for tables, picture in zip(made.tables.values(), pictures, strict=True):
        load_built_in(STUDY_ITEMS, "prediction-figure")(tables, picture)
    files = [request.folder / f"prediction{suffix}" for suffix in _SUFFIXES]
    about = {"folder": request.folder, "runs": list(made.runs), "failed": dict(made.failed), "between": "\n"}
    tables = list(itertools.chain.from_iterable(made.tables.values()))
    return _answer(tables, files, lines=_failures(made.failed), pictures=pictures, **about)


def _failures(failed: Mapping[str, str]) -> list[str]:
    return [f"failed: {name}: {reason}" for name, reason in failed.items()]


def _distributions(_item: str, folders: Paths, *, out: Paths) -> Answer:
    from prbench.sequences import SequenceTable
    from prbench.sequences.table import table_statistics
    from prbench.viewing.distributions import draw_table_one
    from prbench_benchmarks.prime_and_reach.study.sizes import table_one

    tables = [SequenceTable.open(folder) for folder in folders]
    statistics = [each for each in map(table_statistics, tables) if each.sequences]
    if not statistics:
        raise TableError("nothing to draw, since no table holds sequences.")
    caption = draw_table_one(statistics, out[0])
    return _answer([table_one(tables)], (), out[0], caption=caption)


def _drawn(item: str, runs: Paths, *, data: Paths, numbers: Paths, out: Paths, workers: int, by: str = "") -> Answer:
    from prbench.engine import engine_for
    from prbench_benchmarks.prime_and_reach.study import charts

    engine = engine_for(workers)
    opened = charts.genuine_runs(runs, data, engine)
    if item == "figure-4":
        table = charts.breakdown_table(opened, by)
        caption = charts.draw_breakdown(table, out[0])
    else:
        sweeps = [charts.sweep(run, engine=engine) for run in opened]
        caption = charts.draw_sweep(sweeps, out[0])
        table = charts.sweep_table(sweeps)
    return _answer([table], numbers, out[0], caption=caption)


# Title of each picture of motions, and how many sequences of each dataset it shows.
_PICTURES = {
    "figure-1": ("Prime-and-reach sequences: people look at a goal before they reach it", 2),
    "figure-2": ("Examples of curated prime-and-reach sequences", 1),
    "figure-5": ("Recorded and generated motion at the first frame, the prime and the reach", 3),
}


def _motions(item: str, inputs: Paths, *, out: Paths, data: Paths | None = None, **given: Any) -> Answer:
    from prbench.viewing.view import ViewRequest, scenes_of
    from prbench_benchmarks.prime_and_reach.study.motions import draw_examples, draw_moments

    title, usual = _PICTURES[item]
    sequences = given["sequences"]
    limit = usual if given["limit"] is None and not sequences else given["limit"]
    permission = given["permission"]
    # Figure 5 is of runs and their tables, the others are of tables alone.
    runs, data, draw = ((), inputs, draw_examples) if data is None else (inputs, data, draw_moments)
    request = ViewRequest(out=out[0], runs=runs, data=data, sequences=sequences, limit=limit, permitted=permission)
    scenes = [scene for scene in scenes_of(request) if runs or scene.shows_recorded]
    if not scenes:
        raise UsageError("nothing to draw: the licence of these datasets keeps recorded motion (--permission).")
    caption = draw(scenes, out[0], title=title)
    notices = list(dict.fromkeys(scene.notice for scene in scenes if scene.notice))
    lines = [*(f"{scene.sequence_id}: {scene.title}" for scene in scenes), *notices]
    shown = {"sequences": [scene.sequence_id for scene in scenes], "notices": notices, "caption": caption}
    return _answer([], (), out[0], lines, **shown)


class _Item(NamedTuple):
    """A table or figure: what it shows, what it is made from, the options that it takes, and the function.

    ``train`` is the function behind ``--train``, with the options that it takes then.
    """

    title: str
    inputs: str
    options: tuple[str, ...]
    make: Callable[..., Answer]
    train: Callable[..., Answer] | None = None
    training: tuple[str, ...] = ()


_OF_RUNS = ("data", "with_published", "out", "workers")
_OF_SCORES = ("data", "numbers", "out", "workers")
_OF_MOTIONS = ("sequences", "limit", "permission", "out")
_TRAINED = ("configuration", "out", "limit", "device", "threads", "seed", "workers")
_TRAINING = ("data", "nymeria", "humanml3d", *_TRAINED)
_PREDICTED = (
    "motion prediction, Tables 1 to 3 on windows; RUN behind them stand for their rows (--train: several windows)"
)
_RECONSTRUCTED = ("data", "with_published", "device", "out")
_PREDICTION = ("weights", "limit", "device", "seed", "out")
_ABLATIONS = {
    "table-3": "ablation of conditions and optimisation, one by one",
    "table-4": "ablation of the pre-training",
    "table-s4": "ablation: an encoder or a decoder",
    "table-s5": "ablation of the loss",
    "table-s6": "ablation of how initial state and goal enter the memory",
    "table-s7": "ablation of the diffusion steps",
}
_ITEMS = {
    "table-1": _Item("how many sequences, how long, how far people move", "DIR", ("out",), _sizes),
    "table-2": _Item("runs in the layout of the main table, a part a dataset", "RUN", _OF_RUNS, _methods),
    "table-s1": _Item("runs by poses of training and test (weights …-egoallo, …-mocap)", "RUN", _OF_RUNS, _methods),
    "table-s2": _Item("sequences and recordings of each split", "DIR", ("out",), _sizes),
    "table-s3": _Item("models of one dataset each (weights pr-goal-loc-adt)", "RUN", _OF_RUNS, _methods),
    "table-s8": _Item("files of `prbench evaluate-text`", "FILE", ("with_published", "out"), _evaluations),
    **{name: _Item(title, "DIR", _OF_RUNS, _ablation, _train, _TRAINING) for name, title in _ABLATIONS.items()},
    "three-points": _Item("bodies from head and wrists", "RUN", ("with_published", "out"), _evaluations),
    "prediction": _Item(_PREDICTED, "DIR", _PREDICTION, _prediction, _train_prediction, _TRAINED),
    "nymeria-table-5": _Item("weights of motion-tokens on --data", "FILE", _RECONSTRUCTED, _tokens),
    "nymeria-mapping": _Item("the suit's bones, floor and SMPL fit", "--root DIR", ("root", "smpl", "out"), _mapping),
    "nymeria-table-6": _Item("captions of motions", "FILE", ("with_published", "out"), _evaluations),
    "figure-1": _Item("recorded sequences with the look that primes the goal", "DIR", _OF_MOTIONS, _motions),
    "figure-2": _Item("recorded sequences of each table", "DIR", _OF_MOTIONS, _motions),
    "figure-4": _Item("scores by what a sequence asks for (--by)", "RUN", (*_OF_SCORES, "by"), _drawn),
    "figure-5": _Item("poses at first frame, prime and reach", "RUN", (*_OF_MOTIONS, "data"), _motions),
    "figure-s2": _Item("where goals lie, how far people move, when they look", "DIR", ("out",), _distributions),
    "figure-s3": _Item("Prime Success over its distance and window", "RUN", _OF_SCORES, _drawn),
}


def taken_options(ctx: click.Context, name: str, given: Mapping[str, Any], taken: tuple[str, ...]) -> dict[str, Any]:
    """Return the options that an item takes; refuse one that was given and belongs to others.

    Raises:
        UsageError: naming the option, and those of the item.
    """
    spelt = {option.name: option.opts[0] for option in ctx.command.params if option.name in given}
    for option, spelling in spelt.items():
        if option not in taken and ctx.get_parameter_source(option) is not ParameterSource.DEFAULT:
            own = sorted(spelt[each] for each in taken)
            raise UsageError(f"{name} takes no {spelling}; its options: {', '.join(own)}.")
    return {option: given[option] for option in taken}


class _OutType(PlaceType):
    """Type of ``--out``: files that are written or, with ``--train``, a folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Take a path, or a URL."""
        found = super().convert(value, param, ctx)
        trains = ctx is not None and ctx.params.get("train")
        return Remote(found.url, "folder") if trains and isinstance(found, Remote) else found


@command(
    "study",
    section="board",
    example="prbench study table-2 runs/table-2 --data tables/adt --with-published --out table_2.tex table_2.csv",
    report=StudyReport,
    first=("--data", "--with-published", "--out", "--numbers", "--by", "--workers", "--train", "--json"),
    items={name: f"{item.inputs}...: {item.title}" for name, item in _ITEMS.items()},
)
@click.argument("item", type=click.Choice(list(_ITEMS)), metavar="ITEM")
@click.argument("inputs", type=opt.PATH, nargs=-1, metavar="[DIR|RUN|FILE]...")
@click.option(
    "--train",
    is_flag=True,
    is_eager=True,
    help="Tables 3, 4 and S4 to S7, and prediction: train and run the rows, then print the table. A row that fails ends"
    " nothing but itself; the same command tries it again and goes on where it was interrupted.",
)
@opt.data_option(
    required=False,
    help="The tables of the runs: scores are held against the motions on them, and called unverified without; the"
    " embedded tables need not be named. With --train: split 'train' is learnt from, 'test' is run.",
)
@opt.flag(
    "--with-published",
    "Show the study's rows in a block of their own and, for runs on real recordings, the differences.",
)
@click.option(
    "--out",
    cls=SeveralValues,
    type=_OutType("file"),
    metavar="FILE...",
    help="Write a table to these files: .csv (one number a row), .tex (LaTeX with booktabs) or .md. Of a figure, the"
    " picture: .png, .svg or .pdf, also of prediction. With --train: folder of all that is made (default ablations).",
)
@click.option(
    "--numbers",
    cls=SeveralValues,
    type=opt.OUT_FILE,
    metavar="FILE...",
    help="Write what the figure draws to these files: .csv, .tex or .md.",
)
@opt.choice_option(
    "--by",
    ["action", "hand", "kind"],
    "What sequences are grouped by (default action): pick or put, the reaching hand, or the kind of prime.",
    default="action",
)
@opt.sequence_option("Draw this sequence")
@opt.limit_option("2, 1 and 3 in Figures 1, 2 and 5; all with --train")
@opt.permission_option
@click.option("--nymeria", type=opt.PATH, metavar="DIR", help="The built corpus Nymeria, to pre-train on.")
@click.option("--humanml3d", type=opt.PATH, metavar="DIR", help="The same of HumanML3D (Table 4).")
@opt.path_option(
    "--config",
    "configuration",
    "Configuration of the trainings: paper (default: days on a GPU), small, smoke (seconds; learns nothing,"
    " and its table is stamped so), or a .toml file.",
    default="paper",
    metavar="NAME|FILE",
)
@click.option("--weights", type=opt.PATH, metavar="DIR", help="Weights of prediction by row: no-gaze.safetensors …")
@opt.root_option("Your copy of Nymeria (nymeria-mapping).", required=False)
@click.option("--smpl", type=opt.PATH, metavar="FILE", help="Your SMPL model (.npz), to pose fits of NymeriaPlus with.")
@opt.device_option
@opt.threads_option
@opt.seed_option("of the runs")
@opt.workers_option()
@click.pass_context
def study(ctx: click.Context, item: str, inputs: Paths, train: bool, **given: Any) -> Answer:
    """Make a table or figure of the study from your own tables and runs (docs/study.md).

    DIR are built tables, for ablations the folder of one configuration, such as ablations/paper; RUN are run folders,
    or folders that hold some, such as that of `prbench run --method all`. ITEM is one of:
    """
    row = _ITEMS[item]
    name = f"study {item} --train" if train else f"study {item}"
    if train and row.train is None:
        rows = ", ".join(each for each, about in _ITEMS.items() if about.train)
        raise UsageError(f"study {item} has nothing to train; --train goes with: {rows}.")
    chosen = taken_options(ctx, name, given, row.training if train else row.options)
    if row.train and train:
        if len(chosen["out"]) > 1:
            raise UsageError(f"{name}: expected at most one --out DIR, found {len(chosen['out'])}.")
        session().resumes = True
        folder = chosen["out"][0] if chosen["out"] else Path("ablations")
        return row.train(item, inputs, **chosen | {"out": folder, "configuration": str(chosen["configuration"])})
    if not inputs and "root" not in row.options:
        raise UsageError(f"{name}: name {row.inputs}..., which it is made from.")
    # Refuse files of unknown formats before anything is done.
    from prbench.tables import require_format
    from prbench.viewing.figures import FORMATS, require_drawable

    is_figure = name.startswith("study figure")
    for path in given["numbers"] if is_figure else given["out"]:
        if item != "prediction" or path.suffix.lower() not in FORMATS:
            require_format(path)
    if is_figure:
        if len(given["out"]) != 1:
            raise UsageError(f"{name}: --out FILE is needed, the picture: .png, .svg or .pdf.")
        require_drawable(given["out"][0])
    return row.make(item, inputs, **chosen)
