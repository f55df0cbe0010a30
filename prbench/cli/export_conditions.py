"""``prbench export-conditions``: what a method may see, as a file for a program that runs elsewhere."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from pathlib import Path

from prbench.cli.arguments import (
    CONDITIONS,
    FIRST_RUN_SEQUENCES,
    add_data,
    add_limit,
    add_permission,
    add_split,
    command,
    positive,
)


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "export-conditions",
        summary="write exactly what a method may see, for one that runs elsewhere; `prbench score` takes what it makes",
        example="prbench export-conditions --data tables/adt --condition goal-loc --seed 0 --out conditions.npz",
        execute=_export,
    )
    add_data(parser, required=True)
    parser.add_argument("--condition", choices=CONDITIONS, required=True, help="what the method is given")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".parquet, or .npz for NumPy alone")
    parser.add_argument("--seed", type=int, default=0, help="behind opaque ids and noise seeds (default 0)")
    parser.add_argument("--samples", type=positive, default=1, metavar="K", help="motions a sequence (default 1)")
    add_split(parser)
    add_limit(parser)
    parser.add_argument(
        "--max-frames",
        type=positive,
        metavar="N",
        help="leave out longer sequences; scoring counts them as unsupported",
    )
    parser.add_argument(
        "--native-fps",
        type=float,
        metavar="F",
        help="ask for motions at F frames per second; scoring resamples them to the table's rate",
    )
    parser.add_argument(
        "--control", choices=["shuffled-goal"], help="give every sequence another one's goal; the file does not tell"
    )
    add_permission(parser)


def _export(arguments: argparse.Namespace) -> int:
    from prbench.contract import Condition
    from prbench.submitted.offline import ExportRequest, export_conditions

    report = export_conditions(
        ExportRequest(
            data=tuple(arguments.data),
            condition=Condition(arguments.condition),
            out=arguments.out,
            seed=arguments.seed,
            samples=arguments.samples,
            split=arguments.split,
            limit=arguments.limit,
            max_frames=arguments.max_frames,
            native_fps=arguments.native_fps,
            control=arguments.control,
            permitted=tuple(arguments.permission),
        )
    )
    for dataset, sequences in report.sequences.items():
        left_out = report.left_out.get(dataset, 0)
        more = f" ({left_out} longer ones left out)" if left_out else ""
        print(f"{dataset}: {sequences} sequences{more}")
    for line in report.notices:
        print(f"notice: {line}")
    print(f"{report.rows} motions to generate: {report.out}")
    _tell_first_run(arguments)
    print(f"then: prbench score PREDICTIONS --conditions {shlex.quote(str(report.out))} --data …", file=sys.stderr)
    return 0


def _tell_first_run(arguments: argparse.Namespace) -> None:
    """Tell that runs without ``--data`` take a part of the embedded dataset, and this command all of it by default."""
    from prbench.workflows.first_run import default_table_folder

    embedded = os.path.realpath(default_table_folder())
    if arguments.limit is None and any(os.path.realpath(folder) == embedded for folder in arguments.data):
        print(
            f"this is the embedded dataset, of which `prbench run` without --data takes {FIRST_RUN_SEQUENCES}"
            f" sequences: --limit {FIRST_RUN_SEQUENCES} exports the same ones.",
            file=sys.stderr,
        )
