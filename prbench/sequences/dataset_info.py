"""``dataset.json``: what a built dataset is, where it came from and under which terms it may be used."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.sequences.info_file import Provenance, read_info
from prbench.storage import write_json

FILE_NAME = "dataset.json"


class FunnelCounts(msgspec.Struct, frozen=True, kw_only=True):
    """How many candidates each stage left."""

    recordings_found: int
    recordings_read: int
    recordings_failed: int
    recordings_skipped: int
    recordings_cut_short: int = 0
    """Of those that were read, how many have a stream that ends before the recording does; 0 in older tables."""
    events: int
    located: int
    primed: int
    long_enough: int
    moved_enough: int
    sequences: int


class DatasetInfo(Provenance, frozen=True, kw_only=True):
    """Provenance of one built dataset; its outcomes are those of events."""

    counts: FunnelCounts

    @property
    def why_not_scored(self) -> str | None:
        """Why no metric may be computed on this dataset, or None; an import may not know where its goals are."""
        if self.options.get("goal_frame") == "unknown":
            return (
                "it was imported from a release whose goals are in an unknown frame (import_report.json has the"
                " evidence), so no distance to a goal means anything"
            )
        return None

    def write(self, folder: Path) -> None:
        """Write ``dataset.json``."""
        write_json(folder / FILE_NAME, msgspec.to_builtins(self))

    @classmethod
    def read(cls, folder: Path | str) -> DatasetInfo:
        """Read ``dataset.json``.

        Raises:
            TableError: if the folder holds none, or it is damaged or of another version.
        """
        return read_info(Path(folder) / FILE_NAME, cls, what="dataset")
