"""``prbench datasets`` and ``prbench cite``: which datasets there are, and what using them asks for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import data_arguments, root_option
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.checking.catalogue import CatalogueEntry


class DatasetEntry(msgspec.Struct, frozen=True, kw_only=True):
    """One dataset that prbench can read.

    Attributes:
        name: Name by which commands call it, such as ``adt``.
        kind: ``benchmark`` for sequences, ``corpus`` for pre-training.
        title: Its title.
        homepage: Address of its page.
        licence: Its licence.
        redistribution: Whether data made from it may be passed on: ``yes``, ``non-commercial`` or ``none``.
        how_to_obtain: What to do to get it.
        required_files: Files without which a recording is not read.
        optional_files: Files that add to a recording.
        rates_hz: Samples a second of each of its streams.
        body_poses: Where its bodies can come from.
        reader_options: Options of its reader, with their defaults.
        known_bad: Recordings that are left out, and why.
        found: Places and counts of recordings below ``--root``; empty where nothing was looked for or found.
        missing: Required files that recordings below ``--root`` lack, and what else is wrong with them.
        citation: What to cite, as BibTeX.
    """

    name: str
    kind: str
    title: str
    homepage: str
    licence: str
    redistribution: str
    how_to_obtain: str
    required_files: list[str]
    optional_files: list[str]
    rates_hz: dict[str, float]
    body_poses: list[str]
    reader_options: list[str]
    known_bad: dict[str, str]
    found: str
    missing: list[str]
    citation: str


class DatasetsReport(msgspec.Struct, frozen=True, kw_only=True):
    """The catalogue of datasets.

    Attributes:
        datasets: One entry for each dataset, or the one that was named.
        unusable_readers: Installed packages whose reader cannot be used, and why.
    """

    datasets: list[DatasetEntry]
    unusable_readers: list[str]


class CiteReport(msgspec.Struct, frozen=True, kw_only=True):
    """The citations and terms of tables.

    Attributes:
        bibtex: BibTeX entries; the licence terms of each dataset stand above them as comments.
    """

    bibtex: str


@command("datasets", example="prbench datasets --root /data", report=DatasetsReport, writes_report=True)
@click.argument("name", required=False)
@root_option("Look here for copies, and one folder below.", required=False)
def datasets(*, name: str | None, root: Path | None) -> Answer:
    """List the datasets with licence and terms, how to obtain them, and what of them is below a folder.

    With NAME everything about that one is told.
    """
    from prbench.checking.catalogue import catalogue, unusable_readers

    report = DatasetsReport(
        datasets=[_entry(each) for each in catalogue(root, name)],
        unusable_readers=list(unusable_readers()),
    )
    if name is not None:
        return Answer(report, lambda: print(_everything(report.datasets[0])))
    return Answer(report, lambda: _print_list(report))


def _entry(entry: CatalogueEntry) -> DatasetEntry:
    manifest = entry.manifest
    return DatasetEntry(
        name=manifest.name,
        kind=manifest.kind,
        title=manifest.title,
        homepage=manifest.homepage,
        licence=manifest.licence,
        redistribution=manifest.redistribution,
        how_to_obtain=manifest.how_to_obtain,
        required_files=list(manifest.required_files),
        optional_files=list(manifest.optional_files),
        rates_hz=dict(manifest.rates_hz),
        body_poses=[body.pose_source for body in (manifest.body, *manifest.other_bodies.values())],
        reader_options=list(entry.reader_options),
        known_bad=dict(manifest.known_bad),
        found=entry.found,
        missing=list(entry.missing),
        citation=manifest.citation.strip(),
    )


def _print_list(report: DatasetsReport) -> None:
    print_table(
        "datasets",
        ("name", "for", "title", "licence", "redistribution", "found"),
        [
            (each.name, each.kind, each.title, each.licence, each.redistribution, each.found or "–")
            for each in report.datasets
        ],
    )
    for each in report.datasets:
        for line in each.missing:
            print(f"{each.name}: {line}")
    for line in report.unusable_readers:
        print(f"! {line}")
    print("`prbench datasets NAME` tells how to obtain one and which files it consists of.")


def _everything(entry: DatasetEntry) -> str:
    lines = [
        f"{entry.title} ({entry.name}), for: {entry.kind}",
        f"homepage:        {entry.homepage}",
        f"licence:         {entry.licence}",
        f"redistribution:  {entry.redistribution}",
        f"how to obtain:   {entry.how_to_obtain}",
        "required files:  " + ", ".join(entry.required_files),
        "optional files:  " + ", ".join(entry.optional_files),
        "rates (Hz):      " + ", ".join(f"{name} {rate:g}" for name, rate in entry.rates_hz.items()),
        f"body poses:      {', '.join(entry.body_poses)}",
    ]
    lines += [f"reader option:   {text}" for text in entry.reader_options]
    lines += [f"known bad:       {name}: {reason}" for name, reason in entry.known_bad.items()]
    if entry.found:
        lines.append(f"found:           {entry.found}")
    lines += [f"missing:         {line}" for line in entry.missing]
    return "\n".join([*lines, "", entry.citation])


@command("cite", example="prbench cite tables/adt tables/mogaze > references.bib", report=CiteReport)
@data_arguments
def cite(*, data: tuple[Path, ...]) -> Answer:
    """Print BibTeX and licence terms of everything that built tables contain."""
    from prbench.checking.catalogue import citation_text

    report = CiteReport(bibtex=citation_text(data))
    return Answer(report, lambda: print(report.bibtex))
