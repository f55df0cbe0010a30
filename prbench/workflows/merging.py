"""``prbench merge``: the shards of a build or run as one table, corpus or run folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from prbench.corpora import CorpusReport
from prbench.corpora.build import merge_corpus_shards
from prbench.curation import BuildReport
from prbench.curation.build import merge_dataset_shards
from prbench.curation.window_building import WindowsReport, merge_windows_shards
from prbench.engine import Engine
from prbench.engine.shards import require_whole
from prbench.errors import ShardError, UsageError
from prbench.harness.request import Progress, silent
from prbench.harness.run import RunReport
from prbench.harness.sharded import merge_run_shards


def merge(
    shards: Sequence[Path],
    out: Path,
    *,
    data: Sequence[Path] = (),
    replace: bool = False,
    engine: Engine | None = None,
    progress: Callable[[Progress], None] = silent,
) -> BuildReport | CorpusReport | WindowsReport | RunReport:
    """Put all shards of a build or run together; the result has the bytes of an unsharded one.

    Args:
        shards: Their folders, in any order.
        out: Folder of the result.
        data: Tables of a run; by default where its shards found them.
        replace: Replace a table or corpus that holds recordings which the shards lack.
        engine: Where a run is scored.
        progress: Called while a run is scored.

    Raises:
        ShardError: if a shard is missing, there twice, of something else, unfinished or damaged.
        UsageError: for an option that does not fit what is merged, or if the result would stand in a shard.
        StorageError: if ``out`` cannot be written or holds something else.
        RecordingsWouldBeLost: if the table that stands there holds more.
        RunError: if the folder of a run belongs to another one.
    """
    if not shards:
        raise ShardError("expected the folders of all shards, found none.")
    if out.resolve() in [folder.resolve() for folder in shards]:
        raise UsageError(f"--out {out}: is one of the shards. Choose another folder.")
    opened = require_whole(shards)
    kind = opened[0][1].kind
    if data and kind != "run":
        raise UsageError(f"--data: belongs to shards of a run; these are of a {kind}. Leave it out.")
    if replace and kind not in ("dataset", "corpus"):
        raise UsageError(f"--replace: belongs to a dataset or corpus; these are shards of a {kind}. Leave it out.")
    if kind == "dataset":
        return merge_dataset_shards(opened, out, replace=replace)
    if kind == "corpus":
        return merge_corpus_shards(opened, out, replace=replace)
    if kind == "windows":
        return merge_windows_shards(opened, out)
    return merge_run_shards(opened, out, data=data, engine=engine, progress=progress)
