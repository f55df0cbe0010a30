"""Cut one recording into windows and keep the result as a part: the unit of work of a build that can be resumed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import msgspec

from prbench.curation.curate import split_of
from prbench.curation.sources import NativeSource
from prbench.curation.window_runs import runs_of_recording, runs_of_tracks
from prbench.engine import is_out_of_memory
from prbench.errors import InputFileError, PrbenchError
from prbench.files.storage import text_digest
from prbench.prediction.joint_sets import SMPL22, joint_set
from prbench.prediction.protocol import PredictionProtocol
from prbench.prediction.table import CutRun
from prbench.prediction.window_parts import write_cut_runs
from prbench.protocol.manifests import Manifest, digest_of, load_protocol
from prbench.readers import PublishedForPrediction, Reader, reader_for
from prbench.sequences import parts
from prbench.shown import quoted

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
