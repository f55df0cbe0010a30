"""What changed between two builds: which events and sequences appeared, vanished or moved, and what decided.

Events of the two builds are paired by recording, object and action, nearest in time first (design, section 2).
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from prbench.errors import UsageError
from prbench.sequences import DatasetInfo, SequenceTable

LARGEST_SHIFT = 1.0
"""Seconds between two events that may be the same one."""
Kind = Literal["gained", "lost", "appeared", "vanished", "moved", "outcome", "values"]
KINDS: dict[str, str] = {
    "gained": "an event that became a sequence only in the second build",
    "lost": "an event that was a sequence only in the first build",
    "appeared": "an event that only the second build found",
    "vanished": "an event that only the first build found",
    "moved": "a sequence in both, with other event or prime times or another place",
    "outcome": "left out by both, for different reasons",
    "values": "the same sequence in both, with other poses, gaze or split",
}
"""Kinds of changes in the order of a report."""
_SAME_TIME, _SAME_PLACE = 1e-6, 1e-5  # s, m


@dataclass(frozen=True)
class Change:
    """One event that is not the same in both builds."""

    kind: Kind
    recording_id: str
    event: str
    """``object name/action/time`` as a person would say it."""
    before: str
    """What the first build made of it; empty where it has no such event."""
    after: str
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
    unchanged_sequences: int

    @property
    def equal(self) -> bool:
        """Whether the two builds hold the same events and sequences."""
        return not self.changes


def compare_builds(first: Path | str, second: Path | str) -> Difference:
    """Compare two built datasets.

    Raises:
        TableError: if a folder holds no built dataset.
        UsageError: if they are builds of different datasets.
    """
    first = Path(first)
    second = Path(second)
    tables = [SequenceTable(folder, DatasetInfo.read(folder)) for folder in (first, second)]
    names = [table.info.dataset for table in tables]
    if names[0] != names[1]:
        raise UsageError(f"{first} holds {names[0]} and {second} holds {names[1]}; compare builds of one dataset.")
    before, after = (_events(table) for table in tables)
    statuses = [_statuses(table) for table in tables]
    contents = [_contents(table) for table in tables]
    changes: list[tuple[float, Change]] = []
    same_events = same_sequences = 0
    for one, other in _pairs(before, after):
        change = _change(one, other, statuses, contents)
        if change is not None:
            changes.append(((other or one or {})["event_time"], change))
            continue
        same_events += 1
        same_sequences += one is not None and one["outcome"] == "sequence"
    order = {kind: rank for rank, kind in enumerate(KINDS)}
    changes.sort(key=lambda item: (order[item[1].kind], item[1].recording_id, item[0], item[1].event))
    return Difference(
        settings=_settings(*(table.info for table in tables)),
        changes=tuple(change for _, change in changes),
        unchanged_events=same_events,
        unchanged_sequences=same_sequences,
    )


Event = dict[str, Any]
"""One row of ``events``."""


def _events(table: SequenceTable) -> list[Event]:
    return table.events().to_pylist()


def _statuses(table: SequenceTable) -> dict[str, tuple[str, str]]:
    rows = table.recordings().select(["recording_id", "status", "message"]).to_pylist()
    return {row["recording_id"]: (row["status"], row["message"]) for row in rows}


def _contents(table: SequenceTable) -> dict[str, str]:
    """Digest of poses, gaze and split of every sequence, values rounded to 10 µm."""
    columns = ["joints", "gaze_origin", "gaze_direction", "gaze_valid", "split"]
    found = {}
    for chunk in table.chunks(columns=columns):
        for name, row in zip(chunk.batch.column("sequence_id").to_pylist(), range(chunk.batch.num_rows), strict=True):
            digest = hashlib.sha256()
            for column in columns:
                digest.update(_bytes(chunk.batch.column(column).slice(row, 1)))
            found[name] = digest.hexdigest()
    return found


def _bytes(column: pa.Array) -> bytes:
    if pa.types.is_string(column.type):
        return str(column[0]).encode()
    while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        column = column.flatten()
    values = column.to_numpy(zero_copy_only=False)
    return (np.rint(values.astype(np.float64) * 1e5).astype(np.int64) if values.dtype != bool else values).tobytes()


def _pairs(before: list[Event], after: list[Event]) -> Iterator[tuple[Event | None, Event | None]]:
    """Events of the two builds side by side; None where one has no partner."""
    groups: dict[tuple[str, str, str], tuple[list[Event], list[Event]]] = defaultdict(lambda: ([], []))
    for side, events in enumerate((before, after)):
        for event in events:
            groups[event["recording_id"], event["object_id"], event["action"]][side].append(event)
    for key in sorted(groups):
        yield from _pair_group(*groups[key])


def _pair_group(ours: list[Event], theirs: list[Event]) -> Iterator[tuple[Event | None, Event | None]]:
    gaps = np.abs(np.subtract.outer([e["event_time"] for e in ours], [e["event_time"] for e in theirs]))
    rows, columns = np.nonzero(gaps.reshape(len(ours), len(theirs)) <= LARGEST_SHIFT)
    partner: dict[int, int] = {}
    taken: set[int] = set()
    for index in np.argsort(gaps[rows, columns], kind="stable") if len(rows) else ():
        row, column = int(rows[index]), int(columns[index])
        if row not in partner and column not in taken:
            partner[row] = column
            taken.add(column)
    yield from ((event, theirs[partner[row]] if row in partner else None) for row, event in enumerate(ours))
    yield from ((None, event) for column, event in enumerate(theirs) if column not in taken)


def _change(
    one: Event | None,
    other: Event | None,
    statuses: list[dict[str, tuple[str, str]]],
    contents: list[dict[str, str]],
) -> Change | None:
    """What is different about one event; None if nothing is."""
    if one is None or other is None:
        event, absent = (other, statuses[0]) if one is None else (one, statuses[1])
        assert event is not None
        decided = _why_absent(absent, event["recording_id"])
        return _described("appeared" if one is None else "vanished", one, other, decided)
    was, is_now = one["outcome"] == "sequence", other["outcome"] == "sequence"
    if was != is_now:
        return _described("lost" if was else "gained", one, other, _decision(other if was else one))
    if not was:
        same = one["outcome"] == other["outcome"] and one["stage"] == other["stage"]
        return None if same else _described("outcome", one, other, f"{_decision(one)} → {_decision(other)}")
    shift = _shift(one, other)
    if shift:
        return _described("moved", one, other, shift)
    if contents[0].get(one["sequence_id"]) != contents[1].get(other["sequence_id"]):
        source = "" if one["sequence_id"] == other["sequence_id"] else ", other body"
        return _described("values", one, other, f"poses, gaze or split{source}")
    return None


def _described(kind: Kind, one: Event | None, other: Event | None, decided_by: str) -> Change:
    event = other or one
    assert event is not None
    return Change(
        kind=kind,
        recording_id=event["recording_id"],
        event=f"{event['object_name']}/{event['action']}/{event['event_time']:.3f} s",
        before="" if one is None else one["outcome"],
        after="" if other is None else other["outcome"],
        decided_by=decided_by,
    )


def _why_absent(statuses: dict[str, tuple[str, str]], recording_id: str) -> str:
    if recording_id not in statuses:
        return "recording not in that build"
    status, message = statuses[recording_id]
    return "in_hand or annotations: no such event within 1 s" if status == "read" else f"recording {status}: {message}"


def _decision(event: Event) -> str:
    if event["value"] is None:
        return event["stage"]
    threshold = "" if event["threshold"] is None else f" (threshold {event['threshold']:g})"
    return f"{event['stage']}: {event['value']:.3f}{threshold}"


def _shift(one: Event, other: Event) -> str:
    """How far times and place of an event moved; empty if they did not."""
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
    return ", ".join(parts)


def _settings(one: DatasetInfo, other: DatasetInfo) -> tuple[tuple[str, str, str], ...]:
    names = ("dataset", "prbench_version", "protocol_digest", "manifest_digest", "input_digest")
    pairs = [(name, str(getattr(one, name)), str(getattr(other, name))) for name in names]
    for name in sorted(one.options.keys() | other.options.keys()):
        pairs.append((f"option {name}", one.options.get(name, "–"), other.options.get(name, "–")))
    return tuple(pair for pair in pairs if pair[1] != pair[2])
