"""Build a dataset: curate recordings one by one, keep each as a part, and merge the parts into one table.

A build that is killed goes on where it stopped; what comes out has the same bytes for any number of workers, whether it
was interrupted or not. A dry run says what a build would read, and about how long and how much that takes.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Mapping
from collections.abc import Sequence as SequenceOf
from pathlib import Path
from typing import Any

import msgspec

from prbench.curation.corrections import Corrections
from prbench.curation.job import CurationJob, PartReceipt, RecordingSource, describe, native_sources, part_receipt
from prbench.curation.options import NO_OPTIONS, BuildOptions
from prbench.curation.splits import draw_splits
from prbench.engine import Engine, InProcess
from prbench.engine.shards import Shard, ShardRecord, require_settings
from prbench.errors import PrbenchError, StorageError, TableError, UsageError
from prbench.files.bounded import require
from prbench.files.storage import require_replaceable, sole_writer
from prbench.progress_bar import ProgressCallback
from prbench.protocol.manifests import digest_of, load_protocol
from prbench.readers.discover import BrokenDataset, FoundDataset, discover
from prbench.sequences import parts
from prbench.sequences.dataset_info import FILE_NAME, DatasetInfo
from prbench.sequences.parts import BuildPlan, BuildReport, ShardReport
from prbench.sequences.sequence import Recording
from prbench.sequences.write import with_splits, write_dataset

_IN_PROCESS = InProcess()
_UNMEASURED = {"megabytes_per_second": 30.0, "table_share": 0.02}


def build_dataset(
    dataset: str,
    root: Path | str,
    out: Path | str,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: ProgressCallback | None = None,
) -> BuildReport[DatasetInfo, Recording]:
    """Build a dataset from its native files.

    Args:
        dataset: Name of the reader, for example ``adt``.
        root: The dataset's folder, or one recording of it.
        out: Folder of the new dataset; an earlier dataset there is replaced when everything is ready, and
            only by one that holds its recordings.
        options: What to read, and how to curate it.
        engine: Runs the work on recordings, in this process or in others.
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
    progress: ProgressCallback | None = None,
    extra_options: Mapping[str, str] | None = None,
) -> BuildReport[DatasetInfo, Recording]:
    """Build a dataset from any recordings of one dataset, sorted here into table order (see :func:`build_dataset`).

    Args:
        sources: What to read.
        out: See :func:`build_dataset`, as for the other arguments.
        options: See there.
        engine: See there.
        progress: See there.
        extra_options: Further entries for the options in ``dataset.json``.
    """
    out = Path(out).expanduser().absolute()
    require_replaceable(out, FILE_NAME, kind="dataset")
    sources = _in_table_order(sources)
    dataset = sources[0].dataset
    _require_same_dataset(out, dataset)
    with sole_writer(out), parts.working_in_parts(out):
        corrections = _corrections_of(sources, options)
        receipts = _make_parts(sources, parts.work_folder(out), options, corrections, engine, progress)
        return _write_table(dataset, receipts, out, options, extra_options or {})


def build_shard_from_sources(
    sources: SequenceOf[RecordingSource],
    out: Path | str,
    shard: Shard,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: ProgressCallback | None = None,
) -> ShardReport[Recording]:
    """Make one shard of a build, for :func:`merge_dataset_shards`; goes on where it was interrupted.

    Args:
        sources: Recordings of all shards.
        out: Folder of the shard.
        shard: Which one it is.
        options: See :func:`build_dataset`, as for the other arguments.
        engine: See there.
        progress: See there.

    Raises:
        ShardError: if ``out`` holds another shard.
    """
    out = Path(out).expanduser().absolute()
    sources = _in_table_order(sources)
    settings = _settings(sources[0].dataset, options)
    record = ShardRecord.of("dataset", shard, settings, (source.recording_id for source in sources))
    mine = [sources[place] for place in shard.places(len(sources))]
    corrections = _corrections_of(sources, options)
    with parts.making_shard(out, record) as work:
        receipts = _make_parts(mine, work, options, corrections, engine, progress)
        parts.finish_shard(out, record, [receipt.folder for receipt in receipts])
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
    dataset = record.setting(folder, str, "dataset")
    options = dataclasses.replace(record.setting(folder, BuildOptions, "options"), replace=replace)
    require_settings(folder, record, _settings(dataset, options))
    out = out.expanduser().absolute()
    require_replaceable(out, FILE_NAME, kind="dataset")
    _require_same_dataset(out, dataset)
    with sole_writer(out):
        receipts = [part_receipt(part, entries, reused=False) for part, entries in parts.shard_parts(shards)]
        return _write_table(dataset, receipts, out, options, {})


def _settings(dataset: str, options: BuildOptions) -> dict[str, Any]:
    """Return what decides a table beside its recordings, as JSON knows it."""
    chosen = msgspec.to_builtins(dataclasses.replace(options, replace=False, on_error="skip"))
    manifest = digest_of(options.manifest_of(dataset))
    protocol = (options.protocol or load_protocol()).digest
    return {"dataset": dataset, "options": chosen, "manifest": manifest, "protocol": protocol}


def _in_table_order(sources: SequenceOf[RecordingSource]) -> list[RecordingSource]:
    # With the slash, because sequence ids go on with one: the table comes out sorted by id.
    ordered = sorted(sources, key=lambda source: f"{source.recording_id}/")
    require("sources", (ordered != [], "", "recordings to build from", "none", ""))
    for one, other in itertools.pairwise(ordered):
        differ = one.recording_id != other.recording_id and one.dataset == other.dataset
        names = f"{one.dataset}/{one.recording_id} and {other.dataset}/{other.recording_id}"
        require(one.recording_id, (differ, "", "recordings of one dataset with different names", names, ""))
    return ordered


def _corrections_of(sources: SequenceOf[RecordingSource], options: BuildOptions) -> Mapping[str, Corrections]:
    """Return the corrections of each recording; refuse those of recordings that a whole build does not have."""
    if options.corrections is None:
        return {}
    names = frozenset(source.recording_id for source in sources)
    partial = options.recordings != "*" or options.limit is not None
    return options.corrections.by_recording(sources[0].dataset, names, partial=partial)


def _make_parts(
    sources: SequenceOf[RecordingSource],
    work: Path,
    options: BuildOptions,
    corrections: Mapping[str, Corrections],
    engine: Engine,
    progress: ProgressCallback | None,
) -> list[PartReceipt]:
    """Make the parts of some recordings of one dataset, in their order."""
    if not sources:
        return []
    manifest = options.manifest_of(sources[0].dataset)
    options.curation.require_fits(manifest)
    protocol = options.protocol or load_protocol()
    job = CurationJob(options.on_error == "fail", work, manifest, protocol, options.curation, corrections)
    return job.make_all(sources, engine, progress)


def _write_table(
    dataset: str, receipts: SequenceOf[PartReceipt], out: Path, options: BuildOptions, extra_options: Mapping[str, str]
) -> BuildReport[DatasetInfo, Recording]:
    """Write the table of all parts of a build."""
    manifest = options.manifest_of(dataset)
    protocol = options.protocol or load_protocol()
    folders = [receipt.folder for receipt in receipts]
    # Only all recordings together say which of them are tested on.
    splits = draw_splits([receipt.record for receipt in receipts], manifest, protocol.splits)
    about = describe(dataset, options, receipts, extra_options)
    tables = {name: with_splits(parts.read_batches(folders, name), splits) for name in ("sequences", "recordings")}
    tables |= {name: parts.read_batches(folders, name) for name in ("events", "scenes")}
    incomplete = [receipt.record.recording_id for receipt in receipts if receipt.record.shortfalls]
    info = write_dataset(out, about, **tables, replace=options.replace, incomplete=incomplete, protocol=protocol)
    reused = sum(receipt.reused for receipt in receipts)
    records = (dataclasses.replace(each.record, split=splits[each.record.recording_id]) for each in receipts)
    return BuildReport(out, info, tuple(records), reused)


def _require_same_dataset(out: Path, dataset: str) -> None:
    """Refuse to replace the table of another dataset."""
    if not (out / FILE_NAME).is_file():
        return
    try:
        there = DatasetInfo.read(out).dataset
    except TableError:
        return  # damaged or of another version: a build is the way to mend it
    if there != dataset:
        raise StorageError(f"{out}: holds a table of {there}, and {dataset} is built. Choose another folder for --out.")


def plan_build(dataset: str, root: Path | str, options: BuildOptions = NO_OPTIONS) -> BuildPlan:
    """Return the dry run: what :func:`build_dataset` would read. Writes nothing.

    Raises:
        UsageError: for a dataset without a reader.
        InputFileError: if there is nothing to read.
    """
    sources = native_sources(dataset, root, options)
    estimate = options.manifest_of(dataset).estimate or _UNMEASURED
    size = sum(source.size for source in sources if source.skip_reason is None)
    names = tuple(source.recording_id for source in sources)
    skipped = tuple(source.recording_id for source in sources if source.skip_reason is not None)
    seconds = size / (estimate["megabytes_per_second"] * 1e6)
    return BuildPlan(dataset, Path(root), names, skipped, size, seconds, round(size * 2 * estimate["table_share"]))


def build_all(
    root: Path | str,
    out: Path | str,
    *,
    options: BuildOptions = NO_OPTIONS,
    engine: Engine = _IN_PROCESS,
    progress: ProgressCallback | None = None,
) -> tuple[list[BuildReport[DatasetInfo, Recording]], list[BrokenDataset]]:
    """Build every dataset that is recognised below a folder, into ``out/<dataset>``.

    Args:
        root: Folder that holds copies of datasets, or one of them.
        out: Folder of the tables.
        options: Options of every build; in-hand rules and reader's options belong to one dataset and are refused.
        engine: Runs the work on recordings, in this process or in others.
        progress: Called after each recording.

    Returns:
        What was built, and the datasets that were found and gave no table.

    Raises:
        InputFileError: if nothing is recognised.
        UsageError: for options of one dataset, or if one dataset was found twice.
        PrbenchError: the first problem of a dataset, with ``on_error="fail"``.
    """
    found, broken = found_datasets(root, options)
    if broken and options.on_error == "fail":
        raise PrbenchError(broken[0].message)
    built = []
    for each in found:
        folder = Path(out) / each.name
        try:
            report = build_dataset(each.dataset, each.root, folder, options=options, engine=engine, progress=progress)
        except PrbenchError as error:
            if options.on_error == "fail":
                raise
            broken.append(BrokenDataset(each.name, each.root, str(error)))
        else:
            built.append(report)
    return built, broken


def found_datasets(root: Path | str, options: BuildOptions) -> tuple[tuple[FoundDataset, ...], list[BrokenDataset]]:
    """Return the datasets that :func:`build_all` would build, and those that cannot be listed.

    Raises:
        InputFileError: if nothing is recognised.
        UsageError: for options of one dataset, or if one dataset was found twice.
    """
    # Rules and reader's options are named after what one dataset records, so none is meant for all of them.
    chosen = options.curation
    if chosen.in_hand or chosen.shift or chosen.scale or options.reader or options.corrections is not None:
        belonging = "--in-hand, --events-only, --option, --shift, --scale and --corrections belong to one dataset"
        raise UsageError(f"{belonging}; build that dataset by itself.")
    discovery = discover(Path(root))
    if twice := [name for name, count in Counter(each.name for each in discovery.found).items() if count > 1]:
        places = " and ".join(str(each.root) for each in discovery.found if each.name == twice[0])
        raise UsageError(f"{twice[0]} was found in {places}; build the one you mean with `build-dataset {twice[0]}`.")
    return discovery.found, list(discovery.broken)
