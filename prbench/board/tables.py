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

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median

from prbench.board.collect import CollectedRuns, LeaderboardRow
from prbench.board.comparison import Separate, separate_by_comparison
from prbench.harness.benchmark import Benchmark
from prbench.harness.clusters import FEWEST_FOR_TEST, recordings_needed
from prbench.harness.intervals import POINTS, POWER
from prbench.harness.run_folder.record import CONTROL
from prbench.harness.run_folder.summary import MeanOverDatasets, MetricSummary, mean_over_datasets
from prbench.metrics import RANKED_METRICS, MetricInfo, printed_unit

_KEYS = ("protocol", "table identity", "table content", "split", "chosen sequences")


@dataclass(frozen=True)
class TableRow:
    """A line of a dataset's table."""

    entry: LeaderboardRow
    variant: str
    """Unique among the rows of one method and condition in one table."""
    ranks: dict[str, int]
    """Maps ranked metrics to ranks, which methods share that the data cannot separate; empty where none is ranked."""
    leads: frozenset[str] = frozenset()
    """Ranked metrics in which it is better than every other method, each by a supported difference."""
    beaten_by: Mapping[str, frozenset[int]] = field(default_factory=dict)
    """Maps ranked metrics to the places of the rows in the table that are better by a supported difference."""


@dataclass(frozen=True)
class DatasetTable:
    """All comparable runs on one dataset."""

    dataset: str
    title: str
    split: str
    sequences: int
    recordings: int
    synthetic: bool
    redistribution: str
    key: tuple[str, ...]
    """Values of ``_KEYS``, on which the rows agree."""
    rows: tuple[TableRow, ...]
    """Sorted by condition, controls last."""
    of: int = 0
    """Number of the chosen sequences where the table is of the common ones alone; 0 where it is of all."""
    shortest: tuple[str, ...] = ()
    """Methods that left sequences out, with how many, where the table is of the common ones."""
    common: frozenset[str] | None = None
    """Ids of the common sequences; None where the table is of all."""
    protocol: str = ""
    """Name and version of a user's own protocol; empty for prbench's."""
    earlier_version: int | None = None
    """Version of prbench's own protocol where it is not the present one."""

    @property
    def benchmark(self) -> Benchmark:
        """The benchmark of all rows."""
        return self.rows[0].entry.benchmark

    @property
    def estimated_bodies(self) -> bool:
        """Bodies were estimated from whole tracks of the head."""
        return self.rows[0].entry.table.estimated_bodies

    @property
    def protocol_digest(self) -> str:
        """Digest of the rules by which the rows were scored."""
        return self.key[0]


@dataclass(frozen=True)
class MacroRow:
    """Means of one method over the datasets."""

    method: str
    """Name of the method."""
    origin: str
    """Origin of the method, in words."""
    mark: str
    """A remark about its motions that readers must know, of the first dataset that has one; empty without."""
    symbols: str
    """The signs of the mark."""
    is_control: bool
    """Made by the harness: shown, never ranked."""
    condition: str
    """What the method was given."""
    variant: str
    """Control, weights, options and the like, by which rows of one method differ."""
    means: dict[str, MeanOverDatasets]
    """Maps ids of metrics to means, each dataset counting alike; empty if the method lacks a dataset."""
    ranks: dict[str, int]
    """Maps ids of metrics to ranks, from 1; empty where nothing is ranked."""
    missing: tuple[str, ...]
    """Datasets that the method lacks."""
    unverified: bool
    """Scores on one of the datasets or more were not held against the motions."""


@dataclass(frozen=True)
class MacroTable:
    """Methods over all datasets of one protocol."""

    datasets: tuple[str, ...]
    """Names of the datasets."""
    synthetic: bool
    """One of them is synthetic."""
    rows: tuple[MacroRow, ...]
    """The methods."""
    benchmark: str
    """Name of the benchmark."""
    earlier_version: int | None = None
    """Version of prbench's own protocol where it is not the present one."""


@dataclass(frozen=True)
class Leaderboard:
    """Everything that an export shows."""

    tables: tuple[DatasetTable, ...]
    macro: tuple[MacroTable, ...]
    notes: tuple[str, ...]


def make_leaderboard(collected: CollectedRuns, *, separate: Separate = separate_by_comparison) -> Leaderboard:
    """Sort rows into comparable tables, rank them, and take means over datasets.

    Args:
        collected: The runs.
        separate: Finds out which differences are supported; by default from the scores of the sequences.
    """
    groups: dict[tuple[str, ...], list[LeaderboardRow]] = defaultdict(list)
    for row in collected.rows:
        groups[(row.summary.dataset, *_comparison_key(row))].append(row)
    tables: list[DatasetTable] = []
    notes = [f"Left out: {reason}." for reason in collected.left_out]
    for _, rows in sorted(groups.items()):
        whole = [row for row in rows if not row.summary.unsupported]
        if whole:
            tables.append(_dataset_table(whole, separate))
        if len(whole) == len(rows):
            continue
        common = _common_table(rows, separate)
        if common is not None:
            tables.append(common)
        else:
            tables += [_dataset_table([row], separate) for row in rows if row.summary.unsupported]
            notes.append(f"{rows[0].summary.dataset}: there is no sequence that every method generated.")
    # Means over datasets are of all sequences; a dataset that no method generated as a whole gives its common ones.
    complete = {table.key for table in tables if not table.of}
    counted = [table for table in tables if not table.of or table.key not in complete]
    notes += _separations(tables)
    return Leaderboard(tuple(tables), tuple(_macro_tables(counted)), tuple(notes))


def _common_table(rows: list[LeaderboardRow], separate: Separate) -> DatasetTable | None:
    """All runs on the sequences that every one of them scored; None if there is no such sequence."""
    scored = [row.sequences for row in rows]
    known = [sequences for sequences in scored if sequences is not None]
    if len(known) < len(rows):
        return None
    common = frozenset.intersection(*(sequences.ids for sequences in known))
    if not common:
        return None
    restricted = [
        replace(row, summary=sequences.summary_over(common), only=common) for row, sequences in zip(rows, known)
    ]
    left_out = dict.fromkeys(f"{row.method} ({row.summary.unsupported})" for row in rows if row.summary.unsupported)
    table = _dataset_table(restricted, separate)
    return replace(table, of=rows[0].summary.sequences, shortest=tuple(left_out), common=common)


def _comparison_key(row: LeaderboardRow) -> tuple[str, ...]:
    table = row.table
    digests = (row.record.protocol_digest, table.identity_digest, table.content_digest)
    return (*digests, row.record.split, table.selection_digest)


def _separations(tables: Sequence[DatasetTable]) -> Iterable[str]:
    """Yield a note for each dataset that has more than one table."""
    # Tables of two benchmarks are not expected to compare, and their titles tell them apart.
    for benchmark, dataset in sorted({(table.benchmark.name, table.dataset) for table in tables}):
        keys = [table.key for table in tables if (table.benchmark.name, table.dataset) == (benchmark, dataset)]
        different = [name for i, name in enumerate(_KEYS) if len({key[i] for key in keys}) > 1]
        if different:
            yield f"{dataset} has {len(keys)} tables that must not be compared: they differ in {', '.join(different)}."


def _dataset_table(entries: list[LeaderboardRow], separate: Separate) -> DatasetTable:
    first = entries[0]
    metrics = first.benchmark.ranked_metrics
    ordered = sorted(entries, key=_place)
    variants = _unique_variants(ordered)
    ranks = [dict[str, int]() for _ in ordered]
    leads = [set[str]() for _ in ordered]
    beaten_by = [dict[str, frozenset[int]]() for _ in ordered]
    for condition in first.benchmark.about.conditions:
        ranked = [i for i, entry in enumerate(ordered) if entry.record.condition == condition and _is_ranked(entry)]
        beaten = separate([ordered[i] for i in ranked], metrics)
        for info in metrics:
            shown = {place for place, i in enumerate(ranked) if _is_shown(ordered[i], info)}
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
    return DatasetTable(
        dataset=first.summary.dataset,
        title=first.summary.title,
        split=first.record.split,
        sequences=first.summary.sequences,
        recordings=max(entry.summary.recordings for entry in entries),
        synthetic=first.summary.synthetic,
        redistribution=first.summary.redistribution,
        key=_comparison_key(first),
        rows=tuple(TableRow(*row) for row in zip(ordered, variants, ranks, map(frozenset, leads), beaten_by)),
        protocol=first.protocol,
        earlier_version=(None if first.protocol or version == first.benchmark.present_rules.version else version),
    )


def _is_shown(entry: LeaderboardRow, info: MetricInfo) -> bool:
    return entry.metric(info.id) is not None and not hides(entry, info)


def _unique_variants(entries: list[LeaderboardRow]) -> list[str]:
    """Return variants, made unique by seed or by the run folder's name where method, condition and variant agree.

    Controls of all conditions stand together, so their condition distinguishes them first.
    """
    plain = [entry.variant for entry in entries]
    conditioned = [_joined(entry.variant, f"condition {entry.record.condition}") for entry in entries]
    seeded = [_joined(entry.variant, f"seed {entry.record.seed}") for entry in entries]
    named = [_joined(entry.variant, f"run {entry.run}") for entry in entries]

    def shown(entry: LeaderboardRow, text: str) -> tuple[str, str, str, str]:
        condition = "control" if entry.record.method.kind == CONTROL else entry.record.condition
        return entry.method, entry.origin, condition, text

    def first_unlike(i: int) -> str:
        for texts in (plain, conditioned, seeded):
            rows = [shown(entry, text) for entry, text in zip(entries, texts)]
            if rows.count(rows[i]) == 1:
                return texts[i]
        return named[i]

    return [first_unlike(i) for i in range(len(entries))]


def _joined(*parts: str) -> str:
    return "; ".join(part for part in parts if part)


def _place(entry: LeaderboardRow) -> tuple:
    conditions = [*entry.benchmark.about.conditions, entry.record.condition]
    condition = conditions.index(entry.record.condition)
    return (entry.record.method.kind == CONTROL, condition, entry.method, entry.variant, entry.record.seed, entry.run)


def _is_ranked(entry: LeaderboardRow) -> bool:
    return (
        not entry.is_control
        and not entry.summary.hands_in_recordings
        and entry.record.is_usual
        and not entry.summary.unsupported
        and entry.scored >= FEWEST_RANKED
    )


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
    metrics = [[metric for metric in entry.summary.metrics if metric.metric not in _hidden(entry)] for entry in entries]
    ranked = table.benchmark.ranked_metrics
    return tuple(undecided(table.dataset, table.sequences, table.recordings, metrics, ranked=ranked))


def _hidden(entry: LeaderboardRow) -> set[str]:
    return {info.id for info in entry.benchmark.main_metrics if hides(entry, info)}


def _macro_tables(tables: Sequence[DatasetTable]) -> Iterable[MacroTable]:
    """Yield a table for each protocol with two datasets or more, if each dataset has one table under it."""
    for kind in sorted({_kind(table) for table in tables}):
        under = [table for table in tables if _kind(table) == kind]
        datasets = tuple(table.dataset for table in under)
        # A mean over one dataset is that dataset's table; two tables of one dataset would count it twice.
        if len(datasets) < 2 or len(set(datasets)) < len(datasets):
            continue
        synthetic = any(table.synthetic for table in under)
        yield MacroTable(
            datasets, synthetic, tuple(_macro_rows(under)), under[0].benchmark.name, under[0].earlier_version
        )


def _kind(table: DatasetTable) -> tuple[str, bool]:
    """What tables have in common that may enter one mean: the protocol, and whether bodies are estimates."""
    return table.protocol_digest, table.estimated_bodies


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
    means = {key: _macro_means(entries, names) for key, entries in found.items()}
    ranks: dict[tuple[str, str, str, str], dict[str, int]] = {key: {} for key in found}
    for condition in tables[0].benchmark.about.conditions:
        keys = [key for key in found if key[0] == condition and all(_is_ranked(entry) for entry in found[key].values())]
        for info in tables[0].benchmark.ranked_metrics:
            shown = [key for key in keys if info.id in means[key]]
            if len(shown) < 2 or info.higher_is_better is None:
                continue
            for key in shown:
                # Better on each dataset is better in the mean, whatever the weights; less is not known to be.
                better = [
                    table.rows[own].beaten_by.get(info.id, frozenset()) for table, own in zip(tables, places[key])
                ]
                wins = [all(place in rows for place, rows in zip(places[other], better)) for other in shown]
                ranks[key][info.id] = 1 + sum(wins)
    for key in sorted(found, key=lambda key: min(_place(entry) for entry in found[key].values())):
        condition, method, variant, origin = key
        entries = found[key].values()
        missing = tuple(name for name in names if name not in found[key])
        is_control = any(entry.record.method.kind == CONTROL for entry in entries)
        mark, symbols = next(((entry.mark, entry.summary.symbols) for entry in entries if entry.mark), ("", ""))
        unverified = any(entry.unverified for entry in entries)
        yield MacroRow(
            method, origin, mark, symbols, is_control, condition, variant, means[key], ranks[key], missing, unverified
        )


def _macro_means(entries: dict[str, LeaderboardRow], datasets: list[str]) -> dict[str, MeanOverDatasets]:
    # A mean over the easier datasets alone would look like a better method.
    if any(name not in entries for name in datasets):
        return {}
    means = {}
    for info in entries[datasets[0]].benchmark.main_metrics:
        shown = [None if hides(entries[name], info) else entries[name].metric(info.id) for name in datasets]
        mean = mean_over_datasets(shown)
        if mean is not None:
            means[info.id] = mean
    return means


FEWEST_RANKED = 50
"""Sequences below which no method is ranked."""


def undecided(
    dataset: str,
    sequences: int,
    recordings: int,
    methods: Sequence[Iterable[MetricSummary]],
    *,
    ranked: Sequence[MetricInfo] = RANKED_METRICS,
) -> Iterator[str]:
    """Yield sentences on what the data cannot decide, and the smallest differences that they can.

    Args:
        dataset: Its name.
        sequences: Number of sequences that were scored.
        recordings: Number of recordings that they come from.
        methods: The scores of each method.
        ranked: The metrics by which methods of the benchmark are ranked.
    """
    reason = why_undecided(sequences, recordings)
    if reason:
        yield f"{dataset} cannot be decided: {reason}."
    if recordings < FEWEST_FOR_TEST:
        return
    found: dict[str, list[float]] = {}
    for metrics in methods:
        for metric in metrics:
            if metric.detectable is not None:
                found.setdefault(metric.metric, []).append(metric.detectable)
    texts = [_detectable_text(info, median(found[info.id])) for info in ranked if info.id in found]
    if texts:
        yield (
            "Smallest difference between two unrelated methods of this spread that would be found in four of five"
            f" repetitions, at the first step of Holm's correction for {len(ranked)} metrics:"
            f" {', '.join(texts)}."
        )

    rate = next((info for info in ranked if info.unit == "rate" and found.get(info.id)), None)
    if rate is not None:
        needed = [
            recordings_needed(
                median(found[rate.id]),
                points / 100,
                recordings=recordings,
                comparisons=len(ranked),
                power=POWER,
            )
            for points in POINTS
        ]
        yield (
            f"{rate.title}: to find {_listed(POINTS)} points as surely, about {_listed(needed)} recordings like these"
            " are needed."
        )


def why_undecided(sequences: int, recordings: int) -> str:
    """Say why nothing can be decided on so few data; empty if something can."""
    if recordings < FEWEST_FOR_TEST:
        plural = "" if recordings == 1 else "s"
        return f"{recordings} recording{plural}, where a comparison of methods needs {FEWEST_FOR_TEST}"
    if sequences < FEWEST_RANKED:
        return f"{sequences} sequences, where a ranking needs {FEWEST_RANKED}"
    return ""


def _listed(numbers: Sequence[int]) -> str:
    *first, last = map(str, numbers)
    return f"{', '.join(first)} and {last}"


def _detectable_text(info: MetricInfo, detectable: float) -> str:
    """A metric with its smallest detectable difference, or that there is none."""
    if info.unit == "rate" and detectable > 1:
        return f"{info.title} none (not even 100 points)"
    if info.unit == "rate":
        return f"{info.title} {info.scale * detectable:.0f} points"
    return f"{info.title} {info.scale * detectable:.2g}{printed_unit(info.unit)}"
