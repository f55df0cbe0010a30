"""Build a table of windows from a dataset's native files: one recording after the other, written whole.

Source: docs/specification/motion-prediction.md#from-recordings-to-windows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import msgspec

import prbench
from prbench.curation.curate import split_of
from prbench.curation.options import BuildOptions
from prbench.curation.sources import NativeSource, native_sources
from prbench.curation.window_runs import runs_of_recording, runs_of_tracks, window_starts
from prbench.engine import Engine, InProcess
from prbench.errors import InputFileError, PrbenchError, UsageError
from prbench.locks import sole_writer
from prbench.manifests import Manifest, digest_of, load_manifest, load_protocol
from prbench.prediction.protocol import PredictionProtocol, load_prediction_protocol
from prbench.prediction.table import SCHEMA_VERSION, CutRun, WindowsInfo, write_windows
from prbench.readers import SYNTHETIC_PREFIX, PublishedForPrediction, reader_for
from prbench.recording.pose_origin import is_estimated
from prbench.sequences.dataset_info import QuarantinedRecording
from prbench.shown import quoted
from prbench.storage import text_digest

JointChoice = Literal["native", "smpl22"]
"""``native``: joints that a study scored, where the reader gives them; ``smpl22``: the 22 joints of every dataset."""
_IN_PROCESS = InProcess()


@dataclass(frozen=True)
class CutRecording:
    """The runs of one recording, or the reason why there are none."""

    recording_id: str
    status: Literal["read", "failed", "skipped"]
    message: str
    runs: tuple[CutRun, ...] = ()


@dataclass(frozen=True)
class WindowsReport:
    """The result of a build."""

    folder: Path
    info: WindowsInfo
    recordings: tuple[CutRecording, ...]
    """Every recording that was found, without its runs."""


@dataclass
class _Cutter:
    """Reads one recording and cuts it; picklable, so that an engine can do it in other processes."""

    manifest: Manifest
    protocol: PredictionProtocol
    native: bool
    stop_on_error: bool

    def __call__(self, source: NativeSource) -> CutRecording:
        if source.skip_reason is not None:
            return CutRecording(source.recording_id, "skipped", source.skip_reason)
        try:
            return CutRecording(source.recording_id, "read", "", tuple(self._runs(source)))
        except PrbenchError as error:
            if self.stop_on_error:
                raise
            return CutRecording(source.recording_id, "failed", source.without_places(quoted(error)))

    def _runs(self, source: NativeSource) -> Iterator[CutRun]:
        rules = self.protocol.windows
        reader = reader_for(source.dataset, dict(source.reader_options))
        if isinstance(reader, PublishedForPrediction):
            # Its tracks know which samples were measured; the recording holds and interpolates, also from later ones.
            recording, tracks = reader.read_published(source.found)
            if not self.native:
                tracks = tuple(replace(track, joints=track.body) for track in tracks)
            published = self.protocol.published_splits.get(source.dataset)
            yield from runs_of_tracks(
                recording,
                tracks,
                rules,
                split=self._split(source, recording.split_group),
                published_split="" if published is None else published.of(source.recording_id),
            )
            return
        recording = reader.read(source.found)
        yield from runs_of_recording(recording, rules, split=self._split(source, recording.split_group))

    def _split(self, source: NativeSource, group: str) -> str:
        group = group or source.recording_id
        return source.split or split_of(source.recording_id, group, self.manifest, load_protocol().splits)


@dataclass
class _Reported:
    recordings: list[CutRecording] = field(default_factory=list)
    sources: set[str] = field(default_factory=set)


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
    out = Path(out).expanduser().absolute()
    options = BuildOptions(recordings=recordings, limit=limit, reader=reader, on_error=on_error)
    sources = native_sources(dataset, root, options)
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
    protocol = load_prediction_protocol()
    cutter = _Cutter(manifest, protocol, native, on_error == "fail")
    seen = _Reported()

    def cut() -> Iterator[CutRun]:
        for done, each in enumerate(engine.map(cutter, sources), start=1):
            seen.recordings.append(CutRecording(each.recording_id, each.status, each.message))
            seen.sources |= {run.run.pose_source for run in each.runs}
            yield from each.runs
            if progress is not None:
                progress(done, len(sources), each.recording_id)

    info = _described(name, manifest, protocol, joint_set=published if published is not None and native else "smpl22")
    chosen = {"joints": "native" if native else "smpl22", "recordings": recordings, "limit": str(limit or "all")}
    chosen |= {f"reader.{key}": value for key, value in reader}
    with sole_writer(out):
        info = write_windows(out, info, cut(), finish=lambda now: _finished(now, seen, sources, chosen))
    return WindowsReport(out, info, tuple(seen.recordings))


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


def _finished(
    info: WindowsInfo, seen: _Reported, sources: tuple[NativeSource, ...], options: dict[str, str]
) -> WindowsInfo:
    """Provenance with what reading brought up."""
    read = {each.recording_id for each in seen.recordings if each.status == "read"}
    parts = [text for each in sources if each.recording_id in read for text in (each.recording_id, each.input_digest())]
    return msgspec.structs.replace(
        info,
        input_digest=text_digest(*parts),
        options=options,
        estimated_bodies=any(map(is_estimated, seen.sources)),
        quarantine=tuple(
            QuarantinedRecording(recording_id=each.recording_id, status=each.status, message=each.message)
            for each in seen.recordings
            if each.status != "read"
        ),
    )
