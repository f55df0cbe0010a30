"""The content of the files of one MoGaze recording (docs/specification/mogaze.md#files)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.protocol.manifests import Manifest
from prbench.readers.found import RecordingFiles
from prbench.readers.mogaze import body as mogaze_body
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.arrays import (
    attribute,
    dataset,
    group,
    number_attribute,
    numbers,
    opened,
    stored_values,
    words,
)
from prbench.readers.mogaze.layouts import SCENE
from prbench.readers.mogaze.scene import SceneBody, read_mesh, read_scene

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
    state, fixed, participant = _read_human(human)
    poses = _read_poses(objects)
    scene_file = found.path(SCENE)
    scene = {} if scene_file is None else read_scene(scene_file)
    bodies = _named(objects, poses, scene)
    naming = "" if scene else f"no {mogaze.SCENE_FILE}: the bodies have their names by the order of their keys"
    points, confidence, calibration = _read_gaze(gaze)
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


def _read_human(path: Path) -> tuple[Float[np.ndarray, "n 66"], dict[str, float], str]:
    with opened(path) as file:
        entry = dataset(path, file, mogaze.HUMAN_DATASET)
        table = numbers(path, entry, columns=len(mogaze_body.STATE_COLUMNS))
        names = words(attribute(path, entry, mogaze.COLUMNS_ATTRIBUTE))
        keys = words(attribute(path, entry, mogaze.FIXED_KEYS_ATTRIBUTE))
        values = number_attribute(path, entry, mogaze.FIXED_VALUES_ATTRIBUTE).ravel()
        participant = str(entry.attrs.get(mogaze.PARTICIPANT_ATTRIBUTE, ""))
    if len(names) != table.shape[1]:
        raise InputFileError(
            path,
            mogaze.COLUMNS_ATTRIBUTE,
            expected=f"a name for each of the {table.shape[1]} columns",
            found=f"{len(names)} names",
            remedy="Copy or download the file again.",
        )
    _require(path, mogaze.COLUMNS_ATTRIBUTE, mogaze_body.STATE_COLUMNS, names)
    fixed = dict(zip(keys, values.tolist(), strict=False))
    _require(path, mogaze.FIXED_KEYS_ATTRIBUTE, sorted(mogaze_body.MODEL_OFFSETS), list(fixed))
    if len(table) < 2:
        raise InputFileError(
            path, _named_dataset(mogaze.HUMAN_DATASET), expected="frames of a body", found=f"{len(table)}"
        )
    return table[:, [names.index(name) for name in mogaze_body.STATE_COLUMNS]], fixed, participant


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


def _named(path: Path, poses: dict[int, Float[np.ndarray, "n 7"]], scene: dict[int, SceneBody]) -> dict[int, SceneBody]:
    """Bodies by id: the scene's, else by their order, else without a name of their own."""
    if scene:
        bodies = {key: scene.get(key, SceneBody(f"body_{key}", None)) for key in poses}
    else:
        names = mogaze.BODIES_WITHOUT_SCENE if len(poses) == len(mogaze.BODIES_WITHOUT_SCENE) else ()
        bodies = {key: SceneBody(names[index] if names else f"body_{key}", None) for index, key in enumerate(poses)}
    if all(body.name != mogaze.GOGGLES for body in bodies.values()):
        raise InputFileError(
            path,
            mogaze.OBJECT_GROUP,
            expected=f"a body that {mogaze.SCENE_FILE} calls '{mogaze.GOGGLES}'",
            found=", ".join(f"{key} ({body.name})" for key, body in bodies.items()) or "no body",
            remedy=f"Gaze starts at the goggles. Put {mogaze.SCENE_FILE} of the dataset beside the file.",
        )
    return bodies


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


def _read_gaze(path: Path) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"], Float[np.ndarray, "4"]]:
    with opened(path) as file:
        entry = dataset(path, file, mogaze.GAZE_DATASET)
        table = numbers(path, entry, columns=mogaze.FEWEST_GAZE_COLUMNS)
        calibration = number_attribute(path, entry, mogaze.CALIBRATION_ATTRIBUTE).ravel()
    if len(calibration) != 4 or not abs(np.linalg.norm(calibration) - 1) < 0.01:
        raise InputFileError(
            path,
            mogaze.CALIBRATION_ATTRIBUTE,
            expected="a quaternion of length 1",
            found=np.array2string(calibration, precision=3),
            remedy="Copy or download the file again.",
        )
    return table[:, mogaze.GAZE_POINT], table[:, -1], calibration


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
