"""Write the pages, scripts and motions of a board into one folder, whole or not at all."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import msgspec

from prbench.board.comparison import sequence_scores
from prbench.board.site import motions, numbers, pages
from prbench.board.site.numbers import SiteRun
from prbench.board.tables import DatasetTable, Leaderboard, TableRow
from prbench.errors import RunError
from prbench.files.storage import atomic_folder, require_replaceable, sole_writer, write_json
from prbench.harness.run_folder.record import TableRecord
from prbench.progress_bar import ProgressCallback
from prbench.sequences.table import SequenceTable
from prbench.viewing.player.page import player_assets

# Marks a folder as a site, which a new one may replace.
MARKER = "site.json"
# Pairs of runs that are compared; of more, those with the leading runs of their condition.
MOST_PAIRS = 300
LEADING = 5
# Sequences of each dataset whose motions every run shows, and failures that each run shows beside them.
USUAL_MOTIONS = 4


class SiteReport(msgspec.Struct, frozen=True, kw_only=True):
    """What a site holds; ``site.json`` in its folder says the same.

    Attributes:
        title: Title of the board.
        tables: Names of its tables.
        runs: Names of the pages of its runs.
        pairs: Number of pairs of runs that are compared.
        pairs_left_out: Which pairs are not; empty where all are there.
        motions: Number of motions that can be looked at, recorded ones not counted.
        left_out: Sentences on what is not there, such as motions that a licence keeps.
    """

    title: str
    tables: list[str]
    runs: list[str]
    pairs: int
    pairs_left_out: str
    motions: int
    left_out: list[str]


def write_site(
    board: Leaderboard,
    out: Path,
    *,
    about: pages.About,
    find_table: Callable[[TableRecord], object] = lambda _: None,
    motions_of_each: int | None = USUAL_MOTIONS,
    permitted: Collection[str] = (),
    progress: ProgressCallback = lambda *_: None,
) -> SiteReport:
    """Write a board as pages that need neither server nor network; equal boards give equal bytes.

    Args:
        board: The board.
        out: Folder of the site; an earlier site there is replaced.
        about: Title of the board, and what it asks readers to cite.
        find_table: Gives the table that a run was made on, if it is at hand; motions are shown and primes timed there.
        motions_of_each: Sequences of each dataset that every run shows, and failures that each run shows beside them;
            None for all sequences, 0 for none.
        permitted: Datasets whose recorded motion the user has permission to publish.
        progress: Called after each run and each pair.

    Raises:
        StorageError: if ``out`` holds something else, or cannot be written.
        RunError: if a run's scores cannot be read.
    """
    tables = dict(zip(names_of([each.dataset for each in board.tables]), board.tables, strict=True))
    runs = runs_of(tables)
    left_out = list(board.notes)
    with sole_writer(out):
        require_replaceable(out, MARKER, kind="site")
        with atomic_folder(out) as folder:
            at_hand = _tables_at_hand(tables, find_table)
            shown: dict[str, list[motions.ShownSequence]] = {}
            for name, table in at_hand.items() if motions_of_each != 0 else ():
                shown[name], without = _write_motions(folder, name, table, runs, motions_of_each, permitted)
                left_out += without
            if len(at_hand) < len(tables):
                missing = ", ".join(name for name in tables if name not in at_hand)
                left_out.append(
                    f"No motions and no timing of primes of {missing}: no table of it was at hand (--data)."
                )
            (folder / "runs").mkdir()
            for done, run in enumerate(runs, start=1):
                page = pages.run_page(about, run, tables, at_hand, shown)
                (folder / "runs" / f"{run.key}.html").write_text(page, encoding="utf-8")
                progress(done, len(runs), run.key)
            pairs, pairs_left_out = _write_pairs(folder, runs, progress)
            report = SiteReport(
                title=about.title,
                tables=list(tables),
                runs=[run.key for run in runs],
                pairs=pairs,
                pairs_left_out=pairs_left_out,
                motions=sum(len(each.runs) for of_table in shown.values() for each in of_table),
                left_out=left_out,
            )
            (folder / "index.html").write_text(pages.index_page(about, board, tables, runs, report), encoding="utf-8")
            (folder / "compare.html").write_text(pages.compare_page(about, runs, list(shown), report), encoding="utf-8")
            _write_assets(folder / "assets")
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


def runs_of(tables: Mapping[str, DatasetTable]) -> list[SiteRun]:
    """Return the runs of a board, in the order of its tables."""
    placed: dict[Path, dict[str, TableRow]] = {}
    for name, table in tables.items():
        for row in table.rows:
            assert row.entry.sequences is not None  # of every run that was read from a folder
            placed.setdefault(row.entry.sequences.run.path, {})[name] = row
    firsts = [next(iter(rows.values())) for rows in placed.values()]
    # As short as tells the runs apart: method and condition, with the variant, with the name of the page.
    keys = names_of([row.entry.run for row in firsts])
    labels = [_label(row) for row in firsts]
    for more in ([row.variant for row in firsts], keys):
        labels = [
            f"{label} ({word})" if labels.count(label) > 1 and word else label
            for label, word in zip(labels, more, strict=True)
        ]
    runs = []
    for key, label, rows in zip(keys, labels, placed.values(), strict=True):
        scores = {}
        for name, row in rows.items():
            assert row.entry.scores is not None
            scores[name] = sequence_scores(row.entry.scores, row.entry.benchmark, only=row.entry.only)
        scored = next(iter(rows.values())).entry.sequences
        assert scored is not None
        runs.append(SiteRun(key, label, scored.run, rows, scores))
    return runs


def _tables_at_hand(
    tables: Mapping[str, DatasetTable], find_table: Callable[[TableRecord], object]
) -> dict[str, SequenceTable]:
    """Find the sequences of each table of a board, on whosever copy of the data the runs were made."""
    found = {}
    for name, table in tables.items():
        scored = table.rows[0].entry.sequences
        with contextlib.suppress(RunError):  # a table of that dataset with other sequences
            at_hand = None if scored is None else find_table(scored.record)
            if isinstance(at_hand, SequenceTable):
                found[name] = at_hand
    return found


def _label(row: TableRow) -> str:
    record = row.entry.record
    condition = "" if row.entry.is_control and not record.control else record.condition
    return ", ".join(part for part in (row.entry.method, condition, record.control) if part)


def _write_motions(
    folder: Path,
    name: str,
    table: SequenceTable,
    runs: Sequence[SiteRun],
    most: int | None,
    permitted: Collection[str],
) -> tuple[list[motions.ShownSequence], list[str]]:
    """Write the motions of one table, and the script that lists them."""
    there = [run for run in runs if name in run.rows]
    entries = {run.key: run.rows[name].entry for run in there}
    worst = {}
    ids: set[str] = set()
    for run in there:
        failures = numbers.failures_of(run.scores[name], entries[run.key].benchmark)
        worst[run.key] = [failure.sequence_id for failure in failures]
        for names, _ in run.scores[name].values():
            ids.update(names)
    wanted = motions.chosen_sequences(table, ids, worst, most)
    place = folder / motions.FOLDER / name
    place.mkdir(parents=True)
    shown, left_out = motions.write_motions(place, table, entries, wanted, permitted)
    (folder / motions.FOLDER / f"{name}.js").write_bytes(motions.script(name, shown))
    return shown, left_out


def _write_pairs(folder: Path, runs: Sequence[SiteRun], progress: ProgressCallback) -> tuple[int, str]:
    """Write the comparisons of pairs, one script for each first run; return their number, and which were left out."""
    pairs = [pair for pair in combinations(runs, 2) if pair[0].rows.keys() & pair[1].rows.keys()]
    left_out = ""
    if len(pairs) > MOST_PAIRS:
        leading = {id(run) for name in {name for run in runs for name in run.rows} for run in _leading(runs, name)}
        every = len(pairs)
        pairs = [
            (first, second)
            for first, second in pairs
            if first.first.record.condition == second.first.record.condition and {id(first), id(second)} & leading
        ]
        left_out = (
            f"Compared are {len(pairs)} of {every} pairs: each run with the {LEADING} leading ones of its condition in"
            " any table. `prbench leaderboard compare` compares any two."
        )
    (folder / "pairs").mkdir()
    told: dict[str, dict[str, list[numbers.PairedMetric]]] = {run.key: {} for run in runs}
    for done, (first, second) in enumerate(pairs, start=1):
        # The first table of a dataset holds all sequences, a second one those that every method generated.
        shared: dict[str, str] = {}
        for name in first.rows:
            if name in second.rows:
                shared.setdefault(first.rows[name].entry.table.dataset, name)
        entries = {dataset: first.rows[name].entry for dataset, name in shared.items()}
        scores = {dataset: (first.scores[name], second.scores[name]) for dataset, name in shared.items()}
        told[first.key][second.key] = numbers.compared(entries, scores, (first.label, second.label))
        progress(done, len(pairs), f"{first.key}, {second.key}")
    for key, of_run in told.items():
        (folder / "pairs" / f"{key}.js").write_bytes(motions.script(f"pairs/{key}", of_run))
    return len(pairs), left_out


def _leading(runs: Sequence[SiteRun], name: str) -> list[SiteRun]:
    """Return the runs that lead a table by the first ranked metric, a few of each condition."""
    found: dict[str, list[tuple[float, str, SiteRun]]] = {}
    for run in runs:
        if name in run.rows:
            info = run.first.benchmark.ranked_metrics[0]
            metric = run.rows[name].entry.summary.metric(info.id)
            losing = float("inf")
            if metric is not None:
                losing = -metric.mean if info.higher_is_better else metric.mean
            found.setdefault(run.first.record.condition, []).append((losing, run.key, run))
    return [run for own in found.values() for _, _, run in sorted(own)[:LEADING]]


def _write_assets(folder: Path) -> None:
    """Copy scripts and styles, the player's among them."""
    folder.mkdir()
    for name in ("site.css", "theme.js", "site.js", "board.js", "run.js", "compare.js"):
        (folder / name).write_text(pages.asset(name), encoding="utf-8")
    player = player_assets()
    (folder / "player.js").write_text(player.scripts, encoding="utf-8")
    (folder / "player.css").write_text(player.style, encoding="utf-8")
