"""Rows that compare, in one table; rows that do not, in tables of their own with the reason.

Two runs compare on a dataset if protocol, table (both digests), split and chosen sequences agree. Methods are ranked
within their condition, on all main metrics but ``plausible``, where at least 50 sequences were scored; controls and
motions that are the recorded ones or were chosen among several are shown without rank. A rank is one more than the
number of methods that are better by a supported difference, so methods that the data cannot separate share one. A
method that left sequences out because they are longer than it can generate stands in a second table only: there all
methods are scored, compared and ranked on the sequences that every one of them generated. The macro mean weighs every
dataset alike and exists only for methods that have all of them.

What the data of a table can decide, and what not.

Source: docs/specification/protocol.md#comparisons.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import comb
from statistics import median
from typing import Any

import msgspec

from prbench.board.collect import CollectedRuns, LeaderboardRow
from prbench.board.comparison import Separate, separate_by_comparison
from prbench.harness.benchmark import Benchmark
from prbench.harness.clusters import units_needed
from prbench.harness.run_folder.record import CONTROL
from prbench.harness.run_folder.summary import MeanOverDatasets, MetricSummary, counted_units, mean_over_datasets
from prbench.metrics import MAIN_METRICS, MetricInfo, printed_unit

_KEYS = ("protocol", "table identity", "table content", "split", "chosen sequences")


@dataclass(frozen=True)
class TableRow:
    """A line of a dataset's table.

    Attributes:
        variant: Unique among the rows of one method and condition in one table.
        ranks: Maps ranked metrics to ranks, which methods share that the data cannot separate; empty where none is
            ranked.
        leads: Ranked metrics in which it is better than every other method, each by a supported difference.
        beaten_by: Maps ranked metrics to the places of the rows in the table that are better by a supported difference.
    """

    entry: LeaderboardRow
    variant: str
    ranks: dict[str, int]
    leads: frozenset[str] = frozenset()
    beaten_by: Mapping[str, frozenset[int]] = field(default_factory=dict)


@dataclass(frozen=True)
class DatasetTable:
    """All comparable runs on one dataset.

    Attributes:
        key: Values of ``_KEYS``, on which the rows agree.
        rows: Sorted by condition, controls last.
        of: Number of the chosen sequences where the table is of the common ones alone; 0 where it is of all.
        shortest: Methods that left sequences out, with how many, where the table is of the common ones.
        common: Ids of the common sequences; None where the table is of all.
        protocol: Name and version of a user's own protocol; empty for prbench's.
        earlier_version: Version of prbench's own protocol where it is not the present one.
    """

    dataset: str
    title: str
    split: str
    sequences: int
    recordings: int
    synthetic: bool
    redistribution: str
    key: tuple[str, ...]
    rows: tuple[TableRow, ...]
    of: int = 0
    shortest: tuple[str, ...] = ()
    common: frozenset[str] | None = None
    protocol: str = ""
    earlier_version: int | None = None

    @property
    def benchmark(self) -> Benchmark:
        """The benchmark of all rows."""
        return self.rows[0].entry.benchmark


@dataclass(frozen=True)
class MacroRow:
    """Means of one method over the datasets.

    Attributes:
        method: Name of the method.
        origin: Origin of the method, in words.
        mark: A remark about its motions that readers must know, of the first dataset that has one; empty without.
        symbols: The signs of the mark.
        is_control: Made by the harness: shown, never ranked.
        condition: What the method was given.
        variant: Control, weights, options and the like, by which rows of one method differ.
        means: Maps ids of metrics to means, each dataset counting alike; empty if the method lacks a dataset.
        ranks: Maps ids of metrics to ranks, from 1; empty where nothing is ranked.
        missing: Datasets that the method lacks.
        unverified: Scores on one of the datasets or more were not held against the motions.
        declared: What its runs say and nothing at hand can show.
        training: What the method was trained on, as its submission declares it.
    """

    method: str
    origin: str
    mark: str
    symbols: str
    is_control: bool
    condition: str
    variant: str
    means: dict[str, MeanOverDatasets]
    ranks: dict[str, int]
    missing: tuple[str, ...]
    unverified: bool
    declared: tuple[str, ...]
    training: str


@dataclass(frozen=True)
class MacroTable:
    """Methods over all datasets of one protocol.

    Attributes:
        datasets: Names of the datasets.
        synthetic: One of them is synthetic.
        rows: The methods.
        benchmark: Name of the benchmark.
        earlier_version: Version of prbench's own protocol where it is not the present one.
    """

    datasets: tuple[str, ...]
    synthetic: bool
    rows: tuple[MacroRow, ...]
    benchmark: str
    earlier_version: int | None = None


@dataclass(frozen=True)
class Leaderboard:
    """Everything that an export shows; ``signed_by`` is the id of the key that all runs are signed by, or empty."""

    tables: tuple[DatasetTable, ...]
    macro: tuple[MacroTable, ...]
    notes: tuple[str, ...]
    signed_by: str = ""


def make_leaderboard(collected: CollectedRuns, *, separate: Separate = separate_by_comparison) -> Leaderboard:
    """Sort rows into comparable tables, rank them, and take means over datasets.

    Args:
        collected: The runs.
        separate: Finds out which differences are supported; by default from the scores of the sequences.
    """
    groups: dict[tuple[str, ...], list[LeaderboardRow]] = defaultdict(list)
    for row in collected.rows:
        table = row.table
        digests = (row.record.protocol_digest, table.identity_digest, table.content_digest)
        groups[row.summary.dataset, *digests, row.record.split, table.selection_digest].append(row)
    tables: list[DatasetTable] = []
    notes = [f"Left out: {reason}." for reason in collected.left_out]
    if collected.signed_by:
        notes.insert(0, f"All runs are signed by {collected.signed_by}, who vouches for what is declared.")
    for (dataset, *key), rows in sorted(groups.items()):
        whole = [row for row in rows if not row.summary.unsupported]
        if whole:
            tables.append(_dataset_table(tuple(key), whole, separate))
        if len(whole) == len(rows):
            continue
        # All runs on the sequences that every one of them scored, if there is such a sequence.
        scored = [row.sequences for row in rows if row.sequences is not None]
        common = frozenset.intersection(*(each.ids for each in scored)) if len(scored) == len(rows) else frozenset()
        if common:
            restricted = []
            for row, each in zip(rows, scored):
                summary = msgspec.structs.replace(each.summary_over(common), findings=row.summary.findings)
                restricted.append(replace(row, summary=summary, only=common))
            brief = (f"{row.method} ({row.summary.unsupported})" for row in rows if row.summary.unsupported)
            table = _dataset_table(tuple(key), restricted, separate)
            of = rows[0].summary.sequences
            tables.append(replace(table, of=of, shortest=tuple(dict.fromkeys(brief)), common=common))
        else:
            tables += [_dataset_table(tuple(key), [row], separate) for row in rows if row.summary.unsupported]
            notes.append(f"{dataset}: there is no sequence that every method generated.")
    # Means over datasets are of all sequences; a dataset that no method generated as a whole gives its common ones.
    complete = {table.key for table in tables if not table.of}
    counted = [table for table in tables if not table.of or table.key not in complete]
    # Tables of two benchmarks are not expected to compare, and their titles tell them apart.
    for benchmark, dataset in sorted({(table.benchmark.name, table.dataset) for table in tables}):
        keys = [table.key for table in tables if (table.benchmark.name, table.dataset) == (benchmark, dataset)]
        different = [name for name, values in zip(_KEYS, zip(*keys)) if len(set(values)) > 1]
        if different:
            unlike = ", ".join(different)
            notes.append(f"{dataset} has {len(keys)} tables that must not be compared: they differ in {unlike}.")
    return Leaderboard(tuple(tables), tuple(_macro_tables(counted)), tuple(notes), collected.signed_by)


def _dataset_table(key: tuple[str, ...], entries: list[LeaderboardRow], separate: Separate) -> DatasetTable:
    first = entries[0]
    metrics = first.benchmark.ranked_metrics
    ordered = sorted(entries, key=_place)
    variants = _unique_variants(ordered)
    ranks = [dict[str, int]() for _ in ordered]
    leads = [set[str]() for _ in ordered]
    beaten_by = [dict[str, frozenset[int]]() for _ in ordered]
    for condition in first.benchmark.about.conditions:
        ranked = [i for i, entry in enumerate(ordered) if entry.record.condition == condition and _is_ranked(entry)]
        beaten = separate([ordered[i] for i in ranked], first.benchmark.compared_metrics)
        for info in metrics:
            found = (ordered[i].summary.metric(info.id) is not None and not hides(ordered[i], info) for i in ranked)
            shown = {place for place, is_shown in enumerate(found) if is_shown}
            # Being first of one is no distinction.
            if len(shown) < 2 or info.higher_is_better is None:
                continue
            losses = {place: beaten.get((place, info.id), frozenset()) & shown for place in shown}
            for place in shown:
                row = ranked[place]
                ranks[row][info.id] = 1 + len(losses[place])
                beaten_by[row][info.id] = frozenset(ranked[other] for other in losses[place])
                if all(place in losses[other] for other in shown - {place}):
                    leads[row].add(info.id)
    version = first.record.protocol_version
    earlier = None if first.protocol or version == first.benchmark.present_rules.version else version
    same = ("dataset", "title", "sequences", "synthetic", "redistribution")
    about: dict[str, Any] = {name: getattr(first.summary, name) for name in same}
    about |= {"key": key, "split": first.record.split, "protocol": first.protocol, "earlier_version": earlier}
    about |= {"recordings": max(entry.summary.recordings for entry in entries)}
    rows = tuple(TableRow(*row) for row in zip(ordered, variants, ranks, map(frozenset, leads), beaten_by))
    return DatasetTable(**about, rows=rows)


def _unique_variants(entries: list[LeaderboardRow]) -> list[str]:
    """Return variants, made unique by seed or by the run folder's name where method, condition and variant agree.

    Controls of all conditions stand together, so their condition distinguishes them first.
    """
    found = [""] * len(entries)
    unlike = set(range(len(entries)))
    for added in ("", "condition {0.record.condition}", "seed {0.record.seed}", "run {0.run}"):
        texts = ["; ".join(filter(None, (entry.variant, added.format(entry)))) for entry in entries]
        keys = []
        for entry, text in zip(entries, texts):
            condition = "control" if entry.record.method.kind == CONTROL else entry.record.condition
            keys.append((entry.method, entry.origin, condition, text))
        for i in sorted(unlike):
            found[i] = texts[i]
        unlike = {i for i in unlike if keys.count(keys[i]) > 1}
    return found


def _place(entry: LeaderboardRow) -> tuple:
    conditions = [*entry.benchmark.about.conditions, entry.record.condition]
    condition = conditions.index(entry.record.condition)
    return (entry.record.method.kind == CONTROL, condition, entry.method, entry.variant, entry.record.seed, entry.run)


def _is_ranked(entry: LeaderboardRow) -> bool:
    summary = entry.summary
    faults = entry.is_control or summary.hands_in_recordings or summary.findings or summary.unsupported
    return not faults and entry.record.is_usual and summary.sequences >= FEWEST_RANKED


def hides(entry: LeaderboardRow, info: MetricInfo) -> bool:
    """Return True where a metric says nothing of a motionless method, for which the study prints a dash."""
    return entry.record.method.motionless and info.irrelevant_if_motionless


def of_all_methods(tables: Iterable[DatasetTable]) -> tuple[DatasetTable, ...]:
    """Leave out tables of all sequences beside which one of the common sequences stands: the latter has every run."""
    tables = tuple(tables)
    common = {(table.dataset, table.key) for table in tables if table.common is not None}
    return tuple(table for table in tables if table.common is not None or (table.dataset, table.key) not in common)


def undecided_lines(table: DatasetTable) -> tuple[str, ...]:
    """Return sentences on what the data of a table cannot decide, and the smallest differences that they can."""
    entries = [row.entry for row in table.rows if not row.entry.is_control] or [row.entry for row in table.rows]
    compared = table.benchmark.compared_metrics
    measured = []
    for entry in entries:
        hidden = {info.id for info in compared if hides(entry, info)}
        measured.append([metric for metric in entry.summary.metrics if metric.metric not in hidden])
    # Methods are compared within their condition.
    methods = max(Counter(entry.record.condition for entry in entries).values())
    about = (table.dataset, table.split, table.sequences, table.recordings)
    return tuple(undecided(*about, measured, metrics=compared, methods=methods))


def _macro_tables(tables: Sequence[DatasetTable]) -> Iterable[MacroTable]:
    """Yield a table for each protocol with two datasets or more, if each dataset has one table under it."""
    # One mean has one protocol, bodies that are all measured or all estimated, and test parts or folds of everybody.
    groups: dict[tuple[str, bool, bool], list[DatasetTable]] = defaultdict(list)
    for table in tables:
        first = table.rows[0].entry.table
        groups[table.key[0], first.estimated_bodies, bool(first.units)].append(table)
    for _, under in sorted(groups.items()):
        datasets = tuple(table.dataset for table in under)
        # A mean over one dataset is that dataset's table; two tables of one dataset would count it twice.
        if len(datasets) < 2 or len(set(datasets)) < len(datasets):
            continue
        synthetic = any(table.synthetic for table in under)
        rows = tuple(_macro_rows(under))
        yield MacroTable(datasets, synthetic, rows, under[0].benchmark.name, under[0].earlier_version)


def _macro_rows(tables: Sequence[DatasetTable]) -> Iterable[MacroRow]:
    found: dict[tuple[str, str, str, str], dict[str, LeaderboardRow]] = defaultdict(dict)
    places: dict[tuple[str, str, str, str], list[int]] = defaultdict(list)  # of a method's rows, a table each
    for table in tables:
        for place, row in enumerate(table.rows):
            entry = row.entry
            key = (entry.record.condition, entry.method, row.variant, entry.origin)
            found[key][table.dataset] = entry
            places[key].append(place)
    names = [table.dataset for table in tables]
    benchmark = tables[0].benchmark
    means: dict[tuple[str, str, str, str], dict[str, MeanOverDatasets]] = {key: {} for key in found}
    ranks: dict[tuple[str, str, str, str], dict[str, int]] = {key: {} for key in found}
    for key, entries in found.items():
        # A mean over the easier datasets alone would look like a better method.
        for info in benchmark.main_metrics if len(entries) == len(names) else ():
            shown = [None if hides(entries[name], info) else entries[name].summary.metric(info.id) for name in names]
            mean = mean_over_datasets(shown)
            if mean is not None:
                means[key][info.id] = mean
    for condition in benchmark.about.conditions:
        keys = [key for key in found if key[0] == condition and all(map(_is_ranked, found[key].values()))]
        for info in benchmark.ranked_metrics:
            shown = [key for key in keys if info.id in means[key]]
            if len(shown) < 2 or info.higher_is_better is None:
                continue
            for key in shown:
                # Better on each dataset is better in the mean, whatever the weights; less is not known to be.
                mine = [table.rows[own] for table, own in zip(tables, places[key])]
                better = [row.beaten_by.get(info.id, frozenset()) for row in mine]
                wins = [all(place in rows for place, rows in zip(places[other], better)) for other in shown]
                ranks[key][info.id] = 1 + sum(wins)
    for key in sorted(found, key=lambda key: min(_place(entry) for entry in found[key].values())):
        condition, method, variant, origin = key
        entries = list(found[key].values())
        marked = [(entry.summary.mark, entry.summary.symbols) for entry in entries if entry.summary.mark]
        is_control = any(entry.record.method.kind == CONTROL for entry in entries)
        about = (method, origin, *(marked[0] if marked else ("", "")), is_control, condition, variant)
        missing = tuple(name for name in names if name not in found[key])
        unverified = any(entry.unverified for entry in entries)
        declared = max((entry.declared for entry in entries), key=len)
        yield MacroRow(*about, means[key], ranks[key], missing, unverified, declared, entries[0].training)


# Sequences below which no method is ranked.
FEWEST_RANKED = 50


def undecided(
    dataset: str,
    split: str,
    sequences: int,
    recordings: int,
    measured: Sequence[Iterable[MetricSummary]],
    *,
    metrics: Sequence[MetricInfo],
    methods: int = 2,
) -> Iterator[str]:
    """Yield sentences on what the data cannot decide, and the smallest differences that they can.

    Args:
        dataset: Its name.
        split: What was run on: the test split, or folds.
        sequences: Number of sequences that were scored.
        recordings: Number of recordings (of folds: participants) that they come from.
        measured: The scores of each method.
        metrics: The metrics by which methods of the benchmark are compared.
        methods: Number of methods that are compared with each other.
    """
    reason = why_undecided(split, sequences, recordings, methods=methods)
    if reason:
        yield f"{dataset} cannot be decided: {reason}."
    found: dict[str, list[float]] = {}
    for metric in itertools.chain.from_iterable(measured):
        if metric.detectable is not None:
            found.setdefault(metric.metric, []).append(metric.detectable)
    texts = []
    for info in metrics:
        if info.id not in found:
            continue
        detectable = median(found[info.id])
        if info.unit != "rate":
            texts.append(f"{info.title} {info.scale * detectable:.2g}{printed_unit(info.unit)}")
        elif detectable > 1:
            texts.append(f"{info.title} none (not even 100 points)")
        else:
            texts.append(f"{info.title} {info.scale * detectable:.0f} points")
    if texts:
        sentence = "Smallest difference between two unrelated methods of this spread that would be found in four of"
        sentence += f" five repetitions, at the first step of Holm's correction for {len(metrics)} metrics:"
        yield f"{sentence} {', '.join(texts)}."


def why_undecided(split: str, sequences: int, recordings: int, *, methods: int = 2) -> str:
    """Say why nothing can be decided on so few data; empty if something can."""
    needed = units_needed(sum(info.compared for info in MAIN_METRICS) * comb(max(methods, 2), 2))
    if recordings < needed:
        return f"{counted_units(recordings, split)}, where a comparison of {max(methods, 2)} methods needs {needed}"
    if sequences < FEWEST_RANKED:
        return f"{sequences} sequences, where a ranking needs {FEWEST_RANKED}"
    return ""
