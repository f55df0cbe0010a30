"""Measured scores beside the published ones: the difference, its interval, and what could explain it.

A published number stands only beside a built-in method of the same name under the same condition, run on the test split
of a table of real recordings. Everything else has no difference: synthetic people are not the study's people.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from math import hypot
from typing import Any

from scipy.stats import binomtest

from prbench.board.collect import LeaderboardRow
from prbench.board.tables import Leaderboard, TableRow, hides
from prbench.harness.run_folder.record import BUILT_IN
from prbench.metrics import METRICS, exported_unit, printed_unit
from prbench.protocol.published import (
    DATASETS,
    PublishedNumber,
    assumptions_for,
    load_assumptions,
    load_published,
    load_table_one,
    published_table,
)
from prbench.shown import csv_text, markdown, markdown_code
from prbench_benchmarks.prime_and_reach.table_two.request import load_table_two

_TEST = "test"
_INFOS = {info.id: info for info in METRICS}
_STANDS_IN = "small bundled weights, trained on synthetic people alone, stand in for the study's"
_UNKNOWN_WEIGHTS = "what its weights were trained on is not known; compared with the study's fine-tuned row"
PER_DATASET = "fine-tuned per dataset"
_FINE_TUNED = "fine-tuned"


@dataclass(frozen=True)
class Difference:
    """One measured number beside the published one; rates in %, lengths in metres."""

    table: str
    """Table of the study."""
    dataset: str
    """Name of the dataset."""
    condition: str
    """What the method was given."""
    method: str
    """Name of the method."""
    variant: str
    """Of the measured row."""
    published_variant: str
    """Of the study's row that it stands beside."""
    metric: str
    """Id of the metric."""
    unit: str
    """``%``, ``m`` or ``ratio``."""
    measured: float
    """The measured number."""
    published: float
    """The study's number."""
    difference: float
    """measured - published."""
    low: float | None
    """Bounds of its 95 % interval; None where the measured number has none."""
    high: float | None
    """Upper bound of the interval."""
    sequences: int
    """Number of sequences behind the measured number."""
    published_sequences: int
    """Number of sequences in the study's test split."""
    verified: bool
    """Whether the measured scores were held against the motions."""
    assumptions: tuple[str, ...]
    """Ids of what the study leaves open and could explain it (:func:`prbench.protocol.published.load_assumptions`)."""
    remarks: tuple[str, ...]
    """What else could."""
    source: str
    """Where the study prints the number."""


def published_variant(entry: LeaderboardRow, table: str = "2") -> tuple[str, str] | None:
    """Return the study's variant that a run stands for, and what has to be said of that; None if it has no row.

    Args:
        entry: A run on one dataset.
        table: ``2``, or ``S3`` for weights that were trained on one dataset.
    """
    if entry.record.method.kind != BUILT_IN or entry.is_control:
        return None
    rows = [
        row
        for row in load_table_two().rows
        if row.method == entry.method and row.condition.value == entry.record.condition
    ]
    used = (entry.record.method.weights or "").removesuffix(".safetensors")
    for row in rows:
        variant = load_table_two().weights[row.weights].variant
        needs_none = load_table_two().weights[row.weights].state == "none"
        if table == "S3" and variant == _FINE_TUNED:
            if used == f"{row.weights}-{entry.summary.dataset}":
                return PER_DATASET, ""
            continue
        if needs_none or used == row.weights:
            return variant, ""
        if used == row.bundled:
            return variant, _STANDS_IN
    if rows and table == "2":
        return _FINE_TUNED, _UNKNOWN_WEIGHTS
    return None


def differences(rows: Iterable[TableRow], table: str = "2") -> tuple[Difference, ...]:
    """Compare measured rows with the published ones.

    Args:
        rows: Of a leaderboard.
        table: ``2`` or ``S3``.
    """
    found: list[Difference] = []
    for row in rows:
        if why_not_beside(row.entry) is not None:
            continue
        named = published_variant(row.entry, table)
        if named is None:
            continue
        for number in load_published(table):
            key = (number.dataset, number.condition, number.method, number.variant)
            wanted = (row.entry.summary.dataset, row.entry.record.condition, row.entry.method, named[0])
            if key == wanted:
                found += _difference(row, number, named[1])
    return tuple(found)


def why_not_beside(entry: LeaderboardRow) -> str | None:
    """Return why no published number stands beside a run, or None if one may."""
    if entry.summary.synthetic or entry.summary.dataset not in DATASETS:
        return "scores on synthetic data, or on a dataset that the study does not have"
    if entry.record.split != _TEST:
        return f"split '{entry.record.split}', the study scores its test split"
    if entry.protocol:
        return f"a protocol of the user's own, {entry.protocol}"
    if entry.only is not None and not entry.table.unsupported:
        return "its numbers on the common sequences, since those on all of them stand beside the study's"
    if entry.is_control:
        return "a control of the harness"
    if entry.record.method.gaze:
        return "a method that generates gaze, which the study's do not"
    if not entry.record.is_usual:
        return "motions with an option that the study has not"
    if entry.summary.hands_in_recordings:
        return "recorded motions, not a method's"
    return None


def _difference(row: TableRow, number: PublishedNumber, said: str) -> Iterable[Difference]:
    entry = row.entry
    info = _INFOS[number.metric]
    metric = entry.metric(number.metric)
    if metric is None or number.value is None or hides(entry, info):
        return
    theirs = load_table_one()[number.dataset].test
    measured = info.scale * metric.mean
    bounds = (None, None)
    if metric.low is not None and metric.high is not None:
        # Bound the difference: squares of both distances to the bounds add up (MOVER, Zou and Donner 2008).
        published = number.value
        low = info.scale * metric.low
        high = info.scale * metric.high
        difference = measured - published
        below, above = published, published
        if info.unit == "rate":
            hits = round(published / 100 * theirs)
            wilson = binomtest(hits, theirs).proportion_ci(method="wilson")
            below, above = min(published, 100 * wilson.low), max(published, 100 * wilson.high)
        bounds = (
            difference - hypot(measured - low, above - published),
            difference + hypot(high - measured, published - below),
        )
    yield Difference(
        table=number.table,
        dataset=number.dataset,
        condition=number.condition,
        method=number.method,
        variant=row.variant,
        published_variant=number.variant,
        metric=number.metric,
        unit=exported_unit(info.unit),
        measured=measured,
        published=number.value,
        difference=measured - number.value,
        low=bounds[0],
        high=bounds[1],
        sequences=metric.sequences,
        published_sequences=theirs,
        verified=not entry.unverified,
        assumptions=tuple(each.id for each in assumptions_for((number.metric,))),
        remarks=tuple(_remarks(entry, number, said, theirs)),
        source=number.source,
    )


def _remarks(entry: LeaderboardRow, number: PublishedNumber, said: str, theirs: int) -> Iterable[str]:
    if said:
        yield said
    if entry.summary.sequences != theirs:
        yield f"{entry.summary.sequences} test sequences, the study has {theirs}"
    if unsupported := entry.summary.unsupported or entry.table.unsupported:
        yield f"{unsupported} sequences are left out, as longer than the method can generate"
    if entry.record.samples > 1:
        yield f"{entry.record.samples} samples a sequence"
    if entry.mark:
        yield entry.mark
    if entry.unverified:
        yield f"unverified: {entry.unverified}"
    if number.note.startswith("inconsistent"):
        yield f"the published cell is odd: {number.note}"


# Leaderboards with published numbers beside them: the same text as without, and a part of its own behind it.


def add_published(text: str, leaderboard: Leaderboard, format: str) -> str:
    """Add the published numbers, and the differences to them, to an exported leaderboard.

    Args:
        text: The leaderboard in ``format``.
        leaderboard: The same.
        format: ``md``, ``csv`` or ``json``.
    """
    found = [one for table in leaderboard.tables for one in differences(table.rows)]
    reasons = why_none(leaderboard)
    if format == "json":
        content = json.loads(text) | as_json(found, reasons)
        return json.dumps(content, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"
    if format == "csv":
        columns = next(csv.reader(io.StringIO(text)))
        out = io.StringIO()
        writer = csv.DictWriter(out, columns, restval="", extrasaction="ignore", lineterminator="\n")
        for dataset in _shown_tables(leaderboard):
            for number in (each for each in load_published("2") if each.dataset == dataset):
                writer.writerow(_csv_published(number))
        for one in found:
            writer.writerow(
                {
                    "table": "difference",
                    "dataset": one.dataset,
                    "condition": one.condition,
                    "method": one.method,
                    "variant": csv_text(one.variant),
                    "metric": one.metric,
                    "value": f"{one.difference:.6f}",
                    "unit": one.unit,
                    "low": "" if one.low is None else f"{one.low:.6f}",
                    "high": "" if one.high is None else f"{one.high:.6f}",
                    "sequences": str(one.sequences),
                    "verified": "verified" if one.verified else "unverified",
                    "note": csv_text("; ".join(("assumptions: " + ", ".join(one.assumptions), *one.remarks))),
                    "kind": f"measured - published ({one.published_variant})",
                }
            )
        return text + out.getvalue()
    blocks = ["## Published numbers"]
    shown = _shown_tables(leaderboard)
    if not shown:
        blocks.append("None is shown: no table of real recordings that the study has is among the runs.")
    for dataset in shown:
        blocks += [f"### {dataset}: published in Prime and Reach, Table 2, not measured here", _published_grid(dataset)]
        here = [one for one in found if one.dataset == dataset]
        if here:
            blocks += [f"### {dataset}: measured minus published", _difference_grid(here)]
    if shown:
        blocks.append("\n".join(f"- {markdown(line)}" for line in _explained(found)))
    if reasons:
        blocks += ["No published number stands beside:", "\n".join(f"- {markdown(line)}" for line in reasons)]
    return text + ("\n" + "\n\n".join(blocks) + "\n")


def why_none(leaderboard: Leaderboard) -> tuple[str, ...]:
    """Return a sentence for each run beside which no published number stands."""
    sentences = []
    for table in leaderboard.tables:
        for row in table.rows:
            reason = why_not_beside(row.entry)
            if reason is None and published_variant(row.entry) is None:
                reason = "the study has no such row"
            if reason is not None:
                sentences.append(f"{row.entry.run}, {table.dataset}: {reason}")
    return tuple(dict.fromkeys(sentences))


def as_json(found: Sequence[Difference], reasons: Sequence[str]) -> dict[str, Any]:
    """Return differences, the assumptions that they name, and why others have none."""
    return {
        "published": [asdict(one) for one in found],
        "assumptions": {each.id: each.text for each in load_assumptions()} if found else {},
        "not_beside_published": list(reasons),
    }


def _shown_tables(leaderboard: Leaderboard) -> list[str]:
    """Datasets of real recordings, on which published numbers are shown."""
    return [
        name for name in DATASETS if any(table.dataset == name and not table.synthetic for table in leaderboard.tables)
    ]


def _csv_published(number: PublishedNumber) -> dict[str, str]:
    info = _INFOS[number.metric]
    direction = "" if info.higher_is_better is None else str(info.higher_is_better).lower()
    return {
        "table": f"published {number.table}",
        "dataset": number.dataset,
        "condition": number.condition,
        "method": number.method,
        "variant": number.variant,
        "metric": number.metric,
        "value": number.printed,
        "unit": exported_unit(info.unit),
        "higher_is_better": direction,
        "sequences": str(load_table_one()[number.dataset].test),
        "note": csv_text(number.note),
        "kind": number.source,
    }


def _published_grid(dataset: str) -> str:
    metrics = list(dict.fromkeys(number.metric for number in load_published("2")))
    rows: dict[tuple[str, str, str], dict[str, str]] = {}
    for number in load_published("2"):
        if number.dataset == dataset:
            rows.setdefault((number.condition, number.method, number.variant), {})[number.metric] = number.printed
    header = ["Condition", "Method", "Variant", *(_title(name) for name in metrics)]
    lines = [[*map(markdown, key), *(cells[name] or "–" for name in metrics)] for key, cells in rows.items()]
    return _grid(header, lines, words=3)


def _difference_grid(found: Sequence[Difference]) -> str:
    header = ["Condition", "Method", "Variant", "Metric", "Measured", "Published", "Difference", "Could explain it"]
    lines = []
    for one in found:
        bounds = "" if one.low is None or one.high is None else f" [{one.low:+.2f}, {one.high:+.2f}]"
        lines.append(
            [
                markdown(one.condition),
                markdown(one.method),
                markdown(one.variant),
                _title(one.metric),
                f"{one.measured:.2f}",
                f"{one.published:.2f}",
                f"{one.difference:+.2f}{bounds}",
                "; ".join([*(markdown_code(name) for name in one.assumptions), *map(markdown, one.remarks)]),
            ]
        )
    return _grid(header, lines, words=4)


def _title(metric: str) -> str:
    info = _INFOS[metric]
    unit = printed_unit(info.unit).strip()
    return f"{info.title_in_study or info.title}{info.arrow}{f' ({unit})' if unit else ''}"


def _grid(header: Sequence[str], rows: Sequence[Sequence[str]], *, words: int) -> str:
    rule = ["---"] * words + ["---:"] * (len(header) - words)
    return "\n".join("| " + " | ".join(line) + " |" for line in (header, rule, *rows))


def _explained(found: Sequence[Difference]) -> Iterable[str]:
    """Yield what differences mean, and each assumption that one of them names."""
    yield (
        "Intervals of 95 %: the measured number's by recordings; a published rate's as if its sequences were"
        " independent, which is the least that it can be off. A published length has no printed spread and counts as"
        " exact."
    )
    named = {name for one in found for name in one.assumptions}
    for each in load_assumptions():
        if each.id in named:
            yield f"{each.id}: {each.text}"
    yield from published_table("2").notes


def published_beside(text: str, board: Leaderboard, format: str) -> tuple[str, list[Difference], tuple[str, ...]]:
    """Add the study's numbers to an exported board.

    Args:
        text: The board as exported.
        board: What it shows.
        format: ``md``, ``csv`` or ``json``.

    Returns:
        The text with the numbers, the differences, and why some runs have none.
    """
    found = [one for table in board.tables for one in differences(table.rows)]
    return add_published(text, board, format), found, why_none(board)
