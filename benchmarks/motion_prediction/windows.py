"""Recordings as runs of frames at the windows' rate, and the windows in them.

Source: docs/specification/motion-prediction.md#from-recordings-to-windows. Nothing that a predictor sees is made from a
sample later than its frame, except body frames in gaps (no window's observation ends in one) and bodies whose
rate is no multiple of the windows' rate. Recordings are kept as parts (:mod:`prbench.sequences.parts`) until the table
stands, so that a build can be resumed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from prbench.curation.job import NativeSource, PartReceipt, RecordingJob, native_sources, part_receipt, provenance_of
from prbench.curation.mending import Numbers
from prbench.curation.options import BuildOptions
from prbench.curation.splits import draw_splits
from prbench.curation.stream_checks import sound
from prbench.engine import IN_PROCESS, Engine
from prbench.engine.shards import Shard, ShardRecord, require_settings
from prbench.errors import UsageError
from prbench.files.bounded import require
from prbench.files.storage import require_replaceable, sole_writer, text_digest
from prbench.geometry.skeleton import head_forward
from prbench.geometry.timelines import covered, interpolate, nearest_index
from prbench.protocol.manifests import Manifest, digest_of, load_manifest, load_protocol
from prbench.readers import PublishedForPrediction, Reader, reader_for
from prbench.recording import BodyStream, PublishedTrack, Recording
from prbench.sequences import parts
from prbench.sequences.sequence import Recording as RecordingRow
from prbench.sequences.sequence import row_batch
from prbench_benchmarks.motion_prediction import table
from prbench_benchmarks.motion_prediction.joint_sets import SMPL22, joint_set
from prbench_benchmarks.motion_prediction.protocol import PredictionProtocol, WindowRules, load_prediction_protocol

# ``native``: joints that a study scored, where the reader gives them; ``smpl22``: the 22 joints of every dataset.
JointChoice = Literal["native", "smpl22"]
OnError = Literal["skip", "fail"]
Filled = Bool[np.ndarray, " n"]
# Called after each recording with how many are done, of how many, and its id.
Progress = Callable[[int, int, str], None] | None
_ROUNDING = 1e-6  # seconds
# Share by which a rate may differ from a multiple of the windows' rate: 29.97 is 30, EgoAllo's 30.3 is not.
_RATE_TOLERANCE = 0.005


def runs_of_recording(recording: Recording, rules: WindowRules, *, split: str) -> Iterator[table.Run]:
    """Return runs of the 22 joints, cut where the body is missing for longer than the largest gap.

    Args:
        recording: The recording; one without a body yields nothing.
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
    # First frame and end of every stretch of frames with a body.
    steps = np.flatnonzero(np.diff(np.concatenate(([False], posed, [False])).astype(np.int8)))
    for number, (first, stop) in enumerate(steps.reshape(-1, 2).tolist()):
        if stop - first <= rules.length:
            continue
        part = slice(first, stop)
        # What was seen before the run began may be held into it: it lies in the past, too.
        frames = (joints[part], posed[part], looks[part], looking[part], directions[part])
        yield _run(recording, str(number), rules, filled[part], (split, ""), float(times[first]), *frames)


def runs_of_tracks(
    recording: Recording, tracks: tuple[PublishedTrack, ...], rules: WindowRules, *, split: str, published_split: str
) -> Iterator[table.Run]:
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
        splits = (split, track.published_split or published_split)
        frames = (track.joints, track.valid, looks, looking, directions)
        yield _run(recording, track.name, rules, track.filled, splits, float(track.times[0]), *frames)


def _run(
    recording: Recording, segment: str, rules: WindowRules, filled: Filled, splits: tuple[str, str], *frames: Any
) -> table.Run:
    """Return a run with its windows; ``frames`` are the fields of :class:`table.Run` from its start time on."""
    who = (recording.recording_id, recording.participant_id)
    run = table.Run(f"{who[0]}/{segment}", *who, *splits, segment, recording.pose_source, rules.fps, *frames)
    return replace(run, windows=sliding_windows(run, filled, rules))


def window_starts(n_frames: int, rules: WindowRules) -> Int[np.ndarray, " n"]:
    """Return starts 0, stride, 2 stride, … below ``n_frames`` minus a window's length, which is excluded itself."""
    return np.arange(0, max(n_frames - rules.length, 0), rules.stride)


def sliding_windows(run: table.Run, filled: Filled, rules: WindowRules) -> tuple[table.Window, ...]:
    """Every window of a run; those that must not be scored say why.

    Args:
        run: The frames.
        filled: Frames that were interpolated across a gap, and so tell of a later one.
        rules: Lengths.
    """
    windows = []
    for start in window_starts(run.n_frames, rules).tolist():
        border = start + rules.observed_frames
        exclusion = ""
        if not run.joints_valid[start : start + rules.length].all():
            exclusion = "invalid_body"
        elif filled[border - 1]:
            exclusion = "gap_at_border"
        windows.append(table.Window(start, int(run.gaze_valid[start:border].sum()), rules.future_frames, exclusion))
    return tuple(windows)


def latest_gaze(
    times: Float[np.ndarray, " m"],
    directions: Float[np.ndarray, "m 3"],
    valid: Bool[np.ndarray, " m"],
    frames: Float[np.ndarray, " n"],
    *,
    oldest: float,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Return the last valid sample not later than each frame; interpolation would read the future of a window.

    Args:
        times: Times of the samples, seconds.
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


@dataclass(frozen=True)
class NativeWindows:
    """A recording of a reader's dataset that can be cut into windows; picklable, so that other processes can do it.

    Attributes:
        native: Whether the joints are those of the study.
        shift: Seconds that are added to the times of streams (:mod:`prbench.curation.mending`).
        scale: Factors on the positions of streams.
    """

    source: NativeSource
    manifest: Manifest
    native: bool
    shift: Numbers = ()
    scale: Numbers = ()

    @property
    def recording_id(self) -> str:
        """Unique within the build."""
        return self.source.recording_id

    @property
    def skip_reason(self) -> str | None:
        """Why it is left out; None if it is not."""
        return self.source.skip_reason

    @property
    def split(self) -> str | None:
        """None: a recording that is left out belongs to no split."""
        return None

    @property
    def joint_set(self) -> str:
        """Name of the joints of its runs."""
        reader = self._reader
        return reader.native_joints if self.native and isinstance(reader, PublishedForPrediction) else SMPL22.name

    @property
    def settings(self) -> str:
        """Digest of everything but the files and the protocol that decides what comes out."""
        mending = repr((self.shift, self.scale))
        return text_digest(digest_of(self.manifest), load_protocol().digest, self.joint_set, mending)

    def input_digest(self) -> str:
        """Digest of its files."""
        return self.source.input_digest()

    def without_places(self, message: str) -> str:
        """Return a message without the folders of this machine."""
        return self.source.without_places(message)

    def cut(self, protocol: PredictionProtocol) -> tuple[RecordingRow, Iterator[table.Run]]:
        """Read it, examine its streams, and cut it; what decides its split and what was noticed stand in the row.

        Raises:
            PrbenchError: if it cannot be read, or a stream is certainly wrong.
        """
        source = self.source
        reader = self._reader
        tracks: tuple[PublishedTrack, ...] | None = None
        if isinstance(reader, PublishedForPrediction):
            # Its tracks know which samples were measured; the recording holds and interpolates, also from later ones.
            recording, tracks = reader.read_published(source.found, native=self.native)
        else:
            recording = reader.read(source.found)
        recording, findings = sound(recording, self.shift, self.scale, unused=("hands", "objects"))
        row = row_of(recording, source.split or "", recording.split_group)
        row = replace(row, findings=findings, message="; ".join(findings))
        if tracks is None:
            return row, runs_of_recording(recording, protocol.windows, split=row.split)
        published = protocol.published_splits.get(source.dataset)
        published_split = "" if published is None else published.of(source.recording_id)
        rules = protocol.windows
        return row, runs_of_tracks(recording, tracks, rules, split=row.split, published_split=published_split)

    @property
    def _reader(self) -> Reader:
        return reader_for(self.source.dataset, dict(self.source.reader_options))


def row_of(recording: Recording, split: str, split_group: str) -> RecordingRow:
    """Return what decides the split of a recording that was read.

    Args:
        recording: The recording.
        split: Its own split; empty where the build draws it.
        split_group: Shared by recordings that must not be separated; empty for the recording's own id.
    """
    name = recording.recording_id
    duration = recording.span[1] - recording.span[0]
    return RecordingRow(name, recording.participant_id, split, split_group or name, duration, {}, "read", "")


def read_cut_runs(folder: Path) -> Iterator[table.Run]:
    """Read the runs of one part in their order."""
    windows: dict[int, list[table.Window]] = {}
    for batch in parts.read_batches([folder], "windows"):
        for row in batch.to_pylist():
            windows.setdefault(row["row"], []).append(table.Window.of(row))
    rows = (batch.slice(row, 1) for batch in parts.read_batches([folder], "streams") for row in range(batch.num_rows))
    for number, row in enumerate(rows):
        yield replace(table.run_of(row), windows=tuple(windows.get(number, ())))


@dataclass(frozen=True)
class WindowsJob(RecordingJob):
    """Reads and cuts one recording, :class:`NativeWindows` or the like."""

    protocol: PredictionProtocol

    def settings(self, source: Any) -> str:
        """See :class:`RecordingJob`."""
        return text_digest(self.protocol.digest, source.settings)

    def make(self, source: Any) -> tuple[RecordingRow, dict[str, pa.RecordBatch]]:
        """See :class:`RecordingJob`."""
        record, runs = source.cut(self.protocol)
        return record, _tables(source, tuple(runs))

    def nothing(self, source: Any, record: RecordingRow) -> dict[str, pa.RecordBatch]:  # noqa: ARG002
        """See :class:`RecordingJob`."""
        return _tables(source, ())


def _tables(source: Any, runs: tuple[table.Run, ...]) -> dict[str, pa.RecordBatch]:
    windows = [window.row(run, row) for row, run in enumerate(runs) for window in run.windows]
    return {
        "streams": row_batch(runs, table.streams_schema(joint_set(source.joint_set))),
        "windows": pa.RecordBatch.from_pylist(windows, schema=table.WINDOWS),
    }


@dataclass(frozen=True)
class WindowsPlan:
    """Recordings of one dataset with one joint set, and what stands in the description of their table.

    Attributes:
        dataset: Name that the table bears.
        sources: One recording or more in table order; each is :class:`NativeWindows` or has its properties and methods.
    """

    dataset: str
    sources: tuple[Any, ...]
    options: dict[str, str]

    @property
    def settings(self) -> dict[str, Any]:
        """Return what decides a table beside its recordings, as JSON knows it."""
        return _settings(self.dataset, self.sources[0].joint_set, self.options)


def _settings(dataset: str, joints: str, options: dict[str, str]) -> dict[str, Any]:
    manifest = digest_of(load_manifest(dataset))
    protocol = load_prediction_protocol().digest
    return {"dataset": dataset, "joint_set": joints, "options": options, "manifest": manifest, "protocol": protocol}


def plan_windows(
    dataset: str,
    root: Path | str,
    *,
    joints: JointChoice | None = None,
    recordings: str = "*",
    limit: int | None = None,
    reader: tuple[tuple[str, str], ...] = (),
    shift: Numbers = (),
    scale: Numbers = (),
) -> WindowsPlan:
    """Find the recordings of a dataset's native files that are to be cut.

    Args:
        dataset: Name of the reader.
        root: The dataset's folder, or one recording of it.
        joints: ``native`` (default where the dataset was published for prediction) or ``smpl22``.
        recordings: Glob of recordings.
        limit: Largest number of recordings.
        reader: Options of the reader.
        shift: Seconds that are added to the times of streams; one that is named is vouched for.
        scale: Factors on the positions of streams.

    Raises:
        UsageError: for an unknown dataset or option, and for published segments that shall be moved.
        InputFileError: if there is nothing to read, or ``native`` is asked of a dataset that nobody published.
    """
    sources = native_sources(dataset, root, BuildOptions(recordings=recordings, limit=limit, reader=reader))
    name = sources[0].dataset
    manifest = load_manifest(name)
    published = isinstance(reader_for(name, dict(reader)), PublishedForPrediction)
    expected = "a dataset with joints of its own that a study of prediction published"
    remedy = "Leave the option out: every dataset has the 22 joints."
    require(root, (published or joints != "native", "", expected, name, remedy))
    if published and any(number != 0 for _, number in shift) | any(number != 1 for _, number in scale):
        said = f"the segments of {name} are read as they were published, which nothing moves or scales"
        raise UsageError(f"--shift, --scale: {said}. Correct the files; --shift STREAM=0 vouches for a stream.")
    native = published and joints != "smpl22"
    chosen = {"joints": "native" if native else "smpl22", "recordings": recordings, "limit": str(limit or "all")}
    chosen |= {f"reader.{key}": value for key, value in reader}
    for option, numbers in (("shift", shift), ("scale", scale)):
        chosen |= {f"{option}.{stream}": f"{number:g}" for stream, number in numbers}
    cut = (NativeWindows(source, manifest, native, shift, scale) for source in sources)
    return WindowsPlan(name, tuple(cut), chosen)


def build_windows(
    plan: WindowsPlan,
    out: Path | str,
    *,
    on_error: OnError = "skip",
    engine: Engine = IN_PROCESS,
    progress: Progress = None,
) -> parts.BuildReport[table.WindowsInfo, RecordingRow]:
    """Build a table of windows.

    Args:
        plan: What to read, of :func:`plan_windows`.
        out: Folder of the table; an earlier table of windows there is replaced when everything is ready.
        on_error: Leave out recordings that cannot be read, or stop at the first.
        engine: Runs the work, in this process or in several.
        progress: See :data:`Progress`.

    Raises:
        TableError: if no recording yields a window.
        StorageError: if ``out`` cannot be written or holds something else.
    """
    out = Path(out).expanduser().absolute()
    require_replaceable(out, table.FILE_NAME, kind="table of windows")
    with sole_writer(out), parts.working_in_parts(out):
        job = WindowsJob(on_error == "fail", parts.work_folder(out), load_prediction_protocol())
        return _write_table(plan.settings, job.make_all(plan.sources, engine, progress), out)


def build_windows_shard(
    plan: WindowsPlan, out: Path, shard: Shard, *, on_error: OnError, engine: Engine, progress: Progress
) -> parts.ShardReport[RecordingRow]:
    """Make one shard of a build, for :func:`merge_windows_shards`; goes on where it was interrupted.

    Args:
        plan: The plan of the whole build.
        out: Folder of the shard.
        shard: Which one it is.
        on_error: See :func:`build_windows`.
        engine: See :func:`build_windows`.
        progress: See :func:`build_windows`.

    Raises:
        ShardError: if ``out`` holds another shard.
    """
    out = out.expanduser().absolute()
    record = ShardRecord.of("windows", shard, plan.settings, (source.recording_id for source in plan.sources))
    mine = [plan.sources[place] for place in shard.places(len(plan.sources))]
    with parts.making_shard(out, record) as work:
        finished = WindowsJob(on_error == "fail", work, load_prediction_protocol()).make_all(mine, engine, progress)
        parts.finish_shard(out, record, [each.folder for each in finished])
    reused = sum(each.reused for each in finished)
    return parts.ShardReport(out, shard, len(plan.sources), tuple(each.record for each in finished), reused)


def merge_windows_shards(
    shards: Sequence[tuple[Path, ShardRecord]], out: Path
) -> parts.BuildReport[table.WindowsInfo, RecordingRow]:
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
    kinds = {"dataset": str, "joint_set": str, "options": dict[str, str]}
    now = _settings(*(record.setting(folder, kind, name) for name, kind in kinds.items()))
    require_settings(folder, record, now)
    out = out.expanduser().absolute()
    require_replaceable(out, table.FILE_NAME, kind="table of windows")
    with sole_writer(out):
        finished = [part_receipt(part, entries, reused=False) for part, entries in parts.shard_parts(shards)]
        return _write_table(now, finished, out)


def _write_table(
    settings: dict[str, Any], finished: list[PartReceipt], out: Path
) -> parts.BuildReport[table.WindowsInfo, RecordingRow]:
    """Write the table of all parts of a build."""
    dataset = settings["dataset"]
    manifest = load_manifest(dataset)
    protocol = load_prediction_protocol()
    records = [each.record for each in finished]
    read = [each for each in finished if each.record.status == "read"]
    about = provenance_of(dataset, protocol, finished, read)
    if not about["synthetic"]:
        about["citation"] = manifest.citation  # not stripped: earlier tables keep their bytes
    rules = ("fps", "observed_frames", "future_frames", "fewest_gaze_frames")
    info = table.WindowsInfo(
        **about,
        **{name: getattr(protocol.windows, name) for name in rules},
        **{name: settings[name] for name in ("options", "joint_set")},
        schema_version=table.SCHEMA_VERSION,
        outcomes={},
    )
    # Last of all: until here an earlier table stands as it was.
    splits = draw_splits(records, manifest, load_protocol().splits)
    runs = (run for each in finished for run in read_cut_runs(each.folder))
    info = table.write_windows(out, info, (replace(run, split=splits[run.recording_id]) for run in runs))
    return parts.BuildReport(out, info, tuple(records), sum(each.reused for each in finished))
