"""``prbench datasets`` and ``prbench cite``: which datasets there are, and what using them asks for."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import command
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.workflows.catalogue import CatalogueEntry


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the two commands."""
    parser = command(
        commands,
        "datasets",
        summary="list the datasets with licence and terms, how to obtain them, and what of them is below a folder",
        example="prbench datasets --root /data",
        execute=_datasets,
    )
    parser.add_argument("name", nargs="?", help="tell everything about this one")
    parser.add_argument("--root", type=Path, metavar="DIR", help="look here for copies, and one folder below")
    cite = command(
        commands,
        "cite",
        summary="print BibTeX and licence terms of everything that built tables contain",
        example="prbench cite tables/adt tables/mogaze > references.bib",
        execute=_cite,
    )
    cite.add_argument("data", type=Path, nargs="+", metavar="DIR", help="built dataset folder(s)")


def _datasets(arguments: argparse.Namespace) -> int:
    from prbench.workflows.catalogue import catalogue

    entries = catalogue(arguments.root, arguments.name)
    if arguments.name is not None:
        print(_everything(entries[0]))
        return 0
    print_table(
        "datasets",
        ("name", "for", "title", "licence", "redistribution", "found"),
        [
            (
                entry.manifest.name,
                entry.manifest.kind,
                entry.manifest.title,
                entry.manifest.licence,
                entry.manifest.redistribution,
                entry.found or "–",
            )
            for entry in entries
        ],
    )
    for entry in entries:
        for line in entry.missing:
            print(f"{entry.manifest.name}: {line}")
    print("`prbench datasets NAME` tells how to obtain one and which files it consists of.")
    return 0


def _everything(entry: CatalogueEntry) -> str:
    manifest = entry.manifest
    lines = [
        f"{manifest.title} ({manifest.name}), for: {manifest.kind}",
        f"homepage:        {manifest.homepage}",
        f"licence:         {manifest.licence}",
        f"redistribution:  {manifest.redistribution}",
        f"how to obtain:   {manifest.how_to_obtain}",
        "required files:  " + ", ".join(manifest.required_files),
        "optional files:  " + ", ".join(manifest.optional_files),
        "rates (Hz):      " + ", ".join(f"{name} {rate:g}" for name, rate in manifest.rates_hz.items()),
        f"body poses:      {', '.join(body.pose_source for body in (manifest.body, *manifest.other_bodies.values()))}",
    ]
    lines += [f"reader option:   {text}" for text in entry.reader_options]
    lines += [f"known bad:       {name}: {reason}" for name, reason in manifest.known_bad.items()]
    if entry.found:
        lines.append(f"found:           {entry.found}")
    lines += [f"missing:         {line}" for line in entry.missing]
    return "\n".join([*lines, "", manifest.citation.strip()])


def _cite(arguments: argparse.Namespace) -> int:
    from prbench.workflows.catalogue import citation_text

    print(citation_text(arguments.data))
    return 0
