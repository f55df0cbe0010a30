"""Tables 3 and 4 of *Nymeria* in shape: runs beside the printed numbers (docs/specification/three-points.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from prbench.board.collect import collect_runs
from prbench.errors import RunError
from prbench.protocol.published import printed_rows
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell
from prbench_benchmarks.three_points.metrics import METRICS

_SHOWN = {info.id: info for info in METRICS if info.main or info.id == "jitter"}
_TITLE = "Bodies from head and wrists (Nymeria, Tables 3 and 4)"
_WORDS = ("method", "condition", "dataset", "devices")
_NOTES = (
    "Means over tracks, never over frames; 95 % intervals over recordings in brackets. Less is better, but for jitter.",
    "What the study leaves open: docs/specification/three-points.md. Its splits are unknown: approach, do not compare.",
)


def three_points_table(paths: Sequence[Path], *, with_published: bool) -> Table:
    """Lay out runs of the benchmark, one row a run and table.

    Args:
        paths: Run folders, or folders that hold some.
        with_published: Show the printed rows of both tables in blocks of their own.

    Raises:
        RunError: if a path holds no run, or one of another benchmark.
    """
    collected = collect_runs(paths, any_benchmark=True)
    rows = []
    for each in collected.rows:
        if each.record.benchmark != "three-points":
            raise RunError(f"{each.run}: expected a run of three-points, found one of {each.record.benchmark}.")
        about: Any = {"method": each.method, "condition": each.record.condition, "dataset": each.table.dataset}
        about["variant"] = "synthetic" if each.table.dataset.endswith("-suit") else "real"
        cells = [
            metric_cell(one.metric, one.unit, one.mean, one.low, one.high, recordings=one.recordings, **about)
            for one in each.summary.metrics
            if one.metric in _SHOWN
        ]
        rows.append(Row(text=dict(zip(_WORDS, about.values())), cells=tuple(cells)))
    blocks = [Block(title="measured", rows=tuple(rows))]
    for table in ("3", "4") if with_published else ():
        printed: dict[tuple[str, ...], list[Cell]] = {}
        for number in printed_rows("prbench_benchmarks.three_points.published", "tables"):
            if number["table"] == table and number["metric"] in _SHOWN:  # not FID
                about: Any = {name: number[name] for name in ("method", "condition", "dataset", "metric", "note")}
                about |= {"variant": number["devices"], "unit": _SHOWN[number["metric"]].unit}
                about["origin"] = f"published: Nymeria, Table {table}"
                cell = Cell(value=float(number["value"]), **about)
                printed.setdefault(tuple(number[name] for name in _WORDS), []).append(cell)
        lines = [Row(text=dict(zip(_WORDS, key)), cells=tuple(cells)) for key, cells in printed.items()]
        blocks.append(Block(title=f"printed in Table {table} of Nymeria", rows=tuple(lines)))
    columns = (Column(key=name, title=name.capitalize(), text=True) for name in _WORDS)
    numbers = (Column(key=name, title=info.title, unit=info.unit) for name, info in _SHOWN.items())
    return Table(title=_TITLE, columns=(*columns, *numbers), blocks=tuple(blocks), notes=(*_NOTES, *collected.left_out))
