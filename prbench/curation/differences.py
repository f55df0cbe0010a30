"""Compare two builds: which events and sequences appeared, vanished or moved, what decided, and which columns differ.

Numbers are compared to 10 µm (or as little of another unit).
"""

from __future__ import annotations

import hashlib
import math
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from prbench.errors import UsageError
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.schema import is_bulky
from prbench.sequences.sequence import KEY_VALUES, OUTCOMES, SEQUENCES

Row = Mapping[str, Any]
"""Values by column; in place of per-frame values and poses their digest."""
_WITHIN = 1e-5
_LARGEST_SHIFT = 1.0
"""Seconds between two events that may be the same one."""
Kind = Literal["gained", "lost", "appeared", "vanished", "moved", "outcome", "values"]
KINDS: dict[str, str] = {
    "gained": "an event that became a sequence only in the second build",
    "lost": "an event that was a sequence only in the first build",
    "appeared": "an event that only the second build found",
    "vanished": "an event that only the first build found",
    "moved": "a sequence in both, with other event or prime times or another place",
    "outcome": "left out by both, for different reasons",
    "values": "the same sequence, event or recording in both, with other values in the columns named",
}
"""Kinds of changes in the order of a report."""
_SAME_TIME = 1e-6  # s, m
_SAME_PLACE = 1e-5
Event = dict[str, Any]
"""One row of ``events``."""
_DIGESTED = tuple(field.name for field in SEQUENCES if is_bulky(field.type) and field.type != KEY_VALUES)


@dataclass(frozen=True)
class Change:
    """One event that is not the same in both builds."""

    kind: Kind
    """``gained``, ``lost``, ``appeared``, ``vanished``, ``moved``, ``outcome`` or ``values``."""
    recording_id: str
    """Name of the recording."""
    event: str
    """``object name/action/time`` as a person would say it; empty for a change of the recording itself."""
    first: str
    """Outcome in the first build; empty where it has no such event."""
    second: str
    """Outcome in the second build; empty where it has no such event."""
    decided_by: str
    """Stage that made the difference, with its number and threshold where it has them."""


@dataclass(frozen=True)
class Difference:
    """Everything that differs between two builds."""

    settings: tuple[tuple[str, str, str], ...]
    """Name, first and second value of every entry of ``dataset.json`` that decides what a build finds."""
    changes: tuple[Change, ...]
    """Sorted by kind, recording and time."""
    unchanged_events: int
    """Number of events that are the same in both."""
    unchanged_sequences: int
    """Number of sequences among them."""

    @property
    def equal(self) -> bool:
        """Return True if the two builds hold the same events, sequences and recordings."""
        return not self.changes


def compare_builds(first: Path | str, second: Path | str) -> Difference:
    """Compare two built datasets.

    Raises:
        TableError: if a folder holds no built dataset, or one of which a file was edited.
        UsageError: if they are builds of different datasets.
    """
    tables = [SequenceTable.open(folder) for folder in (first, second)]
    names = [table.info.dataset for table in tables]
    if names[0] != names[1]:
        raise UsageError(f"{first} holds {names[0]} and {second} holds {names[1]}; compare builds of one dataset.")
    before, after = (table.events().to_pylist() for table in tables)
    recordings = [{row["recording_id"]: row for row in table.recordings().to_pylist()} for table in tables]
    sequences = [_sequence_rows(table) for table in tables]
    changes: list[tuple[float, Change]] = []
    same_events = same_sequences = 0
    for one, other in _pairs(before, after):
        change = _change(one, other, recordings, sequences)
        if change is not None:
            changes.append(((other or one or {})["event_time"], change))
            continue
        same_events += 1
        same_sequences += one is not None and one["outcome"] == "sequence"
    changes += [(0.0, change) for change in _sequences_without_event(before, after, sequences)]
    reported = {change.recording_id for _, change in changes}
    changes += [(0.0, change) for change in _changed_recordings(recordings[0], recordings[1], reported)]
    order = {kind: rank for rank, kind in enumerate(KINDS)}
    changes.sort(key=lambda item: (order[item[1].kind], item[1].recording_id, item[0], item[1].event))
    return Difference(
        settings=_settings(*(table.info for table in tables)),
        changes=tuple(change for _, change in changes),
        unchanged_events=same_events,
        unchanged_sequences=same_sequences,
    )


def _pairs(before: list[Event], after: list[Event]) -> Iterator[tuple[Event | None, Event | None]]:
    """Events of the two builds side by side; None where one has no partner."""
    groups: dict[tuple[str, str, str], tuple[list[Event], list[Event]]] = defaultdict(lambda: ([], []))
    for side, events in enumerate((before, after)):
        for event in events:
            groups[event["recording_id"], event["object_id"], event["action"]][side].append(event)
    for key in sorted(groups):
        yield from _pair_group(*groups[key])


def _sequence_rows(table: SequenceTable) -> dict[str, Row]:
    """Every column of every sequence, by ``sequence_id``."""
    found: dict[str, Row] = {}
    short = [name for name in SEQUENCES.names if name not in _DIGESTED]
    for chunk in table.chunks():
        rows = chunk.batch.select(short).to_pylist()
        for index, row in enumerate(rows):
            digests = {name: _digest(chunk.batch.column(name).slice(index, 1)) for name in _DIGESTED}
            found[row["sequence_id"]] = row | digests
    return found


def _digest(column: pa.Array) -> bytes:
    """Digest of one row's numbers, rounded to 10 µm."""
    if column.null_count:
        return b""
    while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        column = column.flatten()
    values = column.to_numpy(zero_copy_only=False)
    if values.dtype != bool:
        values = np.rint(values.astype(np.float64) / _WITHIN).astype(np.int64)
    return hashlib.sha256(values.tobytes()).digest()


def _pair_group(ours: list[Event], theirs: list[Event]) -> Iterator[tuple[Event | None, Event | None]]:
    gaps = np.abs(np.subtract.outer([e["event_time"] for e in ours], [e["event_time"] for e in theirs]))
    rows, columns = np.nonzero(gaps.reshape(len(ours), len(theirs)) <= _LARGEST_SHIFT)
    partner: dict[int, int] = {}
    taken: set[int] = set()
    for index in np.argsort(gaps[rows, columns], kind="stable") if len(rows) else ():
        row = int(rows[index])
        column = int(columns[index])
        if row not in partner and column not in taken:
            partner[row] = column
            taken.add(column)
    yield from ((event, theirs[partner[row]] if row in partner else None) for row, event in enumerate(ours))
    yield from ((None, event) for column, event in enumerate(theirs) if column not in taken)


def _change(
    one: Event | None,
    other: Event | None,
    recordings: list[dict[str, Row]],
    sequences: list[dict[str, Row]],
) -> Change | None:
    """Compare one event of both builds; None if nothing differs."""
    if one is None or other is None:
        event, absent = (other, recordings[0]) if one is None else (one, recordings[1])
        assert event is not None
        decided = _why_absent(absent, event["recording_id"])
        return _described("appeared" if one is None else "vanished", one, other, decided)
    was = one["outcome"] == "sequence"
    is_now = other["outcome"] == "sequence"
    if was != is_now:
        return _described("lost" if was else "gained", one, other, _decision(other if was else one))
    if (one["outcome"], one["stage"]) != (other["outcome"], other["stage"]):
        return _described("outcome", one, other, f"{_decision(one)} → {_decision(other)}")
    # Say how far times and place of an event moved; empty if they did not.
    parts = []
    for name in ("event_time", "prime_time"):
        if one[name] is not None and other[name] is not None and abs(other[name] - one[name]) > _SAME_TIME:
            parts.append(f"{name.removesuffix('_time')} {other[name] - one[name]:+.3f} s")
    if one["location"] is not None and other["location"] is not None:
        distance = float(np.linalg.norm(np.subtract(other["location"], one["location"])))
        if distance > _SAME_PLACE:
            parts.append(f"place {distance:.3f} m")
    if one["prime_kind"] != other["prime_kind"]:
        parts.append(f"{one['prime_kind']} → {other['prime_kind']}")
    shift = ", ".join(parts)
    if shift and was:
        return _described("moved", one, other, shift)
    columns = _differing_columns(one, other)
    if was:
        columns += _differing_of_sequence(sequences[0].get(one["sequence_id"]), sequences[1].get(other["sequence_id"]))
    return _described("values", one, other, ", ".join(dict.fromkeys(columns))) if columns else None


def _differing_columns(one: Row, other: Row, *, besides: Collection[str] = ()) -> list[str]:
    """Names of the columns whose values differ, in the order of the first row.

    Args:
        one: A row.
        other: One of the same columns.
        besides: Columns that are not compared.
    """
    return [name for name in one if name not in besides and not _same(one[name], other[name])]


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= _WITHIN or one == other or (math.isnan(one) and math.isnan(other))
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(_same(*pair) for pair in zip(one, other, strict=True))
    return one == other


def _differing_of_sequence(one: Row | None, other: Row | None) -> list[str]:
    if one is None or other is None:
        return [] if one is other else ["no row in sequences in one of them"]
    return _differing_columns(one, other)


def _sequences_without_event(
    before: list[Event], after: list[Event], sequences: list[dict[str, Row]]
) -> Iterator[Change]:
    """Sequences of one build only that no event names."""
    named = {event["sequence_id"] for event in [*before, *after]}
    for name in sorted((sequences[0].keys() ^ sequences[1].keys()) - named):
        row = sequences[0].get(name) or sequences[1][name]
        event = f"{row['object_name']}/{row['action']}/{row['event_time']:.3f} s"
        known = name in sequences[0]
        kind: Kind = "vanished" if known else "appeared"
        before_and_after = ("sequence", "") if known else ("", "sequence")
        yield Change(kind, row["recording_id"], event, *before_and_after, "a sequence that no event names")


def _changed_recordings(one: dict[str, Row], other: dict[str, Row], reported: Collection[str]) -> Iterator[Change]:
    """Recordings with other values; what follows from changes of their events, which are reported, is left out."""
    for name in sorted(one.keys() | other.keys()):
        if name not in one or name not in other:
            if name not in reported:
                kind: Kind = "appeared" if name not in one else "vanished"
                there = one.get(name) or other[name]
                before_and_after = ("", there["status"]) if name not in one else (there["status"], "")
                yield Change(kind, name, "", *before_and_after, "recording in one of the builds only")
            continue
        columns = _differing_columns(
            one[name], other[name], besides=(*OUTCOMES, "status", "message") if name in reported else ()
        )
        if columns:
            yield Change("values", name, "", one[name]["status"], other[name]["status"], ", ".join(columns))


def _described(kind: Kind, one: Event | None, other: Event | None, decided_by: str) -> Change:
    event = other or one
    assert event is not None
    return Change(
        kind=kind,
        recording_id=event["recording_id"],
        event=f"{event['object_name']}/{event['action']}/{event['event_time']:.3f} s",
        first="" if one is None else one["outcome"],
        second="" if other is None else other["outcome"],
        decided_by=decided_by,
    )


def _why_absent(recordings: dict[str, Row], recording_id: str) -> str:
    if recording_id not in recordings:
        return "recording not in that build"
    status = recordings[recording_id]["status"]
    message = recordings[recording_id]["message"]
    return "in_hand or annotations: no such event within 1 s" if status == "read" else f"recording {status}: {message}"


def _decision(event: Event) -> str:
    if event["value"] is None:
        return event["stage"]
    threshold = "" if event["threshold"] is None else f" (threshold {event['threshold']:g})"
    return f"{event['stage']}: {event['value']:.3f}{threshold}"


def _settings(one: DatasetInfo, other: DatasetInfo) -> tuple[tuple[str, str, str], ...]:
    names = ("dataset", "prbench_version", "protocol_digest", "manifest_digest", "input_digest")
    pairs = [(name, str(getattr(one, name)), str(getattr(other, name))) for name in names]
    for name in sorted(one.options.keys() | other.options.keys()):
        pairs.append((f"option {name}", one.options.get(name, "–"), other.options.get(name, "–")))
    return tuple(pair for pair in pairs if pair[1] != pair[2])
