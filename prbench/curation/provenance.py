"""Describe a build in ``dataset.json`` (origin, options, counts, what was left out), and show its funnel as a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass

import msgspec

import prbench
from prbench.curation.job import PartReceipt
from prbench.curation.options import BuildOptions
from prbench.files.storage import text_digest
from prbench.protocol.manifests import BenchmarkProtocol, Manifest, digest_of
from prbench.protocol.own_protocol import OPTION
from prbench.readers import SYNTHETIC_PREFIX, described_options, reader_for
from prbench.sequences.dataset_info import DatasetInfo, FunnelCounts, QuarantinedRecording
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.sequences.sequence import OUTCOMES

_STAGES = {
    "located": ("other_wearer", "excluded_category", "no_location", "tracking_lost"),
    "primed": ("not_primed", "excluded_by_dataset", "not_published"),
    "long_enough": ("too_short", "no_body"),
    "moved_enough": ("minimum_movement",),
}
"""Outcomes that end an event at each stage, in the order of the stages."""
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


def describe(
    dataset: str,
    manifest: Manifest,
    protocol: BenchmarkProtocol,
    options: BuildOptions,
    receipts: SequenceOf[PartReceipt],
    extra_options: Mapping[str, str],
) -> DatasetInfo:
    """Provenance of a build; its two digests are filled in when the tables are written."""
    synthetic = dataset.startswith(SYNTHETIC_PREFIX)
    outcomes = Counter[str]()
    for receipt in receipts:
        outcomes.update(receipt.record.outcomes)
    statuses = Counter(receipt.record.status for receipt in receipts)
    return DatasetInfo(
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset=dataset,
        title=f"Invented recordings in the layout of {manifest.title}" if synthetic else manifest.title,
        synthetic=synthetic,
        prbench_version=prbench.__version__,
        manifest_digest=digest_of(manifest),
        input_digest=text_digest(*(text for r in receipts for text in (r.record.recording_id, r.input_digest))),
        options=_options(manifest, protocol, options) | dict(extra_options),
        counts=msgspec.structs.replace(
            funnel_counts(statuses, outcomes),
            recordings_cut_short=sum(bool(receipt.record.shortfalls) for receipt in receipts),
        ),
        outcomes={outcome: outcomes[outcome] for outcome in OUTCOMES},
        quarantine=tuple(
            QuarantinedRecording(recording_id=r.record.recording_id, status=r.record.status, message=r.record.message)
            for r in receipts
            if r.record.status != "read"
        ),
        identity_digest="",
        content_digest="",
        licence="MIT (invented by prbench, no recorded person)" if synthetic else manifest.licence,
        redistribution="yes" if synthetic else manifest.redistribution,
        homepage="" if synthetic else manifest.homepage,
        citation="" if synthetic else _citation(manifest, options),
    )


def _citation(manifest: Manifest, options: BuildOptions) -> str:
    """BibTeX of the dataset and, where they are not its own, of the body poses."""
    body = manifest.body_source(dict(options.reader).get("poses"))
    return "\n\n".join(text.strip() for text in (manifest.citation, body.citation) if text)


def funnel_counts(statuses: Mapping[str, int], outcomes: Mapping[str, int]) -> FunnelCounts:
    """Count the candidates that each stage left, from recordings by status and events by outcome."""
    events = sum(outcomes.values())
    left = events
    by_stage = {}
    for stage, ending in _STAGES.items():
        left -= sum(outcomes.get(name, 0) for name in ending)
        by_stage[stage] = left
    return FunnelCounts(
        recordings_found=sum(statuses.values()),
        recordings_read=statuses.get("read", 0),
        recordings_failed=statuses.get("failed", 0),
        recordings_skipped=statuses.get("skipped", 0),
        events=events,
        **by_stage,
        sequences=outcomes.get("sequence", 0),
    )


def _options(manifest: Manifest, protocol: BenchmarkProtocol, options: BuildOptions) -> dict[str, str]:
    chosen = {
        "recordings": options.recordings,
        "limit": "all" if options.limit is None else str(options.limit),
    }
    if options.reader:
        reader = reader_for(manifest.name, dict(options.reader))
        chosen |= {f"reader.{name}": value for name, value in described_options(reader.options).items()}
    if protocol.is_own:  # tables of prbench's own protocol keep their bytes
        chosen[OPTION] = protocol.label
    return chosen | options.curation.described(manifest, protocol)


@dataclass(frozen=True)
class FunnelRow:
    """One stage between the files and the table."""

    stage: str
    """Name of the stage, such as ``located``."""
    kept: int
    """How many recordings, events or texts passed it."""
    dropped: int
    """How many of those that came to it did not pass."""
    reason: str
    """Counts by reason for what was dropped; empty if nothing was."""


def funnel_rows(info: DatasetInfo) -> list[FunnelRow]:
    """Return one row a stage, from files found to sequences."""
    counts = info.counts
    outcomes = info.outcomes
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
    before = counts.events
    for stage, names in _STAGES.items():
        kept = getattr(counts, stage)
        reasons = "; ".join(f"{outcomes[name]} {name}: {_REASONS[name]}" for name in names if outcomes.get(name))
        rows.append(FunnelRow(stage.replace("_", " "), kept, before - kept, reasons))
        before = kept
    return [*rows, FunnelRow("sequences", counts.sequences, before - counts.sequences, "")]
