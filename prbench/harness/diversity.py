"""How far several motions for one goal differ: in poses, path and timing.

Source: docs/specification/metrics.md#diversity.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS, WRISTS, Joint, head_forward
from prbench.metrics.ray_track import ray_distance
from prbench.protocol.manifests import MetricConstants

# Places along a path at which paths are compared.
_STATIONS = 21
_SHORTEST_PATH = 1e-6  # m; below, a path has no places along it
_ROUNDING = 1e-9  # m; half of an even way is covered in the same frame whichever way it goes


# Title and unit of each measure by its id.
SPREADS = {
    "apd": ("APD", "m"),
    "apd_joint": ("APD per joint", "m"),
    "apd_pose": ("APD per joint, pose", "m"),
    "path": ("Path of the pelvis", "m"),
    "prime_time": ("Prime time", "s"),
    "half_way": ("Half of the way", "s"),
    "wrist_arrival": ("Arrival of the wrist", "s"),
    "wrist_speed": ("Speed of the wrist", "m/s"),
}


@dataclass(frozen=True, eq=False)
class Timing:
    """When each of k motions does what, seconds after the first frame.

    Attributes:
        prime: First frame from which on the head ray stays on the goal for ``prime_duration``; else that of the best
            look.
        half_way: First frame in which half of the pelvis' way over the ground is covered.
        wrist_arrival: First frame from which on the wrist that ends nearer to the goal is within ``reach_distance`` of
            its end.
    """

    prime: Float[np.ndarray, " k"]
    half_way: Float[np.ndarray, " k"]
    wrist_arrival: Float[np.ndarray, " k"]


@dataclass(frozen=True, eq=False)
class MotionsToGoal:
    """k motions of one length for one goal; canonical frame, metres.

    Raises:
        ValueError: for fewer than two motions, which cannot differ, or fewer than two frames.
    """

    joints: Float[np.ndarray, "k frames 22 3"]
    goal: Float[np.ndarray, "3"]
    head_tilt_deg: float
    fps: float

    def __post_init__(self) -> None:
        if self.joints.shape[0] < 2 or self.joints.shape[1] < 2:
            raise ValueError(f"expected two motions or more of two frames or more, found {self.joints.shape[:2]}")

    @property
    def reaching_wrist(self) -> Float[np.ndarray, "k frames 3"]:
        """The wrist of each motion that ends nearer to the goal."""
        wrists = self.joints[:, :, WRISTS]
        nearer = np.linalg.norm(wrists[:, -1] - self.goal, axis=-1).argmin(axis=1)
        return wrists[np.arange(len(wrists)), :, nearer]

    @property
    def head_distance(self) -> Float[np.ndarray, "k frames"]:
        """Distance of the goal from the head ray in each frame, metres; infinite where the head has no direction."""
        direction, degenerate = head_forward(self.joints, self.head_tilt_deg)
        heads = self.joints[:, :, Joint.HEAD].reshape(-1, 3)
        distance = ray_distance(heads, direction.reshape(-1, 3), self.goal[None])
        return np.where(degenerate, np.inf, distance.reshape(degenerate.shape))


def timing(motions: MotionsToGoal, constants: MetricConstants) -> Timing:
    """Find the moments that are compared."""
    distance = motions.head_distance
    hold = int(np.ceil(constants.prime_duration * motions.fps - 1e-9))
    last = max(distance.shape[1] - hold, 1)
    # The farthest of the frames that a stay is made of, for each frame in which it may begin.
    stay = np.stack([distance[:, k : last + k] for k in range(min(hold + 1, distance.shape[1] - last + 1))]).max(axis=0)
    on_goal = stay <= constants.prime_distance + constants.threshold_tolerance
    steps = np.linalg.norm(np.diff(motions.joints[:, :, Joint.PELVIS][..., [0, 2]], axis=1), axis=-1)
    covered = np.cumsum(steps, axis=1)
    wrist = motions.reaching_wrist
    away = np.linalg.norm(wrist - wrist[:, -1:], axis=-1) > constants.reach_distance
    # The frame behind the last one away; 0 for a wrist that never leaves.
    arrival = np.where(away.any(axis=1), wrist.shape[1] - away[:, ::-1].argmax(axis=1), 0).astype(np.float64)
    prime = np.where(on_goal.any(axis=1), on_goal.argmax(axis=1), stay.argmin(axis=1)).astype(np.float64)
    half_way = 1.0 + (covered >= covered[:, -1:] / 2 - _ROUNDING).argmax(axis=1)
    return Timing(prime / motions.fps, half_way / motions.fps, arrival / motions.fps)


def spreads(motions: MotionsToGoal, constants: MetricConstants) -> dict[str, float]:
    """Measure how far the motions differ.

    Args:
        motions: k motions for one goal.
        constants: Thresholds of the protocol, in metres, seconds and degrees.

    Returns:
        The value of each of :data:`SPREADS` by its id.
    """
    joints = motions.joints.astype(np.float64)
    per_joint = np.sqrt(joints.shape[1] * N_JOINTS)
    poses = joints - joints[:, :, [Joint.PELVIS]]
    ground = joints[:, :, Joint.PELVIS][..., [0, 2]]
    speed = np.linalg.norm(np.diff(motions.reaching_wrist.astype(np.float64), axis=1), axis=-1) * motions.fps
    # Points at equal shares of the length of each path: its form without its speed.
    stations = []
    for path in ground:
        covered = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=-1))])
        if covered[-1] < _SHORTEST_PATH:
            stations.append(np.repeat(path[:1], _STATIONS, axis=0))
            continue
        wanted = np.linspace(0.0, covered[-1], _STATIONS)
        stations.append(np.stack([np.interp(wanted, covered, path[:, axis]) for axis in (0, 1)], axis=-1))
    apd = average_pairwise_distance(joints)
    times = timing(motions, constants)
    return {
        "apd": apd,
        "apd_joint": apd / per_joint,
        "apd_pose": average_pairwise_distance(poses) / per_joint,
        "path": _pair_mean(np.stack(stations)),
        "prime_time": float(times.prime.std(ddof=1)),
        "half_way": float(times.half_way.std(ddof=1)),
        "wrist_arrival": float(times.wrist_arrival.std(ddof=1)),
        "wrist_speed": _pair_mean(speed[..., None]),
    }


def average_pairwise_distance(motions: Float[np.ndarray, "k frames joints 3"]) -> float:
    """Mean over pairs of the Euclidean distance of two motions, all frames and coordinates as one vector; metres."""
    flat = motions.reshape(len(motions), -1)
    return float(np.mean([np.linalg.norm(one - other) for one, other in combinations(flat, 2)]))


def _pair_mean(tracks: Float[np.ndarray, "k places dimensions"]) -> float:
    """Mean over pairs and places of the distance of two tracks."""
    return float(np.mean([np.linalg.norm(one - other, axis=-1).mean() for one, other in combinations(tracks, 2)]))
