"""The dry run: what a build would read, and about how long and how much that takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.curation.options import NO_OPTIONS, BuildOptions
from prbench.curation.sources import native_sources


@dataclass(frozen=True)
class BuildPlan:
    """What a build would read, found out without reading any recording."""

    recordings: tuple[str, ...]
    skipped: tuple[str, ...]
    """Known-bad ones among them."""
    input_bytes: int
    estimated_seconds: float
    """With one worker, on a machine like the one it was measured on."""
    estimated_disk_bytes: int


_READING_RATE = 60e6  # bytes of input a second and worker, measured on synthetic ADT files
_TABLE_SHARE = 0.02  # bytes of table (with the parts it is made from) a byte of input, likewise


def plan_build(dataset: str, root: Path, options: BuildOptions = NO_OPTIONS) -> BuildPlan:
    """The dry run: what :func:`build_dataset` would read. Writes nothing.

    Raises:
        UsageError: for a dataset without a reader.
        InputFileError: if there is nothing to read.
    """
    sources = native_sources(dataset, root, options)
    size = sum(source.size for source in sources if source.skip_reason is None)
    return BuildPlan(
        recordings=tuple(source.recording_id for source in sources),
        skipped=tuple(source.recording_id for source in sources if source.skip_reason is not None),
        input_bytes=size,
        estimated_seconds=size / _READING_RATE,
        estimated_disk_bytes=round(size * _TABLE_SHARE),
    )
