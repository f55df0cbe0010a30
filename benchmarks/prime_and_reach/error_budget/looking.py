"""Why a motion is primed or not: one cause for each, and by how much it misses (docs/error-budget.md#prime-success)."""

from __future__ import annotations

import numpy as np

from prbench.metrics import MotionBatch, ScoringTargets
from prbench.metrics.prime_success import near_goal, primed
from prbench.metrics.ray_track import CandidateFrames, head_track
from prbench.metrics.ray_track import candidate_frames as frames_of
from prbench.protocol.manifests import MetricConstants

PRIMED = "primed"
SLOW = "does not slow"
STAY = "does not stay"
EARLY = "looks early"
LATE = "looks late"
MISS = "misses"
NEVER = "never looks"
UNDEFINED = "undefined"
# Causes in the order in which they are asked for: the first that holds is the motion's cause.
CAUSES = (PRIMED, SLOW, STAY, EARLY, LATE, MISS, NEVER, UNDEFINED)

# Degrees beyond which a head is not said to look towards a goal: eyes alone turn that far from where a head points,
# which is why the protocol's breakdown calls goals of a smaller bearing "ahead".
_NEVER_LOOKS_DEG = 30.0


def diagnose_looking(motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants) -> dict[str, np.ndarray]:
    """Find out of each motion why it is primed (equation 3) or not.

    With C the candidate frames of Prime Success, K frames of ``prime_duration`` and "on the goal" its distance, the
    cause is the first of these that holds: *primed*; *undefined*, without a candidate frame in which the head has a
    direction; *does not slow*, if the ray stays on the goal for K + 1 frames from a frame of C on, yet in no such frame
    turns more slowly than in the one before; *does not stay*, if it is on the goal in a frame of C; *looks early* or
    *looks late*, if the stay nearest in time lies before or after C; *misses*, if the best frame of C is within 30
    degrees; *never looks* otherwise.

    Elevations are from the horizontal, azimuths about the vertical from where the first pose faces, both seen from the
    head. The best frame is that of the smallest angle between ray and goal in C.

    Args:
        motion: Canonical frame, metres, two frames or more.
        targets: Goals and times of the sequences.
        constants: Thresholds of the protocol, in metres, seconds and degrees.

    Returns:
        Columns of one entry a motion: ``cause``; in the best frame the angle ``miss_deg`` between ray and goal,
        ``miss_up_deg`` (the elevation of the ray minus the goal's), ``miss_aside_deg`` (the difference of the azimuths
        times the cosine of the goal's elevation, positive to the left), ``best_time`` (seconds after the recorded prime
        time), elevation and azimuth of both (``ray_elevation_deg`` …); ``first_look``, beginning of the first stay in
        the whole motion, seconds after the prime time, NaN without one; ``longest_stay``, the longest time on the goal
        that has a frame of C, seconds; ``stays``, whether the ray stays on the goal for the protocol's time from some
        frame of C on, and whether it would with the goal's elevation (or azimuth) in every frame and its own azimuth
        (or elevation): ``stays_with_elevation``, ``stays_with_azimuth``.
    """
    motion.require_frames(2)
    fps_of = targets.fps_of_sequence
    candidates = frames_of(motion.n_frames, targets.prime_time, fps_of, constants)
    # With candidates from frame 2 to the last but K, the track holds the whole motion, one entry a frame.
    whole = CandidateFrames(
        np.full(motion.n_sequences, 2), motion.n_frames - 1 - candidates.hold, candidates.hold, candidates.before
    )
    track = head_track(motion, whole, targets.goal_location, targets.head_tilt_deg, fps_of, constants)
    success = primed(track, candidates, constants, "equation")
    on_goal = track.usable & near_goal(track, constants, "equation")
    limit = constants.prime_distance + constants.threshold_tolerance
    found = []
    for row in range(motion.n_sequences):
        first = int(candidates.first[row])
        last = int(candidates.last[row])
        hold = int(candidates.hold[row])
        fps = float(fps_of[row])
        prime = float(targets.prime_time[row])
        begin = int(track.row_of_frame_0[row])
        window = slice(begin + first, begin + last + 1)
        values = dict.fromkeys(_NUMBERS, np.nan)
        found.append({"cause": UNDEFINED, **values, **dict.fromkeys(_STAYS, False)})
        if last < first or not track.usable[window].any():
            continue
        angle = np.where(track.usable[window], track.angle[window], np.inf)
        at = int(angle.argmin())
        on = on_goal[np.flatnonzero(track.sequence == row)]
        staying = _stays(on, hold)
        stays = np.flatnonzero(staying)

        # Angles of ray and goal from the first candidate on, as long as a look that begins at the last one lasts.
        rows = slice(begin + first, begin + last + hold + 1)
        ray_elevation, ray_azimuth = _elevation_azimuth(track.direction[rows])
        goal_elevation, goal_azimuth = _elevation_azimuth(track.to_goal[rows])
        goal_azimuth = np.rad2deg(np.unwrap(np.deg2rad(goal_azimuth)))
        # Within half a turn of the goal's azimuth, so that their difference is the way the head would have to turn.
        ray_azimuth = goal_azimuth + (ray_azimuth - goal_azimuth + 180) % 360 - 180
        distance = np.linalg.norm(track.to_goal[rows], axis=1)
        goal = _unit(goal_elevation, goal_azimuth)
        would_stay = {}
        for name, turned in (
            ("stays_with_elevation", _unit(goal_elevation, ray_azimuth)),
            ("stays_with_azimuth", _unit(ray_elevation, goal_azimuth)),
        ):
            sine = np.linalg.norm(np.cross(turned, goal), axis=1)
            passes = np.where((turned * goal).sum(axis=1) > 0, distance * sine, distance) <= limit
            would_stay[name] = bool(_stays(passes, hold).any())

        # Frames of the longest run on the goal that has a frame of C.
        edges = np.diff(np.concatenate(([0], on.astype(np.int8), [0])))
        starts = np.flatnonzero(edges == 1)
        ends = np.flatnonzero(edges == -1)
        touching = (starts <= last) & (ends > first)

        if success[row]:
            cause = PRIMED
        elif staying[first : last + 1].any():
            cause = SLOW
        elif on[first : last + 1].any():
            cause = STAY
        elif stays.size:
            before = first - stays[stays < first].max(initial=-len(on) - 1)
            after = stays[stays > last].min(initial=2 * len(on) + 1) - last
            cause = EARLY if before < after else LATE
        else:
            cause = MISS if angle[at] <= _NEVER_LOOKS_DEG else NEVER
        aside = (ray_azimuth[at] - goal_azimuth[at]) * np.cos(np.deg2rad(goal_elevation[at]))
        found[-1] |= {
            "cause": cause,
            "miss_deg": float(angle[at]),
            "miss_up_deg": float(ray_elevation[at] - goal_elevation[at]),
            "miss_aside_deg": float(aside),
            "best_time": (first + at) / fps - prime,
            "first_look": float(stays[0] / fps - prime) if stays.size else np.nan,
            "longest_stay": int((ends - starts)[touching].max(initial=0)) / fps,
            "ray_elevation_deg": float(ray_elevation[at]),
            "goal_elevation_deg": float(goal_elevation[at]),
            "ray_azimuth_deg": float(ray_azimuth[at]),
            "goal_azimuth_deg": float(goal_azimuth[at]),
            "stays": bool(staying[first : last + 1].any()),
            **would_stay,
        }
    return {name: np.array([each[name] for each in found]) for name in ("cause", *_NUMBERS, *_STAYS)}


_NUMBERS = (
    *("miss_deg", "miss_up_deg", "miss_aside_deg", "best_time", "first_look", "longest_stay"),
    *("ray_elevation_deg", "goal_elevation_deg", "ray_azimuth_deg", "goal_azimuth_deg"),
)
_STAYS = ("stays", "stays_with_elevation", "stays_with_azimuth")


def _stays(on: np.ndarray, hold: int) -> np.ndarray:
    """Return True for each frame from which on the ray is on the goal for ``hold`` more frames."""
    stays = np.zeros(len(on), dtype=bool)
    if len(on) > hold:
        stays[: len(on) - hold] = np.lib.stride_tricks.sliding_window_view(on, hold + 1).all(axis=1)
    return stays


def _elevation_azimuth(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Elevation from the horizontal and azimuth about +Y (0 is +Z, positive towards +X, the left), degrees."""
    x, y, z = direction.T
    return np.rad2deg(np.arctan2(y, np.hypot(x, z))), np.rad2deg(np.arctan2(x, z))


def _unit(elevation: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    up = np.deg2rad(elevation)
    around = np.deg2rad(azimuth)
    return np.stack((np.cos(up) * np.sin(around), np.sin(up), np.cos(up) * np.cos(around)), axis=1)
