"""A built table or corpus is never replaced by one that holds less, unless the user says so.

A disk that is not mounted, a copy that was interrupted or a damaged folder makes recordings fail; what was built from
them before must not vanish for that.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from prbench.errors import RecordingsWouldBeLost, TableError
from prbench.sequences.dataset_info import counts_stated
from prbench.sequences.rows import read_parquet, table_parts
from prbench.shown import clean, quoted

_SHOWN = 3
"""Lost recordings that the message names."""
_LONGEST_REASON = 160
"""Characters of the reason of one."""


@dataclass(frozen=True)
class Holdings:
    """The contents of a table by recording."""

    yields: dict[str, int]
    """Sequences (of a corpus: clips) of every recording that was read."""
    reasons: dict[str, str] = field(default_factory=dict)
    """Maps each of the other recordings to the reason why it was left out."""

    @classmethod
    def of(cls, recordings: Iterable[pa.RecordBatch], outcome: str) -> Holdings:
        """Count from the rows of ``recordings``, whose column ``outcome`` counts what became a sequence or clip."""
        found = cls({})
        for batch in recordings:
            for row in batch.select(["recording_id", "status", "message", outcome]).to_pylist():
                if row["status"] == "read":
                    found.yields[row["recording_id"]] = row[outcome]
                else:
                    found.reasons[row["recording_id"]] = f"{row['status']}: {row['message']}"
        return found


def require_no_loss(
    folder: Path, marker: str, new: Holdings, *, outcome: str, what: str, incomplete: Collection[str] = ()
) -> None:
    """Refuse to replace what stands in a folder by something that holds less.

    Less is: a recording that was read is missing or could not be read; one of which a part could not be read, or a file
    now ends early, yields fewer sequences; or there are no sequences any more. A folder whose recordings cannot be
    listed is replaced by one in which every recording could be read.

    Args:
        folder: Where the new one would stand.
        marker: Name of the file that describes what stands there.
        new: What the new one holds.
        outcome: Column of ``recordings`` that counts its sequences or clips.
        what: What these are called.
        incomplete: Recordings of the new one of which a part could not be read, or a file ends early.

    Raises:
        RecordingsWouldBeLost: counting both, and naming the first recordings that would be lost.
    """
    if not (folder / marker).is_file():
        return
    after = sum(new.yields.values())
    holds = f"{len(new.yields)} with {after}"
    try:
        columns = ["recording_id", "status", "message", outcome]
        tables = [read_parquet(path, columns) for path in table_parts(folder, "recordings")]
    except TableError:
        # What cannot be listed cannot be compared. A complete build mends it, as long as that does not go wrong itself.
        before = counts_stated(folder / marker).get("recordings_read", 0)
        failed = any(reason.startswith("failed") for reason in new.reasons.values())
        if new.yields and not failed and len(new.yields) >= before:
            return
        counts = (
            f"its recordings cannot be listed (by {marker} {before or 'an unknown number of'} were read), and the new"
            f" one holds {holds} {what}"
        )
        raise RecordingsWouldBeLost(_message(folder, counts, new.reasons)) from None
    old = Holdings.of(pa.concat_tables(tables).to_batches(), outcome).yields
    lost = {name: new.reasons.get(name, "not found") for name in old if name not in new.yields}
    for name in sorted(set(incomplete) & old.keys() & new.yields.keys()):
        if new.yields[name] < old[name]:
            lost[name] = f"{new.yields[name]} of {old[name]} {what}: a part of it is missing or ends early"
    before = sum(old.values())
    if lost or (before and not after):
        counts = f"it holds {len(old)} recordings with {before} {what}, the new one {holds}"
        raise RecordingsWouldBeLost(_message(folder, counts, lost))


def _message(folder: Path, counts: str, lost: dict[str, str]) -> str:
    names = "; ".join(f"{clean(name)} ({quoted(lost[name], longest=_LONGEST_REASON)})" for name in list(lost)[:_SHOWN])
    more = f"; and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
    told = f" Would be lost: {names}{more}." if names else ""
    return (
        f"{folder}: not replaced: {counts}.{told} What stands there is untouched, and finished parts are kept."
        " Is all of the data there (`prbench inspect`)? Then run the same command again; with `--replace` to replace"
        " it all the same, or with another --out to have both."
    )
