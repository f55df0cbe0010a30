"""The pages of a site: all tables and sentences come from the board, scripts only sort, filter and draw them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from string import Template
from typing import Any

from msgspec.structs import replace

from prbench.board.export import board_tables, part_title
from prbench.board.site.motions import json
from prbench.board.site.numbers import SiteRun, failures_of, prime_timing, spread_of
from prbench.board.tables import DatasetTable, Leaderboard, hides
from prbench.datasets import imitated
from prbench.metrics import STUDY_METRICS
from prbench.protocol.published import load_published, published_table
from prbench.sequences.table import SequenceTable
from prbench.shown import html
from prbench.tables import Block, Column, Row, Table, as_html, metric_column

# Failures that a page names; scores.parquet holds all.
MOST_FAILURES = 200


@dataclass(frozen=True)
class About:
    """What all pages of a board say.

    Attributes:
        title: Title of the board.
        cite: BibTeX of what is to be cited.
    """

    title: str
    cite: str


def asset(name: str) -> str:
    """Return one of the files that stand beside this module."""
    return (files("prbench.board.site") / "assets" / name).read_text(encoding="utf-8")


def index_page(
    about: About, board: Leaderboard, tables: Mapping[str, DatasetTable], runs: Sequence[SiteRun], left_out: list[str]
) -> str:
    """Return the page of all tables, with what the study printed apart from them."""
    key_of = {id(row.entry): run.key for run in runs for row in run.rows.values()}
    shown = board_tables(board)
    for number, own in enumerate(tables.values()):
        rows = []
        for row, printed in zip(own.rows, shown[number].blocks[0].rows, strict=True):
            told = {"run": key_of[id(row.entry)], "split": own.split}
            told |= {"status": "unverified" if row.entry.unverified else "verified"}
            told |= {"control": "control" if row.entry.is_control else ""}
            rows.append(replace(printed, text={**printed.text, **told}))
        shown[number] = replace(shown[number], blocks=(Block(rows=tuple(rows)),))
    versions = dict.fromkeys(str(table.rows[0].entry.record.protocol_version) for table in tables.values())
    benchmarks = dict.fromkeys(table.benchmark.about.title for table in tables.values())
    facts = [*benchmarks, f"protocol version {', '.join(versions)}", f"{len(runs)} runs", f"{len(tables)} tables"]
    texts = {"title": html(about.title), "facts": _items(facts), "boards": as_html(shown)}
    texts |= {"published": as_html(_published(tables.values()))}
    texts |= {"left_out": _items(left_out) or "<li>Nothing was left out.</li>"}
    texts |= {"cite": "\n".join(map(html, about.cite.splitlines()))}
    return _page(about, about.title, Template(asset("index.html")).substitute(texts), "board.js")


def run_page(
    about: About,
    run: SiteRun,
    tables: Mapping[str, DatasetTable],
    at_hand: Mapping[str, SequenceTable],
    shown: Iterable[str],
) -> str:
    """Return the page of one run.

    Args:
        about: What all pages say.
        run: The run.
        tables: Tables of the board by name.
        at_hand: Tables of sequences, by the same names, as far as they are at hand.
        shown: Names of the tables whose motions are on the site.
    """
    told = []
    for name, row in run.rows.items():
        entry = row.entry
        failures = failures_of(row)
        timed = name in at_hand and not entry.unverified and entry.benchmark.about.default
        remarks = (entry.summary.mark, entry.summary.arrival, entry.summary.own_first_frame)
        one: dict[str, Any] = {"table": name, "title": part_title(tables[name]), "row": row.told}
        one |= {"main": [info.id for info in entry.benchmark.main_metrics if not hides(entry, info)]}
        one |= {"spread": spread_of(row.scores, entry.benchmark), "remarks": [word for word in remarks if word]}
        one |= {"failures": failures[:MOST_FAILURES], "failed": len(failures), "scored": len(row.worst)}
        told.append(one | {"timing": prime_timing(run.folder, at_hand[name]) if timed else None})
    data = json({"run": run.key, "label": run.label, "tables": told}).decode()
    body = Template(asset("run.html")).substitute(title=html(run.label), data=data)
    lists = [f"../motions/{name}.js" for name in run.rows if name in shown]
    return _page(about, f"{run.label} · {about.title}", body, "run.js", root="../", data=lists)


def compare_page(about: About, runs: Sequence[SiteRun], shown: Sequence[str]) -> str:
    """Return the page on which two runs are compared; ``shown`` are the tables with motions."""
    told = [{"run": run.key, "label": run.label, "tables": list(run.rows)} for run in runs]
    data = json({"runs": told, "shown": shown}).decode()
    return _page(about, f"Compare · {about.title}", Template(asset("compare.html")).substitute(data=data), "compare.js")


def _page(about: About, title: str, body: str, script: str, *, root: str = "", data: Sequence[str] = ()) -> str:
    # What hands values over stands before the script that draws them.
    named = [f"{root}assets/site.js", *data, f"{root}assets/{script}"]
    scripts = "\n".join(f'<script src="{html(name)}"></script>' for name in named)
    told = {"title": html(title), "board": html(about.title), "root": root, "body": body, "scripts": scripts}
    return Template(asset("page.html")).substitute(told)


def _published(tables: Iterable[DatasetTable]) -> list[Table]:
    """Lay out what Table 2 of the study says of the datasets of a board, synthetic copies of them among these."""
    of_study = (imitated(table.dataset) for table in tables if table.benchmark.about.default)
    about = published_table("2")
    columns = [Column(key=key, title=key.capitalize(), text=True) for key in ("method", "weights", "condition")]
    columns += [metric_column(info) for info in STUDY_METRICS]
    found = []
    for dataset in dict.fromkeys(of_study):
        rows: dict[tuple[str, ...], dict[str, str]] = {}
        for number in load_published("2"):
            if number.dataset == dataset:
                words = {"method": number.method, "weights": number.variant, "condition": number.condition}
                rows.setdefault(tuple(words.values()), words)[number.metric] = number.printed or "–"
        title = f"Printed in Prime and Reach, Table 2 (section {about.section}): {dataset}"
        block = Block(rows=tuple(Row(text=text) for text in rows.values()))
        found.append(Table(title=title, dataset=dataset, columns=tuple(columns), blocks=(block,), notes=about.notes))
    return found


def _items(sentences: Iterable[str]) -> str:
    return "".join(f"<li>{html(sentence)}</li>" for sentence in sentences)
