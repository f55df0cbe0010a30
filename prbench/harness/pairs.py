"""Pairs of a pick and the put that follows it: the same object in the same recording.

Source: docs/specification/carry-on.md#pairs.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import pyarrow as pa

from prbench.errors import TableError
from prbench.protocol.manifests import load_carry_on_constants

COLUMNS = ("sequence_id", "recording_id", "object_id", "action", "event_time", "start_time")


@dataclass(frozen=True)
class Pair:
    """One object that is picked and then put."""

    pick: str
    """Id of the pick's sequence."""
    put: str
    """Id of the put's sequence."""
    gap: float
    """Seconds from the pick's event to the first recorded frame of the put; below 0 where the sequences overlap."""


def find_pairs(rows: pa.Table) -> tuple[Pair, ...]:
    """Find each pick whose object's next sequence in the recording is a put that begins soon enough.

    Args:
        rows: Sequences with :data:`COLUMNS`.

    Returns:
        The pairs, by the id of the put. No sequence is in two of them.
    """
    longest = load_carry_on_constants().longest_gap
    ordered = sorted(
        rows.select(COLUMNS).to_pylist(), key=lambda row: (row["recording_id"], row["object_id"], row["event_time"])
    )
    pairs = []
    for one, other in itertools.pairwise(ordered):
        same = one["recording_id"] == other["recording_id"] and one["object_id"] == other["object_id"]
        gap = other["start_time"] - one["event_time"]
        if same and (one["action"], other["action"]) == ("pick", "put") and gap <= longest:
            pairs.append(Pair(one["sequence_id"], other["sequence_id"], gap))
    return tuple(sorted(pairs, key=lambda pair: pair.put))


def require_pairs(rows: pa.Table, *, where: str, split: str) -> tuple[Pair, ...]:
    """Find the pairs of a split.

    Raises:
        TableError: if there is none, saying how many picks and puts there are.
    """
    pairs = find_pairs(rows)
    if not pairs:
        actions = rows["action"].to_pylist()
        longest = load_carry_on_constants().longest_gap
        raise TableError(
            f"{where}: --carry-on: expected picks that are followed by a put of the same object in the same recording"
            f" within {longest:g} s, found none among the {len(actions)} sequences of split '{split}'"
            f" ({actions.count('pick')} picks, {actions.count('put')} puts). GIMO has picks alone. Leave the option"
            " out, or choose other data."
        )
    return pairs
