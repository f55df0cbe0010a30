"""What HD-EPIC's glasses and annotators see of synthetic people, and its native files (docs/specification/hd-epic.md).

Sensors: docs/specification/synthetic-recordings.md#sensors, rows "hd-epic". Poses, gaze and hands come from the Machine
Perception Services, bodies from EgoAllo, places and times of events from people who looked at the video. Everything is
rounded to the files' resolution, so that files and memory agree. Files are archives by video, and annotations for all
videos together.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import tempfile
import zipfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.files.storage import atomic_path, write_json
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, transform_points
from prbench.geometry.timelines import interpolate
from prbench.protocol.manifests import Manifest
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.synthetic import GAZE_BIAS, sense_mps, uid_of, write_csv, write_mps
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo import synthetic as egoallo
from prbench.readers.egoallo.format import EgoAlloOutput
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.to_recording import recording_from_hd_epic
from prbench.recording import Recording
from prbench.synthetic.layouts import SHARED_PARTS, Layout
from prbench.synthetic.people.kinematics import forward_of
from prbench.synthetic.people.truth import seen_again
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.sensors import Sensing, Switches, device_start_us, sensor_generator

_POINT_NOISE = 0.020  # m an axis
_MISSING = 0.05  # share
_MIDDLE_MASK = 0.01  # share of the movements that have a third mask
_REVERSED = 0.3  # share of the movements whose masks are listed backwards
_FIXTURE_REACH = 0.8  # m
_METRES = 6  # decimals
_PIXELS = 2
_WINDOW = 300  # frames: the published priming looks back ten seconds at 30 fps
_NEAR = 0.10  # m between gaze and the object's place
_IN_VIEW = np.cos(np.deg2rad(50.0))  # half of the camera's field of view
_FORGOTTEN = 0.02  # share of the events that the file does not mention
_GAZE_PERIOD = 0.1  # s
_STEP_JITTER_US = 2
_GAZE_KIND = "general"  # HD-EPIC has no personalized gaze.
_CLOCK_JITTER_NS = 400  # of an image's time stamp
_REPEATED = 0.002  # share of the frames
_SKIPPED = 0.001
_TIME_NOISE = 0.060  # s
_SHORTEST_TRACK = 0.05  # s; noise never turns a movement around
_ANNOTATED = ("sequence", "not_primed", "too_short", "minimum_movement", "no_location", "tracking_lost")
_SECONDS = 3  # decimals


@dataclass(frozen=True)
class SensedVideo:
    """Content of the files of one video.

    Attributes:
        readings: Content of the video's files, with whole MPS readings and without body.
    """

    readings: hd_epic.HdEpicReadings
    bodies: tuple[EgoAlloOutput, ...]


def sense(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> SensedVideo:
    """Return what glasses, body estimate and annotators say about a performance.

    Args:
        performance: The truth.
        noise: Multiplies every error: its size, or how often it happens; 0 for ideal sensors.
        switches: Which errors are on; all if None.
    """
    sensing = Sensing(performance, noise, switches or Switches())
    measured = {"start_us": device_start_us(performance), "noise": noise, "switches": switches}
    glasses = sense_mps(performance, **measured, gaze_kind=_GAZE_KIND, step_jitter_us=_STEP_JITTER_US)
    # All videos of one participant share a world.
    world = (uid_of(f"kitchen of {performance.person.participant_id}"),)
    glasses = dataclasses.replace(glasses, trajectory=dataclasses.replace(glasses.trajectory, graph_uids=world))
    clock = sense_video_clock(sensing)
    tracks = _annotated_tracks(sensing, clock)
    # What the dataset publishes about priming: each end of a movement that has a mask, but for a few.
    rng = sensor_generator(performance, "published-priming")
    published = []
    for number, track in enumerate(tracks):
        forgotten = rng.random(2) < _FORGOTTEN
        start = round(track.start * hd_epic.FPS)
        end = round(track.end * hd_epic.FPS)
        for mask in track.masks:
            if mask.location is None or mask.frame not in (start, end) or forgotten[int(mask.frame == end)]:
                continue
            is_start = mask.frame == start
            first = max(start - _WINDOW, 0) if is_start else max(end - _WINDOW, start)
            key = f"{number}/{'start' if is_start else 'end'}"
            primed = _first_look(performance, mask, first)
            published.append(hd_epic.PublishedSide(key, is_start, mask.frame, mask.location, primed))
    published.sort(key=lambda side: (int(side.key.split("/")[0]), not side.is_start))
    identity = (performance.recording_id, performance.person.participant_id)
    readings = hd_epic.HdEpicReadings(*identity, clock, tracks, tuple(published), glasses, None)
    return SensedVideo(readings, egoallo.sense_egoallo(performance, glasses.trajectory, **measured))


def sense_video_clock(sensing: Sensing) -> hd_epic.VideoClock:
    """Return the device time of every frame: the image nearest to a regular time line, some twice, some skipped."""
    n = len(sensing.times(hd_epic.FPS))
    scale = sensing.strength("video_clock")
    rng = sensing.generator("video-clock")
    jitter = rng.uniform(-_CLOCK_JITTER_NS, _CLOCK_JITTER_NS, n) * scale
    repeated = rng.random(n) < _REPEATED * scale
    skipped = rng.random(n) < _SKIPPED * scale
    shown = np.maximum.accumulate(np.clip(np.arange(n) - repeated + skipped, 0, n - 1))
    since_start = np.rint(np.arange(n) * 1e9 / hd_epic.FPS + jitter).astype(np.int64)
    return hd_epic.VideoClock(device_start_us(sensing.performance) * 1000 + since_start[shown])


def _annotated_tracks(sensing: Sensing, clock: hd_epic.VideoClock) -> tuple[hd_epic.ObjectTrack, ...]:
    """Return one track a movement: the pick, and the put that ends it."""
    performance = sensing.performance
    rng = sensing.generator("annotated-times")
    device_start = device_start_us(performance) / 1e6 - performance.times[0]
    last = (len(clock.device_ns) - 1) / hd_epic.FPS - _SHORTEST_TRACK
    tracks = []
    for number, (pick, put) in enumerate(movements(performance)):
        shift = rng.normal(0.0, _TIME_NOISE, 2) * sensing.strength("annotated_times")
        device = device_start + np.array([pick.event_time, put.event_time]) + shift
        seconds = np.clip(clock.frames(device) / hd_epic.FPS, 0.0, last)
        start, end = (float(value) for value in np.round(seconds, _SECONDS))
        track_id = _identifier(f"{performance.recording_id} track {number}")
        names = (track_id, association_id(pick.object_id), pick.object_name.replace("_", " "))
        track = hd_epic.ObjectTrack(*names, start, max(end, start + _SHORTEST_TRACK), ())
        tracks.append(masks_of(sensing, track, (pick, put)))
    return tuple(sorted(tracks, key=lambda track: (track.start, track.end, track.object_id, track.track_id)))


def movements(performance: Performance) -> list[tuple[TrueEvent, TrueEvent]]:
    """Return every pick with the put of the same object that follows it."""
    ordered = sorted(performance.events, key=lambda event: event.event_time)
    known = [event for event in ordered if event.expected in _ANNOTATED]
    pairs = []
    for pick in (event for event in known if event.action == "pick"):
        after = [e for e in known if e.object_id == pick.object_id and e.event_time > pick.event_time]
        if after and after[0].action == "put":
            pairs.append((pick, after[0]))
    return pairs


def association_id(object_id: str) -> str:
    """Return sixteen hexadecimal digits for an object of a performance."""
    return _identifier(f"association {object_id}")


def _identifier(what: str) -> str:
    return hashlib.sha256(what.encode()).hexdigest()[:16]


def masks_of(sensing: Sensing, track: hd_epic.ObjectTrack, ends: tuple[TrueEvent, TrueEvent]) -> hd_epic.ObjectTrack:
    """Return the track with its masks: one at either end, rarely none or a third, listed in either order."""
    performance = sensing.performance
    rng = sensing.generator(f"masks-{track.track_id}")
    points = rng.normal(0.0, _POINT_NOISE, (2, 3)) * sensing.strength("annotated_points")
    lost = rng.random(2) < _MISSING * sensing.strength("mask_losses")
    has_middle, is_reversed = rng.random(2) < (_MIDDLE_MASK, _REVERSED)
    masks = []
    sides = zip(("start", "end"), (track.start, track.end), ends, points, lost, strict=True)
    for side, seconds, event, offset, missing in sides:
        if not missing:
            frame = round(seconds * hd_epic.FPS)
            place = np.round(transform_points(egoallo.NATIVE_FROM_WORLD, event.goal + offset), _METRES)
            box = _box(performance, event, frame)
            fixture = _fixture(performance, event.goal)
            masks.append(hd_epic.ObjectMask(_identifier(f"{track.track_id} {side}"), frame, place, box, fixture))
    if has_middle and track.end - track.start > 1.0 and len(masks) == 2:
        # Draw a mask somewhere in between, in the hand.
        frame = round((track.start + track.end) / 2 * hd_epic.FPS)
        place = np.round(np.mean([mask.location for mask in masks if mask.location is not None], axis=0), _METRES)
        box = _box(performance, ends[0], frame)
        masks.append(hd_epic.ObjectMask(_identifier(f"{track.track_id} middle"), frame, place, box, None))
    return dataclasses.replace(track, masks=tuple(masks[::-1] if is_reversed else masks))


def _box(performance: Performance, event: TrueEvent, frame: int) -> Float[np.ndarray, "4"]:
    """Return a box in the middle of the image, as large as the object appears from the eyes."""
    eye = interpolate(performance.times, performance.eye, performance.times[:1] + frame / hd_epic.FPS)[0]
    moving = next((each for each in performance.objects if each.object_id == event.object_id), None)
    half = 0.05 if moving is None else float(moving.half_extents.mean())
    pixels = half * hd_epic.FOCAL_LENGTH / max(float(np.linalg.norm(event.goal - eye)), 0.1)
    centre = hd_epic.IMAGE_SIZE / 2
    return np.round(np.array([centre - pixels, centre - pixels, centre + pixels, centre + pixels]), _PIXELS)


def _fixture(performance: Performance, goal: Float[np.ndarray, "3"]) -> str | None:
    """Return the piece of furniture whose top is nearest below."""
    furniture = [each for each in performance.objects if len(each.position) == 1]
    distances = [float(np.linalg.norm(each.position[0] - goal)) for each in furniture]
    if not distances or min(distances) > _FIXTURE_REACH:
        return None
    number = int(np.argmin(distances))
    return f"{performance.person.participant_id}_{furniture[number].category.replace(' ', '_')}.{number + 1:03d}"


def _first_look(performance: Performance, mask: hd_epic.ObjectMask, first: int) -> int:
    """Return the frame of the first look, or -1, or -2 for an event that is not tested."""
    assert mask.location is not None
    goal = transform_points(Y_UP_FROM_Z_UP, mask.location)
    row = _row(performance, mask.frame)
    towards = goal - performance.eye[row]
    if towards @ forward_of(performance.head_rotation[row]) < _IN_VIEW * np.linalg.norm(towards):
        return hd_epic.EXCLUDED
    for frame in range(first, mask.frame + 1):
        row = _row(performance, frame)
        towards = goal - performance.eye[row]
        along = float(towards @ performance.gaze[row])
        if along > 0 and float(np.linalg.norm(towards - along * performance.gaze[row])) <= _NEAR:
            return hd_epic.EXCLUDED if frame == first and mask.frame - first == _WINDOW else frame
    return hd_epic.NOT_PRIMED


def _row(performance: Performance, frame: int) -> int:
    """Return the row of the performance nearest to a video frame."""
    return min(round(frame / hd_epic.FPS * performance.rate), len(performance.times) - 1)


def known_events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return the events as HD-EPIC can know them: places are points, gaze comes ten times a second.

    People annotate what is lifted and put down again: no doors and drawers, no touches, nothing that somebody else
    does, and no movement that the video does not see through.
    """
    ends = [event for movement in movements(performance) for event in movement]
    ends.sort(key=lambda event: event.event_time)
    return tuple(seen_again(each, performance, each.goal, each.goal, gaze_period=_GAZE_PERIOD) for each in ends)


_SLAM_ROLES = (mps.TRAJECTORY, mps.CALIBRATION, mps.SLAM_SUMMARY)
_GAZE_ROLES = (mps.GAZE, mps.GAZE_SUMMARY, mps.WRISTS, mps.HAND_SUMMARY)
_UNORDERED = 8  # one in so many objects lists its tracks backwards
_COMPRESSION = 1
_CREATED = (2000, 1, 1, 0, 0, 0)  # of every entry of an archive: the time of writing would change its bytes


def slam_number(video: str) -> str:
    """Return the number of the SLAM archive that holds a synthetic video: its own, at the end of its name."""
    return str(int(video.rpartition("_")[2]))


def _write_video(readings: hd_epic.HdEpicReadings, data: Path) -> None:
    """Write the files of one video below the folder ``HD-EPIC``.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    assert readings.glasses is not None, "synthetic people wear them"
    own = data / hd_epic.VIDEOS_FOLDER / readings.participant_id
    times = readings.clock.device_ns
    columns = {
        hd_epic.MP4_TIME: np.arange(len(times)) * 1e9 / hd_epic.FPS,
        hd_epic.RELATIVE_TIME: times - times[0],
        hd_epic.DEVICE_TIME: times,
    }
    write_csv(own / f"{readings.video}{hd_epic.TIME_SUFFIX}", columns)
    first, last = int(times[0]), int(times[-1])
    log = {"num_mp4_frames": len(times), "down_sampling_factor_": 1}
    log |= {"num_skipped_frames": int((np.diff(times) > 1.5e9 / hd_epic.FPS).sum())}
    log |= {"num_duplicated_frames_": readings.clock.repeats, "num_invalid_frames_": 0}
    log |= {"first_video_timestamp_ns": first, "end_video_timestamp_ns": last, "video_duration_ns": last - first}
    write_json(own / f"{readings.video}{hd_epic.LOG_SUFFIX}", log)
    base = data / hd_epic.MPS_FOLDER / readings.participant_id
    number = slam_number(readings.video)
    _write_archive(base / hd_epic.MULTI_SLAM_FOLDER / f"{number}.zip", number, readings.glasses, _SLAM_ROLES)
    name = f"mps_{readings.video}_vrs"
    _write_archive(base / hd_epic.GAZE_FOLDER / f"{name}.zip", name, readings.glasses, _GAZE_ROLES)


def _write_archive(path: Path, folder: str, readings: mps.MpsReadings, roles: Collection[str]) -> None:
    """Write MPS files into a zip archive; equal contents give equal bytes."""
    with tempfile.TemporaryDirectory() as unpacked:
        write_mps(readings, Path(unpacked), only=roles)
        with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for file in sorted(each for each in Path(unpacked).rglob("*") if each.is_file()):
                entry = zipfile.ZipInfo(f"{folder}/{file.relative_to(unpacked).as_posix()}", _CREATED)
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, file.read_bytes(), compresslevel=_COMPRESSION)


def _share(readings: hd_epic.HdEpicReadings) -> dict[str, object]:
    """Return the entries that one video adds to the annotations."""
    objects: dict[str, dict[str, object]] = {}
    for side in readings.priming or ():
        number, _, name = side.key.partition("/")
        primed = side.frame_primed >= 0
        objects.setdefault(number, {})[name] = {
            "frame": side.frame,
            "3d_location": [] if side.location is None else side.location.tolist(),
            "prime_stats": {
                "prime_window_start": max(side.frame - 300, 0),
                "frame_primed": side.frame_primed,
                "gaze_point": side.location.tolist() if primed and side.location is not None else [],
                "dist_to_cam": -1,
                "prime_gap": (side.frame - side.frame_primed) / hd_epic.FPS if primed else -1,
            },
        }
    tracks: dict[str, list[hd_epic.ObjectTrack]] = {}
    for track in readings.tracks:
        tracks.setdefault(track.object_id, []).append(track)
    associations = {}
    for key, own in tracks.items():
        listed = [
            {
                "track_id": track.track_id,
                "time_segment": [track.start, track.end],
                "masks": [mask.mask_id for mask in track.masks],
            }
            for track in (own[::-1] if hashlib.sha256(key.encode()).digest()[0] % _UNORDERED == 0 else own)
        ]
        associations[key] = {"name": own[0].name, "tracks": listed}
    masks = {
        mask.mask_id: {
            "frame_number": mask.frame,
            "3d_location": None if mask.location is None else mask.location.tolist(),
            "bbox": None if mask.box_px is None else mask.box_px.tolist(),
            "fixture": mask.fixture or hd_epic.NO_FIXTURE,
        }
        for track in readings.tracks
        for mask in track.masks
    }
    names = {"video": readings.video, "participant": readings.participant_id}
    return {**names, "associations": associations, "masks": masks, "priming": objects}


def _to_recording(readings: SensedVideo, manifest: Manifest, *, dataset: str) -> Recording:
    """Return the streams of one synthetic video, thinned as its reader thins them."""
    video = readings.readings
    bodies = body_from_outputs(readings.bodies, egoallo.synthetic_smplh())
    assert video.glasses is not None, "synthetic people wear them"
    seen = dataclasses.replace(video, glasses=mps.thinned(video.glasses), body=bodies)
    return recording_from_hd_epic(seen, manifest, dataset=dataset)


def _write_below(readings: SensedVideo, root: Path) -> None:
    """Write archives and time file of one video, its bodies, and its share of the annotations."""
    _write_video(readings.readings, root / hd_epic.DATA_FOLDER)
    video = readings.readings.video
    egoallo.write_outputs(readings.bodies, root / ego.POSES_FOLDER / video / ego.OUTPUT_FOLDER)
    write_json(root / SHARED_PARTS / f"{video}.json", _share(readings.readings))


def _finish(root: Path) -> None:
    """Write annotations and SLAM maps of all videos, and the synthetic body model."""
    parts = [json.loads(path.read_bytes()) for path in sorted((root / SHARED_PARTS).glob("*.json"))]
    annotations = root / hd_epic.ANNOTATIONS_FOLDER
    movements = annotations / hd_epic.MOVEMENTS_FOLDER
    for path, key in (
        (movements / hd_epic.ASSOCIATIONS_FILE, "associations"),
        (movements / hd_epic.MASKS_FILE, "masks"),
        (annotations / hd_epic.PRIMING_FOLDERS[0] / hd_epic.PRIMING_FILE, "priming"),
    ):
        write_json(path, {part["video"]: part[key] for part in parts})
    for participant in {part["participant"] for part in parts}:
        videos = [part["video"] for part in parts if part["participant"] == participant]
        numbers = {f"{participant}/{video}.vrs": slam_number(video) for video in videos}
        multi = root / hd_epic.DATA_FOLDER / hd_epic.MPS_FOLDER / participant / hd_epic.MULTI_SLAM_FOLDER
        write_json(multi / hd_epic.SLAM_MAP_FILE, numbers)
    egoallo.write_smplh_model(root / ego.MODEL_FILE)


LAYOUT = Layout(
    dataset="hd-epic",
    sense=sense,
    to_recording=_to_recording,
    write=_write_below,
    finish=_finish,
    events=known_events,
    clock_start=lambda performance: device_start_us(performance) / 1e6,
    object_id=association_id,
    gaze_bias=GAZE_BIAS[_GAZE_KIND],
)
