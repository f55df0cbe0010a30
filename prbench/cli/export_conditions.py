"""``prbench export-conditions``: what a method may see, as a file for a program that runs elsewhere."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli.commands import Answer, command, note
from prbench.cli.options import (
    ALL_CONDITIONS,
    FIRST_RUN_SEQUENCES,
    POSITIVE,
    benchmark_option,
    control_option,
    data_option,
    limit_option,
    out_file_option,
    permission_option,
    seed_option,
    split_option,
    usual_number,
)
from prbench.errors import UsageError
from prbench.protocol.benchmarks import default_benchmark

if TYPE_CHECKING:
    from prbench.harness.offline.export import ExportReport


@command(
    "export-conditions",
    example="prbench export-conditions --data tables/adt --condition goal-loc --seed 0 --out conditions.npz",
    report="prbench.harness.offline.export:ExportReport",
)
@data_option(required=True)
@benchmark_option
@click.option("--condition", type=click.Choice(ALL_CONDITIONS), required=True, help="What the method is given.")
@out_file_option(".parquet, or .npz for NumPy alone.", required=True)
@seed_option("behind opaque ids and noise seeds")
@click.option(
    "--samples", type=POSITIVE, metavar="K", help=f"Answers to each case (default {usual_number('samples')})."
)
@split_option()
@limit_option()
@click.option(
    "--max-frames",
    type=POSITIVE,
    metavar="N",
    help="Leave out sequences of more than N frames; scoring counts them as unsupported.",
)
@click.option(
    "--native-fps",
    type=float,
    metavar="F",
    help="Ask for motions at F frames per second; scoring resamples them to the table's rate.",
)
@control_option("Give every sequence another one's goal; the file does not tell.")
@permission_option
def export_conditions(
    data: tuple[Path, ...],
    benchmark: str | None,
    condition: str,
    out: Path,
    seed: int,
    samples: int | None,
    split: str,
    limit: int | None,
    max_frames: int | None,
    native_fps: float | None,
    control: str | None,
    permission: tuple[str, ...],
) -> Answer:
    """Write exactly what a method may see, for one that runs elsewhere.

    `prbench score` takes the motions that the method makes from it.
    """
    from prbench.contract import Condition
    from prbench.harness.offline import ExportRequest
    from prbench.harness.offline import export_conditions as export
    from prbench.protocol.benchmarks import find_benchmark

    about = find_benchmark(benchmark or default_benchmark().name)
    if condition not in about.conditions:
        known = ", ".join(about.conditions)
        raise UsageError(f"--condition {condition}: expected one of the benchmark {about.name}: {known}.")
    samples = samples or about.samples
    if not about.default:
        for option, value in (("max-frames", max_frames), ("native-fps", native_fps), ("control", control)):
            if value is not None:
                raise UsageError(f"--{option}: the benchmark {about.name} does not have it; leave it out.")
        return _windows(data, condition, out, seed, samples, split, limit, permission)
    exported = export(
        ExportRequest(
            data=data,
            condition=Condition(condition),
            out=out,
            seed=seed,
            samples=samples,
            split=split,
            limit=limit,
            max_frames=max_frames,
            native_fps=native_fps,
            control=control,
            permitted=permission,
        )
    )
    if limit is None:
        _tell_first_run(data)
    note(f"then: prbench score PREDICTIONS --conditions {shlex.quote(str(exported.out))} --data …")
    return Answer(exported, lambda: _print(exported))


def _windows(
    data: tuple[Path, ...],
    condition: str,
    out: Path,
    seed: int,
    samples: int,
    split: str,
    limit: int | None,
    permission: tuple[str, ...],
) -> Answer:
    """Write what a predictor may see."""
    from prbench.harness.motion_prediction.offline import WindowsRequest, export_windows
    from prbench.harness.offline.export import ExportReport

    exported = export_windows(
        WindowsRequest(
            data=data,
            condition=condition,
            out=out,
            seed=seed,
            samples=samples,
            split=split,
            limit=limit,
            permitted=permission,
        )
    )
    note(f"then: prbench score FUTURES.npz --conditions {shlex.quote(str(exported.out))} --data …")
    report = ExportReport(
        out=exported.out,
        rows=exported.windows * samples,
        sequences={exported.dataset: exported.windows},
        left_out={},
        notices=exported.notices,
    )
    return Answer(report, lambda: _print(report, case="windows"))


def _tell_first_run(data: Sequence[Path]) -> None:
    """Tell that runs without ``--data`` take a part of the embedded datasets, and this command all by default."""
    from prbench.harness.first_run import default_table_folders

    embedded = {os.path.realpath(folder) for folder in default_table_folders()}
    if any(os.path.realpath(folder) in embedded for folder in data):
        note(
            f"these are embedded datasets, of which `prbench run` without --data takes {FIRST_RUN_SEQUENCES}"
            f" sequences each: --limit {FIRST_RUN_SEQUENCES} exports the same ones."
        )


def _print(report: ExportReport, case: str = "sequences") -> None:
    for dataset, count in report.sequences.items():
        longer = report.left_out.get(dataset, 0)
        print(f"{dataset}: {count} {case}{f' ({longer} longer ones left out)' if longer else ''}")
    for line in report.notices:
        print(f"notice: {line}")
    print(f"{report.rows} motions to generate: {report.out}")
