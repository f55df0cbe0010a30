"""``prbench score``: predictions that lie on disk, against one table or several."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.engines import opened
from prbench.cli.options import (
    CONDITIONS,
    PATH,
    POSITIVE,
    benchmark_option,
    control_option,
    data_option,
    engine_options,
    limit_option,
    out_folder_option,
    protocol_option,
    seed_option,
    split_option,
)
from prbench.cli.progress import progress
from prbench.cli.summaries import print_agreement, print_scene, print_summary
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice
    from prbench.harness.run_folder.agreement import DatasetAgreement
    from prbench.harness.run_folder.summary import DatasetSummary
    from prbench.harness.score_predictions import ScoreReport as Scored


class ScoredMotions(msgspec.Struct, frozen=True, kw_only=True):
    """The finished motions of one dataset.

    Attributes:
        origin: Where the motions come from, in words.
        motionless: They are declared to stand still, so that some metrics, such as Foot Skating, say nothing.
        scores: Their scores, as in ``summary.json``.
        agreement: Agreement with recorded people, and rates by the goal's place; null for futures.
    """

    origin: str
    motionless: bool
    scores: DatasetSummary
    agreement: DatasetAgreement | None


class ScoreReport(msgspec.Struct, frozen=True, kw_only=True):
    """The scores of finished motions.

    Attributes:
        datasets: One entry a dataset.
        out: Folder that the scores were written to; null if nothing was written.
    """

    datasets: list[ScoredMotions]
    out: Path | None


@command(
    "score",
    example="prbench score predictions.npz --conditions conditions.npz --data tables/adt --out scores/mine",
    report=ScoreReport,
)
@click.argument("predictions", type=PATH)
@data_option(required=True)
@click.option(
    "--conditions",
    type=PATH,
    metavar="FILE",
    help="The file of `prbench export-conditions` that the motions were made from; says seed, split, limit, samples and"
    " condition, and is checked.",
)
@click.option("--name", help="Name of the method, for summaries and leaderboards (default: that of the file).")
@split_option(None, help="Split of the table (default: that of the run, else test).")
@limit_option("those of the run or the conditions")
@seed_option("behind the opaque ids, if the predictions have those", default=None)
@click.option("--condition", type=click.Choice(CONDITIONS), help="What the method was given; leaderboards need it.")
@control_option("The method was given other sequences' goals.")
@click.option("--max-frames", type=POSITIVE, metavar="N", help="Longer sequences count as unsupported.")
@click.option(
    "--native-fps", type=float, metavar="F", help="Rate of the motions in frames per second, if not the table's."
)
@click.option(
    "--allow-length-mismatch", is_flag=True, help="Score motions of another length than the recorded one, too."
)
@protocol_option("the numbers of the metrics; the table must have been built by the same rules.")
@out_folder_option("Write scores.parquet, summary.json … into this folder.")
@engine_options()
@benchmark_option
@click.option(
    "--one-design",
    is_flag=True,
    help="The K futures of a window are one design: fewer have no scores (motion-prediction).",
)
def score(
    predictions: Path,
    data: tuple[Path, ...],
    conditions: Path | None,
    name: str | None,
    split: str | None,
    limit: int | None,
    seed: int | None,
    condition: str | None,
    control: str | None,
    max_frames: int | None,
    native_fps: float | None,
    allow_length_mismatch: bool,
    protocol: Path | None,
    out: Path | None,
    engine: EngineChoice,
    benchmark: str | None,
    one_design: bool,
) -> Answer:
    """Score finished motions (Parquet, .npz, motions/*.npy), or a run folder again.

    PREDICTIONS is a run folder; Parquet or .npz with opaque_id (or sequence_id), sample (0 if absent), joints and, in
    .npz, n_frames; or a folder of motions/0000000000.npy, numbered by the rows of --conditions. Of
    motion-prediction it is .npz with opaque_id and joints (windows, samples, frames, joints, 3).
    """
    from prbench.contract import Condition
    from prbench.harness.score_predictions import ScoreRequest, score_predictions
    from prbench.protocol.benchmarks import default_benchmark, find_benchmark

    about = find_benchmark(benchmark or default_benchmark().name)
    if not about.default:
        unknown = {
            "split": split,
            "limit": limit,
            "seed": seed,
            "condition": condition,
            "control": control,
            "max-frames": max_frames,
            "native-fps": native_fps,
            "allow-length-mismatch": allow_length_mismatch or None,
            "protocol": protocol,
        }
        for option, value in unknown.items():
            if value is not None:
                raise UsageError(f"--{option}: the conditions file says it for {about.name}; leave it out.")
        return _futures(predictions, data, conditions, name, one_design=one_design, out=out, engine=engine)
    if one_design:
        raise UsageError("--one-design: belongs to --benchmark motion-prediction; leave it out.")
    request = ScoreRequest(
        predictions=predictions,
        data=data,
        conditions=conditions,
        split=split,
        limit=limit,
        seed=seed,
        condition=Condition(condition) if condition else None,
        control=control,
        max_frames=max_frames,
        native_fps=native_fps,
        name=name,
        allow_length_mismatch=allow_length_mismatch,
        protocol=protocol,
        out=out,
    )
    with progress("scoring") as show:
        scored = score_predictions(
            request,
            engine=opened(engine, reads=(predictions, *data)),
            progress=lambda step: show(step.done, step.total, step.dataset),
        )
    datasets = [
        ScoredMotions(origin=each.origin, motionless=each.motionless, scores=each.summary, agreement=each.agreement)
        for each in scored
    ]
    return Answer(ScoreReport(datasets=datasets, out=out), lambda: _print(scored, out))


def _futures(
    futures: Path,
    data: tuple[Path, ...],
    conditions: Path | None,
    name: str | None,
    *,
    one_design: bool,
    out: Path | None,
    engine: EngineChoice,
) -> Answer:
    """Score the finished futures of a predictor."""
    from prbench.harness.motion_prediction.offline import FuturesRequest, score_futures

    if conditions is None:
        raise UsageError("--conditions FILE: futures are scored with the file of windows that they were made from.")
    request = FuturesRequest(
        futures=futures, conditions=conditions, data=data, name=name, one_design=one_design, out=out
    )
    with progress("scoring") as show:
        scored = score_futures(
            request,
            engine=opened(engine, reads=(futures, conditions, *data)),
            progress=lambda step: show(step.done, step.total, step.dataset),
        )
    made = ScoredMotions(origin=scored.origin, motionless=False, scores=scored.summary, agreement=None)
    report = ScoreReport(datasets=[made], out=out)

    def show_scores() -> None:
        print_summary(scored.summary, origin=scored.origin)
        if out is not None:
            print(f"scores: {out}")

    return Answer(report, show_scores)


def _print(scored: Sequence[Scored], out: Path | None) -> None:
    from prbench.harness.score_predictions import UNSTATED

    for each in scored:
        print_summary(each.summary, origin=each.origin, motionless=each.motionless)
        print_agreement(each.agreement)
        print_scene([each.summary], [each.agreement])
    if out is not None:
        print(f"scores: {out}")
        if any(each.summary.condition == UNSTATED for each in scored):
            print("the condition is not stated (--condition or --conditions): a leaderboard will not rank these scores")
