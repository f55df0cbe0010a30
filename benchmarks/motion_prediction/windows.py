"""Recordings as runs of frames at the windows' rate, and the windows in them.

Source: docs/specification/motion-prediction.md#from-recordings-to-windows. Nothing that a predictor sees is made from a
sample later than its frame, except body frames in gaps (no window's observation ends in one) and bodies whose
rate is no multiple of the windows' rate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int

import prbench
from prbench.curation.curate import split_of
from prbench.curation.job import NativeSource, native_sources
from prbench.curation.options import BuildOptions
from prbench.engine import Engine, InProcess, is_out_of_memory
from prbench.engine.shards import Shard, ShardRecord, require_settings
from prbench.errors import InputFileError, PrbenchError, UsageError
from prbench.files.storage import require_replaceable, sole_writer, text_digest
from prbench.geometry.skeleton import head_forward
from prbench.geometry.timelines import covered, interpolate, nearest_index
from prbench.protocol.manifests import Manifest, digest_of, load_manifest, load_protocol
from prbench.readers import SYNTHETIC_PREFIX, PublishedForPrediction, Reader, reader_for
from prbench.recording.streams import BodyStream, PublishedTrack, Recording, is_estimated
from prbench.sequences import parts
from prbench.sequences.dataset_info import QuarantinedRecording
from prbench.sequences.parts import ShardReport, finish_shard, making_shard, shard_parts, work_folder, working_in_parts
from prbench.shown import quoted
from prbench_benchmarks.motion_prediction.joint_sets import SMPL22, joint_set
from prbench_benchmarks.motion_prediction.protocol import PredictionProtocol, WindowRules, load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import (
    FILE_NAME,
    SCHEMA_VERSION,
    CutRun,
    Run,
    Window,
    WindowsInfo,
    write_windows,
)
from prbench_benchmarks.motion_prediction.window_parts import read_cut_runs, write_cut_runs

_ROUNDING = 1e-6  # seconds
_RATE_TOLERANCE = 0.005
"""Share by which a rate may differ from a multiple of the windows' rate: 29.97 is 30, EgoAllo's 30.3 is not."""


def runs_of_recording(recording: Recording, rules: WindowRules, *, split: str) -> Iterator[CutRun]:
    """Runs of the 22 joints, cut where the body is missing for longer than the largest gap.

    Args:
        recording: With a body; one without yields nothing.
        rules: Rate, lengths and limits.
        split: The recording's split.
    """
    body = recording.body
    if body is None or not body.valid.any():
        return
    times, joints, filled, posed = _resampled(body, rules)
    directions, _ = head_forward(joints, recording.head_tilt_deg)
    gaze = recording.gaze
    looks, looking = latest_gaze(gaze.times, gaze.direction, gaze.valid, times, oldest=rules.largest_gaze_age)
    for number, (first, stop) in enumerate(_stretches(posed)):
        if stop - first <= rules.length:
            continue
        part = slice(first, stop)
        run = Run(
            run_id=f"{recording.recording_id}/{number}",
            recording_id=recording.recording_id,
            participant_id=recording.participant_id,
            split=split,
            published_split="",
            segment=str(number),
            pose_source=recording.pose_source,
            fps=rules.fps,
            start_time=float(times[first]),
            joints=joints[part],
            joints_valid=posed[part],
            # What was seen before the run began may be held into it: it lies in the past, too.
            gaze=looks[part],
            gaze_valid=looking[part],
            head_direction=directions[part],
        )
        yield CutRun(run, sliding_windows(run, filled[part], rules))


def runs_of_tracks(
    recording: Recording, tracks: tuple[PublishedTrack, ...], rules: WindowRules, *, split: str, published_split: str
) -> Iterator[CutRun]:
    """One run for each published segment, whole, with every window that the study counts.

    Args:
        recording: The recording that the segments are pieces of.
        tracks: The segments.
        rules: Rate, lengths and limits.
        split: The recording's split.
        published_split: That of the published evaluation, where the segments do not tell it themselves.
    """
    for track in tracks:
        directions, _ = head_forward(track.body, recording.head_tilt_deg)
        oldest = rules.largest_gaze_age
        looks, looking = latest_gaze(track.times, track.gaze, track.gaze_measured, track.times, oldest=oldest)
        run = Run(
            run_id=f"{recording.recording_id}/{track.name}",
            recording_id=recording.recording_id,
            participant_id=recording.participant_id,
            split=split,
            published_split=track.published_split or published_split,
            segment=track.name,
            pose_source=recording.pose_source,
            fps=rules.fps,
            start_time=float(track.times[0]),
            joints=track.joints,
            joints_valid=track.valid,
            gaze=looks,
            gaze_valid=looking,
            head_direction=directions,
        )
        yield CutRun(run, sliding_windows(run, track.filled, rules))


def window_starts(n_frames: int, rules: WindowRules) -> Int[np.ndarray, " n"]:
    """Starts 0, stride, 2 stride, … below ``n_frames`` minus the length of a window, which is excluded itself."""
    return np.arange(0, max(n_frames - rules.length, 0), rules.stride)


def sliding_windows(run: Run, filled: Bool[np.ndarray, " n"], rules: WindowRules) -> tuple[Window, ...]:
    """Every window of a run; those that must not be scored say why.

    Args:
        run: The frames.
        filled: Frames that were interpolated across a gap, and so tell of a later one.
        rules: Lengths.
    """
    windows = []
    for start in window_starts(len(run), rules).tolist():
        border = start + rules.observed_frames
        exclusion = ""
        if not run.joints_valid[start : start + rules.length].all():
            exclusion = "invalid_body"
        elif filled[border - 1]:
            exclusion = "gap_at_border"
        looking = int(run.gaze_valid[start:border].sum())
        windows.append(Window(start, looking, rules.future_frames, exclusion))
    return tuple(windows)


def latest_gaze(
    times: Float[np.ndarray, " m"],
    directions: Float[np.ndarray, "m 3"],
    valid: Bool[np.ndarray, " m"],
    frames: Float[np.ndarray, " n"],
    *,
    oldest: float,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """The last valid sample not later than each frame; interpolating would read the future across a window's border.

    Args:
        times: Of the samples, seconds.
        directions: Unit vectors.
        valid: Samples that were measured.
        frames: Seconds.
        oldest: Age above which a sample no longer counts, seconds.

    Returns:
        Directions (+Z before the first sample), and where the sample is young enough.
    """
    known = times[valid]
    latest = np.searchsorted(known, frames + _ROUNDING, side="right") - 1
    if not len(known):
        return np.tile([0.0, 0.0, 1.0], (len(frames), 1)), np.zeros(len(frames), dtype=bool)
    there = latest >= 0
    age = frames - known[np.maximum(latest, 0)]
    held = directions[valid][np.maximum(latest, 0)]
    return np.where(there[:, None], held, [0.0, 0.0, 1.0]), there & (age <= oldest + _ROUNDING)


def _resampled(
    body: BodyStream, rules: WindowRules
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 22 3"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Frame times, joints, where they were filled across a gap, and where there is a body at all."""
    known = body.times[body.valid]
    poses = body.joints[body.valid]
    period = float(np.median(np.diff(body.times))) if len(body.times) > 1 else 1.0 / rules.fps
    frames = int(np.floor((known[-1] - known[0]) * rules.fps + _ROUNDING)) + 1
    times = known[0] + np.arange(frames) / rules.fps
    posed = covered(known, np.ones(len(known), dtype=bool), times, max_gap=rules.largest_gap)
    ratio = 1.0 / (period * rules.fps)
    if round(ratio) >= 1 and abs(ratio / round(ratio) - 1) <= _RATE_TOLERANCE:
        nearest = nearest_index(known, times)
        sampled = np.abs(known[nearest] - times) <= 0.5 * period + _ROUNDING
        joints = np.where(sampled[:, None, None], poses[nearest], interpolate(known, poses, times))
        return times, joints, posed & ~sampled, posed | sampled
    right = np.clip(np.searchsorted(known, times), 1, max(len(known) - 1, 1))
    # Between neighbours of the source's own rate there is no gap, whatever its rate.
    apart = np.diff(known)[right - 1] if len(known) > 1 else np.zeros(len(times))
    return times, interpolate(known, poses, times), posed & (apart > 1.5 * period), posed


def _stretches(posed: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """First frame and end of every stretch of frames with a body."""
    steps = np.flatnonzero(np.diff(np.concatenate(([False], posed, [False])).astype(np.int8)))
    return [(int(first), int(stop)) for first, stop in steps.reshape(-1, 2)]


Status = Literal["read", "failed", "skipped"]


class WindowsReceipt(msgspec.Struct, frozen=True, kw_only=True):
    """Description of a finished part, readable without opening its tables."""

    input_digest: str
    status: Status
    message: str
    """The reason where there are no runs."""
    pose_sources: tuple[str, ...]


@dataclass(frozen=True)
class CutRecording:
    """The runs of one recording as a part, or the reason why there are none."""

    recording_id: str
    receipt: WindowsReceipt
    folder: Path
    reused: bool
    """True if an earlier, interrupted build had made it."""

    @property
    def status(self) -> Status:
        """It was read, skipped, or it failed."""
        return self.receipt.status

    @property
    def message(self) -> str:
        """The reason why it was not."""
        return self.receipt.message

    @property
    def input_digest(self) -> str:
        """Digest of its files."""
        return self.receipt.input_digest

    @property
    def pose_sources(self) -> tuple[str, ...]:
        """Kinds of measurement that its bodies come from."""
        return self.receipt.pose_sources


@runtime_checkable
class WindowSource(Protocol):
    """One recording that can be cut into windows; picklable, so that an engine can do it in other processes."""

    @property
    def recording_id(self) -> str:
        """Unique within the build."""
        ...

    @property
    def skip_reason(self) -> str | None:
        """Why it is left out; None if it is not."""
        ...

    @property
    def joint_set(self) -> str:
        """Name of the joints of its runs."""
        ...

    @property
    def settings(self) -> str:
        """Digest of everything but the files and the protocol that decides what comes out."""
        ...

    def input_digest(self) -> str:
        """Digest of its files."""
        ...

    def cut(self, protocol: PredictionProtocol) -> Iterator[CutRun]:
        """Read it, and cut it.

        Raises:
            PrbenchError: if it cannot be read.
        """
        ...

    def without_places(self, message: str) -> str:
        """A message without the folders of this machine."""
        ...


@dataclass(frozen=True)
class NativeWindows:
    """A recording of a reader's dataset."""

    source: NativeSource
    manifest: Manifest
    native: bool
    """Whether the joints are those of the study."""

    @property
    def recording_id(self) -> str:
        """See :class:`WindowSource`."""
        return self.source.recording_id

    @property
    def skip_reason(self) -> str | None:
        """See :class:`WindowSource`."""
        return self.source.skip_reason

    @property
    def joint_set(self) -> str:
        """See :class:`WindowSource`."""
        reader = self._reader
        return reader.native_joints if self.native and isinstance(reader, PublishedForPrediction) else SMPL22.name

    @property
    def settings(self) -> str:
        """See :class:`WindowSource`."""
        return text_digest(digest_of(self.manifest), load_protocol().digest, self.joint_set)

    def input_digest(self) -> str:
        """See :class:`WindowSource`."""
        return self.source.input_digest()

    def without_places(self, message: str) -> str:
        """See :class:`WindowSource`."""
        return self.source.without_places(message)

    def cut(self, protocol: PredictionProtocol) -> Iterator[CutRun]:
        """See :class:`WindowSource`."""
        source = self.source
        reader = self._reader
        if isinstance(reader, PublishedForPrediction):
            # Its tracks know which samples were measured; the recording holds and interpolates, also from later ones.
            recording, tracks = reader.read_published(source.found, native=self.native)
            published = protocol.published_splits.get(source.dataset)
            yield from runs_of_tracks(
                recording,
                tracks,
                protocol.windows,
                split=self._split(recording.split_group),
                published_split="" if published is None else published.of(source.recording_id),
            )
            return
        recording = reader.read(source.found)
        yield from runs_of_recording(recording, protocol.windows, split=self._split(recording.split_group))

    @property
    def _reader(self) -> Reader:
        return reader_for(self.source.dataset, dict(self.source.reader_options))

    def _split(self, group: str) -> str:
        source = self.source
        group = group or source.recording_id
        return source.split or split_of(source.recording_id, group, self.manifest, load_protocol().splits)


@dataclass(frozen=True)
class WindowsJob:
    """Reads and cuts one recording and writes its part, unless that part is there already."""

    protocol: PredictionProtocol
    stop_on_error: bool
    work: Path

    def __call__(self, source: WindowSource) -> CutRecording:
        """Make the part of one recording."""
        try:
            digest = "" if source.skip_reason is not None else source.input_digest()
        except (OSError, InputFileError) as error:
            # No digest exists of what cannot be read; the part is tried again by the next build.
            return self._write(source, "unreadable", *self._failed(source, error))
        folder = self._folder(source, digest)
        entries = parts.read_receipt(folder)
        if entries is not None:
            receipt = msgspec.convert(entries, WindowsReceipt)
            if receipt.status != "failed":  # a failure may have passed: try again
                return CutRecording(source.recording_id, receipt, folder, reused=True)
        return self._write(source, digest, *self._cut(source))

    def if_full(self, source: WindowSource, error: PrbenchError) -> CutRecording:
        """Make the part of a recording for which the memory does not suffice: it is not read, and says why."""
        return self._write(source, source.input_digest(), *self._failed(source, error))

    def _cut(self, source: WindowSource) -> tuple[Status, str, tuple[CutRun, ...]]:
        if source.skip_reason is not None:
            return "skipped", source.skip_reason, ()
        try:
            return "read", "", tuple(source.cut(self.protocol))
        except Exception as error:
            if is_out_of_memory(error):
                raise  # the engine tries again when nothing else is done beside it
            # Whatever one recording does, the others go on; its message reaches the user with the build's report.
            return self._failed(source, error)

    def _failed(self, source: WindowSource, error: Exception) -> tuple[Status, str, tuple[CutRun, ...]]:
        known = isinstance(error, PrbenchError)
        if self.stop_on_error:
            if known:
                raise error
            raise PrbenchError(f"{source.recording_id}: unexpected {type(error).__name__}: {quoted(error)}") from error
        message = quoted(error) if known else f"unexpected {type(error).__name__}: {quoted(error)}"
        return "failed", source.without_places(message), ()

    def _folder(self, source: WindowSource, input_digest: str) -> Path:
        settings = text_digest(self.protocol.digest, source.settings)
        return parts.part_folder(self.work, source.recording_id, input_digest, settings)

    def _write(
        self, source: WindowSource, digest: str, status: Status, message: str, runs: tuple[CutRun, ...]
    ) -> CutRecording:
        receipt = WindowsReceipt(
            input_digest=digest,
            status=status,
            message=message,
            pose_sources=tuple(sorted({each.run.pose_source for each in runs})),
        )
        folder = self._folder(source, digest)
        write_cut_runs(folder, runs, joint_set(source.joint_set), parts.plain(receipt))
        return CutRecording(source.recording_id, receipt, folder, reused=False)


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
    # Provenance of a build as far as it is known before any recording was read.
    protocol = load_prediction_protocol()
    synthetic = dataset.startswith(SYNTHETIC_PREFIX)
    rules = protocol.windows
    described = WindowsInfo(
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset=dataset,
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
        joint_set=joints,
        has_gaze=False,
        estimated_bodies=False,
        participants=0,
        recordings=0,
        runs=0,
        frames=0,
    )
    # Provenance with what reading brought up.
    read = [text for each in finished if each.status == "read" for text in (each.recording_id, each.input_digest)]
    info = msgspec.structs.replace(
        described,
        input_digest=text_digest(*read),
        options=options,
        estimated_bodies=any(is_estimated(source) for each in finished for source in each.pose_sources),
        quarantine=tuple(
            QuarantinedRecording(recording_id=each.recording_id, status=each.status, message=each.message)
            for each in finished
            if each.status != "read"
        ),
    )
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
