"""Find the files of HOT3D recordings, and say which recordings can be used.

Sources: docs/specification/hot3d.md#folder-tree and docs/specification/hot3d.md#usable-recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import msgspec

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.readers.aria_mps.find import find_mps_files
from prbench.readers.aria_mps.format import GAZE, TIME_COLUMN, TRAJECTORY
from prbench.readers.egoallo.places import body_extent, find_outputs
from prbench.readers.extents import SEVERAL_SENSORS, Extent, can_be_looked_at, csv_extent, json_extent
from prbench.readers.files import decode_json, read_columns
from prbench.readers.found import InputFile, RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.hot3d import format as hot3d
from prbench.readers.options import ReaderOptions
from prbench.readers.synthetic_tree import synthetic_tree_around
from prbench.recording import Recording


class Hot3dOptions(ReaderOptions, frozen=True, kw_only=True):
    """Options of the reader of HOT3D."""

    poses: Literal["egoallo"] = "egoallo"
    """Source of bodies; the dataset has none of its own."""
    smplh_model: Path | None = None
    """The licensed body model that EgoAllo's outputs need (``model.npz``)."""
    poses_root: Path | None = None
    """Folder of EgoAllo's outputs by recording; beside the recordings by default."""
    hands: Literal["umetrack", "mano"] = "umetrack"
    """Hand annotation that gives wrists and vertices."""
    mano_models: Path | None = None
    """Folder of ``MANO_LEFT.npz`` and ``MANO_RIGHT.npz``, for ``hands=mano``."""
    meshes: bool = False
    """Load the objects' surfaces: for the in-hand rule ``surface``, and to mark what is primed through an object."""


METADATA = "metadata"
OBJECTS = "objects"
HEADSET = "headset"
INSTANCES = "instances"
UMETRACK = "umetrack"
PROFILE = "hand profile"
MANO = "mano"
MASK_PREFIX = "mask:"
MODEL_PREFIX = "model:"
MANO_MODEL_PREFIX = "mano model:"
"""Roles of masks, object models and hand models are this and their name, uid or side."""
_FILES = {
    OBJECTS: hot3d.OBJECTS_FILE,
    HEADSET: hot3d.HEADSET_FILE,
    UMETRACK: hot3d.UMETRACK_FILE,
    PROFILE: hot3d.PROFILE_FILE,
    MANO: hot3d.MANO_FILE,
    **{f"{MASK_PREFIX}{name}": f"{hot3d.MASK_FOLDER}/mask_{name}.csv" for name in hot3d.MASK_NAMES},
}


class _GroundTruth(msgspec.Struct):
    """Ground truth that a recording has; that of test participants is withheld."""

    object_pose_gt: bool
    umetrack_hand_pose_gt: bool
    mano_hand_pose_gt: bool = False


class Metadata(msgspec.Struct):
    """``metadata.json``."""

    headset: str
    participant_id: str
    recording_name: str
    gt_available_status: _GroundTruth


METADATA_DECODER = msgspec.json.Decoder(Metadata)


def find_recordings(root: Path | str, options: Hot3dOptions) -> tuple[RecordingFiles, ...]:
    """List the recordings of a HOT3D folder: the dataset's (recordings in it or one level deeper), or one recording.

    Recordings of Quest 3 and of test participants are listed with the reason why they are skipped.

    Raises:
        InputFileError: if ``root`` holds none, saying what was looked for and what was found. Damaged metadata is
            reported when its recording is read, not here.
    """
    root = existing_folder(root, "a folder of HOT3D recordings")
    found = [
        _recording(root, path.parent, options)
        for pattern in ("", "*/", "*/*/")
        for path in sorted(root.glob(f"{pattern}{hot3d.METADATA_FILE}"))
        if not any(part.startswith(".") for part in path.relative_to(root).parts) and _is_hot3d(path.parent)
    ]
    if not found:
        raise InputFileError(
            root,
            "",
            expected=f"recordings of HOT3D: folders that hold {hot3d.METADATA_FILE}, at most two levels down",
            found=names_in(root),
            remedy="Give the folder of the recordings. Clips in tar files (HOT3D-Clips) are another format.",
        )
    return tuple(sorted(found, key=lambda recording: recording.recording_id))


def _recording(root: Path, folder: Path, options: Hot3dOptions) -> RecordingFiles:
    tree = synthetic_tree_around(folder, root)
    files = [input_file(METADATA, folder / hot3d.METADATA_FILE)]
    files += [input_file(role, folder / name) for role, name in _FILES.items() if is_present(folder / name)]
    files += find_mps_files(folder / hot3d.MPS_FOLDER)
    files += _library_files(root, folder)
    files += _mano_models(options)
    files += find_outputs(root, folder, folder.name, options.poses_root, smplh_model=options.smplh_model)
    dataset, splits = ("hot3d", {}) if tree is None else (f"{SYNTHETIC_PREFIX}hot3d", tree.split)
    split = splits.get(folder.name)
    skip = _skip_reason(folder)
    return RecordingFiles(dataset, folder.name, folder, tuple(files), split=split, skip_reason=skip)


def _library_files(root: Path, folder: Path) -> list[InputFile]:
    """The table of names, and the models of those objects that this recording tracks."""
    bases = dict.fromkeys((root, folder.parent, folder.parent.parent))
    places = [base / name for base in bases for name in hot3d.LIBRARY_FOLDERS]
    library = next((place for place in places if is_present(place / hot3d.INSTANCES_FILE)), None)
    if library is None:
        return []
    models = [(uid, library / f"{uid}.glb") for uid in _object_ids(folder / hot3d.OBJECTS_FILE)]
    return [
        input_file(INSTANCES, library / hot3d.INSTANCES_FILE),
        *(input_file(f"{MODEL_PREFIX}{uid}", path) for uid, path in models if is_present(path)),
    ]


def _object_ids(path: Path) -> list[str]:
    """Digits only, so that no uid of a file can name a path; none of a missing or damaged file."""
    try:
        table = read_columns(path, {hot3d.OBJECT_ID: str})
    except InputFileError:
        return []
    return sorted(uid for uid in table[hot3d.OBJECT_ID].unique().to_pylist() if uid.isdecimal())


def _mano_models(options: Hot3dOptions) -> list[InputFile]:
    if options.hands != "mano" or options.mano_models is None:
        return []
    folder = options.mano_models.expanduser()
    paths = {side: folder / f"MANO_{side.upper()}.npz" for side in ("left", "right")}
    return [input_file(f"{MANO_MODEL_PREFIX}{side}", path) for side, path in paths.items() if path.is_file()]


def _skip_reason(folder: Path) -> str | None:
    try:
        return why_unusable(decode_json(folder / hot3d.METADATA_FILE, METADATA_DECODER))
    except InputFileError:
        return None  # reported when the recording is read


def why_unusable(metadata: Metadata) -> str | None:
    """Say why a recording cannot be primed, or None: it needs Aria glasses and poses of objects and hands."""
    if metadata.headset != hot3d.ARIA:
        return f"recorded with {metadata.headset}, which has no gaze; only Aria recordings can be primed"
    status = metadata.gt_available_status
    missing = [
        what
        for what, there in (("objects", status.object_pose_gt), ("hands", status.umetrack_hand_pose_gt))
        if not there
    ]
    if missing:
        return f"the dataset withholds the ground truth of {' and '.join(missing)} (a test participant)"
    return None


def _is_hot3d(folder: Path) -> bool:
    """Return True for a recording of this dataset: other datasets call their metadata the same."""
    if any((folder / name).is_file() for name in (hot3d.HEADSET_FILE, hot3d.OBJECTS_FILE, hot3d.UMETRACK_FILE)):
        return True
    try:
        decode_json(folder / hot3d.METADATA_FILE, METADATA_DECODER)
    except InputFileError:
        return False
    return True


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """The streams of one recording, each clock from its own start.

    Ground truth and glasses have different clocks, which only reading all poses relates. The glasses record from the
    beginning to the end of the ground truth, or longer; so they are at least as long.
    """
    device = [
        _device_stream(file) for file in found.files if file.role in (TRAJECTORY, GAZE) and can_be_looked_at(file)
    ]
    body = body_extent(found)
    truth = [_truth_stream(file) for file in found.files if file.role in (HEADSET, OBJECTS, UMETRACK, MANO)]
    masks = [_truth_stream(file) for file in found.files if file.role.startswith(MASK_PREFIX)]
    return (*_from_start([*truth, *masks]), *_from_start(device if body is None else [*device, body]))


def _device_stream(file: InputFile) -> Extent:
    stream = "glasses" if file.role == TRAJECTORY else "gaze"
    return replace(csv_extent(stream, file, TIME_COLUMN, 1e-6), tells_span=False, slack=SEVERAL_SENSORS)


def _truth_stream(file: InputFile) -> Extent:
    """Hands have no row where none was seen, as at the start of many recordings."""
    if file.role in (UMETRACK, MANO):
        return replace(json_extent("hands", file), may_start_late=True)
    stream = {HEADSET: "glasses' ground truth", OBJECTS: "objects"}.get(file.role, "mask")
    return csv_extent(stream, file, hot3d.TIME, 1e-9)


def _from_start(streams: Sequence[Extent]) -> tuple[Extent, ...]:
    """The same with times since the first of all samples."""
    start = min((stream.first for stream in streams if stream.first is not None), default=0.0)
    return tuple(
        replace(
            stream,
            first=None if stream.first is None else stream.first - start,
            last=None if stream.last is None else stream.last - start,
        )
        for stream in streams
    )
