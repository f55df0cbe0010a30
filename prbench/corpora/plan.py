"""The dry run: what a corpus build would read, and about how long and how much that takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.corpora.options import CorpusOptions
from prbench.corpora.sources import corpus_for, find_groups

_DEFAULTS = CorpusOptions()


@dataclass(frozen=True)
class CorpusPlan:
    """What a build would read, found out without reading any recording."""

    recordings: tuple[str, ...]
    skipped: tuple[str, ...]
    """Known-bad ones among them."""
    input_bytes: int
    estimated_seconds: float
    """With one worker, on a machine like the one it was measured on."""
    estimated_disk_bytes: int


def plan_corpus(name: str, root: Path | str | None, options: CorpusOptions = _DEFAULTS) -> CorpusPlan:
    """The dry run: what :func:`build_corpus` would read. Writes nothing.

    Raises:
        UsageError: for an unknown corpus or option.
        InputFileError: if there is nothing to read.
    """
    root = None if root is None else Path(root)
    corpus = corpus_for(name)
    corpus.described(options)
    recordings = [each for group in find_groups(corpus, root, options) for each in group.recordings]
    costs = [each.cost for each in recordings if each.skip_reason is None]
    return CorpusPlan(
        recordings=tuple(each.belonging.recording_id for each in recordings),
        skipped=tuple(each.belonging.recording_id for each in recordings if each.skip_reason is not None),
        input_bytes=sum(cost.input_bytes for cost in costs),
        estimated_seconds=sum(cost.seconds for cost in costs),
        estimated_disk_bytes=round(sum(cost.disk_bytes for cost in costs)),
    )
