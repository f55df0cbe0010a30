"""Narrated spans as clips: each text placed on the motion, or left out with a reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from prbench.sequences.corpus import Annotation, Caption, Clip
from prbench_adapters.corpora.cutting import cut_motion
from prbench_adapters.corpora.nymeria.body import BodyMotion, MotionPiece
from prbench_adapters.corpora.nymeria.clock import ClockOffset
from prbench_adapters.corpora.nymeria.format import Narration
from prbench_adapters.corpora.sources import ClipLimits, RecordingIdentity

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
