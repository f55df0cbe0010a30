"""Why a motion is primed or not: one cause for each, and by how much it misses (docs/error-budget.md#prime-success)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from prbench.metrics import MotionBatch, ScoringTargets
from prbench.metrics.prime_success import near_goal, primed
from prbench.metrics.ray_track import CandidateFrames, RayTrack, candidate_frames, head_track
from prbench.protocol.manifests import MetricConstants

PRIMED = "primed"
SLOW = "does not slow"
STAY = "does not stay"
EARLY = "looks early"
LATE = "looks late"
MISS = "misses"
NEVER = "never looks"
UNDEFINED = "undefined"
CAUSES = (PRIMED, SLOW, STAY, EARLY, LATE, MISS, NEVER, UNDEFINED)
"""In the order in which they are asked for: the first that holds is the motion's cause."""

_NEVER_LOOKS_DEG = 30.0
"""Degrees beyond which a head is not said to look towards a goal: eyes alone turn that far from where a head points,
which is why the protocol's breakdown calls goals of a smaller bearing "ahead"."""


@dataclass(frozen=True, eq=False)
class Looking:
    """The head-forward ray of n motions against their goals, around the recorded prime time.

    Elevations are from the horizontal, azimuths about the vertical from where the first pose faces, both seen from the
    head. The best frame is that of the smallest angle between ray and goal among the candidates of Prime Success.
    """

    cause: tuple[str, ...]
    """One of :data:`CAUSES`."""
    miss_deg: Float[np.ndarray, " n"]
    """Angle between ray and goal in the best frame."""
    miss_up_deg: Float[np.ndarray, " n"]
    """Elevation of the ray minus that of the goal in the best frame: positive above the goal."""
    miss_aside_deg: Float[np.ndarray, " n"]
    """Difference of the azimuths in the best frame times the cosine of the goal's elevation: positive to the left."""
    best_time: Float[np.ndarray, " n"]
    """Of the best frame, seconds after the recorded prime time."""
    first_look: Float[np.ndarray, " n"]
    """Beginning of the first stay on the goal in the whole motion, seconds after the prime time; NaN without one."""
    longest_stay: Float[np.ndarray, " n"]
    """Longest time on the goal that begins or goes on among the candidates, seconds."""
    ray_elevation_deg: Float[np.ndarray, " n"]
    """Of the ray in the best frame."""
    goal_elevation_deg: Float[np.ndarray, " n"]
    """Of the goal in the best frame."""
    ray_azimuth_deg: Float[np.ndarray, " n"]
    """Of the ray in the best frame, within half a turn of the goal's."""
    goal_azimuth_deg: Float[np.ndarray, " n"]
    """Of the goal in the best frame."""
    stays: Bool[np.ndarray, " n"]
    """The ray stays on the goal for the protocol's time from some candidate on."""
    stays_with_elevation: Bool[np.ndarray, " n"]
    """It would, if the ray had the goal's elevation in every frame and kept its own azimuth."""
    stays_with_azimuth: Bool[np.ndarray, " n"]
    """It would, if the ray had the goal's azimuth in every frame and kept its own elevation."""


@dataclass(frozen=True, eq=False)
class _Angles:
    """Of ray and goal in some consecutive frames of one motion, degrees."""

    ray_elevation: np.ndarray
    goal_elevation: np.ndarray
    ray_azimuth: np.ndarray
    goal_azimuth: np.ndarray
    distance: np.ndarray
    """From the head to the goal, metres."""

    def near(self, elevation: np.ndarray, azimuth: np.ndarray, limit: float) -> np.ndarray:
        """Return True where a ray of these angles passes the goal within a limit, metres."""
        ray = _unit(elevation, azimuth)
        goal = _unit(self.goal_elevation, self.goal_azimuth)
        cosine = (ray * goal).sum(axis=1)
        sine = np.linalg.norm(np.cross(ray, goal), axis=1)
        return np.where(cosine > 0, self.distance * sine, self.distance) <= limit


def diagnose_looking(motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants) -> Looking:
    """Find out of each motion why it is primed (equation 3) or not.

    With C the candidate frames of Prime Success, K frames of ``prime_duration`` and "on the goal" its distance, the
    cause is the first of these that holds: *primed*; *undefined*, without a candidate frame in which the head has a
    direction; *does not slow*, if the ray stays on the goal for K + 1 frames from a frame of C on, yet in no such frame
    turns more slowly than in the one before; *does not stay*, if it is on the goal in a frame of C; *looks early* or
    *looks late*, if the stay nearest in time lies before or after C; *misses*, if the best frame of C is within 30
    degrees; *never looks* otherwise.

    Args:
        motion: Canonical frame, metres, two frames or more.
        targets: Of the sequences.
        constants: Of the protocol.
    """
    motion.require_frames(2)
    fps = targets.fps_of_sequence
    candidates = candidate_frames(motion.n_frames, targets.prime_time, fps, constants)
    whole = CandidateFrames(
        np.full(motion.n_sequences, 2), motion.n_frames - 1 - candidates.hold, candidates.hold, candidates.before
    )
    track = head_track(motion, whole, targets.goal_location, targets.head_tilt_deg, fps, constants)
    success = primed(track, candidates, constants, "equation")
    on_goal = track.usable & near_goal(track, constants, "equation")
    looks = [
        _look_of(row, track, on_goal, candidates, targets, constants, success=bool(success[row]))
        for row in range(motion.n_sequences)
    ]
    columns = list(zip(*looks, strict=True))
    return Looking(columns[0], *(np.array(column) for column in columns[1:]))


def _look_of(
    row: int,
    track: RayTrack,
    on_goal: np.ndarray,
    candidates: CandidateFrames,
    targets: ScoringTargets,
    constants: MetricConstants,
    *,
    success: bool,
) -> tuple:
    """Return the fields of :class:`Looking` of one motion."""
    first = int(candidates.first[row])
    last = int(candidates.last[row])
    hold = int(candidates.hold[row])
    fps = float(targets.fps_of_sequence[row])
    prime = float(targets.prime_time[row])
    begin = int(track.row_of_frame_0[row])
    # One entry a frame: with candidates from frame 2 to the last but K, the track holds the whole motion.
    rows = np.flatnonzero(track.sequence == row)
    window = slice(begin + first, begin + last + 1)
    if last < first or not track.usable[window].any():
        nothing = (np.nan,) * 10
        return (UNDEFINED, *nothing, False, False, False)
    angle = np.where(track.usable[window], track.angle[window], np.inf)
    best = first + int(angle.argmin())
    on = on_goal[rows]
    stays = np.flatnonzero(_stays(on, hold))
    angles = _angles(track, slice(begin + first, begin + last + hold + 1))
    limit = constants.prime_distance + constants.threshold_tolerance
    at = best - first
    up = angles.ray_elevation[at] - angles.goal_elevation[at]
    aside = angles.ray_azimuth[at] - angles.goal_azimuth[at]
    # Frames of the longest run on the goal that has a frame from ``first`` to ``last``.
    edges = np.diff(np.concatenate(([0], on.astype(np.int8), [0])))
    starts = np.flatnonzero(edges == 1)
    ends = np.flatnonzero(edges == -1)
    touching = (starts <= last) & (ends > first)
    return (
        PRIMED if success else _cause(on, stays, first, last, float(angle.min())),
        float(angle.min()),
        float(up),
        float(aside * np.cos(np.deg2rad(angles.goal_elevation[at]))),
        best / fps - prime,
        float(stays[0] / fps - prime) if stays.size else np.nan,
        int((ends - starts)[touching].max(initial=0)) / fps,
        float(angles.ray_elevation[at]),
        float(angles.goal_elevation[at]),
        float(angles.ray_azimuth[at]),
        float(angles.goal_azimuth[at]),
        bool(_stays(on, hold)[first : last + 1].any()),
        bool(_stays(angles.near(angles.goal_elevation, angles.ray_azimuth, limit), hold).any()),
        bool(_stays(angles.near(angles.ray_elevation, angles.goal_azimuth, limit), hold).any()),
    )


def _cause(on: np.ndarray, stays: np.ndarray, first: int, last: int, miss_deg: float) -> str:
    inside = (stays >= first) & (stays <= last)
    if inside.any():
        return SLOW
    if on[first : last + 1].any():
        return STAY
    if stays.size:
        before = first - stays[stays < first].max(initial=-len(on) - 1)
        after = stays[stays > last].min(initial=2 * len(on) + 1) - last
        return EARLY if before < after else LATE
    return MISS if miss_deg <= _NEVER_LOOKS_DEG else NEVER


def _stays(on: np.ndarray, hold: int) -> np.ndarray:
    """Return True for each frame from which on the ray is on the goal for ``hold`` more frames."""
    stays = np.zeros(len(on), dtype=bool)
    if len(on) > hold:
        stays[: len(on) - hold] = np.lib.stride_tricks.sliding_window_view(on, hold + 1).all(axis=1)
    return stays


def _angles(track: RayTrack, rows: slice) -> _Angles:
    ray_elevation, ray_azimuth = _elevation_azimuth(track.direction[rows])
    goal_elevation, goal_azimuth = _elevation_azimuth(track.to_goal[rows])
    goal_azimuth = np.rad2deg(np.unwrap(np.deg2rad(goal_azimuth)))
    # Within half a turn of the goal's azimuth, so that their difference is the way the head would have to turn.
    ray_azimuth = goal_azimuth + (ray_azimuth - goal_azimuth + 180) % 360 - 180
    distance = np.linalg.norm(track.to_goal[rows], axis=1)
    return _Angles(ray_elevation, goal_elevation, ray_azimuth, goal_azimuth, distance)


def _elevation_azimuth(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Elevation from the horizontal and azimuth about +Y (0 is +Z, positive towards +X, the left), degrees."""
    x, y, z = direction.T
    return np.rad2deg(np.arctan2(y, np.hypot(x, z))), np.rad2deg(np.arctan2(x, z))


def _unit(elevation: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    up = np.deg2rad(elevation)
    around = np.deg2rad(azimuth)
    return np.stack((np.cos(up) * np.sin(around), np.sin(up), np.cos(up) * np.cos(around)), axis=1)
