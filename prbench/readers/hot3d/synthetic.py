"""Native files of HOT3D (docs/specification/hot3d.md)."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import msgspec
import numpy as np

from prbench.files.storage import atomic_folder, read_json, write_bytes, write_json
from prbench.readers.aria_mps.synthetic import split_columns, write_csv, write_mps
from prbench.readers.aria_mps.synthetic_sensors import GAZE_RATE, gaze_bias
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.synthetic import write_outputs, write_smplh_model
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import hands_umetrack as umetrack
from prbench.readers.hot3d import synthetic_sensors as sensors
from prbench.readers.hot3d.format import HandModel
from prbench.readers.hot3d.to_recording import recording_from_hot3d
from prbench.synthetic.layouts import SHARED_PARTS, Layout
from prbench.synthetic.people.truth import seen_again
from prbench.synthetic.performance import Performance, TrueEvent

_HEADSET_UID = "100000000000001"
LIBRARY = hot3d.LIBRARY_FOLDERS[0]
_OTHER_MASKS = ("good_exposure", "hand_visible", "object_visible")
"""Files that a recording has and curation does not read; all true."""
_OF_AN_EVENT = ("sequence", "not_primed", "too_short", "minimum_movement")
_UNSET = 255.0
"""Of the hand model's unused tables of joints."""
_SCALE = 0.001  # the models of the release are in millimetres, scaled by their node
_QUARTER_TURN = (0.0, -np.sqrt(0.5), 0.0, np.sqrt(0.5))  # x y z w, about the vertical
_SHIFT = (0.0045, -0.0205, -0.0155)
_MAGIC = 0x46546C67
_JSON = 0x4E4F534A
_BINARY = 0x004E4942
_FLOAT = 5126
_SHORT = 5123
_TRIANGLES = 4


def write(readings: hot3d.Hot3dReadings, folder: Path) -> None:
    """Write the files of one recording: complete or not at all.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    with atomic_folder(folder) as target:
        write_json(
            target / hot3d.METADATA_FILE,
            {
                "gt_available_status": {
                    "mano_hand_pose_gt": False,
                    "object_pose_gt": True,
                    "umetrack_hand_pose_gt": True,
                },
                "headset": hot3d.ARIA,
                "participant_id": readings.participant_id,
                "recording_name": readings.recording_id,
            },
        )
        bodies = {entry.object_id: entry.rows for entry in readings.objects}
        write_csv(target / hot3d.OBJECTS_FILE, pose_columns(bodies))
        write_csv(target / hot3d.HEADSET_FILE, pose_columns({_HEADSET_UID: readings.headset}))
        _write_hands(readings, target / hot3d.UMETRACK_FILE)
        if readings.hand_model is not None:
            write_json(target / hot3d.PROFILE_FILE, {"hand_model": profile(readings.hand_model)})
        _write_masks(readings, target / hot3d.MASK_FOLDER)
        write_mps(readings.mps, target / hot3d.MPS_FOLDER)
        write_outputs(readings.egoallo_outputs, target / ego.OUTPUT_FOLDER)


def write_library_part(readings: hot3d.Hot3dReadings, folder: Path) -> None:
    """Write names and models of one recording's objects."""
    instances = {
        entry.object_id: _instance(entry.object_id, entry.name, hot3d.LIBRARY_OBJECT) for entry in readings.objects
    }
    write_json(folder / hot3d.INSTANCES_FILE, instances)
    for entry in readings.objects:
        if entry.mesh is not None:
            content = glb_bytes(entry.mesh, name=entry.name, turned=int(entry.object_id) % 2 == 1)
            write_bytes(folder / f"{entry.object_id}.glb", content)


def glb_bytes(mesh: hot3d.ObjectMesh, *, name: str, turned: bool) -> bytes:
    """Return the file of one model: the node's transform brings its raw vertices into the object's frame.

    Args:
        mesh: In the object's frame, metres; less than 65,536 vertices.
        name: Of the node.
        turned: Whether the node turns and shifts what it holds, besides scaling it.
    """
    node: dict[str, object] = {"name": name, "mesh": 0, "scale": [_SCALE] * 3}
    raw = mesh.vertices
    if turned:
        node |= {"rotation": list(_QUARTER_TURN), "translation": list(_SHIFT)}
        x, y, z = (raw - _SHIFT).T
        raw = np.column_stack([z, y, -x])  # the node turns it back: (x, y, z) becomes (-z, y, x)
    vertices = (raw / _SCALE).astype("<f4")  # glTF knows single precision only
    faces = mesh.faces.astype("<u2")
    content = vertices.tobytes() + faces.tobytes()
    description = {
        "asset": {"version": "2.0", "generator": "prbench"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": _TRIANGLES}]}],
        "accessors": [
            {
                "type": "VEC3",
                "componentType": _FLOAT,
                "count": len(vertices),
                "bufferView": 0,
                "min": vertices.min(axis=0).tolist(),
                "max": vertices.max(axis=0).tolist(),
            },
            {"type": "SCALAR", "componentType": _SHORT, "count": faces.size, "bufferView": 1},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": vertices.nbytes},
            {"buffer": 0, "byteOffset": vertices.nbytes, "byteLength": faces.nbytes},
        ],
        "buffers": [{"byteLength": len(content)}],
    }
    text = json.dumps(description).encode()
    chunks = _chunk(_JSON, text, b" ") + _chunk(_BINARY, content, b"\0")
    return struct.pack("<III", _MAGIC, 2, 12 + len(chunks)) + chunks


def _chunk(kind: int, content: bytes, padding: bytes) -> bytes:
    content += padding * (-len(content) % 4)
    return struct.pack("<II", len(content), kind) + content


def _finish(root: Path) -> None:
    """Gather the parts of all recordings into the object library, and write the body model.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    headset = {_HEADSET_UID: _instance(_HEADSET_UID, "Aria", "headset")}
    instances: dict[str, object] = dict(headset)
    library = root / LIBRARY
    library.mkdir(exist_ok=True)
    for part in sorted((root / SHARED_PARTS).iterdir()):
        names = read_json(part / hot3d.INSTANCES_FILE)
        assert isinstance(names, dict)  # written above
        instances |= names
        for model in sorted(part.glob("*.glb")):
            model.replace(library / model.name)
    write_json(library / hot3d.INSTANCES_FILE, instances)
    write_smplh_model(root / ego.MODEL_FILE)


def pose_columns(bodies: dict[str, hot3d.PoseRows]) -> dict[str, object]:
    """Return columns of a pose table, rows in the order of time."""
    times = np.concatenate([rows.time_ns for rows in bodies.values()])
    order = np.argsort(times, kind="stable")
    uids = np.concatenate([np.full(len(rows.time_ns), uid) for uid, rows in bodies.items()])
    return {
        hot3d.OBJECT_ID: uids[order],
        hot3d.TIME: times[order],
        **split_columns(hot3d.POSITION, np.concatenate([rows.position for rows in bodies.values()])[order]),
        **split_columns(hot3d.ROTATION, np.concatenate([rows.rotation for rows in bodies.values()])[order]),
    }


def _write_hands(readings: hot3d.Hot3dReadings, path: Path) -> None:
    """Write one line an instant, also where no hand is tracked."""
    lines: dict[int, dict[str, object]] = {time: {} for time in readings.headset.time_ns.tolist()}
    for hand in readings.hands:
        numbers = zip(
            hand.time_ns.tolist(),
            hand.position.tolist(),
            hand.rotation.tolist(),
            hand.angles.tolist(),
            strict=True,
        )
        for time, position, rotation, angles in numbers:
            lines[time][hot3d.HAND_KEYS[hand.side]] = {
                "wrist_xform": {"t_xyz": position, "q_wxyz": rotation},
                "joint_angles": angles,
                "hand_confidence": 1.0,
            }
    records = [{"timestamp_ns": time, "hand_poses": poses} for time, poses in lines.items()]
    write_bytes(path, b"".join(msgspec.json.encode(record) + b"\n" for record in records))


def profile(model: HandModel) -> dict[str, object]:
    """Return the hand model with the keys of ``umetrack_hand_user_profile.json``, lengths in millimetres."""
    bones = model.landmark_weights.argmax(axis=1)
    firsts = [joint % umetrack.JOINTS_A_FINGER == 0 for joint in range(umetrack.N_JOINTS)]
    return {
        "dense_bone_weights": model.weights.tolist(),
        "hand_scale": 1.0,
        "joint_first_child": [_UNSET] * umetrack.N_JOINTS,
        "joint_frame_index": [_UNSET] * umetrack.N_JOINTS,
        "joint_limits": [[-np.pi, np.pi]] * umetrack.N_JOINTS,
        "joint_next_sibling": [_UNSET] * umetrack.N_JOINTS,
        "joint_parent": [_UNSET if first else float(joint - 1) for joint, first in enumerate(firsts)],
        "joint_rest_positions": _millimetres(model.joint_positions),
        "joint_rotation_axes": model.joint_axes.tolist(),
        "landmark_rest_bone_indices": [[int(bone)] * 3 for bone in bones],
        "landmark_rest_bone_weights": [[1.0, 0.0, 0.0]] * umetrack.N_LANDMARKS,
        "landmark_rest_positions": _millimetres(model.landmarks),
        "mesh_triangles": model.triangles.astype(float).tolist(),
        "mesh_vertices": _millimetres(model.vertices),
    }


def _millimetres(points: np.ndarray) -> list[list[float]]:
    return np.round(points / umetrack.METRES_A_UNIT, 6).tolist()


def _write_masks(readings: hot3d.Hot3dReadings, folder: Path) -> None:
    all_times = readings.headset.time_ns
    truth = hot3d.MaskRows(all_times[::2], np.ones(len(all_times[::2]), dtype=bool))
    for name, rows in {**dict.fromkeys(_OTHER_MASKS, truth), **readings.masks}.items():
        write_csv(folder / f"mask_{name}.csv", _mask_columns(rows))


def _mask_columns(rows: hot3d.MaskRows) -> dict[str, object]:
    """Return one row a camera and frame: the RGB frame, then both SLAM cameras' one after it."""
    slam = rows.time_ns + round(sensors.SLAM_DELAY * 1e9)
    streams = (hot3d.RGB_STREAM, *hot3d.SLAM_STREAMS)
    return {
        hot3d.TIME: np.column_stack([rows.time_ns, slam, slam]).ravel(),
        hot3d.STREAM: np.tile(streams, len(rows.time_ns)),
        hot3d.MASK: np.repeat(np.where(rows.good, "True", "False"), len(streams)),
    }


def _instance(uid: str, name: str, kind: str) -> dict[str, object]:
    return {
        "instance_bop_id": "0",
        "instance_id": uid,
        "instance_name": name,
        "instance_type": kind,
        "motion_type": "dynamic",
        "rigidity": "rigid",
    }


def _write_below(readings: hot3d.Hot3dReadings, root: Path) -> None:
    """Write one folder a recording; the models of its objects wait for :func:`_finish`."""
    write(readings, root / readings.recording_id)
    write_library_part(readings, root / SHARED_PARTS / readings.recording_id)


def _events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return all events; whether a prime is certain depends on the ten gaze samples a second."""
    return tuple(
        seen_again(event, performance, event.box_min, event.box_max, gaze_period=1.0 / GAZE_RATE)
        if event.expected in _OF_AN_EVENT
        else event
        for event in performance.events
    )


LAYOUT = Layout(
    dataset="hot3d",
    sense=sensors.sense,
    to_recording=recording_from_hot3d,
    write=_write_below,
    finish=_finish,
    events=_events,
    clock_start=sensors.clock_start,
    object_id=sensors.native_object_id,
    gaze_bias=gaze_bias,
)
