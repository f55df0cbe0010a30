"""``prbench score``: predictions that lie on disk, against a table."""

from __future__ import annotations

import argparse
from pathlib import Path

from prbench.cli.arguments import add_workers, command, positive
from prbench.cli.progress import progress
from prbench.cli.summaries import print_summary


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "score",
        summary="score a finished predictions file, or a run folder again",
        example="prbench score predictions.parquet --data tables/adt --out scores/mine",
        execute=_score,
    )
    parser.add_argument(
        "predictions",
        type=Path,
        help="a run folder, or Parquet with sequence_id (or opaque_id), sample (0 if absent) and joints (n × 66)",
    )
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="built dataset folder")
    parser.add_argument("--split", choices=["train", "validation", "test"], help="default: that of the run, else test")
    parser.add_argument("--limit", type=positive, metavar="N", help="the predictions cover only these N sequences")
    parser.add_argument("--seed", type=int, default=0, help="behind the opaque ids, if the predictions have those")
    parser.add_argument(
        "--allow-length-mismatch", action="store_true", help="score motions of another length than the recorded one"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write scores.parquet and summary.json there")
    add_workers(parser)


def _score(arguments: argparse.Namespace) -> int:
    from prbench.engine import engine_for
    from prbench.evaluation.score_predictions import ScoreRequest, score_predictions

    request = ScoreRequest(
        predictions=arguments.predictions,
        data=arguments.data,
        split=arguments.split,
        limit=arguments.limit,
        seed=arguments.seed,
        allow_length_mismatch=arguments.allow_length_mismatch,
        out=arguments.out,
    )
    with progress("scoring") as show:
        report = score_predictions(
            request,
            engine=engine_for(arguments.workers),
            progress=lambda step: show(step.done, step.total, step.dataset),
        )
    print_summary(report.summary, motionless=report.motionless)
    if report.folder is not None:
        print(f"scores: {report.folder}")
    return 0
