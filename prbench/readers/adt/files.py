"""Find and read the files of ADT recordings: one flat folder each (v2.0), or one sub-folder a device (v1.x).

Sources: docs/specification/adt.md#files and docs/specification/adt.md#joints.
"""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input
from prbench.files.storage import inside
from prbench.readers import ReaderOptions, read_synthetic_tree
from prbench.readers.adt import format as adt
from prbench.readers.adt.to_recording import glasses_z_up
from prbench.readers.aria_mps.files import (
    OnlineCalibration,
    find_gaze_file,
    read_first_calibration,
    read_gaze_angles,
    read_warnings,
)
from prbench.readers.aria_mps.format import (
    CALIBRATION_FILE,
    PERSONALIZED_GAZE_FILES,
    SUMMARY_FILE,
    TIME_COLUMN,
    GazeAngles,
)
from prbench.readers.aria_mps.trajectory import read_trajectory
from prbench.readers.egoallo.bodies import read_bodies
from prbench.readers.egoallo.files import body_extent, find_outputs
from prbench.readers.extents import Extent, csv_extent, json_extent
from prbench.readers.files import column_vectors, decode_json, read_columns, read_poses_by_body, require_increasing
from prbench.readers.found import InputFile, RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.recording import Recording


class AdtOptions(ReaderOptions, frozen=True, kw_only=True):
    """Options of the reader of Aria Digital Twin."""

    poses: Literal["native", "egoallo"] = "native"
    """Source of bodies: the suit, or EgoAllo's estimates (the study's table S1). Hands stay the suit's."""
    smplh_model: Path | None = None
    """The licensed body model that EgoAllo's outputs need (``model.npz``)."""
    poses_root: Path | None = None
    """Folder of EgoAllo's outputs by recording; beside the recordings by default."""
    gaze: Literal["release", "personalized"] = "release"
    """Source of gaze: the release's ``eyegaze.csv``, or the services' personalized one where a recording has it."""


METADATA = "metadata"
INSTANCES = "instances"
OBJECTS = "objects"
BOXES = "boxes"
TRAJECTORY = "trajectory"
GAZE = "gaze"
ASSOCIATION = "association"
CALIBRATION = "calibration"
GAZE_STATUS = "gaze status"
SLAM_STATUS = "slam status"
SKELETON_PREFIX = "skeleton:"
"""Roles of the files of a recording; a skeleton's is this and the skeleton's name."""
_FILES = {
    INSTANCES: (adt.INSTANCES_FILE,),
    OBJECTS: (adt.OBJECTS_FILE,),
    BOXES: (adt.BOXES_FILE,),
    TRAJECTORY: (adt.TRAJECTORY_FILE,),
    GAZE: (adt.GAZE_FILE,),
    ASSOCIATION: (adt.ASSOCIATION_FILE, adt.ASSOCIATION_FILE_BEFORE_1_1),
    CALIBRATION: (f"{adt.MPS_FOLDER}/slam/{CALIBRATION_FILE}", f"{adt.MPS_FOLDER}/trajectory/{CALIBRATION_FILE}"),
}
_OWN_FILES = (
    adt.TRAJECTORY_FILE,
    adt.OBJECTS_FILE,
    adt.BOXES_FILE,
    adt.ASSOCIATION_FILE,
    adt.ASSOCIATION_FILE_BEFORE_1_1,
)
"""Names that no other dataset has."""
_STATUS_OF = {GAZE: GAZE_STATUS, CALIBRATION: SLAM_STATUS}
"""Streams that the Machine Perception Services made, and the role of their status beside them."""


class _Subtour(msgspec.Struct):
    """One pair of glasses of a v1.x sequence, with its sub-folder."""

    subtour_name: str
    device_serial: str


class Metadata(msgspec.Struct):
    """``metadata.json`` of either layout."""

    gt_time_domain: str | None = None
    """Checked when the recording is read."""
    serial: str | None = None
    """Serial number of the glasses; absent in v1.x, where every subtour has its own."""
    headset: str | None = None
    """None: only HOT3D's metadata names it."""
    concurrent_sequence: str | None = None
    dataset_version: str = adt.FIRST_VERSION
    subtours: dict[str, _Subtour] | tuple[_Subtour, ...] | None = None

    def subtour_list(self) -> tuple[_Subtour, ...]:
        """The subtours of a v1.x sequence, by name; none in v2.0."""
        if self.subtours is None:
            return ()
        entries = self.subtours.values() if isinstance(self.subtours, dict) else self.subtours
        return tuple(sorted(entries, key=lambda entry: entry.subtour_name))

    def concurrent(self) -> str:
        """Name of the sequence that the other wearer recorded at the same time; empty where there is none."""
        name = self.concurrent_sequence or ""
        return "" if name.upper() == adt.NOBODY else name


METADATA_DECODER = msgspec.json.Decoder(Metadata)
_DEFAULTS = AdtOptions()


def find_recordings(root: Path | str, options: AdtOptions = _DEFAULTS) -> tuple[RecordingFiles, ...]:
    """List the recordings of an ADT folder: the dataset's, a v1.x sequence, or a single recording.

    Raises:
        InputFileError: if ``root`` holds none, saying what was looked for and what was found. Damaged metadata, and
            subtours that would lie outside of their sequence, are reported when the recording is read, not here.
    """
    root = existing_folder(root, "a folder of ADT recordings")
    synthetic = read_synthetic_tree(root) is not None
    folders = [root] if _is_recording(root) else sorted(path for path in root.iterdir() if path.is_dir())
    dataset = f"{SYNTHETIC_PREFIX}adt" if synthetic else "adt"
    found = [recording for folder in folders for recording in _recordings_in(folder, root, dataset, options)]
    if not found:
        raise InputFileError(
            root,
            "",
            expected=f"recordings of ADT: folders that hold {adt.METADATA_FILE} (or {adt.METADATA_FILE_BEFORE_1_1})",
            found=names_in(root),
            remedy="Give the folder whose sub-folders are the recordings, or one recording.",
        )
    return tuple(sorted(found, key=lambda recording: recording.recording_id))


def _is_recording(folder: Path) -> bool:
    """Return True for a recording or a v1.x sequence, also one that lacks its metadata: reading it says so."""
    metadata_path = _metadata_file(folder)
    if metadata_path is None:
        return any((folder / name).is_file() for name in _OWN_FILES)
    # HOT3D's metadata have the same name and tell the kind of headset.
    return _metadata(metadata_path).headset is None


def _metadata_file(folder: Path) -> Path | None:
    """The metadata of a sequence, under its present or its old name; None if there is none."""
    names = (adt.METADATA_FILE, adt.METADATA_FILE_BEFORE_1_1)
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _metadata(path: Path) -> Metadata:
    """Metadata of a sequence; empty where they are damaged: reading reports it, and no bad folder hides the others."""
    try:
        return decode_json(path, METADATA_DECODER)
    except InputFileError:
        return Metadata()


def _recordings_in(folder: Path, root: Path, dataset: str, options: AdtOptions) -> list[RecordingFiles]:
    if not _is_recording(folder):
        return []
    metadata_path = _metadata_file(folder)
    metadata = [] if metadata_path is None else [input_file(METADATA, metadata_path)]
    places = [] if metadata_path is None else _subtour_places(metadata_path)
    return [
        RecordingFiles(
            dataset,
            recording_id,
            place,
            (*metadata, *_input_files(place, options), *_estimated_bodies(root, place, recording_id, options)),
        )
        for recording_id, place in places or [(folder.name, folder)]
    ]


def _subtour_places(metadata_path: Path) -> list[tuple[str, Path]]:
    """Id and folder of each pair of glasses; none where a name leads out of the sequence, which reading reports."""
    folder = metadata_path.parent
    try:
        return [
            (subtour_id(folder.name, tour.subtour_name), subtour_folder(metadata_path, tour))
            for tour in _metadata(metadata_path).subtour_list()
        ]
    except InputFileError:
        return []


def subtour_id(sequence: str, subtour: str) -> str:
    """Recording id of one pair of glasses of a v1.x sequence."""
    return f"{sequence}_{subtour}"


@foreign_input()
def subtour_folder(metadata_path: Path, tour: _Subtour) -> Path:
    """Return the folder with the files of one pair of glasses.

    Raises:
        InputFileError: if its name leads out of the sequence, or cannot be the name of a folder.
    """
    return inside(metadata_path.parent, tour.subtour_name)


def _input_files(folder: Path, options: AdtOptions) -> list[InputFile]:
    files = []
    for role, names in _FILES.items():
        if role == GAZE and options.gaze == "personalized":
            names = (*(f"{adt.MPS_FOLDER}/eye_gaze/{name}" for name in PERSONALIZED_GAZE_FILES), *names)
        path = next((folder / name for name in names if is_present(folder / name)), None)
        if path is None and role == GAZE:
            path = find_gaze_file(folder / adt.MPS_FOLDER / "eye_gaze")
        if path is None:
            continue
        files.append(input_file(role, path))
        status = path.with_name(SUMMARY_FILE)
        if role in _STATUS_OF and path.parent != folder and is_present(status):
            files.append(input_file(_STATUS_OF[role], status))
    skeletons = sorted(folder.glob("Skeleton_*.json"))
    return files + [input_file(f"{SKELETON_PREFIX}{path.stem}", path) for path in skeletons]


def _estimated_bodies(root: Path, folder: Path, recording_id: str, options: AdtOptions) -> tuple[InputFile, ...]:
    if options.poses != "egoallo":
        return ()
    return find_outputs(root, folder, recording_id, options.poses_root, smplh_model=options.smplh_model)


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """The streams of one recording, on the device clock.

    Glasses and objects come from one tracking system, and tell how long there is ground truth. Gaze and the suit run
    longer; the suit may begin late.
    """
    streams = []
    for file in found.files:
        if file.role == TRAJECTORY:
            streams.append(csv_extent("glasses", file, TIME_COLUMN, 1e-6))
        elif file.role == OBJECTS:
            streams.append(csv_extent("objects", file, adt.OBJECT_TIME, 1e-9))
        elif file.role == GAZE:
            streams.append(replace(csv_extent("gaze", file, TIME_COLUMN, 1e-6), tells_span=False))
        elif file.role.startswith(SKELETON_PREFIX):
            streams.append(replace(json_extent("body", file), tells_span=False, may_start_late=True))
    return (*streams, *body_extent(found))


class Instance(msgspec.Struct):
    """One entry of ``instances.json``."""

    instance_id: int
    instance_name: str
    prototype_name: str
    category: str
    motion_type: str
    instance_type: str


_INSTANCES = msgspec.json.Decoder(dict[str, Instance])


def read_objects(
    instances_path: Path, boxes_path: Path, poses_path: Path
) -> tuple[tuple[adt.AdtObject, ...], tuple[str, ...]]:
    """All objects that have a name, a box and a pose, by id; people are no objects.

    Returns:
        The objects, and remarks on those that lack one of the three.

    Raises:
        InputFileError: for a missing or damaged file, a pose that is no pose, or a clock that runs backwards.
    """
    instances = read_instances(instances_path)
    # Lower and upper corner of each object's box in its own frame, metres.
    table = read_columns(boxes_path, {adt.OBJECT_ID: int, **dict.fromkeys((*adt.BOX_MIN, *adt.BOX_MAX), float)})
    lower = column_vectors(table, adt.BOX_MIN)
    upper = column_vectors(table, adt.BOX_MAX)
    bad = ~(np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        found = f"{lower[row].tolist()} … {upper[row].tolist()}"
        raise InputFileError(boxes_path, f"line {row + 2}", expected="a lower and an upper corner", found=found)
    boxes = dict(zip(table[adt.OBJECT_ID].to_pylist(), zip(lower, upper, strict=True), strict=True))
    known = {key for key, instance in instances.items() if instance.instance_type != "human"}
    poses = read_poses_by_body(
        poses_path,
        body={adt.OBJECT_ID: int},
        time=adt.OBJECT_TIME,
        position=adt.OBJECT_POSITION,
        rotation=adt.OBJECT_ROTATION,
        static_time=adt.STATIC_TIME,
    )
    complete = sorted(known & boxes.keys() & poses.keys())
    objects = tuple(
        adt.AdtObject(
            object_id=key,
            name=instances[key].instance_name,
            prototype=instances[key].prototype_name,
            category=instances[key].category,
            dynamic=instances[key].motion_type == "dynamic",
            box_min=boxes[key][0],
            box_max=boxes[key][1],
            time_ns=poses[key][0],
            position=poses[key][1],
            rotation=poses[key][2],
        )
        for key in complete
    )
    incomplete = sorted((known | boxes.keys() | poses.keys()) - set(complete) - (instances.keys() - known))
    if not incomplete:
        return objects, ()
    named = ", ".join(str(key) for key in incomplete[:5]) + (" …" if len(incomplete) > 5 else "")
    return objects, (f"{len(incomplete)} objects without name, box or pose are left out: {named}",)


def read_instances(path: Path) -> dict[int, Instance]:
    """Objects and people by id; ids have up to 16 digits and stay integers.

    Raises:
        InputFileError: if the file is missing, damaged or lacks a key.
    """
    return {instance.instance_id: instance for instance in decode_json(path, _INSTANCES).values()}


class _Association(msgspec.Struct):
    """One tracked person and the glasses that the person wears; ``NONE`` stands for nobody."""

    serial: str = msgspec.field(name="AssociatedDeviceSerial")
    skeleton_id: int | str = msgspec.field(name="SkeletonId")
    name: str = msgspec.field(name="SkeletonName")


class _Associations(msgspec.Struct):
    """The association file."""

    people: tuple[_Association, ...] = msgspec.field(name="SkeletonMetadata")


class _Frame(msgspec.Struct):
    joints: msgspec.Raw
    timestamp_ns: int


class _SkeletonFile(msgspec.Struct):
    frames: list[_Frame]


_ASSOCIATIONS = msgspec.json.Decoder(_Associations)
_SKELETON = msgspec.json.Decoder(_SkeletonFile)


def read_skeletons(found: RecordingFiles) -> tuple[adt.AdtSkeleton, ...]:
    """Every tracked person of a recording.

    Raises:
        InputFileError: if a skeleton's file is missing or damaged, or is not the skeleton of 51 joints.
    """
    return tuple(_read_skeleton(found, person) for person in _read_associations(found))


def _read_skeleton(found: RecordingFiles, person: _Association) -> adt.AdtSkeleton:
    path = found.require(f"{SKELETON_PREFIX}{person.name}", f"{person.name}.json")
    frames = decode_json(path, _SKELETON, nan_is_null=True).frames
    if not frames:
        raise InputFileError(
            path,
            "frames",
            expected="frames of a body",
            found="none",
            remedy=f"Download the recording again, or remove {person.name} from the association file.",
        )
    times = np.array([frame.timestamp_ns for frame in frames], dtype=np.int64)
    require_increasing(path, times, unit="ns", place="frame", first=0)
    skeleton_id = person.skeleton_id if isinstance(person.skeleton_id, int) else -1
    return adt.AdtSkeleton(person.name, skeleton_id, person.serial, times, _parse_joints(path, frames))


def _parse_joints(path: Path, frames: list[_Frame]) -> Float[np.ndarray, "n 51 3"]:
    rows = [bytes(frame.joints).translate(None, b"[] \t\r\n") for frame in frames]
    width = 3 * adt.N_NATIVE_JOINTS
    other = next((index for index, row in enumerate(rows) if row.count(b",") != width - 1), None)
    if other is not None:
        raise InputFileError(
            path,
            f"frame {other}, joints",
            expected=f"the known skeleton of {adt.N_NATIVE_JOINTS} joints with three coordinates",
            found=f"{rows[other].count(b',') + bool(rows[other])} numbers instead of {width}",
            remedy="The order of the joints is a constant of the format; another skeleton cannot be mapped.",
        )
    names = [str(column) for column in range(width)]
    try:
        table = pyarrow.csv.read_csv(
            io.BytesIO(b"\n".join(rows)),
            read_options=pyarrow.csv.ReadOptions(column_names=names, block_size=1 << 22),
            convert_options=pyarrow.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64())),
        )
    except pa.ArrowInvalid as error:
        raise InputFileError(
            path, "joints", expected="numbers", found=str(error).splitlines()[0], remedy="Download the file again."
        ) from error
    return np.column_stack([table[name].to_numpy() for name in names]).reshape(-1, adt.N_NATIVE_JOINTS, 3)


def _read_associations(found: RecordingFiles) -> tuple[_Association, ...]:
    """The tracked people of a recording; none where it has no association file.

    Raises:
        InputFileError: if the file is damaged.
    """
    path = found.path(ASSOCIATION)
    return () if path is None else tuple(p for p in decode_json(path, _ASSOCIATIONS).people if p.name != adt.NOBODY)


_BEHIND = np.pi / 2  # radians; no eye looks there
_TOO_MANY = 0.2  # share of rows


def read_readings(found: RecordingFiles, options: AdtOptions = _DEFAULTS) -> adt.AdtReadings:
    """Read all that curation needs of one recording.

    Raises:
        InputFileError: for a missing or damaged file, an unknown time domain, or a scene that is not Y up.
    """
    serial, concurrent = _read_identity(found)
    objects, remarks = read_objects(
        found.require(INSTANCES, adt.INSTANCES_FILE),
        found.require(BOXES, adt.BOXES_FILE),
        found.require(OBJECTS, adt.OBJECTS_FILE),
    )
    calibration, calibration_remarks = _read_calibration(found)
    path = found.require(TRAJECTORY, adt.TRAJECTORY_FILE)
    trajectory = read_trajectory(path)
    if np.linalg.norm(trajectory.up - np.array(adt.UP)) > 1e-3:
        raise InputFileError(
            path,
            "gravity columns",
            expected="gravity along -Y (ADT scenes are Y up)",
            found=f"up = {(np.round(trajectory.up, 3) + 0.0).tolist()}",
            remedy="This looks like a native MPS trajectory; use the recording's own aria_trajectory.csv.",
        )
    size = None if calibration is None else calibration.size
    return adt.AdtReadings(
        recording_id=found.recording_id,
        serial=serial,
        concurrent=concurrent,
        glasses_size=size,
        device_from_rgb=None if calibration is None else calibration.device_from_camera["camera-rgb"],
        glasses=trajectory,
        gaze=read_gaze(found.require(GAZE, adt.GAZE_FILE)),
        objects=objects,
        skeletons=read_skeletons(found),
        estimated_body=read_bodies(found, cpf=glasses_z_up(trajectory, size)) if options.poses == "egoallo" else None,
        messages=(*remarks, *trajectory.remarks, *calibration_remarks, *_gaze_warnings(found)),
    )


def _read_identity(found: RecordingFiles) -> tuple[str, str]:
    """Serial of the glasses, and the id of the concurrent recording (empty if there is none)."""
    path = found.require(METADATA, adt.METADATA_FILE)
    metadata = decode_json(path, METADATA_DECODER)
    tours = metadata.subtour_list()
    unnamed_before_2 = bool(tours) and metadata.gt_time_domain is None
    if metadata.gt_time_domain != adt.TIME_DOMAIN and not unnamed_before_2:
        raise InputFileError(
            path,
            "gt_time_domain",
            expected=f"'{adt.TIME_DOMAIN}' (the device clock)",
            found=f"'{metadata.gt_time_domain}'" if metadata.gt_time_domain else "nothing",
            remedy="Times on another clock would not meet gaze and poses; use a release on the device clock.",
        )
    if not tours:
        return metadata.serial or "", metadata.concurrent()
    for tour in tours:
        subtour_folder(path, tour)  # refused where the search found no recording of it
    own = next(tour for tour in tours if subtour_id(path.parent.name, tour.subtour_name) == found.recording_id)
    others = [tour for tour in tours if tour is not own]
    concurrent = min((subtour_id(path.parent.name, tour.subtour_name) for tour in others), default="")
    return own.device_serial, concurrent


def _read_calibration(found: RecordingFiles) -> tuple[OnlineCalibration | None, tuple[str, ...]]:
    """The optional calibration, and remarks; one whose own services call it an error is left aside."""
    path = found.path(CALIBRATION)
    status = found.path(SLAM_STATUS)
    if path is None:
        return None, ()
    try:
        remarks = () if status is None else read_warnings(status)
    except InputFileError as error:
        return None, (f"the online calibration is not used: {error}",)
    return read_first_calibration(path), remarks


def read_gaze(path: Path) -> GazeAngles:
    """Read a gaze file and refuse angles that are no radians.

    Raises:
        InputFileError: as :func:`read_gaze_angles`; or if many angles would look backwards.
    """
    gaze = read_gaze_angles(path)
    largest = np.maximum(np.abs(gaze.yaw), np.abs(gaze.pitch))
    known = largest[np.isfinite(largest)]
    if len(known) and (known > _BEHIND).mean() > _TOO_MANY:
        raise InputFileError(
            path,
            "yaw and pitch",
            expected="angles in radians, below 1.57",
            found=f"angles up to {known.max():.1f} in {int((known > _BEHIND).sum())} of {len(known)} rows",
            remedy="They look like degrees; use the file as it was released.",
        )
    return gaze


def _gaze_warnings(found: RecordingFiles) -> tuple[str, ...]:
    """Refuses gaze of the services that they call an error; gaze of the release itself has no such status."""
    status = found.path(GAZE_STATUS)
    return () if status is None else read_warnings(status)
