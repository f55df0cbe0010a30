"""``prbench analyse distributions``: twelve features of a run's motions beside those of recorded people.

Source: docs/specification/metrics.md#distributions.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.geometry.skeleton import Joint, head_forward
from prbench.harness.diversity import MotionsToGoal, timing
from prbench.harness.first_run import tables_of_runs
from prbench.harness.intervals import clustered, difference_interval
from prbench.harness.run_folder import RunFolder
from prbench.metrics import MotionBatch
from prbench.metrics.footing import footing, swings
from prbench.protocol.manifests import MetricConstants
from prbench.sequences import SequenceTable
from prbench.tables import Block, Cell, Column, Row, Table
from prbench_benchmarks.prime_and_reach.diversity import Progress, beside_people, rules_of

# Title and unit of each feature by its id.
FEATURES = {
    "head_yaw_rate": ("Head yaw rate, largest", "°/s"),
    "wrist_speed": ("Wrist speed, largest", "m/s"),
    "pelvis_speed": ("Pelvis speed, largest", "m/s"),
    "toe_lift": ("Toe lift of a swing", "m"),
    "swing_time": ("Swing time", "s"),
    "step_length": ("Step length", "m"),
    "wrist_arrival": ("Wrist arrives before the end", "s"),
    "look_to_reach": ("From look to arrival", "s"),
    "trunk_bend": ("Trunk tilt at the goal", "°"),
    "head_pitch": ("Head pitch at the prime time", "°"),
    "path_ratio": ("Way of the pelvis over its distance", "ratio"),
    "jitter": ("Jerk, root mean square", "m/s³"),
}
MOST = 0.15  # KS distance up to which a feature passes
_LEVEL = 0.5  # horizontal part of the head's direction, a unit vector, below which its yaw is not looked at
_DECIMALS = 9  # to which values are rounded, so that equal numbers of frames are equal times
# The recording of each sequence, and its features: recorded people first, then each sample of the method.
_Measured = tuple[list[str], dict[str, Float[np.ndarray, "n samples_and_1"]]]


def distribution_tables(
    runs: Sequence[Path], data: Sequence[Path] = (), *, progress: Progress = lambda *_: None
) -> list[Table]:
    """Compare the features of each run's motions with those of the recorded motions of the same sequences.

    Args:
        runs: Run folders.
        data: Tables of the runs; the embedded ones are known.
        progress: Called after each sequence.

    Returns:
        For each run a table of all its sequences and, of several datasets, one of each.

    Raises:
        RunError: if motions are missing, or a table is another one than the run's.
        TableError: if a table cannot be found.
        PredictionsError: if a motion does not fit its sequence.
    """
    tables = []
    for path in runs:
        run = RunFolder.open(path)
        opened = tables_of_runs([run], data)
        parts = [_measured(run, table, progress) for table in opened]
        recordings = [name for part, _ in parts for name in part]
        together = {name: np.concatenate([values[name] for _, values in parts]) for name in FEATURES}
        shown = [("all datasets", (recordings, together))] if len(parts) > 1 else []
        shown += [(table.info.dataset, part) for table, part in zip(opened, parts, strict=True)]
        tables += [_table(run, dataset, part) for dataset, part in shown]
    return tables


def features(
    motions: MotionsToGoal, prime_time: float, constants: MetricConstants
) -> dict[str, Float[np.ndarray, " k"]]:
    """Measure the twelve features of motions for one goal (docs/specification/metrics.md#distributions).

    Args:
        motions: k motions of one length; canonical frame, metres.
        prime_time: Recorded prime time, seconds after frame 0.
        constants: Thresholds of the protocol, in metres, seconds and degrees.

    Returns:
        The k values by the ids of :data:`FEATURES`; NaN where a motion has no swing, or its pelvis stays within
        ``drag_way`` of its first place.
    """
    joints = motions.joints.astype(np.float64)
    fps = motions.fps
    count, n_frames = joints.shape[:2]
    head, _ = head_forward(joints, motions.head_tilt_deg)
    x, z = head[..., 0], head[..., 2]
    turn = np.arctan2(x[:, 1:] * z[:, :-1] - z[:, 1:] * x[:, :-1], x[:, 1:] * x[:, :-1] + z[:, 1:] * z[:, :-1])
    level = np.hypot(x, z) >= _LEVEL
    wrist = motions.reaching_wrist.astype(np.float64)
    ground = joints[:, :, Joint.PELVIS][..., [0, 2]]
    steps = np.linalg.norm(np.diff(ground, axis=1), axis=-1)
    away = np.linalg.norm(ground - ground[:, :1], axis=-1)
    moments = timing(motions, constants)
    # Posture in the frame in which the wrist is nearest to the goal, and at the prime time.
    nearest = np.linalg.norm(wrist - motions.goal, axis=-1).argmin(axis=1)
    trunk = (joints[:, :, Joint.NECK] - joints[:, :, Joint.PELVIS])[np.arange(count), nearest]
    prime = min(int(np.floor(prime_time * fps + 0.5)), n_frames - 1)
    jerk = np.diff(joints, n=3, axis=1) * fps**3
    # Steps: sums over the swings of both feet.
    batch = MotionBatch.from_motions(list(joints))
    swung = np.zeros((4, count))
    for toe, up, down in swings(batch, footing(batch, np.full(count, fps), constants)):
        place = batch.columns[toe]
        highest = [place[1, first : last + 1].max() for first, last in zip(up, down, strict=True)]
        lift = np.array(highest) - (place[1, up] + place[1, down]) / 2
        length = np.hypot(*(place[:, down] - place[:, up])[[0, 2]])
        np.add.at(swung.T, batch.sequence_of_row[up], np.stack([np.ones(len(up)), lift, (down - up) / fps, length], 1))
    swung = np.where(swung[0] > 0, swung / np.maximum(swung[0], 1), np.nan)
    goes = away.max(axis=1) >= constants.drag_way
    values = {
        "head_yaw_rate": np.rad2deg(np.abs(turn * (level[:, 1:] & level[:, :-1])).max(axis=1)) * fps,
        "wrist_speed": np.linalg.norm(np.diff(wrist, axis=1), axis=-1).max(axis=1) * fps,
        "pelvis_speed": steps.max(axis=1) * fps,
        "toe_lift": swung[1],
        "swing_time": swung[2],
        "step_length": swung[3],
        "wrist_arrival": (n_frames - 1) / fps - moments.wrist_arrival,
        "look_to_reach": moments.wrist_arrival - moments.prime,
        "trunk_bend": np.rad2deg(np.arctan2(np.hypot(trunk[:, 0], trunk[:, 2]), trunk[:, 1])),
        "head_pitch": np.rad2deg(np.arctan2(head[:, prime, 1], np.hypot(x, z)[:, prime])),
        "path_ratio": np.where(goes, steps.sum(axis=1) / np.where(goes, away.max(axis=1), 1.0), np.nan),
        "jitter": np.sqrt((jerk**2).sum(axis=-1).mean(axis=(1, 2))) if n_frames > 3 else np.zeros(count),
    }
    return {name: np.round(values[name], _DECIMALS) for name in FEATURES}


def largest_difference(
    people: Float[np.ndarray, " n"], predicted: Float[np.ndarray, "n samples"]
) -> Float[np.ndarray, " n"]:
    """Return each sequence's part in the Kolmogorov-Smirnov distance: its mean over sequences is the distance.

    At the value where the shares of motions that are at most as large differ most, the part is the share of the
    sequence's motions that are, less 1 if people's is; with the sign that makes the distance positive.
    """
    values = np.unique(np.concatenate([people, predicted.ravel()]))
    ours, theirs = (np.searchsorted(np.sort(x.ravel()), values, side="right") / x.size for x in (predicted, people))
    place = np.abs(ours - theirs).argmax()
    part = (predicted <= values[place]).mean(axis=1) - (people <= values[place])
    return part if ours[place] >= theirs[place] else -part


def _measured(run: RunFolder, table: SequenceTable, progress: Progress) -> _Measured:
    constants = rules_of(run).metrics
    recordings: list[str] = []
    rows = []
    for _, recording, motions, prime_time in beside_people(run, table, progress):
        recordings.append(f"{table.info.dataset}/{recording}")
        rows.append(features(motions, prime_time, constants))
    return recordings, {name: np.stack([row[name] for row in rows]) for name in FEATURES}


def _table(run: RunFolder, dataset: str, measured: _Measured) -> Table:
    recordings = np.array(measured[0], dtype=object)
    about: dict[str, Any] = {"dataset": dataset, "condition": run.record.condition, "method": run.record.method.name}
    rows = []
    for name, (title, unit) in FEATURES.items():
        values = measured[1][name]
        both = np.isfinite(values).all(axis=1)  # without a swing, or a way, a motion has no value
        words = {"feature": title, "unit": unit, "sequences": str(both.sum())}
        if not both.any():
            rows.append(Row(text=words))
            continue
        sides = {"people": values[both, 0], "predicted": values[both, 1:]}
        part = largest_difference(**sides)
        distance, _ = difference_interval(clustered(part, recordings[both], rate=True))
        low = None if distance.low is None else max(distance.low, 0.0)
        about |= {"variant": name, "sequences": distance.n_sequences, "recordings": distance.n_recordings}
        cells = [
            Cell(metric=side, value=float(each.mean()), sd=float(each.std()), unit=unit, **about)
            for side, each in sides.items()
        ]
        cells.append(Cell(metric="ks", value=distance.mean, low=low, high=distance.high, **about))
        of_people, spread = (float(each.std()) for each in sides.values())
        if of_people:
            cells.append(Cell(metric="spread_ratio", value=spread / of_people, unit="ratio", **about))
        words["passes"] = "yes" if distance.mean <= MOST else "no"
        rows.append(Row(text=words, cells=tuple(cells)))
    columns = [Column(key=name, title=name, text=True) for name in ("feature", "unit", "sequences")]
    columns += [Column(key="people", title="people", digits=3), Column(key="predicted", title="method", digits=3)]
    columns += [Column(key="ks", title="KS", better="lower"), Column(key="spread_ratio", title="spread ratio")]
    said = "A feature passes whose KS distance is at most 0.15; the interval is by recording. ± one standard deviation."
    passed = sum(row.text.get("passes") == "yes" for row in rows)
    name = f"{run.path.name}: {run.record.method.name}, condition {run.record.condition}, on {dataset}"
    return Table(
        title=f"{name}: {passed} of {len(FEATURES)} features as recorded people's",
        dataset=dataset,
        columns=(*columns, Column(key="passes", title="passes", text=True)),
        blocks=(Block(rows=tuple(rows)),),
        notes=(said, ON_SYNTHETIC_DATA) if any(table.synthetic for table in run.record.tables) else (said,),
    )
