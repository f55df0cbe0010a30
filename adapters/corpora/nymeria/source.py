"""Nymeria as a corpus: its recordings, and narrated spans as clips, each text placed on the motion or left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import foreign_input
from prbench.files.storage import file_digest, text_digest
from prbench.limits import HARMLESS_SIZE, LARGEST_UNPACKED
from prbench.protocol.manifests import Manifest, load_manifest
from prbench.randomness import hash_fraction
from prbench.readers import ReaderOptions, RecordingFiles, require_one_origin
from prbench.readers.extents import SEVERAL_SENSORS
from prbench.sequences.corpus import Annotation, Caption
from prbench_adapters.corpora import sources as corpora
from prbench_adapters.corpora.nymeria import clock as clocks
from prbench_adapters.corpora.nymeria import format as nymeria
from prbench_adapters.corpora.nymeria.clock import ClockOffset
from prbench_adapters.corpora.nymeria.devices import device_stream
from prbench_adapters.corpora.nymeria.files import OFFSET, SUIT, TRAJECTORY, find_sequences, read_narrations
from prbench_adapters.corpora.nymeria.format import SUIT_RATE, Narration
from prbench_adapters.corpora.nymeria.suit import CleanSuit, Piece, clean_suit, read_suit

_ROUNDING = 1e-6


def recording_clips(
    identity: corpora.RecordingIdentity,
    body: CleanSuit,
    narrations: Sequence[Narration],
    offset: ClockOffset | None,
    limits: corpora.ClipLimits,
) -> corpora.ReadRecording:
    """Clips of one recording, and what became of every text; for files and for recordings that were never written.

    Texts of one kind for exactly the same span (several annotators, several answers) share a clip.

    Args:
        identity: Whose clips they are.
        body: The motion.
        narrations: Any order.
        offset: The offset from the text's clock to the motion's; None where none was found.
        limits: Lengths of clips.
    """
    coverage = load_manifest("nymeria").thresholds["smallest_coverage"]  # of a span, by one piece of the motion
    # Narrations by kind and time; the order of rows in the file leaves no trace.
    spans: dict[tuple[str, int, int], list[Narration]] = {}
    for row in narrations:
        spans.setdefault((row.kind, round(row.start * 1e6), round(row.end * 1e6)), []).append(row)
    clips = []
    annotations = []
    for (kind, start_us, end_us), rows in sorted(spans.items()):
        rows.sort(key=lambda row: (row.annotator, row.texts))
        name = f"{identity.dataset}/{identity.recording_id}/{kind}/{start_us}-{end_us}"
        sequence_id = f"{name}/{body.pose_source}"
        # Texts of the span without empty and repeated ones; and (kind, text, outcome) of each.
        captions: list[Caption] = []
        texts = []
        for row in rows:
            for answer, text in row.texts:
                caption = Caption(text, kind if len(row.texts) == 1 else answer)
                own = "no_text"
                if text:
                    own = "duplicate" if caption in captions else "clip"
                if own == "clip":
                    captions.append(caption)
                texts.append((caption, own))
        outcome, value, threshold, place = "no_text", None, None, None
        if captions:
            outcome, value, threshold, place = _placed(rows[0], body.pieces, offset, limits, coverage)
        if place is not None and offset is not None:
            piece, first, n_frames = place
            annotators = " ".join(sorted({row.annotator for row in rows if row.annotator}))
            clip = corpora.cut_clip(
                piece.joints,
                first,
                round(SUIT_RATE / limits.fps),
                min(n_frames, limits.longest),
                fps=limits.fps,
                start=piece.start + first / SUIT_RATE,
                sequence_id=sequence_id,
                **vars(identity),
                kind=kind,
                captions=tuple(captions),
                text_start=rows[0].start,
                text_end=rows[0].end,
                cut=n_frames > limits.longest,
                mirrored=False,
                clock_method=offset.method,
                clock_offset=offset.seconds,
                clock_quality=offset.quality,
                approximate=offset.method == "start_alignment",
                pose_source=body.pose_source,
                head_tilt_deg=body.head_tilt_deg,
                extra={"annotators": annotators} if annotators else {},
            )
            if clip is None:
                outcome = "no_heading"
            else:
                clips.append(clip)
        for number, (caption, own) in enumerate(texts):
            decided = outcome if own == "clip" else own
            whose = (f"{name}/{number}", identity.recording_id, sequence_id if decided == "clip" else None)
            described = (caption.kind, caption.text, rows[0].start, rows[0].end, decided)
            decisive = (value, threshold) if own == "clip" else (None, None)
            annotations.append(Annotation(*whose, *described, *decisive))
    found = (tuple(clips), tuple(annotations), sum(len(piece.joints) / SUIT_RATE for piece in body.pieces))
    message = "; ".join(body.messages)
    if offset is None:
        return corpora.ReadRecording(*found, "none", None, message)
    measured = (("clock_offset_s", f"{offset.seconds:.6f}"),)
    return corpora.ReadRecording(*found, offset.method, offset.quality, message, measured)


def _placed(
    span: Narration, pieces: Sequence[Piece], offset: ClockOffset | None, limits: corpora.ClipLimits, coverage: float
) -> tuple[str, float | None, float | None, tuple[Piece, int, int] | None]:
    """Return what becomes of a span: outcome, deciding number, threshold, and its place in the motion if it has one.

    The place is a piece, the native frame on which the clip begins, and the frames of the corpus that are there.
    """
    if offset is None:
        return "no_clock", None, None, None
    length = span.end - span.start
    if length <= 0.0:
        return "end_before_start", length, 0.0, None
    if length * limits.fps < limits.shortest - _ROUNDING:
        return "too_short", length, limits.shortest / limits.fps, None
    start = span.start + offset.seconds
    end = span.end + offset.seconds
    stride = round(SUIT_RATE / limits.fps)
    places = []
    for piece in pieces:
        first = max(int(np.ceil((start - piece.start) * SUIT_RATE - _ROUNDING)), 0)
        wanted = int(np.floor((end - max(start, piece.start)) * limits.fps + _ROUNDING))
        places.append((piece, first, max(min(wanted, (len(piece.joints) - 1 - first) // stride + 1), 0)))
    place = max(places, key=lambda place: place[2])
    share = place[2] / limits.fps / length
    # Frames are counted whole, so that a span may lose up to one of them.
    if share < coverage - 1.0 / limits.fps / length:
        within = min(piece.start for piece in pieces) <= start and end <= max(piece.end for piece in pieces)
        return "clock_gap" if within else "outside_motion", round(share, 6), coverage, None
    if place[2] < limits.shortest:
        return "too_short", place[2] / limits.fps, limits.shortest / limits.fps, None
    return "clip", None, None, place


class NymeriaOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Choices about Nymeria.

    Attributes:
        kinds: Kinds of texts that become clips.
    """

    kinds: str = "atomic_action,motion_narration"

    @property
    def chosen_kinds(self) -> tuple[str, ...]:
        """Kinds of text, in the order of the manifest.

        Raises:
            UsageError: for an unknown one.
        """
        given = tuple(kind.strip() for kind in self.kinds.split(","))
        unknown = [kind for kind in given if kind not in nymeria.NARRATION_FILES]
        if unknown:
            known = ", ".join(nymeria.NARRATION_FILES)
            raise UsageError(f"unknown kind of text '{unknown[0]}'; known ones are: {known}.")
        return tuple(kind for kind in nymeria.NARRATION_FILES if kind in given)


@dataclass(frozen=True)
class NymeriaSource(corpora.CorpusRecording):
    """One sequence."""

    found: RecordingFiles
    options: NymeriaOptions
    bytes_a_second = 50e6
    table_share = 0.06

    @property
    def input_bytes(self) -> int:
        """Bytes of all input files."""
        return sum(file.size for file in self.found.files)

    @foreign_input()
    def input_digest(self) -> str:
        """Roles, names and contents of the files."""
        parts = [self.found.recording_id]
        for file in self.found.files:
            largest = HARMLESS_SIZE if file.role in nymeria.NARRATION_FILES else LARGEST_UNPACKED
            parts += (file.role, file.path.name, file_digest(file.path, largest=largest))
        return text_digest(*parts)

    @foreign_input()
    def suit(self) -> CleanSuit:
        """Return the suit, and its motion on the 22 joints.

        Raises:
            InputFileError: if the file does not hold what its format promises.
        """
        path = self.found.require(SUIT, f"body/{nymeria.SUIT_FILE}")
        return clean_suit(read_suit(path), load_manifest("nymeria"), path=path)

    @foreign_input()
    def read(self) -> corpora.ReadRecording:
        """Read motion and texts, bring them onto one clock, and cut clips.

        Raises:
            InputFileError: if a file does not hold what its format promises.
        """
        chosen = self.options.chosen_kinds
        paths = {kind: path for kind in chosen if (path := self.found.path(kind)) is not None}
        narrations = tuple(row for kind, path in paths.items() for row in read_narrations(path, kind))
        body = self.suit()
        offset, messages = self._offset(body, narrations)
        # Files of chosen kinds that are absent or hold no text; without any text, the clock's message says so.
        held = {narration.kind for narration in narrations}
        lacking = [nymeria.NARRATION_FILES[kind] for kind in chosen if kind not in held]
        if narrations and lacking:
            messages.insert(0, f"no text in {' and '.join(lacking)}, or no such file")
        read = recording_clips(self.identity, body, narrations, offset, self.limits)
        return replace(read, message=self.without_places("; ".join(filter(None, (*messages, read.message)))))

    def _offset(self, clean: CleanSuit, narrations: tuple[Narration, ...]) -> tuple[ClockOffset | None, list[str]]:
        """Return the first way that works, and why the others did not."""
        if not narrations:
            return None, ["no texts of the chosen kinds"]
        path = self.found.path(OFFSET)
        if path is not None and (offset := clocks.offset_from_file(path, self.found.recording_id)) is not None:
            return offset, []
        thresholds = load_manifest("nymeria").thresholds
        messages = []
        path = self.found.path(TRAJECTORY)
        if path is not None:
            try:
                glasses = device_stream(path)
                offset, why = clocks.offset_by_correlation(clean, glasses, thresholds)
                if offset is not None:
                    # Where the trajectory ends before the suit does, what follows was not used for the clock.
                    missing = clean.span[1] - offset.seconds - glasses.times[-1]
                    cut = f"{path.name} ends {missing:.1f} s before the suit does; it may be cut off"
                    return offset, [cut] if missing > SEVERAL_SENSORS else []
            except InputFileError as error:  # texts may still be placed by their starts
                why = str(error)
            messages.append(why)
        offset, why = clocks.offset_by_starts(narrations, clean, thresholds)
        return offset, [*messages, why]


class NymeriaCorpus(corpora.Corpus):
    """See :class:`prbench_adapters.corpora.sources.Corpus`."""

    name = "nymeria"
    options = NymeriaOptions
    native_rate = SUIT_RATE
    rates = "a rate must divide the suit's 240 Hz (20, 24, 30, 40 …)"

    def chosen(self, options: corpora.CorpusOptions) -> NymeriaOptions:
        """See :class:`prbench_adapters.corpora.sources.Corpus`."""
        chosen = super().chosen(options)
        _ = chosen.chosen_kinds  # refuses an unknown kind before anything is read
        return chosen

    @foreign_input()
    def find(self, root: Path | None, options: corpora.CorpusOptions) -> tuple[NymeriaSource, ...]:
        """Find all sequences below a folder."""
        if root is None:
            raise UsageError("--root DIR is needed: your copy of Nymeria.")
        chosen = self.chosen(options)
        limits = self.limits(options)
        manifest = load_manifest(self.name)
        sources = []
        for found in find_sequences(root):
            participant = nymeria.participant_of(found.recording_id)
            split = found.split or split_by_participant(manifest, participant)
            identity = corpora.RecordingIdentity(found.dataset, found.recording_id, participant, split, participant)
            sources.append(NymeriaSource(identity, limits, root, manifest.why_bad(found.recording_id), found, chosen))
        require_one_origin(root, (source.identity.dataset for source in sources))
        return tuple(sources)


def split_by_participant(manifest: Manifest, participant_id: str) -> Literal["train", "validation", "test"]:
    """Return the manifest's shares of sha256(dataset/participant) / 2**256."""
    fraction = hash_fraction(manifest.name, participant_id)
    if fraction >= manifest.thresholds["test_from"]:
        return "test"
    return "validation" if fraction < manifest.thresholds["validation_below"] else "train"


CORPUS = NymeriaCorpus()
