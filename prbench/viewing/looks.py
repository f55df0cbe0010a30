"""A picture of gaze over objects in time: when the gaze ray was on which box around an event."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.curation.own_priming import PrimedEvent
from prbench.curation.priming import Rays, gaze_rays
from prbench.errors import UsageError
from prbench.geometry.shapes import ray_distances
from prbench.geometry.timelines import covered
from prbench.protocol.manifests import CurationConstants, load_protocol
from prbench.recording import AnnotatedEvent, ObjectTrack
from prbench.sequences import Event, SequenceTable
from prbench.sequences.dataset_info import notice, require_may_pass_on
from prbench.shown import figure_text
from prbench.viewing.figures import new_figure, require_drawable, styled, write_figure
from prbench.viewing.replay.scene import BOX_COLOUR, GAZE_COLOUR, MARK_COLOUR
from prbench.viewing.replay.sheet import COLUMN
from prbench.viewing.review import recording_of

MOST_EVENTS = 8  # in one picture
_MOST_THINGS = 9  # beside the event's own place
_AROUND = 1.0  # seconds shown before the window, and after the event
_FARTHEST = 60.0  # centimetres that the curve shows
_ROW = 0.15  # inches
_CURVE = 0.75
_BETWEEN = 0.55  # titles, ticks and labels of one event


@dataclass(frozen=True)
class Looks:
    """Gaze around one event.

    Attributes:
        times: Times of the valid gaze samples around it, seconds.
        distances: How far each of these rays passes each thing, metres, by its name: 0 of a hit, infinite of a ray that
            points away, NaN where the thing was not tracked. The event's own place comes first.
    """

    event: PrimedEvent | Event
    times: Float[np.ndarray, " n"]
    distances: dict[str, Float[np.ndarray, " n"]]


def looks_around(
    rays: Rays, event: PrimedEvent | Event, things: Iterable[ObjectTrack], constants: CurationConstants
) -> Looks:
    """Measure how gaze passed the place of an event and the things around it.

    Args:
        rays: Times, origins and directions of valid gaze samples, world.
        event: An event with a box.
        things: Further objects; those that gaze never met are left out.
        constants: Window and near-miss distance.
    """
    ends = [event.event_time - constants.priming_window - _AROUND, event.event_time + _AROUND]
    times, origins, directions = (column[slice(*np.searchsorted(rays[0], ends))] for column in rays)
    place = (np.array([event.box_min]), np.array([event.box_max]))
    distances = {event.object_name: ray_distances(origins, directions, *place)[0][:, 0]}
    met: list[tuple[float, str, np.ndarray]] = []
    for thing in things if len(times) else ():
        # In the frame of the object its box stands still, whatever way it goes.
        position, rotation = thing.pose_at(times)
        turn = Rotation.from_quat(rotation, scalar_first=True).inv()
        local = (turn.apply(origins - position), turn.apply(directions))
        distance = ray_distances(*local, thing.box_min[None], thing.box_max[None])[0][:, 0]
        if len(thing.times) > 1:
            known = covered(thing.times, thing.valid, times, max_gap=constants.largest_interpolated_gap)
            distance[~known] = np.nan
        first = np.flatnonzero(distance <= constants.near_miss_distance)
        if len(first):
            met.append((float(times[first[0]]), thing.name, distance))
    for _, name, distance in sorted(met, key=lambda each: each[:2])[:_MOST_THINGS]:
        distances.setdefault(name, distance)
    return Looks(event, times, distances)


def draw_event_looks(
    data: Path, event: Event, root: Path, path: Path, option: Mapping[str, str], permitted: Collection[str]
) -> str:
    """Draw gaze over objects around one event of a table, and return the caption.

    Without tracked objects, the places of the recording's other events stand in, each with the event nearest in time.

    Args:
        data: The built dataset.
        event: One of its events.
        root: The recordings that it was built from.
        path: PNG, SVG or PDF; replaced when it exists.
        option: Options of the reader that ``dataset.json`` does not tell, because they are places.
        permitted: Datasets for which the user has permission to pass recorded motion on.

    Raises:
        RedistributionError: if the dataset's licence keeps recorded motion.
        UsageError: for an event without a place, or another kind of file.
        InputFileError: if the recording is not below ``root``, or cannot be read.
        StorageError: if the picture cannot be written.
    """
    require_drawable(path)
    table = SequenceTable.open(data)
    require_may_pass_on(table.info, "the picture", permitted)
    if event.box_min is None or event.box_max is None:
        raise UsageError(f"{event.event_id}: expected an event with a place, found none; `prbench explain` says why.")
    recording = recording_of(table.info, event.recording_id, root, option)
    things = [track for track in recording.objects if track.object_id != event.object_id]
    if not recording.objects:
        nearest = sorted(recording.annotated_events, key=lambda each: -abs(each.event_time - event.event_time))
        of_object = {each.object_id: each for each in nearest if each.object_id != event.object_id}
        things = [_standing(each) for each in of_object.values() if each.location is not None]
    constants = (table.described_protocol.protocol() or load_protocol()).curation
    rays = gaze_rays(recording, table.info.options.get("ray_origin", "eye"))
    return draw_looks([looks_around(rays, event, things, constants)], path, constants, notice(table.info, permitted))


def _standing(event: AnnotatedEvent) -> ObjectTrack:
    """Return an object that stands at the place of an event."""
    location = event.location
    assert location is not None, "chosen by the caller"
    low = location if event.box_min is None else event.box_min
    high = location if event.box_max is None else event.box_max
    pose = (np.zeros(1), location[None], np.array([[1.0, 0.0, 0.0, 0.0]]), np.ones(1, dtype=bool))
    return ObjectTrack(event.object_id, event.object_name, "", *pose, low - location, high - location, movable=True)


@styled
def draw_looks(events: Sequence[Looks], path: Path, constants: CurationConstants, remark: str = "") -> str:
    """Write a picture of gaze over objects, one block an event, as wide as a text column.

    Args:
        events: Events with the looks around them, one or more; the first :data:`MOST_EVENTS` are drawn.
        path: PNG, SVG or PDF; replaced when it exists.
        constants: Window and near-miss distance.
        remark: Sentence that the dataset's terms ask a picture to show.

    Returns:
        The caption.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    window = constants.priming_window
    near = constants.near_miss_distance
    events = events[:MOST_EVENTS]
    heights = [(_ROW * len(looks.distances), _CURVE) for looks in events]
    sizes = [sum(height) + _BETWEEN for height in heights]
    figure = new_figure(COLUMN, sum(sizes) + 0.3, layout="constrained")
    blocks = figure.subfigures(len(events), 1, squeeze=False, height_ratios=sizes)[:, 0]
    for block, looks, ratios in zip(blocks, events, heights, strict=True):
        things, curve = block.subplots(2, 1, sharex=True, height_ratios=ratios)
        event = looks.event
        times = looks.times - event.event_time
        things.set_title(figure_text(f"{event.action} {event.object_name} at {event.event_time:.2f} s".strip()))
        for panel, low, height in ((things, -0.5, len(looks.distances)), (curve, -2.0, _FARTHEST + 2)):
            measured = _spells(times, (times >= -window) & (times <= 0))
            panel.broken_barh(measured, (low, height), color="0.93", linewidth=0, zorder=0)
            panel.set_ylim(low, low + height)
            panel.axvline(0.0, color=BOX_COLOUR, linewidth=1.0)
            if event.prime_time is not None:
                prime = event.prime_time - event.event_time
                panel.axvline(prime, color=MARK_COLOUR, linewidth=1.0, linestyle=(0, (3, 1.5)))
        for row, distance in enumerate(looks.distances.values()):
            hits = _spells(times, distance == 0)
            misses = _spells(times, (distance <= near) & (distance > 0))
            things.broken_barh(hits, (row - 0.38, 0.76), color=GAZE_COLOUR, linewidth=0)
            things.broken_barh(misses, (row - 0.2, 0.4), color=GAZE_COLOUR, alpha=0.45, linewidth=0)
        things.set_yticks(range(len(looks.distances)), [figure_text(name) for name in looks.distances])
        things.get_yticklabels()[0].set_weight("bold")
        things.invert_yaxis()
        # The line breaks where gaze was lost, and where it is too far away.
        distance = 100 * next(iter(looks.distances.values()))
        lost = np.diff(times, prepend=times[:1]) > _longest_step(times)
        curve.plot(times, np.where(lost | (distance > _FARTHEST), np.nan, distance), color=GAZE_COLOUR)
        curve.axhline(100 * near, color="0.4", linewidth=0.6, linestyle=":")
        curve.set(xlim=(-window - _AROUND, _AROUND), ylabel="gaze to place (cm)")
    figure.supxlabel(figure_text(f"seconds from the event\n{remark}".strip()))
    caption = (
        f"Gaze over objects: full bars, the gaze ray hits the object's box; thin bars, it passes within"
        f" {near * 100:g} cm. Bold: the place of the event; below, the distance at which gaze passes it (dotted:"
        f" {near * 100:g} cm). Grey: measured gaze of the {window:g} s in which a look primes; dashed line: the prime;"
        f" full line: the event. {remark}"
    ).strip()
    write_figure(figure, path, caption)
    return caption


def _longest_step(times: Float[np.ndarray, " n"]) -> float:
    """Return the longest time from one gaze sample to the next that is no gap: two and a half usual steps."""
    return 2.5 * float(np.median(np.diff(times))) if len(times) > 1 else np.inf


def _spells(times: Float[np.ndarray, " n"], state: Bool[np.ndarray, " n"]) -> list[tuple[float, float]]:
    """Return start and length of each spell in which a state holds; each sample stands for the time to the next one."""
    step = np.diff(times, append=np.inf)
    usual = float(np.median(step[:-1])) if len(step) > 1 else 0.1
    last = step > _longest_step(times)  # before a gap
    ends = times + np.where(last, usual, step)
    begins = state & ~np.append(False, state[:-1] & ~last[:-1])
    stops = state & ~np.append(state[1:] & ~last[:-1], False)
    return list(zip(times[begins].tolist(), (ends[stops] - times[begins]).tolist(), strict=True))
