"""``prbench leaderboard merge``: the runs of all folds as one."""

from __future__ import annotations

from pathlib import Path

import click
import msgspec

from prbench.cli.checked_runs import run_checker, tables_option
from prbench.cli.commands import Answer, command, note
from prbench.cli.options import PATH, out_folder_option, workers_option
from prbench.cli.summaries import DatasetScores, dataset_scores, print_summary


class MergeReport(msgspec.Struct, frozen=True, kw_only=True):
    """The runs of all folds as one.

    Attributes:
        runs: Their folders.
        scores: The merged scores.
        unverified: A sentence for each run whose scores could not be held against the motions.
        out: The folder of the merged run, which `prbench leaderboard export` shows; null if none was asked for.
    """

    runs: list[Path]
    scores: DatasetScores
    unverified: list[str]
    out: Path | None


@command(
    "merge",
    example="prbench leaderboard merge runs/fold-1 runs/fold-2 runs/fold-3 --out runs/folds",
    report=MergeReport,
)
@click.argument("runs", type=PATH, nargs=-1, required=True, metavar="RUN...")
@out_folder_option("Write them as a run folder, which `prbench leaderboard export` and `compare` put beside others.")
@tables_option
@workers_option()
def merge(runs: tuple[Path, ...], out: Path | None, data: tuple[Path, ...], workers: int) -> Answer:
    """Put the scores of a method's runs on the folds of one dataset together.

    The runs are made by `prbench run --split participants --fold K/N`, one for each K.
    """
    from prbench.board.merging import merge_folds

    merged = merge_folds(runs, checker=run_checker(data, workers))
    protocol = merged.folds[0].protocol
    if protocol is not None and protocol.is_own:
        note(f"scored under a protocol of your own, {protocol.label}: no number here is the study's")
    if out is not None:
        merged.write(out)
    method = merged.record.method
    scores = dataset_scores(merged.summary, None, motionless=method.motionless)
    report = MergeReport(runs=list(runs), scores=scores, unverified=list(merged.unverified), out=out)

    def show() -> None:
        print_summary(merged.summary, origin=method.origin, motionless=method.motionless)
        for reason in merged.unverified:
            print(f"unverified: {reason}")
        if out is not None:
            print(f"run folder: {out}")

    return Answer(report, show)
