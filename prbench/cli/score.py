"""``prbench score``: predictions that lie on disk, against one table or several."""

from __future__ import annotations

import argparse
from pathlib import Path

from prbench.cli.arguments import CONDITIONS, add_data, add_limit, add_workers, command, positive
from prbench.cli.progress import progress
from prbench.cli.summaries import print_summary


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "score",
        summary="score finished motions (Parquet, .npz, motions/*.npy), or a run folder again",
        example="prbench score predictions.npz --conditions conditions.npz --data tables/adt --out scores/mine",
        execute=_score,
    )
    parser.add_argument(
        "predictions",
        type=Path,
        help="a run folder; Parquet or .npz with opaque_id (or sequence_id), sample (0 if absent), joints and, in .npz,"
        " n_frames; or a folder of motions/0000000000.npy, numbered by the rows of --conditions",
    )
    add_data(parser, required=True)
    parser.add_argument(
        "--conditions",
        type=Path,
        metavar="FILE",
        help="of `prbench export-conditions`; says seed, split, limit, samples and condition, and is checked",
    )
    parser.add_argument("--name", help="of the method, for summaries and leaderboards (default: that of the file)")
    parser.add_argument("--split", choices=["train", "validation", "test"], help="default: that of the run, else test")
    add_limit(parser, default="those of the run or the conditions")
    parser.add_argument("--seed", type=int, help="behind the opaque ids, if the predictions have those (default 0)")
    parser.add_argument("--condition", choices=CONDITIONS, help="what the method was given; leaderboards need it")
    parser.add_argument("--control", choices=["shuffled-goal"], help="the method was given other sequences' goals")
    parser.add_argument("--max-frames", type=positive, metavar="N", help="longer sequences count as unsupported")
    parser.add_argument("--native-fps", type=float, metavar="F", help="rate of the motions, if not the table's")
    parser.add_argument(
        "--allow-length-mismatch", action="store_true", help="score motions of another length than the recorded one"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write scores.parquet, summary.json … there")
    add_workers(parser)


def _score(arguments: argparse.Namespace) -> int:
    from prbench.contract import Condition
    from prbench.engine import engine_for
    from prbench.submitted.score_predictions import UNSTATED, ScoreRequest, score_predictions

    request = ScoreRequest(
        predictions=arguments.predictions,
        data=tuple(arguments.data),
        conditions=arguments.conditions,
        split=arguments.split,
        limit=arguments.limit,
        seed=arguments.seed,
        condition=Condition(arguments.condition) if arguments.condition else None,
        control=arguments.control,
        max_frames=arguments.max_frames,
        native_fps=arguments.native_fps,
        name=arguments.name,
        allow_length_mismatch=arguments.allow_length_mismatch,
        out=arguments.out,
    )
    with progress("scoring") as show:
        reports = score_predictions(
            request,
            engine=engine_for(arguments.workers),
            progress=lambda step: show(step.done, step.total, step.dataset),
        )
    for report in reports:
        print_summary(report.summary, origin=report.origin, motionless=report.motionless)
    if arguments.out is not None:
        print(f"scores: {arguments.out}")
        if any(report.summary.condition == UNSTATED for report in reports):
            print("the condition is not stated (--condition or --conditions): a leaderboard will not rank these scores")
    return 0
