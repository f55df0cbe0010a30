"""Find the files of ADT recordings: one flat folder each (v2.0), or one sub-folder a device (v1.x)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input
from prbench.files.storage import inside
from prbench.readers.adt import format as adt
from prbench.readers.aria_mps.find import find_gaze_file
from prbench.readers.aria_mps.format import CALIBRATION_FILE, PERSONALIZED_GAZE_FILES, SUMMARY_FILE, TIME_COLUMN
from prbench.readers.egoallo.places import body_extent, find_outputs
from prbench.readers.extents import Extent, csv_extent, json_extent
from prbench.readers.files import decode_json
from prbench.readers.found import InputFile, RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.options import ReaderOptions
from prbench.readers.synthetic_tree import read_synthetic_tree
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
    body = body_extent(found)
    return tuple(streams) if body is None else (*streams, body)
