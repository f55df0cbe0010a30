"""Native files of HD-EPIC (docs/specification/hd-epic.md): archives by video, annotations for all videos together."""

from __future__ import annotations

import dataclasses
import hashlib
import tempfile
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from prbench.files.storage import atomic_path, write_json
from prbench.protocol.manifests import Manifest
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.synthetic import write_csv, write_mps
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.synthetic import write_outputs, write_smplh_model
from prbench.readers.egoallo.synthetic_smplh import synthetic_smplh
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic import synthetic_sensors as sensors
from prbench.readers.hd_epic.to_recording import recording_from_hd_epic
from prbench.recording import Recording
from prbench.synthetic.layouts import SHARED_PARTS, Layout
from prbench.synthetic.sensors import device_start_us

_SLAM_ROLES = (mps.TRAJECTORY, mps.CALIBRATION, mps.SLAM_SUMMARY)
_GAZE_ROLES = (mps.GAZE, mps.GAZE_SUMMARY, mps.WRISTS, mps.HAND_SUMMARY)
_UNORDERED = 8  # one in so many objects lists its tracks backwards
_COMPRESSION = 1
_CREATED = (2000, 1, 1, 0, 0, 0)  # of every entry of an archive: the time of writing would change its bytes


class _Share(msgspec.Struct):
    """The entries that one video adds to the annotations."""

    video: str
    participant: str
    associations: dict[str, Any]
    masks: dict[str, Any]
    priming: dict[str, Any]


_SHARE = msgspec.json.Decoder(_Share)


def slam_number(video: str) -> str:
    """Return the number of the SLAM archive that holds a synthetic video: its own, at the end of its name."""
    return str(int(video.rpartition("_")[2]))


def _write_video(readings: hd_epic.HdEpicReadings, data: Path) -> None:
    """Write the files of one video below the folder ``HD-EPIC``.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    assert isinstance(readings.glasses, mps.MpsReadings)
    own = data / hd_epic.VIDEOS_FOLDER / readings.participant_id
    write_csv(own / f"{readings.video}{hd_epic.TIME_SUFFIX}", _time_columns(readings.clock))
    write_json(own / f"{readings.video}{hd_epic.LOG_SUFFIX}", _log(readings.clock))
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


def _time_columns(clock: hd_epic.VideoClock) -> dict[str, object]:
    return {
        hd_epic.MP4_TIME: np.arange(len(clock.device_ns)) * 1e9 / hd_epic.FPS,
        hd_epic.RELATIVE_TIME: clock.device_ns - clock.device_ns[0],
        hd_epic.DEVICE_TIME: clock.device_ns,
    }


def _log(clock: hd_epic.VideoClock) -> dict[str, int]:
    first = int(clock.device_ns[0])
    last = int(clock.device_ns[-1])
    skipped = int((np.diff(clock.device_ns) > 1.5e9 / hd_epic.FPS).sum())
    return {
        "num_mp4_frames": len(clock.device_ns),
        "down_sampling_factor_": 1,
        "num_skipped_frames": skipped,
        "num_duplicated_frames_": clock.repeats,
        "num_invalid_frames_": 0,
        "first_video_timestamp_ns": first,
        "end_video_timestamp_ns": last,
        "video_duration_ns": last - first,
    }


def _share(readings: hd_epic.HdEpicReadings) -> dict[str, object]:
    masks = {mask.mask_id: mask for track in readings.tracks for mask in track.masks}
    return {
        "video": readings.video,
        "participant": readings.participant_id,
        "associations": _associations(readings),
        "masks": {key: _mask(mask) for key, mask in masks.items()},
        "priming": _priming(readings.priming or ()),
    }


def _associations(readings: hd_epic.HdEpicReadings) -> dict[str, object]:
    objects: dict[str, list[hd_epic.ObjectTrack]] = {}
    for track in readings.tracks:
        objects.setdefault(track.object_id, []).append(track)
    return {
        key: {
            "name": tracks[0].name,
            "tracks": [
                {
                    "track_id": track.track_id,
                    "time_segment": [track.start, track.end],
                    "masks": [mask.mask_id for mask in track.masks],
                }
                for track in (tracks[::-1] if hashlib.sha256(key.encode()).digest()[0] % _UNORDERED == 0 else tracks)
            ],
        }
        for key, tracks in objects.items()
    }


def _mask(mask: hd_epic.ObjectMask) -> dict[str, object]:
    return {
        "frame_number": mask.frame,
        "3d_location": None if mask.location is None else mask.location.tolist(),
        "bbox": None if mask.box_px is None else mask.box_px.tolist(),
        "fixture": mask.fixture or hd_epic.NO_FIXTURE,
    }


def _priming(sides: Collection[hd_epic.PublishedSide]) -> dict[str, dict[str, object]]:
    objects: dict[str, dict[str, object]] = {}
    for side in sides:
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
    return objects


def _to_recording(readings: sensors.SensedVideo, manifest: Manifest, *, dataset: str) -> Recording:
    """Return the streams of one synthetic video, thinned as its reader thins them."""
    video = readings.readings
    assert isinstance(video.glasses, mps.MpsReadings)
    bodies = body_from_outputs(readings.bodies, synthetic_smplh())
    seen = dataclasses.replace(video, glasses=mps.thinned(video.glasses), body=bodies)
    return recording_from_hd_epic(seen, manifest, dataset=dataset)


def _write_below(readings: sensors.SensedVideo, root: Path) -> None:
    """Write archives and time file of one video, its bodies, and its share of the annotations."""
    _write_video(readings.readings, root / hd_epic.DATA_FOLDER)
    video = readings.readings.video
    write_outputs(readings.bodies, root / ego.POSES_FOLDER / video / ego.OUTPUT_FOLDER)
    write_json(root / SHARED_PARTS / f"{video}.json", _share(readings.readings))


def _finish(root: Path) -> None:
    """Write annotations and SLAM maps of all videos, and the synthetic body model."""
    parts = [_SHARE.decode(path.read_bytes()) for path in sorted((root / SHARED_PARTS).glob("*.json"))]
    annotations = root / hd_epic.ANNOTATIONS_FOLDER
    movements = annotations / hd_epic.MOVEMENTS_FOLDER
    write_json(movements / hd_epic.ASSOCIATIONS_FILE, {part.video: part.associations for part in parts})
    write_json(movements / hd_epic.MASKS_FILE, {part.video: part.masks for part in parts})
    priming = annotations / hd_epic.PRIMING_FOLDERS[0] / hd_epic.PRIMING_FILE
    write_json(priming, {part.video: part.priming for part in parts})
    for participant in {part.participant for part in parts}:
        numbers = {
            f"{participant}/{part.video}.vrs": slam_number(part.video)
            for part in parts
            if part.participant == participant
        }
        multi = root / hd_epic.DATA_FOLDER / hd_epic.MPS_FOLDER / participant / hd_epic.MULTI_SLAM_FOLDER
        write_json(multi / hd_epic.SLAM_MAP_FILE, numbers)
    write_smplh_model(root / ego.MODEL_FILE)


LAYOUT = Layout(
    dataset="hd-epic",
    sense=sensors.sense,
    to_recording=_to_recording,
    write=_write_below,
    finish=_finish,
    events=sensors.known_events,
    clock_start=lambda performance: device_start_us(performance) / 1e6,
    object_id=sensors.association_id,
    gaze_bias=sensors.gaze_bias,
)
