"""``prbench import-release`` and ``prbench export-release``: the layout of the authors' own files."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from prbench.cli import options as opt
from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.commands import Answer, command, note, session
from prbench.cli.terminal import print_table, print_tables

_IMPORT_RELEASE = "prbench import-release /data/PR --out tables/released"
_FIELD_MAP = "Which field of target_information.json means what, for example goal=centre; repeatable. An import that"
_FIELD_MAP += " needs it shows the fields and the words to add."


@command("import-release", example=_IMPORT_RELEASE, report="prbench.release.report:ImportReleaseReport")
@click.argument("root", type=opt.PATH)
@opt.out_folder_option("Gets a table folder for each dataset; with --dataset it is the table.", required=True)
@click.option("--dataset", metavar="NAME", help="Only this dataset, for example hd-epic.")
@click.option("--fps", type=opt.RATE, metavar="N", help="Frames a second, where the files do not tell.")
@opt.pairs_option("--field-map", _FIELD_MAP, metavar="CANONICAL=THEIRS")
@opt.on_error_option(what="sequences", them="them")
@opt.replace_option()
def import_release(*, root: Path, out: Path, dataset: str | None, fps: float | None, **given: Any) -> Answer:
    """Turn the authors' released files into tables, and say what had to be inferred.

    ROOT is the folder with HD-EPIC, MoGaze …, or one of these. Then, for example:
    prbench run --method static --condition none --data tables/released
    """
    from prbench.errors import UsageError
    from prbench.release.importing import import_release as import_files
    from prbench.release.reading import ImportOptions

    if fps is not None and not 1 <= fps <= 1000:
        raise UsageError(f"--fps: expected 1 to 1000, found {fps:g}.")

    def tell(dataset: str, step: str) -> None:
        if not session().quiet:
            print(f"{dataset}: {step}", file=sys.stderr, flush=True)

    report = import_files(root, out, dataset=dataset, options=ImportOptions(fps=fps, **given), progress=tell)
    for table in report.tables:
        for warning in table.warnings:
            note(f"warning: {warning}")
        for line in table.problem_lines():
            note(f"problem: {line}")
        if table.why_not_scored:
            note(f"warning: metrics will be refused: {table.why_not_scored}")
    for name, message in report.failed.items():
        note(f"failed: {name}: {message}")

    def show() -> None:
        for table in report.tables:
            rows = [(each.name, each.value, each.how_surely, each.evidence) for each in table.inferred]
            rows += [(f"field {meaning}", name, "", "") for meaning, name in table.fields.items()]
            print_table(f"{table.title}: what was inferred", ("", "value", "how surely", "evidence"), rows)
            if table.fields_kept_in_extra:
                print(f"fields kept in extra: {', '.join(table.fields_kept_in_extra)}")
            print(f"table: {table.folder}")
        print_tables(report.sizes)

    return Answer(report, show, 0 if report.complete else NOT_EVERYTHING)


_EXPORT_RELEASE = "prbench export-release --as-published --out release"
_AS_PUBLISHED = "Only what the authors' page names: goal, prompt, subset and primed frame, without action, hand,"
_AS_PUBLISHED += " recording …."


@command("export-release", example=_EXPORT_RELEASE, report="prbench.release.report:ExportReleaseReport")
@click.argument("data", type=opt.PATH, nargs=-1, metavar="[DIR]...")
@opt.out_folder_option("Folder of the release; each dataset gets a folder in it.", required=True)
@opt.flag("--as-published", _AS_PUBLISHED)
@opt.permission_option
def export_release(*, data: tuple[Path, ...], out: Path, as_published: bool, permission: tuple[str, ...]) -> Answer:
    """Write tables in the layout of the authors' release.

    Without DIR, the five embedded synthetic datasets are written: a release to try an import on.
    """
    from prbench.engine import engine_for
    from prbench.release.exporting import export_release as export_tables

    data = data or opt.embedded_tables(engine_for(1))
    report = export_tables(data, out, permitted=permission, as_published=as_published)

    def show() -> None:
        for each in report.datasets:
            print(f"{each.dataset}: {each.sequences} sequences in {each.folder}")
            if each.notice:
                print(f"notice: {each.notice}")

    return Answer(report, show)
