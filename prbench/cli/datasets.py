"""``prbench datasets``: which datasets there are, and what using them asks for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli.commands import Answer, SeveralValues, command
from prbench.cli.options import PATH, root_option
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.checking.catalogue import Catalogue, CatalogueEntry


@command(
    "datasets",
    example="prbench datasets --root /data",
    report="prbench.checking.catalogue:Catalogue",
    writes_report=True,
)
@click.argument("name", required=False)
@root_option("Look here for copies, and one folder below.", required=False)
@click.option(
    "--cite",
    cls=SeveralValues,
    type=PATH,
    metavar="DIR...",
    help="Print BibTeX and licence terms of everything that these tables contain, such as --cite tables/adt, and"
    " nothing else.",
)
def datasets(*, name: str | None, root: Path | None, cite: tuple[Path, ...]) -> Answer:
    """List the datasets with licence and terms, how to obtain them, and what of them is below a folder.

    With NAME everything about that one is told.
    """
    from prbench.checking.catalogue import Catalogue, catalogue, citation_text
    from prbench.readers.discover import usable_readers

    if cite:
        text = citation_text(cite)
        return Answer(Catalogue(bibtex=text), lambda: print(text))
    report = Catalogue(datasets=catalogue(root, name), unusable_readers=usable_readers()[1])
    return Answer(report, lambda: _print_list(report) if name is None else print(_everything(report.datasets[0])))


def _print_list(report: Catalogue) -> None:
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


def _everything(entry: CatalogueEntry) -> str:
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
