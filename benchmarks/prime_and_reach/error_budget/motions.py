"""One row a motion: the diagnoses of a run's motions, and of the recorded ones of the same sequences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from prbench.errors import RunError
from prbench.geometry.skeleton import BONES, WRISTS, Joint
from prbench.harness.agreement import goal_places
from prbench.harness.controls import recorded_through_features
from prbench.harness.results import cases_of_run
from prbench.harness.run_folder import RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.scoring import COLUMNS, targets_of
from prbench.metrics import MotionBatch, ScoringTargets
from prbench.metrics.bone_length_change import change_of_each_bone
from prbench.metrics.foot_skating import foot_skating, slow_slides
from prbench.protocol.manifests import MetricConstants, load_protocol
from prbench.sequences import SequenceTable
from prbench_benchmarks.prime_and_reach.error_budget.looking import PRIMED, diagnose_looking

METHOD = "method"
BESIDE = "beside"
PEOPLE = "people"
# Recorded motion through the features that models learn from, and back.
FEATURES = "features"

REACHED = "reached"
FAR = "stands too far"
LEAVES = "comes and leaves"
UNDER_WAY = "under way"
SHORT = "stops short"
# Causes in the order in which they are asked for.
REACH_CAUSES = (REACHED, FAR, LEAVES, UNDER_WAY, SHORT)

_SHOULDERS = (Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER)
_ELBOWS = (Joint.LEFT_ELBOW, Joint.RIGHT_ELBOW)
_LEAVES = 0.05  # metres from its nearest place at which a wrist is said to have left it: half of reach_distance
_APPROACH = 0.1  # m/s towards the goal above which a wrist is said to be under way: standing arms sway below it
_LAST_SECONDS = 0.25  # of the motion, over which that speed is measured
# Up to the recorded prime time; from there to the last second; the last second.
PHASES = ("before", "way", "end")
_END = 1.0  # seconds: the reach itself, when feet should stand


def diagnosed_motions(run: RunFolder, tables: list[SequenceTable], *, who: str = METHOD) -> pa.Table:
    """Diagnose every motion of a run; of recorded people too, as they are and through the features.

    Args:
        run: Run folder that holds its motions.
        tables: The very tables that it was made on; datasets of the run without a table are left out.
        who: What the run's rows are called; people are diagnosed with :data:`METHOD` alone.

    Returns:
        One row a motion: ``who``, dataset, sequence, recording, sample, the place of the goal, and every column of
        the three diagnoses; ``primed`` and ``reached`` are 0 or 1.

    Raises:
        RunError: if the run keeps no motions.
        PredictionsError: if some are missing or damaged.
    """
    constants = (run.protocol or load_protocol()).metrics
    parts = []
    for table in tables:
        folder = run.dataset(table.info.dataset).predictions
        if not any(folder.glob("part-*.parquet")):
            raise RunError(
                f"{folder}: expected the motions of the run, found none. Run the method again, which keeps them."
            )
        predictions = Predictions.open(folder)
        selection = cases_of_run(run, table)[2]
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
                parts.append(_diagnosed(motion, targets, constants, who, sample, place))
            if who == METHOD:
                recorded = MotionBatch(chunk.joints, chunk.offsets)
                parts.append(_diagnosed(recorded, targets, constants, PEOPLE, 0, place))
                decoded = MotionBatch(recorded_through_features(chunk), chunk.offsets)
                parts.append(_diagnosed(decoded, targets, constants, FEATURES, 0, place))
    return pa.concat_tables(parts)


def _diagnosed(
    motion: MotionBatch,
    targets: ScoringTargets,
    constants: MetricConstants,
    who: str,
    sample: int,
    place: Mapping[str, Any],
) -> pa.Table:
    looking = diagnose_looking(motion, targets, constants)
    reaching = diagnose_reaching(motion, targets, constants)
    columns = {
        "who": [who] * motion.n_sequences,
        "sample": [sample] * motion.n_sequences,
        **place,
        "primed": (looking["cause"] == PRIMED).astype(np.float64),
        "reached": (reaching["cause"] == REACHED).astype(np.float64),
        **{f"look_{name}": values for name, values in looking.items()},
        **{f"reach_{name}": values for name, values in reaching.items()},
        **diagnose_bodies(motion, targets, constants),
    }
    return pa.table({name: pa.array(values) for name, values in columns.items()})


def diagnose_reaching(
    motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants
) -> dict[str, np.ndarray]:
    """Find out of each motion why Reach Success counts it or not (docs/error-budget.md#reach-success).

    The cause is the first of these that holds: *reached*; *stands too far*, if shoulder and goal are farther apart than
    the arm is long plus ``reach_distance`` in the frame of the wrist's smallest distance; *comes and leaves*, if the
    nearer wrist ends more than 5 cm farther away than that; *under way*, if it comes nearer by more than 0.1 m/s on
    average over the last quarter of a second; *stops short* otherwise.

    Args:
        motion: Canonical frame, metres.
        targets: Goals and times of the sequences.
        constants: Thresholds of the protocol, in metres, seconds and degrees.

    Returns:
        Columns of one entry a motion: ``cause``; ``smallest``, the smallest distance of either wrist from the goal in
        any frame, metres; ``smallest_before_end``, the time from that frame to the last, seconds; ``final``, the
        distance of the nearer wrist in the last frame, metres; ``slack``, the length of the arm minus the distance of
        its shoulder from the goal in that frame, metres: negative where the arm is too short.
    """
    fps_of = targets.fps_of_sequence
    limit = constants.reach_distance + constants.threshold_tolerance
    found = []
    for row in range(motion.n_sequences):
        joints = motion.values[motion.offsets[row] : motion.offsets[row + 1]].astype(np.float64)
        goal = targets.goal_location[row]
        fps = float(fps_of[row])
        distances = np.linalg.norm(joints[:, WRISTS] - goal, axis=-1)  # (frames, 2)
        frame, side = np.unravel_index(distances.argmin(), distances.shape)
        nearer = distances.min(axis=1)
        smallest = float(distances[frame, side])
        pose = joints[frame]
        upper = np.linalg.norm(pose[_ELBOWS[side]] - pose[_SHOULDERS[side]])
        lower = np.linalg.norm(pose[WRISTS[side]] - pose[_ELBOWS[side]])
        slack = float(upper + lower - np.linalg.norm(pose[_SHOULDERS[side]] - goal))
        steps = min(len(nearer) - 1, max(1, round(_LAST_SECONDS * fps)))
        approach = (nearer[-1 - steps] - nearer[-1]) * fps / max(steps, 1)
        if smallest <= limit:
            cause = REACHED
        elif slack < -constants.reach_distance:
            cause = FAR
        elif nearer[-1] > smallest + _LEAVES:
            cause = LEAVES
        elif approach > _APPROACH:
            cause = UNDER_WAY
        else:
            cause = SHORT
        found.append((cause, smallest, (len(nearer) - 1 - int(frame)) / fps, float(nearer[-1]), slack))
    names = ("cause", "smallest", "smallest_before_end", "final", "slack")
    return {name: np.array(column) for name, column in zip(names, zip(*found, strict=True), strict=True)}


def diagnose_bodies(motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants) -> dict[str, np.ndarray]:
    """Measure sliding feet by phase, and the bone that changes most (docs/error-budget.md#feet-and-bones).

    Args:
        motion: Canonical frame, metres, two frames or more.
        targets: Goals and times of the sequences.
        constants: Thresholds of the protocol, in metres, seconds and degrees.

    Returns:
        Columns of one entry a motion: ``slides_before``, ``slides_way`` and ``slides_end``, the share of the frame
        transitions of each of :data:`PHASES` with a slow slide, NaN where a motion has none in it; ``skating``, Foot
        Skating; ``slides``, the share in the whole motion; ``bone_change``, the largest relative change of a bone's
        length against the first frame, and ``worst_bone``, that bone, such as ``neck-head``.
    """
    fps_of = targets.fps_of_sequence
    found = {phase: np.full(motion.n_sequences, np.nan) for phase in PHASES}
    for row in range(motion.n_sequences):
        fps = float(fps_of[row])
        n = int(motion.n_frames[row])
        end = max(n - 1 - round(_END * fps), 0)
        prime = int(np.clip(round(float(targets.prime_time[row]) * fps), 0, end))
        for phase, first, last in zip(PHASES, (0, prime, end), (prime, end, n - 1), strict=True):
            if last > first:
                part = motion.part(row, row + 1)
                cut = MotionBatch(part.values[first : last + 1], np.array([0, last + 1 - first]))
                found[phase][row] = slow_slides(cut, fps, constants)[0]
    change, _ = change_of_each_bone(motion)
    worst = ["-".join(Joint(joint).name.lower().replace("_", " ") for joint in BONES[b]) for b in change.argmax(axis=0)]
    return {
        **{f"slides_{phase}": values for phase, values in found.items()},
        "skating": foot_skating(motion, fps_of, constants),
        "slides": slow_slides(motion, fps_of, constants),
        "bone_change": change.max(axis=0),
        "worst_bone": np.array(worst),
    }
