"""What the player is told of one sequence: numbers, verdicts and spans that Python has decided, as small JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import head_forward
from prbench.metrics import METRICS, MotionBatch
from prbench.metrics.footing import sliding_steps
from prbench.metrics.ray_track import candidate_frames
from prbench.viewing.replay import scene as replay

Points = Float[np.ndarray, "*n 3"]
MILLIMETRES = 1000
_UNIT = 10_000  # that a direction of length one is written as
_LARGEST = 32_767  # of int16: 32 m; what is farther away is drawn there
# Verdicts that no picture of the study shows beside its own scores.
_FURTHER = tuple(info for info in METRICS if info.id in ("plausible", "foot_skating"))


class Score(msgspec.Struct, frozen=True, kw_only=True):
    """One score of a motion in words.

    Attributes:
        title: Name of the metric.
        text: Its value.
        good: Whether a rate was won; None for a length, which is neither.
    """

    title: str
    text: str
    good: bool | None


class PlayerGoal(msgspec.Struct, frozen=True, kw_only=True):
    """Place of the goal; canonical frame, metres.

    Attributes:
        location: The goal itself.
        box: Corners of its box in the order of :data:`prbench.viewing.figures.BOX_EDGES`.
    """

    location: list[float]
    box: list[list[float]]


class PlayerLimits(msgspec.Struct, frozen=True, kw_only=True):
    """The protocol's thresholds.

    Attributes:
        prime_distance: Largest distance of the goal to a ray on target, metres.
        reach_distance: Largest distance of the goal to a wrist that reached it, metres.
        window: First and last frame at which Prime Success lets priming begin; empty where there is none.
    """

    prime_distance: float
    reach_distance: float
    window: list[int]


class PlayerObject(msgspec.Struct, frozen=True, kw_only=True):
    """An object beside the goal.

    Attributes:
        name: Its name.
        box: Corners of its box at the first frame, canonical frame, metres, in the order of ``BOX_EDGES``.
        path: Its place in every frame, int16 millimetres (n, 3); None if it stands still.
    """

    name: str
    box: list[list[float]]
    path: bytes | None = None


class PlayerMesh(msgspec.Struct, frozen=True, kw_only=True):
    """Triangles of the surroundings.

    Attributes:
        vertices: Canonical frame, int16 millimetres (n, 3).
        triangles: Numbers of vertices, uint32 (m, 3).
    """

    vertices: bytes
    triangles: bytes


class PlayerMotion(msgspec.Struct, frozen=True, kw_only=True):
    """One motion. Arrays are little-endian; msgspec writes them as base64.

    Attributes:
        label: Whose motion it is.
        kind: ``recorded``, ``method`` or ``control``.
        colour: ``#rrggbb``.
        joints: Canonical frame, int16 millimetres (n, 22, 3).
        head_ray: Head-forward unit vectors, int16 (n, 3) in ten thousandths.
        gaze: Origin in millimetres and direction in ten thousandths, int16 (n, 6); None without eyes.
        gaze_valid: Whether the gaze was measured, uint8 (n).
        wrist: Distance of the nearer wrist to the goal, int16 millimetres (n); None without a goal.
        head: Distance of the goal to the head-forward ray, int16 millimetres (n); None without a goal.
        on_target: Spans of frames, first and last, with the ray within ``prime_distance``.
        within_reach: Spans of frames with a wrist within ``reach_distance``.
        scores: The known scores.
        sliding: Spans of frames from which a foot on the floor slides (docs/specification/metrics.md#footing).
    """

    label: str
    kind: str
    colour: str
    joints: bytes
    head_ray: bytes
    gaze: bytes | None = None
    gaze_valid: bytes | None = None
    wrist: bytes | None = None
    head: bytes | None = None
    on_target: list[list[int]] = []
    within_reach: list[list[int]] = []
    scores: list[Score] = []
    sliding: list[list[int]] = []


class PlayerSequence(msgspec.Struct, frozen=True, kw_only=True):
    """One sequence with its motions.

    Attributes:
        version: Version of this form.
        sequence_id: Id of the sequence.
        dataset: Name of its dataset.
        title: Action, object, hand and split in words.
        action: ``pick`` or ``put``.
        fps: Frames per second.
        n_frames: Number of frames.
        prime_time: Seconds after frame 0.
        event_time: Seconds after frame 0.
        notice: Sentence that the dataset's terms ask a view to show.
        goal: None where it is withheld or unknown.
        limits: Thresholds that the scores were made with.
        objects: Other objects, where the recordings are at hand.
        mesh: The surroundings, where the user has them.
        motions: The recorded motion first, unless it is withheld.
    """

    version: int = 1
    sequence_id: str
    dataset: str
    title: str
    action: str
    fps: float
    n_frames: int
    prime_time: float
    event_time: float
    notice: str
    goal: PlayerGoal | None
    limits: PlayerLimits
    objects: list[PlayerObject] = []
    mesh: PlayerMesh | None = None
    motions: list[PlayerMotion]


def player_sequence(scene: replay.Scene) -> PlayerSequence:
    """Tell the player of one scene."""
    limits = scene.thresholds
    lasting = (np.array([scene.n_frames]), np.array([scene.prime_time]), np.array([scene.fps]))
    window = candidate_frames(*lasting, limits)
    goal = None
    if scene.goal is not None:
        goal = PlayerGoal(location=metres(scene.goal.location), box=metres(scene.goal.box_corners))
    frames = [int(window.first[0]), int(window.last[0])] if window.count[0] else []
    same = ("sequence_id", "dataset", "title", "action", "fps", "n_frames", "notice")
    told: dict[str, Any] = {name: getattr(scene, name) for name in same}
    told |= {name: round(getattr(scene, name), 4) for name in ("prime_time", "event_time")}
    distances = {name: getattr(limits, name) for name in ("prime_distance", "reach_distance")}
    told["motions"] = [_motion(scene, motion) for motion in scene.motions]
    return PlayerSequence(goal=goal, limits=PlayerLimits(window=frames, **distances), **told)


def _motion(scene: replay.Scene, motion: replay.ShownMotion) -> PlayerMotion:
    limits = scene.thresholds
    forward, _ = head_forward(motion.joints, scene.head_tilt_deg)
    told: dict[str, Any] = {name: getattr(motion, name) for name in ("label", "kind", "colour")}
    told |= {"joints": packed(motion.joints), "head_ray": packed(forward, _UNIT), "scores": scores_of(scene, motion)}
    if motion.gaze is not None:
        # Where the gaze is not valid its numbers mean nothing and may be NaN.
        rays = np.concatenate([MILLIMETRES * motion.gaze.origin, _UNIT * motion.gaze.direction], axis=1)
        told["gaze"] = packed(np.nan_to_num(rays), 1)
        told["gaze_valid"] = motion.gaze.valid.astype(np.uint8).tobytes()
    if scene.goal is not None:
        head, wrist = replay.measure(motion, scene.goal, scene.head_tilt_deg)
        told |= {"wrist": packed(wrist), "head": packed(head)}
        told["on_target"] = spans(head <= limits.prime_distance + limits.threshold_tolerance)
        told["within_reach"] = spans(wrist <= limits.reach_distance + limits.threshold_tolerance)
    if scene.n_frames > 1:  # a single frame has no step
        batch = MotionBatch(motion.joints, np.array([0, scene.n_frames]))
        told["sliding"] = spans(sliding_steps(batch, np.array([scene.fps]), limits))
    return PlayerMotion(**told)


def scores_of(scene: replay.Scene, motion: replay.ShownMotion) -> list[Score]:
    """Return the scores that pictures show, and whether the motion is plausible and skates.

    Args:
        scene: The sequence.
        motion: One of its motions.
    """
    known = replay.known_scores(scene, motion)
    for info in _FURTHER:
        value = motion.scores.get(info.id)
        if value is not None:
            yes_or_no = "yes" if value >= 0.5 else "no"
            known.append((info.title, yes_or_no if info.unit == "rate" else f"{100 * value:.0f} % of steps"))
    # Of Location Error a "no" is good.
    good = {(info.title, "yes"): info.higher_is_better for info in METRICS if info.unit == "rate"}
    good |= {(title, "no"): not better for (title, _), better in good.items()}
    return [Score(title=title, text=text, good=good.get((title, text))) for title, text in known]


def spans(mask: Bool[np.ndarray, " n"]) -> list[list[int]]:
    """Return the first and last frame of each stretch in which a mask holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [[int(first), int(after) - 1] for first, after in edges.reshape(-1, 2)]


def metres(points: Points) -> list:
    """Return points as numbers of JSON, to a tenth of a millimetre."""
    return np.round(points.astype(np.float64), 4).tolist()


def packed(values: Float[np.ndarray, "*n"], scale: int = MILLIMETRES) -> bytes:
    """Return little-endian int16 of lengths in metres, or of other values times a scale; what is too large is cut."""
    return np.clip(np.rint(values * scale), -_LARGEST, _LARGEST).astype("<i2").tobytes()


def encoded(told: Any) -> bytes:
    """Return JSON, such as that of a sequence; nothing in a name can end the script element that holds it."""
    return msgspec.json.encode(told).replace(b"<", b"\\u003c")


def within(sequences: Iterable[PlayerSequence], largest: int) -> Sequence[PlayerSequence]:
    """Return as many sequences from the first on as have no more bytes of JSON than ``largest`` together."""
    kept = []
    size = 0
    for sequence in sequences:
        size += len(encoded(sequence))
        if kept and size > largest:
            break
        kept.append(sequence)
    return kept
