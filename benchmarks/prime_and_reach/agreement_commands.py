"""``prbench analyse agreement``: on which sequences methods succeed: those of people, and by where the goal is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from prbench.cli.commands import Answer
from prbench.cli.options import run_checker
from prbench.cli.summaries import phi_cell
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.harness.run_folder.agreement import BinRate, DatasetAgreement

_UNITS = {"bearing": "°", "distance": " m", "height": " m"}


class RunAgreement(msgspec.Struct, frozen=True, kw_only=True):
    """The agreement of one run on one dataset.

    Attributes:
        run: The run folder.
        method: Name of the method.
        dataset: Name of the dataset.
        synthetic: The people are synthetic.
        unverified: Why the numbers could not be made anew from motions and table; empty if they were.
        agreement: Agreement with recorded people, and rates by the goal's place.
    """

    run: Path
    method: str
    dataset: str
    synthetic: bool
    unverified: str
    agreement: DatasetAgreement


class AgreementsReport(msgspec.Struct, frozen=True, kw_only=True):
    """Agreement of finished runs with recorded people.

    Attributes:
        runs: One entry a run and dataset.
    """

    runs: list[RunAgreement]


def agreement(runs: tuple[Path, ...], *, data: tuple[Path, ...], workers: int) -> Answer:
    """Say on which sequences methods succeed: those of recorded people, and by where the goal is."""
    from prbench.harness.run_folder import RunFolder
    from prbench.harness.run_folder.agreement import DatasetAgreement

    checker = run_checker(data, workers)
    found = []
    for path in runs:
        run = RunFolder.open(path)
        for table in run.record.tables:
            checked = checker.check(run, table)
            stored = DatasetAgreement.read(run.dataset(table.dataset).path)
            found.append(
                RunAgreement(
                    run=path,
                    method=run.record.method.name,
                    dataset=table.dataset,
                    synthetic=table.synthetic,
                    unverified=checked.unverified,
                    agreement=stored,
                )
            )
    report = AgreementsReport(runs=found)
    return Answer(report, lambda: _print(report))


def _print(report: AgreementsReport) -> None:
    for each in report.runs:
        title = f"{each.run.name}: {each.method} on {each.dataset}"
        rates = [
            (rate.title, phi_cell(rate), f"{100 * rate.people:.2f} %", rate.remark) for rate in each.agreement.rates
        ]
        print_table(
            f"{title}: agreement with recorded people, sequence by sequence (phi from -1 to 1, 0 is unrelated)",
            ("metric", "phi, 95 % interval", "people", ""),
            rates,
            numbers=(1, 2),
        )
        print_table(
            f"{title}: by where the goal is, seen from the first pose",
            ("metric", "goal", "sequences", "recordings", "mean", "95 % interval", "people"),
            [_bin_row(entry) for entry in each.agreement.breakdown],
            numbers=(2, 3, 4, 5, 6),
        )
        if each.unverified:
            print(f"unverified: {each.unverified}")
        if each.synthetic:
            print("These are scores on synthetic data: never compare them with published ones.")


def _bin_row(entry: BinRate) -> tuple[str, ...]:
    unit = _UNITS[entry.by]
    upper = f"from {entry.begin:g}{unit}" if entry.end is None else f"{entry.begin:g} to {entry.end:g}{unit}"
    counts = (str(entry.sequences), str(entry.recordings))
    if entry.mean is None or entry.people is None:
        return (entry.title, f"{entry.by} {upper}", *counts, "–", "–", "–")
    bounds = "–"
    if entry.low is not None and entry.high is not None:
        bounds = f"[{100 * entry.low:.2f}, {100 * entry.high:.2f}]"
    return (
        entry.title,
        f"{entry.by} {upper}",
        *counts,
        f"{100 * entry.mean:.2f} %",
        bounds,
        f"{100 * entry.people:.2f} %",
    )
