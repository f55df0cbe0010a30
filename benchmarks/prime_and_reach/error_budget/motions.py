"""One row a motion: the diagnoses of a run's motions, and of the recorded ones of the same sequences."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyarrow as pa

from prbench.errors import RunError
from prbench.harness.agreement import goal_places
from prbench.harness.controls import recorded_through_features
from prbench.harness.run_folder import RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.score_predictions import scored_sequences
from prbench.harness.scoring import COLUMNS, targets_of
from prbench.metrics import MotionBatch, ScoringTargets
from prbench.protocol.manifests import MetricConstants, load_protocol
from prbench.sequences import SequenceTable
from prbench_benchmarks.prime_and_reach.error_budget.bodies import PHASES, diagnose_bodies
from prbench_benchmarks.prime_and_reach.error_budget.looking import PRIMED, diagnose_looking
from prbench_benchmarks.prime_and_reach.error_budget.reaching import REACHED, diagnose_reaching

METHOD = "method"
BESIDE = "beside"
PEOPLE = "people"
FEATURES = "features"
"""Recorded motion through the features that models learn from, and back."""


def diagnosed_motions(run: RunFolder, tables: list[SequenceTable], *, who: str = METHOD) -> pa.Table:
    """Diagnose every motion of a run; of recorded people too, as they are and through the features.

    Args:
        run: With its motions.
        tables: The very tables that it was made on; datasets of the run without a table are left out.
        who: What the run's rows are called; people are diagnosed with :data:`METHOD` alone.

    Returns:
        One row a motion: ``who``, dataset, sequence, recording, sample, the place of the goal, and every field of
        the three diagnoses; ``primed`` and ``reached`` are 0 or 1.

    Raises:
        RunError: if the run keeps no motions.
        PredictionsError: if some are missing or damaged.
    """
    constants = (run.protocol or load_protocol()).metrics
    parts = [part for table in tables for part in _of_table(run, table, constants, who)]
    return pa.concat_tables(parts)


def _of_table(run: RunFolder, table: SequenceTable, constants: MetricConstants, who: str) -> Iterator[pa.Table]:
    folder = run.dataset(table.info.dataset).predictions
    if not any(folder.glob("part-*.parquet")):
        raise RunError(
            f"{folder}: expected the motions of the run, found none. Run the method again, which keeps them."
        )
    predictions = Predictions.open(folder)
    selection = scored_sequences(run, table)
    for _, chunk in selection.windows([*COLUMNS, "prime_gap", "recording_id", "next_joints"]):
        targets = targets_of(chunk, chunk.vectors("goal_location"), None)
        place = {
            "dataset": [table.info.dataset] * len(chunk),
            "sequence_id": chunk.sequence_ids,
            "recording_id": chunk.strings("recording_id"),
            **goal_places(targets.goal_location),
            "prime gap": chunk.numbers("prime_gap"),
        }
        for sample in range(run.record.samples):
            rows = predictions.motions(tuple(chunk.sequence_ids), sample)
            motion = MotionBatch(rows.values, rows.offsets)
            yield _diagnosed(motion, targets, constants, {"who": who, "sample": sample}, place)
        if who == METHOD:
            recorded = MotionBatch(chunk.joints, chunk.offsets)
            yield _diagnosed(recorded, targets, constants, {"who": PEOPLE, "sample": 0}, place)
            decoded = MotionBatch(recorded_through_features(chunk), chunk.offsets)
            yield _diagnosed(decoded, targets, constants, {"who": FEATURES, "sample": 0}, place)


def _diagnosed(
    motion: MotionBatch,
    targets: ScoringTargets,
    constants: MetricConstants,
    label: dict[str, Any],
    place: dict[str, Any],
) -> pa.Table:
    looking = diagnose_looking(motion, targets, constants)
    reaching = diagnose_reaching(motion, targets, constants)
    bodies = diagnose_bodies(motion, targets, constants)
    columns: dict[str, Any] = {name: [value] * motion.n_sequences for name, value in label.items()}
    columns |= place
    columns["primed"] = np.array([cause == PRIMED for cause in looking.cause], dtype=np.float64)
    columns["reached"] = np.array([cause == REACHED for cause in reaching.cause], dtype=np.float64)
    columns |= _fields(looking, "look") | _fields(reaching, "reach")
    columns |= {f"slides_{phase}": bodies.slides_in[phase] for phase in PHASES}
    columns |= {name: getattr(bodies, name) for name in ("skating", "slides", "bone_change", "worst_bone")}
    return pa.table({name: pa.array(values) for name, values in columns.items()})


def _fields(diagnosis: Any, prefix: str) -> dict[str, Any]:
    return {f"{prefix}_{field.name}": getattr(diagnosis, field.name) for field in dataclasses.fields(diagnosis)}
