"""Numbers that a believable human motion keeps to, and the scores of true motion, measured on performances.

The limits of docs/specification/synthetic-recordings.md#plausibility.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import WRISTS, Joint, bone_lengths, canonical_frame, invert_rigid, transform_points
from prbench.metrics.batch import MotionBatch, ScoringTargets
from prbench.metrics.foot_skating import contact_share, foot_skating
from prbench.metrics.prime_success import prime_success
from prbench.metrics.reach_success import reach_success
from prbench.protocol.manifests import load_protocol
from prbench.synthetic.activities import NarratedMotion
from prbench.synthetic.people.kinematics import forward_of
from prbench.synthetic.performance import Performance
from tests.synthetic.true_clips import FPS, TrueClip, true_clips

_HIPS = [Joint.LEFT_HIP, Joint.RIGHT_HIP]
_KNEES = [Joint.LEFT_KNEE, Joint.RIGHT_KNEE]
_ANKLES = [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]
_BALLS = [Joint.LEFT_FOOT, Joint.RIGHT_FOOT]
_SHOULDERS = [Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER]
_ELBOWS = [Joint.LEFT_ELBOW, Joint.RIGHT_ELBOW]
_JERK_RATE = 60.0


Moving = Performance | NarratedMotion
"""What is measured: joints, rotations and contacts at a uniform rate."""
_SMALLEST = ("knee_smallest", "elbow_smallest", "lowest_joint")
"""Numbers whose extreme over several motions is the smallest; of the others it is the largest."""


def jitter(motion: MotionBatch, fps: float) -> Float[np.ndarray, " n"]:
    """Mean over frames and joints of the third difference's norm times fps³, m/s³."""
    motions = np.split(motion.values, motion.offsets[1:-1])
    return np.array([np.linalg.norm(np.diff(one, n=3, axis=0), axis=-1).mean() * fps**3 for one in motions])


_INF = float("inf")
LIMITS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        # Real motion has about 0.05, because walking toes pass low over the floor.
        "foot_skating_mean": (0.005, 0.08),
        "foot_skating_worst": (-_INF, 0.20),
        "contact_share": (0.6, _INF),  # share of frame transitions with a toe on the floor, mean over sequences
        "planted_slide": (-_INF, 1e-4),  # metres that a planted ball of the foot moves along the floor
        "bone_length_change": (-_INF, 1e-6),
        "knee_smallest": (40.0, _INF),
        "knee_largest": (-_INF, 178.0),
        "knees_bent_backwards": (-_INF, 1e-9),  # share of frames
        "elbow_smallest": (25.0, _INF),
        "elbow_largest": (-_INF, 175.0),
        "lowest_joint": (-0.01, _INF),
        "foot_to_pelvis_yaw": (-_INF, 90.0),
        "head_yaw_rate": (-_INF, 300.0),
        "ball_speed": (-_INF, 8.0),
        "wrist_speed": (-_INF, 4.5),
        "pelvis_speed": (-_INF, 2.2),
        "pelvis_jerk": (-_INF, 1500.0),
        "joint_jerk": (-_INF, 8000.0),  # 99.9 % of all joints and frames
        "jitter_mean": (5.0, 80.0),
    }
)
"""Range of each number, borders excluded. Metres, seconds, degrees."""


def implausible(numbers: Mapping[str, float], limits: Mapping[str, tuple[float, float]] = LIMITS) -> dict[str, float]:
    """Return the numbers that lie outside their ranges."""
    return {name: numbers[name] for name, (low, high) in limits.items() if not low < numbers[name] < high}


def measure(performances: Sequence[Performance]) -> dict[str, float]:
    """Measure extremes, means and shares over performances."""
    return measure_motions(performances, [clip.joints for each in performances for clip in true_clips(each)])


def measure_motions(motions: Sequence[Moving], clips: Sequence[np.ndarray]) -> dict[str, float]:
    """Measure extremes over motions, and means and shares over clips of them at 20 frames a second.

    Args:
        motions: Performances, or anything else that moves.
        clips: Joints (n, 22, 3) of each clip, metres, Y up.
    """
    batch = MotionBatch.from_motions([clip - [0.0, clip[..., 1].min(), 0.0] for clip in clips])
    constants = load_protocol().metrics
    skating = foot_skating(batch, FPS, constants)
    extremes = [_extremes(motion) for motion in motions]
    jerk = np.concatenate([_jerk(motion).ravel() for motion in motions])
    return {
        "foot_skating_mean": float(skating.mean()),
        "foot_skating_worst": float(skating.max()),
        "contact_share": float(contact_share(batch, constants).mean()),
        "joint_jerk": float(np.quantile(jerk, 0.999)),
        "jitter_mean": float(jitter(batch, FPS).mean()),
        **{name: (min if name in _SMALLEST else max)(each[name] for each in extremes) for name in extremes[0]},
    }


def _extremes(motion: Moving) -> dict[str, float]:
    joints = motion.joints
    rate = motion.rate
    knees = _inner_angle(joints[:, _HIPS], joints[:, _KNEES], joints[:, _ANKLES])
    elbows = _inner_angle(joints[:, _SHOULDERS], joints[:, _ELBOWS], joints[:, WRISTS])
    lengths = bone_lengths(joints)
    pelvis_forward = forward_of(motion.rotations[:, Joint.PELVIS])
    head_forward = forward_of(motion.head_rotation)
    head_yaw = np.unwrap(np.arctan2(head_forward[:, 0], head_forward[:, 2]))
    foot = joints[:, _BALLS] - joints[:, _ANKLES]
    cross = foot[..., 0] * pelvis_forward[:, None, 2] - foot[..., 2] * pelvis_forward[:, None, 0]
    dot = foot[..., 0] * pelvis_forward[:, None, 0] + foot[..., 2] * pelvis_forward[:, None, 2]

    def top_speed(points: np.ndarray) -> float:
        return float(np.linalg.norm(np.diff(points, axis=0), axis=-1).max() * rate)

    return {
        "knee_smallest": float(knees.min()),
        "knee_largest": float(knees.max()),
        "knees_bent_backwards": _share_backwards(joints, pelvis_forward),
        "elbow_smallest": float(elbows.min()),
        "elbow_largest": float(elbows.max()),
        "lowest_joint": float(joints[..., 1].min()),
        "planted_slide": _planted_slide(motion),
        "bone_length_change": float(np.abs(lengths / lengths[0] - 1.0).max()),
        "foot_to_pelvis_yaw": float(np.rad2deg(np.abs(np.arctan2(cross, dot))).max()),
        "head_yaw_rate": float(np.rad2deg(np.abs(np.diff(head_yaw)).max() * rate)),
        "ball_speed": top_speed(joints[:, _BALLS]),
        "wrist_speed": top_speed(joints[:, list(WRISTS)]),
        "pelvis_speed": top_speed(joints[:, [Joint.PELVIS]]),
        "pelvis_jerk": float(_jerk(motion)[:, Joint.PELVIS].max()),
    }


def _inner_angle(a: np.ndarray, middle: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle at a joint, degrees."""
    first = a - middle
    second = b - middle
    cross = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.rad2deg(np.arctan2(cross, (first * second).sum(axis=-1)))


def _planted_slide(performance: Moving) -> float:
    """Return the farthest horizontal way of a ball within one stretch of contact."""
    farthest = 0.0
    for side, ball in enumerate(_BALLS):
        planted = performance.planted[:, side]
        stretch = np.cumsum(~planted)
        moved = np.hypot(*np.diff(performance.joints[:, ball][:, [0, 2]], axis=0).T)
        both = planted[1:] & planted[:-1]
        sums = np.bincount(stretch[1:][both], weights=moved[both], minlength=1)
        farthest = max(farthest, float(sums.max(initial=0.0)))
    return farthest


def _share_backwards(joints: np.ndarray, pelvis_forward: np.ndarray) -> float:
    """Return the share of frames in which a knee lies behind the line from hip to ankle, seen along pelvis and foot."""
    hips = joints[:, _HIPS]
    knees = joints[:, _KNEES]
    ankles = joints[:, _ANKLES]
    foot = joints[:, _BALLS] - ankles
    foot[..., 1] = 0.0
    forward = foot / np.linalg.norm(foot, axis=-1, keepdims=True) + pelvis_forward[:, None]
    along = (ankles - hips) / np.linalg.norm(ankles - hips, axis=-1, keepdims=True)
    bulge = knees - hips
    bulge -= (bulge * along).sum(axis=-1, keepdims=True) * along
    forward -= (forward * along).sum(axis=-1, keepdims=True) * along
    return float(((bulge * forward).sum(axis=-1) < 0.0).mean())


def _jerk(performance: Moving) -> Float[np.ndarray, "m 22"]:
    """Return the third difference quotient on a 60 Hz grid, m/s³."""
    stride = max(1, round(performance.rate / _JERK_RATE))
    rate = performance.rate / stride
    return np.linalg.norm(np.diff(performance.joints[::stride], n=3, axis=0), axis=-1) * rate**3


def truth_scores(clips: Sequence[TrueClip]) -> dict[str, float]:
    """Score the true motion of some sequences against their own goals: rates from 0 to 1, ceilings of every method."""
    frames = [invert_rigid(canonical_frame(clip.joints)) for clip in clips]
    motions = [transform_points(frame, clip.joints) for frame, clip in zip(frames, clips, strict=True)]
    goals = [transform_points(frame, clip.event.goal) for frame, clip in zip(frames, clips, strict=True)]
    batch = MotionBatch.from_motions(motions)
    constants = load_protocol().metrics
    targets = ScoringTargets(
        goal_location=np.array(goals),
        prime_time=np.array([clip.prime_after for clip in clips]),
        hand=np.array([int(clip.event.hand == "right") for clip in clips]),
        head_tilt_deg=np.array([clip.neck_tilt_deg for clip in clips]),
        fps=FPS,
    )
    return {
        "prime_equation": float(prime_success(batch, targets, constants, variant="equation").mean()),
        "prime_onset": float(prime_success(batch, targets, constants, variant="onset").mean()),
        "reach_any": float(reach_success(batch, targets.goal_location, constants).mean()),
        "reach_final": float(reach_success(batch, targets.goal_location, constants, final=True).mean()),
    }


def recorded_bone_change(clips: Sequence[Float[np.ndarray, "n 22 3"]]) -> float:
    """Return the largest relative change of a bone within one recorded clip."""
    lengths = [bone_lengths(clip) for clip in clips]
    return max(float(np.abs(clip / clip[0] - 1.0).max()) for clip in lengths)
