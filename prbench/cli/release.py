"""``prbench import-release`` and ``prbench export-release``: the layout of the authors' own files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_permission, command, key_value
from prbench.cli.builds import NOT_EVERYTHING, add_on_error, add_replace
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.release import ImportReport


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register both commands."""
    _add_import(commands)
    _add_export(commands)


def _add_import(commands: argparse._SubParsersAction) -> None:
    parser = command(
        commands,
        "import-release",
        summary="turn the authors' released files into tables, and say what had to be inferred",
        example="prbench import-release /data/PR --out tables/released",
        execute=_import,
    )
    parser.add_argument("root", type=Path, metavar="ROOT", help="folder with HD-EPIC, MoGaze …, or one of these")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="gets a table folder a dataset; with --dataset the table"
    )
    parser.add_argument("--dataset", metavar="NAME", help="only this dataset, for example hd-epic")
    parser.add_argument("--fps", type=float, metavar="F", help="frame rate, where the files do not tell")
    parser.add_argument(
        "--field-map",
        type=key_value,
        action="append",
        default=[],
        metavar="CANONICAL=THEIRS",
        help="what a field of target_information.json means, for example goal=centre; repeatable",
    )
    parser.add_argument(
        "--first-frame",
        choices=["sequence", "previous"],
        default="sequence",
        help="frame 0 belongs to the sequence (default), or is the frame before it",
    )
    add_on_error(parser, what="sequences", them="them")
    add_replace(parser)


def _add_export(commands: argparse._SubParsersAction) -> None:
    parser = command(
        commands,
        "export-release",
        summary="write tables in the layout of the authors' release",
        example="prbench export-release tables/adt tables/mogaze --out release",
        execute=_export,
    )
    parser.add_argument("data", type=Path, nargs="+", metavar="DIR", help="built dataset folders, one a dataset")
    parser.add_argument("--out", type=Path, required=True, metavar="ROOT", help="the release")
    parser.add_argument(
        "--frame",
        choices=["canonical", "world"],
        default="canonical",
        help="each sequence's canonical frame (default; comes back without change), or its recording's world",
    )
    add_permission(parser)


def _import(arguments: argparse.Namespace) -> int:
    from prbench.errors import UsageError
    from prbench.release import ImportOptions, import_release

    if arguments.fps is not None and not 1 <= arguments.fps <= 1000:
        raise UsageError(f"--fps: expected 1 to 1000, found {arguments.fps:g}.")
    options = ImportOptions(
        fps=arguments.fps,
        field_map=dict(arguments.field_map),
        first_frame_is_previous=arguments.first_frame == "previous",
        on_error=arguments.on_error,
        replace=arguments.replace,
    )
    result = import_release(
        arguments.root,
        arguments.out,
        dataset=arguments.dataset,
        options=options,
        progress=lambda dataset, step: print(f"{dataset}: {step}", file=sys.stderr),
    )
    for report in result.reports:
        _print(report)
    for failed in result.failed:
        print(f"failed: {failed.dataset}: {failed.message}", file=sys.stderr)
    return 0 if result.complete else NOT_EVERYTHING


def _print(report: ImportReport) -> None:
    rows = [(each.name.replace("_", " "), each.value, each.certainty, each.evidence) for each in report.inferences]
    rows += [(f"field {each.canonical}", each.field, each.certainty, each.evidence) for each in report.fields]
    print_table(f"{report.info.title}: what was inferred", ("", "value", "how surely", "evidence"), rows)
    counts = [(row.split, str(row.found), "" if row.expected is None else str(row.expected)) for row in report.counts]
    print_table("sequences", ("split", "found", "study"), counts, numbers=(1, 2))
    if report.unmapped:
        print(f"fields kept in extra: {', '.join(report.unmapped)}")
    for warning in report.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    for line in report.problem_lines():
        print(f"problem: {line}", file=sys.stderr)
    if report.info.why_not_scored:
        print(f"warning: metrics will be refused: {report.info.why_not_scored}", file=sys.stderr)
    print(f"table: {report.folder}")


def _export(arguments: argparse.Namespace) -> int:
    from prbench.release import export_release

    for report in export_release(arguments.data, arguments.out, permitted=arguments.permission, frame=arguments.frame):
        print(f"{report.dataset}: {report.sequences} sequences in {report.folder}")
        if report.notice:
            print(f"notice: {report.notice}")
    return 0
