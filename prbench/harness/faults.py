"""Looks for what is certainly wrong with motions that are scored, as ``prbench doctor`` does (docs/doctor.md)."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.examinations import OF_THE_CONVERSION, diagnose
from prbench.checking.doctor.motion_set import Diagnosis, Expected
from prbench.contract import GIVEN, Condition
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.planning import Selection
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.scoring import at_table_rate

# Motions of a dataset that are looked at: a fault of the conversion is in all of them, and more would cost as much
# time as the scores themselves.
_LOOKED_AT = 32
# A motion that begins so near to the recorded pose, in metres, was given it, whatever its condition is said to be.
_BEGINS_THERE = 0.05


def certain_faults(
    selection: Selection, predictions: Predictions, *, condition: str, id_seed: int = 0, native_fps: float | None = None
) -> tuple[Diagnosis, ...]:
    """Return what is certainly wrong with the first sample of motions: axes, unit, frame, rate, joints, left and right.

    Args:
        selection: The sequences that are scored.
        predictions: Holds a motion for each of them.
        condition: What the method was given; a motion is compared with the initial pose where that is part of it.
        id_seed: Seed behind the opaque ids, where the predictions have those.
        native_fps: Rate of the predictions; None for the table's.
    """
    # Evenly spread over the table, so that every recording has its share.
    places = np.linspace(0, len(selection) - 1, min(len(selection), _LOOKED_AT)).round().astype(int)
    chosen = selection.chosen(np.isin(np.arange(len(selection)), places))
    salt = run_salt(id_seed, selection.table.identity)
    known = {each.value for each in Condition if "initial_joints" in GIVEN[each]}
    motions = []
    expected = []
    for place, chunk in chosen.windows(["joints", "previous_joints"]):
        ids = chunk.sequence_ids
        rows = predictions.motions(ids if predictions.id_column != "opaque_id" else opaque_ids(ids, salt), 0)
        if native_fps is not None:
            rows = at_table_rate(rows, chosen.n_frames[place], step=native_fps / selection.fps)
        for row, asked in enumerate(chosen.n_frames[place].tolist()):
            motion = rows.values[rows.offsets[row] : rows.offsets[row + 1]].astype(np.float64)
            initial = chunk.joints[chunk.offsets[row]].astype(np.float64)
            previous = chunk.poses("previous_joints")[row].astype(np.float64)
            motions.append(motion)
            if condition in known or np.abs(motion[0] - initial).max() < _BEGINS_THERE:
                expected.append(Expected(initial, previous, asked, selection.fps))
            else:
                expected.append(Expected(None, None, asked, selection.fps))
    found = diagnose(motions, expected, fps=selection.fps, examinations=OF_THE_CONVERSION)
    # Scoring itself refuses another length, unless the user allows it.
    return tuple(each for each in found if each.certain and each.kind != "length")
