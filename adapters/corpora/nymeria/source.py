"""Nymeria as a corpus: its recordings, and narrated spans as clips, each text placed on the motion or left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Int

from prbench.errors import InputFileError, PrbenchError, UsageError
from prbench.files.bounded import foreign_input
from prbench.files.storage import file_digest, read_json, text_digest
from prbench.protocol.manifests import Manifest, load_manifest
from prbench.randomness import hash_fraction
from prbench.readers import ReaderOptions, RecordingFiles, described_options, parse_options, require_one_origin
from prbench.readers.aria_mps.trajectory import read_near
from prbench.readers.extents import SEVERAL_SENSORS
from prbench.sequences.corpus import Annotation, Caption, Clip
from prbench_adapters.corpora.nymeria import format as nymeria
from prbench_adapters.corpora.nymeria.clock import (
    ClockOffset,
    offset_by_correlation,
    offset_by_starts,
    offset_from_file,
)
from prbench_adapters.corpora.nymeria.files import (
    METADATA,
    OFFSET,
    SMPL,
    SUIT,
    TRAJECTORY,
    find_sequences,
    read_narrations,
)
from prbench_adapters.corpora.nymeria.format import Narration, NymeriaRecording
from prbench_adapters.corpora.nymeria.suit import (
    BodyMotion,
    CleanSuit,
    MotionPiece,
    clean_suit,
    read_smpl_fit,
    read_suit,
    smpl_motion,
    suit_motion,
)
from prbench_adapters.corpora.sources import (
    ClipLimits,
    CorpusOptions,
    Cost,
    ReadRecording,
    RecordingIdentity,
    cut_motion,
    without_folders,
)

_ROUNDING = 1e-6


@dataclass(frozen=True)
class _Span:
    """The texts of one kind for one stretch of time."""

    kind: str
    start: float
    end: float
    rows: tuple[Narration, ...]


@dataclass(frozen=True)
class _Fit:
    """The place of a span in a piece of the motion, or the reason why it has none."""

    outcome: str
    value: float | None = None
    threshold: float | None = None
    piece: MotionPiece | None = None
    first: int = 0
    n_frames: int = 0
    cut: bool = False


def clips_of(
    identity: RecordingIdentity,
    body: BodyMotion,
    narrations: Sequence[Narration],
    offset: ClockOffset | None,
    limits: ClipLimits,
    thresholds: Mapping[str, float],
) -> tuple[tuple[Clip, ...], tuple[Annotation, ...]]:
    """Clips of one recording, and what became of every text.

    Texts of one kind for exactly the same span (several annotators, several answers) share a clip.

    Args:
        identity: Whose clips they are.
        body: The motion.
        narrations: Any order.
        offset: From text to motion clock; None where none was found.
        limits: Lengths of clips.
        thresholds: Of the manifest.
    """
    clips = []
    annotations = []
    for span in _spans(narrations):
        name = f"{identity.dataset}/{identity.recording_id}/{span.kind}/{_micros(span.start)}-{_micros(span.end)}"
        sequence_id = f"{name}/{body.pose_source}"
        captions, outcomes = _captions(span)
        fit = _Fit("no_text")
        if captions:
            fit = _fit(span, body.pieces, offset, limits, thresholds["smallest_coverage"])
        if fit.outcome == "clip" and offset is not None and fit.piece is not None:
            clip = _clip(sequence_id, identity, body, span, captions, offset, fit, limits.fps)
            fit = fit if clip is not None else _Fit("no_heading")
            clips += [] if clip is None else [clip]
        for number, (kind, text, outcome) in enumerate(outcomes):
            decided = fit if outcome == "clip" else _Fit(outcome)
            annotations.append(
                Annotation(
                    annotation_id=f"{name}/{number}",
                    recording_id=identity.recording_id,
                    sequence_id=sequence_id if decided.outcome == "clip" else None,
                    kind=kind,
                    text=text,
                    text_start=span.start,
                    text_end=span.end,
                    outcome=decided.outcome,
                    value=decided.value,
                    threshold=decided.threshold,
                )
            )
    return tuple(clips), tuple(annotations)


def _micros(seconds: float) -> int:
    return round(seconds * 1e6)


def _spans(narrations: Sequence[Narration]) -> list[_Span]:
    """Group narrations by kind and time; the order of rows in the file leaves no trace."""
    groups: dict[tuple[str, int, int], list[Narration]] = {}
    for row in narrations:
        groups.setdefault((row.kind, _micros(row.start), _micros(row.end)), []).append(row)
    spans = []
    for (kind, _, _), rows in sorted(groups.items()):
        ordered = sorted(rows, key=lambda row: (row.annotator, row.texts))
        spans.append(_Span(kind, ordered[0].start, ordered[0].end, tuple(ordered)))
    return spans


def _captions(span: _Span) -> tuple[tuple[Caption, ...], list[tuple[str, str, str]]]:
    """Texts of a span without empty and repeated ones; and (kind, text, outcome) of each."""
    captions: list[Caption] = []
    outcomes = []
    for row in span.rows:
        for answer, text in row.texts:
            kind = span.kind if len(row.texts) == 1 else answer
            caption = Caption(text, kind)
            if not text:
                outcome = "no_text"
            elif caption in captions:
                outcome = "duplicate"
            else:
                outcome = "clip"
                captions.append(caption)
            outcomes.append((kind, text, outcome))
    return tuple(captions), outcomes


def _fit(
    span: _Span, pieces: Sequence[MotionPiece], offset: ClockOffset | None, limits: ClipLimits, coverage: float
) -> _Fit:
    if offset is None:
        return _Fit("no_clock")
    length = span.end - span.start
    if length <= 0.0:
        return _Fit("end_before_start", length, 0.0)
    if length * limits.fps < limits.shortest - _ROUNDING:
        return _Fit("too_short", length, limits.shortest / limits.fps)
    start = span.start + offset.seconds
    end = span.end + offset.seconds
    placed = [_place(piece, start, end, limits.fps) for piece in pieces]
    number = int(np.argmax([n_frames for _, n_frames in placed]))
    (first, n_frames), piece = placed[number], pieces[number]
    share = n_frames / limits.fps / length
    # Frames are counted whole, so that a span may lose up to one of them.
    if share < coverage - 1.0 / limits.fps / length:
        within = min(p.start for p in pieces) <= start and end <= max(_end(p) for p in pieces)
        return _Fit("clock_gap" if within else "outside_motion", round(share, 6), coverage)
    if n_frames < limits.shortest:
        return _Fit("too_short", n_frames / limits.fps, limits.shortest / limits.fps)
    kept = min(n_frames, limits.longest)
    return _Fit("clip", None, None, piece, first, kept, cut=kept < n_frames)


def _end(piece: MotionPiece) -> float:
    return piece.start + (len(piece.joints) - 1) / piece.rate


def _place(piece: MotionPiece, start: float, end: float, fps: float) -> tuple[int, int]:
    """First native frame and number of corpus frames of the part of a span that a piece covers."""
    stride = round(piece.rate / fps)
    first = max(int(np.ceil((start - piece.start) * piece.rate - _ROUNDING)), 0)
    wanted = int(np.floor((end - max(start, piece.start)) * fps + _ROUNDING))
    available = (len(piece.joints) - 1 - first) // stride + 1
    return first, max(min(wanted, available), 0)


def _clip(
    sequence_id: str,
    identity: RecordingIdentity,
    body: BodyMotion,
    span: _Span,
    captions: tuple[Caption, ...],
    offset: ClockOffset,
    fit: _Fit,
    fps: float,
) -> Clip | None:
    piece = fit.piece
    assert piece is not None  # only spans that fit become clips
    try:
        motion = cut_motion(piece.joints, fit.first, round(piece.rate / fps), fit.n_frames)
    except ValueError:
        return None
    start = piece.start + fit.first / piece.rate
    return Clip(
        sequence_id=sequence_id,
        **vars(identity),
        kind=span.kind,
        captions=captions,
        fps=fps,
        n_frames=fit.n_frames,
        start_time=start,
        end_time=start + fit.n_frames / fps,
        text_start=span.start,
        text_end=span.end,
        cut=fit.cut,
        mirrored=False,
        clock_method=offset.method,
        clock_offset=offset.seconds,
        clock_quality=offset.quality,
        approximate=offset.approximate,
        pose_source=body.pose_source,
        head_tilt_deg=body.head_tilt_deg,
        **vars(motion),
        extra={"annotators": " ".join(sorted({row.annotator for row in span.rows if row.annotator}))}
        if any(row.annotator for row in span.rows)
        else {},
    )


_BYTES_A_SECOND = 50e6
_TABLE_SHARE = 0.06
_NO_GAZE = np.empty(0, dtype=np.int64)
__all__ = ["CORPUS", "NymeriaOptions", "NymeriaRecording", "NymeriaSource", "recording_clips"]


class NymeriaOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Choices about Nymeria."""

    mapping: str = "anatomical"
    """Mapping of suit segments to joints: ``anatomical``, or one of the manifest's other mappings (``named``)."""
    body: Literal["xsens", "smpl"] = "xsens"
    """The suit, or the fit of the Plus release (needs ``smpl_model``)."""
    smpl_model: Path | None = None
    """The user's SMPL neutral model as ``.npz``."""
    kinds: str = "atomic_action,motion_narration"
    """Kinds of texts that become clips."""
    start_alignment: bool = True
    """True if texts may be placed by aligning starts where nothing better works; such clips are marked."""

    @property
    def chosen_kinds(self) -> tuple[str, ...]:
        """Kinds of text, in the order of the manifest."""
        given = tuple(kind.strip() for kind in self.kinds.split(","))
        unknown = [kind for kind in given if kind not in nymeria.NARRATION_FILES]
        if unknown:
            known = ", ".join(nymeria.NARRATION_FILES)
            raise UsageError(f"unknown kind of text '{unknown[0]}'; known ones are: {known}.")
        return tuple(kind for kind in nymeria.NARRATION_FILES if kind in given)

    def joint_mapping(self, manifest: Manifest) -> tuple[str, ...]:
        """Segment of each joint."""
        mappings = {"anatomical": manifest.body.joint_mapping, **manifest.body.other_mappings}
        if self.mapping not in mappings:
            raise UsageError(f"unknown mapping '{self.mapping}'; known ones are: {', '.join(mappings)}.")
        return mappings[self.mapping]


@dataclass(frozen=True)
class NymeriaSource:
    """One sequence (see :class:`prbench_adapters.corpora.sources.CorpusRecording`)."""

    root: Path
    found: RecordingFiles
    identity: RecordingIdentity
    skip_reason: str | None
    options: NymeriaOptions
    limits: ClipLimits

    @property
    def cost(self) -> Cost:
        """Estimate from the bytes of all input files."""
        size = sum(file.size for file in self.found.files)
        return Cost(size, size / _BYTES_A_SECOND, size * _TABLE_SHARE)

    @foreign_input()
    def input_digest(self) -> str:
        """Roles, names and contents of the files."""
        files = self.found.files
        return text_digest(
            self.found.recording_id, *(text for f in files for text in (f.role, f.path.name, file_digest(f.path)))
        )

    def without_places(self, message: str) -> str:
        """A message without the folders of this machine."""
        return without_folders(message, self.root)

    @foreign_input()
    def read(self) -> ReadRecording:
        """Read motion and texts, bring them onto one clock, and cut clips.

        Raises:
            InputFileError: if a file does not hold what its format promises.
        """
        narrations = self._narrations()
        path = self.found.require(SUIT, f"body/{nymeria.SUIT_FILE}")
        clean = clean_suit(read_suit(path), self._manifest.thresholds, path=path)
        offset, messages = self._offset(clean, narrations)
        read = recording_clips(
            self.identity, self.body(clean), narrations, offset, self.limits, self._manifest.thresholds
        )
        message = "; ".join(part for part in (*self._without_texts(narrations), *messages, read.message) if part)
        return replace(read, message=self.without_places(message))

    @cached_property
    def _manifest(self) -> Manifest:
        return load_manifest("nymeria")

    def _narrations(self) -> tuple[Narration, ...]:
        kinds = [kind for kind in self.options.chosen_kinds if self.found.path(kind) is not None]
        return tuple(row for kind in kinds for row in read_narrations(self.found.require(kind, kind), kind))

    def _without_texts(self, narrations: tuple[Narration, ...]) -> tuple[str, ...]:
        """Name the files of chosen kinds that are absent or hold no text; without any, the clock's message says so."""
        if not narrations:
            return ()
        held = {narration.kind for narration in narrations}
        lacking = [nymeria.NARRATION_FILES[kind] for kind in self.options.chosen_kinds if kind not in held]
        return (f"no text in {' and '.join(lacking)}, or no such file",) if lacking else ()

    def body(self, clean: CleanSuit) -> BodyMotion:
        """The 22 joints by the way that the options name."""
        manifest = self._manifest
        thresholds = self._manifest.thresholds
        if self.options.body == "xsens":
            name = manifest.body.pose_source
            return suit_motion(
                clean,
                self.options.joint_mapping(manifest),
                name if self.options.mapping == "anatomical" else f"{name}-{self.options.mapping}",
                manifest.body.head_tilt_deg,
                thresholds,
                path=self.found.require(SUIT, nymeria.SUIT_FILE),
            )
        assert self.options.smpl_model is not None  # checked before anything is read
        path = self.found.require(SMPL, f"body/{nymeria.SMPL_FILE}")
        pieces = read_smpl_fit(
            path,
            self.options.smpl_model.expanduser(),
            tolerance=thresholds["clock_tolerance"],
            shortest=thresholds["shortest_piece"],
        )
        other = manifest.other_bodies["smpl"]
        return smpl_motion(pieces, other.pose_source, other.head_tilt_deg)

    def _offset(
        self, clean: CleanSuit, narrations: tuple[Narration, ...]
    ) -> tuple[ClockOffset | None, tuple[str, ...]]:
        """The first way that works, and why the others did not."""
        if not narrations:
            return None, ("no texts of the chosen kinds",)
        path = self.found.path(OFFSET)
        if path is not None and (offset := offset_from_file(path, self.found.recording_id)) is not None:
            return offset, ()
        thresholds = self._manifest.thresholds
        messages = []
        path = self.found.path(TRAJECTORY)
        if path is not None:
            try:
                trajectory = read_near(path, _NO_GAZE, thresholds["correlation_rate"])
                offset, why = offset_by_correlation(clean, trajectory.time_us, trajectory.rotation, thresholds)
                if offset is not None:
                    return offset, _cut_short(path, trajectory.time_us, clean, offset)
            except InputFileError as error:  # texts may still be placed by their starts
                why = str(error)
            messages.append(why)
        if not self.options.start_alignment:
            return None, (*messages, "no way to the suit's clock, and start alignment is switched off")
        offset, why = offset_by_starts(narrations, clean, thresholds)
        return offset, tuple(part for part in (*messages, why) if part)


def recording_clips(
    identity: RecordingIdentity,
    body: BodyMotion,
    narrations: tuple[Narration, ...],
    offset: ClockOffset | None,
    limits: ClipLimits,
    thresholds: dict[str, float],
) -> ReadRecording:
    """Clips and the fate of every text; used for files and for recordings that were never written."""
    clips, annotations = clips_of(identity, body, narrations, offset, limits, thresholds)
    duration = sum(len(piece.joints) / piece.rate for piece in body.pieces)
    return ReadRecording(
        clips,
        annotations,
        duration,
        clock_method="none" if offset is None else offset.method,
        clock_quality=None if offset is None else offset.quality,
        message="; ".join(body.messages),
        measured=body.measured + (() if offset is None else (("clock_offset_s", f"{offset.seconds:.6f}"),)),
    )


class NymeriaCorpus:
    """See :class:`prbench_adapters.corpora.sources.Corpus`."""

    @property
    def manifest(self) -> Manifest:
        """Nymeria's manifest."""
        return load_manifest("nymeria")

    def described(self, options: CorpusOptions) -> dict[str, str]:
        """Rate, lengths, and the options of :class:`NymeriaOptions`."""
        chosen = self._options(options)
        limits = ClipLimits.of(options, self.manifest.thresholds)
        return {
            "fps": f"{limits.fps:g}",
            "max_frames": str(limits.longest),
            **{f"reader.{name}": text for name, text in described_options(chosen).items()},
        }

    @foreign_input()
    def find(self, root: Path | None, options: CorpusOptions) -> tuple[NymeriaSource, ...]:
        """Find all sequences below a folder."""
        if root is None:
            raise UsageError("--root DIR is needed: your copy of Nymeria.")
        chosen = self._options(options)
        limits = ClipLimits.of(options, self.manifest.thresholds)
        sources = []
        for found in find_sequences(root):
            name = found.recording_id
            dataset = found.dataset
            participant = _participant(found)
            split = found.split or split_by_participant(self.manifest, participant)
            identity = RecordingIdentity(dataset, name, participant, split, participant)
            sources.append(NymeriaSource(root, found, identity, self.manifest.why_bad(name), chosen, limits))
        require_one_origin(root, (source.identity.dataset for source in sources))
        return tuple(sources)

    def group_of(self, recording_id: str) -> str:
        """Every sequence is worked on alone."""
        return recording_id

    def _options(self, options: CorpusOptions) -> NymeriaOptions:
        chosen = parse_options(NymeriaOptions, dict(options.source), dataset="nymeria")
        _ = chosen.chosen_kinds, chosen.joint_mapping(self.manifest)
        if (nymeria.SUIT_RATE / options.rate) % 1.0 > 1e-9:
            raise UsageError(f"--fps must divide the suit's 240 Hz (20, 24, 30, 40 …), found {options.rate:g}.")
        if chosen.body == "smpl" and chosen.smpl_model is None:
            raise UsageError("body=smpl needs --option smpl_model=FILE: your SMPL neutral model as .npz.")
        return chosen


def _participant(found: RecordingFiles) -> str:
    """The wearer's invented name: from the sequence's name, else from the metadata where they tell it.

    The name comes first because every copy has it: a copy without metadata must not move anybody to another split.
    """
    if nymeria.SEQUENCE_NAME.fullmatch(found.recording_id):
        return nymeria.participant_of(found.recording_id)
    path = found.path(METADATA)
    if path is not None:
        try:
            metadata = read_json(path)
        except PrbenchError:
            metadata = None  # optional file: the sequence's name tells the same
        if isinstance(metadata, dict) and isinstance(metadata.get("fake_name"), str) and metadata["fake_name"]:
            return metadata["fake_name"]
    return nymeria.participant_of(found.recording_id)


def split_by_participant(manifest: Manifest, participant_id: str) -> Literal["train", "validation", "test"]:
    """The manifest's shares of sha256(dataset/participant) / 2**256."""
    fraction = hash_fraction(manifest.name, participant_id)
    if fraction >= manifest.thresholds["test_from"]:
        return "test"
    return "validation" if fraction < manifest.thresholds["validation_below"] else "train"


def _cut_short(path: Path, time_us: Int[np.ndarray, " n"], clean: CleanSuit, offset: ClockOffset) -> tuple[str, ...]:
    """Say by how much the glasses' trajectory ends before the suit does: what follows was not used for the clock."""
    missing = clean.span[1] - offset.seconds - time_us[-1] * 1e-6
    if missing <= SEVERAL_SENSORS:
        return ()
    return (f"{path.name} ends {missing:.1f} s before the suit does; it may be cut off",)


CORPUS = NymeriaCorpus()
