"""Table S8: text-to-motion quality of a pre-trained model, from the files that ``prbench evaluate-text`` writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prbench.protocol.published import load_published, published_table
from prbench_benchmarks.prime_and_reach.study.document import DASH, StudyBlock, StudyTable, StudyValue
from prbench_benchmarks.text_to_motion.metrics import Repeated
from prbench_benchmarks.text_to_motion.report import ResultRow, TextEvaluation

_METRICS = {
    "r_precision_top_3": ("R Precision Top-3 ↑ (%)", 100.0, "%"),
    "fid": ("FID ↓", 1.0, ""),
    "multimodal_distance": ("Multimodal Distance ↓", 1.0, ""),
    "diversity": ("Diversity ↑", 1.0, ""),
}
"""The study's four metrics: title, factor to the printed value, unit."""
_NOT_RECOMPUTED = "as reported by the file; motions are not at hand to hold the numbers against"


def table_s8(paths: Sequence[Path], *, with_published: bool) -> StudyTable:
    """Make Table S8 from evaluations.

    Args:
        paths: Files of ``prbench evaluate-text``.
        with_published: Show the study's rows in a block of their own. They come from another evaluator and another
            test set, so there is no difference to them.

    Raises:
        InputFileError: if a file is no evaluation.
    """
    evaluations = {path: TextEvaluation.read(path) for path in paths}
    blocks = []
    values: list[StudyValue] = []
    for path, found in evaluations.items():
        title = (
            f"{path.name}: {found.dataset}, split {found.split}, {found.clips} clips, evaluator"
            f" {found.evaluator_sha256[:8]} ({found.vectorisation})"
        )
        blocks.append(StudyBlock(title, tuple(_line(row) for row in found.rows)))
        values += [value for row in found.rows for value in _values(found, row)]
    if with_published:
        blocks.append(StudyBlock("Published: Prime and Reach, Table S8, Nymeria, another evaluator", _published()))
        values += _published_values()
    return StudyTable(
        number="S8",
        title=published_table("S8").title,
        header=("Motions", *(title for title, _, _ in _METRICS.values())),
        blocks=tuple(blocks),
        values=tuple(values),
        notes=(
            "± is 1.96 standard errors over repetitions. Numbers of different evaluators never compare.",
            f"Measured numbers stand {_NOT_RECOMPUTED}.",
            *published_table("S8").notes,
            *(note for found in evaluations.values() for note in found.notes),
        ),
    )


def _line(row: ResultRow) -> tuple[str, ...]:
    return (row.source, *(_cell(row.metrics.get(name), scale) for name, (_, scale, _) in _METRICS.items()))


def _cell(found: Repeated | None, scale: float) -> str:
    if found is None:
        return DASH
    mean = f"{scale * found.mean:.2f}"
    return mean if found.half_width is None else f"{mean} ± {scale * found.half_width:.2f}"


def _values(found: TextEvaluation, row: ResultRow) -> list[StudyValue]:
    values = []
    for name, (_, scale, unit) in _METRICS.items():
        measured = row.metrics.get(name)
        if measured is None:
            continue
        half = measured.half_width
        values.append(
            StudyValue(
                dataset=found.dataset,
                condition="text",
                method=row.source,
                metric=name,
                value=scale * measured.mean,
                low=None if half is None else scale * (measured.mean - half),
                high=None if half is None else scale * (measured.mean + half),
                unit=unit,
                sequences=row.motions,
                note=_NOT_RECOMPUTED,
            )
        )
    return values


def _published() -> tuple[tuple[str, ...], ...]:
    rows: dict[str, dict[str, str]] = {}
    for number in load_published("S8"):
        plus_minus = f" ± {number.plus_minus}" if number.plus_minus else ""
        rows.setdefault(number.variant, {})[number.metric] = f"{number.printed}{plus_minus}"
    return tuple((variant, *(cells.get(name, DASH) for name in _METRICS)) for variant, cells in rows.items())


def _published_values() -> list[StudyValue]:
    return [
        StudyValue(
            dataset=number.dataset,
            condition=number.condition,
            method=number.method,
            variant=number.variant,
            metric=number.metric,
            value=number.value,
            sd=float(number.plus_minus) if number.plus_minus else None,
            unit=_METRICS[number.metric][2],
            origin=number.source,
            note=number.note,
        )
        for number in load_published("S8")
    ]
