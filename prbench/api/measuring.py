"""The study's six metrics on arrays of one's own, in one call.

Definitions: docs/specification/metrics.md.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from prbench import metrics as scoring
from prbench.api import arguments as args
from prbench.api.pictures import frozen
from prbench.checking.doctor.body import wrong_unit
from prbench.checking.doctor.motion_set import spread_poses
from prbench.errors import UsageError, did_you_mean
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.motions import coordinate_problem
from prbench.metrics import score as score_metrics
from prbench.protocol.manifests import load_protocol
from prbench.shown import html

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike

_GOAL = "goal_location (or goal_box)"
_TIME_TOLERANCE = 1e-6  # seconds
_PRIME = (_GOAL, "prime_time", "head_tilt_deg", "fps")
# Arguments beside the predicted motion that a metric needs; one that is not listed here is assumed to need all.
_NEEDS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("prime_success", "prime_success_arrival", "prime_success_onset", "prime_success_angle"), _PRIME),
    **dict.fromkeys(("reach_success", "reach_success_final"), (_GOAL,)),
    "reach_wrist": ("recorded", _GOAL),
    **dict.fromkeys(("goal_mpjpe", "mpjpe", "first_frame_error"), ("recorded",)),
    **dict.fromkeys(("location_error", "location_error_horizontal"), ("recorded",)),
    **dict.fromkeys(("foot_skating", "slow_slides", "largest_jerk", "largest_speed", "plausible_3"), ("fps",)),
    "plausible": (_GOAL, "head_tilt_deg", "fps"),
    **dict.fromkeys(("contact_share", "bone_length_change", "first_step", "floating", "penetration"), ()),
}
_SIDES = {"left": 0, "right": 1, None: scoring.UNKNOWN_HAND}


@dataclass(frozen=True, eq=False, repr=False)
class Measures(Mapping[str, Any]):
    """Values of metrics by id: a number each for one motion, an array (batch,) each for several.

    Works as a dictionary does: ``measures["mpjpe"]``, ``dict(measures)``, ``"mpjpe" in measures``.

    Attributes:
        left_out: Metrics that could not be computed, by id, each with the arguments that it needs.
        flags: Remarks by metric id, one a motion: ``no_candidate_frames`` and the like, or None.
    """

    _values: dict[str, Float[np.ndarray, " batch"]]
    left_out: dict[str, str]
    flags: dict[str, list[str | None]] = field(default_factory=dict)
    _one: bool = False
    _infos: tuple[scoring.MetricInfo, ...] = scoring.METRICS_OF_MOTIONS  # what text shows of them

    def __getitem__(self, metric: str) -> Any:
        if metric in self.left_out:
            raise KeyError(f"{metric} was left out: it {self.left_out[metric]}")
        values = self._values[metric]
        return float(values[0]) if self._one else values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def mean(self) -> dict[str, float]:
        """Return the mean over motions by metric id; average over sequences is what the study's tables hold."""
        return {metric: float(values.mean()) for metric, values in self._values.items()}

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a motion and one column a metric; rates are 0 or 1, lengths are in metres."""
        import pandas as pd

        return pd.DataFrame(self._values)

    def __repr__(self) -> str:
        return f"<Measures {'; '.join(self._lines())}>"

    def _repr_html_(self) -> str:
        return "<br>".join(html(line) for line in self._lines())

    def _lines(self) -> list[str]:
        over = "" if self._one else "mean "
        means = self.mean()
        shown = [info for info in self._infos if info.id in means]
        lines = [
            f"{info.title}: {over}{means[info.id] * info.scale:.4g}{scoring.printed_unit(info.unit)}" for info in shown
        ]
        left_out = [info for info in self._infos if info.id in self.left_out]
        return lines + [f"{info.title} left out: {self.left_out[info.id]}" for info in left_out]


def measure(
    predicted: ArrayLike | Sequence[ArrayLike],
    *,
    recorded: ArrayLike | Sequence[ArrayLike] | None = None,
    goal_location: ArrayLike | None = None,
    goal_box: ArrayLike | None = None,
    prime_time: ArrayLike | None = None,
    head_tilt_deg: ArrayLike | None = None,
    fps: ArrayLike | None = None,
    hand: str | Sequence[str | None] | None = None,
    n_frames: ArrayLike | None = None,
    metrics: Collection[str] | None = None,
) -> Measures:
    """Compute the study's six metrics for one motion or several, as far as the arguments allow.

    A metric whose arguments are not given is left out and named in :attr:`Measures.left_out`. The values are those
    that ``prbench run`` and ``prbench score`` compute.

    All positions stand in one frame with Y up and the floor at Y = 0, in metres; for sequences of a table that is
    their canonical frame. Arrays may be NumPy's, nested lists, or tensors on the processor.

    Args:
        predicted: Joint positions (n, 22, 3) of one motion, in the order of :class:`prbench.Joint`; or several: a list
            of such arrays, or (batch, frames, 22, 3) with ``n_frames``.
        recorded: The recorded motion(s) in the same form, with the same lengths. Goal MPJPE, MPJPE and Location Error
            compare with it (docs/specification/metrics.md#goal-mpjpe, docs/specification/metrics.md#mpjpe,
            docs/specification/metrics.md#location-error).
        goal_location: Position of the object, (3,) or (batch, 3), metres. Prime Success and Reach Success need it
            (docs/specification/metrics.md#prime-success, docs/specification/metrics.md#reach-success).
        goal_box: The object's box in place of ``goal_location``, of which the centre counts: lower and upper corner
            (2, 3) or all corners (8, 3), with a leading axis for several motions; metres.
        prime_time: When the recorded gaze first met the goal, seconds after the first frame
            (``sequence.prime_after``); a number, or (batch,).
        head_tilt_deg: Rest tilt of the neck-head bone of the skeleton, degrees (``sequence.head_tilt_deg``; 7.4 for
            SMPL-X, 38.3 for SMPL-H: docs/specification/humanml3d.md#head-forward-vector); a number, or (batch,).
        fps: Frames per second; a number, or (batch,). Prime Success and Foot Skating need it
            (docs/specification/metrics.md#foot-skating).
        hand: The recorded reaching hand, ``left`` or ``right``, or one for each motion; None where it is unknown. Only
            the variant ``reach_wrist`` asks for it.
        n_frames: Frames of each motion of a padded batch, (batch,); what stands behind them leaves no trace.
        metrics: Ids of other metrics than the six, for example ``prime_success_arrival`` or ``plausible``
            (the table in docs/specification/metrics.md).

    Returns:
        Values by metric id.

    Raises:
        UsageError: if an array has another shape than it must, lengths differ, a coordinate is not finite or more than
            100 m away, ``prime_time`` lies outside the motion, or a metric is unknown.

    Examples:
        All joints off by (0.03, 0.04, 0) m in the last of four frames, and exact elsewhere:

        >>> import numpy as np
        >>> import prbench
        >>> recorded = np.zeros((4, 22, 3))
        >>> predicted = recorded.copy()
        >>> predicted[-1] += [0.03, 0.04, 0.0]
        >>> measures = prbench.measure(predicted, recorded=recorded, goal_location=[0.0, 0.0, 0.08])
        >>> round(measures["goal_mpjpe"], 4), round(measures["mpjpe"], 4), measures["reach_success"]
        (0.05, 0.0125, 1.0)
        >>> measures.left_out
        {'prime_success': 'needs prime_time, head_tilt_deg, fps', 'foot_skating': 'needs fps'}

        Two motions at once, with 4 and 3 frames:

        >>> several = prbench.measure([predicted, predicted[:3]], recorded=[recorded, recorded[:3]], fps=20)
        >>> several["mpjpe"].round(4).tolist()
        [0.0125, 0.0]
        >>> several.to_pandas().columns.tolist()
        ['goal_mpjpe', 'location_error', 'mpjpe', 'foot_skating']
    """
    motions, one = _motions("predicted", predicted, n_frames)
    size = len(motions)
    batch = scoring.MotionBatch.from_motions(motions)
    reference = batch
    if recorded is not None:
        others, _ = _motions("recorded", recorded, n_frames)
        if len(others) != size:
            raise UsageError(f"recorded: expected {size} motions, as many as predicted, found {len(others)}.")
        # Motions of different lengths cannot be compared (docs/specification/metrics.md#length-contract).
        for row, (motion, other) in enumerate(zip(motions, others, strict=True)):
            if len(motion) != len(other):
                problem = f"found {len(motion)} and {len(other)}. Give every motion the length of the recorded one."
                raise UsageError(f"motion {row}: expected as many predicted as recorded frames, {problem}")
        reference = scoring.MotionBatch.from_motions(others)
    if goal_location is not None and goal_box is not None:
        raise UsageError("goal_location and goal_box: give one of them; of a box the centre counts.")
    goal = _one_each("goal_location", goal_location, size, (3,))
    if goal_box is not None:
        corners = args.as_array("goal_box", goal_box)
        if corners.shape not in ((2, 3), (8, 3), (size, 2, 3), (size, 8, 3)):
            found = f"found the shape {corners.shape}"
            raise UsageError(f"goal_box: expected (2, 3) or (8, 3), or one for each of {size} motions, {found}.")
        goal = np.broadcast_to(corners.mean(axis=-2), (size, 3)).copy()
    rates = _one_each("fps", fps, size)
    primes = _one_each("prime_time", prime_time, size)
    tilts = _one_each("head_tilt_deg", head_tilt_deg, size)
    if rates is not None and primes is not None:
        lasts = (batch.n_frames - 1) / rates
        outside = np.flatnonzero((primes < -_TIME_TOLERANCE) | (primes > lasts + _TIME_TOLERANCE))
        if outside.size:
            row = int(outside[0])
            expected = f"seconds after the first frame, from 0 to {lasts[row]:g} for motion {row}"
            remedy = "Of a recording's clock, subtract the first frame's time (sequence.prime_after)."
            raise UsageError(f"prime_time: expected {expected}, found {primes[row]:g}. {remedy}")
    # Metric ids in printed order: the six, or those that were asked for.
    known = [info.id for info in scoring.METRICS_OF_MOTIONS]
    wanted = [info.id for info in scoring.STUDY_METRICS]
    if metrics is not None:
        asked = [metrics] if isinstance(metrics, str) else list(metrics)
        for name in asked:
            if name not in known:
                raise UsageError(f"unknown metric '{name}'; there are: {', '.join(known)}.{did_you_mean(name, known)}")
        wanted = [name for name in known if name in asked]
    given = {"recorded": recorded, _GOAL: goal, "prime_time": primes, "head_tilt_deg": tilts, "fps": rates}
    left_out = {}
    for metric in wanted:
        missing = [name for name in _NEEDS.get(metric, tuple(given)) if given[name] is None]
        if missing:
            left_out[metric] = f"needs {', '.join(missing)}"
    words = [hand] * size if hand is None or isinstance(hand, str) else list(hand)
    if len(words) != size:
        raise UsageError(f"hand: expected {size} of them, one a motion, found {len(words)}.")
    for word in words:
        if word not in _SIDES:
            raise UsageError(f"hand: expected left, right or None, found '{word}'.")
    possible = [metric for metric in wanted if metric not in left_out]
    try:
        # What is not given is filled with numbers that no possible metric reads.
        targets = scoring.ScoringTargets(
            goal_location=np.zeros((size, 3)) if goal is None else goal,
            prime_time=np.zeros(size) if primes is None else primes,
            hand=np.array([_SIDES[word] for word in words]),
            head_tilt_deg=np.zeros(size) if tilts is None else tilts,
            fps=np.ones(size) if rates is None else rates,
            pose_given=recorded is not None,
        )
        constants = load_protocol().metrics
        values = score_metrics(batch, reference, targets, constants, metrics=possible) if possible else {}
    except ValueError as error:
        raise UsageError(f"measure: {error}.") from error
    flags = {metric: found.flag for metric, found in values.items() if any(found.flag)}
    return Measures({metric: frozen(found.value) for metric, found in values.items()}, left_out, flags, one)


def measure_futures(
    predicted: ArrayLike,
    recorded: ArrayLike,
    *,
    last_observed: ArrayLike | None = None,
    goal: ArrayLike | None = None,
    fps: float | None = None,
    similar_futures: ArrayLike | None = None,
) -> Measures:
    """Score K predicted futures of one window of the benchmark motion-prediction.

    The arithmetic is that of ``prbench run`` and of :func:`prbench.score`: one function of the benchmark scores the
    windows of all of them (docs/specification/motion-prediction.md#metrics). A metric whose arguments are not given is
    left out and named in :attr:`Measures.left_out`.

    All positions are in metres and in one frame. The joints are the 22 of :class:`prbench.Joint`, MoGaze's 21, or
    GIMO's 23 (docs/specification/motion-prediction.md#joint-sets).

    Args:
        predicted: Positions (k, frames, joints, 3) of the K futures, without the observed frames.
        recorded: Positions (frames, joints, 3) of what happened in the same frames.
        last_observed: The last observed pose (joints, 3). ``first_frame_jump`` and ``bone_error_percent`` need it.
        goal: Position of the hand in the last frame, (3,). ``wrist_to_goal`` and ``pelvis_at_event`` need it.
        fps: Frames per second. The errors at horizons, such as ``ade@0.5s``, need it.
        similar_futures: Futures (m, frames, joints, 3) of other windows with a similar past, in the same frame.
            ``mmade`` and ``mmfde`` need them; the recorded future is added to them.

    Returns:
        A number for each metric by its id: ``ade``, ``fde``, ``apd`` and the others that a run on the window scores.

    Raises:
        UsageError: if a shape does not fit, a coordinate is not finite, or bodies look like another unit than metres.

    Examples:
        One future stands 10 cm aside in all frames, another one is right until the last frame:

        >>> import numpy as np
        >>> import prbench
        >>> recorded = np.zeros((60, 22, 3))
        >>> predicted = np.zeros((2, 60, 22, 3))
        >>> predicted[0, :, :, 0] = 0.1
        >>> predicted[1, -1, :, 1] = 0.3
        >>> measures = prbench.measure_futures(predicted, recorded)
        >>> round(measures["ade"], 4), round(measures["fde"], 4), round(measures["mpjpe"], 4)
        (0.0235, 0.469, 0.005)
        >>> measures.left_out["mmade"]
        'needs similar_futures'
    """
    futures = args.as_array("predicted", predicted)
    happened = args.as_array("recorded", recorded)
    if happened.ndim != 3 or happened.shape[2] != 3 or not len(happened):
        raise UsageError(f"recorded: expected (frames, joints, 3), found the shape {happened.shape}.")
    if futures.ndim != 4 or futures.shape[1:] != happened.shape or not len(futures):
        expected = f"(k, {', '.join(map(str, happened.shape))}), k futures of the recorded frames"
        raise UsageError(f"predicted: expected {expected}, found the shape {futures.shape}.")
    given = {"last_observed": last_observed, "goal": goal, "similar_futures": similar_futures}
    given = {name: None if value is None else args.as_array(name, value) for name, value in given.items()}
    for name, shape in (("last_observed", happened.shape[1:]), ("goal", (3,)), ("similar_futures", happened.shape)):
        array = given[name]
        several = name == "similar_futures"  # any number of them
        if array is not None and (array.ndim != len(shape) + several or array.shape[several:] != shape):
            words = ", ".join(map(str, ("m", *shape) if several else shape))
            raise UsageError(f"{name}: expected the shape ({words}), found {array.shape}.")
    if fps is not None and not 0 < fps < np.inf:
        raise UsageError(f"fps: expected frames per second above 0, found {fps}.")
    for name, array in {"predicted": futures, "recorded": happened, **given}.items():
        if array is None or not array.size:
            continue
        if not np.isfinite(array).all():
            place = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
            raise UsageError(f"{name}{list(place)}: expected finite positions, found {array[place]}.")
        unit = None if name == "goal" else wrong_unit(spread_poses(array.reshape(-1, *happened.shape[1:])))
        # A network that has learnt little may answer with bodies of any size; what is 50 times as large is a unit.
        if unit is not None and (name != "predicted" or unit[1] < 0.02):
            raise UsageError(f"{name}: {unit[0].evidence}: {unit[0].cause}. {unit[0].remedy}")
    benchmark = load_benchmark("motion-prediction")
    scores = benchmark.measure(futures, happened, fps=fps, **given)
    needs = {"last_observed": ("first_frame_jump", "bone_error_percent"), "fps": ()}
    needs |= {"goal": ("wrist_to_goal", "pelvis_at_event"), "similar_futures": ("mmade", "mmfde")}
    if fps is None:
        needs["fps"] = tuple(info.id for info in benchmark.metrics if info.id.endswith("s") and "@" in info.id)
    left_out = {id: f"needs {name}" for name, ids in needs.items() for id in ids if id not in scores}
    values = {info.id: frozen(np.array([scores[info.id]])) for info in benchmark.metrics if info.id in scores}
    return Measures(values, left_out, {}, True, benchmark.main_metrics)


def _motions(name: str, value: Any, n_frames: Any) -> tuple[list[Float[np.ndarray, "_ 22 3"]], bool]:
    """Return motions as a list, and whether a single one was given.

    Raises:
        UsageError: if shapes or lengths are wrong, or a coordinate is impossible.
    """
    if isinstance(value, list | tuple) and value and np.ndim(value[0]) == 3:
        motions = [args.as_array(f"{name}[{row}]", motion) for row, motion in enumerate(value)]
        one = False
    else:
        array = args.as_array(name, value)
        one = array.ndim == 3
        motions = [array] if one else list(array)
    for motion in motions:
        if motion.ndim != 3 or motion.shape[1:] != (N_JOINTS, 3) or not len(motion):
            forms = f"(n, {N_JOINTS}, 3), a list of such arrays, or (batch, frames, {N_JOINTS}, 3) with n_frames"
            shape = motion.shape if one else (len(motions), *motion.shape)
            raise UsageError(f"{name}: expected {forms}, found the shape {shape}.")
    if n_frames is not None:
        lengths = np.atleast_1d(args.as_array("n_frames", n_frames)).tolist()
        if np.ndim(n_frames) == 0:
            lengths *= len(motions)
        if len(lengths) != len(motions):
            raise UsageError(f"n_frames: expected {len(motions)} numbers, one a motion, found {len(lengths)}.")
        for row, (motion, length) in enumerate(zip(motions, lengths, strict=True)):
            if not 1 <= length <= len(motion):
                found = f"found {length:g}."
                raise UsageError(f"n_frames[{row}]: expected 1 to {len(motion)}, the frames of the array, {found}")
            motions[row] = motion[: int(length)]
    for row, motion in enumerate(motions):
        if problem := coordinate_problem(motion):
            raise UsageError(f"{name if one else f'{name}[{row}]'}, {problem}")
    return motions, one


def _one_each(name: str, value: Any, size: int, shape: tuple[int, ...] = ()) -> np.ndarray | None:
    """Return a value of one shape for each motion, or None if none is given.

    Raises:
        UsageError: if it is neither one value nor one for each motion.
    """
    if value is None:
        return None
    array = args.as_array(name, value)
    if array.shape not in (shape, (size, *shape)):
        expected = f"{shape} or {(size, *shape)}" if shape else f"one number or {size}, one a motion"
        raise UsageError(f"{name}: expected {expected}, found the shape {array.shape}.")
    return np.broadcast_to(array, (size, *shape)).copy()
