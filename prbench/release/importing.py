"""Import the authors' release: every property that it leaves open is inferred and written down.

Files are read three times, so that memory does not grow with the motions: headers (frame rate, base of the primed
frames), measurements (unit, frames), and conversion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from prbench.errors import InputFileError, RecordingsWouldBeLost
from prbench.files.boundary import foreign_input
from prbench.files.locks import sole_writer
from prbench.files.storage import require_replaceable
from prbench.protocol.manifests import Manifest, load_manifest, load_protocol
from prbench.release.interpret import ImportOptions, Interpreted, interpret, require_some
from prbench.release.judge import UNKNOWN, Conclusions, conclude
from prbench.release.known import SYNTHETIC_PREFIX, dataset_of
from prbench.release.layout import DatasetFiles, find_datasets
from prbench.release.report import ImportReport, Inference, count_rows, count_warnings
from prbench.release.rows import Reading
from prbench.release.survey import Measured, survey
from prbench.release.writing import ImportedRows, describe, read_export_record, terms_of
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import FILE_NAME
from prbench.sequences.write import write_dataset

NO_OPTIONS = ImportOptions()
Progress = Callable[[str, str], None]
"""Called with the dataset and the step that begins."""


@dataclass(frozen=True)
class FailedDataset:
    """A dataset of the release that could not be imported."""

    dataset: str
    message: str


@dataclass(frozen=True)
class ImportResult:
    """The imported datasets, and those that could not be imported."""

    reports: tuple[ImportReport, ...]
    failed: tuple[FailedDataset, ...]

    @property
    def complete(self) -> bool:
        """True if nothing had to be left out."""
        return not self.failed and not any(report.left_out for report in self.reports)


@foreign_input()
def import_release(
    root: Path | str,
    out: Path | str,
    *,
    dataset: str | None = None,
    options: ImportOptions = NO_OPTIONS,
    progress: Progress = lambda _dataset, _step: None,
) -> ImportResult:
    """Turn a release into sequence tables.

    Args:
        root: The release (folders HD-EPIC, MoGaze …), or the folder of one dataset.
        out: With ``dataset`` the table's folder, else a folder in which each dataset gets one of its own.
        dataset: Name of the only dataset to import.
        options: Statements of the user, which replace inferences.
        progress: Called before each step.

    Raises:
        InputFileError: if there is nothing to import; with ``on_error="fail"`` for the first thing that is wrong.
        UsageError: for an unknown dataset or field name.
        StorageError: if ``out`` cannot be written or holds something else.
        RecordingsWouldBeLost: if the one dataset's table that stands there holds more, and the options do not say to
            replace it.
    """
    root = Path(root)
    out = Path(out)
    if dataset is not None:
        dataset = dataset_of(dataset) or dataset  # users may write it as the authors do: HD-EPIC
    found = find_datasets(root, dataset)
    targets = {name: out if dataset is not None else out / name for name, _ in found}
    for target in targets.values():
        # Before anything is read: a folder that holds something else must not be noticed after an hour.
        require_replaceable(target, FILE_NAME, kind="dataset")
    reports = list[ImportReport]()
    failed = list[FailedDataset]()
    for name, folder in found:
        try:
            with sole_writer(targets[name]):
                reports.append(_import_dataset(name, folder, targets[name], options, progress))
        except (InputFileError, RecordingsWouldBeLost) as error:
            if options.on_error == "fail" or len(found) == 1:
                raise
            failed.append(FailedDataset(name, str(error)))
    return ImportResult(tuple(reports), tuple(failed))


@foreign_input()
def _import_dataset(dataset: str, folder: Path, out: Path, options: ImportOptions, progress: Progress) -> ImportReport:
    manifest = load_manifest(dataset.removeprefix(SYNTHETIC_PREFIX))
    exported = read_export_record(folder)
    progress(dataset, "reading target_information.json and headers")
    interpreted = interpret(dataset, folder, options)
    progress(dataset, f"measuring {len(interpreted.found.candidates)} sequences")
    measured = _measure(interpreted, options)
    reading = _reading(manifest, dataset, interpreted, measured, options)
    inferences = (*interpreted.inferences, *reading.conclusions.inferences)
    progress(dataset, f"writing {len(measured)} sequences")
    rows = ImportedRows(reading, measured, interpreted.found)
    info = write_dataset(
        out,
        describe(dataset, manifest, terms_of(dataset, manifest, exported), interpreted, inferences, rows),
        sequences=rows.sequences(),
        events=rows.events(),
        recordings=rows.recordings(),
        replace=options.replace,
        incomplete=[each.recording_id for each in rows.records] if interpreted.found.left_out else (),
    )
    # Counts of the study say nothing about synthetic people.
    of_study = None if dataset.startswith(SYNTHETIC_PREFIX) else interpreted.known
    counts = count_rows((each.candidate.subset for each in measured), of_study)
    report = ImportReport(
        dataset=dataset,
        folder=out,
        info=info,
        shape=interpreted.entries.shape,
        fields=interpreted.fields,
        unmapped=interpreted.unmapped,
        inferences=inferences + _round_trip(exported, SequenceTable.open(out)),
        problems=tuple(interpreted.found.problems),
        counts=counts,
        warnings=(*reading.conclusions.warnings, *count_warnings(counts), *_unused_files(interpreted.files)),
    )
    report.write()
    return report


def _measure(interpreted: Interpreted, options: ImportOptions) -> list[Measured]:
    """Read every sequence once; with ``on_error="fail"`` refuse a release of which one is missing."""
    found = interpreted.found
    shift = int(options.first_frame_is_previous)
    rate = interpreted.fps if interpreted.primed.in_seconds else 1.0
    primed_frame = dict[int, int]()
    for candidate in found.candidates:
        primed = candidate.primed * rate - interpreted.primed.base
        whole = interpreted.primed.in_seconds or candidate.primed == round(candidate.primed)
        if not whole or not shift <= round(primed) < candidate.n_frames or candidate.n_frames < 2 + shift:
            last = candidate.n_frames - 1
            message = f"primed frame: expected one of the frames (0 to the last), found {candidate.primed:g} of {last}"
            found.report(candidate.entry.key, message)
        else:
            primed_frame[candidate.index] = round(primed)
    found.candidates = [each for each in found.candidates if each.index in primed_frame]
    measured = survey(found, primed_frame, first_frame=shift)
    # Surveying may have dropped the further arrays of a candidate, so its own copy counts from here on.
    found.candidates = [each.candidate for each in measured]
    if options.on_error == "fail" and found.left_out:
        key, reason = next(iter(found.left_out.items()))
        more = f" (and {len(found.left_out) - 1} more sequences)" if len(found.left_out) > 1 else ""
        raise InputFileError(
            interpreted.files.folder, f"sequence {key}", expected="a complete sequence", found=reason + more
        )
    require_some(found, interpreted.files)
    return measured


def _reading(
    manifest: Manifest, dataset: str, interpreted: Interpreted, measured: list[Measured], options: ImportOptions
) -> Reading:
    """Put together everything that rows depend on: from the JSON, the measurements and our own blocks."""
    reading = Reading(
        dataset=dataset,
        head_tilt_deg=manifest.body.head_tilt_deg,
        texts=load_protocol().text,
        mapping=interpreted.mapping,
        unmapped=interpreted.unmapped,
        fps=interpreted.fps,
        primed=interpreted.primed,
        conclusions=_conclude(interpreted, measured, options),
        first_frame_is_previous=options.first_frame_is_previous,
    )
    return _as_exported(reading, measured)


def _conclude(interpreted: Interpreted, measured: list[Measured], options: ImportOptions) -> Conclusions:
    units = {str(each.candidate.entry.fields.get(interpreted.mapping.get("units", ""), "")) for each in measured}
    stated = units.pop() if len(units) == 1 else None
    conclusions = conclude(str(interpreted.files.folder), measured, stated_unit=stated)
    previous = (
        Inference("frame_0", "the frame before the sequence", "certain", "given by --first-frame previous")
        if options.first_frame_is_previous
        else Inference("frame_0", "the first frame of the sequence", "assumed", "nothing tells otherwise")
    )
    return replace(conclusions, inferences=(*conclusions.inferences, previous))


def _as_exported(reading: Reading, measured: list[Measured]) -> Reading:
    """Replace the inferences of frames by the statements of our own blocks, where every entry has one."""
    blocks = [reading.block(each.candidate) for each in measured]
    stated = [block for block in blocks if block is not None]
    # One entry without a block was written or changed by somebody else; then nothing is taken on trust.
    if len(stated) < len(blocks):
        return reading
    is_known = all(block.goal_frame != UNKNOWN for block in stated)
    goal_frame = "as the motions" if is_known else UNKNOWN
    motion_frame = " and ".join(sorted({block.motion_frame for block in stated}))
    evidence = "stated by the prbench block of every entry"
    known = {
        "goal_frame": Inference("goal_frame", goal_frame, "certain" if is_known else "unknown", evidence),
        "motion_frame": Inference("motion_frame", motion_frame, "certain", evidence),
    }
    inferences = tuple(known.get(each.name, each) for each in reading.conclusions.inferences)
    conclusions = replace(reading.conclusions, goal_frame=goal_frame, inferences=inferences)
    return replace(reading, conclusions=conclusions)


def _round_trip(exported: Mapping[str, Any] | None, table: SequenceTable) -> tuple[Inference, ...]:
    """Compare the imported table with the one that our exporter wrote, by their digests."""
    if exported is None:
        return ()
    info = table.info
    kinds = ("identity_digest", "content_digest")
    same = [kind.replace("_", " ") for kind in kinds if exported.get(kind) == getattr(info, kind)]
    if len(same) == len(kinds):
        return (Inference("exported_table", "unchanged", "certain", "both digests are those of the exported table"),)
    if same == ["content digest"]:
        for version in range(1, info.protocol_version):
            if table.identity_under(version) == exported.get("identity_digest"):
                value = f"unchanged, of protocol version {version}"
                found = (
                    f"the content digest agrees, and the identity digest is that of the same sequences under protocol"
                    f" version {version}; the table is now one of version {info.protocol_version}"
                )
                return (Inference("exported_table", value, "certain", found),)
    found = f"of the digests agree: {', '.join(same) or 'none'}"
    return (Inference("exported_table", "not the same", "certain", found),)


def _unused_files(files: DatasetFiles) -> tuple[str, ...]:
    if not files.unused_names:
        return ()
    shown = ", ".join(files.unused_names[:5]) + (", …" if len(files.unused_names) > 5 else "")
    return (f"{len(files.unused_names)} files are no arrays of sequences: {shown}.",)
