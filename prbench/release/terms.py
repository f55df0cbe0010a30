"""Under which terms an imported table stands: those of the study's release and those of the dataset behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prbench.manifests import Manifest, load_citations
from prbench.release.known import SYNTHETIC_PREFIX
from prbench.release.layout import EXPORT_RECORD
from prbench.sequences.redistribution import strictest
from prbench.storage import read_json

_STUDY_TERMS = "Prime and Reach release (its page states no licence known to prbench; ask its authors)"
_STUDY_REDISTRIBUTION = "non-commercial"
"""Assumed of the study's own contribution, for want of a statement: the terms that most of its datasets have."""


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
    """What our own exporter left in a dataset's folder, or None.

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
    if exported is not None:
        stated = exported.get("redistribution", manifest.redistribution)
        return Terms(
            title=manifest.title,
            licence=manifest.licence,
            redistribution=strictest([manifest.redistribution, str(stated)]),
            homepage=manifest.homepage,
            citation=manifest.citation.strip(),
            synthetic=False,
        )
    return Terms(
        title=f"{manifest.title}, as released with Prime and Reach",
        licence=f"{manifest.licence} (source recordings); {_STUDY_TERMS}",
        redistribution=strictest([manifest.redistribution, _STUDY_REDISTRIBUTION]),
        homepage=manifest.homepage,
        citation=f"{load_citations().study.strip()}\n\n{manifest.citation.strip()}",
        synthetic=False,
    )
