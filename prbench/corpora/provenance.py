"""What ``corpus.json`` says about a build: origin, options, counts, and what was left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import prbench
from prbench.corpora.job import GroupReceipt
from prbench.corpora.options import CorpusOptions
from prbench.manifests import Manifest, digest_of, load_protocol
from prbench.readers import SYNTHETIC_PREFIX
from prbench.sequences.corpus import ANNOTATION_OUTCOMES, CORPUS_SCHEMA_VERSION
from prbench.sequences.dataset_info import CorpusCounts, CorpusInfo, QuarantinedRecording
from prbench.storage import text_digest


def describe(
    dataset: str,
    manifest: Manifest | None,
    described: Mapping[str, str],
    options: CorpusOptions,
    receipts: Sequence[GroupReceipt],
) -> CorpusInfo:
    """Provenance of a build; its two digests are filled in when the tables are written."""
    synthetic = dataset.startswith(SYNTHETIC_PREFIX)
    protocol = load_protocol()
    outcomes = Counter[str]()
    for receipt in receipts:
        for record in receipt.records:
            outcomes.update(record.outcomes)
    real = None if synthetic else manifest
    return CorpusInfo(
        schema_version=CORPUS_SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset=dataset,
        title=_title(manifest, synthetic=synthetic),
        synthetic=synthetic,
        prbench_version=prbench.__version__,
        manifest_digest="" if manifest is None else digest_of(manifest),
        input_digest=text_digest(*(text for receipt in receipts for text in (receipt.name, receipt.input_digest))),
        options={
            "recordings": options.recordings,
            "limit": "all" if options.limit is None else str(options.limit),
            **described,
        },
        counts=_counts(receipts, outcomes),
        outcomes={outcome: outcomes[outcome] for outcome in ANNOTATION_OUTCOMES},
        quarantine=tuple(
            QuarantinedRecording(recording_id=record.recording_id, status=record.status, message=record.message)
            for receipt in receipts
            for record in receipt.records
            if record.status != "read"
        ),
        identity_digest="",
        content_digest="",
        licence="MIT (invented by prbench, no recorded person)" if real is None else real.licence,
        redistribution="yes" if real is None else real.redistribution,
        homepage="" if real is None else real.homepage,
        citation="" if real is None else real.citation.strip(),
    )


def _title(manifest: Manifest | None, *, synthetic: bool) -> str:
    if manifest is None:
        return "Invented people and what they do"
    return f"Invented recordings in the layout of {manifest.title}" if synthetic else manifest.title


def _counts(receipts: Sequence[GroupReceipt], outcomes: Counter[str]) -> CorpusCounts:
    statuses = Counter(record.status for receipt in receipts for record in receipt.records)
    return CorpusCounts(
        recordings_found=sum(statuses.values()),
        recordings_read=statuses["read"],
        recordings_failed=statuses["failed"],
        recordings_skipped=statuses["skipped"],
        annotations=sum(outcomes.values()),
        clips=sum(receipt.clips for receipt in receipts),
        captions=sum(receipt.captions for receipt in receipts),
        approximate_clips=sum(receipt.approximate_clips for receipt in receipts),
        frames=sum(receipt.frames for receipt in receipts),
    )
