"""``prbench leaderboard submit`` and ``verify``: runs in one file, which whoever has the data scores again."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, session
from prbench.cli.terminal import print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.board.verifying import Verification


@command(
    "submit",
    example="prbench leaderboard submit runs/mine --out mine.prbench.zip --name Mine --author 'A. B.' --trained-on adt",
    report="prbench.board.submission:Submission",
)
@click.argument("runs", type=opt.PATH, nargs=-1, required=True, metavar="RUN...")
@opt.out_file_option("Write the submission to this file.", required=True)
@click.option("--name", required=True, help="Name of the submission, as boards show it.")
@click.option("--author", "authors", multiple=True, help="An author of the method; repeatable.")
@click.option("--contact", help="How to reach the authors.")
@click.option("--url", help="Page of the method.")
@click.option("--paper", help="Address of the paper.")
@click.option("--code", help="Address of the code.")
@opt.path_option("--training", "TOML file that declares what the methods learned from (docs/leaderboard.md).")
@click.option(
    "--trained-on",
    multiple=True,
    metavar="DATASET[:DETAIL]",
    help="Declares it in short: `none`, or a dataset with a split (default train), `all`, or participants separated by"
    " commas; repeatable.",
)
@opt.permission_option
@opt.tables_option
@opt.workers_option()
def submit(
    runs: tuple[Path, ...],
    out: Path,
    data: tuple[Path, ...],
    workers: int,
    training: Path | None,
    trained_on: tuple[str, ...],
    permission: tuple[str, ...],
    **about: Any,
) -> Answer:
    """Pack finished runs into one file that anybody with the data can verify.

    RUN are run folders, or folders that hold some. With --data their scores are held against the motions first, and
    the recordings that training used are listed by their digests.
    """
    from prbench.board.submission import pack, read_training
    from prbench.board.submission import trained_on as declared_on

    if training is not None and trained_on:
        raise UsageError("--trained-on: --training says the same. Leave one of the two out.")
    declared = None
    if training is not None:
        declared = read_training(training)
    elif trained_on:
        declared = declared_on(trained_on)
    checker = opt.run_checker(data, workers)
    submission = pack(runs, out, checker=checker, permitted=permission, training=declared, **about)

    def show() -> None:
        print(
            f"{len(submission.runs)} runs, {len(submission.members)} files; training data: {submission.training_words}"
        )
        print(f"submission {submission.id}: {out}")

    return Answer(submission, show)


@command(
    "verify",
    example="prbench leaderboard verify mine.prbench.zip --data tables",
    report="prbench.board.verifying:Verification",
)
@click.argument("file", type=opt.PATH)
@opt.data_option(required=True, help="Your own tables of the datasets, or a folder of such.")
@opt.workers_option()
def verify(file: Path, data: tuple[Path, ...], workers: int) -> Answer:
    """Score a submission again from its motions, on tables of the same sequences, and refuse what does not follow."""
    from prbench.board.submission import open_submission
    from prbench.board.verifying import verify_submission
    from prbench.engine import engine_for

    with tempfile.TemporaryDirectory(prefix="prbench-submission-") as place:
        folder = Path(place) / "submission"
        submission = open_submission(file, folder)
        verification = verify_submission(submission, folder, data, engine=engine_for(workers))
    return Answer(verification, lambda: _print_verification(verification))


def _print_verification(found: Verification) -> None:
    from prbench.metrics.registry import printed_scale, printed_unit

    header = ("run", "dataset", "metric", "stored", "scored again", "drift")
    rows = []
    for each in found.datasets:
        for drift in each.metrics:
            if drift.drift or session().verbose:
                numbers = (drift.stored, drift.rescored, drift.drift)
                shown = (f"{number * printed_scale(drift.unit):.3f}" for number in numbers)
                rows.append((each.run, each.dataset, f"{drift.title}{printed_unit(drift.unit)}", *shown))
    if rows:
        print_table("metrics of which tables of other values give other scores", header, rows, numbers=(3, 4, 5))
    print(f"training data: {found.training}")
    print(f"{found.submission}: {found.verdict}.")
