"""Find and read the files of MoGaze recordings: all in one folder, four HDF5 files a recording, and a common scene.

Source: docs/specification/mogaze.md#files.
"""

from __future__ import annotations

import itertools
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath

import h5py
import numpy as np
from jaxtyping import Float, Int

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, require_size
from prbench.limits import HARMLESS_SIZE, HIGHEST_COMPRESSION, LARGEST_ARRAYS, LARGEST_UNPACKED
from prbench.protocol.manifests import Manifest, load_manifest
from prbench.readers import read_synthetic_tree
from prbench.readers.extents import Extent
from prbench.readers.found import InputFile, RecordingFiles, input_file, is_present, names_in
from prbench.readers.mogaze import format as mogaze
from prbench.recording import Recording

_SHOWN = 8
"""Names that a message lists."""
_COPY_AGAIN = "The file may be truncated; copy or download it again."


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file, open for reading.

    Raises:
        InputFileError: if it cannot be opened, or a read inside fails.
    """
    try:
        require_size(path, largest=LARGEST_UNPACKED)
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError) as error:  # h5py says the latter of damaged links and indices
        found = str(error).splitlines()[0]
        raise InputFileError(path, "", expected="a complete HDF5 file", found=found, remedy=_COPY_AGAIN) from error


def dataset(path: Path, parent: h5py.Group, name: str) -> h5py.Dataset:
    """One dataset of a file or group.

    Raises:
        InputFileError: if it is missing, listing what is there, or lies in another file.
    """
    entry = _entry(path, parent, name)
    if isinstance(entry, h5py.Dataset):
        return entry
    raise InputFileError(
        path, parent.name or "", expected=f"a dataset '{name}'", found=_names(parent), remedy="Is this the right file?"
    )


def group(path: Path, file: h5py.File, name: str) -> h5py.Group:
    """One group of a file.

    Raises:
        InputFileError: if it is missing, listing what is there, or lies in another file.
    """
    entry = _entry(path, file, name)
    if isinstance(entry, h5py.Group):
        return entry
    raise InputFileError(path, "", expected=f"a group '{name}'", found=_names(file), remedy="Is this the right file?")


def _entry(path: Path, parent: h5py.Group, name: str) -> object:
    """Return what stands under a name in this very file; a link that leads elsewhere is never followed."""
    link = parent.get(name, getlink=True)
    if link is not None and not isinstance(link, h5py.HardLink):
        found = f"a link ({type(link).__name__})"
        raise InputFileError(path, f"{parent.name}, '{name}'", expected="numbers in this file", found=found)
    return parent.get(name)


def _names(parent: h5py.Group) -> str:
    return ", ".join(itertools.islice(parent, _SHOWN)) + (" …" if len(parent) > _SHOWN else "") or "nothing"


def stored_values(path: Path, entry: h5py.Dataset) -> np.ndarray:
    """All values of a dataset; what it declares is held against what is stored before anything is allocated.

    Raises:
        InputFileError: if it declares more than its stored bytes can hold, or its values lie in other files.
    """
    if entry.external or entry.is_virtual:
        raise InputFileError(path, entry.name or "", expected="values in this file", found="values in other files")
    stored = entry.id.get_storage_size()
    largest = min(LARGEST_ARRAYS, max(HARMLESS_SIZE, HIGHEST_COMPRESSION * stored))
    at_once = max(math.prod(shape) for shape in (entry.shape or (), entry.chunks or ()))
    if at_once * entry.dtype.itemsize > largest:
        raise InputFileError(
            path,
            entry.name or "",
            expected=f"at most {largest:,} bytes of values, for {stored:,} that are stored",
            found=f"shape {entry.shape} of {entry.dtype}",
            remedy=_COPY_AGAIN,
        )
    return entry[...]


def numbers(path: Path, entry: h5py.Dataset, *, columns: int) -> Float[np.ndarray, "n columns"]:
    """A table of numbers with at least ``columns`` columns.

    Raises:
        InputFileError: if it is of another shape or kind.
    """
    if entry.ndim != 2 or entry.shape[1] < columns or entry.dtype.kind not in "fiu":
        raise InputFileError(
            path,
            entry.name or "",
            expected=f"rows of at least {columns} numbers",
            found=f"shape {entry.shape}, type {entry.dtype}",
            remedy="Is this the right file?",
        )
    return stored_values(path, entry).astype(np.float64)


def attribute(path: Path, entry: h5py.Dataset, name: str) -> np.ndarray:
    """One attribute as an array.

    Raises:
        InputFileError: if it is missing, listing what is there.
    """
    if name not in entry.attrs:
        raise InputFileError(
            path,
            f"attributes of {entry.name}",
            expected=f"'{name}'",
            found=", ".join(itertools.islice(entry.attrs, _SHOWN)) or "none",
            remedy="Copy or download the file again.",
        )
    stored = entry.attrs.get_id(name)
    if stored.shape is None:
        raise InputFileError(path, f"attribute '{name}'", expected="values", found="none", remedy=_COPY_AGAIN)
    if math.prod(stored.shape or ()) * stored.dtype.itemsize > HARMLESS_SIZE:
        found = f"shape {stored.shape}"
        raise InputFileError(path, f"attribute '{name}'", expected=f"at most {HARMLESS_SIZE:,} bytes", found=found)
    return np.atleast_1d(np.asarray(entry.attrs[name]))


def number_attribute(path: Path, entry: h5py.Dataset, name: str) -> Float[np.ndarray, "..."]:
    """One attribute as numbers.

    Raises:
        InputFileError: see :func:`attribute`, or if it holds anything else.
    """
    found = attribute(path, entry, name)
    if found.dtype.kind not in "fiu":
        raise InputFileError(path, f"attribute '{name}'", expected="numbers", found=str(found.dtype))
    return found.astype(np.float64)


def words(values: np.ndarray | Sequence[object]) -> list[str]:
    """Texts, whether the file holds them as bytes (padded or not) or as strings."""
    return [
        value.decode("utf-8", "replace").rstrip("\0") if isinstance(value, bytes) else str(value) for value in values
    ]


_MOST_DIGITS = 19  # of the id of a body


@dataclass(frozen=True)
class SceneBody:
    """One body of the scene."""

    name: str
    mesh: Path | None
    """None where the scene names none, or none of that name lies in the dataset's folder."""


@foreign_input()
def read_scene(path: Path) -> dict[int, SceneBody]:
    """Bodies by id.

    Raises:
        InputFileError: if the file is no XML, or a body lacks id or name.
    """
    try:
        require_size(path, largest=HARMLESS_SIZE)
        root = ET.parse(path).getroot()
    except ET.ParseError as error:
        raise InputFileError(
            path, "", expected="XML", found=str(error), remedy="Copy or download the file again."
        ) from error
    bodies = {}
    for number, entry in enumerate(root.iter("body"), start=1):
        key = entry.get("id", "")
        name = entry.get("name", "").strip()
        if not key.isdecimal() or len(key) > _MOST_DIGITS or not name:
            raise InputFileError(
                path,
                f"body {number}",
                expected="an integer id and a name",
                found=f"id '{key}' and name '{name}'",
                remedy="Copy or download the file again; without it the bodies get their names by their order.",
            )
        mesh = entry.find("meshfile")
        source = "" if mesh is None else mesh.get("src", "")
        bodies[int(key)] = SceneBody(name, find_mesh(path.parent, source) if source else None)
    return bodies


def find_mesh(folder: Path, source: str) -> Path | None:
    """The mesh that a scene names: relative to the parent of the dataset's folder, to the folder, or by its base name.

    A path that leads out of the dataset's folder is never followed.

    Args:
        folder: The dataset's folder, in which ``scene.xml`` lies.
        source: What stands in ``scene.xml``, for example ``mogaze/meshfiles/cup.obj``.
    """
    written = PurePosixPath(source.replace("\\", "/"))
    for candidate in (folder.parent / written, folder / written, folder / mogaze.MESH_FOLDER / written.name):
        # Asked first, because following links takes ten times as long, and few candidates are there.
        if candidate.is_file() and (place := candidate.resolve()).is_relative_to(folder.resolve()):
            return place
    return None


def read_mesh(path: Path) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices (metres, in the frame of the body) and triangles of a mesh.

    Raises:
        InputFileError: if the file holds no triangles.
    """
    status = path.stat()
    return _read_mesh(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=64)
def _read_mesh(path: Path, _size: int, _changed: int) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    import trimesh  # late: 0.3 s that copies without meshes need not wait for

    try:
        require_size(path)
        mesh = trimesh.load_mesh(path, process=False)
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except (ValueError, IndexError, KeyError, AttributeError, TypeError) as error:
        raise _no_mesh(path, f"'{error}'") from error
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise _no_mesh(path, f"{len(faces)} triangles and {len(vertices)} corners")
    return vertices, faces


def _no_mesh(path: Path, found: str) -> InputFileError:
    return InputFileError(
        path,
        "",
        expected="a mesh of triangles",
        found=found,
        remedy="Copy or download the file again, or remove it: the size of the object is then taken from a table.",
    )


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


_BODY_KEY = re.compile(r"(?:.*\s)?(\d{1,19})")
_PARTICIPANT = re.compile(r"(p\d+)_\d+")


def read_readings(found: RecordingFiles, manifest: Manifest, *, meshes: bool = False) -> mogaze.MogazeReadings:
    """Read one recording; all streams are cut to the shortest.

    Args:
        found: Its files.
        manifest: Sizes of objects whose mesh is missing.
        meshes: Keep the triangles of the meshes.

    Raises:
        InputFileError: if a file is missing or damaged, or the files are not of one recording.
    """
    paths = {part: found.require(part, f"{found.recording_id}_{part}.hdf5") for part in mogaze.PARTS}
    human, objects, gaze, segmentations = (paths[part] for part in mogaze.PARTS)
    with opened(human) as file:
        entry = dataset(human, file, mogaze.HUMAN_DATASET)
        table = numbers(human, entry, columns=len(mogaze.STATE_COLUMNS))
        names = words(attribute(human, entry, mogaze.COLUMNS_ATTRIBUTE))
        keys = words(attribute(human, entry, mogaze.FIXED_KEYS_ATTRIBUTE))
        values = number_attribute(human, entry, mogaze.FIXED_VALUES_ATTRIBUTE).ravel()
        participant = str(entry.attrs.get(mogaze.PARTICIPANT_ATTRIBUTE, ""))
    if len(names) != table.shape[1]:
        raise InputFileError(
            human,
            mogaze.COLUMNS_ATTRIBUTE,
            expected=f"a name for each of the {table.shape[1]} columns",
            found=f"{len(names)} names",
            remedy="Copy or download the file again.",
        )
    _require(human, mogaze.COLUMNS_ATTRIBUTE, mogaze.STATE_COLUMNS, names)
    fixed = dict(zip(keys, values.tolist(), strict=False))
    _require(human, mogaze.FIXED_KEYS_ATTRIBUTE, sorted(mogaze.MODEL_OFFSETS), list(fixed))
    if len(table) < 2:
        raise InputFileError(
            human, _named_dataset(mogaze.HUMAN_DATASET), expected="frames of a body", found=f"{len(table)}"
        )
    state, fixed, participant = table[:, [names.index(name) for name in mogaze.STATE_COLUMNS]], fixed, participant
    poses = _read_poses(objects)
    scene_file = found.path(SCENE)
    scene = {} if scene_file is None else read_scene(scene_file)
    # Bodies by id: the scene's, else by their order, else without a name of their own.
    if scene:
        bodies = {key: scene.get(key, SceneBody(f"body_{key}", None)) for key in poses}
    else:
        names = mogaze.BODIES_WITHOUT_SCENE if len(poses) == len(mogaze.BODIES_WITHOUT_SCENE) else ()
        bodies = {key: SceneBody(names[index] if names else f"body_{key}", None) for index, key in enumerate(poses)}
    if all(body.name != mogaze.GOGGLES for body in bodies.values()):
        raise InputFileError(
            objects,
            mogaze.OBJECT_GROUP,
            expected=f"a body that {mogaze.SCENE_FILE} calls '{mogaze.GOGGLES}'",
            found=", ".join(f"{key} ({body.name})" for key, body in bodies.items()) or "no body",
            remedy=f"Gaze starts at the goggles. Put {mogaze.SCENE_FILE} of the dataset beside the file.",
        )
    naming = "" if scene else f"no {mogaze.SCENE_FILE}: the bodies have their names by the order of their keys"
    with opened(gaze) as file:
        entry = dataset(gaze, file, mogaze.GAZE_DATASET)
        table = numbers(gaze, entry, columns=mogaze.FEWEST_GAZE_COLUMNS)
        calibration = number_attribute(gaze, entry, mogaze.CALIBRATION_ATTRIBUTE).ravel()
    if len(calibration) != 4 or not abs(np.linalg.norm(calibration) - 1) < 0.01:
        raise InputFileError(
            gaze,
            mogaze.CALIBRATION_ATTRIBUTE,
            expected="a quaternion of length 1",
            found=np.array2string(calibration, precision=3),
            remedy="Copy or download the file again.",
        )
    points, confidence, calibration = table[:, mogaze.GAZE_POINT], table[:, -1], calibration
    lengths = {"human_data": len(state), "gaze_data": len(points)}
    lengths |= {f"object_data, body {key}": len(rows) for key, rows in poses.items()}
    n, unequal = _common_length(found, lengths)
    match = _PARTICIPANT.fullmatch(found.recording_id)
    return mogaze.MogazeReadings(
        recording_id=found.recording_id,
        participant_id=match[1] if match else participant or found.recording_id,
        state=state[:n],
        fixed=fixed,
        bodies=tuple(_body(key, poses[key][:n], body, manifest, meshes=meshes) for key, body in sorted(bodies.items())),
        gaze_points=points[:n],
        gaze_confidence=confidence[:n],
        calibration=calibration,
        segments=_read_segments(segmentations),
        messages=tuple(text for text in (naming, unequal) if text),
    )


def _named_dataset(name: str) -> str:
    return f"dataset '{name}'"


def _require(path: Path, where: str, wanted: tuple[str, ...] | list[str], present: list[str]) -> None:
    missing = [name for name in wanted if name not in present]
    if missing:
        raise InputFileError(
            path,
            where,
            expected=f"'{missing[0]}'" + (f" and {len(missing) - 1} more" if len(missing) > 1 else ""),
            found=f"{len(present)} others: {', '.join(present[:6])} …" if present else "nothing",
            remedy="Without it the body cannot be placed; copy or download the file again.",
        )


def _read_poses(path: Path) -> dict[int, Float[np.ndarray, "n 7"]]:
    """Position and quaternion (x y z w) of each tracked body by id, in the order of the file."""
    poses: dict[int, Float[np.ndarray, "n 7"]] = {}
    with opened(path) as file:
        bodies = group(path, file, mogaze.OBJECT_GROUP)
        for key in map(str, bodies):
            match = _BODY_KEY.fullmatch(key)
            if match is None or int(match[1]) in poses:
                raise InputFileError(
                    path,
                    f"{mogaze.OBJECT_GROUP}/{key}",
                    expected="a key that ends with an integer id, each id once",
                    found=f"'{key}'",
                    remedy="Is this the right file?",
                )
            poses[int(match[1])] = numbers(path, dataset(path, bodies, key), columns=7)[:, :7]
    return poses


def _body(
    key: int, rows: Float[np.ndarray, "n 7"], body: SceneBody, manifest: Manifest, *, meshes: bool
) -> mogaze.MogazeBody:
    vertices, faces = (None, None) if body.mesh is None else read_mesh(body.mesh)
    if vertices is not None:
        box_min = vertices.min(axis=0)
        box_max = vertices.max(axis=0)
    else:
        point = ((0.0, 0.0),) * 3
        box_min, box_max = np.array(manifest.object_extents.get(mogaze.kind_of_body(body.name), point)).T
    return mogaze.MogazeBody(
        body_id=key,
        name=body.name,
        position=rows[:, :3],
        rotation=rows[:, 3:],
        box_min=box_min,
        box_max=box_max,
        vertices=vertices if meshes else None,
        faces=faces if meshes else None,
    )


def _read_segments(path: Path) -> tuple[mogaze.Segment, ...]:
    with opened(path) as file:
        rows = stored_values(path, dataset(path, file, mogaze.SEGMENT_DATASET))
    names = rows.dtype.names or ()
    if len(names) < 3:
        raise InputFileError(
            path,
            _named_dataset(mogaze.SEGMENT_DATASET),
            expected="rows of start, end and label",
            found=str(rows.dtype),
            remedy="Is this the right file?",
        )
    start, end, label = (rows[name] for name in names[:3])
    return tuple(
        mogaze.Segment(int(first), int(last), text) for first, last, text in zip(start, end, words(label), strict=True)
    )


def _common_length(found: RecordingFiles, lengths: dict[str, int]) -> tuple[int, str]:
    """The shortest stream's length, and a remark where the streams differ by more than two frames."""
    short = min(lengths, key=lambda name: lengths[name])
    long = max(lengths, key=lambda name: lengths[name])
    difference = lengths[long] - lengths[short]
    if difference > mogaze.LONGEST_LENGTH_DIFFERENCE * lengths[long]:
        raise InputFileError(
            found.folder / found.recording_id,
            "",
            expected="streams of one length: they share one frame index",
            found=f"{lengths[short]} frames of {short}, {lengths[long]} of {long}",
            remedy="One of the files is truncated or belongs to another recording; copy or download them again.",
        )
    if difference <= mogaze.UNREMARKABLE_LENGTH_DIFFERENCE:
        return lengths[short], ""
    return lengths[short], f"cut to {lengths[short]} frames of {short}; {long} has {lengths[long]}"
