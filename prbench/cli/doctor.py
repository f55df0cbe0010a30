"""``prbench doctor``: what is wrong with motions in a file, from the numbers themselves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli.commands import Answer, command
from prbench.cli.options import PATH, POSITIVE, data_option, seed_option

if TYPE_CHECKING:
    from prbench.checking.doctor.examine_file import DoctorReport


@command(
    "doctor",
    example="prbench doctor motions.npy",
    report="prbench.checking.doctor.examine_file:DoctorReport",
    writes_report=True,
)
@click.argument("motions", type=PATH, metavar="FILE")
@data_option(
    required=False,
    help="Built dataset folder(s): compare with their initial poses, lengths and recordings.",
)
@click.option("--conditions", type=PATH, metavar="FILE", help="Compare with this file of `prbench export-conditions`.")
@seed_option("behind the opaque ids, with --data")
@click.option("--fps", type=float, metavar="F", help="Rate of the motions (default: that asked for, else 20).")
@click.option(
    "--max-motions",
    type=POSITIVE,
    default=200,
    metavar="N",
    help="Look at N motions at most, evenly spread (default 200).",
)
def doctor(
    motions: Path, data: tuple[Path, ...], conditions: Path | None, seed: int, fps: float | None, max_motions: int
) -> Answer:
    """Say what is wrong with motions (unit, axes, order of joints, place, clock …), from the numbers.

    FILE is .npy, .npz or Parquet of any shape, a folder of motions/*.npy, or a run folder. The exit code is 1 where a
    fault is certain.
    """
    from prbench.checking.doctor.examine_file import DoctorRequest, examine_file

    report = examine_file(
        DoctorRequest(path=motions, data=data, conditions=conditions, seed=seed, fps=fps, limit=max_motions)
    )
    return Answer(report, lambda: _print(report), int(report.certain))


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
