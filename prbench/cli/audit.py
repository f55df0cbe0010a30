"""``prbench audit``: what cheats and controls earn under each metric."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from prbench.cli.commands import Answer, command, session
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
from prbench.cli.summaries import phi_cell
from prbench.cli.terminal import print_table, shown_width

if TYPE_CHECKING:
    from prbench.board.audit import ControlMeans, TableAudit
    from prbench.metrics import MetricInfo

_COLUMNS = 8
"""Metrics side by side at most; half as many on a narrow terminal."""
_WIDE = 120
"""Columns of a terminal that these metrics take."""
_SEQUENCES = 48
"""Sequences of each dataset that is named with ``--data``, unless the user says how many."""


class AuditReport(msgspec.Struct, frozen=True, kw_only=True):
    """What each metric pays for.

    Attributes:
        tables: One entry a table.
        means: Means over all tables, one entry a control.
        as_good_as_people: Maps each metric to the controls whose means are as good as those of recorded people or
            better, though they are none; metrics that compare with the recorded motion, and those without a direction,
            are left out.
        out: Folder of the run folders; null if they were not kept.
    """

    tables: tuple[TableAudit, ...]
    means: tuple[ControlMeans, ...]
    as_good_as_people: dict[str, list[str]]
    out: Path | None


@command("audit", example="prbench audit --data tables/adt --limit 100", report=AuditReport)
@data_option(required=False, help="Built dataset folder(s); without it the five embedded synthetic ones are used.")
@split_option()
@limit_option(f"{_SEQUENCES}; {FIRST_RUN_SEQUENCES} without --data")
@out_folder_option("Keep the run folders in this one (default: they are thrown away).")
@workers_option()
def audit(data: tuple[Path, ...], split: str, limit: int | None, out: Path | None, workers: int) -> Answer:
    """Print what cheats, controls and recorded people earn under each metric.

    Of several tables it prints means of the main metrics; with -v of all metrics, and each table.
    Every cheat can be run by itself, too: `prbench run --method tremor`. docs/audit.md says what is to be learnt.
    """
    from prbench.board.audit import audit as run_audit
    from prbench.board.audit import means_of_controls
    from prbench.engine import engine_for

    engine = engine_for(workers)
    default = _SEQUENCES if data else FIRST_RUN_SEQUENCES
    tables = data or embedded_tables(engine)
    with progress("running controls") as show:
        found = run_audit(tables, split=split, limit=limit or default, out=out, engine=engine, progress=show)
    over = means_of_controls(found)
    report = AuditReport(tables=found, means=over, as_good_as_people=_as_good_as_people(over), out=out)

    def show_all() -> None:
        if len(found) > 1:
            _print_means(found, over)
        if len(found) == 1 or session().verbose:
            for each in found:
                _print_dataset(each)
        if any(each.recorded.synthetic for each in found):
            print("These are scores on synthetic data: never compare them with published ones.")
        print("docs/audit.md says what each control does and what is to be learnt from it.")
        if out is not None:
            print(f"run folders: {out}")

    return Answer(report, show_all)


def _as_good_as_people(controls: Sequence[ControlMeans]) -> dict[str, list[str]]:
    """Map each metric in which scoring like people can be told from being compared with them to who does."""
    from prbench.board.audit import metrics_of, not_worse_than_people

    contests = [
        info for info in metrics_of(controls) if info.higher_is_better is not None and not info.compares_with_recorded
    ]
    return {info.id: list(not_worse_than_people(controls, info)) for info in contests}


def _print_means(tables: Sequence[TableAudit], over: Sequence[ControlMeans]) -> None:
    first = tables[0].recorded
    numbers = sorted({each.recorded.sequences for each in tables})
    counts = str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
    title = f"Means over {len(tables)} datasets, {counts} sequences of each, split {first.split}"
    _print_all_metrics(title, over, only_main=not session().verbose)
    print("With -v, or with --json: other metrics, each dataset, and agreement with recorded people.")


def _print_dataset(each: TableAudit) -> None:
    summary = each.recorded
    title = f"{summary.title}: {summary.sequences} sequences of {summary.recordings} recordings, split {summary.split}"
    _print_all_metrics(title, each.means)
    _print_agreement(each)
    for control in each.controls:
        if control.summary.edge_arrivals:
            print(f"{control.name}: {control.summary.edge_arrivals}.")


def _print_all_metrics(title: str, controls: Sequence[ControlMeans], *, only_main: bool = False) -> None:
    """Print what every control earns, and in which metrics it does no worse than recorded people."""
    from prbench.board.audit import metrics_of

    metrics = metrics_of(controls)
    columns = _COLUMNS if shown_width() >= _WIDE else _COLUMNS // 2
    for kind, infos in (
        (f"{title}; the main metrics", [info for info in metrics if info.main]),
        ("beside them", [info for info in metrics if not info.main and not only_main]),
    ):
        for first in range(0, len(infos), columns):
            _print_metrics(kind, controls, infos[first : first + columns])
    titles = {info.id: info.title for info in metrics}
    for metric, names in _as_good_as_people(controls).items():
        if names:
            print(f"{titles[metric]}: no worse than recorded people: {', '.join(names)}.")


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


def _print_metrics(title: str, controls: Sequence[ControlMeans], metrics: Sequence[MetricInfo]) -> None:
    from prbench.metrics import printed_unit

    header = ["control"]
    for info in metrics:
        unit = printed_unit(info.unit).strip()
        words = f"{info.title}{info.arrow}".replace(" ", "\n")
        header.append(f"{words}\n({unit})" if unit else words)
    rows = []
    for control in controls:
        found = [control.means.get(info.id) for info in metrics]
        cells = [
            "–" if mean is None else f"{mean.mean * info.scale:.2f}" for mean, info in zip(found, metrics, strict=True)
        ]
        rows.append((control.name, *cells))
    print_table(title, header, rows, numbers=range(1, len(header)))
