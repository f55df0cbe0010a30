"""``prbench analyse KIND RUN...``: what the scores of finished runs do not say by themselves."""

from __future__ import annotations

from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, Session, command, progress
from prbench.cli.places import Remote
from prbench.cli.terminal import print_tables
from prbench.entry_points import STUDY_ITEMS, load_built_in
from prbench.errors import UsageError
from prbench_benchmarks.prime_and_reach.study_commands import taken_options

if TYPE_CHECKING:  # help is quick: tables load NumPy
    from prbench.tables import Table


Paths = tuple[Path, ...]


class AnalysisReport(msgspec.Struct, frozen=True, kw_only=True):
    """What was found out.

    Attributes:
        tables: The tables, those of one run one behind the other.
        fan: The picture of diversity; null if none was asked for.
        fan_sequence: Id of the sequence in that picture; null if none was asked for.
        caption: Text below that picture in a paper.
        page: The page of pairs; null if none was asked for.
    """

    tables: list[Table] = []
    fan: Path | None = None
    fan_sequence: str | None = None
    caption: str = ""
    page: Path | None = None


def _answer(report: AnalysisReport, *lines: str) -> Answer:
    def show() -> None:
        print_tables(report.tables)
        for line in lines:
            print(line)

    return Answer(report, show)


def _agreement(runs: Paths, *, data: Paths, workers: int) -> Answer:
    from prbench_benchmarks.prime_and_reach.diversity import agreement_tables

    return _answer(AnalysisReport(tables=agreement_tables(runs, opt.run_checker(data, workers))))


def _diversity(
    runs: Paths, *, data: Paths, fan: Path | None, sequence: str | None, permission: tuple[str, ...]
) -> Answer:
    from prbench.viewing.fan import draw_fan
    from prbench.viewing.figures import require_drawable
    from prbench_benchmarks.prime_and_reach.diversity import measure_diversity, read_fan

    if len(runs) != 1:
        raise UsageError("analyse diversity: name one RUN.")
    if fan is None and sequence is not None:
        raise UsageError("--sequence: belongs to --fan FILE, which it is drawn in.")
    if fan is not None:
        require_drawable(fan)
    drawn = None if fan is None else read_fan(runs[0], data, sequence=sequence, permitted=permission)
    with progress("measuring") as show:
        tables = measure_diversity(runs[0], data, progress=show)
    if fan is None or drawn is None:
        return _answer(AnalysisReport(tables=tables))
    caption = draw_fan(drawn, fan)
    lines = [*([drawn.notice] if drawn.notice else []), f"caption: {caption}", f"fan: {fan} ({drawn.sequence_id})"]
    return _answer(AnalysisReport(tables=tables, fan=fan, fan_sequence=drawn.sequence_id, caption=caption), *lines)


def _tables(target: str, runs: Paths, *, data: Paths, **options: Any) -> Answer:
    """Answer with the tables that a function of this package, ``module:function``, measures anew."""
    module, _, name = target.partition(":")
    with progress("measuring") as show:
        make = getattr(import_module(f"{__package__}.{module}"), name)
        return _answer(AnalysisReport(tables=make(runs, data, progress=show, **options)))


def _pairs(
    runs: Paths, *, data: Paths, out: Path | None, pairs: int | None, seed: int, permission: tuple[str, ...]
) -> Answer:
    from prbench.harness.run_folder import RunFolder
    from prbench.viewing.pairs import KEY, PAGE
    from prbench_benchmarks.prime_and_reach.telling_apart import write_pairs_of_run

    if out is None:
        raise UsageError("analyse pairs: with --out DIR name the folder that gets the page and its key.")
    settings: dict[str, Any] = {"seed": seed, "permitted": permission}
    if pairs is not None:
        settings["pairs"] = pairs
    if RunFolder.open(runs[0], any_benchmark=True).record.benchmark == "motion-prediction":
        key = load_built_in(STUDY_ITEMS, "prediction-pairs")(runs, data, out, **settings)
    elif len(runs) != 1:
        raise UsageError("analyse pairs: name one RUN, or two of motion prediction.")
    else:
        key = write_pairs_of_run(runs[0], data, out, **settings)
    asked = f"{len(key.pairs)} pairs, {len(key.numbered)} questions"
    lines = f"page: {out / PAGE} ({asked})", f"key: {out / KEY} (keep it; hand out the page alone)"
    return _answer(AnalysisReport(page=out / PAGE), *lines)


def _answers(paths: Paths) -> Answer:
    from prbench.viewing.pairs import answers_table, read_key

    if len(paths) < 2:
        raise UsageError("analyse answers: name the DIR that `analyse pairs` has written, and FILE... of answers.")
    of_predictors = read_key(paths[0]).benchmark == "motion-prediction"
    count = load_built_in(STUDY_ITEMS, "prediction-answers") if of_predictors else answers_table
    return _answer(AnalysisReport(tables=[count(paths[0], paths[1:])]))


def _people(tables: Paths, *, seed: int, count: int) -> Answer:
    from prbench_benchmarks.prime_and_reach.people import people_table

    return _answer(AnalysisReport(tables=[people_table(tables, seed=seed, recordings=count)]))


# The function of each kind, and the options that it takes.
_KINDS = {
    "agreement": (_agreement, ("data", "workers")),
    "answers": (_answers, ()),
    "causes": (partial(_tables, "telling_apart:causes_tables"), ("data", "by")),
    "distributions": (partial(_tables, "distributions:distribution_tables"), ("data",)),
    "diversity": (_diversity, ("data", "fan", "sequence", "permission")),
    "pairs": (_pairs, ("data", "out", "pairs", "seed", "permission")),
    "people": (_people, ("seed", "count")),
    "tell-apart": (partial(_tables, "telling_apart:tell_apart_table"), ("data",)),
}


def _out(ctx: click.Context, _parameter: click.Parameter, value: Any) -> Any:
    """Return the folder of pairs; of other kinds, leave the file to the session, which writes the report into it."""
    if ctx.params.get("kind") == "pairs":
        return Remote(value.url, "folder") if isinstance(value, Remote) else value
    if isinstance(value, Path) and value.is_dir():
        raise click.BadParameter(f"{value} is a directory.")
    ctx.ensure_object(Session).report_file = value
    return None


@command(
    "analyse",
    section="board",
    example="prbench analyse diversity runs/pr --data tables/adt --fan fan.png",
    report=AnalysisReport,
)
@click.argument("kind", type=click.Choice(list(_KINDS)), metavar="KIND", is_eager=True)
@click.argument("runs", type=opt.PATH, nargs=-1, metavar="RUN...")
@opt.data_option(
    required=False, help="Tables of the runs, on which their scores are checked; the embedded ones are known."
)
@opt.option(
    "--fan",
    "Of diversity: draw the motions of one sequence as a fan of bodies: .png, .svg.",
    type=opt.OUT_FILE,
    metavar="FILE",
)
@click.option(
    "--sequence", metavar="ID", help="The sequence to draw: its id, or a part that fits one only (default: any)."
)
@opt.choice_option("--by", ("layout", "limit"), "Of causes: the flags on each table, or each limit.")
@click.option(
    "--out",
    type=opt.OUT_FILE,
    callback=_out,
    metavar="FILE|DIR",
    help="Of pairs: the folder of the page. Of others: write the report as JSON to this file, too.",
)
@opt.number_option("--pairs", "Of pairs: most pairs, of each table as many (default 60; of two RUNs 16).")
@opt.seed_option("of the pairs, their order and sides, or of acted people")
@opt.permission_option
@opt.number_option("--count", "Of people: acted recordings a layout (default 4).", default=4)
@opt.workers_option()
@click.pass_context
def analyse(ctx: click.Context, kind: str, runs: Paths, **given: Any) -> Answer:
    """Say on which sequences methods succeed, how their motions are distributed, and how far they differ.

    agreement: on which sequences methods succeed: those of recorded people, and by where the goal is.

    causes: what keeps motions from being plausible, a column a run (docs/specification/metrics.md#plausible).

    distributions: how twelve features of the motions (speeds, steps, timing, posture) are distributed, beside recorded
    people's of the same sequences (docs/specification/metrics.md#distributions).

    diversity: how far several motions for one goal differ in poses, path and timing, beside recorded people; RUN is one
    run with --samples 2 or more (docs/diversity.md).

    pairs: a page on which people choose between RUN's motion and the recorded one, or between the futures of two RUNs
    of motion prediction; answers: what the saved files say (analyse answers DIR FILE...); tell-apart: how well a
    classifier tells motions from recorded ones (docs/telling-apart.md).

    people: how people look, reach and walk beside what others measured (docs/specification/people.md): those of tables
    in place of RUN, else synthetic ones from --seed, as they were acted out at 120 frames a second.
    """
    make, taken = _KINDS[kind]
    if not runs and kind != "people":
        raise UsageError(f"analyse {kind}: name one RUN or more.")
    if "out" not in taken:
        del given["out"]
    return make(runs, **taken_options(ctx, f"analyse {kind}", given, taken))
