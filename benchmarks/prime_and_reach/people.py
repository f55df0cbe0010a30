"""``prbench analyse people``: how people look, reach, turn and walk, beside what others measured of people.

Definitions and sources of the figures: docs/specification/people.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool, Float

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.geometry.skeleton import TOES, WRISTS, Joint, head_forward, rotation_matrices
from prbench.harness.synthetic_table import Staging
from prbench.protocol.manifests import read_toml
from prbench.sequences import SequenceTable
from prbench.synthetic.people import PRESETS
from prbench.synthetic.performance import Performance
from prbench.tables import Block, Cell, Column, Row, Table

Directions = Float[np.ndarray, "n 3"]
# What is measured, its amplitude, way, height or speed, and its value.
Measurement = tuple[str, Any, Any]
_TURNING = 20.0  # degrees a second of a head or body that turns
_SACCADE = 100.0  # degrees a second of gaze that goes elsewhere
_SAME_LOOK = 10.0  # degrees
_WALKING = 0.15  # m/s of a pelvis on its way
_MOVING = 0.3  # m/s of a toe that swings, or a hand that reaches
_STRIDE = 0.2  # metres that a toe goes at least in a step
_AT_REST = 0.05  # share of its peak speed below which a wrist rests
_SLOW = 0.3  # the same of a wrist in its slow phase


@dataclass(frozen=True)
class Observed:
    """One person's motion at a uniform rate.

    Attributes:
        fps: Frames a second.
        joints: World or canonical frame, Y up, metres.
        head: Directions of the head.
        gaze: Directions of gaze, NaN where it is unknown.
        reaches: Frame of contact, wrist and goal (metres) of each reach.
    """

    fps: float
    joints: Float[np.ndarray, "n 22 3"]
    head: Directions
    gaze: Directions
    reaches: tuple[tuple[int, int, np.ndarray], ...] = ()


class Figure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One row of docs/specification/people.md.

    Attributes:
        of: Name of the measurement.
        begin: Smallest amplitude, way, height or speed of what belongs to it.
        end: The first one beyond.
        low: Lower end of the published interval, where a number was found.
        high: Its upper end.
    """

    title: str
    unit: str
    of: str
    begin: float = -np.inf
    end: float = np.inf
    low: float = -np.inf
    high: float = np.inf


def _of_performance(performance: Performance) -> Observed:
    frames = np.searchsorted(performance.times, [event.contact_time for event in performance.events])
    events = zip(frames, performance.events, strict=True)
    reaches = tuple((int(frame), WRISTS[each.hand == "right"], each.goal) for frame, each in events)
    head = rotation_matrices(performance.head_rotation)[..., 2]
    return Observed(performance.rate, performance.joints, head, performance.gaze, reaches)


def _of_table(table: SequenceTable) -> Iterator[Observed]:
    columns = ["joints", "goal_location", "hand", "head_tilt_deg", "fps", "gaze_direction", "gaze_valid"]
    for chunk in table.chunks(columns=columns, rows=1):
        joints = chunk.joints.astype(np.float64)
        head, _ = head_forward(joints, float(chunk.numbers("head_tilt_deg")[0]))
        gaze = np.where(chunk.frames("gaze_valid")[:, None], chunk.frames("gaze_direction"), np.nan)
        (hand,) = chunk.strings("hand")
        reach = (len(joints) - 1, WRISTS[hand == "right"], chunk.vectors("goal_location")[0])
        yield Observed(float(chunk.numbers("fps")[0]), joints, head, gaze, (reach,) if hand else ())


def _angle(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angle between directions, degrees."""
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(first, second), axis=-1), (first * second).sum(axis=-1)))


def _yaw(first: np.ndarray, second: np.ndarray) -> float:
    """Turn about the vertical from one direction to another, degrees."""
    (x, z), (to_x, to_z) = first[[0, 2]], second[[0, 2]]
    return float(np.rad2deg(np.arctan2(z * to_x - x * to_z, x * to_x + z * to_z)))


def _speed(points: np.ndarray, fps: float) -> Float[np.ndarray, " n"]:
    return np.append(np.linalg.norm(np.diff(points, axis=0), axis=1) * fps, 0.0)


def _turning(directions: Directions, fps: float) -> Float[np.ndarray, " n"]:
    return np.append(_angle(directions[:-1], directions[1:]) * fps, 0.0)


def _bouts(moving: Bool[np.ndarray, " n"]) -> Iterator[tuple[int, int]]:
    """Yield the first frame of each stretch of motion and the first one after it; a stretch cut short is left out."""
    edges = np.flatnonzero(np.diff(moving)) + 1
    edges = edges[int(moving[0]) :]
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=False)


def _turns(name: str, directions: Directions, fps: float) -> Iterator[Measurement]:
    speed = _turning(directions, fps)
    for start, stop in _bouts(speed > _TURNING):
        yield name, _angle(directions[start], directions[stop]), speed[start:stop].max()


def _looks(person: Observed) -> Iterator[Measurement]:
    """Yield the head's share of each horizontal gaze shift that begins with a resting head, and its lag."""
    turning = _turning(person.head, person.fps)
    gaze = person.gaze
    before = round(0.2 * person.fps)
    after = round(0.4 * person.fps)
    for start, stop in _bouts(_turning(person.gaze, person.fps) > _SACCADE):
        if start < before or stop + after >= len(gaze) or turning[start - before] > _TURNING:
            continue
        shift = _yaw(gaze[start], gaze[stop])
        moved = _yaw(person.head[start - before], person.head[stop + after])
        if _angle(gaze[stop], gaze[stop + after]) < _SAME_LOOK <= abs(shift):  # False where gaze is unknown
            yield "head_share", abs(shift), moved / shift
            if (onsets := np.flatnonzero(turning[start - before : stop] > _TURNING)).size:
                yield "head_lag", moved * np.sign(shift), (onsets[0] - before) / person.fps


def _reaches(person: Observed) -> Iterator[Measurement]:
    """Yield the bend at contact, and the wrist's speed relative to the pelvis, its shape and the look before it."""
    for end, wrist, goal in person.reaches:
        first = max(end - round(1.5 * person.fps), 0)
        trunk = person.joints[end, Joint.NECK] - person.joints[end, Joint.PELVIS]
        yield "bend", goal[1], _angle(trunk, np.array([0.0, 1.0, 0.0]))
        way = person.joints[first : end + 1, wrist] - person.joints[first : end + 1, Joint.PELVIS]
        speed = _speed(way, person.fps)
        peak = int(speed.argmax())
        resting = np.flatnonzero(speed < max(_AT_REST * speed[peak], 1e-9))
        begun = resting[resting < peak]
        if speed[peak] < _MOVING or not begun.size:  # the hand was on its way before
            continue
        start = int(begun[-1]) + 1
        stop = int(resting[resting > peak][0])
        length = stop - start
        distance = np.linalg.norm(way[stop] - way[start])
        yield "wrist_speed", distance, speed[peak]
        yield "wrist_peak", distance, (peak - start + 0.5) / length
        yield "wrist_slow", distance, (peak - start + np.argmax(speed[peak:] < _SLOW * speed[peak])) / length
        yield "wrist_ratio", distance, speed[peak] / speed[start:stop].mean()
        away = _angle(person.gaze, goal - person.joints[:, Joint.HEAD]) > _SAME_LOOK
        if not away[first + start] and away[: first + start].any():
            yield "gaze_lead", distance, (start - 1 + first - np.flatnonzero(away[: first + start])[-1]) / person.fps


def _walks(person: Observed) -> Iterator[Measurement]:
    """Yield speeds of straight walks, and length, cadence, swing and clearance of steps."""
    pelvis = person.joints[:, Joint.PELVIS][:, [0, 2]]
    speed = _speed(pelvis, person.fps)
    for start, stop in _bouts(speed > _WALKING):
        distance = np.linalg.norm(pelvis[stop] - pelvis[start])
        if distance > 0.9 * speed[start:stop].sum() / person.fps:
            yield "walk_speed", distance, distance * person.fps / (stop - start)
            yield "pelvis_speed", distance, speed[start:stop].max()
    swings = []
    for toe in TOES:
        path = person.joints[:, toe][:, [0, 2]]
        for start, stop in _bouts(_speed(person.joints[:, toe], person.fps) > _MOVING):
            if np.linalg.norm(path[stop] - path[start]) > _STRIDE:
                swings.append((stop, start, toe))
    for (before, _, other), (stop, start, toe) in itertools.pairwise(sorted(swings)):
        seconds = (stop - before) / person.fps
        if toe == other or not 0.2 < seconds < 1.5:
            continue
        stride = (person.joints[stop, toe] - person.joints[start, toe])[[0, 2]]
        ahead = (person.joints[stop, toe] - person.joints[stop, other])[[0, 2]]
        length = stride @ ahead / np.linalg.norm(stride)
        pace = length / seconds
        yield "step", pace, length
        yield "cadence", pace, 60 / seconds
        yield "walk_ratio", pace, 1000 * length * seconds / 60
        yield "swing_share", pace, (stop - start) / (2 * (stop - before))
        yield "swing_time", pace, (stop - start) / person.fps
        middle = person.joints[start + round(0.3 * (stop - start)) : start + round(0.8 * (stop - start)) + 1, toe, 1]
        yield "clearance", pace, 100 * (middle.min() - person.joints[:, toe, 1].min())


def measured(people: Iterable[Observed]) -> dict[str, list[float]]:
    """Measure every figure of docs/specification/people.md on some people: all values of each, by its id."""
    found: list[Measurement] = []
    for person in people:
        found += [*_turns("head_speed", person.head, person.fps), *_looks(person)]
        hips = person.joints[:, Joint.LEFT_HIP] - person.joints[:, Joint.RIGHT_HIP]
        found += [*_turns("body_speed", hips * [1.0, 0.0, 1.0], person.fps), *_reaches(person), *_walks(person)]
    return {
        name: [float(value) for of, size, value in found if of == figure.of and figure.begin <= size < figure.end]
        for name, figure in figures().items()
    }


def figures() -> dict[str, Figure]:
    """Load the figures and their published intervals, by id."""
    return read_toml("prbench_benchmarks.prime_and_reach", "people.toml", dict[str, Figure])


def people_table(tables: Sequence[Path], *, seed: int, recordings: int) -> Table:
    """Measure people and lay them out beside the published figures, a column for each dataset.

    Args:
        tables: Built datasets; none for people who are acted out at 120 frames a second, a column for each layout.
        seed: Seed of acted people.
        recordings: Acted recordings a layout.

    Raises:
        TableError: if a table cannot be read.
    """
    people: dict[str, Iterable[Observed]] = {}
    for table in map(SequenceTable.open, tables):
        people[table.info.dataset] = _of_table(table)
    for preset in () if tables else PRESETS:
        performances = map(Staging(preset, seed).perform, range(recordings))
        people[f"{SYNTHETIC_PREFIX}{preset}"] = map(_of_performance, performances)
    values = {name: measured(each) for name, each in people.items()}
    rows = []
    for name, figure in figures().items():
        cells = []
        for dataset, found in values.items():
            if found[name]:
                low, median, high = np.quantile(found[name], (0.25, 0.5, 0.75))
                outside = not figure.low <= median <= figure.high
                about = {"dataset": dataset, "variant": name, "unit": figure.unit, "sequences": len(found[name])}
                about["note"] = f"quartiles {low:.3g} and {high:.3g}" + "; outside" * outside
                cells.append(Cell(metric=dataset, value=float(median), mark="!" * outside, **about))
        ends = [f"{word} {end:g}" for word, end in (("from", figure.low), ("to", figure.high)) if np.isfinite(end)]
        words = {"figure": f"{figure.title} ({figure.unit})", "published": " ".join(ends)}
        rows.append(Row(text=words, cells=tuple(cells)))
    columns = [Column(key=key, title=key, text=True) for key in ("figure", "published")]
    columns += [Column(key=name, title=name) for name in values]
    title = "People beside published figures (docs/specification/people.md): medians, ! where outside"
    return Table(title=title, columns=tuple(columns), blocks=(Block(rows=tuple(rows)),))
