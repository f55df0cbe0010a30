"""Build a dataset: curate recordings one by one, keep each as a part, and merge the parts into one table.

A build that is killed goes on where it stopped; what comes out has the same bytes for any number of workers, whether it
was interrupted or not. A dry run says what a build would read, and about how long and how much that takes.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Callable, Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from prbench.curation.job import CurationJob, PartReceipt, RecordingSource, describe, native_sources, part_receipt
from prbench.curation.options import NO_OPTIONS, BuildOptions
from prbench.engine import Engine, InProcess
from prbench.engine.shards import Shard, ShardRecord, require_settings
from prbench.errors import InputFileError, PrbenchError, StorageError, TableError, UsageError
from prbench.files.storage import require_replaceable, sole_writer
from prbench.protocol.manifests import BuildEstimate, digest_of, load_manifest, load_protocol
from prbench.readers import SYNTHETIC_PREFIX, reader_for
from prbench.readers.discover import FoundDataset, discover
from prbench.sequences.dataset_info import FILE_NAME, DatasetInfo
from prbench.sequences.parts import (
    BuildPlan,
    BuildReport,
    ShardReport,
    finish_shard,
    making_shard,
    read_batches,
    shard_parts,
    work_folder,
    working_in_parts,
)
from prbench.sequences.sequence import Recording
from prbench.sequences.write import write_dataset

_IN_PROCESS = InProcess()
_UNMEASURED = BuildEstimate(megabytes_per_second=30.0, table_share=0.02)


@dataclass(frozen=True)
class Progress:
    """One recording is done."""

    done: int
    total: int
    record: Recording
    reused: bool
    """True if an interrupted build had already made it."""


def build_dataset(
    dataset: str,
    root: Path | str,
    out: Path | str,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: Callable[[Progress], None] | None = None,
) -> BuildReport[DatasetInfo, Recording]:
    """Build a dataset from its native files.

    Args:
        dataset: Name of the reader, for example ``adt``.
        root: The dataset's folder, or one recording of it.
        out: Folder of the new dataset; an earlier dataset there is replaced when everything is ready, and
            only by one that holds its recordings.
        options: What to read, and how to curate it.
        engine: Where recordings are worked on.
        progress: Called after each recording, in order.

    Raises:
        UsageError: for an unknown dataset or option.
        InputFileError: if there is nothing to read.
        StorageError: if ``out`` cannot be written or holds something else.
        RecordingsWouldBeLost: if the dataset that stands there holds more, and the options do not say to replace it;
            finished parts are kept.
    """
    sources = native_sources(dataset, root, options)
    return build_from_sources(sources, out, options=options, engine=engine, progress=progress)


def build_from_sources(
    sources: SequenceOf[RecordingSource],
    out: Path | str,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: Callable[[Progress], None] | None = None,
    extra_options: dict[str, str] | None = None,
) -> BuildReport[DatasetInfo, Recording]:
    """Build a dataset from any recordings of one dataset, in table order (see :func:`build_dataset`).

    Args:
        sources: What to read; sorted here.
        out: See :func:`build_dataset`.
        options: See :func:`build_dataset`.
        engine: See :func:`build_dataset`.
        progress: See :func:`build_dataset`.
        extra_options: Further entries for the options in ``dataset.json``.
    """
    out = Path(out).expanduser().absolute()
    require_replaceable(out, FILE_NAME, kind="dataset")
    sources = _in_table_order(sources)
    dataset = sources[0].dataset
    _require_same_dataset(out, dataset)
    with sole_writer(out), working_in_parts(out):
        receipts = _make_parts(sources, work_folder(out), options, engine, progress)
        return _write_table(dataset, receipts, out, options, extra_options or {})


def build_dataset_shard(
    dataset: str,
    root: Path | str,
    out: Path | str,
    shard: Shard,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: Callable[[Progress], None] | None = None,
) -> ShardReport[Recording]:
    """Make one shard of a build, for :func:`merge_dataset_shards`; goes on where it was interrupted.

    Args:
        dataset: See :func:`build_dataset`, whose errors these are.
        root: See :func:`build_dataset`.
        out: Folder of the shard.
        shard: Which one it is.
        options: See :func:`build_dataset`.
        engine: See :func:`build_dataset`.
        progress: See :func:`build_dataset`.

    Raises:
        ShardError: if ``out`` holds another shard.
    """
    sources = native_sources(dataset, root, options)
    return build_shard_from_sources(sources, out, shard, options=options, engine=engine, progress=progress)


def build_shard_from_sources(
    sources: SequenceOf[RecordingSource],
    out: Path | str,
    shard: Shard,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: Callable[[Progress], None] | None = None,
) -> ShardReport[Recording]:
    """Make one shard of any recordings of one dataset (see :func:`build_dataset_shard`).

    Args:
        sources: Those of all shards; sorted here.
        out: See :func:`build_dataset_shard`.
        shard: See :func:`build_dataset_shard`.
        options: See :func:`build_dataset_shard`.
        engine: See :func:`build_dataset_shard`.
        progress: See :func:`build_dataset_shard`.
    """
    out = Path(out).expanduser().absolute()
    sources = _in_table_order(sources)
    record = ShardRecord(
        kind="dataset",
        number=shard.number,
        count=shard.count,
        settings=_settings(sources[0].dataset, options),
        plan=tuple(source.recording_id for source in sources),
    )
    mine = [sources[place] for place in shard.places(len(sources))]
    with making_shard(out, record) as work:
        receipts = _make_parts(mine, work, options, engine, progress)
        finish_shard(out, record, [receipt.folder for receipt in receipts])
    reused = sum(receipt.reused for receipt in receipts)
    return ShardReport(out, shard, len(sources), tuple(receipt.record for receipt in receipts), reused)


def merge_dataset_shards(
    shards: SequenceOf[tuple[Path, ShardRecord]], out: Path, *, replace: bool
) -> BuildReport[DatasetInfo, Recording]:
    """Write the table of an unsharded build from all of its shards, with the same bytes.

    Args:
        shards: All of them (:func:`prbench.engine.shards.require_whole`).
        out: See :func:`build_dataset`.
        replace: Replace a table that holds recordings which the shards lack.

    Raises:
        ShardError: if one is unfinished or damaged, or the manifests differ from today's.
        StorageError: see :func:`build_dataset`.
        RecordingsWouldBeLost: see :func:`build_dataset`.
    """
    folder, record = shards[0]
    dataset = record.settings["dataset"]
    options = dataclasses.replace(msgspec.convert(record.settings["options"], BuildOptions), replace=replace)
    require_settings(folder, record, _settings(dataset, options))
    out = out.expanduser().absolute()
    require_replaceable(out, FILE_NAME, kind="dataset")
    _require_same_dataset(out, dataset)
    with sole_writer(out):
        receipts = [part_receipt(part, entries, reused=False) for part, entries in shard_parts(shards)]
        return _write_table(dataset, receipts, out, options, {})


def _settings(dataset: str, options: BuildOptions) -> dict[str, Any]:
    """Return what decides a table beside its recordings, as JSON knows it."""
    chosen = dataclasses.replace(options, replace=False, on_error="skip")
    return {
        "dataset": dataset,
        "options": msgspec.to_builtins(chosen),
        "manifest": digest_of(load_manifest(dataset.removeprefix(SYNTHETIC_PREFIX))),
        "protocol": (options.protocol or load_protocol()).digest,
    }


def _in_table_order(sources: SequenceOf[RecordingSource]) -> list[RecordingSource]:
    # With the slash, because sequence ids go on with one: the table comes out sorted by id.
    ordered = sorted(sources, key=lambda source: f"{source.recording_id}/")
    if not ordered:
        raise InputFileError("sources", "", expected="recordings to build from", found="none")
    for one, other in itertools.pairwise(ordered):
        if one.recording_id == other.recording_id or one.dataset != other.dataset:
            raise InputFileError(
                one.recording_id,
                "",
                expected="recordings of one dataset with different names",
                found=f"{one.dataset}/{one.recording_id} and {other.dataset}/{other.recording_id}",
            )
    return ordered


def _make_parts(
    sources: SequenceOf[RecordingSource],
    work: Path,
    options: BuildOptions,
    engine: Engine,
    progress: Callable[[Progress], None] | None,
) -> list[PartReceipt]:
    """Make the parts of some recordings of one dataset, in their order."""
    if not sources:
        return []
    manifest = load_manifest(sources[0].dataset.removeprefix(SYNTHETIC_PREFIX))
    options.curation.require_fits(manifest)
    protocol = options.protocol or load_protocol()
    job = CurationJob(manifest, protocol, options.curation, options.on_error == "fail", work)
    receipts = []
    for receipt in engine.map(job, sources, if_full=job.if_full):
        receipts.append(receipt)
        if progress is not None:
            progress(Progress(len(receipts), len(sources), receipt.record, receipt.reused))
    return receipts


def _write_table(
    dataset: str,
    receipts: SequenceOf[PartReceipt],
    out: Path,
    options: BuildOptions,
    extra_options: dict[str, str],
) -> BuildReport[DatasetInfo, Recording]:
    """Write the table of all parts of a build."""
    manifest = load_manifest(dataset.removeprefix(SYNTHETIC_PREFIX))
    protocol = options.protocol or load_protocol()
    info = describe(dataset, manifest, protocol, options, receipts, extra_options)
    folders = [receipt.folder for receipt in receipts]
    info = write_dataset(
        out,
        info,
        sequences=read_batches(folders, "sequences"),
        events=read_batches(folders, "events"),
        recordings=read_batches(folders, "recordings"),
        scenes=read_batches(folders, "scenes"),
        replace=options.replace,
        incomplete=[receipt.record.recording_id for receipt in receipts if receipt.record.shortfalls],
        protocol=protocol,
    )
    reused = sum(receipt.reused for receipt in receipts)
    return BuildReport(out, info, tuple(receipt.record for receipt in receipts), reused)


def _require_same_dataset(out: Path, dataset: str) -> None:
    """A table replaces an older one of its own dataset, never that of another."""
    if not (out / FILE_NAME).is_file():
        return
    try:
        there = DatasetInfo.read(out).dataset
    except TableError:
        return  # damaged or of another version: a build is the way to mend it
    if there != dataset:
        raise StorageError(f"{out}: holds a table of {there}, and {dataset} is built. Choose another folder for --out.")


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


@dataclass(frozen=True)
class Outcome:
    """The outcome of one dataset."""

    dataset: str
    root: Path
    report: BuildReport | None
    """The report; None where nothing could be built."""
    message: str
    """The reason why nothing was built; empty where it was."""

    @property
    def complete(self) -> bool:
        """Return True if every recording that was found could be read to its end."""
        if self.report is None:
            return False
        counts = self.report.info.counts
        return counts.recordings_failed == 0 and counts.recordings_cut_short == 0


def build_all(
    root: Path | str,
    out: Path | str,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: Callable[[str, Progress], None] | None = None,
) -> tuple[Outcome, ...]:
    """Build every dataset that is recognised below a folder, into ``out/<dataset>``.

    Args:
        root: Folder that holds copies of datasets, or one of them.
        out: Folder of the tables.
        options: As for one dataset; options of readers go to those that know them.
        engine: Where recordings are worked on.
        progress: Called with the dataset's name after each recording.

    Raises:
        InputFileError: if nothing is recognised.
        UsageError: if an option fits no dataset that was found, or one dataset was found twice.
        PrbenchError: the first problem of a dataset, with ``on_error="fail"``.
    """
    root = Path(root)
    out = Path(out)
    discovery = discover(root)
    chosen = _reader_options(discovery.found, options)
    outcomes = [Outcome(broken.dataset, broken.root, None, broken.message) for broken in discovery.broken]
    if outcomes and options.on_error == "fail":
        raise PrbenchError(outcomes[0].message)
    for found in discovery.found:
        # A reader gets only the options that it knows; those of other datasets would be refused.
        own = dataclasses.replace(options, reader=chosen[found.dataset])
        try:
            report = build_dataset(
                found.dataset,
                found.root,
                out / found.name,
                options=own,
                engine=engine,
                progress=None if progress is None else lambda step, name=found.name: progress(name, step),
            )
        except PrbenchError as error:
            if options.on_error == "fail":
                raise
            outcomes.append(Outcome(found.name, found.root, None, str(error)))
        else:
            outcomes.append(Outcome(found.name, found.root, report, ""))
    # By name, so that broken folders, which are known before anything is built, stand among the others.
    return tuple(sorted(outcomes, key=lambda outcome: outcome.dataset))


def plan_all(root: Path | str, options: BuildOptions = NO_OPTIONS) -> tuple[tuple[str, Path, BuildPlan], ...]:
    """The dry run: name, folder and plan of every dataset that :func:`build_all` would build.

    Raises:
        InputFileError: if nothing is recognised.
        UsageError: if an option fits no dataset that was found, or one dataset was found twice.
    """
    found = discover(root).found
    chosen = _reader_options(found, options)
    return tuple(
        (
            each.name,
            each.root,
            plan_build(each.dataset, each.root, dataclasses.replace(options, reader=chosen[each.dataset])),
        )
        for each in found
    )


def _reader_options(
    found: tuple[FoundDataset, ...], options: BuildOptions
) -> Mapping[str, tuple[tuple[str, str], ...]]:
    """The options of each dataset's reader, out of those given for all of them."""
    twice = [name for name, count in Counter(each.name for each in found).items() if count > 1]
    if twice:
        places = " and ".join(str(each.root) for each in found if each.name == twice[0])
        raise UsageError(f"{twice[0]} was found in {places}; build the one you mean with `build-dataset {twice[0]}`.")
    # Rules are named after what a dataset records (grasps, bodies, annotations), so no rule is meant for all of them.
    if options.curation.in_hand is not None:
        raise UsageError("--in-hand names a rule of one dataset; build that dataset by itself.")
    known = {each.dataset: reader_for(each.dataset).options.names() for each in found}
    for name, _ in options.reader:
        if not any(name in names for names in known.values()):
            everything = sorted({name for names in known.values() for name in names})
            raise UsageError(f"no reader of what was found has an option '{name}'; they have: {', '.join(everything)}.")
    return {dataset: tuple(o for o in options.reader if o[0] in names) for dataset, names in known.items()}
