"""Compare two builds: which events and sequences appeared, vanished or moved, what decided, and which columns differ.

Numbers are compared to 10 µm (or as little of another unit).
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections import defaultdict
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from prbench.errors import UsageError
from prbench.sequences import SequenceTable
from prbench.sequences.schema import is_bulky
from prbench.sequences.sequence import KEY_VALUES, OUTCOMES, SEQUENCES

# Kinds of changes in the order of a report.
KINDS: dict[str, str] = {
    "gained": "an event that became a sequence only in the second build",
    "lost": "an event that was a sequence only in the first build",
    "appeared": "an event that only the second build found",
    "vanished": "an event that only the first build found",
    "moved": "a sequence in both, with other event or prime times or another place",
    "outcome": "left out by both, for different reasons",
    "values": "the same sequence, event or recording in both, with other values in the columns named",
}
_WITHIN = 1e-5
_SAME_TIME = 1e-6  # s
_LARGEST_SHIFT = 1.0  # seconds between two events that may be the same one
_DIGESTED = tuple(field.name for field in SEQUENCES if is_bulky(field.type) and field.type != KEY_VALUES)
# Entries of the description that follow from what is compared row by row, or are compared one by one.
_FOLLOWING = {"options", "outcomes", "counts", "quarantine", "identity_digest", "content_digest", "file_digests"}
# Values by column; in place of per-frame values and poses their digest.
Row = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Change:
    """One event that is not the same in both builds.

    Attributes:
        kind: ``gained``, ``lost``, ``appeared``, ``vanished``, ``moved``, ``outcome`` or ``values``.
        recording_id: Name of the recording.
        event: ``object name/action/time`` as a person would say it; empty for a change of the recording itself.
        first: Outcome in the first build; empty where it has no such event.
        second: Outcome in the second build; empty where it has no such event.
        decided_by: Stage that made the difference, with its number and threshold where it has them.
    """

    kind: str
    recording_id: str
    event: str
    first: str
    second: str
    decided_by: str


@dataclasses.dataclass(frozen=True)
class Difference:
    """Everything that differs between two builds.

    Attributes:
        settings: Name, first and second value of every entry of ``dataset.json`` that decides what a build finds.
        changes: Sorted by kind, recording and time.
        unchanged_events: Number of events that are the same in both.
        unchanged_sequences: Number of sequences among them.
    """

    settings: tuple[tuple[str, str, str], ...]
    changes: tuple[Change, ...]
    unchanged_events: int
    unchanged_sequences: int

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
    one, other = (table.info for table in tables)
    if one.dataset != other.dataset:
        found = f"{first} holds {one.dataset} and {second} holds {other.dataset}"
        raise UsageError(f"{found}; compare builds of one dataset.")
    # A table of an older version tells nothing of what has been added since: that is no change of an event.
    untold = ["prime_margin", "event_confidence", "video"] if one.schema_version != other.schema_version else []
    before, after = (table.events().drop_columns(untold).to_pylist() for table in tables)
    recordings = [{row["recording_id"]: row for row in table.recordings().to_pylist()} for table in tables]
    sequences = [_sequence_rows(table) for table in tables]
    changes: list[tuple[float, Change]] = []
    unchanged = []
    for pair in _pairs(before, after):
        change = _change(pair, recordings, sequences)
        said = [row["corrected"] for row in pair if row is not None]
        if change is not None and len(set(said)) == 2:
            decided = f"correction: {said[1] or f'taken back: {said[0]}'}; {change.decided_by}"
            change = dataclasses.replace(change, decided_by=decided.removesuffix("; correction"))
        event = pair[1] or pair[0] or {}
        if change is None:
            unchanged.append(event)
        else:
            changes.append((float(np.nan_to_num(event["event_time"])), change))
    # Sequences of one build only that no event names.
    named = {event["sequence_id"] for event in [*before, *after]}
    for name in sorted((sequences[0].keys() ^ sequences[1].keys()) - named):
        row = (sequences[0].get(name) or sequences[1][name]) | {"outcome": "sequence"}
        pair = (row, None) if name in sequences[0] else (None, row)
        changes.append((0.0, _told(*pair, "vanished" if pair[0] else "appeared", "a sequence that no event names")))
    # Recordings with other values; what follows from changes of their events, which are reported, is left out.
    reported = {change.recording_id for _, change in changes}
    for name in sorted(recordings[0].keys() | recordings[1].keys()):
        status, later = (rows[name]["status"] if name in rows else "" for rows in recordings)
        if status and later:
            follows = (*OUTCOMES, "status", "message") if name in reported else ()
            if columns := ", ".join(_differing(recordings[0][name], recordings[1][name], besides=follows)):
                changes.append((0.0, Change("values", name, "", status, later, columns)))
        elif name not in reported:
            kind = "vanished" if status else "appeared"
            changes.append((0.0, Change(kind, name, "", status, later, "recording in one of the builds only")))
    if not _same(*(table.scenes().to_pylist() for table in tables)):
        changes.append((0.0, Change("values", "", "", "", "", "boxes of the scenes")))
    order = {kind: rank for rank, kind in enumerate(KINDS)}
    changes.sort(key=lambda item: (order[item[1].kind], item[1].recording_id, item[0], item[1].event))
    names = [name for name in one.__struct_fields__ if name not in _FOLLOWING]
    settings = [(name, str(getattr(one, name)), str(getattr(other, name))) for name in names]
    for name in sorted(one.options.keys() | other.options.keys()):
        settings.append((f"option {name}", one.options.get(name, "–"), other.options.get(name, "–")))
    settings = [each for each in settings if each[1] != each[2]]
    sequences_too = sum(event["outcome"] == "sequence" for event in unchanged)
    return Difference(tuple(settings), tuple(change for _, change in changes), len(unchanged), sequences_too)


def _sequence_rows(table: SequenceTable) -> dict[str, Row]:
    """Every column of every sequence, by ``sequence_id``; of long ones the digest of their numbers in 10 µm."""
    found: dict[str, Row] = {}
    short = [name for name in SEQUENCES.names if name not in _DIGESTED]
    for chunk in table.chunks():
        for index, row in enumerate(chunk.batch.select(short).to_pylist()):
            for name in _DIGESTED:
                column = chunk.batch.column(name).slice(index, 1)
                row[name] = b""
                if column.null_count:
                    continue
                while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
                    column = column.flatten()
                values = column.to_numpy(zero_copy_only=False)
                if values.dtype != bool:
                    values = np.rint(values.astype(np.float64) / _WITHIN).astype(np.int64)
                row[name] = hashlib.sha256(values.tobytes()).digest()
            found[row["sequence_id"]] = row
    return found


def _pairs(before: list[Row], after: list[Row]) -> Iterator[tuple[Row | None, Row | None]]:
    """Events of the two builds side by side, the nearest in time first; None where one has no partner."""
    groups: dict[tuple[str, str, str], tuple[list[Row], list[Row]]] = defaultdict(lambda: ([], []))
    for side, events in enumerate((before, after)):
        for event in events:
            groups[event["recording_id"], event["object_id"], event["action"]][side].append(event)
    for key in sorted(groups):
        ours, theirs = groups[key]
        gaps = []
        for row, one in enumerate(ours):
            for place, other in enumerate(theirs):
                # An id stays the event's own, however far a person has moved it. What cannot be read has no time.
                same = one["event_id"] == other["event_id"]
                gap = 0.0 if same else float(np.nan_to_num(abs(one["event_time"] - other["event_time"]), nan=np.inf))
                gaps.append((gap, row, place))
        partner: dict[int, int] = {}
        for gap, row, place in sorted(gaps):
            if gap <= _LARGEST_SHIFT and row not in partner and place not in partner.values():
                partner[row] = place
        yield from ((event, theirs[partner[row]] if row in partner else None) for row, event in enumerate(ours))
        yield from ((None, event) for place, event in enumerate(theirs) if place not in partner.values())


def _change(
    pair: tuple[Row | None, Row | None], recordings: list[dict[str, Row]], sequences: list[dict[str, Row]]
) -> Change | None:
    """Compare one event of both builds; None if nothing differs."""
    one, other = pair
    if one is None or other is None:
        event, absent = (other, recordings[0]) if one is None else (one, recordings[1])
        assert event is not None
        decided = "recording not in that build"
        if event["recording_id"] in absent:
            recording = absent[event["recording_id"]]
            decided = "in_hand or annotations: no such event within 1 s"
            if recording["status"] != "read":
                decided = f"recording {recording['status']}: {recording['message']}"
        return _told(one, other, "appeared" if one is None else "vanished", decided)
    was = one["outcome"] == "sequence"
    if was != (other["outcome"] == "sequence"):
        return _told(one, other, "lost" if was else "gained", _decision(other if was else one))
    if (one["outcome"], one["stage"]) != (other["outcome"], other["stage"]):
        return _told(one, other, "outcome", f"{_decision(one)} → {_decision(other)}")
    # How far times and place of a sequence's event moved.
    parts = []
    for name in ("event_time", "prime_time"):
        if one[name] is not None and other[name] is not None and abs(other[name] - one[name]) > _SAME_TIME:
            parts.append(f"{name.removesuffix('_time')} {other[name] - one[name]:+.3f} s")
    if one["location"] is not None and other["location"] is not None:
        distance = float(np.linalg.norm(np.subtract(other["location"], one["location"])))
        if distance > _WITHIN:
            parts.append(f"place {distance:.3f} m")
    if one["prime_kind"] != other["prime_kind"]:
        parts.append(f"{one['prime_kind']} → {other['prime_kind']}")
    if parts and was:
        return _told(one, other, "moved", ", ".join(parts))
    columns = _differing(one, other)
    if was:
        rows = (sequences[0].get(one["sequence_id"]), sequences[1].get(other["sequence_id"]))
        if rows[0] is not None and rows[1] is not None:
            columns += _differing(rows[0], rows[1])
        elif rows[0] is not rows[1]:
            columns.append("no row in sequences in one of them")
    return _told(one, other, "values", ", ".join(dict.fromkeys(columns))) if columns else None


def _differing(one: Row, other: Row, *, besides: Collection[str] = ()) -> list[str]:
    """Names of the columns whose values differ, in the order of the first row."""
    return [name for name in one if name not in besides and not _same(one[name], other[name])]


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= _WITHIN or one == other or (math.isnan(one) and math.isnan(other))
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return not _differing(one, other)
    return one == other


def _told(one: Row | None, other: Row | None, kind: str, decided_by: str) -> Change:
    event = other or one
    assert event is not None
    name = f"{event['object_name']}/{event['action']}/{event['event_time']:.3f} s"
    before, after = ("" if row is None else row["outcome"] for row in (one, other))
    return Change(kind, event["recording_id"], name, before, after, decided_by)


def _decision(event: Row) -> str:
    if event["value"] is None:
        return event["stage"]
    threshold = "" if event["threshold"] is None else f" (threshold {event['threshold']:g})"
    return f"{event['stage']}: {event['value']:.3f}{threshold}"
