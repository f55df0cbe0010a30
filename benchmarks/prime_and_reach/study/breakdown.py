"""Figure 4: scores of runs by what a sequence asks for, such as picking against putting.

Each group's interval is that of the protocol, over the recordings of its sequences. Groups are other sequences, so
neither their means nor their intervals are a comparison of methods.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pyarrow.compute as pc

from prbench.errors import UsageError
from prbench.geometry.skeleton import Joint
from prbench.harness.clusters import FEWEST_FOR_TEST
from prbench.harness.intervals import Estimate, metric_interval
from prbench.harness.run_folder.scores import read_scores
from prbench.metrics import MAIN_METRICS, MetricInfo, exported_unit
from prbench.sequences import SequenceTable
from prbench_benchmarks.prime_and_reach.study.document import (
    DASH,
    MEASURED,
    SYNTHETIC,
    StudyBlock,
    StudyTable,
    StudyValue,
    interval_text,
)
from prbench_benchmarks.prime_and_reach.study.genuine import GenuineRun
from prbench_benchmarks.prime_and_reach.study.settings import load_study_settings
from prbench_benchmarks.prime_and_reach.study.sizes import SYNTHETIC_NOTE
from prbench_benchmarks.prime_and_reach.table_two.layout import metric_title

_START_COLUMNS = ["goal_location", "joints"]


@dataclass(frozen=True)
class GroupScore:
    """One metric of one group of sequences of one run."""

    run: GenuineRun
    group: str
    info: MetricInfo
    estimate: Estimate
    """As stored: rates from 0 to 1."""


def break_down(runs: Sequence[GenuineRun], by: str) -> list[GroupScore]:
    """Score each group of sequences of each run.

    Args:
        runs: Whose scores were held against their motions.
        by: A key of :data:`GROUPINGS`.

    Raises:
        UsageError: for an unknown grouping.
    """
    if by not in GROUPINGS:
        raise UsageError(f"--by: unknown '{by}'; the groupings are: {', '.join(GROUPINGS)}.")
    found = []
    for run in runs:
        groups = GROUPINGS[by](run.table)
        rows = run.table.scalars()
        recording_of = dict(zip(rows["sequence_id"].to_pylist(), rows["recording_id"].to_pylist(), strict=True))
        scores = read_scores(run.run.dataset(run.record.dataset).scores)
        hidden = run.run.record.method.motionless
        for info in MAIN_METRICS:
            if hidden and info.irrelevant_if_motionless:
                continue
            part = scores.filter(pc.field("metric") == info.id)
            ids = np.array(part["sequence_id"].to_pylist(), dtype=object)
            values = part["value"].to_numpy()
            group_of = np.array([groups[name] for name in ids], dtype=object)
            recordings = np.array([recording_of[name] for name in ids], dtype=object)
            for group in _ordered(groups, set(group_of)):
                chosen = group_of == group
                estimate = metric_interval(info, values[chosen], recordings[chosen].tolist(), ids[chosen].tolist())
                found.append(GroupScore(run, group, info, estimate))
    return found


def breakdown_table(scores: Sequence[GroupScore], by: str) -> StudyTable:
    """Make the numbers of Figure 4 a table: a row for each group, a block for each run."""
    blocks = []
    for run in dict.fromkeys(one.run for one in scores):
        rows = []
        own = [one for one in scores if one.run is run]
        for group in dict.fromkeys(one.group for one in own):
            cells = {one.info.id: one.estimate for one in own if one.group == group}
            first = next(iter(cells.values()))
            counts = f"{first.n_sequences} ({first.n_recordings})"
            rows.append((group, counts, *(_cell(cells.get(info.id), info) for info in MAIN_METRICS)))
        word = ", measured on synthetic data" if run.record.synthetic else ""
        blocks.append(StudyBlock(f"{run.title}{word}", tuple(rows)))
    synthetic = any(one.run.record.synthetic for one in scores)
    few = dict.fromkeys(one.group for one in scores if one.estimate.n_recordings < FEWEST_FOR_TEST)
    return StudyTable(
        number="of Figure 4",
        title=f"scores by {by}",
        header=(by, "Sequences (recordings)", *(metric_title(info) for info in MAIN_METRICS)),
        blocks=tuple(blocks),
        values=tuple(_value(one, by) for one in scores),
        notes=(
            "Rates in %, lengths in m; 95 % intervals over the recordings of each group in brackets.",
            *((f"Cannot be decided, with fewer than {FEWEST_FOR_TEST} recordings: {', '.join(few)}.",) if few else ()),
            "The study prints no numbers for its Figure 4, so that nothing published stands beside.",
            *((SYNTHETIC_NOTE,) if synthetic else ()),
        ),
    )


def _cell(estimate: Estimate | None, info: MetricInfo) -> str:
    if estimate is None:
        return DASH
    low, high = (None if bound is None else info.scale * bound for bound in (estimate.low, estimate.high))
    return interval_text(info.scale * estimate.mean, low, high)


def _value(one: GroupScore, by: str) -> StudyValue:
    estimate = one.estimate
    scale = one.info.scale
    return StudyValue(
        dataset=one.run.record.dataset,
        condition=one.run.run.record.condition,
        method=one.run.run.record.method.name,
        variant=f"{by}: {one.group}",
        metric=one.info.id,
        value=scale * estimate.mean,
        low=None if estimate.low is None else scale * estimate.low,
        high=None if estimate.high is None else scale * estimate.high,
        unit=exported_unit(one.info.unit),
        sequences=estimate.n_sequences,
        recordings=estimate.n_recordings,
        origin=SYNTHETIC if one.run.record.synthetic else MEASURED,
        note="; ".join(estimate.marks),
    )


def _ordered(groups: Mapping[str, str], there: set[str]) -> list[str]:
    """Return the groups that occur: numbers by size, words by name."""
    names = list(dict.fromkeys(groups.values()))
    return [name for name in sorted(names, key=_place) if name in there]


def _place(group: str) -> tuple[float, str]:
    first = group.removeprefix("below ").split()[0]
    try:
        # "below 1.0" comes before "1.0 to 2.0", which begins with the same number.
        return float(first) - group.startswith("below "), group
    except ValueError:
        return -np.inf, group


def _by_column(name: str) -> Callable[[SequenceTable], dict[str, str]]:
    def groups(table: SequenceTable) -> dict[str, str]:
        rows = table.scalars()
        words = [value or "unknown" for value in rows[name].to_pylist()]
        return dict(zip(rows["sequence_id"].to_pylist(), words, strict=True))

    return groups


def _by_gap(table: SequenceTable) -> dict[str, str]:
    rows = table.scalars()
    gaps = rows["prime_gap"].to_numpy()
    edges = load_study_settings().figure_4.gap_edges
    return dict(zip(rows["sequence_id"].to_pylist(), _binned(gaps, edges, "s"), strict=True))


def _by_distance(table: SequenceTable) -> dict[str, str]:
    ids, offsets, _ = _starts(table)
    distance = np.hypot(offsets[:, 0], offsets[:, 2])
    return dict(zip(ids, _binned(distance, load_study_settings().figure_4.distance_edges, "m"), strict=True))


def _by_bearing(table: SequenceTable) -> dict[str, str]:
    ids, offsets, _ = _starts(table)
    # In the canonical frame the body faces +Z in its first frame.
    bearing = np.abs(np.rad2deg(np.arctan2(offsets[:, 0], offsets[:, 2])))
    return dict(zip(ids, _binned(bearing, load_study_settings().figure_4.bearing_edges, "deg"), strict=True))


def _by_height(table: SequenceTable) -> dict[str, str]:
    ids, _, heights = _starts(table)
    return dict(zip(ids, _binned(heights, load_study_settings().figure_4.height_edges, "m"), strict=True))


def _starts(table: SequenceTable) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Ids, offsets from the first frame's pelvis to the goal (n, 3), and heights of the goal (n,); metres."""
    ids: list[str] = []
    offsets = []
    heights = []
    for chunk in table.chunks(columns=_START_COLUMNS):
        goal = chunk.vectors("goal_location")
        ids += chunk.sequence_ids
        offsets.append(goal - chunk.joints[chunk.offsets[:-1], Joint.PELVIS])
        heights.append(goal[:, 1])
    return ids, np.concatenate(offsets), np.concatenate(heights)


def _binned(values: np.ndarray, edges: Sequence[float], unit: str) -> list[str]:
    """Name the bin of each value; an edge belongs to the bin above it."""
    names = [f"below {edges[0]:g} {unit}"]
    names += [f"{low:g} to {high:g} {unit}" for low, high in pairwise(edges)]
    names.append(f"{edges[-1]:g} {unit} and more")
    return [names[place] for place in np.searchsorted(np.asarray(edges), values, side="right")]


GROUPINGS: dict[str, Callable[[SequenceTable], dict[str, str]]] = {
    "action": _by_column("action"),
    "hand": _by_column("hand"),
    "kind": _by_column("prime_kind"),
    "distance": _by_distance,
    "bearing": _by_bearing,
    "height": _by_height,
    "gap": _by_gap,
}
"""What sequences are grouped by; each function maps the ids of a table to names of groups."""
