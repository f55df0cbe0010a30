"""Terms of an imported table and its ``dataset.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import prbench
from prbench.manifests import Manifest, digest_of, load_citations, load_protocol
from prbench.release.interpret import Interpreted
from prbench.release.known import SYNTHETIC_PREFIX
from prbench.release.layout import EXPORT_RECORD
from prbench.release.report import Inference
from prbench.release.writing import ImportedRows
from prbench.sequences.dataset_info import DatasetInfo, FunnelCounts, QuarantinedRecording
from prbench.sequences.redistribution import strictest
from prbench.sequences.schema import OUTCOMES, SCHEMA_VERSION
from prbench.storage import file_digest, read_json, text_digest

_STUDY_TERMS = "Prime and Reach release (its page states no licence known to prbench; ask its authors)"
_STUDY_REDISTRIBUTION = "non-commercial"
"""Our assumption, since the study states no terms of its own contribution: the terms of most of its datasets."""


@dataclass(frozen=True)
class Terms:
    """Title, licence, redistribution, homepage and citation, as ``dataset.json`` has them."""

    title: str
    licence: str
    redistribution: str
    homepage: str
    citation: str
    synthetic: bool


def read_export_record(folder: Path) -> dict[str, Any] | None:
    """Read the record that our own exporter left in a dataset's folder, or None.

    Raises:
        InputFileError: if it is no JSON.
    """
    if not (folder / EXPORT_RECORD).is_file():
        return None
    record = read_json(folder / EXPORT_RECORD)
    return record if isinstance(record, dict) else None


def terms_of(dataset: str, manifest: Manifest, exported: Mapping[str, Any] | None) -> Terms:
    """The terms of an imported dataset.

    Data that our exporter wrote are no part of the study's release; what its record says can make terms stricter than
    the manifest's, never looser.
    """
    if dataset.startswith(SYNTHETIC_PREFIX):
        return Terms(
            title=f"Invented recordings in the layout of {manifest.title}",
            licence="MIT (invented by prbench, no recorded person)",
            redistribution="yes",
            homepage="",
            citation="",
            synthetic=True,
        )
    source = Terms(
        title=manifest.title,
        licence=manifest.licence,
        redistribution=manifest.redistribution,
        homepage=manifest.homepage,
        citation=manifest.citation.strip(),
        synthetic=False,
    )
    if exported is not None:
        stated = str(exported.get("redistribution", source.redistribution))
        return replace(source, redistribution=strictest([source.redistribution, stated]))
    return replace(
        source,
        title=f"{source.title}, as released with Prime and Reach",
        licence=f"{source.licence} (source recordings); {_STUDY_TERMS}",
        redistribution=strictest([source.redistribution, _STUDY_REDISTRIBUTION]),
        citation=f"{load_citations().study.strip()}\n\n{source.citation}",
    )


def describe(
    dataset: str,
    manifest: Manifest,
    terms: Terms,
    interpreted: Interpreted,
    inferences: tuple[Inference, ...],
    rows: ImportedRows,
) -> DatasetInfo:
    """Describe an import: every inference stands among its options; the writer fills in the digests."""
    protocol = load_protocol()
    n = len(rows.measured)
    failed = [record for record in rows.records if record.status == "failed"]
    return DatasetInfo(
        schema_version=SCHEMA_VERSION,
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        dataset=dataset,
        title=terms.title,
        synthetic=terms.synthetic,
        prbench_version=prbench.__version__,
        manifest_digest=digest_of(manifest),
        input_digest=_input_digest(interpreted, rows),
        options=_options(interpreted, inferences),
        counts=FunnelCounts(
            recordings_found=len(rows.records),
            recordings_read=len(rows.records) - len(failed),
            recordings_failed=len(failed),
            recordings_skipped=0,
            events=n,
            located=n,
            primed=n,
            long_enough=n,
            moved_enough=n,
            sequences=n,
        ),
        outcomes={outcome: n if outcome == "sequence" else 0 for outcome in OUTCOMES},
        quarantine=tuple(
            QuarantinedRecording(recording_id=record.recording_id, status=record.status, message=record.message)
            for record in failed
        ),
        identity_digest="",
        content_digest="",
        licence=terms.licence,
        redistribution=terms.redistribution,
        homepage=terms.homepage,
        citation=terms.citation,
    )


def _options(interpreted: Interpreted, inferences: tuple[Inference, ...]) -> dict[str, str]:
    goal_frame = next(each.value for each in inferences if each.name == "goal_frame")
    options = {"source": "release", "goal_frame": goal_frame, "in_hand_rule": "the release's own events"}
    options |= {f"release.{each.name}": each.text for each in inferences}
    for choice in interpreted.fields:
        options[f"release.field.{choice.canonical}"] = f"{choice.field} ({choice.certainty}: {choice.evidence})"
    return options


def _input_digest(interpreted: Interpreted, rows: ImportedRows) -> str:
    """Return the digest of ``target_information.json`` and of the arrays of every imported sequence."""
    arrays = []
    for each in rows.measured:
        arrays += [str(each.candidate.index), each.digest]
    return text_digest(file_digest(interpreted.files.targets), *arrays)
