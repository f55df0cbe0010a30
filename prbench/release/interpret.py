"""Interpret the JSON and the headers of the arrays: fields, sequences, frame rate, base of the primed frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from prbench.errors import InputFileError
from prbench.files.boundary import foreign_input
from prbench.release.candidates import Found, find_candidates
from prbench.release.entries import Entries, read_entries
from prbench.release.fields import choose_fields
from prbench.release.known import SYNTHETIC_PREFIX, KnownDataset, load_known
from prbench.release.layout import DatasetFiles, list_files
from prbench.release.rates import FrameRateEvidence, PrimedFrames, infer_frame_rate, read_primed_frames
from prbench.release.report import FieldChoice, Inference
from prbench.release.values import parse_number


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Statements of a user about a release."""

    fps: float | None = None
    """Frame rate; inferred if None."""
    field_map: Mapping[str, str] = field(default_factory=dict)
    """Field of the release by canonical name, where the choice by name and value is wrong."""
    first_frame_is_previous: bool = False
    """Frame 0 of every motion is the frame before the sequence."""
    on_error: Literal["skip", "fail"] = "skip"
    """Leave out sequences (and datasets) that cannot be read, or fail at the first."""
    replace: bool = False
    """Replace a table that holds recordings which the new one lacks (:mod:`prbench.sequences.replacing`)."""


@dataclass(frozen=True)
class Interpreted:
    """A dataset before its arrays are read: the meaning of its fields, and its sequences."""

    entries: Entries
    files: DatasetFiles
    fields: tuple[FieldChoice, ...]
    found: Found
    fps: float
    primed: PrimedFrames
    inferences: tuple[Inference, ...]
    known: KnownDataset | None

    @property
    def mapping(self) -> dict[str, str]:
        """Field of the release by canonical name."""
        return {choice.canonical: choice.field for choice in self.fields}

    @property
    def unmapped(self) -> tuple[str, ...]:
        """Fields that stand for no canonical one."""
        taken = set(self.mapping.values())
        return tuple(name for name in self.entries.field_names if name not in taken)


@foreign_input()
def interpret(dataset: str, folder: Path, options: ImportOptions) -> Interpreted:
    """Infer everything that the JSON and the headers tell.

    Raises:
        InputFileError: if a file is missing or damaged, no field fits, no sequence is whole, or nothing tells the rate.
        UsageError: if the user names a field that does not exist.
    """
    files = list_files(folder, dataset)
    entries = read_entries(files.targets)
    fields = choose_fields(str(files.targets), entries.field_names, entries.values, options.field_map)
    mapping = {choice.canonical: choice.field for choice in fields}
    found = find_candidates(entries, files, mapping)
    require_some(found, files)
    known = load_known().datasets.get(dataset.removeprefix(SYNTHETIC_PREFIX))
    primed = read_primed_frames(_primes(found), _lengths(found))
    fps, rate = _frame_rate(found, mapping, primed, known, options, files)
    _check_lengths(found, mapping)
    return Interpreted(entries, files, fields, found, fps, primed, (rate, primed.inference), known)


def _frame_rate(
    found: Found,
    mapping: Mapping[str, str],
    primed: PrimedFrames,
    known: KnownDataset | None,
    options: ImportOptions,
    files: DatasetFiles,
) -> tuple[float, Inference]:
    durations = _field_values(found, mapping, "duration")
    evidence = FrameRateEvidence(
        n_frames=_lengths(found),
        primed=_primes(found),
        stated=_field_values(found, mapping, "fps"),
        # Durations are compared with the lengths row by row, so they count only where all have one.
        durations=durations if len(durations) == len(found.candidates) else None,
        known=known,
    )
    rate, inference = infer_frame_rate(evidence, primed)
    if options.fps is not None:
        said = f"given by --fps; the data say {inference.text}"
        return options.fps, Inference("fps", f"{options.fps:g}", "certain", said)
    if rate is None:
        raise InputFileError(
            files.folder,
            "frame rate",
            expected="signs that agree on one rate",
            found=inference.evidence,
            remedy="Say what it is: --fps N",
        )
    return rate, inference


def _field_values(found: Found, mapping: Mapping[str, str], canonical: str) -> np.ndarray:
    if canonical not in mapping:
        return np.empty(0)
    values = [parse_number(candidate.entry.fields.get(mapping[canonical])) for candidate in found.candidates]
    return np.array([value for value in values if value is not None], dtype=np.float64)


def _check_lengths(found: Found, mapping: Mapping[str, str]) -> None:
    """Report stated lengths that differ from the arrays', which are used."""
    for canonical, expected in (("num_frames", 0), ("event_frame", -1)):
        # The event is the last frame, so its number is one less than the length.
        for candidate in found.candidates if canonical in mapping else ():
            stated = parse_number(candidate.entry.fields.get(mapping[canonical]))
            if stated is not None and stated != candidate.n_frames + expected:
                name = canonical.replace("_", " ")
                message = f"{name}: expected {candidate.n_frames + expected} for this motion, found {stated:g}"
                found.report(candidate.entry.key, message, left_out=False)


def require_some(found: Found, files: DatasetFiles) -> None:
    """Refuse a dataset without any complete sequence.

    Raises:
        InputFileError: with what is wrong with the first sequence.
    """
    if found.candidates:
        return
    key, reason = next(iter(found.left_out.items()), ("", "no sequence"))
    raise InputFileError(
        files.folder,
        f"sequence {key}" if key else "",
        expected="one complete sequence or more",
        found=f"none; of the first: {reason}",
    )


def _lengths(found: Found) -> np.ndarray:
    return np.array([candidate.n_frames for candidate in found.candidates])


def _primes(found: Found) -> np.ndarray:
    return np.array([candidate.primed for candidate in found.candidates], dtype=np.float64)
