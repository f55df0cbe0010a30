"""Figure 4: scores of runs by what a sequence asks for, such as picking against putting.

Each group's interval is that of the protocol, over the recordings of its sequences. Groups are other sequences, so
neither their means nor their intervals are a comparison of methods.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pyarrow.compute as pc

from prbench.errors import UsageError
from prbench.geometry.skeleton import Joint
from prbench.harness.clusters import FEWEST_FOR_TEST
from prbench.harness.intervals import metric_interval
from prbench.harness.run_folder.scores import read_scores
from prbench.metrics import MAIN_METRICS
from prbench.sequences import SequenceTable
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell
from prbench_benchmarks.prime_and_reach.study.genuine import GenuineRun, load_study_settings
from prbench_benchmarks.prime_and_reach.study.methods import METRIC_COLUMNS
from prbench_benchmarks.prime_and_reach.study.sizes import SYNTHETIC_NOTE, origin_of

_WORDS = {"action": "action", "hand": "hand", "kind": "prime_kind"}
"""Columns of words that sequences are grouped by."""
_UNITS = {"distance": "m", "bearing": "deg", "height": "m", "gap": "s"}
"""Quantities that sequences are grouped by, and their units; the edges stand in ``study.toml``."""
GROUPINGS = (*_WORDS, *_UNITS)
"""What sequences can be grouped by."""


def breakdown_table(runs: Sequence[GenuineRun], by: str) -> Table:
    """Score each group of sequences of each run: a row for each group, a block for each run.

    Args:
        runs: Whose scores were held against their motions.
        by: One of :data:`GROUPINGS`.

    Raises:
        UsageError: for an unknown grouping.
    """
    if by not in GROUPINGS:
        raise UsageError(f"--by: unknown '{by}'; the groupings are: {', '.join(GROUPINGS)}.")
    blocks = []
    few: dict[str, None] = {}
    for run in runs:
        rows = []
        for group, cells in _scored_groups(run, by).items():
            if cells[0].recordings < FEWEST_FOR_TEST:
                few[group] = None
            rows.append(
                Row(
                    text={"group": group, "counts": f"{cells[0].sequences} ({cells[0].recordings})"}, cells=tuple(cells)
                )
            )
        word = ", measured on synthetic data" if run.record.synthetic else ""
        blocks.append(Block(title=f"{run.title}{word}", rows=tuple(rows)))
    notes = ["Rates in %, lengths in m; 95 % intervals over the recordings of each group in brackets."]
    if few:
        notes.append(f"Cannot be decided, with fewer than {FEWEST_FOR_TEST} recordings: {', '.join(few)}.")
    notes.append("The study prints no numbers for its Figure 4, so that nothing published stands beside.")
    if any(run.record.synthetic for run in runs):
        notes.append(SYNTHETIC_NOTE)
    return Table(
        number="of Figure 4",
        title=f"scores by {by}",
        columns=(
            Column(key="group", title=by, text=True),
            Column(key="counts", title="Sequences (recordings)"),
            *METRIC_COLUMNS,
        ),
        blocks=tuple(blocks),
        notes=tuple(notes),
    )


def _scored_groups(run: GenuineRun, by: str) -> dict[str, list[Cell]]:
    """Map each group of sequences that a run has, in printed order, to its metrics."""
    group_of, names = groups_of(run.table, by)
    rows = run.table.scalars()
    recording_of = dict(zip(rows["sequence_id"].to_pylist(), rows["recording_id"].to_pylist(), strict=True))
    scores = read_scores(run.run.dataset(run.record.dataset).scores)
    method = run.run.record.method
    found: dict[str, list[Cell]] = {name: [] for name in names}
    for info in MAIN_METRICS:
        if method.motionless and info.irrelevant_if_motionless:
            continue
        part = scores.filter(pc.field("metric") == info.id)
        ids = np.array(part["sequence_id"].to_pylist(), dtype=object)
        values = part["value"].to_numpy()
        groups = np.array([group_of[name] for name in ids], dtype=object)
        recordings = np.array([recording_of[name] for name in ids], dtype=object)
        for name in names:
            chosen = groups == name
            if not chosen.any():
                continue
            estimate = metric_interval(info, values[chosen], recordings[chosen].tolist(), ids[chosen].tolist())
            cell = metric_cell(
                info.id,
                info.unit,
                estimate.mean,
                estimate.low,
                estimate.high,
                dataset=run.record.dataset,
                condition=run.run.record.condition,
                method=method.name,
                variant=f"{by}: {name}",
                sequences=estimate.n_sequences,
                recordings=estimate.n_recordings,
                origin=origin_of(synthetic=run.record.synthetic),
                note="; ".join(estimate.marks),
            )
            found[name].append(cell)
    return {name: cells for name, cells in found.items() if cells}


def groups_of(table: SequenceTable, by: str) -> tuple[dict[str, str], list[str]]:
    """Return the group of each sequence of a table, and all groups: numbers by size, words by name."""
    rows = table.scalars()
    ids = rows["sequence_id"].to_pylist()
    if by in _WORDS:
        words = [value or "unknown" for value in rows[_WORDS[by]].to_pylist()]
        return dict(zip(ids, words, strict=True)), sorted(set(words))
    if by == "gap":
        values = rows["prime_gap"].to_numpy()
    else:
        ids = []
        parts = []
        for chunk in table.chunks(columns=["goal_location", "joints"]):
            goal = chunk.vectors("goal_location")
            ids += chunk.sequence_ids
            x, _, z = (goal - chunk.joints[chunk.offsets[:-1], Joint.PELVIS]).T
            if by == "distance":
                parts.append(np.hypot(x, z))
            elif by == "bearing":  # in the canonical frame the body faces +Z in its first frame
                parts.append(np.abs(np.rad2deg(np.arctan2(x, z))))
            else:
                parts.append(goal[:, 1])
        values = np.concatenate(parts)
    unit = _UNITS[by]
    edges = load_study_settings().figure_4[f"{by}_edges"]
    names = [f"below {edges[0]:g} {unit}"]
    names += [f"{low:g} to {high:g} {unit}" for low, high in pairwise(edges)]
    names.append(f"{edges[-1]:g} {unit} and more")
    # An edge belongs to the bin above it.
    places = np.searchsorted(np.asarray(edges), values, side="right")
    return dict(zip(ids, [names[place] for place in places], strict=True)), names
