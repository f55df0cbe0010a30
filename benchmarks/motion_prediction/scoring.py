"""Scores of predictors, and of references that know the future, on a table of windows: one value a window.

Source: docs/specification/motion-prediction.md#metrics, and #references. References are no predictors: nothing that a
predictor is given leads to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.fft import dct, idct

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction import metrics
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch, Predictor, ask
from prbench_benchmarks.motion_prediction.joint_sets import JOINT_SETS, JointSet, invert_each, transform_each
from prbench_benchmarks.motion_prediction.protocol import EvaluationRules, FrameName, load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import Truth, WindowsTable

Points = Float[np.ndarray, "batch 3"]

GROUND_TRUTH = "ground-truth"
TRUNCATION_FLOOR = "truncation-floor"
# Columns beside the scores; Truth holds one value a window of each.
_ABOUT = ("window_id", "recording_id", "participant_id", "segment", "anchor")
Reference = Callable[[ObservedBatch, Truth], Futures]


@dataclass(frozen=True)
class SimilarPasts:
    """The windows with similar pasts of every window: one set for all predictors and conditions, joints alone.

    Attributes:
        places: Place of each window by id.
        sets: Places of each window's set, its own among them.
        canonical_sets: Places of each window's set where poses are compared each in the frame of its own last pose.
        futures: Room.
    """

    places: Mapping[str, int]
    sets: list[np.ndarray]
    canonical_sets: list[np.ndarray]
    futures: Float[np.ndarray, "windows future joints 3"]
    own_from_room: Float[np.ndarray, "windows 4 4"]

    @classmethod
    def of(cls, table: WindowsTable, chosen: Int[np.ndarray, " n"], *, closer_than: float) -> SimilarPasts:
        """Compare the last observed poses of some windows.

        Windows that are not scored to their end have a set of their own alone: futures of other lengths are no
        continuations of theirs.
        """
        batches = list(table.batches(Condition.POSE, chosen, frame="room", size=256))
        ids = [name for _, truth in batches for name in truth.window_ids]
        last = np.concatenate([batch.observed_joints[:, -1] for batch, _ in batches])
        complete = np.concatenate([truth.n_scored == batch.n_future for batch, truth in batches])
        inverse = invert_each(table.joints.last_pose_frame(last))

        def sets(poses: np.ndarray) -> list[np.ndarray]:
            found = metrics.similar_pasts(poses, closer_than=closer_than)
            return [near[complete[near]] if complete[place] else np.array([place]) for place, near in enumerate(found)]

        places = {name: place for place, name in enumerate(ids)}
        futures = np.concatenate([truth.joints for _, truth in batches])
        return cls(places, sets(last), sets(transform_each(inverse, last)), futures, inverse)


@dataclass
class Scores:
    """Scores of windows in table order: one value a window in each column."""

    columns: dict[str, list] = field(default_factory=dict)

    def add(self, values: Mapping[str, object]) -> None:
        """Append the columns of some windows; a column that they lack, or that came up with them, is NaN elsewhere."""
        before = len(self)
        added = {name: np.asarray(column).tolist() for name, column in values.items()}
        new = len(added["window_id"])
        for name in dict.fromkeys([*self.columns, *added]):
            self.columns.setdefault(name, [np.nan] * before).extend(added.get(name, [np.nan] * new))

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
        similar: Windows with similar pasts, for MMADE and MMFDE; these are left out without it.
        n_samples: K; smaller ones of the protocol are scored as prefixes.
        seed: The run's seed.
        frame: Frame in which the predictor works; the protocol's by default. Distances do not depend on it.
        size: Windows of a batch.

    Raises:
        UsageError: for less than one sample, or a condition that table or predictor do not have.
        AdapterError: if an answer does not fit.
    """
    if n_samples < 1:
        raise UsageError(f"expected one sample or more, found {n_samples}.")
    frame = frame or load_prediction_protocol().evaluation.frame
    scores = Scores()
    for batch, truth in table.batches(condition, chosen, frame=frame, size=size):
        futures = ask(predictor, batch, n_samples=n_samples, seed=seed)
        one_design = bool(getattr(predictor, "one_design", False))
        _add(scores, batch, futures, truth, table.joints, similar=similar, one_design=one_design)
    return scores


def score_reference(
    reference: Reference, table: WindowsTable, chosen: Int[np.ndarray, " n"], *, similar: SimilarPasts | None = None
) -> Scores:
    """Score a reference as a predictor is scored.

    Args:
        reference: :func:`ground_truth`, or what :func:`truncation_floor` returned.
        table: The windows.
        chosen: Places of windows.
        similar: Windows with similar pasts, for MMADE and MMFDE; these are left out without it.
    """
    scores = Scores()
    for batch, truth in table.batches(Condition.POSE, chosen, frame="room"):
        _add(scores, batch, reference(batch, truth), truth, table.joints, similar=similar)
    return scores


def _add(scores: Scores, batch: ObservedBatch, futures: Futures, truth: Truth, joints: JointSet, **given) -> None:
    rules = load_prediction_protocol().evaluation
    about = {name: getattr(truth, f"{name}s") for name in _ABOUT}
    scores.add(about | score_batch(batch, futures, truth, joints, rules, **given))


def score_batch(
    batch: ObservedBatch,
    futures: Futures,
    truth: Truth,
    joints: JointSet,
    rules: EvaluationRules,
    *,
    similar: SimilarPasts | None = None,
    one_design: bool = False,
) -> dict[str, Float[np.ndarray, " batch"]]:
    """Score the answer to one batch.

    Args:
        batch: The question.
        futures: The answer, in the batch's frame.
        truth: What happened.
        joints: The joint set of both.
        rules: Numbers of samples, and horizons.
        similar: Windows with similar pasts, for MMADE and MMFDE.
        one_design: The samples are one design: fewer than all of them have no scores.

    Returns:
        One value a window by the name of the score; NaN where a window has none.
    """
    columns: dict[str, np.ndarray] = {}
    for n_scored in np.unique(truth.n_scored).tolist():
        rows = np.flatnonzero(truth.n_scored == n_scored)
        predicted = futures.joints[rows][:, :, :n_scored]
        actual = truth.joints[rows][:, :n_scored]
        last = batch.observed_joints[rows, -1]
        by_joint = metrics.joint_errors(predicted, actual)
        # The study's metrics for every number of samples, at every horizon.
        errors = np.sqrt((by_joint**2).sum(axis=-1))
        samples = errors.shape[1]
        values = metrics.displacements(errors) | {"apd": metrics.diversity(predicted)}
        for n in (each for each in rules.samples if each == samples or (each < samples and not one_design)):
            part = metrics.displacements(errors[:, :n])
            values |= {f"ade@k{n}": part["ade"], f"fde@k{n}": part["fde"]}
        for seconds in rules.horizons:
            frames = round(seconds * batch.fps)
            # Anchored windows may end before a horizon: there it says nothing.
            part = {"ade": np.nan, "fde": np.nan}
            if frames <= errors.shape[2]:
                part = metrics.displacements(errors[:, :, :frames])
            values |= {f"ade@{seconds:g}s": part["ade"], f"fde@{seconds:g}s": part["fde"]}
        # Joints are told of the sample whose joints are nearest on average.
        each = by_joint.mean(axis=2)
        best = each[np.arange(len(each)), each.mean(axis=2).argmin(axis=1)]
        values["mpjpe"] = best.mean(axis=1)
        values |= {f"joint/{name}": best[:, place] for place, name in enumerate(joints.names)}
        of_wrists = metrics.displacements(by_joint[..., joints.index(*joints.wrists)].mean(axis=-1))
        values |= {"wrists_ade": of_wrists["ade"], "wrists_fde": of_wrists["fde"]}
        values["first_frame_jump"] = metrics.first_frame_jump(predicted, last)
        values["bone_error_percent"] = metrics.bone_error(predicted, last, joints.bones)
        if np.isfinite(truth.goal[rows]).any():
            values |= _at_goal(predicted, actual, truth.goal[rows], joints)
        if similar is not None:
            values |= _multimodal(predicted, truth, rows, similar)
        for name, value in values.items():
            columns.setdefault(name, np.full(len(batch), np.nan))[rows] = value
    return columns


def score_window(
    predicted: Float[np.ndarray, "samples frames joints 3"],
    recorded: Float[np.ndarray, "frames joints 3"],
    *,
    last_observed: Float[np.ndarray, "joints 3"] | None = None,
    goal: Float[np.ndarray, "3"] | None = None,
    fps: float | None = None,
    similar_futures: Float[np.ndarray, "others frames joints 3"] | None = None,
) -> dict[str, float]:
    """Score the futures of one window with :func:`score_batch`, as far as the arguments allow; metres, one frame.

    Args:
        predicted: The futures.
        recorded: What happened.
        last_observed: The last observed pose, for the jump of the first frame and the lengths of bones.
        goal: Place of the hand in the last frame.
        fps: Frames a second, for the horizons.
        similar_futures: Futures of other windows with a similar past, for MMADE and MMFDE; the own one is added.

    Raises:
        UsageError: if no joint set has as many joints.
    """
    n_joints = recorded.shape[1]
    known = {len(each.names): each for each in JOINT_SETS.values()}
    if n_joints not in known:
        sets = ", ".join(f"{n} ({each.name})" for n, each in sorted(known.items()))
        raise UsageError(f"recorded: expected {sets} joints, found {n_joints}.")
    joints = known[n_joints]
    rules = load_prediction_protocol().evaluation
    batch = ObservedBatch(
        condition=Condition.POSE,
        fps=np.inf if fps is None else fps,
        n_future=len(recorded),
        joint_names=joints.names,
        observed_joints=(recorded[0] if last_observed is None else last_observed)[None, None],
        key=(0,),
    )
    none = ("",)
    goals = np.full((1, 3), np.nan) if goal is None else goal[None]
    truth = Truth(none, none, none, none, none, np.array([len(recorded)]), recorded[None], goals, np.eye(4)[None])
    if fps is None:
        rules = msgspec.structs.replace(rules, horizons=())
    columns = score_batch(batch, Futures(joints=predicted[None]), truth, joints, rules)
    scores = {name: float(values[0]) for name, values in columns.items() if np.isfinite(values[0])}
    if last_observed is None:
        del scores["first_frame_jump"], scores["bone_error_percent"]
    if similar_futures is not None:
        futures = np.concatenate([recorded[None], similar_futures])
        scores["mmade"], scores["mmfde"] = metrics.multimodal_displacements(predicted, futures)
        scores["similar_pasts"] = float(len(futures))
    return scores


def _at_goal(predicted: np.ndarray, actual: np.ndarray, goal: Points, joints: JointSet) -> dict[str, np.ndarray]:
    """Distance of the nearer wrist to the goal, and error of the pelvis, at the event; NaN where it lies beyond."""
    wrists = joints.index(*joints.wrists)
    best, mean = metrics.goal_distances(predicted[:, :, -1][:, :, wrists], goal)
    _, own = metrics.goal_distances(actual[:, None, -1][:, :, wrists], goal)
    pelvis = joints.index(joints.pelvis)[0]
    apart = np.linalg.norm(predicted[:, :, -1, pelvis].astype(np.float64) - actual[:, None, -1, pelvis], axis=-1)
    known = np.isfinite(goal).all(axis=1)
    values = {"wrist_to_goal": best, "wrist_to_goal_mean": mean, "wrist_to_goal_recorded": own}
    values |= {"pelvis_at_event": apart.min(axis=1), "pelvis_at_event_mean": apart.mean(axis=1)}
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


def ground_truth(batch: ObservedBatch, truth: Truth) -> Futures:
    """Return what happened, as the only sample; the last pose is held after an event."""
    frame = np.minimum(np.arange(batch.n_future), truth.n_scored[:, None] - 1)
    return Futures(joints=truth.joints[np.arange(len(batch))[:, None], frame][:, None])


def truncation_floor(coefficients: int) -> Reference:
    """Return what is left of the true windows when only their first coefficients are kept.

    A network that describes a window by L coefficients cannot be better than this, whatever it learns.

    Args:
        coefficients: L of the orthonormal DCT-II over observed and future frames, one or more.
    """

    def truncated(batch: ObservedBatch, truth: Truth) -> Futures:
        future = ground_truth(batch, truth).joints[:, 0]
        windows = np.concatenate([batch.observed_joints, future], axis=1).astype(np.float64)
        kept = np.asarray(dct(windows, axis=1, norm="ortho"))
        kept[:, coefficients:] = 0.0
        future = np.asarray(idct(kept, axis=1, norm="ortho"))[:, batch.observed_joints.shape[1] :]
        return Futures(joints=future[:, None].astype(np.float32))

    return truncated


def references() -> Mapping[str, Reference]:
    """Return the references by name, the floor with the protocol's number of coefficients."""
    coefficients = load_prediction_protocol().evaluation.coefficients
    return {TRUNCATION_FLOOR: truncation_floor(coefficients), GROUND_TRUTH: ground_truth}
