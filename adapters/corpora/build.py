"""Build a corpus: read recordings group by group, keep each group as a part, and merge the parts into one table.

A build that is killed goes on where it stopped; what comes out has the same bytes for any number of workers, whether it
was interrupted or not. A dry run says what a build would read, and about how long and how much that takes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from prbench.engine import Engine, InProcess
from prbench.engine.shards import Shard, ShardRecord, require_settings
from prbench.files.storage import require_replaceable, sole_writer, text_digest
from prbench.protocol.manifests import digest_of, load_protocol
from prbench.sequences import parts
from prbench.sequences.corpus import CORPUS_TABLES, CorpusRecord, write_corpus
from prbench.sequences.dataset_info import CORPUS_FILE, CorpusInfo
from prbench.sequences.parts import ShardReport, finish_shard, making_shard, shard_parts
from prbench_adapters.corpora.job import CorpusJob, FinishedGroup, GroupReceipt, describe
from prbench_adapters.corpora.sources import Corpus, CorpusOptions, RecordingGroup, corpus_for, find_groups

_IN_PROCESS = InProcess()
_DEFAULTS = CorpusOptions()

Progress = Callable[[int, int, str], None]
"""Called with finished recordings, all of them, and what was finished last."""


@dataclass(frozen=True)
class CorpusReport:
    """The result of a build."""

    folder: Path
    info: CorpusInfo
    records: tuple[CorpusRecord, ...]
    reused: int
    """Recordings taken over from an interrupted build."""


def build_corpus(
    name: str,
    root: Path | str | None,
    out: Path | str,
    *,
    options: CorpusOptions = _DEFAULTS,
    engine: Engine = _IN_PROCESS,
    progress: Progress | None = None,
) -> CorpusReport:
    """Build a corpus.

    Args:
        name: ``nymeria``, ``humanml3d`` or ``synthetic``.
        root: The dataset's folder; None for ``synthetic``.
        out: Folder of the new corpus; an earlier corpus there is replaced when everything is ready, and
            only by one that holds its recordings.
        options: What to read, and how to cut it.
        engine: Where recordings are worked on.
        progress: Called after each group of recordings, in order.

    Raises:
        UsageError: for an unknown corpus or option.
        InputFileError: if there is nothing to read.
        StorageError: if ``out`` cannot be written or holds something else.
        RecordingsWouldBeLost: if the corpus that stands there holds more, and the options do not say to replace it;
            finished parts are kept.
    """
    out = Path(out).expanduser().absolute()
    require_replaceable(out, CORPUS_FILE, kind="corpus")
    corpus = corpus_for(name)
    described = corpus.described(options)
    groups = find_groups(corpus, None if root is None else Path(root), options)
    with sole_writer(out), parts.working_in_parts(out):
        finished = _make_parts(corpus, described, groups, parts.work_folder(out), options, engine, progress)
        dataset = groups[0].recordings[0].identity.dataset
        return _write_corpus(dataset, corpus, described, finished, out, options)


def build_corpus_shard(
    name: str,
    root: Path | str | None,
    out: Path | str,
    shard: Shard,
    *,
    options: CorpusOptions = _DEFAULTS,
    engine: Engine = _IN_PROCESS,
    progress: Progress | None = None,
) -> ShardReport[CorpusRecord]:
    """Make one shard of a build, for :func:`merge_corpus_shards`; goes on where it was interrupted.

    Args:
        name: See :func:`build_corpus`, whose errors these are.
        root: See :func:`build_corpus`.
        out: Folder of the shard.
        shard: Which one it is.
        options: See :func:`build_corpus`.
        engine: See :func:`build_corpus`.
        progress: See :func:`build_corpus`.

    Raises:
        ShardError: if ``out`` holds another shard.
    """
    out = Path(out).expanduser().absolute()
    corpus = corpus_for(name)
    described = corpus.described(options)
    groups = find_groups(corpus, None if root is None else Path(root), options)
    record = ShardRecord(
        kind="corpus",
        number=shard.number,
        count=shard.count,
        settings=_shard_settings(name, groups[0].recordings[0].identity.dataset, options),
        plan=tuple(group.name for group in groups),
    )
    mine = [groups[place] for place in shard.places(len(groups))]
    with making_shard(out, record) as work:
        finished = _make_parts(corpus, described, mine, work, options, engine, progress)
        finish_shard(out, record, [part.folder for part in finished])
    return ShardReport(out, shard, len(groups), _records(finished), _reused(finished))


def merge_corpus_shards(shards: Sequence[tuple[Path, ShardRecord]], out: Path, *, replace: bool) -> CorpusReport:
    """Write the corpus of an unsharded build from all of its shards, with the same bytes.

    Args:
        shards: All of them (:func:`prbench.engine.shards.require_whole`).
        out: See :func:`build_corpus`.
        replace: Replace a corpus that holds recordings which the shards lack.

    Raises:
        ShardError: if one is unfinished or damaged, or the manifests differ from today's.
        StorageError: see :func:`build_corpus`.
        RecordingsWouldBeLost: see :func:`build_corpus`.
    """
    folder, record = shards[0]
    name = record.settings["corpus"]
    dataset = record.settings["dataset"]
    options = dataclasses.replace(msgspec.convert(record.settings["options"], CorpusOptions), replace=replace)
    require_settings(folder, record, _shard_settings(name, dataset, options))
    corpus = corpus_for(name)
    out = out.expanduser().absolute()
    require_replaceable(out, CORPUS_FILE, kind="corpus")
    with sole_writer(out):
        finished = [
            FinishedGroup(part, msgspec.convert(entries, GroupReceipt), reused=False)
            for part, entries in shard_parts(shards)
        ]
        return _write_corpus(dataset, corpus, corpus.described(options), finished, out, options)


def _shard_settings(name: str, dataset: str, options: CorpusOptions) -> dict[str, Any]:
    """Return what decides a corpus beside its recordings, as JSON knows it."""
    corpus = corpus_for(name)
    return {
        "corpus": name,
        "dataset": dataset,
        "options": msgspec.to_builtins(dataclasses.replace(options, replace=False, on_error="skip")),
        "manifest": "" if corpus.manifest is None else digest_of(corpus.manifest),
        "protocol": load_protocol().digest,
    }


def _make_parts(
    corpus: Corpus,
    described: dict[str, str],
    groups: Sequence[RecordingGroup],
    work: Path,
    options: CorpusOptions,
    engine: Engine,
    progress: Progress | None,
) -> list[FinishedGroup]:
    """Make the parts of some groups, in their order."""
    settings = _settings(described, "" if corpus.manifest is None else digest_of(corpus.manifest))
    job = CorpusJob(settings, options.on_error == "fail", work)
    finished = []
    done = 0
    total = sum(len(group.recordings) for group in groups)
    for part in engine.map(job, groups, if_full=job.if_full):
        finished.append(part)
        done += len(part.receipt.records)
        if progress is not None:
            progress(done, total, part.receipt.name)
    return finished


def _write_corpus(
    dataset: str,
    corpus: Corpus,
    described: dict[str, str],
    finished: Sequence[FinishedGroup],
    out: Path,
    options: CorpusOptions,
) -> CorpusReport:
    """Write the corpus of all parts of a build."""
    info = describe(dataset, corpus.manifest, described, options, [part.receipt for part in finished])
    folders = [part.folder for part in finished]
    tables = {table: parts.read_batches(folders, table) for table in CORPUS_TABLES}
    # Last of all: until here an earlier corpus stands as it was.
    info = write_corpus(out, info, tables, replace=options.replace)
    return CorpusReport(out, info, _records(finished), _reused(finished))


def _records(finished: Sequence[FinishedGroup]) -> tuple[CorpusRecord, ...]:
    return tuple(record for part in finished for record in part.receipt.records)


def _reused(finished: Sequence[FinishedGroup]) -> int:
    return sum(len(part.receipt.records) for part in finished if part.reused)


def _settings(described: dict[str, str], manifest_digest: str) -> str:
    chosen = [text for item in sorted(described.items()) for text in item]
    return text_digest(manifest_digest, load_protocol().digest, *chosen)


@dataclass(frozen=True)
class CorpusPlan:
    """The input of a build, found out without reading any recording."""

    recordings: tuple[str, ...]
    skipped: tuple[str, ...]
    """Known-bad ones among them."""
    input_bytes: int
    estimated_seconds: float
    """Seconds with one worker, on a machine like the one it was measured on."""
    estimated_disk_bytes: int


def plan_corpus(name: str, root: Path | str | None, options: CorpusOptions = _DEFAULTS) -> CorpusPlan:
    """The dry run: what :func:`build_corpus` would read. Writes nothing.

    Raises:
        UsageError: for an unknown corpus or option.
        InputFileError: if there is nothing to read.
    """
    root = None if root is None else Path(root)
    corpus = corpus_for(name)
    # Options that the build would refuse are refused here, too.
    corpus.described(options)
    recordings = [each for group in find_groups(corpus, root, options) for each in group.recordings]
    costs = [each.cost for each in recordings if each.skip_reason is None]
    return CorpusPlan(
        recordings=tuple(each.identity.recording_id for each in recordings),
        skipped=tuple(each.identity.recording_id for each in recordings if each.skip_reason is not None),
        input_bytes=sum(cost.input_bytes for cost in costs),
        estimated_seconds=sum(cost.seconds for cost in costs),
        estimated_disk_bytes=round(sum(cost.disk_bytes for cost in costs)),
    )
