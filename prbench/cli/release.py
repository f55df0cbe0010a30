"""``prbench import-release`` and ``prbench export-release``: the layout of the authors' own files."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click
import msgspec

from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.commands import Answer, command, note, session
from prbench.cli.options import (
    PATH,
    KeyValue,
    data_arguments,
    on_error_option,
    out_folder_option,
    permission_option,
    replace_option,
)
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.release import ImportReport


class Inferred(msgspec.Struct, frozen=True, kw_only=True):
    """One property that the release does not state, or one field of it.

    Attributes:
        name: What was inferred.
        value: What it was taken to be; for a field its name in the release.
        how_surely: ``certain``, ``likely``, ``assumed`` or ``unknown``.
        evidence: What speaks for it.
    """

    name: str
    value: str
    how_surely: str
    evidence: str


class SplitCount(msgspec.Struct, frozen=True, kw_only=True):
    """The number of sequences of one split.

    Attributes:
        split: Name of the split.
        found: Number of sequences that were found.
        study: The study's number; null where it prints none.
    """

    split: str
    found: int
    study: int | None


class SequenceProblem(msgspec.Struct, frozen=True, kw_only=True):
    """One problem of one sequence.

    Attributes:
        sequence: Its key in the release.
        problem: What is wrong.
        left_out: Whether the sequence was left out; else it was imported in spite of the problem.
    """

    sequence: str
    problem: str
    left_out: bool


class ImportedTable(msgspec.Struct, frozen=True, kw_only=True):
    """One dataset of the release that became a table; the same stands in its ``import_report.json``.

    Attributes:
        dataset: Name of the dataset.
        title: Its title.
        folder: The table.
        inferred: What the release does not state.
        fields: Which field of the release holds what.
        fields_kept_in_extra: Fields of the release of which nothing is known; the column ``extra`` keeps them.
        counts: Sequences of each split, beside the study's.
        warnings: What a user should look at.
        problems: Problems of single sequences.
        why_not_scored: Why metrics will be refused on this table; null where they will not.
    """

    dataset: str
    title: str
    folder: Path
    inferred: list[Inferred]
    fields: list[Inferred]
    fields_kept_in_extra: list[str]
    counts: list[SplitCount]
    warnings: list[str]
    problems: list[SequenceProblem]
    why_not_scored: str | None


class NotImported(msgspec.Struct, frozen=True, kw_only=True):
    """One dataset of the release that could not be imported.

    Attributes:
        dataset: Name of the dataset.
        message: What is wrong.
    """

    dataset: str
    message: str


class ImportReleaseReport(msgspec.Struct, frozen=True, kw_only=True):
    """The result of an import.

    Attributes:
        tables: One entry for each table that was written.
        failed: Datasets that could not be imported.
    """

    tables: list[ImportedTable]
    failed: list[NotImported]


class ExportedTable(msgspec.Struct, frozen=True, kw_only=True):
    """One table that was written in the layout of the release.

    Attributes:
        dataset: Name of the dataset.
        folder: Its folder in the release.
        sequences: Number of sequences.
        notice: Terms under which the folder may be passed on; empty if there are none.
    """

    dataset: str
    folder: Path
    sequences: int
    notice: str


class ExportReleaseReport(msgspec.Struct, frozen=True, kw_only=True):
    """The result of an export.

    Attributes:
        datasets: One entry for each table.
    """

    datasets: list[ExportedTable]


@command(
    "import-release",
    example="prbench import-release /data/PR --out tables/released",
    report=ImportReleaseReport,
)
@click.argument("root", type=PATH)
@out_folder_option("Gets a table folder for each dataset; with --dataset it is the table.", required=True)
@click.option("--dataset", metavar="NAME", help="Only this dataset, for example hd-epic.")
@click.option("--fps", type=float, metavar="N", help="Frames a second, where the files do not tell.")
@click.option(
    "--field-map",
    type=KeyValue(),
    multiple=True,
    metavar="CANONICAL=THEIRS",
    help="What a field of target_information.json means, for example goal=centre; repeatable.",
)
@click.option(
    "--first-frame",
    type=click.Choice(["sequence", "previous"]),
    default="sequence",
    help="Frame 0 belongs to the sequence (default), or is the frame before it.",
)
@on_error_option(what="sequences", them="them")
@replace_option()
def import_release(
    *,
    root: Path,
    out: Path,
    dataset: str | None,
    fps: float | None,
    field_map: tuple[tuple[str, str], ...],
    first_frame: str,
    on_error: Literal["skip", "fail"],
    replace: bool,
) -> Answer:
    """Turn the authors' released files into tables, and say what had to be inferred.

    ROOT is the folder with HD-EPIC, MoGaze …, or one of these.
    """
    from prbench.errors import UsageError
    from prbench.release import ImportOptions
    from prbench.release import import_release as import_files

    if fps is not None and not 1 <= fps <= 1000:
        raise UsageError(f"--fps: expected 1 to 1000, found {fps:g}.")
    options = ImportOptions(
        fps=fps,
        field_map=dict(field_map),
        first_frame_is_previous=first_frame == "previous",
        on_error=on_error,
        replace=replace,
    )
    result = import_files(root, out, dataset=dataset, options=options, progress=_tell_step)
    for each in result.reports:
        _note_problems(each)
    for failed in result.failed:
        note(f"failed: {failed.dataset}: {failed.message}")
    report = ImportReleaseReport(
        tables=[_imported(each) for each in result.reports],
        failed=[NotImported(dataset=failed.dataset, message=failed.message) for failed in result.failed],
    )
    return Answer(report, lambda: _print_imported(report), 0 if result.complete else NOT_EVERYTHING)


def _tell_step(dataset: str, step: str) -> None:
    """Say what the import is doing now."""
    if not session().quiet:
        print(f"{dataset}: {step}", file=sys.stderr, flush=True)


def _note_problems(report: ImportReport) -> None:
    for warning in report.warnings:
        note(f"warning: {warning}")
    for line in report.problem_lines():
        note(f"problem: {line}")
    if report.info.why_not_scored:
        note(f"warning: metrics will be refused: {report.info.why_not_scored}")


def _imported(report: ImportReport) -> ImportedTable:
    return ImportedTable(
        dataset=report.dataset,
        title=report.info.title,
        folder=report.folder,
        inferred=[
            Inferred(name=each.name, value=each.value, how_surely=each.certainty, evidence=each.evidence)
            for each in report.inferences
        ],
        fields=[
            Inferred(name=each.canonical, value=each.field, how_surely=each.certainty, evidence=each.evidence)
            for each in report.fields
        ],
        fields_kept_in_extra=list(report.unmapped),
        counts=[SplitCount(split=row.split, found=row.found, study=row.expected) for row in report.counts],
        warnings=list(report.warnings),
        problems=[
            SequenceProblem(sequence=each.key, problem=each.message, left_out=each.left_out) for each in report.problems
        ],
        why_not_scored=report.info.why_not_scored,
    )


def _print_imported(report: ImportReleaseReport) -> None:
    for table in report.tables:
        rows = [(each.name.replace("_", " "), each.value, each.how_surely, each.evidence) for each in table.inferred]
        rows += [(f"field {each.name}", each.value, each.how_surely, each.evidence) for each in table.fields]
        print_table(f"{table.title}: what was inferred", ("", "value", "how surely", "evidence"), rows)
        counts = [(row.split, str(row.found), "" if row.study is None else str(row.study)) for row in table.counts]
        print_table("sequences", ("split", "found", "study"), counts, numbers=(1, 2))
        if table.fields_kept_in_extra:
            print(f"fields kept in extra: {', '.join(table.fields_kept_in_extra)}")
        print(f"table: {table.folder}")


@command(
    "export-release",
    example="prbench export-release tables/adt tables/mogaze --out release",
    report=ExportReleaseReport,
)
@data_arguments
@out_folder_option("Folder of the release; each dataset gets a folder in it.", required=True)
@click.option(
    "--frame",
    type=click.Choice(["canonical", "world"]),
    default="canonical",
    help="Each sequence's canonical frame (default; comes back without change), or its recording's world.",
)
@permission_option
def export_release(
    *, data: tuple[Path, ...], out: Path, frame: Literal["canonical", "world"], permission: tuple[str, ...]
) -> Answer:
    """Write tables in the layout of the authors' release."""
    from prbench.release import export_release as export_tables

    exported = export_tables(data, out, permitted=permission, frame=frame)
    report = ExportReleaseReport(
        datasets=[
            ExportedTable(dataset=each.dataset, folder=each.folder, sequences=each.sequences, notice=each.notice)
            for each in exported
        ]
    )
    return Answer(report, lambda: _print_exported(report))


def _print_exported(report: ExportReleaseReport) -> None:
    for each in report.datasets:
        print(f"{each.dataset}: {each.sequences} sequences in {each.folder}")
        if each.notice:
            print(f"notice: {each.notice}")
