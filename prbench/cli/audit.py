"""``prbench audit``: what cheats and controls earn under each metric."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.embedded import embedded_tables
from prbench.cli.options import (
    FIRST_RUN_SEQUENCES,
    data_option,
    limit_option,
    out_folder_option,
    split_option,
    workers_option,
)
from prbench.cli.progress import progress
from prbench.cli.summaries import DatasetScores, dataset_scores, phi_cell
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.metrics import MetricInfo
    from prbench.workflows.audit import TableAudit

_COLUMNS = 7
"""Metrics side by side at most, so that a table fits on a usual terminal."""
_SEQUENCES = 48
"""Sequences of each dataset that is named with ``--data``, unless the user says how many."""


class ControlScores(msgspec.Struct, frozen=True, kw_only=True):
    """What one control earned.

    Attributes:
        name: Name of the control; ``ground-truth, shuffled-goal`` was scored against other sequences' goals.
        use: What it does.
        is_recorded: The motions are the recorded ones, through another form at most.
        scores: Its scores.
    """

    name: str
    use: str
    is_recorded: bool
    scores: DatasetScores


class AuditedTable(msgspec.Struct, frozen=True, kw_only=True):
    """All controls on one table.

    Attributes:
        dataset: Name of the dataset.
        controls: The controls, recorded motion last.
        as_good_as_people: Maps each metric to the controls that score as well as recorded people or better, though
            they are none; metrics that compare with the recorded motion, and those without a direction, are left out.
    """

    dataset: str
    controls: list[ControlScores]
    as_good_as_people: dict[str, list[str]]


class AuditReport(msgspec.Struct, frozen=True, kw_only=True):
    """What each metric pays for.

    Attributes:
        tables: One entry a table.
        out: Folder of the run folders; null if they were not kept.
    """

    tables: list[AuditedTable]
    out: Path | None


@command("audit", example="prbench audit --data tables/adt --limit 100", report=AuditReport)
@data_option(required=False, help="Built dataset folder(s); without it the five embedded synthetic ones are used.")
@split_option()
@limit_option(f"{_SEQUENCES}; {FIRST_RUN_SEQUENCES} without --data")
@out_folder_option("Keep the run folders in this one (default: they are thrown away).")
@workers_option()
def audit(data: tuple[Path, ...], split: str, limit: int | None, out: Path | None, workers: int) -> Answer:
    """Print what cheats, controls and recorded people earn under each metric.

    Every cheat can be run by itself, too: `prbench run --method tremor`. docs/audit.md says what is to be learnt.
    """
    from prbench.engine import engine_for
    from prbench.workflows.audit import audit as run_audit
    from prbench.workflows.audit import metrics_of

    engine = engine_for(workers)
    default = _SEQUENCES if data else FIRST_RUN_SEQUENCES
    tables = data or embedded_tables(engine)
    with progress("running controls") as show:
        found = run_audit(tables, split=split, limit=limit or default, out=out, engine=engine, progress=show)
    report = AuditReport(tables=[_audited_table(each) for each in found], out=out)

    def show_all() -> None:
        for each in found:
            _print(each, metrics_of(each))
        if out is not None:
            print(f"run folders: {out}")

    return Answer(report, show_all)


def _audited_table(each: TableAudit) -> AuditedTable:
    from prbench.workflows.audit import metrics_of

    won = {info.id: list(each.not_worse_than_people(info)) for info in metrics_of(each) if _is_contest(info)}
    return AuditedTable(
        dataset=each.recorded.dataset,
        controls=[
            ControlScores(
                name=control.name,
                use=control.use,
                is_recorded=control.is_recorded,
                scores=dataset_scores(control.summary, control.agreement),
            )
            for control in each.controls
        ],
        as_good_as_people=won,
    )


def _is_contest(info: MetricInfo) -> bool:
    """Return True where scoring like recorded people can be told from being compared with them."""
    return info.higher_is_better is not None and not info.compares_with_recorded


def _print(each: TableAudit, metrics: Sequence[MetricInfo]) -> None:
    summary = each.recorded
    title = f"{summary.title}: {summary.sequences} sequences of {summary.recordings} recordings, split {summary.split}"
    main = [info for info in metrics if info.main]
    beside = [info for info in metrics if not info.main]
    for first in range(0, len(main), _COLUMNS):
        _print_metrics(f"{title}; the main metrics", each, main[first : first + _COLUMNS])
    for first in range(0, len(beside), _COLUMNS):
        _print_metrics("beside them", each, beside[first : first + _COLUMNS])
    _print_agreement(each)
    for info in metrics:
        names = each.not_worse_than_people(info)
        if names and _is_contest(info):
            print(f"{info.title}: no worse than recorded people: {', '.join(names)}.")
    for control in each.controls:
        if control.summary.edge_arrivals:
            print(f"{control.name}: {control.summary.edge_arrivals}.")
    if summary.synthetic:
        print("These are scores on synthetic data: never compare them with published ones.")
    print("docs/audit.md says what each control does and what is to be learnt from it.")


def _print_agreement(each: TableAudit) -> None:
    """Print on which sequences each control succeeds, beside recorded people."""
    rates = each.controls[0].agreement.rates
    header = ["control", *(rate.title.replace(" ", "\n") for rate in rates)]
    rows = []
    for control in each.controls:
        found = {rate.metric: rate for rate in control.agreement.rates}
        cells = [phi_cell(found[rate.metric]) if rate.metric in found else "–" for rate in rates]
        rows.append((control.name, *cells))
    title = "agreement with recorded people on the same sequences (phi, 95 % interval; 0 is unrelated)"
    print_table(title, header, rows, numbers=range(1, len(header)))


def _print_metrics(title: str, each: TableAudit, metrics: Sequence[MetricInfo]) -> None:
    from prbench.metrics import printed_unit

    header = ["control"]
    for info in metrics:
        unit = printed_unit(info.unit).strip()
        words = f"{info.title}{info.arrow}".replace(" ", "\n")
        header.append(f"{words}\n({unit})" if unit else words)
    rows = []
    for control in each.controls:
        means = {metric.metric: metric.mean for metric in control.summary.metrics}
        cells = [f"{means[info.id] * info.scale:.2f}" if info.id in means else "–" for info in metrics]
        rows.append((control.name, *cells))
    print_table(title, header, rows, numbers=range(1, len(header)))
