"""A finished table as Markdown and as values for JSON.

Markdown has the study's layout, an interval under every mean, and cost columns at the end. JSON has rates in %, as
printed, and null where Markdown prints a dash.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict

from prbench.board.tables import FEWEST_RANKED
from prbench.harness.run_folder.summary import LOZENGE, PILCROW
from prbench.metrics import STUDY_METRICS, exported_unit
from prbench.shown import markdown
from prbench_benchmarks.prime_and_reach.table_two.layout import (
    ARRIVAL,
    CONTROL,
    DECIDING,
    BlockLayout,
    Cell,
    DatasetLayout,
    Line,
    LineCost,
    Step,
    TableLayout,
    metric_title,
)

_DASH = "–"
_MARKS = {"†": "zero-shot", "‡": "zero-shot, trained on HumanML3D", "*": "zero-shot, trained on Nymeria"}
"""Marks of the study's row labels."""
COST_TITLES = ("s/motion", "passes/motion", "MiB")
SCHEMA_VERSION = 1


def as_markdown(layout: TableLayout) -> str:
    """Return the whole document."""
    parts = ["# Table 2"]
    for dataset in layout.datasets:
        parts += [f"## {markdown(heading(dataset, layout))}", _grid(dataset)]
        parts += ["\n".join(f"- {markdown(text)}" for text in orders(dataset))] if dataset.is_ranked else []
    parts.append("\n".join(f"- {markdown(note)}" for note in notes(layout)))
    return "\n\n".join(parts) + "\n"


def heading(dataset: DatasetLayout, layout: TableLayout) -> str:
    """Title, and the data behind it."""
    plural = "" if dataset.recordings == 1 else "s"
    of = "" if dataset.sequences == dataset.chosen else f" (of {dataset.chosen}: those that every method can generate)"
    counts = f"n = {dataset.sequences} sequences{of} of {dataset.recordings} recording{plural}"
    return f"{dataset.title}: {counts}, split {layout.split}"


def orders(dataset: DatasetLayout) -> Iterable[str]:
    """Yield each block's orders, with the difference at each step and whether the data support it."""
    for block in dataset.blocks:
        labels = {line.name: line.label for line in block.lines}
        for info, order in ((DECIDING, block.order), (ARRIVAL, block.arrival_order)):
            if order:
                steps = [labels[order[0].better], *(f"{labels[step.worse]} ({_step(step)})" for step in order)]
                yield f"{block.title}, by {info.title}: {' > '.join(steps)}"


def _step(step: Step) -> str:
    bounds = "" if step.low is None or step.high is None else f" [{step.low:.2f}, {step.high:.2f}]"
    p = "" if step.p is None else f", p = {step.p:.3f}"
    return f"{step.difference:.2f}{bounds} lower{p}{'' if step.supported else ', not supported by the data'}"


def notes(layout: TableLayout) -> Iterable[str]:
    """Yield the notes that a reader needs, one sentence or two each."""
    if layout.minutes is not None:
        yield f"n is what fitted into {layout.minutes} min on the machine that it was run on."
    lines = [line for block in layout.datasets[0].blocks for line in block.lines]
    if any(line.label[-1] in _MARKS for line in lines):
        yield "; ".join(f"{mark}: {meaning}" for mark, meaning in _MARKS.items()) + "; no mark: fine-tuned."
    if any(line.gaze for line in lines):
        yield f"{PILCROW}: gaze is generated with the head, beyond the study. Never ranked."
    if any(line.obstacles for line in lines):
        yield f"{LOZENGE}: was given the scene's boxes, which other methods are not. Never ranked."
    yield "Rates in %, Goal MPJPE and MPJPE in m; 95 % intervals over recordings in brackets."
    few = [dataset.dataset for dataset in layout.datasets if not dataset.is_ranked]
    if few:
        yield f"Nothing is ranked on {', '.join(few)}: fewer than {FEWEST_RANKED} sequences."
    if len(few) < len(layout.datasets):
        yield (
            "Bold or ¹: better than every other method of the block, each by a supported difference. Controls are not"
            " ranked."
        )
    for dataset in layout.datasets:
        yield from _controls_arrival(dataset)
        yield from dataset.edge_arrivals
        yield from dataset.undecided
    if any(dataset.synthetic for dataset in layout.datasets):
        yield "Scores on synthetic data: they say nothing about real people; never compare them with published ones."
    stand_ins = [f"{line.label} ({line.weights_used})" for line in lines if line.stands_in and line.state == "run"]
    if stand_ins:
        yield (
            "Small weights, trained on invented people alone, stand in for the study's: "
            f"{', '.join(dict.fromkeys(stand_ins))}."
        )
    for line in layout.without_numbers:
        yield f"{line.label} ({line.name}): {line.state}, {line.reason}"
    for dataset in layout.datasets:
        for line in (line for block in dataset.blocks for line in block.lines if line.unsupported):
            yield (
                f"{line.label} on {dataset.dataset}: {line.unsupported} sequences are longer than it can generate and"
                " were left out for every method."
            )
    if any(dataset.redistribution == "non-commercial" for dataset in layout.datasets):
        yield "Some of the data may be used for non-commercial purposes only."


def _controls_arrival(dataset: DatasetLayout) -> Iterable[str]:
    """Yield the metric that tells staring from priming, of which the study's table has no column."""
    lines = [line for block in dataset.blocks if block.condition == CONTROL for line in block.lines]
    shown = [f"{line.label} {line.arrival.mean:.2f}" for line in lines if line.arrival is not None]
    if shown:
        yield f"{ARRIVAL.title} of the controls on {dataset.dataset}, in %: {', '.join(shown)}."


def _grid(dataset: DatasetLayout) -> str:
    header = ["Condition", "Method", *(metric_title(info) for info in STUDY_METRICS), *COST_TITLES]
    rule = ["---"] * 2 + ["---:"] * (len(STUDY_METRICS) + len(COST_TITLES))
    rows = [row for block in dataset.blocks for row in _rows(block)]
    return "\n".join("| " + " | ".join(line) + " |" for line in (header, rule, *rows))


def _rows(block: BlockLayout) -> Iterable[Sequence[str]]:
    for i, line in enumerate(block.lines):
        cells = (_cell(line.cells[info.id]) for info in STUDY_METRICS)
        yield [markdown(block.title) if i == 0 else "", markdown(shown_label(line)), *cells, *cost_cells(line.cost)]


def shown_label(line: Line) -> str:
    """The label of a line, with the signs of motions that bring gaze, or knew of the scene's boxes."""
    marks = (
        PILCROW if line.gaze else "",
        LOZENGE if line.obstacles else "",
    )
    return " ".join((line.label, *filter(None, marks)))


def _cell(cell: Cell | None) -> str:
    if cell is None:
        return _DASH
    mean = f"{cell.mean:.2f}"
    marked = f"**{mean}**" if cell.leads else mean
    return f"{marked} {cell.interval}".rstrip()


def cost_cells(cost: LineCost) -> tuple[str, str, str]:
    """Seconds and network passes of a motion, memory of a process."""
    seconds = _DASH if cost.seconds is None else f"{cost.seconds:.2f}"
    passes = _DASH if cost.network_passes is None else f"{cost.network_passes:.0f}"
    return seconds, passes, _DASH if cost.memory_mebibytes is None else f"{cost.memory_mebibytes:.0f}"


def as_builtins(layout: TableLayout) -> dict[str, object]:
    """The whole layout with what its numbers mean."""
    return {
        "schema_version": SCHEMA_VERSION,
        "table": "2",
        "metrics": [
            {"id": info.id, "unit": exported_unit(info.unit), "higher_is_better": info.higher_is_better}
            for info in STUDY_METRICS
        ],
        "ranked_from": FEWEST_RANKED,
        **asdict(layout),
    }
