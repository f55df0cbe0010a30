"""``nearest-neighbour``: the training motion of the most similar task, laid so that its goal is the given one.

It learns nothing, and shows what a method earns that only recalls training data. For each sequence:

1. Training sequences of the same table are compared by what a condition tells: the distance of the first poses (mean
   over the 22 joints, canonical frame) plus the distance of the goals, metres. The nearest is taken; of equal ones that
   with the smallest id. Its own recording is never searched, so that it may run on the training split, too.
2. The motion is stretched or compressed in time, linearly, to the asked number of frames.
3. It is turned about the vertical through its first pelvis until its goal lies in the given goal's direction, and moved
   over the ground until the two goals stand above one another. Its height stays, because feet belong on the floor.

Steps 2 and 3 keep a recorded body as it was, but for its speed. In return, the first frame is not exactly the given
one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.contract import Motions
from prbench.errors import TableError
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.conditions import ConditionSource
from prbench.harness.planning import WINDOW, Selection, select
from prbench.harness.similar_tasks import at_length, laid_on_goal, read_motions
from prbench.sequences.table import SequenceTable

_TRAINING = "train"


@dataclass(frozen=True)
class _Task:
    """What is asked for: one row a sequence, canonical frame, metres."""

    initial_joints: Float[np.ndarray, "n 22 3"]
    goal_location: Float[np.ndarray, "n 3"]
    recording_ids: tuple[str, ...]


def retrieved_motions(
    selection: Selection, source: ConditionSource, plan: list[Int[np.ndarray, "_"]]
) -> Iterator[Motions]:
    """Yield the motions of each planned batch, in order.

    Args:
        selection: The chosen sequences.
        source: Their conditions.
        plan: Of :func:`prbench.harness.planning.plan_batches`; a batch never crosses a window.

    Raises:
        TableError: if the table has no training sequences, or none of another recording.
    """
    training = _training_rows(selection.table)
    known = ConditionSource.read(training)
    searched = _Task(known.initial_joints, known.goal_location, training.recording_ids)
    wanted = _Task(source.initial_joints, source.goal_location, selection.recording_ids)
    nearest = _nearest(wanted, searched, selection.table)
    place = -1
    motions: dict[str, np.ndarray] = {}
    for rows in plan:
        if int(rows[0]) // WINDOW != place:
            # Only the motions of one window are held in memory.
            place = int(rows[0]) // WINDOW
            window = nearest[place * WINDOW : (place + 1) * WINDOW]
            ids = frozenset(training.sequence_ids[row] for row in window)
            motions = read_motions(selection.table, ids, split=_TRAINING)
        n_frames = source.n_frames[rows]
        joints = np.zeros((len(rows), int(n_frames.max()), N_JOINTS, 3), dtype=np.float32)
        for i, row in enumerate(rows):
            found = int(nearest[row])
            motion = at_length(motions[training.sequence_ids[found]], int(n_frames[i]))
            joints[i, : n_frames[i]] = laid_on_goal(motion, known.goal_location[found], source.goal_location[row])
        yield Motions(joints, n_frames)


def _training_rows(table: SequenceTable) -> Selection:
    if not table.scalars(split=_TRAINING, columns=["split"]).num_rows:
        raise TableError(
            f"{table.folder}: expected training sequences, which nearest-neighbour retrieves from, found none in split"
            f" '{_TRAINING}'. Build more recordings, or leave this control out."
        )
    return select(table, split=_TRAINING, limit=None)


def _nearest(wanted: _Task, searched: _Task, table: SequenceTable) -> Int[np.ndarray, " n"]:
    """Row of the most similar task of another recording, for each wanted one."""
    recordings = np.array(searched.recording_ids, dtype=object)
    nearest = np.zeros(len(wanted.recording_ids), dtype=np.int64)
    for row, recording in enumerate(wanted.recording_ids):
        poses = np.linalg.norm(searched.initial_joints - wanted.initial_joints[row], axis=-1).mean(axis=-1)
        goals = np.linalg.norm(searched.goal_location - wanted.goal_location[row], axis=-1)
        distance = np.where(recordings == recording, np.inf, poses + goals)
        nearest[row] = distance.argmin()
        if not np.isfinite(distance[nearest[row]]):
            raise TableError(
                f"{table.folder}: expected training sequences of another recording than {recording}, found none."
                " Build more recordings, or leave nearest-neighbour out."
            )
    return nearest
