"""``prbench doctor``: what is wrong with motions in a file, from the numbers themselves."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_data, command, positive

if TYPE_CHECKING:
    from prbench.checking.doctor.examine_file import DoctorReport

_SOMETHING_IS_WRONG = 1
"""Exit code when a fault is certain; suspicions alone leave 0."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "doctor",
        summary="say what is wrong with motions (unit, axes, order of joints, place, clock …), from the numbers",
        example="prbench doctor motions.npy",
        execute=_doctor,
    )
    parser.add_argument(
        "motions",
        type=Path,
        metavar="FILE",
        help=".npy, .npz or Parquet of any shape, a folder of motions/*.npy, or a run folder",
    )
    add_data(parser, required=False, help="built dataset folder(s): compare with initial poses, lengths and recordings")
    parser.add_argument(
        "--conditions", type=Path, metavar="FILE", help="of `prbench export-conditions`: compare with it"
    )
    parser.add_argument("--seed", type=int, default=0, help="behind the opaque ids, with --data (default 0)")
    parser.add_argument("--fps", type=float, metavar="F", help="rate of the motions (default: that asked for, else 20)")
    parser.add_argument(
        "--limit", type=positive, default=200, metavar="N", help="at most N motions, evenly spread (default 200)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the report as JSON, too")


def _doctor(arguments: argparse.Namespace) -> int:
    from prbench.checking.doctor.examine_file import DoctorRequest, examine_file
    from prbench.locks import sole_writer
    from prbench.storage import write_json

    report = examine_file(
        DoctorRequest(
            path=arguments.motions,
            data=tuple(arguments.data or ()),
            conditions=arguments.conditions,
            seed=arguments.seed,
            fps=arguments.fps,
            limit=arguments.limit,
        )
    )
    if arguments.json is not None:
        with sole_writer(arguments.json):
            write_json(arguments.json, asdict(report) | {"path": str(report.path), "certain": report.certain})
    _print(report)
    return _SOMETHING_IS_WRONG if report.certain else 0


def _print(report: DoctorReport) -> None:
    some = f"{report.examined} of {report.total}" if report.examined < report.total else f"{report.total}"
    compared = f", {report.compared} compared with what was asked for" if report.compared else ""
    print(f"{report.path}: {some} motion(s), {', '.join(report.shapes)}, at {report.fps:g} frames a second{compared}")
    for diagnosis in report.diagnoses:
        print(f"\n{'wrong' if diagnosis.certain else 'suspicious'}: {diagnosis.kind}")
        print(f"  evidence  {diagnosis.evidence}")
        print(f"  cause     {diagnosis.cause}")
        print(f"  remedy    {diagnosis.remedy}")
    if not report.diagnoses:
        print("nothing found; docs/doctor.md says what numbers cannot tell")
