"""Build a corpus: read recordings group by group, keep each group as a part, and merge the parts into one table.

A build that is killed goes on where it stopped; what comes out has the same bytes for any number of workers, whether it
was interrupted or not. A dry run says what a build would read, and about how long and how much that takes.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from prbench.curation.job import message_of
from prbench.engine import IN_PROCESS, Engine, is_out_of_memory
from prbench.engine.shards import Shard, ShardRecord, require_settings
from prbench.errors import InputFileError, PrbenchError
from prbench.files.storage import require_replaceable, sole_writer, text_digest
from prbench.protocol.manifests import digest_of, load_manifest, load_protocol
from prbench.readers import SYNTHETIC_PREFIX
from prbench.sequences import corpus as corpus_tables
from prbench.sequences import parts
from prbench.sequences.dataset_info import CORPUS_FILE, CorpusCounts, CorpusInfo, begun_with, quarantined
from prbench.sequences.parts import BuildPlan, BuildReport, ShardReport, finish_shard, making_shard, shard_parts
from prbench_adapters.corpora import sources as corpora


class GroupReceipt(msgspec.Struct, frozen=True):
    """Description of a finished part, readable without opening its tables."""

    name: str
    input_digest: str
    records: tuple[corpus_tables.CorpusRecord, ...]
    clips: int
    captions: int
    approximate_clips: int
    frames: int


_COUNTED = ("clips", "captions", "approximate_clips", "frames")  # what a receipt counts, and the corpus adds up
# A part, where it lies, and True if an earlier, interrupted build had made it.
_Finished = tuple[Path, GroupReceipt, bool]


@dataclass(frozen=True)
class CorpusJob:
    """Reads the recordings of a group and writes their part, unless that part is there already.

    Attributes:
        settings: Digest of everything but the input that decides what comes out.
    """

    settings: str
    stop_on_error: bool
    work: Path

    def __call__(self, group: corpora.RecordingGroup, full: PrbenchError | None = None) -> _Finished:
        """Make the part of one group; where the memory does not suffice, nothing of it is read, and it says why."""
        name, recordings = group
        try:
            digest = text_digest(*(recording.input_digest() for recording in recordings if not recording.skip_reason))
        except (OSError, InputFileError) as error:
            digest = text_digest("unreadable", type(error).__name__)
        # Splits, participants and reasons to skip come from files that the recordings share, or from the manifest.
        known = [
            text
            for recording in recordings
            for text in (*map(str, vars(recording.identity).values()), recording.skip_reason or "")
        ]
        folder = parts.part_folder(self.work, name, digest, text_digest(self.settings, *known))
        entries = parts.read_receipt(folder)
        if entries is not None and full is None:
            receipt = msgspec.convert(entries, GroupReceipt)
            if all(record.status != "failed" for record in receipt.records):  # a failure may have passed: try again
                return folder, receipt, True
        done = [self._read(recording, full) for recording in recordings]
        clips = [clip for read, _ in done for clip in sorted(read.clips, key=lambda clip: clip.sequence_id)]
        annotations = [row for read, _ in done for row in read.annotations]
        records = tuple(record for _, record in done)
        rows = {"clips": clips, "annotations": annotations, "recordings": records}
        batches = {table: corpus_tables.corpus_batch(table, each) for table, each in rows.items()}
        captions = sum(len(clip.captions) for clip in clips)
        approximate = sum(clip.approximate for clip in clips)
        frames = sum(clip.n_frames for clip in clips)
        receipt = GroupReceipt(name, digest, records, len(clips), captions, approximate, frames)
        parts.write_part(folder, batches, parts.plain(receipt))
        return folder, receipt, False

    def _read(
        self, recording: corpora.CorpusRecording, full: PrbenchError | None
    ) -> tuple[corpora.ReadRecording, corpus_tables.CorpusRecord]:
        identity = recording.identity
        read = corpora.ReadRecording((), (), 0.0, clock_method="none")
        status = "read"
        message = ""
        try:
            if full is not None:
                raise full
            if recording.skip_reason is None:
                read = recording.read()
                message = read.message
            else:
                status = "skipped"
                message = recording.skip_reason
        except Exception as error:
            if full is None and is_out_of_memory(error):
                raise  # the engine tries again when nothing else is done beside it
            # Whatever one recording does, the others go on; its message reaches the user with the build's report.
            status = "failed"
            message = recording.without_places(message_of(error, recording.recording_id, stop=self.stop_on_error))
        whose = (identity.recording_id, identity.participant_id, identity.split, identity.split_group)
        outcomes = dict(Counter(row.outcome for row in read.annotations))
        found = (outcomes, read.clock_method, read.clock_quality, status, message, dict(read.measured))
        return read, corpus_tables.CorpusRecord(*whose, read.duration, *found)


_DEFAULTS = corpora.CorpusOptions()

Progress = Callable[[int, int, str], None]  # Called with finished recordings, all of them, and what was finished last.


def _found(
    name: str, root: Path | str | None, options: corpora.CorpusOptions
) -> tuple[corpora.Corpus, tuple[corpora.RecordingGroup, ...]]:
    """Return a corpus and the groups of its recordings; unknown options are refused before anything is searched."""
    corpus = corpora.corpus_for(name)
    corpus.described(options)
    return corpus, corpora.find_groups(corpus, None if root is None else Path(root), options)


def build_corpus(
    name: str,
    root: Path | str | None,
    out: Path | str,
    *,
    options: corpora.CorpusOptions = _DEFAULTS,
    engine: Engine = IN_PROCESS,
    progress: Progress | None = None,
) -> BuildReport[CorpusInfo, corpus_tables.CorpusRecord]:
    """Build a corpus.

    Args:
        name: ``nymeria``, ``humanml3d`` or ``synthetic``.
        root: The dataset's folder; None for ``synthetic``.
        out: Folder of the new corpus; an earlier corpus there is replaced when everything is ready, and
            only by one that holds its recordings.
        options: What to read, and how to cut it.
        engine: Runs the work, in this process or in several.
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
    corpus, groups = _found(name, root, options)
    with sole_writer(out), parts.working_in_parts(out):
        finished = _make_parts(corpus, groups, parts.work_folder(out), options, engine, progress)
        return _write_corpus(groups[0][1][0].identity.dataset, corpus, finished, out, options)


def build_corpus_shard(
    name: str,
    root: Path | str | None,
    out: Path | str,
    shard: Shard,
    *,
    options: corpora.CorpusOptions = _DEFAULTS,
    engine: Engine = IN_PROCESS,
    progress: Progress | None = None,
) -> ShardReport[corpus_tables.CorpusRecord]:
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
    corpus, groups = _found(name, root, options)
    settings = _shard_settings(corpus, groups[0][1][0].identity.dataset, options)
    record = ShardRecord.of("corpus", shard, settings, (name for name, _ in groups))
    mine = [groups[place] for place in shard.places(len(groups))]
    with making_shard(out, record) as work:
        finished = _make_parts(corpus, mine, work, options, engine, progress)
        finish_shard(out, record, [folder for folder, _, _ in finished])
    return ShardReport(out, shard, len(groups), *_records(finished))


def merge_corpus_shards(
    shards: Sequence[tuple[Path, ShardRecord]], out: Path, *, replace: bool
) -> BuildReport[CorpusInfo, corpus_tables.CorpusRecord]:
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
    corpus = corpora.corpus_for(record.setting(folder, str, "corpus"))
    dataset = record.setting(folder, str, "dataset")
    options = dataclasses.replace(record.setting(folder, corpora.CorpusOptions, "options"), replace=replace)
    require_settings(folder, record, _shard_settings(corpus, dataset, options))
    out = out.expanduser().absolute()
    require_replaceable(out, CORPUS_FILE, kind="corpus")
    with sole_writer(out):
        finished = [(part, msgspec.convert(entries, GroupReceipt), False) for part, entries in shard_parts(shards)]
        return _write_corpus(dataset, corpus, finished, out, options)


def _shard_settings(corpus: corpora.Corpus, dataset: str, options: corpora.CorpusOptions) -> dict[str, Any]:
    """Return what decides a corpus beside its recordings, as JSON knows it."""
    return {
        "corpus": corpus.name,
        "dataset": dataset,
        "options": msgspec.to_builtins(dataclasses.replace(options, replace=False, on_error="skip")),
        "manifest": _manifest_digest(corpus),
        "protocol": load_protocol().digest,
    }


def _manifest_digest(corpus: corpora.Corpus) -> str:
    return "" if corpus.manifest is None else digest_of(corpus.manifest)


def _make_parts(
    corpus: corpora.Corpus,
    groups: Sequence[corpora.RecordingGroup],
    work: Path,
    options: corpora.CorpusOptions,
    engine: Engine,
    progress: Progress | None,
) -> list[_Finished]:
    """Make the parts of some groups, in their order."""
    chosen = [text for item in sorted(corpus.described(options).items()) for text in item]
    settings = text_digest(_manifest_digest(corpus), load_protocol().digest, *chosen)
    job = CorpusJob(settings, options.on_error == "fail", work)
    finished = []
    done = 0
    total = sum(len(recordings) for _, recordings in groups)
    for part in engine.map(job, groups, if_full=job):
        finished.append(part)
        done += len(part[1].records)
        if progress is not None:
            progress(done, total, part[1].name)
    return finished


def _write_corpus(
    dataset: str, corpus: corpora.Corpus, finished: Sequence[_Finished], out: Path, options: corpora.CorpusOptions
) -> BuildReport[CorpusInfo, corpus_tables.CorpusRecord]:
    """Write the corpus of all parts of a build."""
    protocol = load_protocol()
    manifest = corpus.manifest
    terms = (manifest or load_manifest("nymeria")).terms(synthetic=dataset.startswith(SYNTHETIC_PREFIX))
    if manifest is None:
        terms["title"] = "Invented people and what they do"
    receipts = [receipt for _, receipt, _ in finished]
    records, reused = _records(finished)
    statuses = Counter(record.status for record in records)
    outcomes = sum((Counter(record.outcomes) for record in records), Counter[str]())
    info = CorpusInfo(
        schema_version=corpus_tables.CORPUS_SCHEMA_VERSION,
        **begun_with(protocol),
        dataset=dataset,
        manifest_digest=_manifest_digest(corpus),
        input_digest=text_digest(*(text for receipt in receipts for text in (receipt.name, receipt.input_digest))),
        options={
            "recordings": options.recordings,
            "limit": "all" if options.limit is None else str(options.limit),
            **corpus.described(options),
        },
        counts=CorpusCounts(
            recordings_found=len(records),
            recordings_read=statuses["read"],
            recordings_failed=statuses["failed"],
            recordings_skipped=statuses["skipped"],
            annotations=sum(outcomes.values()),
            **{name: sum(getattr(receipt, name) for receipt in receipts) for name in _COUNTED},
        ),
        outcomes={outcome: outcomes[outcome] for outcome in corpus_tables.ANNOTATION_OUTCOMES},
        quarantine=quarantined(records),
        **terms,
    )
    folders = [folder for folder, _, _ in finished]
    tables = {table: parts.read_batches(folders, table) for table in corpus_tables.CORPUS_TABLES}
    # Last of all: until here an earlier corpus stands as it was.
    info = corpus_tables.write_corpus(out, info, tables, replace=options.replace)
    return BuildReport(out, info, records, reused)


def _records(finished: Sequence[_Finished]) -> tuple[tuple[corpus_tables.CorpusRecord, ...], int]:
    """All recordings, and how many of them an interrupted build had made."""
    records = tuple(record for _, receipt, _ in finished for record in receipt.records)
    return records, sum(len(receipt.records) for _, receipt, reused in finished if reused)


def plan_corpus(name: str, root: Path | str | None, options: corpora.CorpusOptions = _DEFAULTS) -> BuildPlan:
    """Return the dry run: what :func:`build_corpus` would read. Writes nothing.

    Raises:
        UsageError: for an unknown corpus or option.
        InputFileError: if there is nothing to read.
    """
    recordings = [each for _, members in _found(name, root, options)[1] for each in members]
    read = [each for each in recordings if each.skip_reason is None]
    return BuildPlan(
        dataset=name,
        root=None if root is None else Path(root),
        recordings=tuple(each.identity.recording_id for each in recordings),
        skipped=tuple(each.identity.recording_id for each in recordings if each.skip_reason is not None),
        input_bytes=sum(each.input_bytes for each in read),
        estimated_seconds=sum(each.cost[0] for each in read),
        estimated_disk_bytes=round(sum(each.cost[1] for each in read)),
    )
