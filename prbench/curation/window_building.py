"""Build a table of windows from a dataset's native files: each recording is kept as a part, and the parts are merged.

A build that is killed goes on where it stopped; what comes out has the same bytes for any number of workers, whether it
was interrupted or not. Source: docs/specification/motion-prediction.md#from-recordings-to-windows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

import prbench
from prbench.curation.options import BuildOptions
from prbench.curation.sources import native_sources
from prbench.curation.window_job import CutRecording, NativeWindows, WindowsJob, WindowSource, WindowsReceipt
from prbench.curation.window_runs import window_starts
from prbench.engine import Engine, InProcess
from prbench.engine.shards import Shard, ShardRecord, require_settings
from prbench.errors import InputFileError, UsageError
from prbench.files.storage import require_replaceable, sole_writer, text_digest
from prbench.prediction.protocol import PredictionProtocol, load_prediction_protocol
from prbench.prediction.table import FILE_NAME, SCHEMA_VERSION, WindowsInfo, write_windows
from prbench.prediction.window_parts import read_cut_runs
from prbench.protocol.manifests import Manifest, digest_of, load_manifest
from prbench.readers import SYNTHETIC_PREFIX, PublishedForPrediction, reader_for
from prbench.recording.pose_origin import is_estimated
from prbench.sequences.dataset_info import QuarantinedRecording
from prbench.sequences.parts import work_folder, working_in_parts
from prbench.sequences.shard_parts import ShardReport, finish_shard, making_shard, shard_parts

JointChoice = Literal["native", "smpl22"]
"""``native``: joints that a study scored, where the reader gives them; ``smpl22``: the 22 joints of every dataset."""
_IN_PROCESS = InProcess()


@dataclass(frozen=True)
class WindowsReport:
    """The result of a build."""

    folder: Path
    info: WindowsInfo
    recordings: tuple[CutRecording, ...]
    """Every recording that was found, in table order."""

    @property
    def reused(self) -> int:
        """Recordings taken over from an interrupted build."""
        return sum(each.reused for each in self.recordings)


def build_windows(
    dataset: str,
    root: Path | str,
    out: Path | str,
    *,
    joints: JointChoice | None = None,
    recordings: str = "*",
    limit: int | None = None,
    reader: tuple[tuple[str, str], ...] = (),
    on_error: Literal["skip", "fail"] = "skip",
    engine: Engine = _IN_PROCESS,
    progress: Callable[[int, int, str], None] | None = None,
) -> WindowsReport:
    """Build a table of windows from a dataset's native files.

    Args:
        dataset: Name of the reader.
        root: The dataset's folder, or one recording of it.
        out: Folder of the table; an earlier table of windows there is replaced when everything is ready.
        joints: ``native`` (default where the dataset was published for prediction) or ``smpl22``.
        recordings: Glob of recordings.
        limit: Largest number of recordings.
        reader: Options of the reader.
        on_error: Leave out recordings that cannot be read, or stop at the first.
        engine: Where recordings are worked on.
        progress: Called after each recording with how many are done, of how many, and its id.

    Raises:
        UsageError: for an unknown dataset or option.
        InputFileError: if there is nothing to read, or ``native`` is asked of a dataset that nobody published.
        TableError: if no recording yields a window.
        StorageError: if ``out`` cannot be written or holds something else.
    """
    plan = plan_windows(dataset, root, joints=joints, recordings=recordings, limit=limit, reader=reader)
    return build_planned_windows(plan, Path(out), on_error=on_error, engine=engine, progress=progress)


@dataclass(frozen=True)
class WindowsPlan:
    """Recordings of one dataset with one joint set, and what stands in the description of their table."""

    dataset: str
    """Name that the table bears."""
    sources: tuple[WindowSource, ...]
    """At least one, in table order."""
    options: dict[str, str]

    @property
    def joint_set(self) -> str:
        """Name of the joints."""
        return self.sources[0].joint_set


def plan_windows(
    dataset: str,
    root: Path | str,
    *,
    joints: JointChoice | None,
    recordings: str,
    limit: int | None,
    reader: tuple[tuple[str, str], ...],
) -> WindowsPlan:
    """Find the recordings of :func:`build_windows`, whose arguments and errors these are."""
    sources = native_sources(dataset, root, BuildOptions(recordings=recordings, limit=limit, reader=reader))
    name = sources[0].dataset
    manifest = load_manifest(name.removeprefix(SYNTHETIC_PREFIX))
    found = reader_for(name, dict(reader))
    published = found.native_joints if isinstance(found, PublishedForPrediction) else None
    if joints == "native" and published is None:
        raise InputFileError(
            root,
            "",
            expected="a dataset with joints of its own that a study of prediction published",
            found=name,
            remedy="Leave the option out: every dataset has the 22 joints.",
        )
    native = published is not None and joints != "smpl22"
    chosen = {"joints": "native" if native else "smpl22", "recordings": recordings, "limit": str(limit or "all")}
    chosen |= {f"reader.{key}": value for key, value in reader}
    return WindowsPlan(name, tuple(NativeWindows(source, manifest, native) for source in sources), chosen)


def build_planned_windows(
    plan: WindowsPlan,
    out: Path,
    *,
    on_error: Literal["skip", "fail"],
    engine: Engine,
    progress: Callable[[int, int, str], None] | None,
) -> WindowsReport:
    """Build a table of windows from any recordings (see :func:`build_windows`).

    Args:
        plan: What to read.
        out: Folder of the table.
        on_error: See :func:`build_windows`.
        engine: See :func:`build_windows`.
        progress: See :func:`build_windows`.
    """
    out = out.expanduser().absolute()
    require_replaceable(out, FILE_NAME, kind="table of windows")
    with sole_writer(out), working_in_parts(out):
        finished = _cut(plan.sources, work_folder(out), on_error, engine, progress)
        return _write_table(plan.dataset, plan.joint_set, plan.options, finished, out)


def build_windows_shard(
    plan: WindowsPlan,
    out: Path,
    shard: Shard,
    *,
    on_error: Literal["skip", "fail"],
    engine: Engine,
    progress: Callable[[int, int, str], None] | None,
) -> ShardReport[CutRecording]:
    """Make one shard of a build, for :func:`merge_windows_shards`; goes on where it was interrupted.

    Args:
        plan: Of the whole build.
        out: Folder of the shard.
        shard: Which one it is.
        on_error: See :func:`build_windows`.
        engine: See :func:`build_windows`.
        progress: See :func:`build_windows`.

    Raises:
        ShardError: if ``out`` holds another shard.
    """
    out = out.expanduser().absolute()
    record = ShardRecord(
        kind="windows",
        number=shard.number,
        count=shard.count,
        settings=_settings(plan.dataset, plan.joint_set, plan.options),
        plan=tuple(source.recording_id for source in plan.sources),
    )
    mine = [plan.sources[place] for place in shard.places(len(plan.sources))]
    with making_shard(out, record) as work:
        finished = _cut(mine, work, on_error, engine, progress)
        finish_shard(out, record, [each.folder for each in finished])
    return ShardReport(out, shard, len(plan.sources), tuple(finished), sum(each.reused for each in finished))


def merge_windows_shards(shards: Sequence[tuple[Path, ShardRecord]], out: Path) -> WindowsReport:
    """Write the table of an unsharded build from all of its shards, with the same bytes.

    Args:
        shards: All of them (:func:`prbench.engine.shards.require_whole`).
        out: See :func:`build_windows`.

    Raises:
        ShardError: if one is unfinished or damaged, or the manifests differ from today's.
        StorageError: see :func:`build_windows`.
        TableError: see :func:`build_windows`.
    """
    folder, record = shards[0]
    dataset, joints, options = (record.settings[name] for name in ("dataset", "joint_set", "options"))
    require_settings(folder, record, _settings(dataset, joints, options))
    out = out.expanduser().absolute()
    require_replaceable(out, FILE_NAME, kind="table of windows")
    with sole_writer(out):
        finished = [
            CutRecording(name, msgspec.convert(entries, WindowsReceipt), part, reused=False)
            for name, (part, entries) in zip(record.plan, shard_parts(shards), strict=True)
        ]
        return _write_table(dataset, joints, options, finished, out)


def _settings(dataset: str, joints: str, options: dict[str, str]) -> dict[str, Any]:
    """Return what decides a table beside its recordings, as JSON knows it."""
    return {
        "dataset": dataset,
        "joint_set": joints,
        "options": options,
        "manifest": digest_of(load_manifest(dataset.removeprefix(SYNTHETIC_PREFIX))),
        "protocol": load_prediction_protocol().digest,
    }


def _cut(
    sources: Sequence[WindowSource],
    work: Path,
    on_error: Literal["skip", "fail"],
    engine: Engine,
    progress: Callable[[int, int, str], None] | None,
) -> list[CutRecording]:
    """Make the parts of some recordings, in their order."""
    job = WindowsJob(load_prediction_protocol(), on_error == "fail", work)
    finished: list[CutRecording] = []
    for each in engine.map(job, sources, if_full=job.if_full):
        finished.append(each)
        if progress is not None:
            progress(len(finished), len(sources), each.recording_id)
    return finished


def _write_table(
    dataset: str, joints: str, options: dict[str, str], finished: list[CutRecording], out: Path
) -> WindowsReport:
    """Write the table of all parts of a build."""
    manifest = load_manifest(dataset.removeprefix(SYNTHETIC_PREFIX))
    described = _described(dataset, manifest, load_prediction_protocol(), joint_set=joints)
    info = _finished(described, finished, options)
    # Last of all: until here an earlier table stands as it was.
    info = write_windows(out, info, (run for each in finished for run in read_cut_runs(each.folder)))
    return WindowsReport(out, info, tuple(finished))


def published_counts(dataset: str, root: Path | str) -> dict[str, tuple[int, int, int]]:
    """Count a study's segments, frames and windows by published split, without reading any recording.

    Args:
        dataset: Name of a reader.
        root: The dataset's folder; the file that lists its segments is enough.

    Raises:
        UsageError: for a dataset without such a file.
        InputFileError: if it is missing or damaged.
    """
    reader = reader_for(dataset)
    lengths = reader.published_lengths(Path(root)) if isinstance(reader, PublishedForPrediction) else None
    if lengths is None:
        raise UsageError(f"{dataset}: no file of it lists segments that a study of prediction used; build the windows.")
    rules = load_prediction_protocol().windows
    return {
        split: (len(frames), sum(frames), sum(len(window_starts(each, rules)) for each in frames))
        for split, frames in lengths.items()
    }


def _described(name: str, manifest: Manifest, protocol: PredictionProtocol, *, joint_set: str) -> WindowsInfo:
    """Provenance of a build as far as it is known before any recording was read."""
    synthetic = name.startswith(SYNTHETIC_PREFIX)
    rules = protocol.windows
    return WindowsInfo(
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset=name,
        title=f"Invented recordings in the layout of {manifest.title}" if synthetic else manifest.title,
        synthetic=synthetic,
        prbench_version=prbench.__version__,
        manifest_digest=digest_of(manifest),
        input_digest="",
        options={},
        outcomes={},
        quarantine=(),
        identity_digest="",
        content_digest="",
        licence="MIT (invented by prbench, no recorded person)" if synthetic else manifest.licence,
        redistribution="yes" if synthetic else manifest.redistribution,
        homepage="" if synthetic else manifest.homepage,
        citation="" if synthetic else manifest.citation,
        fps=rules.fps,
        observed_frames=rules.observed_frames,
        future_frames=rules.future_frames,
        fewest_gaze_frames=rules.fewest_gaze_frames,
        joint_set=joint_set,
        has_gaze=False,
        estimated_bodies=False,
        participants=0,
        recordings=0,
        runs=0,
        frames=0,
    )


def _finished(info: WindowsInfo, recordings: list[CutRecording], options: dict[str, str]) -> WindowsInfo:
    """Provenance with what reading brought up."""
    read = [text for each in recordings if each.status == "read" for text in (each.recording_id, each.input_digest)]
    return msgspec.structs.replace(
        info,
        input_digest=text_digest(*read),
        options=options,
        estimated_bodies=any(is_estimated(source) for each in recordings for source in each.pose_sources),
        quarantine=tuple(
            QuarantinedRecording(recording_id=each.recording_id, status=each.status, message=each.message)
            for each in recordings
            if each.status != "read"
        ),
    )
