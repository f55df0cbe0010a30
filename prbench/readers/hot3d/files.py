"""Find and read the files of HOT3D recordings, and say which recordings can be used.

Sources: docs/specification/hot3d.md#folder-tree, docs/specification/hot3d.md#files and
docs/specification/hot3d.md#usable-recordings.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.bounded import require
from prbench.readers import ReaderOptions, synthetic_tree_around
from prbench.readers import files as native
from prbench.readers.aria_mps.files import find_mps_files, read_mps, read_poses_by_body, require_up
from prbench.readers.aria_mps.format import GAZE, OBJECT_ID, OBJECT_TIME, TIME_COLUMN, TRAJECTORY
from prbench.readers.aria_mps.to_recording import mps_streams
from prbench.readers.egoallo.bodies import read_bodies
from prbench.readers.egoallo.files import body_extent, find_outputs
from prbench.readers.egoallo.to_recording import NO_OUTPUTS
from prbench.readers.extents import SEVERAL_SENSORS, Extent, can_be_looked_at, csv_extent, json_extent
from prbench.readers.found import RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.hands import read_profile, read_umetrack
from prbench.readers.three_point import find_body
from prbench.recording import Recording, UnreadableEntry


class Hot3dOptions(ReaderOptions, frozen=True, kw_only=True):
    """Options of the reader of HOT3D.

    Attributes:
        poses: Source of bodies; the dataset has none of its own.
        smplh_model: The licensed body model that EgoAllo's outputs need (``model.npz``).
        poses_root: Folder of EgoAllo's outputs by recording; beside the recordings by default.
        meshes: Load the objects' surfaces, for the in-hand rule ``surface``.
    """

    poses: Literal["egoallo", "three-point"] = "egoallo"
    smplh_model: Path | None = None
    poses_root: Path | None = None
    meshes: bool = False


METADATA = "metadata"
OBJECTS = "objects"
HEADSET = "headset"
INSTANCES = "instances"
UMETRACK = "umetrack"
PROFILE = "hand profile"
# Roles of masks and object models are these and their name or uid.
MASK_PREFIX = "mask:"
MODEL_PREFIX = "model:"
_FILES = {
    OBJECTS: hot3d.OBJECTS_FILE,
    HEADSET: hot3d.HEADSET_FILE,
    UMETRACK: hot3d.UMETRACK_FILE,
    PROFILE: hot3d.PROFILE_FILE,
    **{f"{MASK_PREFIX}{name}": f"{hot3d.MASK_FOLDER}/mask_{name}.csv" for name in hot3d.MASK_NAMES},
}


class Metadata(msgspec.Struct):
    """``metadata.json``.

    Attributes:
        gt_available_status: Ground truth that a recording has; that of test participants is withheld.
    """

    headset: str
    participant_id: str
    recording_name: str
    gt_available_status: dict[str, bool]


def find_recordings(root: Path | str, options: Hot3dOptions) -> tuple[RecordingFiles, ...]:
    """List the recordings of a HOT3D folder: the dataset's (recordings in it or one level deeper), or one recording.

    Recordings of Quest 3 and of test participants are listed with the reason why they are skipped.

    Raises:
        InputFileError: if ``root`` holds none, saying what was looked for and what was found. Damaged metadata is
            reported when its recording is read, not here.
    """
    root = existing_folder(root, "a folder of HOT3D recordings")
    found = []
    for path in sorted(path for depth in ("", "*/", "*/*/") for path in root.glob(f"{depth}{hot3d.METADATA_FILE}")):
        folder = path.parent
        if any(part.startswith(".") for part in path.relative_to(root).parts):
            continue
        try:
            metadata = native.decode_json(path, Metadata)
        except InputFileError:
            # Other datasets call their metadata the same; damaged ones of this dataset lie beside its own files.
            if not any((folder / _FILES[role]).is_file() for role in (HEADSET, OBJECTS, UMETRACK)):
                continue
            metadata = None
        files = [input_file(METADATA, path)]
        files += [input_file(role, folder / name) for role, name in _FILES.items() if is_present(folder / name)]
        files += [*find_mps_files(folder / hot3d.MPS_FOLDER), *find_body(root, folder.name)]
        # The table of names, and the models of those objects that this recording tracks.
        bases = dict.fromkeys((root, folder.parent, folder.parent.parent))
        places = [base / name for base in bases for name in hot3d.LIBRARY_FOLDERS]
        library = next((place for place in places if is_present(place / hot3d.INSTANCES_FILE)), None)
        if library is not None:
            files.append(input_file(INSTANCES, library / hot3d.INSTANCES_FILE))
            # Digits only, so that no uid of a file can name a path; none of a missing or damaged file.
            uids: set[str] = set()
            with contextlib.suppress(InputFileError):
                table = native.read_columns(folder / hot3d.OBJECTS_FILE, {OBJECT_ID: str})
                uids = set(filter(str.isdecimal, table[OBJECT_ID].unique().to_pylist()))
            models = [(uid, library / f"{uid}.glb") for uid in sorted(uids)]
            files += [input_file(f"{MODEL_PREFIX}{uid}", path) for uid, path in models if is_present(path)]
        if options.poses == "egoallo":
            files += find_outputs(root, folder, folder.name, options.poses_root, smplh_model=options.smplh_model)
        tree = synthetic_tree_around(folder, root)
        dataset, splits = ("hot3d", {}) if tree is None else (f"{SYNTHETIC_PREFIX}hot3d", tree.split)
        reason = None if metadata is None else why_unusable(metadata)
        found.append(RecordingFiles(dataset, folder.name, folder, tuple(files), splits.get(folder.name), reason))
    expected = f"recordings of HOT3D: folders that hold {hot3d.METADATA_FILE}, at most two levels down"
    remedy = "Give the folder of the recordings. Clips in tar files (HOT3D-Clips) are another format."
    require(root, (found, "", expected, names_in(root), remedy))
    return tuple(sorted(found, key=lambda recording: recording.recording_id))


def why_unusable(metadata: Metadata) -> str | None:
    """Say why a recording cannot be primed, or None: it needs Aria glasses and poses of objects and hands."""
    if metadata.headset != hot3d.ARIA:
        return f"recorded with {metadata.headset}, which has no gaze; only Aria recordings can be primed"
    truth = {"objects": "object_pose_gt", "hands": "umetrack_hand_pose_gt"}
    if missing := [what for what, key in truth.items() if not metadata.gt_available_status.get(key)]:
        return f"the dataset withholds the ground truth of {' and '.join(missing)} (a test participant)"
    return None


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """Return the streams of one recording, each clock from its own start.

    Ground truth and glasses have different clocks, which only reading all poses relates. The glasses record from the
    beginning to the end of the ground truth, or longer; so they are at least as long.
    """
    device = []
    truth = []
    for file in found.files:
        if file.role in (TRAJECTORY, GAZE) and can_be_looked_at(file):
            stream = csv_extent("glasses" if file.role == TRAJECTORY else "gaze", file, TIME_COLUMN, 1e-6)
            device.append(replace(stream, tells_span=False, slack=SEVERAL_SENSORS))
        elif file.role == UMETRACK:  # hands have no row where none was seen, as at the start of many recordings
            truth.append(replace(json_extent("hands", file), may_start_late=True))
        elif file.role in _TRUTH_STREAMS or file.role.startswith(MASK_PREFIX):
            truth.append(csv_extent(_TRUTH_STREAMS.get(file.role, "mask"), file, OBJECT_TIME, 1e-9))
    streams = []
    for clock in (truth, [*device, *body_extent(found)]):
        start = min((stream.first for stream in clock if stream.first is not None), default=0.0)
        for stream in clock:
            first, last = (None if time is None else time - start for time in (stream.first, stream.last))
            streams.append(replace(stream, first=first, last=last))
    return tuple(streams)


_TRUTH_STREAMS = {HEADSET: "glasses' ground truth", OBJECTS: "objects"}
_METRES = 7  # Decimals: float32 millimetres carry no more.


class _Instance(msgspec.Struct):
    """One entry of ``instance.json``."""

    instance_name: str
    instance_type: str


def read_objects(found: RecordingFiles) -> tuple[tuple[hot3d.Hot3dObject, ...], tuple[str, ...], list[UnreadableEntry]]:
    """Read all objects that a recording tracks, by uid, remarks, and entries of the names that cannot be read.

    An object without a model keeps its poses; without a name it is called by its uid.

    Raises:
        InputFileError: for a missing or damaged file, a pose that is no pose, a clock that runs backwards, no object.
    """
    path = found.require(OBJECTS, hot3d.OBJECTS_FILE)
    rows = _read_pose_rows(path)
    names = found.require(INSTANCES, f"../assets/{hot3d.INSTANCES_FILE}")
    expected = "an object with instance_name and instance_type"
    entries = native.decode_json(names, dict[str, msgspec.Raw])
    instances, unreadable = native.read_entries(names, entries, msgspec.json.Decoder(_Instance).decode, expected)
    held = [uid for uid in sorted(rows) if uid not in instances or instances[uid].instance_type == hot3d.LIBRARY_OBJECT]
    if not held:
        raise InputFileError(path, OBJECT_ID, expected="objects", found="headsets only")
    objects = []
    for uid in held:
        name = instances[uid].instance_name if uid in instances else uid
        model = found.path(f"{MODEL_PREFIX}{uid}")
        objects.append(hot3d.Hot3dObject(uid, name, rows[uid], None if model is None else read_glb(model)))
    nameless = [uid for uid in held if uid not in instances]
    remark = f"objects without a name in {hot3d.INSTANCES_FILE}: {', '.join(nameless)}"
    return tuple(objects), (remark,) if nameless else (), unreadable


def _read_pose_rows(path: Path) -> dict[str, hot3d.PoseRows]:
    """Return the poses of every body of the file, by uid; uids stay text.

    Raises:
        InputFileError: if the file or a column is missing, it has no rows, a pose is no pose, or the clock of a body
            stands still (a repeated row) or runs backwards.
    """
    poses = read_poses_by_body(path, str)
    remedy = "metadata.json says that this ground truth is there; download the recording again."
    require(path, (poses, "", "rows of poses", "none", remedy))
    return {uid: hot3d.PoseRows(*rows) for uid, rows in poses.items()}


def read_glb(path: Path) -> hot3d.Mesh:
    """Read the triangles of a model in the object's frame, metres: node transforms applied, materials left aside.

    Raises:
        InputFileError: if the file is missing, is no binary glTF, or holds no triangles.
    """
    remedy = "The file may be truncated; download the object library again."
    vertices, triangles = native.read_triangles(path, expected="a model in binary glTF", remedy=remedy)
    return np.round(vertices, _METRES), triangles


_TRUTH = {"True": True, "False": False, "true": True, "false": False, "1": True, "0": False}


def read_readings(found: RecordingFiles) -> hot3d.Hot3dReadings:
    """Read all that curation needs of one recording.

    Raises:
        InputFileError: for a missing or damaged file, or a world that is not Z up.
        RecordingUnusable: for a recording of Quest 3, or without ground truth.
    """
    metadata = native.decode_json(found.require(METADATA, hot3d.METADATA_FILE), Metadata)
    found.require_usable(why_unusable(metadata))
    objects, remarks, unreadable = read_objects(found)
    path = found.require(HEADSET, hot3d.HEADSET_FILE)
    headsets = _read_pose_rows(path)
    names = f"{len(headsets)}: {', '.join(sorted(headsets)[:3])}"
    require(path, (len(headsets) <= 1, OBJECT_ID, "one headset", names, ""))
    hands, odd_hands = read_umetrack(found.require(UMETRACK, hot3d.UMETRACK_FILE))
    profile = found.path(PROFILE)
    # Those masks that curation honours and the recording has.
    paths: dict[hot3d.MaskName, Path | None] = {name: found.path(f"{MASK_PREFIX}{name}") for name in hot3d.MASK_NAMES}
    masks: dict[hot3d.MaskName, hot3d.Mask] = {}
    for name, mask_path in paths.items():
        if mask_path is not None:
            masks[name], odd = read_mask(mask_path)
            unreadable += odd
    mps = read_mps(found, thin=False)
    remedy = "This trajectory belongs to another dataset; download the recording's own."
    require_up(found.folder / hot3d.MPS_FOLDER, mps.trajectory, (0.0, 0.0, 1.0), within=1e-3, remedy=remedy)
    body = read_bodies(found, cpf=mps_streams(mps, world_from_source=np.eye(4)).head)
    known = (found.recording_id, metadata.participant_id, next(iter(headsets.values())), objects, hands)
    model = None if profile is None else read_profile(profile)
    messages = (*remarks, *(() if body is not None else (NO_OUTPUTS,)))
    return hot3d.Hot3dReadings(*known, model, masks, mps, body, (), messages, (*unreadable, *odd_hands))


def read_mask(path: Path) -> tuple[hot3d.Mask, list[UnreadableEntry]]:
    """Read one mask of the RGB stream, in the order of time, and tell rows that are neither True nor False.

    Raises:
        InputFileError: if the file or a column is missing.
    """
    table = native.read_columns(path, {OBJECT_TIME: int, hot3d.STREAM: str, hot3d.MASK: str})
    values = table[hot3d.MASK].to_numpy()
    streams = table[hot3d.STREAM].to_numpy()
    known = np.isin(values, list(_TRUTH))
    rows = np.flatnonzero(~known)
    odd = [UnreadableEntry(path.name, f"line {row + 2}", "True or False", f"'{values[row]}'") for row in rows]
    rgb = known & (streams == hot3d.RGB_STREAM)
    time_ns, first = np.unique(table[OBJECT_TIME].to_numpy()[rgb], return_index=True)
    good = np.isin(values[rgb], [text for text, good in _TRUTH.items() if good])[first]
    return (time_ns, good), native.told_together(odd)
