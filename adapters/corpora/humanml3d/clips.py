"""Captioned parts of a motion as clips: each caption placed, or left out with a reason."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from prbench.protocol.manifests import Manifest
from prbench.sequences.corpus import Annotation, Caption, Clip
from prbench_adapters.corpora.cutting import cut_motion
from prbench_adapters.corpora.humanml3d import files as layout
from prbench_adapters.corpora.humanml3d.files import TextLine
from prbench_adapters.corpora.sources import ClipLimits, RecordingIdentity

_WHOLE = "caption"
_PART = "sub_caption"


def clips_of(
    identity: RecordingIdentity,
    joints: Float[np.ndarray, "frames 22 3"],
    lines: Sequence[TextLine],
    limits: ClipLimits,
    manifest: Manifest,
) -> tuple[tuple[Clip, ...], tuple[Annotation, ...]]:
    """Clips of one motion, and what became of every caption.

    Captions of the same part of the motion share a clip; parts are cut at 20 frames a second as the official loader
    does, ``motion[int(from * 20) : int(to * 20)]``.

    Args:
        identity: Whose clips they are.
        joints: Of the whole motion, metres, Y up.
        lines: Captions in file order.
        limits: Lengths of clips.
        manifest: Of the dataset.
    """
    clips = []
    annotations = []
    for (start, end), members in _by_span(lines, len(joints) / layout.RATE).items():
        kind = _WHOLE if members[0][1].is_whole else _PART
        name = f"{identity.dataset}/{identity.recording_id}/{kind}/{round(start * 1e6)}-{round(end * 1e6)}"
        sequence_id = f"{name}/{manifest.body.pose_source}"
        captions = tuple(dict.fromkeys(Caption(line.text, kind, line.tokens) for _, line in members if line.text))
        first = int(start * layout.RATE)
        available = min(int(end * layout.RATE), len(joints)) - first
        outcome, value, threshold = _fate(captions, start, end, available, limits)
        if outcome == "clip":
            n_frames = min(available, limits.longest)
            clip = _clip(sequence_id, identity, kind, captions, joints, first, n_frames, (start, end), limits, manifest)
            outcome = "no_heading" if clip is None else "clip"
            clips += [] if clip is None else [clip]
        seen: set[str] = set()
        for number, line in members:
            if not line.text:
                own = "no_text"
            elif line.text in seen:
                own = "duplicate"
            else:
                own = outcome
            seen.add(line.text)
            decided = own == outcome
            annotations.append(
                Annotation(
                    annotation_id=f"{identity.dataset}/{identity.recording_id}/{number}",
                    recording_id=identity.recording_id,
                    sequence_id=sequence_id if own == "clip" else None,
                    kind=kind,
                    text=line.text,
                    text_start=start,
                    text_end=end,
                    outcome=own,
                    value=value if decided else None,
                    threshold=threshold if decided else None,
                )
            )
    return tuple(clips), tuple(annotations)


def _by_span(lines: Sequence[TextLine], duration: float) -> dict[tuple[float, float], list[tuple[int, TextLine]]]:
    """Lines of one span together, whole motions first."""
    spans: dict[tuple[float, float], list[tuple[int, TextLine]]] = {}
    for number, line in sorted(enumerate(lines, start=1), key=lambda item: (not item[1].is_whole, item[0])):
        spans.setdefault((0.0, duration) if line.is_whole else (line.start, line.end), []).append((number, line))
    return spans


def _fate(
    captions: tuple[Caption, ...], start: float, end: float, available: int, limits: ClipLimits
) -> tuple[str, float | None, float | None]:
    if not captions:
        return "no_text", None, None
    if end <= start:
        return "end_before_start", end - start, 0.0
    if available <= 0 or start < 0.0:
        return "outside_motion", float(available) / limits.fps, 0.0
    if available < limits.shortest:
        return "too_short", available / limits.fps, limits.shortest / limits.fps
    return "clip", None, None


def _clip(
    sequence_id: str,
    identity: RecordingIdentity,
    kind: str,
    captions: tuple[Caption, ...],
    joints: np.ndarray,
    first: int,
    n_frames: int,
    span: tuple[float, float],
    limits: ClipLimits,
    manifest: Manifest,
) -> Clip | None:
    try:
        motion = cut_motion(joints, first, 1, n_frames)
    except ValueError:
        return None
    start = first / layout.RATE
    return Clip(
        sequence_id=sequence_id,
        **vars(identity),
        kind=kind,
        captions=captions,
        fps=limits.fps,
        n_frames=n_frames,
        start_time=start,
        end_time=start + n_frames / limits.fps,
        text_start=span[0],
        text_end=span[1],
        # Cut only where a whole frame more was described; less than one is lost by rounding down.
        cut=span[1] * layout.RATE - first >= n_frames + 1,
        mirrored=identity.recording_id.startswith(layout.MIRROR_PREFIX),
        clock_method="same",
        clock_offset=0.0,
        clock_quality=None,
        approximate=False,
        pose_source=manifest.body.pose_source,
        head_tilt_deg=manifest.body.head_tilt_deg,
        **vars(motion),
    )
