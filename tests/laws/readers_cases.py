"""Native files of every dataset that are damaged: refused with file, place, what was expected and what was found."""

from __future__ import annotations

import io
import json
import os
import pickle
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import torch

from prbench.errors import RecordingUnusable
from prbench.readers import reader_for
from prbench.readers.adt import synthetic as adt_layout
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import find_mps_files, read_gaze_angles, read_mps, read_near
from prbench.readers.aria_mps.synthetic import sense_mps, write_mps
from prbench.readers.egoallo.bodies import read_output, read_smplh_rest
from prbench.readers.found import RecordingFiles
from prbench.readers.gimo.bodies import read_pose_decoder, read_rest_joints
from prbench.readers.gimo.bvh import read_bvh, write_bvh
from prbench.readers.gimo.gaze import read_vertices
from prbench.readers.gimo.pickles import load_tensors
from prbench.readers.gimo.synthetic import pickled_tensors, ply_bytes
from prbench.readers.gimo.table import read_segments
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.annotations import read_video_clock
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.hands import N_BONES, N_JOINTS, read_profile
from prbench.readers.hot3d.synthetic import sense
from prbench.readers.mogaze import format as mogaze
from prbench.synthetic.people import perform
from prbench.synthetic.sensors import Switches
from tests.laws.cases import BadInput, bad_files
from tests.readers import egoallo_files, gimo_sample
from tests.readers.conftest import still_life
from tests.readers.damages import (
    Damage,
    cut,
    edit_cells,
    edit_json,
    edit_lines,
    keep,
    keep_header,
    remove,
    replace_text,
    set_cell,
    swap_columns,
    swap_lines,
    write_text,
)
from tests.readers.hd_epic_copies import FIRST, write_copy
from tests.readers.hot3d_trees import first_seconds, write_tree
from tests.readers.mps_files import gaze_lines, trajectory_lines, write_lines
from tests.readers.own.plain import write_short
from tests.recording.mogaze_scene import N, write_scene
from tests.shared import made_once


def told(damage: Damage, *parts: str) -> tuple[Damage, Sequence[str]]:
    """Return a damage with parts of the message that it must lead to."""
    return damage, parts


def _reads(dataset: str, recording: str | None = None, **options: str) -> Callable[[Path], object]:
    """Return a function that finds the recordings below a folder and reads one."""

    def read(root: Path) -> object:
        reader = reader_for(dataset, options)
        return reader.read(next(each for each in reader.find(root) if recording in (None, each.recording_id)))

    return read


def copy_of(name: str, make: Callable[[Path], object], below: str = "") -> Callable[[Path], Path]:
    """Return a function that copies a folder, which is made once a run, into another one."""
    return lambda folder: Path(shutil.copytree(made_once(name, make), folder / name)) / below


def write_adt(folder: Path) -> Path:
    adt_layout.write(still_life(), folder / "still_life")
    return folder / "still_life"


ADT = {
    "no objects": told(remove("scene_objects.csv"), "scene_objects.csv", "no such file", "Download"),
    "no gaze": told(remove("eyegaze.csv"), "eyegaze.csv", "no such file"),
    "no trajectory": told(remove("aria_trajectory.csv"), "aria_trajectory.csv", "no such file"),
    "no metadata": told(remove("metadata.json"), "metadata.json", "no such file"),
    "listed skeleton absent": told(remove("Skeleton_T.json"), "Skeleton_T.json", "no such file"),
    "csv cut within a line": told(cut("aria_trajectory.csv", 60), "aria_trajectory.csv", "truncated"),
    "cut number": told(cut("scene_objects.csv", 2), "scene_objects.csv, last line", "line break", "truncated"),
    "few cells": told(
        edit_cells("scene_objects.csv", 7, lambda cells: cells[:4]),
        "scene_objects.csv, line 7",
        "9 columns, got 4",
        "truncated",
    ),
    "json cut": told(cut("Skeleton_T.json", 500), "Skeleton_T.json", "valid JSON", "truncated"),
    "column renamed": told(
        set_cell("eyegaze.csv", 1, 2, "pitch"),
        "eyegaze.csv, header",
        "'pitch_rads_cpf'",
        "yaw_rads_cpf, pitch, depth_m",
    ),
    "word for a number": told(set_cell("eyegaze.csv", 3, 1, "left"), "eyegaze.csv, line 3", "'left'"),
    "no time": told(set_cell("eyegaze.csv", 3, 0, ""), "eyegaze.csv, line 3", "tracking_timestamp_us", "nothing"),
    "NaN in a pose": told(set_cell("aria_trajectory.csv", 5, 3, "nan"), "aria_trajectory.csv, line 5", "finite"),
    "NaN in an object's pose": told(set_cell("scene_objects.csv", 9, 4, ""), "scene_objects.csv, line 9", "finite"),
    "long quaternion": told(set_cell("scene_objects.csv", 9, 5, "0.5"), "scene_objects.csv, line 9", "length 1", "0.5"),
    "glasses' clock backwards": told(
        swap_lines("aria_trajectory.csv", 10, 11),
        "aria_trajectory.csv, line 11",
        "a time after 5000300000 us",
        "5000266667 us",
        "backwards",
    ),
    "gaze clock stands still": told(
        set_cell("eyegaze.csv", 4, 0, "5000033330"), "eyegaze.csv, line 4", "a time after 5000033330 us"
    ),
    "object's clock backwards": told(
        swap_lines("scene_objects.csv", 20, 21), "scene_objects.csv, line 21", "backwards"
    ),
    "object both still and moving": told(
        set_cell("scene_objects.csv", 4, 1, "-1"), "scene_objects.csv, line", "one row of time -1", "both"
    ),
    "body's clock backwards": told(
        edit_json("Skeleton_T.json", lambda content: content["frames"].insert(4, content["frames"].pop(5))),
        "Skeleton_T.json, frame 5",
        "backwards",
    ),
    "no frames": told(
        edit_json("Skeleton_T.json", lambda content: content["frames"].clear()), "frames of a body", "none"
    ),
    "no gaze rows": told(keep_header("eyegaze.csv"), "eyegaze.csv", "gaze rows", "none"),
    "no poses": told(keep_header("aria_trajectory.csv"), "aria_trajectory.csv", "at least one pose", "none"),
    "another clock": told(
        edit_json("metadata.json", lambda content: content.update(gt_time_domain="TIME_CODE")),
        "metadata.json, gt_time_domain",
        "'DEVICE_CAPTURE'",
        "'TIME_CODE'",
    ),
    "clock not named": told(
        edit_json("metadata.json", lambda content: content.pop("gt_time_domain")),
        "metadata.json, gt_time_domain",
        "nothing",
    ),
    "layout v1.x": told(
        edit_json("metadata.json", lambda content: content.update(subtours={"0": {}}, gt_time_domain=None)),
        "subtours: expected layout v2.0, found layout v1.x",
    ),
    "another up": told(
        edit_cells("aria_trajectory.csv", 2, lambda cells: [*cells[:16], "0", "0", "-9.81", *cells[19:]]),
        "aria_trajectory.csv, gravity columns",
        "-Y",
        "[0.0, 0.0, 1.0]",
    ),
    "association damaged": told(cut("skeleton_aria_association.json", 20), "skeleton_aria_association.json", "JSON"),
    "metadata damaged": told(cut("metadata.json", 4), "metadata.json: expected valid JSON"),
    "metadata that is no text": told(
        lambda folder: (folder / "metadata.json").write_bytes(b'{"gt_time_domain": "DEVI\xffE"}'),
        "metadata.json: expected valid JSON",
    ),
}


def write_hot3d(root: Path) -> None:
    performance = perform("hot3d", seed=11, index=0, n_events=2, provocations={})
    readings = first_seconds(sense(performance, switches=replace(Switches(), hand_losses=False)), 2.0)
    write_tree(readings, root).rename(root / "P0001_a")


def _first_model(change: Callable[[bytes], bytes]) -> Damage:
    def damage(root: Path) -> None:
        path = min((root / "assets").glob("*.glb"))
        path.write_bytes(change(path.read_bytes()))

    return damage


def _more_corners_than_bytes(content: bytes) -> bytes:
    """Declare 999,999,999 values in a model's first accessor."""
    count = re.search(rb'"count":\s*(\d+)', content)
    assert count is not None
    longer = content[: count.start(1)] + b"9" * 9 + content[count.end(1) :]
    length = int.from_bytes(content[12:16], "little") + len(longer) - len(content)
    return longer[:12] + length.to_bytes(4, "little") + longer[16:]


_OBJECTS = f"P0001_a/{hot3d.OBJECTS_FILE}"
_PROMISED = ["metadata.json says that this ground truth is there"]
HOT3D = {
    "metadata without flags": told(
        write_text("P0001_a/metadata.json", '{"headset": "Aria"}'), "missing required field"
    ),
    "metadata cut off": told(write_text("P0001_a/metadata.json", '{"headset": "Ar'), "valid JSON"),
    "no objects": told(remove(_OBJECTS), hot3d.OBJECTS_FILE),
    "no headset": told(remove(f"P0001_a/{hot3d.HEADSET_FILE}"), hot3d.HEADSET_FILE),
    "no hands": told(remove(f"P0001_a/{hot3d.UMETRACK_FILE}"), hot3d.UMETRACK_FILE),
    "no trajectory": told(remove("P0001_a/mps/slam/closed_loop_trajectory.csv"), "closed_loop_trajectory.csv"),
    "no gaze": told(remove("P0001_a/mps/eye_gaze/personalized_eye_gaze.csv"), "eye_gaze"),
    "no names": told(remove("assets/instance.json"), "instance.json"),
    "no rows of objects": told(keep_header(_OBJECTS), *_PROMISED),
    "no rows of the headset": told(keep_header(f"P0001_a/{hot3d.HEADSET_FILE}"), *_PROMISED),
    "no lines of hands": told(write_text(f"P0001_a/{hot3d.UMETRACK_FILE}", ""), *_PROMISED),
    "NaN in a pose": told(set_cell(_OBJECTS, 31, 3, "nan"), "line 31: expected a pose of finite numbers"),
    "long quaternion": told(set_cell(_OBJECTS, 31, 5, "1.1"), "line 31: expected a quaternion of length 1"),
    "clock backwards": told(set_cell(_OBJECTS, 31, 1, "17"), "line 31: expected a time after"),
    "word for a time": told(set_cell(_OBJECTS, 31, 1, "soon"), "line 31"),
    "a row twice": told(
        edit_lines(_OBJECTS, lambda lines: lines.insert(31, lines[30])), "line 32: expected a time after", "repeated"
    ),
    "headsets only": told(
        replace_text("assets/instance.json", '"object"', '"headset"'), "expected objects, found headsets only"
    ),
    "a model cut off": told(_first_model(lambda content: content[:50]), ".glb: expected a model in binary glTF"),
    "a model of too many corners": told(
        _first_model(_more_corners_than_bytes), ".glb, accessors: expected at most", "found 999,999,999"
    ),
    "a trajectory that is not Z up": told(
        swap_columns("P0001_a/mps/slam/closed_loop_trajectory.csv", "gravity_y_world", "gravity_z_world"),
        "expected gravity along -Z",
    ),
}


def _profile(folder: Path) -> Path:
    profile = {
        "mesh_vertices": [[0, 0, 0], [10, 0, 0], [0, 10, 0]],
        "dense_bone_weights": [[1.0] + [0.0] * (N_BONES - 1)] * 3,
        "joint_rest_positions": [[0, 0, 0]] * N_JOINTS,
        "joint_rotation_axes": [[1, 0, 0]] * N_JOINTS,
    }
    (folder / "profile.json").write_text(json.dumps({"hand_model": profile}))
    return folder


def _in_profile(key: str, value: object) -> Damage:
    return edit_json("profile.json", lambda content: content["hand_model"].update({key: value}))


HAND_PROFILE = {
    "ragged weights": told(
        _in_profile("dense_bone_weights", [[1.0], [0.5, 0.5], [1.0]]),
        "profile.json, dense_bone_weights, row 0: expected",
    ),
    "no weights": told(_in_profile("dense_bone_weights", []), "profile.json, dense_bone_weights: expected"),
    "huge weights": told(
        _in_profile("dense_bone_weights", [[1e308] * N_BONES] * 3), "profile.json, dense_bone_weights, row 0: expected"
    ),
    "a huge hand": told(_in_profile("mesh_vertices", [[1e300, 0, 0]] * 3), "profile.json, mesh_vertices"),
}


def _below(pattern: str, change: Callable[[Path], object]) -> Damage:
    """Change the only file that matches a pattern."""

    def damage(root: Path) -> None:
        (path,) = root.glob(pattern)
        change(path)

    return damage


def _tilted(archive: Path) -> None:
    """Unpack an archive of SLAM, and exchange two axes of gravity."""
    shutil.unpack_archive(archive, archive.parent)
    archive.unlink()
    name = f"0/{mps.SLAM_FOLDER}/{mps.TRAJECTORY_FILE}"
    swap_columns(name, "gravity_y_world", "gravity_z_world")(archive.parent)


_SLAM = "HD-EPIC/SLAM-and-Gaze/*/SLAM/multi"
_MOVEMENTS = f"{hd_epic.ANNOTATIONS_FOLDER}/{hd_epic.MOVEMENTS_FOLDER}"
HD_EPIC = {
    "no SLAM archive": told(_below(f"{_SLAM}/0.zip", Path.unlink), f"{FIRST}, found SLAM zip 0 of ", "missing"),
    "no SLAM map": told(
        _below(f"{_SLAM}/0.zip", lambda path: path.with_name(hd_epic.SLAM_MAP_FILE).unlink()),
        "which tells the SLAM zip of",
    ),
    "no time file": told(_below(f"HD-EPIC/Videos/*/{FIRST}{hd_epic.TIME_SUFFIX}", Path.unlink), "_mp4_to_vrs_time_ns"),
    "no movements of the video": told(
        edit_json(f"{_MOVEMENTS}/{hd_epic.ASSOCIATIONS_FILE}", lambda content: content.pop(FIRST)),
        f"{FIRST}: expected the movements of this video",
    ),
    "masks that are no JSON": told(write_text(f"{_MOVEMENTS}/{hd_epic.MASKS_FILE}", "{"), "expected valid JSON"),
    "masks of no video": told(write_text(f"{_MOVEMENTS}/{hd_epic.MASKS_FILE}", "[1]"), "expected the keys"),
    "no gaze archive": told(
        _below(f"HD-EPIC/SLAM-and-Gaze/*/GAZE_HAND/mps_{FIRST}_vrs.zip", Path.unlink),
        f"GAZE_HAND/mps_{FIRST}_vrs.zip: expected eye gaze",
    ),
    "a SLAM archive cut off": told(
        _below(f"{_SLAM}/0.zip", lambda path: path.write_bytes(path.read_bytes()[:100_000])),
        "0.zip",
        "whole zip archive",
    ),
    "a trajectory that is not Z up": told(_below(f"{_SLAM}/0.zip", _tilted), "gravity along -Z"),
    "no annotations": told(lambda root: shutil.rmtree(root / hd_epic.ANNOTATIONS_FOLDER), "--option annotations=DIR"),
}


def _times(folder: Path) -> Path:
    rows = "".join(f"{index * 33.3},{index},{time}\n" for index, time in enumerate((100, 200, 250)))
    (folder / "t.csv").write_text("mp4_time_ns,relative_vrs_device_time_ns,vrs_device_time_ns\n" + rows)
    return folder


def _edit_hdf5(part: str, name: str, change: Callable[[h5py.Dataset], object]) -> Damage:
    def damage(root: Path) -> None:
        with h5py.File(root / f"p1_1_{part}.hdf5", "r+") as file:
            change(file[name])

    return damage


def replace_rows(part: str, name: str, rows: np.ndarray) -> Damage:
    """Put other rows in place of a dataset's, which keeps its attributes."""

    def damage(root: Path) -> None:
        with h5py.File(root / f"p1_1_{part}.hdf5", "r+") as file:
            kept = dict(file[name].attrs)
            del file[name]
            file.create_dataset(name, data=rows).attrs.update(kept)

    return damage


_CUP_MESH = "meshfiles/cup.obj"
_OTHER_NAMES = np.array(["else" if name == "lKneeRotX" else name for name in mogaze.STATE_COLUMNS], dtype="S")
MOGAZE = {
    **{f"no {part}": told(remove(f"p1_1_{part}.hdf5"), f"p1_1_{part}") for part in mogaze.PARTS},
    **{
        f"{part} cut": told(keep(f"p1_1_{part}.hdf5", 700), f"p1_1_{part}", "complete HDF5 file")
        for part in mogaze.PARTS
    },
    "no scene": told(remove("scene.xml"), "scene.xml: expected this file"),
    "a scene cut off": told(write_text("scene.xml", "<scene><body"), "scene.xml", "XML"),
    "an empty mesh": told(write_text(_CUP_MESH, ""), "cup.obj", "triangles"),
    "a mesh without triangles": told(write_text(_CUP_MESH, "v 0 0 0\n"), "cup.obj", "triangles"),
    "a word in a mesh": told(write_text(_CUP_MESH, "v 0 0 0\nv 1 0 0\nv 0 x 0\nf 1 2 3\n"), "cup.obj", "triangles"),
    "65 columns": told(replace_rows("human_data", "data", np.zeros((N, 65))), "at least 66 numbers, found shape"),
    "67 columns": told(replace_rows("human_data", "data", np.zeros((N, 67))), "a name for each of the 67 columns"),
    "5 columns of gaze": told(replace_rows("gaze_data", "gaze", np.zeros((N, 5))), "at least 6 numbers"),
    "short gaze": told(replace_rows("gaze_data", "gaze", np.zeros((N - 40, 7))), "440 frames of gaze_data, 480"),
    "plain segments": told(replace_rows("segmentations", "segments", np.zeros((3, 3))), "start, end and label"),
    "no description": told(_edit_hdf5("human_data", "data", lambda d: d.attrs.pop("description")), "'description'"),
    "one length": told(
        _edit_hdf5("human_data", "data", lambda d: d.attrs.update(keys_fixed=np.array([b"lHipTransX"]))),
        "'headTransY' and",
        "more",
    ),
    "no calibration": told(_edit_hdf5("gaze_data", "gaze", lambda d: d.attrs.pop("calibration")), "'calibration'"),
    "no rotation": told(
        _edit_hdf5("gaze_data", "gaze", lambda d: d.attrs.update(calibration=np.zeros(4))), "a quaternion of length 1"
    ),
    "a missing column": told(
        _edit_hdf5("human_data", "data", lambda d: d.attrs.update(description=_OTHER_NAMES)), "'lKneeRotX'"
    ),
}


def _half_latent() -> bytes:
    return pickled_tensors({name: np.zeros(n, np.float32) for name, n in (("orient", 3), ("trans", 3), ("latent", 16))})


_SEQUENCE = "room1/2022-01-23-080759"
_NORM = "room1/scene_obj/transform_norm.txt"
GIMO = {
    "a pose cut off": told(
        lambda root: (root / _SEQUENCE / "smplx_local/101.pkl").write_bytes(b"\x80\x04\x95"),
        "101.pkl: expected a pickled dictionary",
    ),
    "half a latent": told(
        lambda root: (root / _SEQUENCE / "smplx_local/101.pkl").write_bytes(_half_latent()),
        "101.pkl, latent: expected 32 numbers, found 16",
    ),
    "no scale": told(
        edit_json(f"{_SEQUENCE}/transform_info_0.json", lambda content: content.pop("scale")),
        "transform_info_0.json",
        "scale",
    ),
    "3 of 4 rows": told(
        edit_lines(_NORM, lambda lines: lines.pop()), "transform_norm.txt: expected a 4x4 matrix, found 12 numbers"
    ),
    "no way to the joints": told(
        remove(f"{_SEQUENCE}/skeleton.bvh"),
        "smplx lacks --option vposer_model",
        "bvh lacks skeleton.bvh",
        "https://smpl-x.is.tue.mpg.de",
    ),
    "no sequence": told(lambda root: shutil.rmtree(root / "room1"), "found none of the 1: room1/2022-01-23-080759."),
    "a path out of the folder": told(
        edit_lines("dataset.csv", lambda rows: rows.append(rows[1].replace("2022-01-23-080759", "../../elsewhere"))),
        "a path that leads out of it",
    ),
}


def _segment_table(folder: Path) -> Path:
    header = "sequence_path,start_frame,end_frame,scene,transformation,training\n"
    (folder / "dataset.csv").write_text(header + "S,10,50,room,t.json,1\n", encoding="utf-8-sig")
    return folder


SEGMENTS = {
    "no column": told(replace_text("dataset.csv", "training", "split"), "header: expected a column 'training'"),
}


def _bvh(folder: Path) -> Path:
    write_bvh(gimo_sample.skeleton(), folder / "a.bvh")
    return folder


def _in_bvh(pattern: str, new: str) -> Damage:
    def damage(folder: Path) -> None:
        text, count = re.subn(pattern, new, (folder / "a.bvh").read_text(), count=1)
        assert count == 1
        (folder / "a.bvh").write_text(text)

    return damage


BVH = {
    "no motion": told(
        _in_bvh("MOTION", "MOVEMENT"),
        "sections HIERARCHY and MOTION, found 'HIERARCHY",
        " and no MOTION. The file may be truncated",
    ),
    "unknown channel": told(_in_bvh("Zrotation", "Wrotation"), "expected a channel such as"),
    "word for a number": told(_in_bvh(r"OFFSET \S+", "OFFSET x"), "expected a number, found 'x'"),
    "an open brace": told(_in_bvh("}\nMOTION", "MOTION"), "expected closed braces"),
    "fewer frames": told(_in_bvh(r"Frames: \d+", "Frames: 3"), "MOTION: expected 3 frames of 69 numbers"),
    "no time": told(_in_bvh(r"Frame Time: \S+", "Frame Time: 0"), "more than 0 s apart"),
    "word for a value": told(_in_bvh(r"(Frame Time: \S+\n)\S+", r"\1three"), "MOTION: expected frames of numbers"),
    **{
        f"{count} channels": told(
            _in_bvh(r"CHANNELS \d+", f"CHANNELS {count}"), "a.bvh, HIERARCHY, at", "CHANNELS with as many names"
        )
        for count in ("inf", "1e300", "2.5", "-1")
    },
}


def _ply(folder: Path) -> Path:
    (folder / "a.ply").write_bytes(ply_bytes(np.ones((2, 3))))
    return folder


def _in_ply(old: bytes, new: bytes) -> Damage:
    return lambda folder: (folder / "a.ply").write_bytes((folder / "a.ply").read_bytes().replace(old, new, 1))


PLY = {
    "empty": told(write_text("a.ply", ""), "expected a PLY file"),
    "another format": told(write_text("a.ply", "solid\n"), "expected a PLY file"),
    "text": told(_in_ply(b"binary_little_endian", b"ascii"), "expected a binary PLY format"),
    "a property twice": told(
        _in_ply(b"double y", b"double x"), "a.ply, header: expected each vertex property once, found x, x"
    ),
    "too long a number": told(_in_ply(b"vertex 2", b"vertex " + b"9" * 5000), "header: expected a number of vertices"),
}


def _pickle(folder: Path) -> Path:
    (folder / "0.pkl").write_bytes(pickled_tensors({"trans": np.zeros(3, np.float32)}))
    return folder


def _huge(folder: Path) -> None:
    os.truncate(folder / "0.pkl", 2 << 20)


_NO_TENSORS = ["0.pkl", "expected a pickled dictionary of torch tensors"]
PICKLES = {
    f"a pickle of {name}": told(lambda folder, content=content: (folder / "0.pkl").write_bytes(content), *_NO_TENSORS)
    for name, content in {
        "nothing": b"",
        "a frame cut off": b"\x80\x04\x95\x10",
        "text": b"hello",
        "a list": pickle.dumps([1, 2]),
        "a dictionary of text": pickle.dumps({"a": "b"}),
    }.items()
} | {"a huge pickle": told(_huge, "found 2,097,152")}


def _weights(folder: Path) -> Path:
    shapes = {"fc1": (24, 32), "fc2": (24, 24), "out": (126, 24)}
    layers = {f"bodyprior_dec_{name}.weight": torch.zeros(shape) for name, shape in shapes.items()}
    layers |= {f"bodyprior_dec_{name}.bias": torch.zeros(shape[0]) for name, shape in shapes.items()}
    torch.save(layers, folder / "a.pt")
    return folder


WEIGHTS = {
    "another version": told(
        lambda folder: torch.save({"decoder_net.0.weight": torch.zeros(3, 3)}, folder / "a.pt"),
        "expected the weights 'bodyprior_dec_fc1.weight'",
    ),
    "a foreign pickle": told(lambda folder: (folder / "a.pt").write_bytes(pickle.dumps(print)), "a file of weights"),
    "nothing": told(remove("a.pt"), "no such"),
}


def _body_model(folder: Path) -> Path:
    np.savez(folder / "a.npz", v_template=np.zeros((40, 3)), J_regressor=np.zeros((55, 40)))
    return folder


BODY_MODEL = {
    "no regressor": told(
        lambda folder: np.savez(folder / "a.npz", v_template=np.zeros((3, 3))), "expected an array 'J_regressor'"
    ),
    "a pickle": told(
        lambda folder: (folder / "a.npz").write_bytes(pickle.dumps({"v_template": 1})), "expected a readable .npz file"
    ),
}


def _output(folder: Path) -> Path:
    return egoallo_files.write(folder, egoallo_files.output())


def _changed(found: str, **arrays: object) -> tuple[Damage, Sequence[str]]:
    """Replace arrays of an output file, or with None remove them; the message says how to make a new one."""
    return told(lambda path: egoallo_files.rewrite(path, **arrays), ".npz", found, "prbench poses egoallo")


@cache
def _good() -> dict[str, np.ndarray]:
    good = egoallo_files.output()
    long, backwards = good.body_quats.copy(), good.time_ns.copy()
    long[0, 3, 4] *= 1.002
    backwards[5] = backwards[4]
    hole, lost_head = good.body_quats.copy(), good.world_from_cpf.copy()
    hole[0, 0, 4, 1] = lost_head[2, 3] = np.nan
    return {
        "long": long, "backwards": backwards, "hole": hole, "head": lost_head, "root": good.world_from_root[:, :11],
        "betas": np.tile(good.betas, (2, 1, 1)), "times": good.time_ns / 1.0,
    }  # fmt: skip


OUTPUTS = {
    "no betas": _changed("an array 'betas'", betas=None),
    "no times": _changed("an array 'timestamps_ns'", timestamps_ns=None),
    "no root": _changed("an array 'Ts_world_root'", Ts_world_root=None),
    "no frames": _changed("T = 0", timestamps_ns=np.zeros(0, dtype=np.int64)),
    "no samples": _changed("S = 0", Ts_world_root=np.zeros((0, 12, 7), dtype=np.float32)),
    "fewer roots": _changed("Ts_world_root: expected floats of the shape", Ts_world_root=_good()["root"]),
    "other samples": _changed("betas: expected floats of the shape", betas=_good()["betas"]),
    "51 rotations": _changed("float32 (1, 12, 51, 4)", body_quats=np.ones((1, 12, 51, 4), dtype=np.float32)),
    "NaN in the body": _changed("body_quats[0, 0, 4, 1]: expected finite numbers", body_quats=_good()["hole"]),
    "NaN in the head": _changed("Ts_world_cpf", Ts_world_cpf=_good()["head"]),
    "long quaternion": _changed("body_quats[0, 3, 4]: expected a quaternion of length 1", body_quats=_good()["long"]),
    "repeated time": _changed("timestamps_ns, frame 5", timestamps_ns=_good()["backwards"]),
    "times as floats": _changed("integers (T,)", timestamps_ns=_good()["times"]),
    "objects": _changed("numbers or text, found Python objects", betas=np.array([None], dtype=object)),
    "half a file": told(lambda path: path.write_bytes(path.read_bytes()[:3000]), "may be truncated"),
    "nothing": told(lambda path: path.write_bytes(b""), "a readable .npz file"),
    "a web page": told(lambda path: path.write_bytes(b"<html>not found</html>"), "a readable .npz file"),
    "a single array": told(lambda path: path.write_bytes(_npy()), "a readable .npz file"),
}


def _npy() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    return buffer.getvalue()


SMPLH = {
    "no regressor": told(lambda p: egoallo_files.rewrite(p, J_regressor=None), "model.npz", "an array 'J_regressor'"),
    "ten shapes": told(lambda p: egoallo_files.rewrite(p, shapedirs=np.zeros((52, 3, 10))), "at least 16 shapes"),
    "SMPL": told(lambda p: egoallo_files.rewrite(p, J_regressor=np.zeros((24, 52))), "J_regressor (52, v)"),
    "objects": told(
        lambda p: egoallo_files.rewrite(p, J_regressor=np.array([None], dtype=object)), "found Python objects"
    ),
    "nothing": told(Path.unlink, "Extended SMPL+H model", "smplh_model=FILE"),
}

_START = 5_000_000_000


def _poses(folder: Path) -> Path:
    write_lines(folder / "t.csv", trajectory_lines(_START + np.arange(3000, dtype=np.int64) * 1000))
    return folder


def _near(folder: Path) -> object:
    return read_near(folder / "t.csv", np.array([_START + 100_000, _START + 1_498_500, _START + 2_900_000]))


def _pose_cell(column: str, value: str) -> Damage:
    return set_cell("t.csv", 2001, trajectory_lines(np.zeros(0, dtype=np.int64))[0].split(",").index(column), value)


TRAJECTORY = {
    "a row twice": told(
        edit_lines("t.csv", lambda lines: lines.insert(1501, lines[1500])),
        "line 1502: expected a time after 5001499000 us",
    ),
    "no number": told(_pose_cell("tx_world_device", "nan"), "line 2001: expected a pose of finite numbers"),
    "no rotation": told(_pose_cell("qw_world_device", "2.0"), "line 2001", "length"),
    "text": told(_pose_cell("qx_world_device", "x"), "line 2001"),
    "time runs back": told(_pose_cell(mps.TIME_COLUMN, "5"), "line 2001", "expected a time after 5001998000"),
    "too many cells": told(_pose_cell("qz_world_device", "0.5,0.5"), "line 2001"),
    "a cut last line": told(cut("t.csv", 40), "line 3001"),
    "an empty file": told(write_text("t.csv", ""), "a column 'graph_uid'"),
    "no rows": told(keep_header("t.csv"), "at least one pose"),
    "nothing": told(remove("t.csv"), "no such file"),
}


def _gaze(folder: Path) -> Path:
    write_lines(folder / "eyegaze.csv", gaze_lines(np.array([10, 20, 30])))
    return folder


GAZE = {
    "backwards": told(set_cell("eyegaze.csv", 4, 0, "15"), "line 4: expected a time after"),
    "repeated": told(set_cell("eyegaze.csv", 4, 0, "20"), "line 4: expected a time after"),
}


def _services(folder: Path) -> Path:
    write_mps(
        sense_mps(perform("hd-epic", seed=3, index=1, n_events=1, provocations={}), start_us=7_000_000_321), folder
    )
    return folder


def _read_services(root: Path) -> object:
    return read_mps(RecordingFiles("test", "recording", root, find_mps_files(root)))


def _error(folder: str) -> tuple[Damage, Sequence[str]]:
    content = {"SomeOperator": {"status": "ERROR", "message": "it rained", "warnings": [], "errors": []}}
    return told(write_text(f"{folder}/summary.json", json.dumps(content)), "SomeOperator", "ERROR (it rained)")


SERVICES = {
    "no poses": told(remove("slam/closed_loop_trajectory.csv"), "closed_loop_trajectory.csv"),
    "no gaze": told(remove("eye_gaze/personalized_eye_gaze.csv"), "eye_gaze.csv"),
    "an error of SLAM": _error("slam"),
    "an error of gaze": _error("eye_gaze"),
}

TOML = "one/recording.toml"
OWN = {
    "unknown key": told(replace_text(TOML, "participant", "partcipant"), TOML, "Did you mean 'participant'"),
    "unknown unit": told(replace_text(TOML, '"m"', '"inch"'), "units.length", "m, cm, mm", "inch"),
    "no unit": told(replace_text(TOML, 'length = "m"', ""), "units", "required field `length`"),
    "unknown skeleton": told(replace_text(TOML, "smpl22", "smplx55"), "body", "Did you mean 'smplx-55'"),
    "no right angle": told(replace_text(TOML, 'up = "y"\n\n[gaze]', 'up = "z"\n\n[gaze]'), "head", "no right angle"),
    "left-handed": told(replace_text(TOML, '"right"', '"left"'), "body.csv", "mirrored", "axes.handed"),
    "order of quaternions": told(replace_text(TOML, "wxyz", "xyzw"), "csv, header", "qx, qy, qz, qw", "qw, qx"),
    "no column": told(set_cell("one/gaze.csv", 1, 1, "d_x"), "gaze.csv, header", "'dx'", "Did you mean 'd_x'"),
    "no joint": told(set_cell("one/body.csv", 1, 1, "hips_x"), "body.csv, header", "'pelvis_x'", "skeleton 'smpl22'"),
    "half a point": told(set_cell("one/wrists.csv", 5, 3, ""), "wrists.csv, line 5", "x, y, z", "nan", "empty"),
    "infinite": told(set_cell("one/object_poses.csv", 7, 2, "inf"), "object_poses.csv, line 7", "finite", "inf"),
    "word for a number": told(set_cell("one/gaze.csv", 4, 2, "left"), "gaze.csv, line 4", "'left'"),
    "no time": told(set_cell("one/body.csv", 6, 0, ""), "body.csv, line 6, column 'time'", "nan"),
    "clock backwards": told(swap_lines("one/body.csv", 10, 11), "body.csv, line 11, column 'time'", "after", "Sort"),
    "object's clock": told(swap_lines("one/object_poses.csv", 3, 4), "line 4, column 'time'", "after", "Sort"),
    "long quaternion": told(edit_cells("one/object_poses.csv", 9, lambda cells: [*cells[:-4], "2", "0", "0", "0"]),
                            "object_poses.csv, line 9", "length of 1", "2.0"),
    "gaze at a point": told(edit_cells("one/gaze.csv", 9, lambda cells: [cells[0], "0", "0", "9", *cells[4:]]),
                            "gaze.csv, line 9", "length of 1", "9.0", "Divide"),
    "third hand": told(set_cell("one/wrists.csv", 3, 1, "middle"), "wrists.csv, line 3, column 'side'", "left|right"),
    "unknown object": told(set_cell("one/objects.csv", 2, 0, "cupp"), "object_poses.csv", "ids of objects.csv"),
    "object twice": told(edit_lines("one/objects.csv", lambda lines: lines.append(lines[1])), "objects.csv", "twice"),
    "two files": told(write_text("one/gaze.parquet", ""), "gaze.csv", "one file a table", "gaze.parquet beside it"),
    "no Parquet": told(lambda folder: (folder / "one/gaze.csv").rename(folder / "one/gaze.parquet"), "a Parquet file"),
    "no events' time": told(set_cell("one/events.csv", 1, 0, "when"), "events.csv, header", "'time', or 'frame'"),
}  # fmt: skip

BAD_INPUT = [
    *bad_files("a plain recording", copy_of("own-short", write_short), _reads("own"), OWN),
    *bad_files("files of the services", copy_of("mps-files", _services), _read_services, SERVICES),
    *bad_files("an ADT recording", write_adt, _reads("adt"), ADT),
    *bad_files("a HOT3D recording", copy_of("hot3d-two-seconds", write_hot3d), _reads("hot3d"), HOT3D),
    *bad_files("a HOT3D hand", _profile, lambda folder: read_profile(folder / "profile.json"), HAND_PROFILE),
    *bad_files("an HD-EPIC video", copy_of("hd-epic-two-videos", write_copy), _reads("hd-epic", FIRST), HD_EPIC),
    *bad_files(
        "an HD-EPIC clock",
        _times,
        lambda folder: read_video_clock(folder / "t.csv", None),
        {
            "backwards": told(
                set_cell("t.csv", 4, 2, "150"), "line 4: expected a device time not before 200 ns, found 150"
            )
        },
    ),
    *bad_files("a MoGaze recording", write_scene, _reads("mogaze"), MOGAZE),
    *bad_files("a GIMO segment", lambda f: gimo_sample.write_root(f, gimo_sample.readings()), _reads("gimo"), GIMO),
    *bad_files("GIMO's segments", _segment_table, lambda folder: read_segments(folder / "dataset.csv"), SEGMENTS),
    *bad_files("a BVH file", _bvh, lambda folder: read_bvh(folder / "a.bvh"), BVH),
    *bad_files("a PLY file", _ply, lambda folder: read_vertices(folder / "a.ply"), PLY),
    *bad_files("tensors", _pickle, lambda folder: load_tensors(folder / "0.pkl"), PICKLES),
    *bad_files("VPoser's weights", _weights, lambda folder: read_pose_decoder(folder / "a.pt"), WEIGHTS),
    *bad_files("a SMPL-X model", _body_model, lambda folder: read_rest_joints(folder / "a.npz"), BODY_MODEL),
    *bad_files("an EgoAllo output", _output, read_output, OUTPUTS),
    *bad_files("an SMPL-H model", egoallo_files.model, read_smplh_rest, SMPLH),
    *bad_files("poses of glasses", _poses, _near, TRAJECTORY),
    *bad_files("gaze of glasses", _gaze, lambda folder: read_gaze_angles(folder / "eyegaze.csv"), GAZE),
    BadInput(
        "an ADT recording that is known to be bad",
        lambda folder: _reads("adt")(write_adt(folder).rename(folder / "Apartment_release_clean_seq139_M1292")),
        ("damaged IMU data",),
        RecordingUnusable,
    ),
]
