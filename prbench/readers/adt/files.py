"""Find and read the files of ADT recordings, one flat folder each (layout v2.0).

Sources: docs/specification/adt.md#files and docs/specification/adt.md#joints.
"""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.bounded import require
from prbench.limits import LARGEST_OBJECT
from prbench.readers import ReaderOptions, read_synthetic_tree
from prbench.readers import files as native
from prbench.readers.adt import format as adt
from prbench.readers.adt.to_recording import ASSUMED_SIZE, turned_to_z_up
from prbench.readers.aria_mps import files as aria
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.to_recording import part_poses
from prbench.readers.egoallo.bodies import read_bodies
from prbench.readers.egoallo.files import body_extent, find_outputs
from prbench.readers.extents import Extent, csv_extent, json_extent
from prbench.readers.found import RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.three_point import find_body
from prbench.recording import Recording, UnreadableEntry


class AdtOptions(ReaderOptions, frozen=True, kw_only=True):
    """Options of the reader of Aria Digital Twin.

    Attributes:
        poses: Source of bodies: the suit, EgoAllo's estimates (the study's table S1), or those of `prbench poses
            three-point`, for which the suit's wrists stand in for devices. Hands stay the suit's.
        smplh_model: The licensed body model that EgoAllo's outputs need (``model.npz``).
        poses_root: Folder of EgoAllo's outputs by recording; beside the recordings by default.
    """

    poses: Literal["native", "egoallo", "three-point"] = "native"
    smplh_model: Path | None = None
    poses_root: Path | None = None


# Roles of the files of a recording; a skeleton's is SKELETON_PREFIX and the skeleton's name.
METADATA = "metadata"
INSTANCES = "instances"
OBJECTS = "objects"
BOXES = "boxes"
TRAJECTORY = "trajectory"
GAZE = "gaze"
ASSOCIATION = "association"
CALIBRATION = "calibration"
SKELETON_PREFIX = "skeleton:"
_FILES = {
    METADATA: adt.METADATA_FILE,
    INSTANCES: adt.INSTANCES_FILE,
    OBJECTS: adt.OBJECTS_FILE,
    BOXES: adt.BOXES_FILE,
    TRAJECTORY: adt.TRAJECTORY_FILE,
    GAZE: adt.GAZE_FILE,
    ASSOCIATION: adt.ASSOCIATION_FILE,
}
_OWN_ROLES = (TRAJECTORY, OBJECTS, BOXES, ASSOCIATION)  # Roles of files whose names no other dataset has.


class Metadata(msgspec.Struct):
    """``metadata.json``.

    Attributes:
        gt_time_domain: Checked when the recording is read.
        serial: Serial number of the glasses.
        headset: None: only HOT3D's metadata names it.
        subtours: Named by the layout v1.x alone.
    """

    gt_time_domain: str | None = None
    serial: str | None = None
    headset: str | None = None
    concurrent_sequence: str | None = None
    subtours: Any = None


_DEFAULTS = AdtOptions()


def find_recordings(root: Path | str, options: AdtOptions = _DEFAULTS) -> tuple[RecordingFiles, ...]:
    """List the recordings of an ADT folder: the dataset's, or a single recording.

    Raises:
        InputFileError: if ``root`` holds none, saying what was looked for and what was found. Damaged metadata are
            reported when the recording is read, not here.
    """
    root = existing_folder(root, "a folder of ADT recordings")
    dataset = "adt" if read_synthetic_tree(root) is None else f"{SYNTHETIC_PREFIX}adt"
    folders = [root] if _is_recording(root) else sorted(path for path in root.iterdir() if path.is_dir())
    recordings = []
    for folder in folders:
        if not _is_recording(folder):
            continue
        places = {role: folder / name for role, name in _FILES.items()}
        if not is_present(places[GAZE]):
            places[GAZE] = aria.find_gaze_file(folder / adt.MPS_FOLDER / "eye_gaze") or places[GAZE]
        places[CALIBRATION] = folder / adt.MPS_FOLDER / "slam" / mps.CALIBRATION_FILE
        places |= {f"{SKELETON_PREFIX}{path.stem}": path for path in sorted(folder.glob("Skeleton_*.json"))}
        files = [input_file(role, path) for role, path in places.items() if is_present(path)]
        if options.poses == "egoallo":
            files += find_outputs(root, folder, folder.name, options.poses_root, smplh_model=options.smplh_model)
        files += find_body(root, folder.name)
        recordings.append(RecordingFiles(dataset, folder.name, folder, tuple(files)))
    expected = f"recordings of ADT: folders that hold {adt.METADATA_FILE}"
    remedy = "Give the folder whose sub-folders are the recordings, or one recording."
    require(root, (recordings, "", expected, names_in(root), remedy))
    return tuple(recordings)


def _is_recording(folder: Path) -> bool:
    """Return True for a recording, also one that lacks its metadata or has damaged ones: reading it says so."""
    path = folder / adt.METADATA_FILE
    if not path.is_file():
        return any((folder / _FILES[role]).is_file() for role in _OWN_ROLES)
    try:
        # HOT3D's metadata have the same name and tell the kind of headset.
        return native.decode_json(path, Metadata).headset is None
    except InputFileError:
        return True


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """Return the streams of one recording, on the device clock.

    Glasses and objects come from one tracking system, and tell how long there is ground truth. Gaze and the suit run
    longer; the suit may begin late.
    """
    streams = []
    for file in found.files:
        if file.role == TRAJECTORY:
            streams.append(csv_extent("glasses", file, mps.TIME_COLUMN, 1e-6))
        elif file.role == OBJECTS:
            streams.append(csv_extent("objects", file, mps.OBJECT_TIME, 1e-9))
        elif file.role == GAZE:
            streams.append(replace(csv_extent("gaze", file, mps.TIME_COLUMN, 1e-6), tells_span=False))
        elif file.role.startswith(SKELETON_PREFIX):
            streams.append(replace(json_extent("body", file), tells_span=False, may_start_late=True))
    return (*streams, *body_extent(found))


class _Instance(msgspec.Struct):
    """One entry of ``instances.json``; ids have up to 16 digits and stay integers."""

    instance_id: int
    instance_name: str
    prototype_name: str
    category: str
    motion_type: str
    instance_type: str


class _Association(msgspec.Struct):
    """One tracked person and the glasses that the person wears; ``NONE`` stands for nobody."""

    serial: str = msgspec.field(name="AssociatedDeviceSerial")
    skeleton_id: int | str = msgspec.field(name="SkeletonId")
    name: str = msgspec.field(name="SkeletonName")


class _Associations(msgspec.Struct):
    people: list[msgspec.Raw] = msgspec.field(name="SkeletonMetadata")


class _Frame(msgspec.Struct):
    joints: msgspec.Raw
    timestamp_ns: native.Nanoseconds


class _SkeletonFile(msgspec.Struct):
    frames: list[msgspec.Raw]


_FRAME = msgspec.json.Decoder(_Frame)
_WIDTH = 3 * adt.N_NATIVE_JOINTS
_NUMBERS = re.compile(rb"[-+.,0-9eEnul]*")  # null stands for NaN


def read_objects(
    instances_path: Path, boxes_path: Path, poses_path: Path
) -> tuple[tuple[adt.AdtObject, ...], tuple[str, ...], list[UnreadableEntry]]:
    """Read all objects that have a name, a box and a pose, by id; people are no objects.

    Returns:
        The objects, remarks on those that lack one of the three, and the entries that cannot be read.

    Raises:
        InputFileError: for a missing or damaged file, a pose that is no pose, or a clock that runs backwards.
    """
    expected = "an object with its instance_id, names, category, motion_type and instance_type"
    named = native.decode_json(instances_path, dict[str, msgspec.Raw])
    entries, unreadable = native.read_entries(instances_path, named, msgspec.json.Decoder(_Instance).decode, expected)
    instances: dict[int, _Instance] = {}
    for key, instance in entries.items():
        if instances.setdefault(instance.instance_id, instance) is not instance:
            found = f"{instance.instance_id} again"
            unreadable.append(UnreadableEntry(instances_path.name, key, "an instance_id of its own", found))
    columns = (mps.OBJECT_ID, *adt.BOX_MIN, *adt.BOX_MAX)
    table = native.read_columns(boxes_path, dict.fromkeys(columns, str))
    rows = zip(*(table[name].to_pylist() for name in columns), strict=True)
    lines = {f"line {number}": row for number, row in enumerate(rows, start=2)}
    listed, odd = native.read_entries(boxes_path, lines, _box, "an id, and a lower and an upper corner in metres")
    boxes = dict(listed.values())
    unreadable += odd
    known = {key for key, instance in instances.items() if instance.instance_type != "human"}
    poses = aria.read_poses_by_body(poses_path, int, static_time=adt.STATIC_TIME)
    complete = sorted(known & boxes.keys() & poses.keys())
    objects = []
    for key in complete:
        about = instances[key]
        names = (about.instance_name, about.prototype_name, about.category)
        low, high = boxes[key]
        objects.append(adt.AdtObject(key, *names, about.motion_type == "dynamic", low, high, *poses[key]))
    incomplete = sorted((known | boxes.keys() | poses.keys()) - set(complete) - (instances.keys() - known))
    if not incomplete:
        return tuple(objects), (), unreadable
    named = ", ".join(str(key) for key in incomplete[:5]) + (" …" if len(incomplete) > 5 else "")
    return tuple(objects), (f"{len(incomplete)} objects without name, box or pose are left out: {named}",), unreadable


def _box(cells: tuple[str, ...]) -> tuple[int, Float[np.ndarray, "2 3"]]:
    """Return an object's id, and the lower and upper corner of its box in its own frame, metres."""
    corners = np.array([float(cell) for cell in cells[1:]]).reshape(2, 3)
    if not ((np.abs(corners) <= LARGEST_OBJECT).all() and (corners[0] <= corners[1]).all()):
        raise ValueError(f"{corners[0].tolist()} … {corners[1].tolist()}")
    return int(cells[0]), corners


def read_skeletons(found: RecordingFiles) -> tuple[tuple[adt.AdtSkeleton, ...], list[UnreadableEntry]]:
    """Read every tracked person of a recording; none where it has no association file.

    Returns:
        The people, and the entries of the files that cannot be read.

    Raises:
        InputFileError: if the association or a skeleton's file is missing or damaged, or a skeleton has other joints
            than the 51.
    """
    people, unreadable = associated_people(found)
    skeletons = []
    names = [str(column) for column in range(_WIDTH)]
    for person, path in people:
        listed = enumerate(native.decode_json(path, _SkeletonFile).frames)
        expected = f"a time, and the known skeleton of {adt.N_NATIVE_JOINTS} joints with three coordinates"
        frames, odd = native.read_entries(path, {f"frame {number}": raw for number, raw in listed}, _frame, expected)
        told = native.told_together(odd)
        unreadable += told
        remedy = f"Download the recording again, or remove {person.name} from the association file."
        require(path, (len(frames) > 0, "frames", f"frames of a body: {expected}", told[0] if told else "none", remedy))
        times = np.array([time for time, _ in frames.values()], dtype=np.int64)
        native.require_increasing(path, times, unit="ns", place="frame", first=0)
        rows = [row for _, row in frames.values()]
        try:
            table = pyarrow.csv.read_csv(
                io.BytesIO(b"\n".join(rows)),
                read_options=pyarrow.csv.ReadOptions(column_names=names, block_size=1 << 22),
                convert_options=pyarrow.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64())),
            )
        except pa.ArrowInvalid as error:
            found_text = str(error).splitlines()[0]
            remedy = "Download the file again."
            raise InputFileError(path, "joints", expected="numbers", found=found_text, remedy=remedy) from error
        joints = np.column_stack([table[name].to_numpy() for name in names]).reshape(-1, adt.N_NATIVE_JOINTS, 3)
        skeleton_id = person.skeleton_id if isinstance(person.skeleton_id, int) else -1
        skeletons.append(adt.AdtSkeleton(person.name, skeleton_id, person.serial, times, joints))
    return tuple(skeletons), unreadable


def associated_people(found: RecordingFiles) -> tuple[list[tuple[_Association, Path]], list[UnreadableEntry]]:
    """Return the people whom the association file names, each with the skeleton's file, and its unreadable entries.

    Raises:
        InputFileError: if the association is damaged, or the file of a skeleton is missing.
    """
    association = found.path(ASSOCIATION)
    if association is None:
        return [], []
    listed = enumerate(native.decode_json(association, _Associations).people)
    entries = {f"SkeletonMetadata[{number}]": raw for number, raw in listed}
    expected = "a person with AssociatedDeviceSerial, SkeletonId and SkeletonName"
    people, unreadable = native.read_entries(association, entries, msgspec.json.Decoder(_Association).decode, expected)
    named = [person for person in people.values() if person.name != adt.NOBODY]
    paths = [found.require(f"{SKELETON_PREFIX}{person.name}", f"{person.name}.json") for person in named]
    return list(zip(named, paths, strict=True)), unreadable


def _frame(raw: msgspec.Raw) -> tuple[int, bytes]:
    """Return the time of a frame, and its numbers as a line of comma-separated values, which are parsed fast."""
    frame = _FRAME.decode(raw)
    row = bytes(frame.joints).translate(None, b"[] \t\r\n")
    count = row.count(b",") + bool(row)
    if count != _WIDTH or not _NUMBERS.fullmatch(row):
        raise ValueError(f"{count} numbers instead of {_WIDTH}" if count != _WIDTH else "words among the numbers")
    return frame.timestamp_ns, row


_BEHIND = np.pi / 2  # radians; no eye looks there
_TOO_MANY = 0.2  # share of rows


def read_readings(found: RecordingFiles, options: AdtOptions = _DEFAULTS) -> adt.AdtReadings:
    """Read all that curation needs of one recording.

    Raises:
        InputFileError: for a missing or damaged file, an unknown time domain, or a scene that is not Y up.
    """
    path = found.require(METADATA, adt.METADATA_FILE)
    metadata = native.decode_json(path, Metadata)
    remedy = "Download the sequence again: its present release has one flat folder a recording."
    require(path, (metadata.subtours is None, "subtours", "layout v2.0", "layout v1.x", remedy))
    expected = f"'{adt.TIME_DOMAIN}' (the device clock)"
    remedy = "Times on another clock would not meet gaze and poses; use a release on the device clock."
    seen = f"'{metadata.gt_time_domain}'" if metadata.gt_time_domain else "nothing"
    require(path, (metadata.gt_time_domain == adt.TIME_DOMAIN, "gt_time_domain", expected, seen, remedy))
    concurrent = metadata.concurrent_sequence or ""
    paths = (found.require(role, _FILES[role]) for role in (INSTANCES, BOXES, OBJECTS))
    objects, remarks, unreadable = read_objects(*paths)
    size, device_from_rgb = aria.read_size_and_camera(found.path(CALIBRATION))
    path = found.require(TRAJECTORY, adt.TRAJECTORY_FILE)
    trajectory = aria.read_trajectory(path)
    remedy = "This looks like a native MPS trajectory; use the recording's own aria_trajectory.csv."
    aria.require_up(path, trajectory, adt.UP, within=1e-3, remedy=remedy)
    skeletons, odd = read_skeletons(found)
    body = None
    if options.poses == "egoallo":
        # The glasses' central pupil frame, which EgoAllo's outputs refer to.
        body = read_bodies(found, cpf=part_poses(turned_to_z_up(trajectory), mps.device_from_cpf(size or ASSUMED_SIZE)))
    names = (found.recording_id, metadata.serial or "", "" if concurrent.upper() == adt.NOBODY else concurrent)
    gaze = read_gaze(found.require(GAZE, adt.GAZE_FILE))
    told = ((*remarks, *trajectory.remarks), (*unreadable, *odd))
    return adt.AdtReadings(*names, size, device_from_rgb, trajectory, gaze, objects, skeletons, body, *told)


def read_gaze(path: Path) -> mps.GazeAngles:
    """Read a gaze file and refuse angles that are no radians.

    Raises:
        InputFileError: as :func:`read_gaze_angles`; or if many angles would look backwards.
    """
    gaze = aria.read_gaze_angles(path)
    largest = np.maximum(np.abs(gaze.yaw), np.abs(gaze.pitch))
    known = largest[np.isfinite(largest)]
    if len(known) and (known > _BEHIND).mean() > _TOO_MANY:
        expected = "angles in radians, below 1.57"
        found = f"angles up to {known.max():.1f} in {int((known > _BEHIND).sum())} of {len(known)} rows"
        remedy = "They look like degrees; use the file as it was released."
        raise InputFileError(path, "yaw and pitch", expected=expected, found=found, remedy=remedy)
    return gaze
