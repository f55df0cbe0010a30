"""``dataset.json`` of an imported dataset."""

from __future__ import annotations

import prbench
from prbench.manifests import Manifest, digest_of, load_protocol
from prbench.release.inferences import Inference
from prbench.release.interpret import Interpreted
from prbench.release.terms import Terms
from prbench.release.writing import ImportedRows
from prbench.sequences.dataset_info import DatasetInfo, FunnelCounts, QuarantinedRecording
from prbench.sequences.schema import OUTCOMES, SCHEMA_VERSION
from prbench.storage import file_digest, text_digest


def describe(
    dataset: str,
    manifest: Manifest,
    terms: Terms,
    interpreted: Interpreted,
    inferences: tuple[Inference, ...],
    rows: ImportedRows,
) -> DatasetInfo:
    """Provenance of an import: every inference stands among its options; the digests are filled in by the writer."""
    protocol, n = load_protocol(), len(rows.measured)
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
    return (
        {"source": "release", "goal_frame": goal_frame, "in_hand_rule": "the release's own events"}
        | {f"release.{each.name}": each.text for each in inferences}
        | {
            f"release.field.{choice.canonical}": f"{choice.field} ({choice.certainty}: {choice.evidence})"
            for choice in interpreted.fields
        }
    )


def _input_digest(interpreted: Interpreted, rows: ImportedRows) -> str:
    """Over ``target_information.json`` and the arrays of every sequence that was taken."""
    arrays = (text for each in rows.measured for text in (str(each.candidate.index), each.digest))
    return text_digest(file_digest(interpreted.files.targets), *arrays)
