"""The dry run: what a build would read, and about how long and how much that takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.curation.options import NO_OPTIONS, BuildOptions
from prbench.curation.sources import native_sources
from prbench.manifests import BuildEstimate, load_manifest
from prbench.readers import SYNTHETIC_PREFIX


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


_UNMEASURED = BuildEstimate(megabytes_per_second=30.0, table_share=0.02)


def plan_build(dataset: str, root: Path | str, options: BuildOptions = NO_OPTIONS) -> BuildPlan:
    """The dry run: what :func:`build_dataset` would read. Writes nothing.

    Raises:
        UsageError: for a dataset without a reader.
        InputFileError: if there is nothing to read.
    """
    sources = native_sources(dataset, root, options)
    estimate = load_manifest(dataset.removeprefix(SYNTHETIC_PREFIX)).estimate or _UNMEASURED
    size = sum(source.size for source in sources if source.skip_reason is None)
    return BuildPlan(
        recordings=tuple(source.recording_id for source in sources),
        skipped=tuple(source.recording_id for source in sources if source.skip_reason is not None),
        input_bytes=size,
        estimated_seconds=size / (estimate.megabytes_per_second * 1e6),
        estimated_disk_bytes=round(size * 2 * estimate.table_share),
    )
