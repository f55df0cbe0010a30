"""Scores of a predictor on a table of windows, one value a window.

Source: docs/specification/motion-prediction.md#metrics.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction import metrics
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, Predictor, ask
from prbench_benchmarks.motion_prediction.joint_sets import JointSet, invert_each, transform_each
from prbench_benchmarks.motion_prediction.protocol import EvaluationRules, FrameName, load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import Truth, WindowsTable


@dataclass(frozen=True)
class SimilarPasts:
    """The windows with similar pasts of every window: one set for all predictors and conditions, joints alone."""

    places: Mapping[str, int]
    """Place of each window by id."""
    sets: list[np.ndarray]
    """Places of each window's set, its own among them."""
    canonical_sets: list[np.ndarray]
    """The same where poses are compared each in its own frame."""
    futures: Float[np.ndarray, "windows future joints 3"]
    """Room."""
    own_from_room: Float[np.ndarray, "windows 4 4"]

    @classmethod
    def of(cls, table: WindowsTable, chosen: Int[np.ndarray, " n"], *, closer_than: float) -> SimilarPasts:
        """Compare the last observed poses of some windows.

        Windows that are not scored to their end have a set of their own alone: futures of other lengths are no
        continuations of theirs.
        """
        ids: list[str] = []
        poses: list[np.ndarray] = []
        futures: list[np.ndarray] = []
        whole: list[np.ndarray] = []
        for batch, truth in table.batches(Condition.POSE, chosen, frame="room", size=256):
            ids += truth.window_ids
            poses.append(batch.observed_joints[:, -1])
            futures.append(truth.joints)
            whole.append(truth.n_scored == batch.n_future)
        last = np.concatenate(poses)
        complete = np.concatenate(whole)
        inverse = invert_each(table.joints.last_pose_frame(last))
        own = transform_each(inverse, last)
        return cls(
            places={name: place for place, name in enumerate(ids)},
            sets=_among(metrics.similar_pasts(last, closer_than=closer_than), complete),
            canonical_sets=_among(metrics.similar_pasts(own, closer_than=closer_than), complete),
            futures=np.concatenate(futures),
            own_from_room=inverse,
        )


def _among(sets: list[np.ndarray], complete: np.ndarray) -> list[np.ndarray]:
    """Sets of complete windows; an incomplete one keeps itself alone."""
    return [members[complete[members]] if complete[place] else np.array([place]) for place, members in enumerate(sets)]


@dataclass
class Scores:
    """Scores of windows: one value a window in each column."""

    columns: dict[str, list] = field(default_factory=dict)

    def add(self, values: Mapping[str, object]) -> None:
        """Append the columns of some windows; a column that they lack, or that came up with them, is NaN elsewhere."""
        before = len(self.columns.get("window_id", ()))
        added = {name: np.asarray(column).tolist() for name, column in values.items()}
        after = before + len(added["window_id"])
        for name in dict.fromkeys([*self.columns, *added]):
            column = self.columns.setdefault(name, [np.nan] * before)
            column.extend(added.get(name, [np.nan] * (after - before)))

    def table(self) -> pa.Table:
        """One row a window, named by ``window_id``; the order is the same for every predictor and condition."""
        return pa.table(self.columns)

    @classmethod
    def of(cls, table: pa.Table) -> Scores:
        """Read scores from what :meth:`table` returned."""
        return cls({name: table[name].to_pylist() for name in table.column_names})

    def only(self, keep: Bool[np.ndarray, " windows"]) -> Scores:
        """The scores of some windows."""
        return self._at(np.flatnonzero(keep))

    def in_order(self, window_ids: SequenceOf[str]) -> Scores:
        """The same scores in the order of these windows: batches of another size bring short windows in another one.

        Raises:
            UsageError: if they are scores of other windows.
        """
        place: dict[str, int] = {name: number for number, name in enumerate(self.columns.get("window_id", []))}
        if place.keys() != set(window_ids) or len(window_ids) != len(self):
            raise UsageError(f"expected scores of {len(window_ids)} windows, found those of {len(self)} others.")
        return self._at(np.array([place[name] for name in window_ids]))

    def _at(self, places: Int[np.ndarray, " n"]) -> Scores:
        chosen = places.tolist()
        return Scores({name: [values[place] for place in chosen] for name, values in self.columns.items()})

    def __len__(self) -> int:
        return len(self.columns.get("window_id", ()))

    @property
    def metrics(self) -> dict[str, Float[np.ndarray, " windows"]]:
        """Every score by name; NaN where a window has none."""
        columns = {name: np.asarray(values) for name, values in self.columns.items()}
        return {name: values for name, values in columns.items() if values.dtype.kind == "f"}

    def means(self) -> dict[str, float]:
        """Means over the windows that have a score, as the study has them; scores that no window has are left out."""
        return {name: float(np.nanmean(values)) for name, values in self.metrics.items() if np.isfinite(values).any()}


def score_predictor(
    predictor: Predictor,
    table: WindowsTable,
    condition: Condition,
    chosen: Int[np.ndarray, " n"],
    *,
    similar: SimilarPasts | None = None,
    n_samples: int = 50,
    seed: int = 0,
    frame: FrameName | None = None,
    size: int = 16,
) -> Scores:
    """Ask a predictor about some windows, and score its answers.

    Args:
        predictor: What predicts.
        table: The windows.
        condition: What the predictor knows.
        chosen: Places of windows (:meth:`prbench_benchmarks.motion_prediction.table.WindowsTable.chosen`).
        similar: For MMADE and MMFDE; these are left out without it.
        n_samples: K; smaller ones of the protocol are scored as prefixes.
        seed: Of the run.
        frame: Frame in which the predictor works; the protocol's by default. Distances do not depend on it.
        size: Windows of a batch.

    Raises:
        UsageError: for less than one sample, or a condition that table or predictor do not have.
        AdapterError: if an answer does not fit.
    """
    if n_samples < 1:
        raise UsageError(f"expected one sample or more, found {n_samples}.")
    rules = load_prediction_protocol().evaluation
    scores = Scores()
    for batch, truth in table.batches(condition, chosen, frame=frame or rules.frame, size=size):
        futures = ask(predictor, batch, n_samples=n_samples, seed=seed)
        one_design = bool(getattr(predictor, "one_design", False))
        add_scores(scores, batch, futures, truth, table.joints, rules, similar=similar, one_design=one_design)
    return scores


def add_scores(
    scores: Scores,
    batch: ObservedBatch,
    futures: Futures,
    truth: Truth,
    joints: JointSet,
    rules: EvaluationRules,
    *,
    similar: SimilarPasts | None = None,
    one_design: bool = False,
) -> None:
    """Score the answer to one batch (:func:`score_batch`), and append its rows to the scores of others."""
    for rows, values in score_batch(batch, futures, truth, joints, rules, similar=similar, one_design=one_design):
        named = {
            "window_id": truth.window_ids,
            "recording_id": truth.recording_ids,
            "participant_id": truth.participant_ids,
            "segment": truth.segments,
            "anchor": truth.anchors,
        }
        scores.add({name: [values[row] for row in rows] for name, values in named.items()} | values)


def score_batch(
    batch: ObservedBatch,
    futures: Futures,
    truth: Truth,
    joints: JointSet,
    rules: EvaluationRules,
    *,
    similar: SimilarPasts | None = None,
    one_design: bool = False,
) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Score the answer to one batch.

    Args:
        batch: The question.
        futures: The answer, in the batch's frame.
        truth: What happened.
        joints: The joint set of both.
        rules: Numbers of samples, and horizons.
        similar: For MMADE and MMFDE.
        one_design: The samples are one design: fewer than all of them have no scores.

    Yields:
        Rows of the batch that are scored over one number of frames, and their scores by name.
    """
    for n_scored in np.unique(truth.n_scored).tolist():
        rows = np.flatnonzero(truth.n_scored == n_scored)
        predicted = futures.joints[rows][:, :, :n_scored]
        actual = truth.joints[rows][:, :n_scored]
        last = batch.observed_joints[rows, -1]
        by_joint = metrics.joint_errors(predicted, actual)
        # The study's metrics for every number of samples, at every horizon.
        errors = np.sqrt((by_joint**2).sum(axis=-1))
        samples = errors.shape[1]
        found = metrics.displacements(errors)
        values = {
            "ade": found.ade,
            "fde": found.fde,
            "ade_mean": found.ade_mean,
            "fde_mean": found.fde_mean,
            "apd": metrics.diversity(predicted),
        }
        for n in (each for each in rules.samples if each == samples or (each < samples and not one_design)):
            part = metrics.displacements(errors[:, :n])
            values |= {f"ade@k{n}": part.ade, f"fde@k{n}": part.fde}
        for seconds in rules.horizons:
            frames = round(seconds * batch.fps)
            # Anchored windows may end before a horizon: there it says nothing.
            there = frames <= errors.shape[2]
            part = metrics.displacements(errors[:, :, : min(frames, errors.shape[2])])
            nothing = np.full(len(errors), np.nan)
            values |= {f"ade@{seconds:g}s": part.ade if there else nothing}
            values |= {f"fde@{seconds:g}s": part.fde if there else nothing}
        values |= _of_joints(by_joint, joints)
        values["first_frame_jump"] = metrics.first_frame_jump(predicted, last)
        values["bone_error_percent"] = metrics.bone_error(predicted, last, joints.bones)
        values |= _at_goal(predicted, actual, truth.goal[rows], joints)
        if similar is not None:
            values |= _multimodal(predicted, truth, rows, similar)
        yield rows, values


def _of_joints(by_joint: Float[np.ndarray, "batch samples frames joints"], joints: JointSet) -> dict[str, np.ndarray]:
    """Mean distance of each joint, of the sample whose joints are nearest on average, and of the wrists, metres."""
    each = by_joint.mean(axis=2)
    best = each.mean(axis=2).argmin(axis=1)
    chosen = each[np.arange(len(each)), best]
    values = {"mpjpe": chosen.mean(axis=1)}
    values |= {f"joint/{name}": chosen[:, place] for place, name in enumerate(joints.names)}
    wrists = by_joint[..., joints.index(*joints.wrists)].mean(axis=-1)
    found = metrics.displacements(wrists)
    return values | {"wrists_ade": found.ade, "wrists_fde": found.fde}


def _at_goal(
    predicted: np.ndarray, actual: np.ndarray, goal: Float[np.ndarray, "batch 3"], joints: JointSet
) -> dict[str, np.ndarray]:
    """Distance of the nearer wrist to the goal, and error of the pelvis, at the event; NaN where it lies beyond."""
    if not np.isfinite(goal).any():
        return {}
    wrists = joints.index(*joints.wrists)
    best, mean = metrics.goal_distances(predicted[:, :, -1][:, :, wrists], goal)
    _, own = metrics.goal_distances(actual[:, None, -1][:, :, wrists], goal)
    pelvis = joints.index(joints.pelvis)[0]
    apart = np.linalg.norm(predicted[:, :, -1, pelvis].astype(np.float64) - actual[:, None, -1, pelvis], axis=-1)
    known = np.isfinite(goal).all(axis=1)
    values = {
        "wrist_to_goal": best,
        "wrist_to_goal_mean": mean,
        "wrist_to_goal_recorded": own,
        "pelvis_at_event": apart.min(axis=1),
        "pelvis_at_event_mean": apart.mean(axis=1),
    }
    return {name: np.where(known, value, np.nan) for name, value in values.items()}


def _multimodal(predicted: np.ndarray, truth: Truth, rows: np.ndarray, similar: SimilarPasts) -> dict[str, np.ndarray]:
    """MMADE and MMFDE in the room and in the frame of the last pose, each with the size of its set."""
    found = []
    n_scored = predicted.shape[2]
    in_room = transform_each(truth.room_from_batch[rows], predicted)
    places = [similar.places[truth.window_ids[row]] for row in rows]
    own = transform_each(similar.own_from_room[places], in_room)
    for row, place in enumerate(places):
        members = similar.sets[place]
        near = similar.canonical_sets[place]
        room = metrics.multimodal_displacements(in_room[row], similar.futures[members][:, :n_scored])
        futures = transform_each(similar.own_from_room[near], similar.futures[near][:, :n_scored])
        canonical = metrics.multimodal_displacements(own[row], futures)
        found.append((*room, float(len(members)), *canonical, float(len(near))))
    names = ("mmade", "mmfde", "similar_pasts", "mmade_canonical", "mmfde_canonical", "similar_pasts_canonical")
    return dict(zip(names, np.transpose(found), strict=True))
