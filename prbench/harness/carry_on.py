"""Puts that carry on from generated picks, so that both are one motion (docs/specification/carry-on.md)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from prbench.contract import Condition, Gaze, Motions
from prbench.errors import UsageError
from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.harness.best_of import WITH_GOAL
from prbench.harness.conditions import ConditionSource
from prbench.harness.pairs import COLUMNS, Pair, find_pairs
from prbench.harness.planning import Selection
from prbench.harness.run_folder.coded_scores import CodedScores
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.rates_of_people import CarriedOn


@dataclass(frozen=True, eq=False)
class Carrying:
    """The pairs of a selection of which both sequences were chosen, and where their frames stand in the world."""

    pairs: tuple[Pair, ...]
    picks: Int[np.ndarray, " pairs"]
    """Places of the picks in the selection."""
    puts: Int[np.ndarray, " pairs"]
    world_from_canonical: Float[np.ndarray, "n 4 4"]
    """Of every sequence of the selection."""

    @classmethod
    def of(cls, selection: Selection) -> Carrying:
        """Find the pairs of a selection."""
        place = {name: row for row, name in enumerate(selection.sequence_ids)}
        rows = selection.table.scalars(split=selection.split, columns=COLUMNS)
        pairs = tuple(pair for pair in find_pairs(rows) if pair.pick in place and pair.put in place)
        parts = [
            chunk.vectors("world_from_canonical").reshape(-1, 4, 4)
            for _, chunk in selection.windows(["world_from_canonical"])
        ]
        return cls(
            pairs,
            np.array([place[pair.pick] for pair in pairs], dtype=np.int64),
            np.array([place[pair.put] for pair in pairs], dtype=np.int64),
            np.concatenate([np.empty((0, 4, 4)), *parts]),
        )

    def source(
        self, source: ConditionSource, predictions: Predictions, sample: int
    ) -> tuple[ConditionSource, Float[np.ndarray, "n 4 4"]]:
        """Let every put start in the last pose of its pick's motion, with the velocity that this ends with.

        Args:
            source: Makings of the conditions of the selection.
            predictions: Motions of all picks.
            sample: Index of the motions that are carried on.

        Returns:
            The makings, in which the frame of a put is that of its new first pose, with the floor of its pick; and for
            each sequence the transform from its new frame into the frame of the table.
        """
        initial, previous = source.initial_joints.copy(), source.previous_joints.copy()
        goals, goal_poses = source.goal_location.copy(), source.goal_joints.copy()
        placements = np.repeat(np.eye(4)[None], len(source.sequence_ids), axis=0)
        rows = predictions.motions([pair.pick for pair in self.pairs], sample)
        for number, (pick, put) in enumerate(zip(self.picks.tolist(), self.puts.tolist(), strict=True)):
            last = int(rows.offsets[number + 1]) - 1
            end, before = rows.values[last].astype(np.float64), rows.values[last - 1].astype(np.float64)
            pick_from_new = canonical_frame(end[None])
            pick_from_new[1, 3] = 0.0  # the floor is the pick's, wherever the last pose has its feet
            new_from_pick = invert_rigid(pick_from_new)
            new_from_put = new_from_pick @ self.pick_from_put(pick, put)
            initial[put] = transform_points(new_from_pick, end)
            previous[put] = transform_points(new_from_pick, before)
            goals[put] = transform_points(new_from_put, goals[put].astype(np.float64))
            goal_poses[put] = transform_points(new_from_put, goal_poses[put].astype(np.float64))
            placements[put] = invert_rigid(new_from_put)
        carried = dataclasses.replace(
            source, initial_joints=initial, previous_joints=previous, goal_location=goals, goal_joints=goal_poses
        )
        if source.obstacles is not None:
            moved = [
                source.obstacles.part(row, row + 1).placed(invert_rigid(placements[row]))
                for row in range(len(source.sequence_ids))
            ]
            carried = dataclasses.replace(carried, obstacles=type(source.obstacles).joined(moved))
        return carried, placements

    def pick_from_put(self, pick: int, put: int) -> Float[np.ndarray, "4 4"]:
        """Map the frame of one sequence of the selection into that of another of its recording."""
        return invert_rigid(self.world_from_canonical[pick]) @ self.world_from_canonical[put]


def whole_pairs(selection: Selection) -> Selection:
    """The sequences of a selection that are in a pair of which both were chosen."""
    carrying = Carrying.of(selection)
    keep = np.zeros(len(selection), dtype=bool)
    keep[carrying.picks] = keep[carrying.puts] = True
    return selection.chosen(keep)


def require_goal_to_carry(condition: Condition) -> None:
    """Refuse to carry on under a condition that gives no first pose and no goal.

    Raises:
        UsageError: naming the conditions that do.
    """
    if condition not in WITH_GOAL:
        known = " or ".join(item.value for item in WITH_GOAL)
        raise UsageError(
            f"--carry-on: a put starts in the pose in which the generated pick ends, and the condition"
            f" '{condition.value}' gives a method no first pose. Choose --condition {known}, or leave --carry-on out."
        )


def placed(motions: Motions, placements: Float[np.ndarray, "batch 4 4"]) -> Motions:
    """Motions in other frames, row by row.

    Args:
        motions: Metres.
        placements: Map each row's frame into the one that is wanted.
    """
    joints = _placed_points(motions.joints, placements)
    gaze = None
    if motions.gaze is not None:
        direction = np.einsum("bij,bfj->bfi", placements[:, :3, :3], motions.gaze.direction.astype(np.float64))
        gaze = Gaze(_placed_points(motions.gaze.origin, placements), direction.astype(np.float32))
    return dataclasses.replace(motions, joints=joints, gaze=gaze)


def _placed_points(
    points: Float[np.ndarray, "batch *points 3"], placements: Float[np.ndarray, "batch 4 4"]
) -> Float[np.ndarray, "batch *points 3"]:
    rows = zip(placements, points, strict=True)
    return np.stack([transform_points(place, own.astype(np.float64)) for place, own in rows]).astype(np.float32)


def measure_carried(
    selection: Selection, predictions: Path, scores: CodedScores, *, samples: Sequence[int]
) -> CarriedOn:
    """Measure the seams of a run, and the scores of its two halves.

    Args:
        selection: The scored sequences.
        predictions: The run's motions.
        scores: Rows of ``scores.parquet``.
        samples: Indices of the motions of each sequence.
    """
    carrying = Carrying.of(selection)
    opened = Predictions.open(predictions)
    opened.make_ready()
    steps, changes = [], []
    for sample in samples:
        picks = opened.motions([pair.pick for pair in carrying.pairs], sample)
        puts = opened.motions([pair.put for pair in carrying.pairs], sample)
        for number in range(len(carrying.pairs)):
            place = carrying.pick_from_put(int(carrying.picks[number]), int(carrying.puts[number]))
            end = picks.values[int(picks.offsets[number + 1]) - 2 : int(picks.offsets[number + 1])].astype(np.float64)
            first = int(puts.offsets[number])
            start = transform_points(place, puts.values[first : first + 2].astype(np.float64))
            steps.append(np.linalg.norm(start[0] - end[1], axis=-1).max())
            changes.append(_speed_change(end[0], end[1], start[1] - start[0], selection.fps))
    recorded = _recorded_changes(selection, frozenset(pair.pick for pair in carrying.pairs))
    rows = selection.table.scalars(split=selection.split)
    halves = {pair.pick: "picks" for pair in carrying.pairs} | {pair.put: "puts" for pair in carrying.pairs}
    return CarriedOn(
        dataset=selection.table.info.dataset,
        pairs=len(carrying.pairs),
        share_of_picks=len(find_pairs(rows)) / max(rows["action"].to_pylist().count("pick"), 1),
        median_gap=float(np.median([pair.gap for pair in carrying.pairs])),
        overlapping=float(np.mean([pair.gap < 0 for pair in carrying.pairs])),
        largest_step=float(np.max(steps)),
        speed_change=float(np.mean(changes)),
        recorded_speed_change=float(np.mean(recorded)) if recorded else None,
        picks=_means(scores, halves, "picks"),
        puts=_means(scores, halves, "puts"),
    )


def _speed_change(before: np.ndarray, at: np.ndarray, step: np.ndarray, fps: float) -> float:
    return float(np.linalg.norm(step - (at - before), axis=-1).mean() * fps)


def _recorded_changes(selection: Selection, picks: frozenset[str]) -> list[float]:
    """Changes of velocity of recorded people at the pick's event, where the frame after it was recorded."""
    found = []
    for _, chunk in selection.windows(["joints", "next_joints", "next_source"]):
        after = chunk.poses("next_joints")
        for row, (name, source) in enumerate(zip(chunk.sequence_ids, chunk.strings("next_source"), strict=True)):
            if name in picks and source == "recorded":
                last = int(chunk.offsets[row + 1]) - 1
                before, at = chunk.joints[last - 1], chunk.joints[last]
                found.append(_speed_change(before, at, after[row] - at, selection.fps))
    return found


def _means(scores: CodedScores, halves: Mapping[str, str], half: str) -> dict[str, float]:
    own = scores.only(lambda name: halves.get(name) == half)
    found = dict.fromkeys(own.metric.tolist())
    return {own.metrics[number]: float(own.value[own.metric == number].mean()) for number in found}
