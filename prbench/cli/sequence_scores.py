"""Scores of single sequences on the terminal: one row a metric, one column a sample."""

from __future__ import annotations

from typing import TYPE_CHECKING

from prbench.cli.tables import print_table

if TYPE_CHECKING:
    from prbench.runs import RunFolder


def print_sequence_scores(run: RunFolder) -> None:
    """Print what every motion of a run scored, sequence by sequence."""
    from prbench.metrics import METRICS
    from prbench.runs import read_scores

    for table in run.record.tables:
        rows = read_scores(run.dataset(table.dataset).scores).to_pylist()
        for name in dict.fromkeys(row["sequence_id"] for row in rows):
            values = {(row["metric"], row["sample"]): row for row in rows if row["sequence_id"] == name}
            samples = sorted({sample for _, sample in values})
            header = ("metric", *(f"sample {sample}" if len(samples) > 1 else "value" for sample in samples), "")
            lines = []
            for metric in METRICS:
                cells = [values[metric.id, sample] for sample in samples if (metric.id, sample) in values]
                if cells:
                    remarks = dict.fromkeys(cell["flag"].replace("_", " ") for cell in cells if cell["flag"])
                    lines.append(
                        (metric.title, *(_cell(cell["value"], metric.unit) for cell in cells), "; ".join(remarks))
                    )
            print_table(
                f"{name}: {run.record.method.name}, {run.record.condition}",
                header,
                lines,
                numbers=range(1, len(samples) + 1),
            )
        if table.synthetic:
            print("These are scores on synthetic data: never compare them with published ones.")


def _cell(value: float, unit: str) -> str:
    from prbench.metrics import printed_unit

    if unit == "rate":
        return "yes" if value >= 0.5 else "no"
    return f"{value:.3f}{printed_unit(unit)}"
