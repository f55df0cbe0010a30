"""``prbench doctor``: what is wrong with motions in a file, from the numbers themselves."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import PATH, POSITIVE, data_option, seed_option

if TYPE_CHECKING:
    from prbench.checking.doctor.examine_file import DoctorReport as Examination

_SOMETHING_IS_WRONG = 1
"""Exit code when a fault is certain; suspicions alone leave 0."""


class DiagnosedFault(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that is wrong with motions, or may be.

    Attributes:
        kind: ``unit``, ``up-axis``, ``facing`` …; docs/doctor.md lists them all.
        certain: True if the motions are wrong for sure, false if they are only suspicious.
        evidence: The measured numbers, in a sentence.
        cause: The most frequent reason for such numbers.
        remedy: The change to make, with the converter where there is one.
    """

    kind: str
    certain: bool
    evidence: str
    cause: str
    remedy: str


class DoctorReport(msgspec.Struct, frozen=True, kw_only=True):
    """The findings about a file of motions.

    Attributes:
        path: The file, or the folder.
        total: Number of motions in it.
        examined: Number of motions that were looked at.
        compared: Number of those that were compared with what was asked for (``--data``, ``--conditions``).
        shapes: Different shapes of the arrays, in the order of the file; at most five.
        fps: Frame rate by which the motions were read, in frames per second.
        certain: Whether one of the diagnoses is certain; then the exit code is 1.
        diagnoses: What was found; empty if nothing was.
    """

    path: Path
    total: int
    examined: int
    compared: int
    shapes: list[str]
    fps: float
    certain: bool
    diagnoses: list[DiagnosedFault]


@command("doctor", example="prbench doctor motions.npy", report=DoctorReport, writes_report=True)
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

    found = examine_file(
        DoctorRequest(path=motions, data=data, conditions=conditions, seed=seed, fps=fps, limit=max_motions)
    )
    report = _report(found)
    return Answer(report, lambda: _print(report), _SOMETHING_IS_WRONG if report.certain else 0)


def _report(found: Examination) -> DoctorReport:
    return DoctorReport(
        path=found.path,
        total=found.total,
        examined=found.examined,
        compared=found.compared,
        shapes=list(found.shapes),
        fps=found.fps,
        certain=found.certain,
        diagnoses=[
            DiagnosedFault(
                kind=each.kind,
                certain=bool(each.certain),
                evidence=each.evidence,
                cause=each.cause,
                remedy=each.remedy,
            )
            for each in found.diagnoses
        ],
    )


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
