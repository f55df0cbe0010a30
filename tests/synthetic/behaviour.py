"""How synthetic people act, beside what the literature and the study measured of people.

Targets, limits and their sources: docs/specification/synthetic-recordings.md#statistics and
docs/specification/synthetic-recordings.md#behaviour. Measured on true gaze, without sensors; what curation measures
through sensors differs a little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from prbench.geometry.skeleton import WRISTS, Joint
from prbench.protocol.published import Spread, load_table_one
from prbench.synthetic.people.kinematics import forward_of
from prbench.synthetic.performance import Performance, TrueEvent
from tests.synthetic.true_clips import PREROLL, TrueClip, clips_of


@dataclass(frozen=True)
class SequenceStatistics:
    """The columns of the study's Table 1 for one dataset: seconds and metres."""

    duration: Spread
    gap: Spread
    body: Spread
    hand: Spread

    def deviations(self, target: SequenceStatistics) -> dict[str, float]:
        """Return (ours - target) / target sd of every mean."""
        names = ("duration", "gap", "body", "hand")
        pairs = {name: (getattr(self, name), getattr(target, name)) for name in names}
        return {name: (ours.mean - theirs.mean) / theirs.sd for name, (ours, theirs) in pairs.items()}


TARGETS: Mapping[str, SequenceStatistics] = MappingProxyType(
    {
        dataset: SequenceStatistics(row.duration, row.prime_gap, row.body_movement, row.hand_movement)
        for dataset, row in load_table_one().items()
    }
)
"""The study's numbers of the real datasets."""


def sequence_statistics(clips: Sequence[TrueClip]) -> SequenceStatistics:
    """Return mean and spread of the four numbers over sequences."""
    gaps = np.array([clip.event.event_time - clip.start - clip.prime_after for clip in clips])
    return SequenceStatistics(
        duration=_spread(gaps + PREROLL),
        gap=_spread(gaps),
        body=_spread(np.array([clip.body_movement for clip in clips])),
        hand=_spread(np.array([clip.hand_movement for clip in clips])),
    )


def _spread(values: np.ndarray) -> Spread:
    return Spread(float(values.mean()), float(values.std()))


LONG_GAP = 9.0  # seconds of a prime gap, in a window of ten
_MOVING = 0.3  # m/s of the pelvis over the floor, from which on somebody is on their way
_OFF_THE_WAY = 60.0  # degrees between pelvis and direction of travel
_AFTER_PRIME = 0.5  # seconds
_SACCADE = 0.12  # seconds
_SAME_LOOK = 10.0  # degrees within which gaze rests on the same place

RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "long_gaps": (0.0, 0.08),  # ours: fewer than if all gaps of the window were equally likely
        "body_movement": (-1 / 3, 1 / 3),  # ours: presets were fitted to Prime and Reach, Table 1
        "reach_peak": (0.30, 0.50),  # people: Jeannerod 1984; at most .5, Flash & Hogan 1985
        "off_the_way": (0.0, 0.15),  # ours: Handford & Srinivasan 2014 say a step or two, without a number
        "gaze_to_head": (10.0, 30.0),  # people: Ergonomics 2010 (head share .69), of a shift of 35 degrees, .6 s long
        "head_share": (0.50, 0.85),  # people: Ergonomics 2010, .69
    }
)
"""Ranges of the numbers of :func:`measure_behaviour`, borders included. People of hot3d stay at one table: their ways
are steps to the side, so ``off_the_way`` is not asked of them."""


def out_of_range(preset: str, numbers: Mapping[str, float]) -> dict[str, float]:
    """Return the numbers of a preset that lie outside their ranges."""
    asked = [name for name in RANGES if (preset, name) != ("hot3d", "off_the_way")]
    return {name: numbers[name] for name in asked if not RANGES[name][0] <= numbers[name] <= RANGES[name][1]}


def measure_behaviour(performances: Sequence[Performance]) -> dict[str, float]:
    """Measure how people of one preset act, on noise-free motion and gaze."""
    events = [
        (performance, event, event.prime_time)
        for performance in performances
        for event in performance.events
        if event.expected == "sequence" and event.prime_time is not None
    ]
    gaps = np.array([event.event_time - prime for _, event, prime in events])
    statistics = sequence_statistics(clips_of(performances))
    ways = np.array([_off_the_way(performance) for performance in performances])
    looks = np.array([_gaze_to_head(performance, prime) for performance, _, prime in events])
    resting = looks[looks[:, 3] < _SAME_LOOK]
    return {
        "long_gaps": float((gaps > LONG_GAP).mean()),
        "body_movement": statistics.deviations(TARGETS[performances[0].preset])["body"],
        "reach_peak": float(np.median([_reach_peak(performance, event) for performance, event, _ in events])),
        "off_the_way": ways[:, 0].sum() / max(ways[:, 1].sum(), 1),
        "gaze_to_head": float(looks[:, 0].mean()),
        "head_share": float(1.0 - resting[:, 2].mean() / resting[:, 1].mean()),
    }


def _reach_peak(performance: Performance, event: TrueEvent) -> float:
    first, last = np.searchsorted(performance.times, [event.reach_start, event.contact_time])
    around = slice(max(int(first) - 1, 0), int(last) + 2)
    wrist = performance.joints[around, WRISTS[event.hand == "right"]] - performance.joints[around, Joint.PELVIS]
    speed = np.linalg.norm(np.gradient(wrist, axis=0), axis=1)[1:-1]
    return float(speed.argmax()) / max(len(speed) - 1, 1)


def _off_the_way(performance: Performance) -> tuple[int, int]:
    """Return in how many frames the pelvis travels facing elsewhere, and in how many it travels."""
    velocity = np.gradient(performance.joints[:, Joint.PELVIS][:, [0, 2]], performance.times, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    facing = forward_of(performance.rotations[:, Joint.PELVIS])[:, [0, 2]]
    along = (velocity * facing).sum(axis=1) / np.linalg.norm(facing, axis=1)
    moving = speed > _MOVING
    off = moving & (along < np.cos(np.deg2rad(_OFF_THE_WAY)) * speed)
    return int(off.sum()), int(moving.sum())


def _gaze_to_head(performance: Performance, prime: float) -> tuple[float, float, float, float]:
    """Return the angle between gaze and head after a prime (mean, first, last) and how far gaze moved, degrees."""
    first, settled, last = np.searchsorted(performance.times, [prime, prime + _SACCADE, prime + _AFTER_PRIME])
    last = min(int(last), performance.times.size - 1)
    span = slice(int(first), last + 1)
    angle = _angle(forward_of(performance.head_rotation[span]), performance.gaze[span])
    moved = _angle(performance.gaze[min(int(settled), last)], performance.gaze[last])
    return float(angle.mean()), float(angle[0]), float(angle[-1]), float(moved)


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angle between unit vectors, degrees."""
    return np.rad2deg(np.arccos(np.clip((first * second).sum(axis=-1), -1.0, 1.0)))
