"""``prbench build-dataset``: native recordings into a table."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_workers, command
from prbench.cli.builds import (
    NOT_EVERYTHING,
    add_on_error,
    add_reader_options,
    add_recordings,
    add_replace,
    print_cut_short,
    print_fruitless,
    print_plan,
    print_unread,
)
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.curation import BuildReport
    from prbench.curation.options import BuildOptions

EVERYTHING = "all"
"""Stands in place of a dataset's name for whatever is found."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "build-dataset",
        summary="turn a dataset's recordings into a table of prime-and-reach sequences",
        example="prbench build-dataset adt --root /data/ADT --out tables/adt --workers 4",
        execute=_build,
        resumes=True,
    )
    parser.add_argument("dataset", help="name of the dataset, for example adt; 'all' for whatever lies below --root")
    parser.add_argument("--root", type=Path, required=True, metavar="DIR", help="your copy of the dataset")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the table; an earlier one is replaced once the new one is ready, if that lacks nothing",
    )
    add_replace(parser)
    parser.add_argument("--recordings", default="*", metavar="GLOB", help="only recordings whose name matches")
    add_recordings(parser)
    parser.add_argument("--dry-run", action="store_true", help="say what would be read, and write nothing")
    parser.add_argument("--in-hand", metavar="RULE", help="another in-hand rule of the manifest, for example wrist")
    parser.add_argument("--ray-origin", choices=["eye", "camera"], help="where gaze rays start (default: eye)")
    parser.add_argument(
        "--priming",
        choices=["rule", "published"],
        default="rule",
        help="prime times by the equations (default), or taken over from the dataset where it publishes them (hd-epic)",
    )
    parser.add_argument(
        "--occlusion",
        choices=["off", "mark", "require"],
        default="off",
        help="where a dataset has meshes: mark events primed through one, or let unobstructed looks alone prime"
        " (needs the extra open3d)",
    )
    parser.add_argument(
        "--minimum-movement",
        default="wrist_to_goal",
        metavar="MEASURE",
        help="what must be at least 20 cm: wrist_to_goal (default), pelvis or object displacement",
    )
    add_on_error(parser)
    parser.add_argument(
        "--poses",
        metavar="SOURCE",
        help="where bodies come from, for example egoallo in place of ADT's suit; short for --option poses=SOURCE",
    )
    add_reader_options(parser)
    add_workers(parser)


def _build(arguments: argparse.Namespace) -> int:
    from prbench.curation import build_dataset, plan_build
    from prbench.engine import engine_for

    options = _options(arguments)
    if arguments.dataset == EVERYTHING:
        return _build_all(arguments, options)
    if arguments.dry_run:
        print_plan(plan_build(arguments.dataset, arguments.root, options), arguments.workers, unfit="bad")
        return 0
    _require_out(arguments)
    with progress(f"building {arguments.dataset}") as show:
        report = build_dataset(
            arguments.dataset,
            arguments.root,
            arguments.out,
            options=options,
            engine=engine_for(arguments.workers),
            progress=lambda step: show(step.done, step.total, step.record.recording_id),
        )
    return _print_report(report)


def _build_all(arguments: argparse.Namespace, options: BuildOptions) -> int:
    from prbench.engine import engine_for
    from prbench.workflows.build_all import build_all, plan_all

    if arguments.dry_run:
        for name, root, plan in plan_all(arguments.root, options):
            print(f"{name} in {root}:")
            print_plan(plan, arguments.workers, unfit="bad")
        return 0
    _require_out(arguments)
    with progress("building") as show:
        outcomes = build_all(
            arguments.root,
            arguments.out,
            options=options,
            engine=engine_for(arguments.workers),
            progress=lambda name, step: show(step.done, step.total, f"{name} {step.record.recording_id}"),
        )
    for outcome in outcomes:
        if outcome.report is not None:
            _print_report(outcome.report)
    rows = [
        (each.dataset, *(_sizes(each.report) if each.report else ("–", "–", "–")), each.message) for each in outcomes
    ]
    print_table("datasets", ("dataset", "recordings", "not read", "sequences", "problem"), rows, numbers=(1, 2, 3))
    return 0 if all(outcome.complete for outcome in outcomes) else NOT_EVERYTHING


def _sizes(report: BuildReport) -> tuple[str, str, str]:
    counts = report.info.counts
    return str(counts.recordings_read), str(counts.recordings_failed + counts.recordings_skipped), str(counts.sequences)


def _require_out(arguments: argparse.Namespace) -> None:
    from prbench.errors import UsageError

    if arguments.out is None:
        raise UsageError("--out DIR is needed: the folder of the table. (--dry-run does without.)")


def _options(arguments: argparse.Namespace) -> BuildOptions:
    from prbench.curation.options import BuildOptions, CurationOptions

    return BuildOptions(
        curation=CurationOptions(
            in_hand=arguments.in_hand,
            ray_origin=arguments.ray_origin,
            minimum_movement=arguments.minimum_movement,
            priming=arguments.priming,
            occlusion=arguments.occlusion,
        ),
        recordings=arguments.recordings,
        limit=arguments.limit,
        reader=tuple(sorted((_meshes(arguments) | dict(arguments.option) | _poses(arguments)).items())),
        on_error=arguments.on_error,
        replace=arguments.replace,
    )


def _meshes(arguments: argparse.Namespace) -> dict[str, str]:
    """Ask the reader for meshes where an option needs them; readers load none otherwise."""
    from prbench.errors import UsageError
    from prbench.readers import reader_for

    if arguments.in_hand == "surface":
        return {"meshes": "true"}
    if arguments.occlusion == "off":
        return {}
    if arguments.dataset != EVERYTHING and "meshes" not in reader_for(arguments.dataset).options.names():
        raise UsageError(f"--occlusion needs meshes, and {arguments.dataset} has none; leave the option out.")
    return {"meshes": "true"}


def _poses(arguments: argparse.Namespace) -> dict[str, str]:
    return {} if arguments.poses is None else {"poses": arguments.poses}


def _print_report(report: BuildReport) -> int:
    from prbench.curation.provenance import funnel_rows

    rows = [(row.stage, str(row.kept), str(row.dropped or ""), row.reason) for row in funnel_rows(report.info)]
    print_table(
        f"{report.info.title}: from files to sequences", ("stage", "kept", "dropped", "why"), rows, numbers=(1, 2)
    )
    print_unread(report.records, reused=report.reused)
    print_cut_short(report.records)
    print_fruitless(report.records)
    print(f"table: {report.folder}")
    counts = report.info.counts
    return NOT_EVERYTHING if counts.recordings_failed or counts.recordings_cut_short else 0
