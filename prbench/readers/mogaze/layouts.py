"""Find the files of MoGaze recordings: all in one folder, four HDF5 files a recording, and a common scene."""

from __future__ import annotations

import re
from pathlib import Path

import h5py

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.protocol.manifests import load_manifest
from prbench.readers.extents import Extent
from prbench.readers.found import InputFile, RecordingFiles, input_file, is_present, names_in
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.arrays import opened
from prbench.readers.mogaze.scene import read_scene
from prbench.readers.synthetic_tree import read_synthetic_tree
from prbench.recording import Recording

SCENE = "scene"
_MESH_PREFIX = "mesh:"
"""Role of a mesh: this and the name of its file."""

_FILE_NAME = re.compile(rf"(?P<id>p\d+_\d+|\w+_synthetic_\w+)_(?P<part>{'|'.join(mogaze.PARTS)})\.hdf5")


def find_recordings(root: Path | str, *, include_excluded: bool = False) -> tuple[RecordingFiles, ...]:
    """List the recordings of a MoGaze folder, or of the folder ``mogaze`` in it; a file names its recording alone.

    Args:
        root: The dataset's folder.
        include_excluded: Do not tell builds to leave out what the manifest excludes.

    Raises:
        InputFileError: if there are none, saying what was looked for and what was found. Damaged files are reported
            when their recording is read, not here.
    """
    root = Path(root).expanduser().resolve()
    if root.is_file() and (match := _FILE_NAME.fullmatch(root.name)):
        found = find_recordings(root.parent, include_excluded=include_excluded)
        return tuple(recording for recording in found if recording.recording_id == match["id"])
    if not root.is_dir():
        raise InputFileError(root, "", expected="a folder of MoGaze recordings", found="no such folder")
    folder = root if _parts_in(root) else root / "mogaze"
    parts = _parts_in(folder) if folder.is_dir() else {}
    if not parts:
        raise InputFileError(
            root,
            "",
            expected="recordings of MoGaze: files like p1_1_human_data.hdf5",
            found=names_in(root),
            remedy="Give the folder that the archive unpacks to (mogaze).",
        )
    tree = read_synthetic_tree(folder)
    dataset, splits = ("mogaze", {}) if tree is None else (f"{SYNTHETIC_PREFIX}mogaze", tree.split)
    excluded = {} if include_excluded else load_manifest("mogaze").excluded
    shared = _shared_files(folder)
    return tuple(
        RecordingFiles(dataset, name, folder, (*files, *shared), split=splits.get(name), skip_reason=excluded.get(name))
        for name, files in sorted(parts.items())
    )


def _parts_in(folder: Path) -> dict[str, list[InputFile]]:
    parts: dict[str, list[InputFile]] = {}
    for path in sorted(folder.iterdir()):
        match = _FILE_NAME.fullmatch(path.name)
        if match:
            parts.setdefault(match["id"], []).append(input_file(match["part"], path))
    return parts


def _shared_files(folder: Path) -> tuple[InputFile, ...]:
    """The scene and the meshes that it names; of a damaged scene the file alone."""
    path = folder / mogaze.SCENE_FILE
    if not is_present(path):
        return ()
    try:
        meshes = {body.mesh for body in read_scene(path).values() if body.mesh is not None}
    except InputFileError:
        meshes = set()
    return (
        input_file(SCENE, path),
        *(input_file(f"{_MESH_PREFIX}{mesh.relative_to(folder).as_posix()}", mesh) for mesh in sorted(meshes)),
    )


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """The streams of one recording: frames at one rate, all from frame 0; labels begin and end with nothing in hand."""
    return tuple(stream for file in found.files if (stream := _extent(file)) is not None)


def _extent(file: InputFile) -> Extent | None:
    human, objects, gaze, segments = mogaze.PARTS
    streams = {human: "body", objects: "objects", gaze: "gaze", segments: "labels"}
    if file.role not in streams:
        return None
    try:
        with opened(file.path) as content:
            last = _last_label(content) if file.role == segments else _last_frame(content)
    except (InputFileError, KeyError):
        return None  # reading says what is wrong with it
    seconds = None if last is None else last / mogaze.RATE
    return Extent(streams[file.role], file.path.name, 0.0, seconds, tells_span=file.role != segments)


def _last_frame(content: h5py.File) -> int | None:
    """Return the last frame of a file's shortest array; None where it holds no frame."""
    bodies = content.get(mogaze.OBJECT_GROUP)
    arrays = list(bodies.values()) if isinstance(bodies, h5py.Group) else []
    arrays += [content[name] for name in (mogaze.HUMAN_DATASET, mogaze.GAZE_DATASET) if name in content]
    frames = min((array.shape[0] for array in arrays if isinstance(array, h5py.Dataset) and array.ndim), default=0)
    return frames - 1 if frames else None


def _last_label(content: h5py.File) -> int | None:
    """Last frame of the last label; None where nothing is labelled."""
    rows = content[mogaze.SEGMENT_DATASET]
    if not isinstance(rows, h5py.Dataset) or rows.ndim != 1 or len(rows) == 0:
        return None
    return int(rows[len(rows) - 1][1])
