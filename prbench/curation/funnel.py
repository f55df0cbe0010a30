"""The funnel of a build as rows of a table: what each stage took, what it left, and why."""

from __future__ import annotations

from dataclasses import dataclass

from prbench.sequences.dataset_info import DatasetInfo

_REASONS = {
    "other_wearer": "somebody else's hand was nearer",
    "excluded_category": "doors, drawers and the like",
    "no_location": "never came to rest, or no place annotated",
    "tracking_lost": "object not tracked around the event",
    "not_primed": "gaze never met the place in the window before",
    "excluded_by_dataset": "never tested by the dataset itself",
    "not_published": "the dataset publishes nothing about it",
    "too_short": "recording or body does not cover the sequence",
    "no_body": "no body poses",
    "minimum_movement": "started beside the goal",
}


@dataclass(frozen=True)
class FunnelRow:
    """One stage."""

    stage: str
    kept: int
    dropped: int
    reason: str
    """Counts by reason for what was dropped; empty if nothing was."""


def funnel_rows(info: DatasetInfo) -> list[FunnelRow]:
    """From files found to sequences, one row a stage."""
    counts, outcomes = info.counts, info.outcomes
    left_out = counts.recordings_failed + counts.recordings_skipped
    read_reason = f"{counts.recordings_failed} failed, {counts.recordings_skipped} skipped" if left_out else ""
    if counts.recordings_cut_short:
        cut = f"{counts.recordings_cut_short} of those that were read are cut short: events may be missing"
        read_reason = f"{read_reason}; {cut}" if read_reason else cut
    rows = [
        FunnelRow("recordings found", counts.recordings_found, 0, ""),
        FunnelRow("recordings read", counts.recordings_read, left_out, read_reason),
        FunnelRow("candidate events", counts.events, 0, ""),
    ]
    stages = (
        ("located", counts.located, ("other_wearer", "excluded_category", "no_location", "tracking_lost")),
        ("primed", counts.primed, ("not_primed", "excluded_by_dataset", "not_published")),
        ("long enough", counts.long_enough, ("too_short", "no_body")),
        ("moved enough", counts.moved_enough, ("minimum_movement",)),
    )
    before = counts.events
    for stage, kept, names in stages:
        reasons = "; ".join(f"{outcomes[name]} {name}: {_REASONS[name]}" for name in names if outcomes.get(name))
        rows.append(FunnelRow(stage, kept, before - kept, reasons))
        before = kept
    return [*rows, FunnelRow("sequences", counts.sequences, before - counts.sequences, "")]
