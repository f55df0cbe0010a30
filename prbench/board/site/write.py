"""Write the pages, scripts and motions of a board into one folder, whole or not at all."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import msgspec

from prbench.board.comparison import sequence_scores
from prbench.board.export import as_board
from prbench.board.site import motions, numbers, pages
from prbench.board.site.numbers import SiteRow, SiteRun
from prbench.board.tables import Leaderboard
from prbench.errors import RunError
from prbench.files.storage import atomic_folder, require_replaceable, sole_writer, write_json
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import TableRecord
from prbench.harness.run_folder.scores import CodedScores
from prbench.progress_bar import ProgressCallback
from prbench.sequences.table import SequenceTable
from prbench.viewing.player.links import worst_first
from prbench.viewing.player.page import player_assets

# Marks a folder as a site, which a new one may replace.
MARKER = "site.json"
_ASSETS = ("site.css", "theme.js", "site.js", "board.js", "run.js", "compare.js")


class SiteReport(msgspec.Struct, frozen=True, kw_only=True):
    """What a site holds; ``site.json`` in its folder says the same.

    Attributes:
        title: Title of the board.
        tables: Names of its tables.
        runs: Names of the pages of its runs.
        pairs: Number of pairs of runs that are compared: all that stand in one table.
        motions: Number of motions that can be looked at, recorded ones not counted.
        left_out: Sentences on what is not there, such as motions that a licence keeps.
    """

    title: str
    tables: list[str]
    runs: list[str]
    pairs: int
    motions: int
    left_out: list[str]


def write_site(
    board: Leaderboard,
    out: Path,
    *,
    about: pages.About,
    find_table: Callable[[TableRecord], object] = lambda _: None,
    motions_of_each: int | None = 4,
    permitted: Collection[str] = (),
    progress: ProgressCallback = lambda *_: None,
) -> SiteReport:
    """Write a board as pages that need neither server nor network; equal boards give equal bytes.

    Args:
        board: The board, of runs that were read from folders.
        out: Folder of the site; an earlier site there is replaced.
        about: Title of the board, and what it asks readers to cite.
        find_table: Gives the table that a run was made on, if it is at hand; motions are shown and primes timed there.
        motions_of_each: Sequences of each dataset that every run shows, and failures that each run shows beside them;
            None for all sequences, 0 for none.
        permitted: Datasets whose recorded motion the user has permission to publish.
        progress: Called after each page of a run and each of its comparisons.

    Raises:
        StorageError: if ``out`` holds something else, or cannot be written.
        RunError: if a run's scores cannot be read.
    """
    tables = dict(zip(names_of([each.dataset for each in board.tables]), board.tables, strict=True))
    datasets = {name: table.dataset for name, table in tables.items()}
    runs = runs_of(board, list(tables))
    at_hand: dict[str, SequenceTable] = {}
    for name, table in tables.items():
        scored = table.rows[0].entry.sequences
        with contextlib.suppress(RunError):  # the table at hand is of other sequences
            found = None if scored is None else find_table(scored.record)
            if isinstance(found, SequenceTable):
                at_hand[name] = found
    left_out = list(board.notes)
    lacks = "no motions and no timing of primes, as no table of it was at hand"
    left_out += [f"{name}: {lacks}." for name in tables if name not in at_hand]
    with sole_writer(out):
        require_replaceable(out, MARKER, kind="site")
        with atomic_folder(out) as folder:
            for name in ("assets", "runs", "pairs", "motions"):
                (folder / name).mkdir()
            shown: dict[str, list[motions.ShownSequence]] = {}
            for name, table in at_hand.items() if motions_of_each != 0 else ():
                rows = {run.key: run.rows[name] for run in runs if name in run.rows}
                target = folder / "motions" / name
                shown[name], kept = motions.write_motions(target, table, rows, motions_of_each, permitted)
                left_out += kept
            for done, run in enumerate(runs, start=1):
                _write(folder / "runs" / f"{run.key}.html", pages.run_page(about, run, tables, at_hand, shown))
                progress(done, 2 * len(runs), run.key)
            pairs = 0
            for done, run in enumerate(runs, start=1):
                others = [other for other in runs[done:] if run.rows.keys() & other.rows.keys()]
                told = numbers.compared(run, others, datasets)
                _write(folder / "pairs" / f"{run.key}.js", motions.script(f"pairs/{run.key}", told))
                pairs += len(others)
                progress(len(runs) + done, 2 * len(runs), f"pairs of {run.key}")
            _write(folder / "index.html", pages.index_page(about, board, tables, runs, left_out))
            _write(folder / "compare.html", pages.compare_page(about, runs, list(shown)))
            player = player_assets()
            texts = {name: pages.asset(name) for name in _ASSETS}
            texts |= {"player.js": player.scripts, "player.css": player.style}
            for name, text in texts.items():
                _write(folder / "assets" / name, text)
            counts = {"pairs": pairs, "motions": sum(len(each.runs) for own in shown.values() for each in own)}
            keys = [run.key for run in runs]
            report = SiteReport(title=about.title, tables=list(tables), runs=keys, **counts, left_out=left_out)
            write_json(folder / MARKER, msgspec.to_builtins(report))
    return report


def names_of(wanted: Sequence[str]) -> list[str]:
    """Return a name for each text that a file and a link can have; equal ones are numbered."""
    found: list[str] = []
    for text in wanted:
        slug = re.sub(r"[^a-z0-9._]+", "-", text.lower()).strip("-._")[:60] or "x"
        number = 1
        name = slug
        while name in found:
            number += 1
            name = f"{slug}-{number}"
        found.append(name)
    return found


def runs_of(board: Leaderboard, names: Sequence[str]) -> list[SiteRun]:
    """Return the runs of a board in the order of its tables, which have these names."""
    placed: dict[Path, dict[str, SiteRow]] = {}
    folders: dict[Path, RunFolder] = {}
    for name, table, told in zip(names, board.tables, as_board(board).tables, strict=True):
        for row, each in zip(table.rows, told.rows, strict=True):
            entry = row.entry
            assert entry.sequences is not None
            assert entry.scores is not None
            scores = CodedScores.read(entry.scores)
            worst = worst_first([scores if entry.only is None else scores.only(entry.only)])
            values = sequence_scores(entry.scores, entry.benchmark, entry.table, only=entry.only)
            folders[entry.sequences.run.path] = entry.sequences.run
            placed.setdefault(entry.sequences.run.path, {})[name] = SiteRow(entry, each, values, worst)
    firsts = [next(iter(rows.values())) for rows in placed.values()]
    keys = names_of([row.entry.run for row in firsts])
    # As short as tells the runs apart: method and condition, with the variant, with the name of the page.
    labels = []
    for entry in (row.entry for row in firsts):
        condition = "" if entry.is_control and not entry.record.control else entry.record.condition
        labels.append(", ".join(part for part in (entry.method, condition, entry.record.control) if part))
    for more in ([row.told.variant for row in firsts], keys):
        seen = list(labels)
        labels = [f"{label} ({word})" if seen.count(label) > 1 and word else label for label, word in zip(seen, more)]
    return [SiteRun(key, label, folders[path], placed[path]) for key, label, path in zip(keys, labels, placed)]


def _write(path: Path, text: str | bytes) -> None:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
