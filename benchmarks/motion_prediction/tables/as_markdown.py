"""The tables, and what gaze is worth, as Markdown and as values for JSON. Metres, as the study prints them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from prbench.harness.clusters import SIGNIFICANCE
from prbench.harness.intervals import Comparison, Estimate
from prbench.shown import markdown
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.published_numbers import PUBLISHED_METRICS
from prbench_benchmarks.motion_prediction.tables.gaze_value import ValueOfCondition
from prbench_benchmarks.motion_prediction.tables.layout import Line, PredictionLayout, Step, Table, per_joint

SCHEMA_VERSION = 1
_DASH = "–"
_TITLES = tuple(metric.upper() for metric in PUBLISHED_METRICS)
_TOLD = ("ade", "ade_mean", "wrist_to_goal", "wrist_to_goal_mean")
"""Metrics whose value of gaze is printed; all stand in the JSON file."""


def as_markdown(layout: PredictionLayout, values: Sequence[ValueOfCondition]) -> str:
    """Return the whole document."""
    parts = ["# Motion prediction", markdown(heading(layout))]
    for table in layout.tables:
        parts += [f"## Table {table.number}: {markdown(table.title)}", _grid(table, layout)]
        if table.order:
            parts.append(markdown(order(table)))
    if values:
        header = ("method", "windows", "metric", "told", "difference, m", "p")
        rows = [(each.method, *value_cells(each)) for each in told(values)]
        parts += ["## What the head and gaze are worth", _markdown_table(header, rows)]
    parts.append("\n".join(f"- {markdown(note)}" for note in notes(layout)))
    return "\n\n".join(parts) + "\n"


def heading(layout: PredictionLayout) -> str:
    """Which windows were scored."""
    return (
        f"{layout.dataset}, {layout.joint_set}: {layout.n_windows} windows of {layout.n_recordings} recordings and"
        f" {layout.n_participants} participants, {layout.split}, K = {layout.n_samples}"
    )


def columns(layout: PredictionLayout) -> tuple[str, ...]:
    """Header of a table."""
    printed = (f"{title} printed ({dataset})" for dataset in layout.shown_datasets for title in _TITLES)
    return ("Method", *_TITLES, *printed)


def cells(line: Line, layout: PredictionLayout) -> tuple[str, ...]:
    """One row of a table; a dash stands for a number that is not there."""
    measured = (shown(line.measured.get(metric)) for metric in PUBLISHED_METRICS)
    printed = (
        scores[metric].printed if metric in scores else _DASH
        for dataset in layout.shown_datasets
        for scores in [line.published.get(dataset, {})]
        for metric in PUBLISHED_METRICS
    )
    return (line.row.label, *measured, *printed)


def shown(estimate: Estimate | None) -> str:
    """A mean with its interval, metres."""
    if estimate is None:
        return _DASH
    interval = "" if estimate.low is None else f" [{estimate.low:.3f}, {estimate.high:.3f}]"
    return f"{estimate.mean:.3f}{interval}"


def order(table: Table) -> str:
    """The measured methods from the best to the worst, with the difference at each step."""
    return f"By ADE: {table.order[0].better}" + "".join(f" < {each.worse} ({_step(each)})" for each in table.order)


def _step(step: Step) -> str:
    p_value = step.comparison.adjusted_p_value
    supported = p_value is not None and p_value <= SIGNIFICANCE
    return f"{_difference(step.comparison.difference)}{'' if supported else ', not supported by the data'}"


def _difference(estimate: Estimate) -> str:
    interval = "" if estimate.low is None else f" [{estimate.low:+.3f}, {estimate.high:+.3f}]"
    return f"{estimate.mean:+.3f}{interval}"


def told(values: Sequence[ValueOfCondition]) -> tuple[ValueOfCondition, ...]:
    """The values that are printed; all of them stand in the JSON file."""
    return tuple(each for each in values if each.metric in _TOLD)


def value_cells(value: ValueOfCondition) -> tuple[str, ...]:
    """One value of a condition: windows, metric, what is told besides, difference, p-value."""
    adjusted = value.comparison.adjusted_p_value
    p_value = _DASH if adjusted is None else f"{adjusted:.3f}"
    step = f"{value.less.value} → {value.more.value}"
    return value.anchor, value.metric, step, _difference(value.comparison.difference), p_value


def notes(layout: PredictionLayout) -> Iterable[str]:
    """Yield the notes that a reader needs, one sentence or two each."""
    yield "Metres over the flattened pose; 95 % intervals over recordings in brackets. Less is better."
    yield (
        f"A distance over {layout.n_joints} joints is √{layout.n_joints} = {1 / per_joint(1.0, layout.n_joints):.2f}"
        " times a joint's root mean square; compare other joint sets after dividing by that (MoGaze's study has 21"
        " joints, GIMO's 23)."
    )
    if not layout.comparable:
        yield "The printed numbers are of other recordings: they show the study's order, and are not to be compared."
    if layout.estimated_bodies:
        yield (
            "The bodies were estimated from whole tracks of the head: the numbers are agreement with an estimate, and"
            " never enter one mean with captured bodies."
        )
    yield "Ground truth and truncation floor know the future; they are no methods and are not ranked."
    seen = set()
    for line in (line for table in layout.tables for line in table.lines):
        if line.missing and line.row.name not in seen:
            yield f"{line.row.label}: {line.missing}"
        if _is_one_design(line, layout.n_samples) and line.row.name not in seen:
            yield (
                f"{line.row.label}: its {layout.n_samples} samples are one design, of which fewer are no part, so it"
                " has no scores of fewer."
            )
        seen.add(line.row.name)
        for dataset in layout.shown_datasets:
            odd = dict.fromkeys(each.note for each in line.published.get(dataset, {}).values() if each.note)
            yield from (f"{line.row.label}, printed for {dataset}: {note}" for note in odd)


def _is_one_design(line: Line, n_samples: int) -> bool:
    """Return True for a row that was scored with all of its samples and with none of the smaller numbers."""
    smaller = [n for n in load_prediction_protocol().evaluation.samples if n < n_samples]
    return bool(line.measured and smaller) and not any(f"ade@k{n}" in line.measured for n in smaller)


def _grid(table: Table, layout: PredictionLayout) -> str:
    return _markdown_table(columns(layout), [cells(line, layout) for line in table.lines])


def _markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(markdown(cell) for cell in line)} |" for line in lines)


def as_builtins(layout: PredictionLayout, values: Sequence[ValueOfCondition]) -> dict[str, Any]:
    """All numbers, those that are not printed too, for JSON."""
    return {
        "schema_version": SCHEMA_VERSION,
        "dataset": layout.dataset,
        "joint_set": layout.joint_set,
        "n_joints": layout.n_joints,
        "estimated_bodies": layout.estimated_bodies,
        "split": layout.split,
        "windows": layout.n_windows,
        "recordings": layout.n_recordings,
        "participants": layout.n_participants,
        "samples": layout.n_samples,
        "tables": [
            {
                "table": table.number,
                "title": table.title,
                "section": table.section,
                "lines": [_line(line) for line in table.lines],
                "order": [
                    {
                        "better": step.better,
                        "worse": step.worse,
                        **_numbers(step.comparison),
                    }
                    for step in table.order
                ],
            }
            for table in layout.tables
        ],
        "values": [
            {
                "method": each.method,
                "anchor": each.anchor,
                "metric": each.metric,
                "less": each.less.value,
                "more": each.more.value,
                **_numbers(each.comparison),
            }
            for each in values
        ],
        "notes": list(notes(layout)),
    }


def _line(line: Line) -> dict[str, Any]:
    return {
        "label": line.row.label,
        "name": line.row.name,
        "method": line.row.method,
        "condition": line.row.condition.value,
        "missing": line.missing,
        "measured": {name: asdict(each) for name, each in line.measured.items()},
        "published": {
            dataset: {metric: each.value for metric, each in scores.items()}
            for dataset, scores in line.published.items()
        },
    }


def _numbers(comparison: Comparison) -> dict[str, Any]:
    return {
        **asdict(comparison.difference),
        "p_value": comparison.p_value,
        "adjusted_p_value": comparison.adjusted_p_value,
    }
