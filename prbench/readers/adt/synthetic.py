"""Native files of Aria Digital Twin (docs/specification/adt.md): layout v2.0, and v1.x for tests of the reader."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from prbench.files.storage import atomic_folder, write_bytes, write_json
from prbench.readers.adt import format as adt
from prbench.readers.adt import synthetic_sensors as sensors
from prbench.readers.adt.for_egoallo import prepared_trajectory
from prbench.readers.adt.to_recording import recording_from_adt
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.synthetic import split_columns, write_csv
from prbench.readers.aria_mps.synthetic_sensors import gaze_bias
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.synthetic import sense_egoallo, write_outputs, write_smplh_model
from prbench.synthetic.layouts import Layout
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Switches, device_start_us

_GRAPH_UID = "00000000-0000-0000-0000-000000000000"
_GRAVITY = (0.0, -9.81, 0.0)
_UNUSED_VELOCITIES = tuple(
    f"{quantity}_{axis}_device" for quantity in ("device_linear_velocity", "angular_velocity") for axis in "xyz"
)
_CREATED = "01/01/2000-00:00:00"
_QUATERNION_SCALAR_LAST = (1, 2, 3, 0)


def estimated_outputs(
    performance: Performance, readings: adt.AdtReadings, *, noise: float = 1.0, switches: Switches | None = None
) -> tuple[ego.EgoAlloOutput, ...]:
    """Return what EgoAllo would make of the glasses of one recording, in the scene turned to Z up."""
    return sense_egoallo(
        performance,
        prepared_trajectory(readings.glasses),
        noise=noise,
        switches=switches,
        start_us=device_start_us(performance),
        size=sensors.GLASSES_SIZE,
        native_from_world=adt.Z_UP_FROM_SCENE,
    )


def write(readings: adt.AdtReadings, folder: Path) -> None:
    """Write one recording in layout v2.0: one flat folder, complete or not at all.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    with atomic_folder(folder) as target:
        write_json(
            target / adt.METADATA_FILE,
            {
                **_scene_metadata(readings),
                "serial": readings.serial,
                "concurrent_sequence": readings.concurrent,
                "dataset_version": "2.0",
            },
        )
        _write_device_files(readings, target, adt.ASSOCIATION_FILE)


def write_v1(tours: Mapping[str, adt.AdtReadings], folder: Path, *, version: str = "1.1") -> None:
    """Write concurrent recordings in layout v1.x: a sequence with one sub-folder a pair of glasses.

    Args:
        tours: Recordings by name of their sub-folder.
        folder: The sequence.
        version: ``1.0`` uses the older file names and, as the release did, states no version.
    """
    old = version == adt.FIRST_VERSION
    with atomic_folder(folder) as target:
        subtours = {
            str(number): {"subtour_name": name, "device_serial": tour.serial}
            for number, (name, tour) in enumerate(tours.items())
        }
        metadata = {**_scene_metadata(*tours.values()), "subtours": subtours}
        name = adt.METADATA_FILE_BEFORE_1_1 if old else adt.METADATA_FILE
        write_json(target / name, metadata if old else {**metadata, "dataset_version": version})
        for name, tour in tours.items():
            (target / name).mkdir()
            association = adt.ASSOCIATION_FILE_BEFORE_1_1 if old else adt.ASSOCIATION_FILE
            _write_device_files(tour, target / name, association)


def _scene_metadata(*readings: adt.AdtReadings) -> dict[str, object]:
    return {
        "gt_creation_time": _CREATED,
        "scene": "Synthetic",
        "is_multi_person": len(readings[0].skeletons) > 1,
        "num_skeletons": len(readings[0].skeletons),
        "timecode_enabled": 0,
        "gt_time_domain": adt.TIME_DOMAIN,
        "dataset_name": "ADT_2023",
    }


def _write_device_files(readings: adt.AdtReadings, folder: Path, association_file: str) -> None:
    write_json(folder / adt.INSTANCES_FILE, _instances(readings))
    write_csv(folder / adt.TRAJECTORY_FILE, _trajectory_columns(readings.glasses))
    write_csv(folder / adt.GAZE_FILE, _gaze_columns(readings.gaze))
    write_csv(folder / adt.BOXES_FILE, _box_columns(readings.objects))
    write_csv(folder / adt.OBJECTS_FILE, _object_columns(readings.objects))
    people = [
        {"AssociatedDeviceSerial": person.serial, "SkeletonId": person.skeleton_id, "SkeletonName": person.name}
        for person in readings.skeletons
    ]
    write_json(folder / association_file, {"SkeletonMetadata": people})
    for person in readings.skeletons:
        _write_skeleton(folder / f"{person.name}.json", person)


def _trajectory_columns(glasses: adt.GlassesPoses) -> dict[str, object]:
    n = len(glasses.time_us)
    rotation = [mps.ROTATION_COLUMNS[index] for index in _QUATERNION_SCALAR_LAST]
    return {
        mps.GRAPH_COLUMN: [_GRAPH_UID] * n,
        mps.TIME_COLUMN: glasses.time_us,
        "utc_timestamp_ns": np.full(n, -1),
        **split_columns(mps.POSITION_COLUMNS, glasses.position),
        **split_columns(rotation, glasses.rotation[:, list(_QUATERNION_SCALAR_LAST)]),
        **{name: np.zeros(n) for name in _UNUSED_VELOCITIES},
        **split_columns(mps.GRAVITY_COLUMNS, np.tile(_GRAVITY, (n, 1))),
        mps.QUALITY_COLUMN: glasses.quality,
    }


def _gaze_columns(gaze: adt.GazeAngles) -> dict[str, object]:
    yaw_low, yaw_high = gaze.yaw_range.T
    pitch_low, pitch_high = gaze.pitch_range.T
    return {
        mps.TIME_COLUMN: gaze.time_us,
        mps.YAW: gaze.yaw,
        mps.PITCH: gaze.pitch,
        mps.DEPTH: gaze.depth,
        mps.YAW_RANGE[0]: yaw_low,
        mps.PITCH_RANGE[0]: pitch_low,
        mps.YAW_RANGE[1]: yaw_high,
        mps.PITCH_RANGE[1]: pitch_high,
    }


def _box_columns(objects: Sequence[adt.AdtObject]) -> dict[str, object]:
    lower, upper = (np.stack([getattr(entry, side) for entry in objects]) for side in ("box_min", "box_max"))
    columns: dict[str, object] = {
        adt.OBJECT_ID: np.array([entry.object_id for entry in objects]),
        adt.OBJECT_TIME: np.full(len(objects), adt.STATIC_TIME),
    }
    for axis in range(3):
        columns |= {adt.BOX_MIN[axis]: lower[:, axis], adt.BOX_MAX[axis]: upper[:, axis]}
    return columns


def _object_columns(objects: Sequence[adt.AdtObject]) -> dict[str, object]:
    times = np.concatenate([entry.time_ns for entry in objects])
    ids = np.concatenate([np.full(len(entry.time_ns), entry.object_id) for entry in objects])
    order = np.argsort(times, kind="stable")
    position = np.concatenate([entry.position for entry in objects])[order]
    rotation = np.concatenate([entry.rotation for entry in objects])[order]
    return {
        adt.OBJECT_ID: ids[order],
        adt.OBJECT_TIME: times[order],
        **split_columns(adt.OBJECT_POSITION, position),
        **split_columns(adt.OBJECT_ROTATION, rotation),
    }


def _instances(readings: adt.AdtReadings) -> dict[str, dict[str, object]]:
    objects = {
        str(entry.object_id): _instance(
            entry.object_id, entry.name, entry.prototype, entry.category, dynamic=entry.dynamic, human=False
        )
        for entry in readings.objects
    }
    people = {
        str(person.skeleton_id): _instance(
            person.skeleton_id, person.name, "Skeleton", "person", dynamic=True, human=True
        )
        for person in readings.skeletons
    }
    return objects | people


def _instance(
    instance_id: int, name: str, prototype: str, category: str, *, dynamic: bool, human: bool
) -> dict[str, object]:
    return {
        "instance_id": instance_id,
        "instance_name": name,
        "prototype_name": prototype,
        "category": category,
        "category_uid": 0,
        "motion_type": "dynamic" if dynamic else "static",
        "instance_type": "human" if human else "object",
        "rigidity": "deformable" if human else "rigid",
        "rotational_symmetry": {"is_annotated": False},
        "canonical_pose": {"up_vector": [0, 1, 0], "front_vector": [0, 0, 1]},
    }


def _write_skeleton(path: Path, person: adt.AdtSkeleton) -> None:
    joints = person.joints.tolist()
    markers = np.zeros((len(joints), adt.N_MARKERS, 3)) if person.markers is None else person.markers
    frames = [
        {"markers": frame_markers, "joints": frame_joints, "timestamp_ns": time}
        for frame_markers, frame_joints, time in zip(markers.tolist(), joints, person.time_ns.tolist(), strict=True)
    ]
    content = {"dt_optitrack_minus_device_ns": {person.serial: 0}, "frames": frames}
    write_bytes(path, msgspec.json.encode(content))


def _write_estimates(performance: Performance, readings: adt.AdtReadings, root: Path, *, noise: float = 1.0) -> None:
    """Write bodies as EgoAllo estimates them from the glasses, and the body model that reading them needs."""
    outputs = estimated_outputs(performance, readings, noise=noise)
    write_outputs(outputs, root / ego.POSES_FOLDER / readings.recording_id / ego.OUTPUT_FOLDER)
    if not (root / ego.MODEL_FILE).is_file():
        write_smplh_model(root / ego.MODEL_FILE)


LAYOUT = Layout(
    dataset="adt",
    sense=sensors.sense,
    to_recording=recording_from_adt,
    write=lambda readings, root: write(readings, root / readings.recording_id),
    events=lambda performance: performance.events,
    clock_start=lambda performance: device_start_us(performance) / 1e6,
    object_id=lambda object_id: str(sensors.native_object_id(object_id)),
    gaze_bias=gaze_bias,
    write_estimates=_write_estimates,
)
