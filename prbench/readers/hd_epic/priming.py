"""Match the entries of HD-EPIC's priming file with events (docs/specification/hd-epic.md#annotations)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.readers.hd_epic import format as hd_epic
from prbench.recording.streams import PublishedPriming


@dataclass(frozen=True)
class MaskedEvent:
    """Facts by which an event and an entry of the priming file are matched."""

    is_start: bool
    frame: float
    """Frame of the annotated time."""
    mask_frame: int
    location: Float[np.ndarray, "3"]
    """World (Z up), metres."""


def published_priming(
    events: Sequence[MaskedEvent | None],
    entries: Sequence[hd_epic.PublishedSide],
    clock: hd_epic.VideoClock,
    thresholds: hd_epic.Thresholds,
) -> tuple[list[PublishedPriming | None], tuple[str, ...]]:
    """Return what the dataset publishes about each event, and remarks on what found no partner.

    An entry belongs to an event of the same side whose frame (annotated time or mask) is within 1 and whose location
    within 1 mm; each entry serves one event, nearest first.

    Args:
        events: In any order; None for events without location.
        entries: Of the same video.
        clock: Of the video.
        thresholds: How near is the same.
    """
    partner = _partners(events, entries, thresholds)
    result = [None if index is None else _priming(entries[index], clock) for index in partner]
    used = sum(index is not None for index in partner)
    located = sum(event is not None for event in events)
    remarks = []
    if used < len(entries):
        remarks.append(f"published priming: {len(entries) - used} of {len(entries)} entries belong to no event")
    if used < located:
        remarks.append(f"published priming: nothing about {located - used} of {located} located events")
    behind = sum(index is not None and told is None for index, told in zip(partner, result, strict=True))
    if behind:
        remarks.append(
            f"published priming: {behind} primed frames lie beyond the rows of the time file; taken as unknown"
        )
    return result, tuple(remarks)


def _partners(
    events: Sequence[MaskedEvent | None], entries: Sequence[hd_epic.PublishedSide], thresholds: hd_epic.Thresholds
) -> list[int | None]:
    """Index of the entry of each event."""
    at_frame: dict[int, list[int]] = {}
    for index, entry in enumerate(entries):
        at_frame.setdefault(entry.frame, []).append(index)
    # Nearest first: by frames, among equals by metres.
    candidates = sorted(
        (distance, number, index)
        for number, event in enumerate(events)
        if event is not None
        for frame in _frames_near(event, thresholds.same_frame)
        for index in at_frame.get(frame, ())
        if (distance := _distance(event, entries[index], thresholds)) is not None
    )
    partner: list[int | None] = [None] * len(events)
    taken: set[int] = set()
    for _, number, index in candidates:
        if partner[number] is None and index not in taken:
            partner[number] = index
            taken.add(index)
    return partner


def _frames_near(event: MaskedEvent, reach: float) -> set[int]:
    around = (event.frame, float(event.mask_frame))
    return {frame for base in around for frame in range(math.ceil(base - reach), math.floor(base + reach) + 1)}


def _distance(
    event: MaskedEvent, entry: hd_epic.PublishedSide, thresholds: hd_epic.Thresholds
) -> tuple[float, float] | None:
    """Frames and metres between them; None if they cannot be the same."""
    if event.is_start != entry.is_start or entry.location is None:
        return None
    frames = float(min(abs(event.frame - entry.frame), abs(event.mask_frame - entry.frame)))
    if frames > thresholds.same_frame:
        return None
    metres = float(np.linalg.norm(event.location - entry.location))
    return (frames, metres) if metres <= thresholds.same_place_m else None


def _priming(entry: hd_epic.PublishedSide, clock: hd_epic.VideoClock) -> PublishedPriming | None:
    """None for a primed frame beyond the rows of the time file."""
    frame = entry.frame_primed
    if frame < 0:
        return PublishedPriming("excluded" if frame == hd_epic.EXCLUDED else "not_primed", None)
    if not clock.covers(np.array([float(frame)]))[0]:
        return None
    time = clock.device_seconds(np.array([float(frame)]))[0]
    return PublishedPriming("primed", float(time), uncertainty=1 / hd_epic.FPS)
