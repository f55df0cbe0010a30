"""Footing: which foot stands still on the floor, and whether the body goes, leans and turns only where one does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.geometry.skeleton import TOES, Joint
from prbench.metrics.batch import MotionBatch, ScoringPair, moving_sum, odd_window
from prbench.protocol.manifests import MetricConstants

Feet = Bool[np.ndarray, "2 frames"]
Rows = Int[np.ndarray, " swings"]


def _of_both_sides(share: float, start: str, end: str, place: float) -> list[tuple[float, Joint, Joint, float]]:
    return [(share, Joint[f"{side}_{start}"], Joint[f"{side}_{end}"], place) for side in ("LEFT", "RIGHT")]


# Ankle and toe of the left foot, then of the right one.
_FEET = (Joint.LEFT_ANKLE, TOES[0], Joint.RIGHT_ANKLE, TOES[1])
_HIGHEST_ANKLE = 0.10  # metres above the sole of a flat foot; measured people have at most 0.09 (Gordon et al. 2014)
# Winter 2009, table 4.1: share of the body's mass, ends of the segment, and how far down its centre of mass lies.
_SEGMENTS = (
    (0.081, Joint.NECK, Joint.HEAD, 1.0),
    (0.497, Joint.NECK, Joint.PELVIS, 0.5),
    *_of_both_sides(0.028, "SHOULDER", "ELBOW", 0.436),
    *_of_both_sides(0.022, "ELBOW", "WRIST", 0.682),
    *_of_both_sides(0.100, "HIP", "KNEE", 0.433),
    *_of_both_sides(0.0465, "KNEE", "ANKLE", 0.433),
    *_of_both_sides(0.0145, "ANKLE", "FOOT", 0.5),
)
_SWING = 0.05  # metres; shorter ways of a toe are shuffles
_DIRECTIONS = 36  # in which a body may lean: each 10 degrees, so that a distance is 0.4 % too short at most


@dataclass(frozen=True, eq=False)
class Footing:
    """The steps of ankles and toes from each frame to the next; a sequence's last frame has none and holds zeros.

    Attributes:
        contact: Near the floor before and after the step: left ankle, left toe, right ankle, right toe.
        speed: Horizontal, m/s, of the same points.
        planted: True in contact if not faster than ``foot_speed``.
        travel: Horizontal speed of the pelvis, m/s.
    """

    contact: Bool[np.ndarray, "4 frames"]
    speed: Float[np.ndarray, "4 frames"]
    planted: Bool[np.ndarray, "4 frames"]
    travel: Float[np.ndarray, " frames"]


def footing(motion: MotionBatch, fps: Float[np.ndarray, " n"], constants: MetricConstants) -> Footing:
    """Find the contacts of motions (docs/specification/metrics.md#footing).

    Args:
        motion: Canonical frame, metres, two frames or more.
        fps: Frames per second, one rate a sequence.
        constants: Thresholds of the protocol, in metres and metres a second.
    """
    motion.require_frames(2)
    rate = fps[motion.sequence_of_row]
    height = motion.columns[list(_FEET), 1]
    # An ankle rests above the sole: as high as the lower one gets in the motion, if a foot can be that high.
    ankles = height[[0, 2]]
    rest = np.minimum(np.minimum.reduceat(ankles.min(axis=0), motion.first), _HIGHEST_ANKLE)
    ankles -= rest[motion.sequence_of_row]
    height[[0, 2]] = ankles
    low = height <= constants.contact_height + constants.foot_tolerance
    contact = np.zeros_like(low)
    contact[:, :-1] = low[:, :-1] & low[:, 1:]
    contact[:, motion.last] = False
    points = motion.columns[[*_FEET, Joint.PELVIS]]
    speed = np.zeros((len(points), len(motion.values)))
    speed[:, :-1] = np.hypot(np.diff(points[:, 0]), np.diff(points[:, 2]))
    speed[:, motion.last] = 0.0
    speed *= rate
    planted = contact & (speed[:4] <= constants.foot_speed + constants.foot_tolerance)
    return Footing(contact, speed[:4], planted, speed[4])


def sliding_steps(
    motion: MotionBatch, fps: Float[np.ndarray, " n"], constants: MetricConstants
) -> Bool[np.ndarray, " frames"]:
    """Return True for each step in which an ankle or toe slides over the floor, as :func:`footing_numbers` counts it.

    Args:
        motion: Canonical frame, metres, two frames or more.
        fps: Frames per second, one rate a sequence.
        constants: Thresholds of the protocol, in metres and metres a second.
    """
    return _sliding(footing(motion, fps, constants), constants)


def _sliding(feet: Footing, constants: MetricConstants) -> Bool[np.ndarray, " frames"]:
    slides = feet.contact & (feet.speed > constants.slide_speed + constants.foot_tolerance)
    return np.logical_or.reduce(slides, axis=0)


def footing_numbers(pair: ScoringPair, constants: MetricConstants) -> dict[str, Float[np.ndarray, " n"]]:
    """Measure how the feet carry each predicted motion (docs/specification/metrics.md#footing).

    Returns:
        * ``lower_toe``: greatest height of the lower toe, metres.
        * ``slides``: share of the steps in which an ankle or toe slides over the floor.
        * ``support``: share of the pelvis' way over the ground in steps in which a foot is planted.
        * ``drag``: metres that the stillest foot on the floor moves along for a metre of that way; ways below
          ``drag_way`` count as that long.
        * ``flight``: share of the steps in which no foot is planted.
        * ``unsupported_speed``: largest speed of the pelvis over the ground where no foot is planted, m/s.
        * ``travel_speed``: largest speed of the pelvis over the ground, m/s.
        * ``step_rate``: largest number of feet lifted within a second.
        * ``swing_time``: shortest time in which a foot swings ``_SWING`` metres or more, seconds; infinite without one.
        * ``pivot``: largest turn of a foot that lies on the floor, over the whole motion, degrees.
        * ``foot_roll``: largest change of a foot's pitch over the motion, degrees; infinite where the pelvis goes less
          than ``drag_way`` from its first place.
        * ``imbalance``: largest distance of the centre of mass from planted feet while the body stands, metres.
        * ``overhang``: the same in any step.
    """
    motion = pair.predicted
    feet = footing(motion, pair.targets.fps_of_sequence, constants)

    def largest(values: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " n"]:
        return np.maximum.reduceat(values, motion.first)

    sliding = _sliding(feet, constants)
    standing = feet.planted.any(axis=0)
    way = np.add.reduceat(feet.travel, motion.first)
    carried = np.add.reduceat(feet.travel * standing, motion.first)
    # Where no foot is near the floor, the pelvis drags as far as it goes; noise is slower than ``drag_speed``.
    stillest = np.minimum(np.where(feet.contact, feet.speed, np.inf).min(axis=0), feet.travel)
    dragged = np.add.reduceat(np.where(stillest > constants.drag_speed, stillest, 0.0), motion.first)
    rates = pair.targets.fps_of_sequence
    lifted, _ = _lifted_and_landed(motion, feet)
    steps = np.zeros(motion.n_sequences)
    for rate in np.unique(rates):
        counted = moving_sum(lifted.astype(float), motion, odd_window(1.0, rate)).sum(axis=0)
        steps = np.where(rates == rate, largest(counted), steps)
    shortest_swing = np.full(motion.n_sequences, np.inf)
    for _, up, down in swings(motion, feet):
        np.minimum.at(shortest_swing, motion.sequence_of_row[up], down - up)
    beyond = _beyond_feet(motion, feet, constants)
    return {
        "lower_toe": largest(motion.columns[list(TOES), 1].min(axis=0)),
        "slides": np.add.reduceat(sliding.astype(float), motion.first) / (motion.n_frames - 1),
        "support": np.where(way > 0, carried / np.where(way > 0, way, 1.0), 1.0),
        "drag": dragged / np.maximum(way, constants.drag_way * pair.targets.fps_of_sequence),
        "flight": 1 - np.add.reduceat(standing.astype(float), motion.first) / (motion.n_frames - 1),
        "unsupported_speed": largest(np.where(standing, 0.0, feet.travel)),
        "travel_speed": largest(feet.travel),
        "step_rate": steps,
        "swing_time": shortest_swing / rates,
        "pivot": _largest_pivot(motion, feet),
        "foot_roll": _foot_roll(motion, constants),
        "imbalance": largest(np.where(feet.travel <= constants.slide_speed, beyond, 0.0)),
        "overhang": largest(beyond),
    }


def _lifted_and_landed(motion: MotionBatch, feet: Footing) -> tuple[Feet, Feet]:
    """Return the steps in which a foot moves that stood in the step before, and the other way round."""
    each = np.stack([feet.planted[:2].any(axis=0), feet.planted[2:].any(axis=0)])
    before = np.roll(each, 1, axis=1)
    before[:, motion.first] = each[:, motion.first]  # what stands or moves at first did so before
    before[:, motion.last] = each[:, motion.last]
    return before & ~each, each & ~before


def swings(motion: MotionBatch, feet: Footing) -> list[tuple[Joint, Rows, Rows]]:
    """Find where each foot swings: from where it is lifted to where it lands, its toe ``_SWING`` metres away or more.

    Returns:
        For the left and the right foot its toe, the rows of the frames in which it is lifted, and of those in which it
        lands.
    """
    found = []
    for toe, lifted, landed in zip(TOES, *_lifted_and_landed(motion, feet), strict=True):
        up = np.flatnonzero(lifted)
        landings = np.append(np.flatnonzero(landed), len(motion.values) - 1)
        down = landings[np.searchsorted(landings, up)]
        x, _, z = motion.columns[toe]
        swing = (np.hypot(x[down] - x[up], z[down] - z[up]) >= _SWING) & landed[down]
        swing &= motion.sequence_of_row[up] == motion.sequence_of_row[down]
        found.append((toe, up[swing], down[swing]))
    return found


def _largest_pivot(motion: MotionBatch, feet: Footing) -> Float[np.ndarray, " n"]:
    """Turn of each foot about the vertical, summed over the steps in which its ankle and its toe are in contact."""
    turns = []
    for ankle in (0, 2):
        x, _, z = motion.columns[_FEET[ankle + 1]] - motion.columns[_FEET[ankle]]
        turn = np.zeros(len(x))
        turn[:-1] = np.arctan2(x[:-1] * z[1:] - z[:-1] * x[1:], x[:-1] * x[1:] + z[:-1] * z[1:])
        flat = feet.contact[ankle] & feet.contact[ankle + 1]
        turns.append(np.abs(np.add.reduceat(np.where(flat, turn, 0.0), motion.first)))
    return np.rad2deg(np.max(turns, axis=0))


def _foot_roll(motion: MotionBatch, constants: MetricConstants) -> Float[np.ndarray, " n"]:
    """Range of the angle between foot and floor, of the foot with the larger one; infinite for short ways."""
    pelvis = motion.columns[Joint.PELVIS]
    start = pelvis[:, motion.first][:, motion.sequence_of_row]
    way = np.maximum.reduceat(np.hypot(pelvis[0] - start[0], pelvis[2] - start[2]), motion.first)
    ranges = []
    for ankle in (0, 2):
        x, y, z = motion.columns[_FEET[ankle + 1]] - motion.columns[_FEET[ankle]]
        pitch = np.arctan2(y, np.hypot(x, z))
        ranges.append(np.maximum.reduceat(pitch, motion.first) - np.minimum.reduceat(pitch, motion.first))
    return np.where(way >= constants.drag_way, np.rad2deg(np.max(ranges, axis=0)), np.inf)


def _beyond_feet(motion: MotionBatch, feet: Footing, constants: MetricConstants) -> Float[np.ndarray, " frames"]:
    """Distance over the ground of the centre of mass from the planted feet; 0 where none is or the body sits."""
    # Summed segment by segment: the rounding of a matrix product depends on the rest of the batch.
    centre = np.zeros((2, len(motion.values)))
    for mass, upper, lower, share in _SEGMENTS:
        centre += mass * ((1 - share) * motion.columns[upper][[0, 2]] + share * motion.columns[lower][[0, 2]])
    points = motion.columns[list(_FEET)][:, [0, 2]]
    # The farthest that the body leans out of what its feet span, over all directions, is its distance from the span.
    distance = np.full(len(motion.values), -np.inf)
    for angle in np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS):
        along = np.cos(angle) * points[:, 0] + np.sin(angle) * points[:, 1]
        edge = np.where(feet.planted, along, -np.inf).max(axis=0)
        distance = np.maximum(distance, np.cos(angle) * centre[0] + np.sin(angle) * centre[1] - edge)
    return np.where(feet.planted.any(axis=0) & ~_sits(motion, constants), np.maximum(distance, 0.0), 0.0)


def _sits(motion: MotionBatch, constants: MetricConstants) -> Bool[np.ndarray, " frames"]:
    """Frames up to which a body that begins with a low pelvis keeps it there and low."""
    pelvis = motion.columns[Joint.PELVIS]
    of_row = motion.sequence_of_row
    bones = motion.columns[:, :, motion.first]
    thigh = np.linalg.norm(bones[Joint.LEFT_KNEE] - bones[Joint.LEFT_HIP], axis=0)
    shank = np.linalg.norm(bones[Joint.LEFT_ANKLE] - bones[Joint.LEFT_KNEE], axis=0)
    start = pelvis[:, motion.first][:, of_row]
    moved = np.hypot(pelvis[0] - start[0], pelvis[2] - start[2])
    high = pelvis[1] > constants.seat_height * (thigh + shank)[of_row]
    left = np.cumsum(high | (moved > constants.seat_travel))
    # The seat is left once: from then on the count differs from what it was before the sequence.
    before = np.concatenate([[0], left])[motion.first]
    return left == before[of_row]
