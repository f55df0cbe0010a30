"""Native files of MoGaze: four HDF5 files a recording, and a scene with meshes for all.

Source: docs/specification/mogaze.md.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from xml.sax.saxutils import quoteattr

import h5py
import msgspec
import numpy as np
from jaxtyping import Float

from prbench.files.storage import atomic_path, write_json, write_text
from prbench.protocol.manifests import load_manifest
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze import synthetic_sensors as sensors
from prbench.readers.mogaze.body import STATE_COLUMNS
from prbench.readers.mogaze.to_recording import recording_from_mogaze
from prbench.synthetic.layouts import SHARED_PARTS, Layout

_GAZE_COLUMNS = 7
_COLOUR = "1 0.5 0.5 0.5"
_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
_FACES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip


class _SceneEntry(msgspec.Struct, frozen=True):
    """One body of the scene as recordings hand it over."""

    body_id: int
    name: str
    mesh: str
    """Name of its file; empty without a mesh."""
    low: tuple[float, float, float]
    high: tuple[float, float, float]


_ENTRIES = msgspec.json.Decoder(list[_SceneEntry])


def write(readings: mogaze.MogazeReadings, root: Path) -> None:
    """Write the four files of one recording below the dataset's folder.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    root.mkdir(parents=True, exist_ok=True)
    writers = (_write_human, _write_objects, _write_gaze, _write_segments)
    for part, writer in zip(mogaze.PARTS, writers, strict=True):
        with (
            atomic_path(root / f"{readings.recording_id}_{part}.hdf5") as temporary,
            h5py.File(temporary, "w", track_order=False) as file,
        ):
            writer(file, readings)


def _write_scene(root: Path, entries: dict[int, _SceneEntry]) -> None:
    """Write ``scene.xml`` and one box mesh for each shape that it names."""
    lines = ['<?xml version="1.0"?>', "<scene>"]
    meshes: dict[str, _SceneEntry] = {}
    for key, entry in sorted(entries.items()):
        lines.append(f'  <body id="{key}" name={quoteattr(entry.name)}>')
        if entry.mesh:
            meshes[entry.mesh] = entry
            lines.append(f"    <meshfile src={quoteattr(f'mogaze/{mogaze.MESH_FOLDER}/{entry.mesh}')}/>")
        lines += [f"    <color>{_COLOUR}</color>", "  </body>"]
    for name, entry in sorted(meshes.items()):
        write_text(root / mogaze.MESH_FOLDER / name, box_mesh(np.array(entry.low), np.array(entry.high)))
    write_text(root / mogaze.SCENE_FILE, "\n".join([*lines, "</scene>", ""]))


def box_mesh(low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> str:
    """Return a box of twelve triangles as Wavefront OBJ; its numbers survive the text bit for bit."""
    corners = np.where(_CORNERS, high, low).tolist()
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners]
    return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in _FACES), ""])


def _write_human(file: h5py.File, readings: mogaze.MogazeReadings) -> None:
    entry = file.create_dataset(mogaze.HUMAN_DATASET, data=readings.state)
    entry.attrs[mogaze.COLUMNS_ATTRIBUTE] = np.array(STATE_COLUMNS, dtype="S")
    entry.attrs[mogaze.START_ATTRIBUTE] = 0
    entry.attrs[mogaze.FIXED_KEYS_ATTRIBUTE] = np.array(list(readings.fixed), dtype="S")
    entry.attrs[mogaze.FIXED_VALUES_ATTRIBUTE] = np.array(list(readings.fixed.values()))
    entry.attrs[mogaze.PARTICIPANT_ATTRIBUTE] = readings.participant_id


def _write_objects(file: h5py.File, readings: mogaze.MogazeReadings) -> None:
    bodies = file.create_group(mogaze.OBJECT_GROUP)
    for body in readings.bodies:
        bodies.create_dataset(f"body {body.body_id}", data=np.hstack([body.position, body.rotation]))


def _write_gaze(file: h5py.File, readings: mogaze.MogazeReadings) -> None:
    """Write one row more than the other files have, as in the release; columns of unknown meaning are zero."""
    rows = np.zeros((len(readings.gaze_points) + 1, _GAZE_COLUMNS))
    rows[:-1, mogaze.GAZE_POINT], rows[:-1, -1] = readings.gaze_points, readings.gaze_confidence
    rows[-1] = rows[-2]
    entry = file.create_dataset(mogaze.GAZE_DATASET, data=rows)
    entry.attrs[mogaze.CALIBRATION_ATTRIBUTE] = readings.calibration


def _write_segments(file: h5py.File, readings: mogaze.MogazeReadings) -> None:
    kinds = np.dtype([("start", "<i8"), ("end", "<i8"), ("label", f"S{mogaze.LABEL_LENGTH}")])
    rows = [(segment.start, segment.end, segment.label.encode()) for segment in readings.segments]
    entry = file.create_dataset(mogaze.SEGMENT_DATASET, data=np.array(rows, dtype=kinds))
    labels = dict.fromkeys([mogaze.NULL_LABEL, *(segment.label for segment in readings.segments)])
    entry.attrs[mogaze.LABELS_ATTRIBUTE] = np.array(list(labels), dtype="S")


def _scene_entry(body: mogaze.MogazeBody) -> _SceneEntry:
    kind = mogaze.kind_of_body(body.name)
    known = load_manifest("mogaze").object_extents.get(kind)
    shared = known is not None and np.array_equal(np.transpose(known), [body.box_min, body.box_max])
    own_mesh = f"{kind}.obj" if shared else f"body_{body.body_id}.obj"
    mesh = "" if body.name == mogaze.GOGGLES else own_mesh
    return _SceneEntry(body.body_id, body.name, mesh, tuple(body.box_min.tolist()), tuple(body.box_max.tolist()))


def _write_below(readings: mogaze.MogazeReadings, root: Path) -> None:
    """Write four files, and the recording's share of the scene."""
    write(readings, root)
    entries = [_scene_entry(body) for body in readings.bodies]
    write_json(root / SHARED_PARTS / f"{readings.recording_id}.json", msgspec.to_builtins(entries))


def _finish(root: Path) -> None:
    """Write scene and meshes of all recordings."""
    parts = sorted((root / SHARED_PARTS).glob("*.json"))
    entries = [entry for part in parts for entry in _ENTRIES.decode(part.read_bytes())]
    _write_scene(root, {entry.body_id: entry for entry in entries})


LAYOUT = Layout(
    dataset="mogaze",
    sense=sensors.sense,
    to_recording=recording_from_mogaze,
    write=_write_below,
    finish=_finish,
    events=sensors.events,
    clock_start=lambda _: 0.0,  # the first frame is time 0
    object_id=lambda object_id: object_id,
    gaze_bias=sensors.gaze_bias,
)
