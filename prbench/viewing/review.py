"""A page to look through the events of a table: what eyes, hands and object did around each, and a person's verdict.

One HTML file that loads nothing. Its script (``review.html`` beside this file) draws the pictures from the numbers that
are gathered here from the recordings, and saves what a person decides as a corrections file
(docs/review.md#the-corrections-file).
"""

from __future__ import annotations

import fnmatch
import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.curation.clipping import gaze_at, joints_at
from prbench.curation.corrections import CHANGES, COLUMNS
from prbench.curation.in_hand import contact_distance
from prbench.curation.job import NativeSource, native_sources
from prbench.curation.mending import Numbers, mended, stream_numbers
from prbench.curation.options import BuildOptions
from prbench.curation.priming import Rays, gaze_rays
from prbench.engine import Engine, InProcess
from prbench.errors import InputFileError, PrbenchError, UsageError, did_you_mean
from prbench.files.storage import sole_writer, text_digest, write_text
from prbench.geometry.shapes import ray_distances
from prbench.geometry.skeleton import WRISTS, Joint
from prbench.geometry.timelines import covered, interpolate, nearest_index
from prbench.metrics import GazeRays
from prbench.progress_bar import ProgressCallback
from prbench.protocol.manifests import InHandRule, MetricConstants, load_manifest, load_protocol
from prbench.readers import reader_for
from prbench.recording import SIDES, BodyStream, HandStream, ObjectTrack, PoseStream, Recording
from prbench.sequences import DatasetInfo, Event, SequenceTable
from prbench.sequences.dataset_info import notice, require_may_pass_on
from prbench.sequences.sequence import EVENTS, OUTCOMES, row_values
from prbench.viewing.player.document import encoded, player_sequence
from prbench.viewing.player.page import filled, player_assets
from prbench.viewing.replay.scene import RECORDED, RECORDED_COLOUR, Goal, Scene, ShownMotion

_STEP = 0.05  # seconds between two values of a curve
_WAY_STEP = 5  # steps between two places seen from above
_BEFORE = 1.0  # seconds shown before the window in which a look primes
_AFTER = 2.0
_LONGEST_GAP = 0.3  # seconds that a path is drawn across
_SPEED_WINDOW = 0.2  # seconds, where no in-hand rule says another
_MOST = 9999  # mm, which stands for all that is farther, and for rays that point away
_WARNING = "This table was built with corrections: load their file first, or what you save lacks them. "
_MOTION_BEFORE = 3.0  # seconds of the body before and after an event
_MOTION_AFTER = 1.0
_MOTION_FPS = 20.0
_NEVER = -1000.0
LARGEST_MOTIONS = 20_000_000  # bytes of motions on a page; a motion takes about 20 kB
_UNKNOWN = -1  # stands in a curve where nothing was measured


@dataclass(frozen=True)
class Review:
    """The page that was written.

    Attributes:
        out: The page.
        events: Number of events on it, the most doubtful first; entries that cannot be read have no time to show.
        without_picture: Maps each recording that could not be read to the reason; its events have no pictures.
        motions: Number of events whose body can be played: of the first ones that have one, as many as 20 MB hold.
    """

    out: Path
    events: int
    without_picture: Mapping[str, str]
    motions: int = 0


_IN_PROCESS = InProcess()


def write_review(
    data: Path,
    root: Path,
    out: Path,
    *,
    outcomes: Collection[str] = (),
    recordings: str = "*",
    objects: str = "",
    max_confidence: float | None = None,
    limit: int | None = None,
    option: Mapping[str, str] | None = None,
    permitted: Collection[str] = (),
    engine: Engine = _IN_PROCESS,
    progress: ProgressCallback | None = None,
) -> Review:
    """Write the page of a table's events.

    Args:
        data: A built dataset.
        root: The recordings that it was built from.
        out: The page; replaced when it exists.
        outcomes: Only events with one of these outcomes; all if empty.
        recordings: Glob over recording ids.
        objects: Part of an object's name or id.
        max_confidence: Only events that are at most so sure.
        limit: Largest number of events, the most doubtful first.
        option: Options of the reader that ``dataset.json`` does not tell, because they are places.
        permitted: Datasets for which the user has permission to pass recorded motion on.
        engine: Reads the recordings, in this process or in others.
        progress: Called after each recording.

    Raises:
        TableError: if the folder holds no dataset.
        RedistributionError: if its licence keeps recorded motion.
        UsageError: if no event is left, an outcome is unknown, or the page is no ``.html``.
        InputFileError: if none of the recordings is below ``root``.
        StorageError: if the page cannot be written.
    """
    if out.suffix.lower() != ".html":
        raise UsageError(f"{out}: expected a file that ends in .html, found '{out.suffix}'.")
    for name in set(outcomes) - set(OUTCOMES):
        raise UsageError(f"there is no outcome '{name}'.{did_you_mean(name, OUTCOMES)} All: {', '.join(OUTCOMES)}.")
    table = SequenceTable.open(data)
    info = table.info
    require_may_pass_on(info, "the page", permitted)
    rows = table.events()
    columns = [row_values(rows[name].combine_chunks()) for name in EVENTS.names]
    chosen = [
        event
        for event in (Event(**dict(zip(EVENTS.names, values, strict=True))) for values in zip(*columns, strict=True))
        if math.isfinite(event.event_time)
        and (not outcomes or event.outcome in outcomes)
        and fnmatch.fnmatchcase(event.recording_id, recordings)
        and (objects in event.object_name or objects in event.object_id)
        and (max_confidence is None or (event.event_confidence or 0.0) <= max_confidence)
    ]
    events = sorted(chosen, key=doubt)[:limit]
    if not events:
        raise UsageError(f"{data}: expected events that the options choose, found none among {len(rows)}.")

    sources, mends = native_recordings(info, root, option)
    of_recording: dict[str, list[Event]] = {}
    for event in events:
        of_recording.setdefault(event.recording_id, []).append(event)
    work = [(sources.get(name), own) for name, own in of_recording.items()]
    if not any(source for source, _ in work):
        expected = f"recordings of {data}, such as {events[0].recording_id}"
        raise InputFileError(root, "", expected=expected, found="others")
    protocol = table.described_protocol.protocol() or load_protocol()
    said = info.options.get("in_hand_rule", "none")
    rule = None if said == "none" else load_manifest(info.dataset).in_hand_rule(None if said == "default" else said)
    before = protocol.curation.priming_window + _BEFORE
    terms = notice(info, permitted)
    act = partial(event_motion, dataset=info.dataset, constants=protocol.metrics, terms=terms)
    numbers = partial(picture, rule=rule, before=before)
    draw = partial(_pictures, mends=mends, origin=info.options.get("ray_origin", "eye"), numbers=numbers, act=act)
    pictures: dict[str, dict[str, Any]] = {}
    bodies: dict[str, bytes] = {}
    problems: dict[str, str] = {}
    read = zip(engine.map(draw, work), of_recording, strict=True)
    for number, ((found, moved, problem), recording) in enumerate(read, 1):
        pictures |= found
        bodies |= moved
        if problem:
            problems[recording] = problem
        if progress is not None:
            progress(number, len(work), recording)
    motions = []
    room = LARGEST_MOTIONS
    for place, event in enumerate(events):
        content = bodies.get(event.event_id, b"")
        room -= len(content)
        if content and room >= 0:
            motions.append(f'<script type="application/json" id="motion-{place}">{content.decode()}</script>')
    page = {
        "title": info.title,
        "notice": f"{_WARNING if 'corrections' in info.options else ''}{terms}",
        "key": text_digest(info.dataset, info.content_digest),
        "columns": COLUMNS,
        "changes": CHANGES,
        "step": _STEP,
        "every": _WAY_STEP,
        "before": before,
        "near": round(protocol.curation.near_miss_distance * 1000),
        "held": None if rule is None else round(rule.distance * 1000),
        "moving": None if rule is None else round(rule.moving_speed * 1000),
        "events": [_told(each, pictures.get(each.event_id), problems.get(each.recording_id, "")) for each in events],
    }
    assets = player_assets()
    parts = {"STYLE": assets.style, "DATA": encoded(page).decode()}
    parts |= {"MOTIONS": "\n".join(motions), "PLAYER": assets.scripts}
    with sole_writer(out):
        write_text(out, filled(Path(__file__).with_name("review.html"), parts))
    return Review(out, len(events), problems, len(motions))


def native_recordings(
    info: DatasetInfo, root: Path, option: Mapping[str, str] | None = None
) -> tuple[dict[str, NativeSource], tuple[Numbers, Numbers]]:
    """Return the recordings below a folder by id, to be read as a table's build read them, and what it mended in them.

    Args:
        info: Description of the table.
        root: The recordings that it was built from.
        option: Options of the reader that the description does not tell: of places it knows digests only.
    """

    def told(kind: str) -> dict[str, str]:
        return {key.removeprefix(kind): text for key, text in info.options.items() if key.startswith(kind)}

    usual = reader_for(info.dataset).options
    reader = {key: text for key, text in told("reader.").items() if getattr(usual, key, None) is not None}
    reader |= dict(option or {})
    mends = (stream_numbers(told("shift."), "shift"), stream_numbers(told("scale."), "scale"))
    sources = native_sources(info.dataset, root, BuildOptions(reader=(*reader.items(),)))
    return {each.recording_id: each for each in sources}, mends


def recording_of(
    info: DatasetInfo | None, recording_id: str, root: Path, option: Mapping[str, str] | None = None
) -> Recording:
    """Read a recording of a table as the table's build read it; the arguments are those of :func:`native_recordings`.

    Raises:
        InputFileError: if it is not below ``root``, or cannot be read.
    """
    assert info is not None, "the recording is of a table"
    sources, mends = native_recordings(info, root, option)
    if recording_id not in sources:
        found = ", ".join(list(sources)[:3])
        raise InputFileError(root, "", expected=f"the recording {recording_id}", found=f"others, such as {found}")
    return mended(sources[recording_id].read(), *mends)


def doubt(event: Event) -> tuple[float, float, str]:
    """Return the key that sorts the most doubtful event first: by confidence, then by the margin of what decided."""
    confidence = 1.0 if event.event_confidence is None else event.event_confidence
    margins = [event.prime_margin, None if event.threshold is None else (event.value or 0.0) - event.threshold]
    return confidence, min((abs(margin) for margin in margins if margin is not None), default=math.inf), event.event_id


def _told(event: Event, picture: dict[str, Any] | None, problem: str) -> dict[str, Any]:
    """Return what the page says of one event; times in seconds after the uncorrected event."""
    time = _uncorrected(event)
    what = f"{event.event_time:.2f} s, {event.hand or 'unknown'} hand; {event.outcome}"
    if event.value is not None:
        limit = "" if event.threshold is None else f" (threshold {event.threshold:g})"
        what = f"{what}, {event.stage}: {event.value:.3f}{limit}"
    if event.event_confidence is not None:
        what = f"{what}, confidence {event.event_confidence:.2f}"
    if event.location is not None:
        what = f"{what}; goal {' '.join(f'{value:.3f}' for value in event.location)}"
    return {
        "id": event.event_id,
        "title": f"{event.action} of {event.object_name}",
        "what": what,
        "corrected": f"in the table: {event.corrected}" if event.corrected else "",
        "problem": f"no pictures: {problem}" if problem else "",
        "hand": event.hand,
        "event": round(event.event_time - time, 3),
        "prime": None if event.prime_time is None else round(event.prime_time - time, 3),
        "goal": event.location is not None,
        "picture": picture,
    }


def _uncorrected(event: Event) -> float:
    """Return the time of the event without corrections, seconds, which its id tells in microseconds."""
    return int(event.event_id.rpartition("/")[2]) / 1e6


def _pictures(
    work: tuple[NativeSource | None, Sequence[Event]],
    *,
    mends: tuple[Numbers, Numbers],
    origin: str,
    numbers: Callable[[Recording, Event, Rays], dict[str, Any]],
    act: Callable[[Recording, Event], bytes],
) -> tuple[dict[str, dict[str, Any]], dict[str, bytes], str]:
    """Read one recording and return the numbers of its events' pictures and motions, or why there are none."""
    source, events = work
    if source is None:
        return {}, {}, "this recording is not below --root"
    try:
        recording = mended(source.read(), *mends)
    except PrbenchError as error:
        return {}, {}, source.without_places(str(error))
    rays = gaze_rays(recording, origin)
    pictures = {event.event_id: numbers(recording, event, rays) for event in events}
    return pictures, {event.event_id: act(recording, event) for event in events}, ""


def event_motion(recording: Recording, event: Event, *, dataset: str, constants: MetricConstants, terms: str) -> bytes:
    """Return the document of the body around an event, for the player; nothing where there was no body all the time.

    Args:
        recording: What a reader yields.
        event: One of its events.
        dataset: Name of the dataset.
        constants: Thresholds of the protocol.
        terms: Sentence that the dataset's terms ask a view to show.
    """
    body = recording.body
    time = _uncorrected(event)
    times = time + np.arange(-_MOTION_BEFORE, _MOTION_AFTER, 1 / _MOTION_FPS)
    if body is None or event.location is None or event.box_min is None or event.box_max is None:
        return b""
    if not covered(body.times, body.valid, times, max_gap=_LONGEST_GAP).all():
        return b""
    joints = joints_at(body, times)
    # The player's floor is at height 0, and its stage around the origin.
    shift = np.array([joints[0, Joint.PELVIS, 0], joints[..., 1].min(), joints[0, Joint.PELVIS, 2]])
    origin, direction, valid = gaze_at(recording.gaze, times, max_gap=_LONGEST_GAP)
    corners = np.array(list(itertools.product(*zip(event.box_min, event.box_max, strict=True))))
    eyes = GazeRays(origin - shift, direction, valid) if valid.any() else None
    motion = ShownMotion(RECORDED, RECORDED_COLOUR, joints - shift, {}, eyes, "recorded")
    # An event that was not primed, or long before, has no prime within these seconds.
    prime = _NEVER if event.prime_time is None else float(event.prime_time - times[0])
    title = f"{event.action} of {event.object_name}"
    said = (event.event_id, dataset, title, event.action, _MOTION_FPS, len(times), prime, recording.head_tilt_deg)
    scene = Scene(*said, (motion,), constants, Goal(event.location - shift, corners - shift), terms)
    return encoded(msgspec.structs.replace(player_sequence(scene), event_time=_MOTION_BEFORE))


def picture(recording: Recording, event: Event, rays: Rays, rule: InHandRule | None, before: float) -> dict[str, Any]:
    """Return the numbers of one event's pictures.

    Args:
        recording: What a reader yields.
        event: One of its events.
        rays: Times, origins and directions of its valid gaze samples.
        rule: The in-hand rule; None where the dataset annotates its events.
        before: Seconds to show before the event.

    Returns:
        Curves, one value each :data:`_STEP` from ``before`` the uncorrected event on: distance of ``left`` and
        ``right`` hand to the object (by the rule, else of the wrist to the place), distance ``gaze`` of the ray to the
        box (0 within it), both in mm, ``speed`` of the object in mm/s; -1 where nothing was measured. Under ``above``
        places x, z in cm around the goal, one each :data:`_WAY_STEP` of these steps: ``head``, ``left``, ``right``,
        ``object``, and ``look``, where the gaze ray is as far away as the goal; None where unknown. ``box``: half its
        sides along x and z, cm.
    """
    times = _uncorrected(event) + np.arange(-before, _AFTER + _STEP / 2, _STEP)
    unknown = np.full((len(times), 3), np.nan)
    goal = np.zeros(3) if event.location is None else event.location
    if event.location is None and len(recording.head.times):  # where nothing is known of the place, around the head
        goal = recording.head.pose_at(np.array([event.event_time]))[0][0]
    body = recording.body
    track = next((each for each in recording.objects if each.object_id == event.object_id), None)
    ways = {"head": _path(recording.head, recording.head.position, times), "object": unknown}
    curves = {"speed": unknown[:, 0]}
    if track is not None:
        half = (_SPEED_WINDOW if rule is None else rule.moving_window) / 2
        ends = [_path(track, track.position, times + shift) for shift in (-half, half)]
        curves["speed"] = np.linalg.norm(ends[1] - ends[0], axis=1) / (2 * half)
        ways["object"] = _path(track, track.position, times)
    if body is not None and not recording.head.valid.any():
        ways["head"] = _path(body, body.joints[:, Joint.HEAD], times)
    for side, wrist in zip(SIDES, WRISTS, strict=True):
        # The points that decide come first; a body's wrist stands in where no hand was tracked.
        hands = [hand for hand in recording.hands if hand.side == side]
        hands.sort(key=lambda hand: hand.contact != ("wrist" if rule is None else rule.contact))
        way = unknown if body is None else _path(body, body.joints[:, wrist], times)
        if hands:
            way = _path(hands[0], hands[0].points.mean(axis=1), times)
        distance = np.linalg.norm(way - (np.nan if event.location is None else goal), axis=1)
        if track is not None and rule is not None and hands and hands[0].contact == rule.contact:
            near = contact_distance(hands[0], track, rule, times, *track.pose_at(times))
            distance = np.where(np.isfinite(near) & np.isfinite(ways["object"][:, 0]), near, np.nan)
        ways[side] = way
        curves[side] = distance
    curves["gaze"], ways["look"] = _looks(rays, event, goal, times)
    above = {}
    for name, way in ways.items():
        places = (100 * (way - goal)[::_WAY_STEP, [0, 2]]).round()
        above[name] = [None if math.isnan(place[0]) else [int(each) for each in place] for place in places.tolist()]
    box = [0, 0]
    if event.box_min is not None and event.box_max is not None:
        box = (50 * (event.box_max - event.box_min)[[0, 2]]).round().astype(int).tolist()
    measured = {name: np.nan_to_num(1000 * curve, nan=_UNKNOWN) for name, curve in curves.items()}
    numbers = {name: curve.clip(max=_MOST).round().astype(int).tolist() for name, curve in measured.items()}
    return {**numbers, "above": above, "box": box}


def _looks(
    rays: Rays, event: Event, goal: np.ndarray, times: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """Return how far gaze passes the event's box, metres, and where each ray is as far away as the goal.

    Every sample counts, as it does for priming: a curve shows the nearest of those that fall between two of its values.
    """
    near = np.full(len(times), np.nan)
    look = np.full((len(times), 3), np.nan)
    span = slice(*np.searchsorted(rays[0], [times[0] - _STEP, times[-1] + _STEP]))
    at, origins, directions = (column[span] for column in rays)
    if len(at) == 0 or event.box_min is None or event.box_max is None:
        return near, look
    distance = ray_distances(origins, directions, event.box_min[None], event.box_max[None])[0][:, 0]
    # Trackers slower than the curve leave steps without a sample: the nearest one stands there.
    nearest = nearest_index(at, times)
    spacing = float(np.median(np.diff(at))) if len(at) > 1 else 0.0
    known = np.abs(at[nearest] - times) <= 0.75 * max(spacing, _STEP)
    near[known] = distance[nearest[known]]
    np.fmin.at(near, nearest_index(times, at), distance)
    tips = origins + np.linalg.norm(goal - origins, axis=1)[:, None] * directions
    look[known] = tips[nearest[known]]
    return near, look


def _path(
    stream: ObjectTrack | PoseStream | BodyStream | HandStream,
    points: Float[np.ndarray, "n 3"],
    query: Float[np.ndarray, " m"],
) -> Float[np.ndarray, "m 3"]:
    """Return the path of a stream's points at some times; NaN where nothing near was measured."""
    found = np.full((len(query), 3), np.nan)
    seen = covered(stream.times, stream.valid, query, max_gap=_LONGEST_GAP)
    if seen.any():
        found[seen] = interpolate(stream.times[stream.valid], points[stream.valid], query[seen])
    return found
