"""``prbench score``, ``export-conditions`` and ``merge``: what lies on disk against tables, exchanged, put together."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli import summaries
from prbench.cli.builds import BuildsReport, table_answer
from prbench.cli.commands import Answer, command, note, progress
from prbench.entry_points import CORPORA, STUDY_ITEMS, load_built_in
from prbench.errors import UsageError
from prbench.protocol.manifests import default_benchmark, find_benchmark

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice
    from prbench.harness.request import Progress
    from prbench.harness.run_folder.summary import DatasetAgreement, DatasetSummary
    from prbench.viewing.player.links import SequenceScores


class ScoredMotions(msgspec.Struct, frozen=True, kw_only=True):
    """The finished motions of one dataset.

    Attributes:
        origin: Origin of the motions, in words.
        motionless: They are declared to stand still, so that some metrics, such as Foot Skating, say nothing.
        scores: Their scores, as in ``summary.json``.
        agreement: Agreement with recorded people, and rates by the goal's place; null for futures.
        sequences: Every sequence with its scores and the link to its motion, the worst first; empty for futures.
    """

    origin: str
    motionless: bool
    scores: DatasetSummary
    agreement: DatasetAgreement | None
    sequences: list[SequenceScores] = []


_SCORE = "prbench score predictions.npz --conditions conditions.npz --data tables/adt --out scores/mine"
_CONDITIONS = "The file of `prbench export-conditions` that the motions were made from; says seed, split, limit,"
_CONDITIONS += " samples and condition, and is checked."


@command("score", example=_SCORE, report=[ScoredMotions])
@click.argument("predictions", type=opt.PATH)
@opt.data_option(required=True)
@opt.path_option("--conditions", _CONDITIONS)
@click.option("--name", help="Name of the method, for summaries and leaderboards (default: that of the file).")
@opt.split_option(None, help="Split of the table (default: that of the run, else test).")
@opt.fold_option
@opt.limit_option("those of the run or the conditions")
@opt.seed_option("behind the opaque ids, if the predictions have those", default=None)
@click.option("--condition", type=click.Choice(opt.CONDITIONS), help="What the method was given; leaderboards need it.")
@opt.control_option("The method was given other sequences' goals.")
@opt.number_option("--max-frames", "Longer sequences count as unsupported.")
@opt.option("--native-fps", "Rate of the motions in frames per second, if not the table's.", type=float, metavar="F")
@opt.flag("--allow-length-mismatch", "Score motions of another length than the recorded one, too.")
@opt.protocol_option("the numbers of the metrics; the table must have been built by the same rules.")
@opt.out_folder_option("Write scores.parquet, summary.json … into this folder.")
@opt.flag("--keep-motions", "Keep the motions there, too, so that `prbench leaderboard submit` can pack them.")
@opt.signed_option
@opt.engine_options()
@opt.benchmark_option
@opt.scores_options
@opt.flag("--one-design", "The K futures of a window are one design: fewer have no scores (motion-prediction).")
def score(
    *,
    predictions: Path,
    data: tuple[Path, ...],
    conditions: Path | None,
    out: Path | None,
    engine: EngineChoice,
    benchmark: str | None,
    one_design: bool,
    fold: str | None,
    require_signed: Path | None,
    **given: Any,
) -> Answer:
    """Score finished motions (Parquet, .npz), or a run folder again.

    PREDICTIONS is a run folder, or Parquet or .npz with opaque_id (or sequence_id), sample (0 if absent), joints and,
    in .npz, n_frames. Of motion-prediction it is .npz with opaque_id and joints (windows, samples, frames, joints, 3).
    """
    from prbench.contract import Condition
    from prbench.harness.benchmark import load_benchmark
    from prbench.harness.run_folder import RunFolder, signature
    from prbench.harness.run_folder.folder import run_folder_of
    from prbench.harness.run_folder.record import FILE_NAME as RUN_FILE
    from prbench.harness.score_predictions import ScoreRequest, score_predictions
    from prbench.sequences.folds import fold_tables
    from prbench.viewing.player.links import sequence_scores

    folder = run_folder_of(predictions)
    is_run = (folder / RUN_FILE).is_file()
    if require_signed is not None:
        run = RunFolder.open(folder, any_benchmark=True)
        note(f"signed by {signature.require_signed([run], require_signed)}")
    elif (folder / signature.SIGNATURE).is_file():
        note("the run is signed; --require-signed PUBLIC_KEY finds out by whom, and whether it was changed.")
    data = fold_tables(data, fold)
    shared: dict[str, Any] = {"conditions": conditions, "data": data, "name": given.pop("name"), "out": out}
    about = find_benchmark(benchmark or default_benchmark().name)
    if about.default:
        if one_design:
            raise UsageError("--one-design: belongs to --benchmark motion-prediction; leave it out.")
        condition = given.pop("condition")
        stated = Condition(condition) if condition else None
        request = ScoreRequest(predictions=predictions, condition=stated, **shared, **given)
        with progress("scoring") as show:
            scored = score_predictions(
                request,
                engine=opt.opened(engine, reads=(predictions, *data)),
                progress=lambda step: show(step.done, step.total, step.dataset),
            )
        for each in scored:
            if each.changed:
                note(f"changed: {each.changed}")
        made = []
        for each in scored:
            sequences = sequence_scores(each.coded, each.summary.dataset, data, linked=is_run)
            own = {"scores": each.summary, "agreement": each.agreement, "sequences": sequences}
            made.append(ScoredMotions(origin=each.origin, motionless=each.motionless, **own))
    else:
        for name in (name for name, value in given.items() if value is not None and value is not False):
            option = name.replace("_", "-")
            raise UsageError(f"--{option}: the conditions file says it for {about.name}; leave it out.")
        if conditions is None:
            raise UsageError("--conditions FILE: futures are scored with the file of windows that they were made from.")
        with progress("scoring") as show:
            summary, origin = load_benchmark(about.name).offline.score_futures(
                predictions,
                one_design=one_design,
                **shared,
                engine=opt.opened(engine, reads=(predictions, conditions, *data)),
                progress=lambda step: show(step.done, step.total, step.dataset),
            )
        made = [ScoredMotions(origin=origin, motionless=False, scores=summary, agreement=None)]

    def show_scores() -> None:
        from prbench.harness.score_predictions import UNSTATED

        for each in made:
            metrics = load_benchmark(about.name).metrics
            summaries.print_summary(each.scores, origin=each.origin, motionless=each.motionless, metrics=metrics)
            summaries.print_agreement(each.agreement)
            summaries.print_worst(each.sequences, folder if is_run else None, data)
        if out is not None:
            print(f"scores: {out}")
            if any(each.scores.condition == UNSTATED for each in made):
                unstated = "the condition is not stated (--condition or --conditions)"
                print(f"{unstated}: a leaderboard will not rank these scores")
        summaries.print_findings([each.scores for each in made])

    return Answer(made, show_scores, summaries.exit_code_of([each.scores for each in made]))


_EXPORT_CONDITIONS = "prbench export-conditions --data tables/adt --condition goal-loc --seed 0 --out conditions.npz"
_CONDITION = f"What the method is given: {opt.conditions_by_benchmark()}."
_SAMPLES = f"Answers to each case (default {opt.usual_number('samples')})."
_NATIVE_FPS = "Ask for motions at F frames per second; scoring resamples them to the table's rate."


@command("export-conditions", example=_EXPORT_CONDITIONS, report="prbench.harness.offline:ExportReport")
@opt.data_option(required=True)
@opt.benchmark_option
@click.option("--condition", type=click.Choice(opt.ALL_CONDITIONS), metavar="CONDITION", required=True, help=_CONDITION)
@opt.out_file_option(".npz", required=True)
@opt.seed_option("behind opaque ids and noise seeds")
@click.option("--samples", type=opt.POSITIVE, metavar="K", help=_SAMPLES)
@opt.split_option()
@opt.fold_option
@opt.limit_option()
@opt.number_option("--max-frames", "Leave out sequences of more than N frames; scoring counts them as unsupported.")
@click.option("--native-fps", type=float, metavar="F", help=_NATIVE_FPS)
@opt.control_option("Give every sequence another one's goal; the file does not tell.")
@opt.permission_option
def export_conditions(*, data: tuple[Path, ...], benchmark: str | None, fold: str | None, **given: Any) -> Answer:
    """Write exactly what a method may see, for one that runs elsewhere.

    `prbench score` takes the motions that the method makes from it.
    """
    from prbench.contract import Condition
    from prbench.harness.benchmark import load_benchmark
    from prbench.harness.offline import ExportRequest
    from prbench.harness.offline import export_conditions as export
    from prbench.sequences.folds import fold_tables

    about = find_benchmark(benchmark or default_benchmark().name)
    condition = given.pop("condition")
    load_benchmark(about.name).condition(condition)  # which refuses one of another benchmark
    own = {name: given.pop(name) for name in ("max_frames", "native_fps", "control")}
    given |= {"samples": given["samples"] or about.samples, "permitted": given.pop("permission")}
    given["data"] = fold_tables(data, fold)
    if about.default:
        report = export(ExportRequest(condition=Condition(condition), **own, **given))
    else:
        for option in (name.replace("_", "-") for name, value in own.items() if value is not None):
            raise UsageError(f"--{option}: the benchmark {about.name} does not have it; leave it out.")
        report = load_benchmark(about.name).offline.export_windows(condition=condition, **given)
    answers = "PREDICTIONS" if about.default else "FUTURES.npz"
    note(f"then: prbench score {answers} --conditions {shlex.quote(str(report.out))} --data …")

    def show() -> None:
        case = "sequences" if about.default else "windows"
        for dataset, count in report.sequences.items():
            longer = report.left_out.get(dataset, 0)
            print(f"{dataset}: {count} {case}{f' ({longer} longer ones left out)' if longer else ''}")
        for line in report.notices:
            print(f"notice: {line}")
        print(f"{report.rows} motions to generate: {report.out}")

    return Answer(report, show)


_MERGE = "prbench merge shards/adt-* --out tables/adt"
_DATA = "Tables of a run, where they no longer lie where its shards found them; of runs on folds, the tables on which"
_DATA += " their scores are checked."


@command("merge", example=_MERGE, report={"of tables": BuildsReport, "of runs": summaries.RunAnswer}, resumes=True)
@click.argument("parts", type=opt.PATH, nargs=-1, required=True, metavar="DIR...")
@opt.out_folder_option("Folder of the table, corpus, windows or run.", required=True)
@opt.data_option(required=False, help=_DATA)
@opt.replace_option("table or corpus")
@opt.workers_option(help="Processes that score a run (default 1); changes no result.")
@opt.scores_options
def merge(parts: tuple[Path, ...], out: Path, data: tuple[Path, ...], replace: bool, workers: int) -> Answer:
    """Put the shards of a build or run together, with the bytes of an unsharded one, or runs on folds as one run.

    DIR... are the folders of all shards of one `prbench build-dataset`, `build-corpus`, `build-windows` or `run` with
    --shard K/N, in any order, of which a run is scored here; or the runs of a method on all folds of a dataset, made by
    `prbench run --fold K/N`.
    """
    from prbench.engine.shards import FILE_NAME, require_whole
    from prbench.harness.run_folder.folder import run_folder_of
    from prbench.harness.run_folder.record import FILE_NAME as RUN_FILE

    if (run_folder_of(parts[0]) / RUN_FILE).is_file() and not (parts[0] / FILE_NAME).is_file():
        if replace:
            raise UsageError("--replace: belongs to a dataset or corpus; these are runs on folds. Leave it out.")
        from prbench.board.merging import merge_folds
        from prbench.harness.run import RunReport
        from prbench.harness.run_folder import RunFolder

        merged = merge_folds(parts, checker=opt.run_checker(data, workers))
        protocol = merged.folds[0].protocol
        if protocol is not None and protocol.is_own:
            note(f"scored under a protocol of your own, {protocol.label}: no number here is the study's")
        for reason in merged.unverified:
            note(f"unverified: {reason}")
        merged.write(out)
        folds = RunReport(RunFolder.open(out), (merged.summary,), batches_made=0, batches_found=0)
        return summaries.run_answer([folds], single=False, data=data)
    if out.resolve() in [folder.resolve() for folder in parts]:
        raise UsageError(f"--out {out}: is one of the shards. Choose another folder.")
    opened = require_whole(parts)
    kind = opened[0][1].kind
    if data and kind != "run":
        raise UsageError(f"--data: belongs to shards of a run; these are of a {kind}. Leave it out.")
    if replace and kind not in ("dataset", "corpus"):
        raise UsageError(f"--replace: belongs to a dataset or corpus; these are shards of a {kind}. Leave it out.")
    if kind == "dataset":
        from prbench.curation.build import merge_dataset_shards

        return table_answer(merge_dataset_shards(opened, out, replace=replace))
    if kind == "corpus":
        return load_built_in(CORPORA, "merge")(opened, out, replace=replace)
    if kind == "windows":
        return load_built_in(STUDY_ITEMS, "merged-windows")(opened, out)
    from prbench.engine import engine_for
    from prbench.harness.sharded import merge_run_shards

    with progress("merging") as tell:

        def told(step: Progress) -> None:
            tell(step.done, step.total, f"{step.stage} {step.dataset}")

        run = merge_run_shards(opened, out, data=data, engine=engine_for(workers), progress=told)
    return summaries.run_answer([run], single=bool(run.folder.record.sequences), data=data)
