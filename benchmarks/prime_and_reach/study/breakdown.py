"""Figure 4: scores of runs by what a sequence asks for, such as picking against putting.

Each group's interval is that of the protocol, over the recordings of its sequences. Groups are other sequences, so
neither their means nor their intervals are a comparison of methods.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow.compute as pc

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.errors import UsageError
from prbench.harness.clusters import FEWEST_FOR_BOARD
from prbench.harness.intervals import metric_interval
from prbench.harness.run_folder.scores import read_scores
from prbench.metrics import MAIN_METRICS
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell
from prbench_benchmarks.prime_and_reach.study.genuine import GenuineRun
from prbench_benchmarks.prime_and_reach.study.methods import METRIC_COLUMNS
from prbench_benchmarks.prime_and_reach.study.sizes import origin_of

# What sequences can be grouped by, and the column of the table that says it.
GROUPINGS = {"action": "action", "hand": "hand", "kind": "prime_kind"}


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
            if (cells[0].recordings or 0) < FEWEST_FOR_BOARD:
                few[group] = None
            words = {"group": group, "counts": f"{cells[0].sequences} ({cells[0].recordings})"}
            rows.append(Row(text=words, cells=tuple(cells)))
        word = ", measured on synthetic data" if run.record.synthetic else ""
        blocks.append(Block(title=f"{run.title}{word}", rows=tuple(rows)))
    notes = ["Rates in %, lengths in m; 95 % intervals over the recordings of each group in brackets."]
    if few:
        notes.append(f"Cannot be decided, with fewer than {FEWEST_FOR_BOARD} recordings: {', '.join(few)}.")
    notes.append("The study prints no numbers for its Figure 4, so that nothing published stands beside.")
    if any(run.record.synthetic for run in runs):
        notes.append(ON_SYNTHETIC_DATA)
    counts = Column(key="counts", title="Sequences (recordings)")
    columns = (Column(key="group", title=by, text=True), counts, *METRIC_COLUMNS)
    about = {"number": "of Figure 4", "title": f"scores by {by}"}
    return Table(**about, columns=columns, blocks=tuple(blocks), notes=tuple(notes))


def _scored_groups(run: GenuineRun, by: str) -> dict[str, list[Cell]]:
    """Map each group of sequences that a run has, by name, to its metrics."""
    rows = run.table.scalars()
    ids = rows["sequence_id"].to_pylist()
    words = [value or "unknown" for value in rows[GROUPINGS[by]].to_pylist()]
    group_of = dict(zip(ids, words, strict=True))
    names = sorted(set(words))
    recording_of = dict(zip(ids, rows["recording_id"].to_pylist(), strict=True))
    scores = read_scores(run.run.dataset(run.record.dataset).scores)
    method = run.run.record.method
    about: dict[str, Any] = {"dataset": run.record.dataset, "condition": run.run.record.condition}
    about |= {"method": method.name, "origin": origin_of(synthetic=run.record.synthetic)}
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
            bounds = (estimate.mean, estimate.low, estimate.high)
            counts = {"sequences": estimate.n_sequences, "recordings": estimate.n_recordings}
            said = {"variant": f"{by}: {name}", "note": "; ".join(estimate.marks)}
            found[name].append(metric_cell(info.id, info.unit, *bounds, **about, **counts, **said))
    return {name: cells for name, cells in found.items() if cells}
