"""`prbench view` of runs of motion prediction: possible futures of a window as a fan of bodies.

Each run fills a row: bodies from the side at some moments after the last observed frame, ways from above, and how far
each future is from what happened. What was observed is grey, what happened is black.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import UsageError
from prbench.harness.run_folder.folder import DatasetFolder
from prbench.sequences.dataset_info import notice, require_may_pass_on
from prbench.sequences.schema import read_parquet
from prbench.sequences.table import by_share, find_sequence_id
from prbench.shown import figure_text
from prbench.viewing import figures
from prbench.viewing.replay.read import run_labels
from prbench.viewing.replay.scene import METHOD_COLOURS
from prbench.viewing.view import DEFAULT_LIMIT, ViewReport, ViewRequest
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.benchmark import run_on
from prbench_benchmarks.motion_prediction.joint_sets import JointSet, transform_each
from prbench_benchmarks.motion_prediction.metrics import displacements, frame_errors, joint_errors
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import WindowsTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RECORDED_COLOUR = "#000000"
OBSERVED_COLOUR = "#8c8c8c"
GAZE_COLOUR = "#e69f00"
GOAL_COLOUR = "#56b4e9"
MOST_ROWS = 12
_MOMENTS = (0.5, 1.0, 1.5, 2.0)  # seconds after the last observed frame
_OBSERVED_POSES = 3  # of the observed frames, evenly spread
_SPACING = 0.45  # metres between the bodies of two moments
_MARGIN = 0.3  # metres
_LOOK = 0.6  # metres of the line that shows where gaze points
_LINE = 140  # characters of the note below the panels


@dataclass(frozen=True, eq=False)
class Fan:
    """The futures of one run in a window.

    Attributes:
        colour: ``#rrggbb``.
        joints: Room, metres.
        score: ADE and FDE, in words.
    """

    label: str
    colour: str
    joints: Float[np.ndarray, "samples future joints 3"]
    score: str

    @property
    def shades(self) -> list[tuple[float, float, float]]:
        """A colour for each future."""
        return figures.shades(self.colour, len(self.joints))


@dataclass(frozen=True, eq=False)
class ShownWindow:
    """One window with the futures that runs hold of it. Room, metres.

    Attributes:
        recorded: What happened, up to the last scored frame.
        look: Line from the head along the gaze of the last observed frame; None where it was not measured.
        goal: Place of the hand at the event; None where the window does not reach it.
        notice: Sentence that the dataset's terms ask for; empty where they ask for none.
    """

    sequence_id: str
    dataset: str
    title: str
    joint_set: JointSet
    fps: float
    observed: Float[np.ndarray, "observed joints 3"]
    recorded: Float[np.ndarray, "scored joints 3"]
    look: Float[np.ndarray, "2 3"] | None
    goal: Float[np.ndarray, "3"] | None
    motions: tuple[Fan, ...]
    notice: str

    @property
    def pelvis(self) -> int:
        """Place of the pelvis among the joints."""
        return self.joint_set.index(self.joint_set.pelvis)[0]

    @property
    def floor(self) -> float:
        """Height of the lowest joint that was seen, metres."""
        return float(self.observed[..., 1].min())

    @property
    def sideways(self) -> Float[np.ndarray, "3"]:
        """Horizontal unit vector that points to the right in side views: where the body goes, or else faces."""
        way = self.recorded[-1, self.pelvis] - self.observed[0, self.pelvis]
        if np.hypot(way[0], way[2]) < 0.1:
            way = self.joint_set.last_pose_frame(self.observed[-1:])[0, :3, 2]
        return figures.horizontal_direction(way)

    def errors(self, fan: Fan) -> Float[np.ndarray, "samples scored"]:
        """Mean distance of the joints from what happened, metres."""
        n = min(len(self.recorded), fan.joints.shape[1])
        return joint_errors(fan.joints[None, :, :n], self.recorded[None, :n])[0].mean(axis=-1)


@dataclass(frozen=True)
class FuturesReport(ViewReport):
    """The windows that were shown."""

    def told(self, scene: Any, motion: Any) -> str:  # noqa: ARG002 - as the base class
        """Return what a run scored in a window."""
        return motion.score


def view_futures(request: ViewRequest) -> FuturesReport:
    """Draw the futures of runs into a picture, a row for each window and run.

    Raises:
        RedistributionError: if the dataset's licence keeps recorded motion.
        RunError: for a run of another benchmark or table.
        TableError: if the windows cannot be read.
        UsageError: for a window that is not in all runs, or too much for one picture.
        StorageError: if the file cannot be written.
    """
    figures.require_drawable(request.out)
    if len(request.data) != 1 or request.sample:
        raise UsageError("runs of motion prediction: name their windows with one --data DIR; no --sample.")
    table = WindowsTable.open(request.data[0])
    # What was observed stands in every view.
    require_may_pass_on(table.info, "the view", request.permitted)
    runs = [run_on(path, table) for path in request.runs]
    labels = run_labels([run.path for run, _ in runs], [run.record for run, _ in runs])
    windows = table.windows["window_id"].to_pylist()
    known = held_windows([files for _, files in runs], windows)
    if request.sequences:
        chosen = {find_sequence_id(name, known, among="the windows of these runs") for name in request.sequences}
    else:
        rows = table.windows["row"].take([windows.index(name) for name in known])
        recordings = table.runs["recording_id"].take(rows).to_pylist()
        chosen = set(by_share(known, recordings)[: request.limit or DEFAULT_LIMIT])
    if not 0 < len(chosen) * len(runs) <= MOST_ROWS:
        problem = f"expected 1 to {MOST_ROWS} rows (windows times runs), found {len(chosen) * len(runs)}."
        raise UsageError(f"{request.out}: {problem}")
    places = np.array([place for place, name in enumerate(windows) if name in chosen])
    futures = [read_futures(files, chosen, len(table.joints.names)) for _, files in runs]
    shown = []
    condition = Condition.POSE_GAZE if table.info.has_gaze else Condition.POSE
    frame = load_prediction_protocol().evaluation.frame
    batch, truth = next(table.batches(condition, places, frame=frame, size=len(places)))
    turns = truth.room_from_batch.copy()
    turns[:, :3, 3] = 0.0
    observed = transform_each(truth.room_from_batch, batch.observed_joints)
    recorded = transform_each(truth.room_from_batch, truth.joints)
    goal = transform_each(truth.room_from_batch, truth.goal)
    for row, name in enumerate(truth.window_ids):
        n = int(truth.n_scored[row])
        look = None
        if batch.gaze is not None and batch.gaze_valid is not None and batch.gaze_valid[row, -1]:
            head = observed[row, -1, table.joints.index(table.joints.head)[0]]
            direction = transform_each(turns[row : row + 1], batch.gaze[row : row + 1, -1])[0]
            look = np.stack([head, head + _LOOK * direction])
        fans = []
        for label, colour, found in zip(labels, METHOD_COLOURS, futures, strict=False):
            joints = found[name]
            error = displacements(frame_errors(joints[None, :, :n], truth.joints[row : row + 1, :n]))
            score = f"ADE {error['ade'][0]:.2f} m, FDE {error['fde'][0]:.2f} m"
            in_room = transform_each(truth.room_from_batch[row : row + 1], joints[None])[0]
            fans.append(Fan(label, colour, in_room, score))
        title = "Synthetic people." if table.info.dataset.startswith(SYNTHETIC_PREFIX) else ""
        end = goal[row] if np.isfinite(goal[row]).all() else None
        said = notice(table.info, request.permitted)
        seen = (observed[row], recorded[row, :n], look, end, tuple(fans))
        shown.append(ShownWindow(name, table.info.dataset, title, table.joints, batch.fps, *seen, said))
    caption = _draw(shown, request)
    return FuturesReport(request.out, tuple(shown), caption=caption)


def held_windows(files: Sequence[DatasetFolder], windows: Sequence[str]) -> list[str]:
    """Return the ids of those windows of which all runs hold futures."""
    held = set(windows)
    for each in files:
        parts = [read_parquet(path, ["sequence_id"]) for path in each.predictions.glob("part-*.parquet")]
        held &= {name for part in parts for name in part["sequence_id"].to_pylist()}
    return [name for name in windows if name in held]


def read_futures(
    files: DatasetFolder, chosen: set[str], joints: int
) -> dict[str, Float[np.ndarray, "samples future _ 3"]]:
    """Return the futures of some windows by id, in the order of their samples and in the frame of the batch."""
    found: dict[str, list[np.ndarray]] = {}
    for path in sorted(files.predictions.glob("part-*.parquet")):
        rows = read_parquet(path, ["sequence_id", "joints"])
        wanted = pc.is_in(rows["sequence_id"], value_set=pa.array(sorted(chosen))).to_numpy()
        for row in np.flatnonzero(wanted).tolist():
            values = rows["joints"][row].values.flatten().to_numpy()
            found.setdefault(rows["sequence_id"][row].as_py(), []).append(values.reshape(-1, joints, 3))
    return {name: np.stack(samples) for name, samples in found.items()}


@figures.styled
def _draw(windows: Sequence[ShownWindow], request: ViewRequest) -> str:
    """Draw windows below one another, a row for each run, and return the caption."""
    rows = [(window, fan) for window in windows for fan in window.motions]
    height = 1.55 * len(rows) + 0.7
    figure = figures.new_figure(7.0, height)
    grid = {"left": 0.005, "right": 0.992, "top": 1 - 0.4 / height, "bottom": 0.5 / height}
    grid |= {"wspace": 0.2, "hspace": 0.4}
    panels = figure.subplots(len(rows), 3, squeeze=False, width_ratios=(3.4, 1.2, 1.2), gridspec_kw=grid)
    for (window, fan), (bodies, above, errors) in zip(rows, panels, strict=True):
        _draw_bodies(bodies, window, fan)
        title = f"{textwrap.fill(window.sequence_id, 66)}\n{fan.label}: {len(fan.joints)} futures, {fan.score}"
        bodies.set_title(figure_text(title), fontsize=6)
        _draw_from_above(above, window, fan)
        # Mean distance of the joints from what happened over the seconds.
        tracks = window.errors(fan)
        seconds = np.arange(1, tracks.shape[1] + 1) / window.fps
        for track, colour in reversed(list(zip(tracks, fan.shades, strict=True))):
            errors.plot(seconds, track, color=colour, linewidth=0.8)
        # The same for all rows of a window, so that rows compare.
        errors.set_ylim(0.0, 1.05 * max(float(window.errors(each).max()) for each in window.motions) + 1e-3)
        errors.set_title("mean error (m) over s")
    said = [
        "Grey: the observed half second, the last pose darkest; black: what happened; a shade is a future, the same in",
        "all panels of a row.",
    ]
    if any(window.look is not None for window in windows):
        said.append("Orange: recorded gaze at the last observed frame.")
    if any(window.goal is not None for window in windows):
        said.append("Light blue: the goal at the event.")
    said.append(windows[0].title)
    notices = dict.fromkeys(window.notice for window in windows if window.notice)
    foot = "\n".join((*textwrap.wrap(" ".join(said), _LINE), *notices)).strip()
    figure.supxlabel(figure_text(foot), fontsize=6, color="0.35", x=0.01, y=0.01, ha="left")
    caption = f"Possible futures of windows. {' '.join(foot.split())}"
    figures.write_figure(figure, request.out, caption)
    return caption


def _draw_from_above(axes: Axes, window: ShownWindow, fan: Fan) -> None:
    """Draw the ways of the pelvis, and the wrists at the end."""
    pelvis = window.pelvis
    wrists = window.joint_set.index(*window.joint_set.wrists)

    def end(pose: np.ndarray, colour: object) -> None:
        axes.plot(pose[pelvis, 0], pose[pelvis, 2], "s", color=colour, markersize=2.5)
        axes.plot(pose[wrists, 0], pose[wrists, 2], ".", color=colour, markersize=2.5)

    for joints, colour in reversed(list(zip(fan.joints, fan.shades, strict=True))):
        axes.plot(joints[:, pelvis, 0], joints[:, pelvis, 2], color=colour, linewidth=0.9)
        end(joints[-1], colour)
    for joints, colour, width in ((window.observed, OBSERVED_COLOUR, 2.0), (window.recorded, RECORDED_COLOUR, 0.8)):
        axes.plot(joints[:, pelvis, 0], joints[:, pelvis, 2], color=colour, linewidth=width)
    end(window.recorded[-1], RECORDED_COLOUR)
    shown = [window.observed[:, pelvis], window.recorded[:, pelvis], window.recorded[-1][wrists]]
    shown += [each.joints[:, :, pelvis].reshape(-1, 3) for each in window.motions]
    if window.look is not None:
        axes.plot(window.look[:, 0], window.look[:, 2], color=GAZE_COLOUR, linewidth=1.4)
        shown.append(window.look)
    if window.goal is not None:
        axes.plot(window.goal[0], window.goal[2], "s", color=GOAL_COLOUR, markersize=4)
        shown.append(window.goal[None])
    x, z = figures.square_limits(np.concatenate(shown)[:, [0, 2]], margin=_MARGIN)
    # x grows to the left, as for somebody who looks down on a body that faces away from them.
    axes.set_xlim(*reversed(x))
    axes.set_ylim(*z)
    axes.set_aspect("equal")
    axes.set_title("from above (m); ends")


def _draw_bodies(axes: Axes, window: ShownWindow, fan: Fan) -> None:
    """Draw the observed half second, then all futures at some moments, each moment at a place of its own."""
    last = window.observed[-1, window.pelvis]
    chosen = np.linspace(0, len(window.observed) - 1, _OBSERVED_POSES).round().astype(int)
    groups = [(f"+{seconds:g} s", round(seconds * window.fps) - 1) for seconds in _MOMENTS]
    groups = [(name, frame) for name, frame in groups if frame < fan.joints.shape[1]]
    # All poses of each moment with their colours; what futures show after the event nobody has recorded.
    moments: list[tuple[str, list[tuple[np.ndarray, Any, float]], np.ndarray | None]] = []
    greys = reversed(figures.shades(OBSERVED_COLOUR, len(chosen)))
    poses = [(pose, colour, 0.9) for pose, colour in zip(window.observed[chosen], greys, strict=True)]
    moments.append(("observed", poses, None))
    for name, frame in groups:
        poses = [(pose, colour, 0.9) for pose, colour in zip(fan.joints[:, frame], fan.shades, strict=True)][::-1]
        happened = frame < len(window.recorded)
        if happened:
            poses.append((window.recorded[frame], RECORDED_COLOUR, 0.7))
        moments.append((name, poses, window.goal if happened else None))
    clouds = []
    for _, poses, goal in moments:
        points = [pose for pose, _, _ in poses] + ([] if goal is None else [goal[None]])
        clouds.append(figures.flattened(np.concatenate(points), last, window.sideways, 0.0))
    shifts = figures.side_by_side(clouds, spacing=_SPACING)
    head = window.joint_set.index(window.joint_set.head)[0]
    for (name, poses, goal), cloud, shift in zip(moments, clouds, shifts, strict=True):
        for pose, colour, width in poses:
            flat = figures.flattened(pose, last, window.sideways, shift)
            figures.draw_chains(axes, flat, window.joint_set.chains, colour, linewidth=width)
            axes.plot(*flat[head], "o", color=colour, markersize=2.2)
        if goal is not None:
            place = figures.flattened(goal[None], last, window.sideways, shift)[0]
            axes.plot(*place, "s", color=GOAL_COLOUR, markersize=4, zorder=4)
        centre = float(cloud[:, 0].mean()) + shift
        axes.text(centre, window.floor - 0.1, name, fontsize=6, ha="center", va="top", color="0.35")
    if window.look is not None:
        axes.plot(*figures.flattened(window.look, last, window.sideways, shifts[0]).T, color=GAZE_COLOUR, linewidth=1.4)
    figures.frame_side_view(axes, clouds, shifts, _MARGIN, window.floor)
