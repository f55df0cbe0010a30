"""``prbench leaderboard site``: a board as pages that open from disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, note, progress
from prbench.errors import UsageError

_EXAMPLE = "prbench leaderboard site runs/* --data tables/adt --out site"
_MOTIONS = "Motions that can be looked at: of each dataset the same N sequences of every run, and each run's N worst"
_MOTIONS += " failures (default 4); or all, or none."


@command("site", example=_EXAMPLE, report="prbench.board.site:SiteReport")
@click.argument("runs", type=opt.PATH, nargs=-1, required=True, metavar="BOARD|RUN...")
@opt.out_folder_option("Write the site to this folder; an earlier site there is replaced.", required=True)
@opt.option("--title", "Title of the site (default: the board's, or Leaderboard).", metavar="TEXT")
@opt.option("--motions", _MOTIONS, default="4", metavar="N|all|none")
@opt.permission_option
@opt.tables_option
@opt.workers_option()
def site(
    runs: tuple[Path, ...], out: Path, title: str | None, motions: str, permission: tuple[str, ...], **given: Any
) -> Answer:
    """Write a leaderboard as pages with tables, charts, a page a run, and motions to look at.

    They open from disk and from any web server, and load nothing from elsewhere. BOARD is a board folder, RUN are run
    folders or folders that hold some. Recorded motion stands in them only where its licence allows that to everybody.
    """
    from prbench import board as boards
    from prbench.board.folder import INFO, BoardFolder
    from prbench.board.pages import cite_board, cited_with
    from prbench.board.site import MARKER, About, write_site
    from prbench.files.storage import require_replaceable
    from prbench.harness.first_run import table_finder

    if motions not in ("all", "none") and not (motions.isdecimal() and int(motions) > 0):
        raise UsageError(f"--motions {motions}: expected a number from 1 on, all or none.")
    require_replaceable(out, MARKER, kind="site")
    most = None if motions == "all" else int(motions) if motions.isdecimal() else 0
    board = boards.make_leaderboard(opt.collected_runs(runs, **given, any_benchmark=True))
    # A board says by itself how it is called and cited.
    about = About(title or "Leaderboard", "\n\n".join(cited_with(table.dataset for table in board.tables)))
    if len(runs) == 1 and (runs[0] / INFO).is_file():
        folder = BoardFolder.open(runs[0])
        about = About(title or folder.info.title, cite_board(folder).bibtex)
    with progress("writing pages") as show:
        tables = table_finder(given["data"], same_values=False)
        how = {"find_table": tables, "motions_of_each": most, "permitted": permission, "progress": show}
        report = write_site(board, out, about=about, **how)
    for reason in report.left_out:
        note(reason)
    counts = f"tables: {len(report.tables)}, runs: {len(report.runs)}, pairs: {report.pairs}, motions: {report.motions}"
    return Answer(report, lambda: print(f"{counts}\nsite: {out / 'index.html'}"))
