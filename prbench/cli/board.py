"""``prbench leaderboard submit`` and ``verify``: runs in one file, which whoever has the data scores again.

``init``, ``add``, ``withdraw``, ``history``, ``build``, ``check`` and ``cite``: a board of such files in a folder.
"""

from __future__ import annotations

import datetime
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, note, session
from prbench.cli.terminal import print_table
from prbench.engine import InProcess, engine_for
from prbench.protocol.manifests import default_benchmark

if TYPE_CHECKING:
    from prbench.board.verifying import Verification


_SUBMIT = "prbench leaderboard submit runs/mine --out mine.prbench.zip --name Mine --author 'A. B.' --trained-on adt"
_TRAINED_ON = "What the methods learned from: `none`; a dataset with a split (default train), `all`, or participants"
_TRAINED_ON += " separated by commas, repeatable; or a TOML file (docs/leaderboard.md)."


@command("submit", example=_SUBMIT, report="prbench.board.submission:Submission")
@click.argument("runs", type=opt.PATH, nargs=-1, required=True, metavar="RUN...")
@opt.out_file_option("Write the submission to this file.", required=True)
@click.option("--name", required=True, help="Name of the submission, as boards show it.")
@click.option("--author", "authors", multiple=True, help="An author of the method; repeatable.")
@click.option("--contact", help="How to reach the authors.")
@click.option("--url", help="Page of the method.")
@click.option("--paper", help="Address of the paper.")
@click.option("--code", help="Address of the code.")
@click.option("--trained-on", multiple=True, metavar="DATASET[:DETAIL]", help=_TRAINED_ON)
@opt.permission_option
@opt.tables_option
@opt.workers_option()
def submit(runs: tuple[Path, ...], out: Path, data: tuple[Path, ...], workers: int, **given: Any) -> Answer:
    """Pack finished runs into one file that anybody with the data can verify.

    RUN are run folders, or folders that hold some. With --data their scores are held against the motions first, and
    the recordings that training used are listed by their digests.
    """
    from prbench.board.submission import declared_training, pack

    texts = given.pop("trained_on")
    given |= {"training": declared_training(texts) if texts else None, "permitted": given.pop("permission")}
    submission = pack(runs, out, checker=opt.run_checker(data, workers), **given)

    counts = f"{len(submission.runs)} runs, {len(submission.members)} files"
    text = f"{counts}; training data: {submission.training_words}\nsubmission {submission.id}: {out}"
    return Answer(submission, lambda: print(text))


_VERIFY = "prbench leaderboard verify mine.prbench.zip --data tables"


@command("verify", example=_VERIFY, report="prbench.board.verifying:Verification")
@click.argument("file", type=opt.PATH)
@opt.data_option(required=True, help="Your own tables of the datasets, or a folder of such.")
@opt.workers_option()
def verify(file: Path, data: tuple[Path, ...], workers: int) -> Answer:
    """Score a submission again from its motions, on tables of the same sequences, and refuse what does not follow."""
    from prbench.board.submission import open_submission
    from prbench.board.verifying import verify_submission

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


_BOARD = click.argument("board", type=opt.LOCAL_PATH, metavar="BOARD")
_DATE = click.option(
    "--date",
    type=click.DateTime(["%Y-%m-%d"]),
    default=lambda: str(datetime.date.today()),
    callback=lambda _ctx, _param, day: str(day.date()),
    metavar="YYYY-MM-DD",
    help="Day in the history (default: today).",
)


_INIT = "prbench leaderboard init board --title 'Reach 2026' --contact reach@example.org --data tables"


@command("init", example=_INIT, report="prbench.board.folder:BoardInfo")
@click.argument("board", type=opt.LOCAL_PATH, metavar="DIR")
@click.option("--title", default="Leaderboard", help="Title of the board.")
@click.option("--url", default="", help="Where it is going to be read.")
@click.option("--contact", default="", help="Whom to write to.")
@click.option("--maintainer", "maintainers", multiple=True, help="A name to cite; repeatable.")
@click.option("--licence", default="CC BY 4.0", help="Licence of submissions (default CC BY 4.0).")
@opt.benchmark_option
@opt.data_option(required=False, help="Tables to compare methods on; without it the embedded synthetic ones.")
def init(board: Path, data: tuple[Path, ...], benchmark: str | None, **about: Any) -> Answer:
    """Begin a board: its rules, a README, and what GitHub needs to take and check submissions.

    DIR may be a clone of a repository; its files stay as they are.
    """
    from prbench.board.upkeep import begin_board

    tables = data or opt.embedded_tables(InProcess())
    info = begin_board(board, tables, benchmark=benchmark or default_benchmark().name, **about).info
    say_what_licences_keep(info.datasets)
    return Answer(info, lambda: print(f"board: {board}, of {', '.join(each.dataset for each in info.datasets)}"))


_ADD = "prbench leaderboard add board mine.prbench.zip --data tables"


@command("add", example=_ADD, report="prbench.board.folder:HistoryEntry")
@_BOARD
@click.argument("file", type=opt.PATH)
@opt.data_option(required=False, help="Your own tables; the embedded ones need not be named.")
@_DATE
@click.option("--reason", default="", help="Why a withdrawn submission comes back; stays in the history.")
@opt.workers_option()
def add(board: Path, file: Path, data: tuple[Path, ...], workers: int, **given: str) -> Answer:
    """Verify a submission, put it on a board, and make the pages again."""
    from prbench.board.upkeep import add_submission

    entry, found = add_submission(board, file, data, engine=engine_for(workers), **given)
    text = f"training data: {found.training}\n{entry.id}: {found.verdict}.\nadded to {board}"
    return Answer(entry, lambda: print(text))


_WITHDRAW = "prbench leaderboard withdraw board mine-0a1b2c3d4e --reason 'trained on test recordings'"


@command("withdraw", example=_WITHDRAW, report="prbench.board.folder:HistoryEntry")
@_BOARD
@click.argument("name", metavar="ID|NAME")
@click.option("--reason", required=True, help="Why; stays in the history and on the page.")
@_DATE
def withdraw(board: Path, name: str, **given: str) -> Answer:
    """Take a submission from a board: its motions go, its line and the reason stay."""
    from prbench.board.upkeep import withdraw_submission

    entry = withdraw_submission(board, name, **given)
    return Answer(entry, lambda: print(f"{entry.id}: withdrawn on {entry.date}: {entry.reason}"))


@command("history", example="prbench leaderboard history board", report=["prbench.board.folder:HistoryEntry"])
@_BOARD
def history(board: Path) -> Answer:
    """Print what was added to a board and withdrawn from it."""
    from prbench.board.folder import BoardFolder

    entries = list(BoardFolder.open(board).history)
    header = ("date", "action", "id", "name", "reason")
    rows = [tuple(getattr(each, name) for name in header) for each in entries]
    return Answer(entries, lambda: print_table(str(board), header, rows))


@command("build", example="prbench leaderboard build board", report="prbench.board.folder:BoardInfo")
@_BOARD
def build(board: Path) -> Answer:
    """Make the pages of a board again from its submissions alone; they are the same on every machine."""
    from prbench.board.upkeep import build_board

    made = build_board(board)
    say_what_licences_keep(made.info.datasets)
    return Answer(made.info, lambda: print(f"board: {board}, submissions: {len(made.standing)}"))


@command("check", example="prbench leaderboard check board --against base", report="prbench.board.upkeep:BoardCheck")
@_BOARD
@opt.path_option("--against", "The board before a change: its history may only have grown.", metavar="DIR")
@opt.data_option(required=False, help="Your own tables: submissions on them are scored again.")
@opt.workers_option()
def check(board: Path, against: Path | None, data: tuple[Path, ...], workers: int) -> Answer:
    """Look for anything on a board that no command has put there; what a pull request's workflow runs.

    Files, digests, history, licences and pages are compared. Scores are held against motions with --data alone.
    """
    from prbench.board.upkeep import check_board

    found = check_board(board, against=against, data=data, engine=engine_for(workers))
    lines = [f"! {problem}" for problem in found.problems]
    lines += [f"? {name}: new, and not scored again here: name its tables with --data" for name in found.believed]
    lines += [f"submissions: {found.submissions}, withdrawn: {found.withdrawn}, scored again: {len(found.rescored)}"]
    lines += [f"{board}: {len(found.problems)} problems" if found.problems else f"{board}: sound"]
    return Answer(found, lambda: print("\n".join(lines)), 1 if found.problems else 0)


@command("cite", example="prbench leaderboard cite board", report="prbench.board.pages:BoardCitation")
@_BOARD
@opt.choice_option("--format", ["bibtex", "apa", "cff"], "BibTeX (default), APA or CITATION.cff.", default="bibtex")
def cite(board: Path, format: str) -> Answer:
    """Print how to cite a board, its benchmark and its datasets, and the papers that its entries declare."""
    from prbench.board.folder import BoardFolder
    from prbench.board.pages import cite_board

    found = cite_board(BoardFolder.open(board))
    return Answer(found, lambda: print(getattr(found, format).rstrip("\n")))


def say_what_licences_keep(datasets: Iterable[Any]) -> None:
    """Say on the terminal what pages say of the licences of some datasets or their tables."""
    from prbench.board.export import licence_note

    for text in dict.fromkeys(licence_note(each.title, each.redistribution) for each in datasets):
        if text:
            note(text)
