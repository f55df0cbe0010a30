"""Ask a method for motions, and check what it declares and every motion before it is kept."""

from __future__ import annotations

import dataclasses
import gc
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.checking.doctor.body import wrong_unit
from prbench.checking.doctor.motion_set import spread_poses
from prbench.contract import Adapter, Condition, ConditionBatch, Cost, Gaze, Motions
from prbench.engine import is_out_of_memory
from prbench.errors import AdapterError, InputFileError, PrbenchError
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.limits import FARTHEST_COORDINATE, FARTHEST_EYES

Poses = Float[np.ndarray, "*frames 22 3"]
Vectors = Float[np.ndarray, "frames 3"]

Motion = Float[np.ndarray, "frames 22 3"]
_Answer = TypeVar("_Answer")


@dataclass(frozen=True)
class Declared:
    """The attributes of an adapter that the harness honours.

    Attributes:
        conditions: Conditions that it takes, of the benchmark's own type.
        max_frames: Longest motion at its own rate, in frames; None for no limit.
        native_fps: Frames per second that it generates; None for the table's rate.
        gaze: True if its motions bring gaze.
        one_design: The K futures of a window are one design: fewer are no part of more.
    """

    conditions: frozenset[Any]
    max_frames: int | None = None
    native_fps: float | None = None
    motionless: bool = False
    gaze: bool = False
    one_design: bool = False

    @classmethod
    def by(cls, adapter: Any, *, origin: str, conditions: type[StrEnum] = Condition) -> Declared:
        """Read the attributes of a method.

        Args:
            adapter: The method.
            origin: Name of the method in messages.
            conditions: The conditions of its benchmark.

        Raises:
            AdapterError: naming the attribute that is not what the contract asks for.
        """
        stated = {each.name: getattr(adapter, each.name, None) for each in fields(cls)}
        return cls.checked(stated | {"conditions": adapter.conditions}, origin=origin, known=conditions)

    @classmethod
    def checked(cls, stated: Mapping[str, Any], *, origin: str, known: type[StrEnum] = Condition) -> Declared:
        """Read the same from values of unknown types, such as those of a program's hello.

        Args:
            stated: Maps the names of the attributes to what is declared; others are passed over.
            origin: Name of the method in messages.
            known: The conditions of its benchmark.

        Raises:
            AdapterError: see :meth:`by`.
        """
        conditions = stated["conditions"]
        names = [condition.value for condition in known]
        # A one-shot iterator may be all that a method gives.
        asked = list(conditions) if isinstance(conditions, Iterable) and not isinstance(conditions, str) else []
        max_frames = stated.get("max_frames")
        native_fps = stated.get("native_fps")
        some = bool(asked) and all(item in names for item in asked)
        counted = max_frames is None or (_is_number(max_frames, Integral) and max_frames >= 1)
        paced = native_fps is None or (_is_number(native_fps, Real) and 0 < native_fps < _FASTEST)
        checks = (
            ("conditions", some, f"to be some of {', '.join(sorted(names))}"),
            ("max_frames", counted, "to be a whole number of 1 or more, or None"),
            ("native_fps", paced, "to be frames per second above 0, or None"),
        )
        for name, holds, expected in checks:
            if not holds:
                raise AdapterError(f"{origin}: expected '{name}' {expected}, found {stated.get(name)!r}.")
        return cls(
            frozenset(known(item) for item in asked),
            None if max_frames is None else int(max_frames),
            None if native_fps is None else float(native_fps),
            **{name: bool(stated.get(name, False)) for name in ("motionless", "gaze", "one_design")},
        )


def _is_number(value: object, kind: type) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


_FASTEST = 1e300  # frames per second: a whole number beyond what a float holds is refused
_UNIT_WITHIN = 0.01  # by which a direction's length may differ from 1, such as after rounding to half precision


def impossible_frames(joints: Poses, farthest: float = FARTHEST_COORDINATE) -> Bool[np.ndarray, "*frames"]:
    """Return True for each frame with a coordinate that is not finite, or farther out than any motion goes.

    Args:
        joints: Joint positions, metres.
        farthest: Metres from the origin; infinity to look for what is not finite alone.
    """
    return np.logical_not(_possible(joints, farthest).all(axis=(-2, -1)))


def coordinate_problem(motion: Motion, farthest: float = FARTHEST_COORDINATE) -> str | None:
    """Say where a motion holds an impossible coordinate, and what its numbers look like.

    Args:
        motion: All frames of one motion, as it was handed in.
        farthest: See :func:`impossible_frames`.

    Returns:
        ``frame …`` and the rest of a message, or None if all coordinates are possible.
    """
    frames = np.flatnonzero(impossible_frames(motion, farthest))
    if not frames.size:
        return None
    frame = int(frames[0])
    joint = int(np.flatnonzero(~_possible(motion[frame], farthest).all(axis=1))[0])
    found = ", ".join(f"{value:.6g}" for value in motion[frame, joint])
    finite = np.isfinite(motion[frame, joint]).all()
    expected = f"coordinates within {farthest:g} m of the origin" if finite else "finite positions"
    name = Joint(joint).name.lower().replace("_", " ")
    problem = f"frame {frame}: expected {expected}, found [{found}] at joint {joint} ({name})."
    # Which unit the size of the body looks like.
    unit = wrong_unit(spread_poses(motion.astype(np.float64))) if np.isfinite(motion).all() else None
    if unit is None:
        return problem
    evidence = unit[0].evidence
    return f"{problem} {evidence[0].upper()}{evidence[1:]}: {unit[0].cause}. {unit[0].remedy}"


def gaze_problem(motion: Motion, origin: Vectors, direction: Vectors) -> str | None:
    """Say where gaze is no ray from a head.

    Args:
        motion: The joints of the same frames, metres.
        origin: Between the eyes, same frame and unit.
        direction: Direction of the ray, of length one.

    Returns:
        ``frame …`` and the rest of a message, or None if every frame has a ray from its head.
    """
    away = np.linalg.norm(origin - motion[:, Joint.HEAD], axis=-1)
    length = np.linalg.norm(direction, axis=-1)
    # Written as "not within", so that NaN counts as wrong.
    elsewhere = ~(away <= FARTHEST_EYES)
    no_unit = ~(np.abs(length - 1) <= _UNIT_WITHIN)
    wrong = np.flatnonzero(elsewhere | no_unit)
    if not wrong.size:
        return None
    frame = int(wrong[0])
    if elsewhere[frame]:
        found = f"found them {away[frame]:.3g} m away. Gaze stands in the frame of the joints, in metres."
        return f"frame {frame}: expected eyes within {FARTHEST_EYES:g} m of the head joint, {found}"
    found = f"found {length[frame]:.4g}. Divide each by its length."
    return f"frame {frame}: expected a gaze direction of length 1, {found}"


def _possible(values: np.ndarray, farthest: float) -> np.ndarray:
    """Return True for each number that is finite and within the distance."""
    return np.isfinite(values) & (np.abs(values) <= farthest)


_OPPOSITE = 1e-6  # length of the mean of two unit vectors that point against each other


Ids = Sequence[str]


def generate_checked(
    adapter: Adapter,
    batch: ConditionBatch,
    *,
    seed: int,
    method: str,
    sequence_ids: Ids,
    farthest: float = FARTHEST_COORDINATE,
) -> tuple[Motions, int]:
    """Generate the motions of a batch at the table's rate; one that does not fit in memory is run in halves.

    Args:
        adapter: The method.
        batch: What it may know.
        seed: The run's seed, for the record.
        method: Name of the method, for messages.
        sequence_ids: Names of the rows, for messages; the method never sees them.
        farthest: Metres from the origin beyond which a coordinate is refused; infinity for a network in training.

    Returns:
        float32 motions, and how often a batch was halved.

    Raises:
        AdapterError: if the method raises, or returns something else than one finite motion of the asked length for
            each row; names method, sequence and frame.
    """
    declared = Declared.by(adapter, origin=f"method '{method}'")
    native_fps = declared.native_fps
    asked = batch if native_fps is None else at_native_rate(batch, native_fps)

    def generated(part: ConditionBatch, ids: Ids) -> Motions:
        try:
            motions = adapter.generate(own_copy(part), seed=seed)
        except AdapterError as error:
            raise AdapterError(_with_names(str(error), part, ids)) from error
        except InputFileError as error:  # of a converter, as a rule, which knows neither method nor sequences
            told_of = _with_names(str(error), part, ids)
            raise AdapterError(f"method '{method}' failed: {told_of}{asked_for(ids)}") from error
        return well_formed(motions, part, method=method, sequence_ids=ids, farthest=farthest)

    parts = in_halves(generated, asked, sequence_ids, method=method)
    motions = parts[0] if len(parts) == 1 else _joined(*parts)
    # A run is marked before it begins, so gaze must be announced.
    if declared.gaze is not (motions.gaze is not None):
        expected, found = ("gaze with its motions", "none") if declared.gaze else ("motions without gaze", "some")
        remedy = "Return Motions(…, gaze=Gaze(origin, direction)) and set gaze = True on the adapter, or leave both"
        raise AdapterError(f"method '{method}': expected {expected}, as it declares, found {found}. {remedy} out.")
    if native_fps is not None:
        # The last native frame lies at or after the end, so nothing is extrapolated.
        motions = resampled(motions, batch.n_frames, step=native_fps / batch.fps)
    return motions, len(parts) - 1


def native_frames(n_frames: Int[np.ndarray, " n"], *, fps: float, native_fps: float) -> Int[np.ndarray, " n"]:
    """Count the frames at the native rate that cover ``n_frames`` at the table's: the last one at or after the end."""
    return np.ceil((n_frames - 1) * (native_fps / fps) - 1e-9).astype(np.int64) + 1


def at_native_rate(batch: ConditionBatch, native_fps: float) -> ConditionBatch:
    """Return the batch as the method is to see it.

    The frame before the first lies one native frame before it: its offset, a velocity, is scaled with the rate.
    """
    n_frames = native_frames(batch.n_frames, fps=batch.fps, native_fps=native_fps)
    changed: dict[str, object] = {"fps": native_fps, "n_frames": n_frames}
    if batch.initial_joints is not None and batch.previous_joints is not None:
        step = (batch.previous_joints - batch.initial_joints) * (batch.fps / native_fps)
        changed["previous_joints"] = (batch.initial_joints + step).astype(batch.previous_joints.dtype)
    return dataclasses.replace(batch, **changed)


def resampled(motions: Motions, n_frames: Int[np.ndarray, " n"], *, step: float) -> Motions:
    """Interpolate motions linearly at evenly spaced times; times after their end show their last frame.

    Args:
        motions: Motions at their own rate.
        n_frames: Frames that each shall have.
        step: Frames of ``motions`` from one new frame to the next.
    """
    place = np.arange(int(n_frames.max())) * step
    last = motions.n_frames[:, None] - 1
    left = np.minimum(np.floor(place + 1e-9).astype(np.int64), last)  # (batch, frames)
    right = np.minimum(left + 1, last)
    weight = np.clip(place - left, 0.0, 1.0)[..., None]
    row = np.arange(len(n_frames))[:, None]

    def between(values: np.ndarray) -> np.ndarray:
        share = weight.reshape(*weight.shape[:2], *[1] * (values.ndim - 2))
        return values[row, left] * (1 - share) + values[row, right] * share

    joints = between(motions.joints).astype(np.float32)
    gaze = None
    if motions.gaze is not None:
        direction = between(motions.gaze.direction)
        # Two opposite directions have no middle; then the earlier one stays.
        length = np.linalg.norm(direction, axis=-1, keepdims=True)
        direction = np.where(length > _OPPOSITE, direction, motions.gaze.direction[row, left])
        direction = direction / np.linalg.norm(direction, axis=-1, keepdims=True).clip(_OPPOSITE)
        gaze = Gaze(between(motions.gaze.origin).astype(np.float32), direction.astype(np.float32))
    return Motions(joints, n_frames, motions.cost, gaze)


def well_formed(
    motions: object, batch: ConditionBatch, *, method: str, sequence_ids: Ids, farthest: float = FARTHEST_COORDINATE
) -> Motions:
    """Return the motions as float32 if they are what the contract asks for.

    Args:
        motions: What a method has returned.
        batch: What it was asked for.
        method: Name of the method, for messages.
        sequence_ids: Names of the rows, for messages.
        farthest: See :func:`generate_checked`.

    Raises:
        AdapterError: naming method, sequence and frame, what was expected and what was found.
    """
    ids = sequence_ids
    origin = f"method '{method}'"
    longest = int(batch.n_frames.max())

    def require(holds: bool, expected: str, found: str, remedy: str = "") -> None:
        if not holds:
            raise AdapterError(f"{origin}: expected {expected}, found {found}.{remedy}{asked_for(ids)}")

    require(isinstance(motions, Motions), "prbench.contract.Motions", type(motions).__name__)
    assert isinstance(motions, Motions)
    joints = motions.joints
    remedy = " Give joints.detach().cpu().numpy()." if type(joints).__name__ == "Tensor" else ""
    kind = f"{type(joints).__module__}.{type(joints).__name__}".removeprefix("builtins.")
    require(isinstance(joints, np.ndarray), "joints as a NumPy array", kind, remedy)
    is_cost = motions.cost is None or isinstance(motions.cost, Cost)
    require(is_cost, "cost as prbench.contract.Cost or None", f"{motions.cost!r}")
    fits = joints.ndim == 4 and joints.shape[0] == len(batch) and joints.shape[2:] == (N_JOINTS, 3)
    expected = f"joints of shape ({len(batch)}, {longest} or more, {N_JOINTS}, 3) with decimals"
    require(fits and np.issubdtype(joints.dtype, np.floating), expected, f"{joints.shape} of {joints.dtype}")
    try:
        n_frames = np.asarray(motions.n_frames)
    except (TypeError, ValueError, RuntimeError):  # such as a tensor on another device, or a ragged list
        n_frames = np.empty(0)
    if n_frames.shape != batch.n_frames.shape or (n_frames != batch.n_frames).any():
        row = 0 if n_frames.shape != batch.n_frames.shape else int(np.flatnonzero(n_frames != batch.n_frames)[0])
        found = n_frames[row] if n_frames.shape == batch.n_frames.shape else f"n_frames of shape {n_frames.shape}"
        raise AdapterError(f"{origin}, sequence {ids[row]}: expected {batch.n_frames[row]} frames, found {found}.")
    if joints.shape[1] < longest:
        row = int(batch.n_frames.argmax())
        found = f"{joints.shape[1]} in joints"
        raise AdapterError(f"{origin}, sequence {ids[row]}: expected {longest} frames, found {found}.")
    with np.errstate(over="ignore"):
        joints = joints[:, :longest].astype(np.float32)
    # Refuse coordinates that are not finite or far beyond any room; what the padding holds does not matter.
    valid = np.arange(joints.shape[1]) < batch.n_frames[:, None]
    rows = np.flatnonzero((impossible_frames(joints, farthest) & valid).any(axis=1))
    if rows.size:
        row = int(rows[0])
        problem = coordinate_problem(joints[row, : batch.n_frames[row]], farthest)
        raise AdapterError(f"method '{method}', sequence {ids[row]}, {problem}")
    if motions.gaze is None:
        return Motions(joints, batch.n_frames, motions.cost)
    require(isinstance(motions.gaze, Gaze), "prbench.contract.Gaze or None", type(motions.gaze).__name__)
    rays = []
    for name in ("origin", "direction"):
        values = getattr(motions.gaze, name)
        fits = isinstance(values, np.ndarray) and values.ndim == 3 and values.shape[::2] == (len(batch), 3)
        fits = fits and values.shape[1] >= longest and np.issubdtype(values.dtype, np.floating)
        expected = f"gaze.{name} as a NumPy array of shape ({len(batch)}, {longest} or more, 3) with decimals"
        found = f"{values.shape} of {values.dtype}" if isinstance(values, np.ndarray) else type(values).__name__
        require(fits, expected, found)
        with np.errstate(over="ignore"):
            rays.append(values[:, :longest].astype(np.float32))
    for row, frames in enumerate(batch.n_frames):
        problem = gaze_problem(joints[row, :frames], rays[0][row, :frames], rays[1][row, :frames])
        if problem:
            raise AdapterError(f"{origin}, sequence {ids[row]}, gaze, {problem}")
    return Motions(joints, batch.n_frames, motions.cost, Gaze(*rays))


def own_copy(batch: ConditionBatch) -> ConditionBatch:
    """Copy all arrays: a method that writes into its batch changes neither its next sample nor our checks."""
    arrays = {name: value.copy() for name, value in vars(batch).items() if isinstance(value, np.ndarray)}
    return dataclasses.replace(batch, **arrays)


def _with_names(message: str, batch: ConditionBatch, ids: Sequence[str]) -> str:
    """Replace opaque ids in a message of a method by the names that a user knows."""
    for opaque_id, name in zip(batch.opaque_id, ids, strict=True):
        message = re.sub(rf"\b{re.escape(opaque_id)}\b", lambda _: name, message)  # noqa: B023 - called at once
    return message


def told(error: BaseException) -> str:
    """Describe an exception with the file and line that raised it, for whoever has to repair the method."""
    raised_at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({raised_at.filename}, line {raised_at.lineno})".replace(":  (", " (")


def _joined(*parts: Motions) -> Motions:
    longest = max(part.joints.shape[1] for part in parts)

    def stacked(arrays: Sequence[np.ndarray]) -> np.ndarray:
        widths = [[(0, 0), (0, longest - each.shape[1]), *[(0, 0)] * (each.ndim - 2)] for each in arrays]
        return np.concatenate([np.pad(each, width) for each, width in zip(arrays, widths, strict=True)])

    passes = [part.cost.network_passes for part in parts if part.cost is not None]
    rays = [part.gaze for part in parts if part.gaze is not None]
    gaze = None
    if len(rays) == len(parts):
        gaze = Gaze(stacked([each.origin for each in rays]), stacked([each.direction for each in rays]))
    n_frames = np.concatenate([part.n_frames for part in parts])
    return Motions(stacked([part.joints for part in parts]), n_frames, Cost(sum(passes)) if passes else None, gaze)


def in_halves(
    ask: Callable[[Any, Ids], _Answer], batch: Any, ids: Ids, *, method: str, case: str = "sequence", remedy: str = ""
) -> list[_Answer]:
    """Ask about a batch; one that does not fit in memory is cut in two, and has an answer for each part.

    Args:
        ask: Returns the answer to a batch, given the names of its cases.
        batch: What can be cut by its method ``rows``.
        ids: Names of the cases, for messages.
        method: Name of the method, for messages.
        case: What a case is called.
        remedy: What else makes a single case smaller, in words.

    Raises:
        AdapterError: if the method raises anything but prbench's own errors, or a single case does not fit in memory.
    """
    try:
        return [ask(batch, ids)]
    except PrbenchError:
        raise
    except (Exception, SystemExit) as error:
        if not is_out_of_memory(error):
            raise AdapterError(f"method '{method}' failed: {told(error)}.{asked_for(ids, case)}") from error
        if len(batch) == 1:
            problem = f"method '{method}' ran out of memory on the single {case} {ids[0]}."
            raise AdapterError(f"{problem} Use a device with more memory{remedy}.") from error
    # Outside of the handler: its traceback would hold the tensors of the failed batch.
    release_memory()
    middle = len(batch) // 2
    told_of: Any = {"method": method, "case": case, "remedy": remedy}
    first = in_halves(ask, batch.rows(0, middle), ids[:middle], **told_of)
    return first + in_halves(ask, batch.rows(middle, len(batch)), ids[middle:], **told_of)


def release_memory() -> None:
    """Give back what a failed batch holds, before it is tried in halves."""
    gc.collect()
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        torch.cuda.empty_cache()


def asked_for(ids: Sequence[str], case: str = "sequence") -> str:
    """Say what was asked for; names are long, so it comes behind the reason."""
    batch = f"{case} {ids[0]}" if len(ids) == 1 else f"the batch of {len(ids)} {case}s from {ids[0]} to {ids[-1]}"
    return f" It was asked for {batch}."
