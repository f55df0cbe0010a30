"""The data that one picture, film or page shows of one sequence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import BONES, WRISTS, Joint, head_forward
from prbench.metrics import STUDY_METRICS, GazeRays, MetricInfo
from prbench.metrics.ray_track import ray_distance
from prbench.protocol.manifests import MetricConstants
from prbench.sequences import DatasetInfo
from prbench.viewing.figures import BOX_EDGES, Flatten, Vector, horizontal_direction

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vectors = Float[np.ndarray, "n 3"]
Arrows = Float[np.ndarray, "n 2 3"]
Distances = Float[np.ndarray, " n"]

# Label of the recorded motion.
RECORDED = "ground truth"

# Called with finished steps, all steps, and the sequence that was worked on last.
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """One motion of a sequence: the recorded one, or what a method made of it.

    Attributes:
        colour: ``#rrggbb``.
        joints: Canonical frame, metres.
        scores: Maps metric ids to values; rates are 0 or 1. Empty if the motion was not scored.
        gaze: Recorded with the motion, or generated with it; None for a motion without eyes.
        kind: ``recorded``, ``method`` or ``control``.
    """

    label: str
    colour: str
    joints: Float[np.ndarray, "n 22 3"]
    scores: Mapping[str, float] = field(default_factory=dict)
    gaze: GazeRays | None = None
    kind: str = "method"


@dataclass(frozen=True, eq=False)
class Goal:
    """Place of the object at the event; canonical frame, metres.

    Attributes:
        box_corners: Corners in the order that :data:`prbench.viewing.figures.BOX_EDGES` expects.
    """

    location: Vector
    box_corners: Float[np.ndarray, "8 3"]


@dataclass(frozen=True, eq=False)
class Scene:
    """One sequence with its motions.

    Attributes:
        title: Action, object, hand and split in words.
        action: ``pick`` or ``put``.
        prime_time: Seconds after the first frame; the event is the last frame.
        head_tilt_deg: See :func:`prbench.geometry.skeleton.head_forward`.
        motions: The recorded motion first, unless it is withheld.
        thresholds: The protocol's limits of priming and reaching, drawn beside the measured values.
        goal: None where the recorded motion is withheld, and where the goal's place is unknown.
        notice: Sentence that the dataset's terms ask a view to show.
        info: Description of the table; None for a scene of no table.
        recording_id: The recording that the sequence was cut from.
        start_time: Time of the first frame on the recording's clock, seconds.
        world_from_canonical: Maps canonical coordinates into the recording's world.
    """

    sequence_id: str
    dataset: str
    title: str
    action: str
    fps: float
    n_frames: int
    prime_time: float
    head_tilt_deg: float
    motions: tuple[ShownMotion, ...]
    thresholds: MetricConstants
    goal: Goal | None = None
    notice: str = ""
    info: DatasetInfo | None = None
    recording_id: str = ""
    start_time: float = 0.0
    world_from_canonical: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))

    @property
    def shows_recorded(self) -> bool:
        """True if the first motion is the recorded one."""
        return self.motions[0].label == RECORDED

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Times of the frames, seconds after the first."""
        return np.arange(self.n_frames) / self.fps

    @property
    def event_time(self) -> float:
        """Time of the event, seconds after the first frame."""
        return (self.n_frames - 1) / self.fps

    @property
    def goal_location(self) -> Vector | None:
        """Location of the goal, canonical frame, metres; None without a goal."""
        return None if self.goal is None else self.goal.location

    @property
    def prime_frame(self) -> int:
        """The frame nearest to the prime time."""
        # A prime between two frames may round to the frame after the last.
        return int(np.clip(round(self.prime_time * self.fps), 0, self.n_frames - 1))

    @property
    def picture_axis(self) -> Vector:
        """Horizontal unit vector that points to the right in side views, so that the reach is seen from the side.

        It points from the first motion's pelvis to the goal at the event; without a goal, from where that pelvis began
        to where it ends.
        """
        pelvis = self.motions[0].joints[:, Joint.PELVIS]
        if self.goal is None:
            return horizontal_direction(pelvis[-1] - pelvis[0])
        return horizontal_direction(self.goal.location - pelvis[-1])


# Rates are shown as yes or no, metres as lengths; a ratio such as Foot Skating says little of one sequence.
_SHOWN = sorted((info for info in STUDY_METRICS if info.unit in ("rate", "m")), key=lambda i: i.unit != "rate")
_OF_ONE_MOTION = tuple(info for info in _SHOWN if not info.compares_with_recorded)
_OF_TWO_MOTIONS = tuple(info for info in _SHOWN if info.compares_with_recorded)
# Titles of the scores; "nearest wrist" is the smallest distance between a wrist and the goal.
TITLES = (*(info.title for info in _OF_ONE_MOTION), "nearest wrist", *(info.title for info in _OF_TWO_MOTIONS))
_UNKNOWN = "–"


def measure(motion: ShownMotion, goal: Goal, head_tilt_deg: float) -> tuple[Distances, Distances]:
    """Return the distances of the goal from the head-forward ray and from the nearer wrist in each frame, metres.

    Sources: docs/specification/humanml3d.md#head-forward-vector, docs/specification/metrics.md#prime-success and
    docs/specification/metrics.md#reach-success.
    """
    head = motion.joints[:, Joint.HEAD]
    forward, _ = head_forward(motion.joints, head_tilt_deg)
    wrists = np.linalg.norm(motion.joints[:, list(WRISTS)] - goal.location, axis=2)
    return ray_distance(head, forward, goal.location[None]), wrists.min(axis=1)


def gaze_distance(gaze: GazeRays, goal: Goal) -> Distances:
    """Return the distance of the goal from the recorded gaze ray, metres; NaN where the gaze is not valid."""
    return np.where(gaze.valid, ray_distance(gaze.origin, gaze.direction, goal.location[None]), np.nan)


def score_row(scene: Scene, motion: ShownMotion) -> tuple[str, ...]:
    """Return the scores in the order of :data:`TITLES`; an en dash stands for an unknown value.

    The recorded motion gets no scores that would compare it with itself.
    """
    wrist = None
    if scene.goal is not None:
        wrist = float(measure(motion, scene.goal, scene.head_tilt_deg)[1].min())
    recorded = motion is scene.motions[0] and scene.shows_recorded
    compared = [_UNKNOWN if recorded else _cell(info, motion) for info in _OF_TWO_MOTIONS]
    return (*(_cell(info, motion) for info in _OF_ONE_MOTION), _length(wrist), *compared)


def known_scores(scene: Scene, motion: ShownMotion) -> list[tuple[str, str]]:
    """Return the title and value of each known score of a motion."""
    return [pair for pair in zip(TITLES, score_row(scene, motion), strict=True) if pair[1] != _UNKNOWN]


def verdict(scene: Scene, motion: ShownMotion) -> str:
    """Return the two main scores in a few words."""
    cells = score_row(scene, motion)
    if cells[0] == _UNKNOWN:
        return "not scored"
    scores = ", ".join(f"{info.title} {cell}" for info, cell in zip(_OF_ONE_MOTION, cells))
    return f"{scores} ({cells[len(_OF_ONE_MOTION)]})"


def phase(scene: Scene, frame: int) -> str:
    """Name prime and event at the frames where they happen; the prime for a quarter of a second, so that it is seen."""
    if frame == scene.n_frames - 1:
        return f"{scene.action}  "
    since = frame / scene.fps - scene.prime_time
    return "prime  " if abs(since) <= 0.125 else ""


def _cell(info: MetricInfo, motion: ShownMotion) -> str:
    value = motion.scores.get(info.id)
    if info.unit != "rate" or value is None:
        return _length(value)
    return "yes" if value >= 0.5 else "no"


def _length(metres: float | None) -> str:
    if metres is None:
        return _UNKNOWN
    return f"{metres * 100:.0f} cm" if metres < 0.995 else f"{metres:.2f} m"


RECORDED_COLOUR = "#303030"
# Colours of the runs in the order in which they are named; more could not be told apart.
METHOD_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#999933", "#882255")
GAZE_COLOUR = "#e69f00"
GOAL_COLOUR = "#56b4e9"
BOX_COLOUR = "#1b6f9c"
MARK_COLOUR = "#555555"


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def paler(colour: str) -> str:
    """Return a colour, ``#rrggbb``, half as far from white."""
    return "#" + "".join(f"{(each + 255) // 2:02x}" for each in rgb(colour))


def gaze_style(motion: ShownMotion) -> dict[str, Any]:
    """Return how the gaze of one of several motions is drawn in a panel that they share."""
    if motion.label == RECORDED:
        return {"color": GAZE_COLOUR}
    return {"color": motion.colour, "linestyle": ":"}


def bone_segments(points: Float[np.ndarray, "*poses 22 k"]) -> Float[np.ndarray, "*poses 21 2 k"]:
    """Return both ends of every bone, in the order of ``skeleton.BONES``."""
    return points[..., np.array(BONES), :]


def side_view(
    points: Float[np.ndarray, "*n 3"], axis: Vector, around: Float[np.ndarray, "*m 3"] | None = None
) -> Float[np.ndarray, "*n 2"]:
    """Project points onto a horizontal axis, counted from ``around``, and onto the vertical; metres."""
    across = points @ axis
    if around is not None:
        across = across - around @ axis
    return np.stack([across, points[..., 1]], axis=-1)


def top_view(points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Return ground coordinates (x, z), metres; a panel lets x grow to the left, as seen from above."""
    return points[..., [0, 2]]


def head_rays(joints: Float[np.ndarray, "n 22 3"], head_tilt_deg: float, goal: Vector | None, longest: float) -> Arrows:
    """Return head-forward rays from the head joint (docs/specification/humanml3d.md#head-forward-vector).

    Args:
        joints: Canonical frame, metres.
        head_tilt_deg: See :func:`prbench.geometry.skeleton.head_forward`.
        goal: See :func:`rays`.
        longest: See :func:`rays`.
    """
    forward, _ = head_forward(joints, head_tilt_deg)
    return rays(joints[:, Joint.HEAD], forward, goal, longest)


def rays(origin: Vectors, direction: Vectors, goal: Vector | None, longest: float) -> Arrows:
    """Return segments from ``origin`` along the unit ``direction``, metres.

    A segment is as long as the distance to the goal, so that a ray that meets the goal ends there; ``longest`` where
    the goal is farther away or unknown.
    """
    length = np.full(len(origin), longest)
    if goal is not None:
        length = np.minimum(np.linalg.norm(goal - origin, axis=1), longest)
    return np.stack([origin, origin + length[:, None] * direction], axis=1)


def extent(scene: Scene, flat: Flatten) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and greatest coordinates of what must be seen: pelvis paths, last poses and the goal.

    Args:
        scene: The sequence.
        flat: Maps points (..., 3) to the picture's coordinates.
    """
    points = [flat(motion.joints[:, Joint.PELVIS]) for motion in scene.motions]
    points += [flat(motion.joints[-1]) for motion in scene.motions]
    if scene.goal is not None:
        points.append(flat(scene.goal.box_corners))
    everything = np.concatenate(points)
    return everything.min(axis=0), everything.max(axis=0)


def draw_goal(axes: Axes, goal: Goal, flat: Flatten, *, linewidth: float, markersize: float, zorder: int) -> None:
    """Draw the edges of a goal's box and a square at its location, both made flat."""
    corners = flat(goal.box_corners)
    for one, other in BOX_EDGES:
        axes.plot(*corners[[one, other]].T, color=BOX_COLOUR, linewidth=linewidth, zorder=zorder)
    axes.plot(*flat(goal.location), "s", color=GOAL_COLOUR, markersize=markersize, zorder=zorder)
