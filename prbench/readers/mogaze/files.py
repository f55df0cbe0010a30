"""Find and read the files of MoGaze recordings: all in one folder, four HDF5 files a recording, and a common scene.

Source: docs/specification/mogaze.md#files.
"""

from __future__ import annotations

import itertools
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import TypeVar

import h5py
import numpy as np
from jaxtyping import Float

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, require, require_size
from prbench.limits import HARMLESS_SIZE, HIGHEST_COMPRESSION, LARGEST_ARRAYS, LARGEST_UNPACKED
from prbench.protocol.manifests import Manifest, load_manifest
from prbench.readers import read_synthetic_tree
from prbench.readers.extents import Extent
from prbench.readers.files import read_entries, read_triangles
from prbench.readers.found import InputFile, RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.mogaze import format as mogaze
from prbench.recording import Recording, UnreadableEntry

_SHOWN = 8  # Names that a message lists.
_COPY_AGAIN = "The file may be truncated; copy or download it again."
_OTHER_FILE = "Is this the right file?"
_MOST_DIGITS = 19  # of the id of a body
_Kind = TypeVar("_Kind", h5py.Dataset, h5py.Group)


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Return an HDF5 file, open for reading.

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


def _entry(path: Path, parent: h5py.Group, name: str, kind: type[_Kind], called: str) -> _Kind:
    """Return what stands under a name in this very file; a link that leads elsewhere is never followed."""
    link = parent.get(name, getlink=True)
    elsewhere = link is not None and not isinstance(link, h5py.HardLink)
    found = f"a link ({type(link).__name__})"
    require(path, (not elsewhere, f"{parent.name}, '{name}'", "numbers in this file", found, ""))
    entry = parent.get(name)
    if not isinstance(entry, kind):
        expected, where = f"{called} '{name}'", parent.name or ""
        raise InputFileError(path, where, expected=expected, found=_listed(parent), remedy=_OTHER_FILE)
    return entry


def _listed(names: Iterable[str]) -> str:
    first = list(itertools.islice(names, _SHOWN + 1))
    return ", ".join(first[:_SHOWN]) + (" …" if len(first) > _SHOWN else "") or "nothing"


def dataset(path: Path, parent: h5py.Group, name: str) -> h5py.Dataset:
    """Return one dataset of a file or group.

    Raises:
        InputFileError: if it is missing, listing what is there, or lies in another file.
    """
    return _entry(path, parent, name, h5py.Dataset, "a dataset")


def stored_values(path: Path, entry: h5py.Dataset) -> np.ndarray:
    """Return all values of a dataset; what it declares is held against what is stored before anything is allocated.

    Raises:
        InputFileError: if it declares more than its stored bytes can hold, or its values lie in other files.
    """
    where = entry.name or ""
    is_here = not entry.external and not entry.is_virtual
    require(path, (is_here, where, "values in this file", "values in other files", ""))
    stored = entry.id.get_storage_size()
    largest = min(LARGEST_ARRAYS, max(HARMLESS_SIZE, HIGHEST_COMPRESSION * stored))
    at_once = max(math.prod(shape) for shape in (entry.shape or (), entry.chunks or ()))
    fits = at_once * entry.dtype.itemsize <= largest
    expected = f"at most {largest:,} bytes of values, for {stored:,} that are stored"
    require(path, (fits, where, expected, f"shape {entry.shape} of {entry.dtype}", _COPY_AGAIN))
    return entry[...]


def numbers(path: Path, entry: h5py.Dataset, *, columns: int) -> Float[np.ndarray, "n columns"]:
    """Return a table of numbers with at least ``columns`` columns.

    Raises:
        InputFileError: if it is of another shape or kind.
    """
    is_table = entry.ndim == 2 and entry.shape[1] >= columns and entry.dtype.kind in "fiu"
    found = f"shape {entry.shape}, type {entry.dtype}"
    require(path, (is_table, entry.name or "", f"rows of at least {columns} numbers", found, _OTHER_FILE))
    return stored_values(path, entry).astype(np.float64)


def _attribute(path: Path, entry: h5py.Dataset, name: str) -> np.ndarray:
    """Return one attribute as an array; refused if it is missing, empty or too large."""
    where = f"attributes of {entry.name}"
    require(path, (name in entry.attrs, where, f"'{name}'", _listed(entry.attrs), _COPY_AGAIN))
    stored = entry.attrs.get_id(name)
    where = f"attribute '{name}'"
    size = math.prod(stored.shape or ()) * stored.dtype.itemsize
    require(
        path,
        (stored.shape is not None, where, "values", "none", _COPY_AGAIN),
        (size <= HARMLESS_SIZE, where, f"at most {HARMLESS_SIZE:,} bytes", f"shape {stored.shape}", ""),
    )
    return np.atleast_1d(np.asarray(entry.attrs[name]))


def _number_attribute(path: Path, entry: h5py.Dataset, name: str) -> Float[np.ndarray, " n"]:
    found = _attribute(path, entry, name)
    require(path, (found.dtype.kind in "fiu", f"attribute '{name}'", "numbers", found.dtype, ""))
    return found.astype(np.float64).ravel()


def _words(values: np.ndarray | Sequence[object]) -> list[str]:
    """Return the texts, whether the file holds them as bytes (padded or not) or as strings."""
    return [each.decode("utf-8", "replace").rstrip("\0") if isinstance(each, bytes) else str(each) for each in values]


@foreign_input()
def read_scene(path: Path) -> tuple[dict[int, tuple[str, Path | None]], list[UnreadableEntry]]:
    """Read the names and meshes of the bodies, by id, and tell bodies without id or name.

    A mesh is None where the scene names none, or none of that name lies in the dataset's folder.

    Raises:
        InputFileError: if the file is no XML.
    """
    try:
        require_size(path, largest=HARMLESS_SIZE)
        root = ET.parse(path).getroot()
    except ET.ParseError as error:
        raise InputFileError(path, "", expected="XML", found=str(error), remedy=_COPY_AGAIN) from error

    def read_body(entry: ET.Element) -> tuple[int, tuple[str, Path | None]]:
        key = entry.get("id", "")
        name = entry.get("name", "").strip()
        if not (key.isdecimal() and len(key) <= _MOST_DIGITS and name):
            raise ValueError(f"id '{key}' and name '{name}'")
        mesh = entry.find("meshfile")
        source = "" if mesh is None else mesh.get("src", "")
        return int(key), (name, find_mesh(path.parent, source) if source else None)

    entries = {f"body {number}": entry for number, entry in enumerate(root.iter("body"), start=1)}
    bodies, unreadable = read_entries(path, entries, read_body, "an integer id and a name")
    return dict(bodies.values()), unreadable


def find_mesh(folder: Path, source: str) -> Path | None:
    """Find the mesh that a scene names: relative to the folder's parent, to the folder, or by its base name.

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


def read_mesh(path: Path) -> Float[np.ndarray, "v 3"]:
    """Read the vertices of a mesh, metres, in the frame of the body.

    Raises:
        InputFileError: if the file holds no triangles.
    """
    remedy = "Copy or download the file again, or remove it: the size of the object is then taken from a table."
    return read_triangles(path, remedy=remedy)[0]


SCENE = "scene"
_MESH_PREFIX = "mesh:"  # Role of a mesh: this and the name of its file.

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
    folder = existing_folder(root, "a folder of MoGaze recordings")
    parts: dict[str, list[InputFile]] = {}
    for folder in (root, root / "mogaze"):
        for match in filter(None, [_FILE_NAME.fullmatch(path.name) for path in sorted(folder.glob("*.hdf5"))]):
            parts.setdefault(match["id"], []).append(input_file(match["part"], folder / match[0]))
        if parts:
            break
    expected = "recordings of MoGaze: files like p1_1_human_data.hdf5"
    remedy = "Give the folder that the archive unpacks to (mogaze)."
    require(root, (len(parts) > 0, "", expected, names_in(root), remedy))
    tree = read_synthetic_tree(folder)
    dataset, splits = ("mogaze", {}) if tree is None else (f"{SYNTHETIC_PREFIX}mogaze", tree.split)
    excluded = {} if include_excluded else load_manifest("mogaze").excluded
    # The scene and the meshes that it names; of a damaged scene the file alone.
    shared = []
    scene = folder / mogaze.SCENE_FILE
    if is_present(scene):
        shared.append(input_file(SCENE, scene))
        try:
            meshes = sorted({mesh for _, mesh in read_scene(scene)[0].values() if mesh is not None})
        except InputFileError:
            meshes = []
        shared += [input_file(f"{_MESH_PREFIX}{mesh.relative_to(folder).as_posix()}", mesh) for mesh in meshes]
    return tuple(
        RecordingFiles(dataset, name, folder, (*files, *shared), split=splits.get(name), skip_reason=excluded.get(name))
        for name, files in sorted(parts.items())
    )


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """Return the streams of one recording: frames at one rate, all from frame 0, labels with nothing in hand."""
    human, objects, gaze, segments = mogaze.PARTS
    streams = {human: "body", objects: "objects", gaze: "gaze", segments: "labels"}
    extents = []
    for file in found.files:
        if file.role not in streams:
            continue
        try:
            with opened(file.path) as content:
                last = _last(content, file.role)
        except (InputFileError, KeyError):
            continue  # reading says what is wrong with it
        seconds = None if last is None else last / mogaze.RATE
        extents.append(Extent(streams[file.role], file.path.name, 0.0, seconds, tells_span=file.role != segments))
    return tuple(extents)


def _last(content: h5py.File, role: str) -> int | None:
    """Return the last frame of a file's shortest array or of its last label; None where it holds none."""
    if role == mogaze.PARTS[3]:
        rows = content[mogaze.SEGMENT_DATASET]
        if not isinstance(rows, h5py.Dataset) or rows.ndim != 1 or len(rows) == 0:
            return None
        return int(rows[len(rows) - 1][1])
    bodies = content.get(mogaze.OBJECT_GROUP)
    arrays = list(bodies.values()) if isinstance(bodies, h5py.Group) else []
    arrays += [content[name] for name in (mogaze.HUMAN_DATASET, mogaze.GAZE_DATASET) if name in content]
    frames = min((array.shape[0] for array in arrays if isinstance(array, h5py.Dataset) and array.ndim), default=0)
    return frames - 1 if frames else None


_BODY_KEY = re.compile(r"(?:.*\s)?(\d{1,19})")
_PARTICIPANT = re.compile(r"(p\d+)_\d+")


def read_readings(found: RecordingFiles, manifest: Manifest) -> mogaze.MogazeReadings:
    """Read one recording; all streams are cut to the shortest.

    Args:
        found: Its files.
        manifest: Sizes of objects whose mesh is missing.

    Raises:
        InputFileError: if a file is missing or damaged, or the files are not of one recording.
    """
    paths = [found.require(part, f"{found.recording_id}_{part}.hdf5") for part in mogaze.PARTS]
    human, objects, gaze, segmentations = paths
    with opened(human) as file:
        entry = dataset(human, file, mogaze.HUMAN_DATASET)
        table = numbers(human, entry, columns=len(mogaze.STATE_COLUMNS))
        columns = _words(_attribute(human, entry, mogaze.COLUMNS_ATTRIBUTE))
        keys = _words(_attribute(human, entry, mogaze.FIXED_KEYS_ATTRIBUTE))
        values = _number_attribute(human, entry, mogaze.FIXED_VALUES_ATTRIBUTE)
        participant = str(entry.attrs.get(mogaze.PARTICIPANT_ATTRIBUTE, ""))
    fixed = dict(zip(keys, values.tolist(), strict=False))
    named = f"a name for each of the {table.shape[1]} columns"
    has_names = len(columns) == table.shape[1]
    require(human, (has_names, mogaze.COLUMNS_ATTRIBUTE, named, f"{len(columns)} names", _COPY_AGAIN))
    for where, wanted, present in (
        (mogaze.COLUMNS_ATTRIBUTE, mogaze.STATE_COLUMNS, columns),
        (mogaze.FIXED_KEYS_ATTRIBUTE, sorted(mogaze.MODEL_OFFSETS), list(fixed)),
    ):
        missing = [f"'{name}'" for name in wanted if name not in present]
        expected = " and ".join([*missing[:1], *([f"{len(missing) - 1} more"] if len(missing) > 1 else [])])
        others = f"{len(present)} others: {', '.join(present[:6])} …" if present else "nothing"
        remedy = "Without it the body cannot be placed; copy or download the file again."
        require(human, (not missing, where, expected, others, remedy))
    where = f"dataset '{mogaze.HUMAN_DATASET}'"
    require(human, (len(table) >= 2, where, "frames of a body", len(table), ""))
    state = table[:, [columns.index(name) for name in mogaze.STATE_COLUMNS]]

    with opened(gaze) as file:
        entry = dataset(gaze, file, mogaze.GAZE_DATASET)
        gaze_rows = numbers(gaze, entry, columns=mogaze.FEWEST_GAZE_COLUMNS)
        calibration = _number_attribute(gaze, entry, mogaze.CALIBRATION_ATTRIBUTE)
    is_turn = len(calibration) == 4 and abs(np.linalg.norm(calibration) - 1) < 0.01
    shown = np.array2string(calibration, precision=3)
    require(gaze, (is_turn, mogaze.CALIBRATION_ATTRIBUTE, "a quaternion of length 1", shown, _COPY_AGAIN))

    poses, unreadable = _read_poses(objects)
    scene, odd_bodies = read_scene(found.require(SCENE, mogaze.SCENE_FILE))
    bodies = {key: scene.get(key, (f"body_{key}", None)) for key in poses}
    has_goggles = any(name == mogaze.GOGGLES for name, _ in bodies.values())
    expected = f"a body that {mogaze.SCENE_FILE} calls '{mogaze.GOGGLES}'"
    named = ", ".join(f"{key} ({name})" for key, (name, _) in bodies.items()) or "no body"
    remedy = f"Gaze starts at the goggles. Put {mogaze.SCENE_FILE} of the dataset beside the file."
    require(objects, (has_goggles, mogaze.OBJECT_GROUP, expected, named, remedy))
    messages = []

    # All streams share one frame index, and are cut to the shortest.
    lengths = {"human_data": len(state), "gaze_data": len(gaze_rows)}
    lengths |= {f"object_data, body {key}": len(rows) for key, rows in poses.items()}
    short = min(lengths, key=lambda name: lengths[name])
    long = max(lengths, key=lambda name: lengths[name])
    n = lengths[short]
    is_one_length = lengths[long] - n <= mogaze.LONGEST_LENGTH_DIFFERENCE * lengths[long]
    expected = "streams of one length: they share one frame index"
    differing = f"{n} frames of {short}, {lengths[long]} of {long}"
    remedy = "One of the files is truncated or belongs to another recording; copy or download them again."
    require(found.folder / found.recording_id, (is_one_length, "", expected, differing, remedy))
    if lengths[long] - n > mogaze.UNREMARKABLE_LENGTH_DIFFERENCE:
        messages.append(f"cut to {n} frames of {short}; {long} has {lengths[long]}")
    segments, odd_segments = _read_segments(segmentations)
    match = _PARTICIPANT.fullmatch(found.recording_id)
    names = (found.recording_id, match[1] if match else participant or found.recording_id)
    placed = tuple(_body(key, poses[key][:n], *body, manifest) for key, body in sorted(bodies.items()))
    sensed = (gaze_rows[:n, mogaze.GAZE_POINT], gaze_rows[:n, -1], calibration)
    told = (tuple(messages), (*unreadable, *odd_bodies, *odd_segments))
    return mogaze.MogazeReadings(*names, state[:n], fixed, placed, *sensed, segments, *told)


def _read_poses(path: Path) -> tuple[dict[int, Float[np.ndarray, "n 7"]], list[UnreadableEntry]]:
    """Return the position and quaternion (x y z w) of each tracked body by id, in the order of the file."""
    poses: dict[int, Float[np.ndarray, "n 7"]] = {}
    with opened(path) as file:
        bodies = _entry(path, file, mogaze.OBJECT_GROUP, h5py.Group, "a group")

        def read_body(key: str) -> None:
            match = _BODY_KEY.fullmatch(key)
            number = -1 if match is None else int(match[1])
            expected = "a key that ends with an integer id, each id once"
            require(path, (number >= 0 and number not in poses, key, expected, f"'{key}'", _OTHER_FILE))
            poses[number] = numbers(path, dataset(path, bodies, key), columns=7)[:, :7]

        _, unreadable = read_entries(path, {f"{mogaze.OBJECT_GROUP}/{key}": str(key) for key in bodies}, read_body)
    return poses, unreadable


def _body(
    key: int, rows: Float[np.ndarray, "n 7"], name: str, mesh: Path | None, manifest: Manifest
) -> mogaze.MogazeBody:
    if mesh is not None:
        vertices = read_mesh(mesh)
        box_min = vertices.min(axis=0)
        box_max = vertices.max(axis=0)
    else:
        box_min, box_max = np.array(manifest.object_extents.get(mogaze.kind_of_body(name), ((0.0, 0.0),) * 3)).T
    return mogaze.MogazeBody(key, name, rows[:, :3], rows[:, 3:], box_min, box_max)


def _read_segments(path: Path) -> tuple[tuple[mogaze.Segment, ...], list[UnreadableEntry]]:
    with opened(path) as file:
        rows = stored_values(path, dataset(path, file, mogaze.SEGMENT_DATASET))
    names = rows.dtype.names or ()
    where = f"dataset '{mogaze.SEGMENT_DATASET}'"
    require(path, (len(names) >= 3, where, "rows of start, end and label", rows.dtype, _OTHER_FILE))
    start, end, label = (rows[name].tolist() for name in names[:3])
    listed = zip(start, end, _words(label), strict=True)
    entries = {f"{mogaze.SEGMENT_DATASET}[{number}]": row for number, row in enumerate(listed)}
    segments, unreadable = read_entries(path, entries, _segment, "two frames and a label")
    return tuple(segments.values()), unreadable


def _segment(row: tuple[float, float, str]) -> mogaze.Segment:
    start, end, label = row
    if not all(isinstance(frame, int | float) and float(frame).is_integer() for frame in (start, end)):
        raise ValueError(f"{start} to {end} ({label})")
    return mogaze.Segment(int(start), int(end), label)
