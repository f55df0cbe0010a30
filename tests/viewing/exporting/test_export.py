"""What independent readers find in exported files, what licences keep, and where files go."""

from __future__ import annotations

import json
import re
import shutil
import struct
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import bvhio
import msgspec
import numpy as np
import pygltflib
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from prbench.cli import main
from prbench.geometry.skeleton import PARENTS, Joint
from prbench.representation.converters.smpl import (
    from_axis_angle,
    pose_body,
    read_amass,
    read_rest_joints,
    smpl_joints,
)
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.viewing.exporting import smpl
from prbench.viewing.exporting.export import ExportRequest, file_name
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset
from tests.representation.converters.bodies import person, person_rotations, write_body_model
from tests.shared import made_once
from tests.viewing.replay.scenes import a_scene

NAMES = [joint.name.lower() for joint in Joint]
ID = "/obj5/"


def _make(folder: Path) -> None:
    def walk(name: str, n_frames: int) -> np.ndarray:  # of bones that keep their lengths, unlike the made-up motions
        return person(n_frames, 300 + 5 * int(name))

    with patch("tests.fakes.smooth_motion", walk):
        fake_dataset(folder / "table", 24)
    run = ["run", "--method", "scripted", "--condition", "goal-loc", "--limit", "3", "--data"]
    assert main([*run, str(folder / "table"), "--out", str(folder / "run"), "-q"]) == 0


@pytest.fixture
def place() -> Path:
    return made_once("exported", _make)


@pytest.fixture
def joints(place) -> np.ndarray:
    table = SequenceTable.open(place / "table")
    (name,) = [each for each in table.scalars()["sequence_id"].to_pylist() if ID in each]
    return next(table.chunks(ids=frozenset({name}))).joints.astype(float)


def _exported(place, out: Path, form: str, *more: str, code: int = 0) -> Path:
    words = ["export-motion", str(place / "table"), "--sequence", ID, "--format", form, "--out", str(out), *more]
    assert main(words) == code
    return out


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("cm", 100.0)])
def test_another_reader_of_bvh_finds_our_joints_and_our_times(unit, scale, place, joints, tmp_path):
    path = _exported(place, tmp_path / "a.bvh", "bvh", "--unit", unit)
    read = bvhio.readAsBvh(str(path))
    assert (read.FrameCount, 1 / read.FrameTime) == (len(joints), pytest.approx(20.0))
    tree = bvhio.convertBvhToHierarchy(read.Root)
    for frame in (0, len(joints) // 2, len(joints) - 1):
        tree.loadPose(frame)
        found = {joint.Name: np.array(joint.PositionWorld) / scale for joint, _, _ in tree.layout()}
        np.testing.assert_allclose([found[name] for name in NAMES], joints[frame], atol=0.002)


def _values(gltf: pygltflib.GLTF2, number: int) -> np.ndarray:
    accessor = gltf.accessors[number]
    view = gltf.bufferViews[accessor.bufferView]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor.type]
    kind = np.dtype({5126: "<f4", 5123: "<u2", 5121: "u1"}[accessor.componentType])
    assert view.byteOffset % 4 == 0
    assert view.byteLength == accessor.count * width * kind.itemsize
    values = np.frombuffer(gltf.binary_blob(), kind, accessor.count * width, view.byteOffset).reshape(-1, width)
    if accessor.min:
        np.testing.assert_allclose([accessor.min, accessor.max], [values.min(axis=0), values.max(axis=0)])
    return values


def test_another_reader_of_gltf_finds_our_joints_our_times_and_the_terms(place, joints, tmp_path):
    path = _exported(place, tmp_path / "a.glb", "glb")
    gltf = pygltflib.GLTF2().load(str(path))
    (animation,) = gltf.animations
    every = [_values(gltf, number) for number in range(len(gltf.accessors))]
    times = every[animation.samplers[0].input]
    np.testing.assert_allclose(times[:, 0], np.arange(len(joints)) / 20, atol=1e-6)
    assert gltf.accessors[animation.samplers[0].input].max  # demanded
    track = {
        (channel.target.node, channel.target.path): every[animation.samplers[channel.sampler].output]
        for channel in animation.channels
    }
    assert all(len(values) == len(joints) for values in track.values())
    place_of = np.zeros(joints.shape)
    turned: list[Rotation] = []
    for joint, node in enumerate(gltf.nodes[:22]):  # by hand, as a viewer does
        local = Rotation.from_quat(track[joint, "rotation"])
        if joint == 0:
            place_of[:, 0] = track[0, "translation"]
            turned.append(local)
            continue
        assert joint in gltf.nodes[PARENTS[joint]].children
        place_of[:, joint] = place_of[:, PARENTS[joint]] + turned[PARENTS[joint]].apply(node.translation)
        turned.append(turned[PARENTS[joint]] * local)
    assert gltf.scenes[0].nodes == [0, 22, 23]
    assert [node.name for node in gltf.nodes] == [*NAMES, "body", "goal"]
    np.testing.assert_allclose(place_of, joints, atol=0.002)
    for primitive in gltf.meshes[0].primitives:
        assert every[primitive.indices].max() < gltf.accessors[primitive.attributes.POSITION].count
        assert every[primitive.attributes.JOINTS_0].max() < 22
        np.testing.assert_allclose(every[primitive.attributes.WEIGHTS_0].sum(axis=1), 1)
        rest = every[gltf.skins[0].inverseBindMatrices].reshape(22, 4, 4)
        np.testing.assert_allclose(rest[0], np.eye(4))
    extras = gltf.scenes[0].extras
    assert ID in extras["sequence_id"]
    assert extras["licence"] == DatasetInfo.read(place / "table").licence
    head, *lengths = struct.unpack("<4sII", path.read_bytes()[:12])
    assert (head, lengths) == (b"glTF", [2, path.stat().st_size])
    body = trimesh.load(path).geometry
    assert len(body) >= 3  # two sides and the goal


def test_blender_opens_both(place, joints, tmp_path):
    bpy = pytest.importorskip("bpy", reason="Blender as a module (pip install bpy) is not installed")
    for form in ("bvh", "glb"):
        path = _exported(place, tmp_path / f"a.{form}", form)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        if form == "bvh":
            bpy.ops.import_anim.bvh(filepath=str(path), axis_forward="-Z", axis_up="Y", update_scene_fps=True)
        else:
            bpy.context.scene.render.fps = 20
            bpy.ops.import_scene.gltf(filepath=str(path))
        (armature,) = [each for each in bpy.data.objects if each.type == "ARMATURE"]
        for frame in (0, len(joints) - 1):
            bpy.context.scene.frame_set(frame + (form == "bvh"))
            heads = [armature.matrix_world @ armature.pose.bones[name].head for name in NAMES]
            np.testing.assert_allclose([(x, z, -y) for x, y, z in heads], joints[frame], atol=0.002)


def test_npz_holds_what_the_page_names_as_plain_arrays(place, joints, tmp_path):
    with np.load(_exported(place, tmp_path / "a.npz", "npz"), allow_pickle=False) as arrays:
        held = dict(arrays)
    np.testing.assert_array_equal(held["joints"], joints.astype(np.float32))
    assert held["joint_names"].tolist() == NAMES
    assert json.loads(str(held["about"]))["motion"] == "ground truth"
    page = (Path(__file__).parents[3] / "docs" / "exporting.md").read_text(encoding="utf-8")
    assert [name for name in held if f"`{name}`" not in page] == []
    again = _exported(place, tmp_path / "b.npz", "npz")
    assert again.read_bytes() == (tmp_path / "a.npz").read_bytes()


def _fitted(joints: np.ndarray, folder: Path, model_joints: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances, metres, and rotation vectors of a fit; parameters, model and distances agree."""
    model = folder / "model.npz"
    write_body_model(model, joints=model_joints)
    request = ExportRequest(form="smpl", body_model=model, data=(folder,), out=folder / "a.npz")
    scene = a_scene(n_frames=len(joints))
    error = smpl.write(replace(scene, motions=(replace(scene.motions[0], joints=joints),)), request.out, {}, request)
    parameters = read_amass(request.out)
    found = smpl_joints(parameters, read_rest_joints(model))
    np.testing.assert_allclose(np.linalg.norm(found - joints, axis=2), error, atol=1e-9)
    assert parameters.fps == 20.0
    return error, np.load(request.out)["poses"].reshape(len(joints), model_joints, 3)


@pytest.mark.parametrize("model_joints", [24, 55])
def test_the_parameters_of_a_body_model_give_its_joints_back(model_joints, tmp_path):
    error, poses = _fitted(person_rotations(20)[0], tmp_path, model_joints)
    assert error.mean() < 0.0005
    assert not poses[:, 22:].any()


def test_a_knee_bends_as_a_hinge_though_positions_leave_the_thighs_twist_open(tmp_path):
    write_body_model(tmp_path / "model.npz", joints=24)
    rest = read_rest_joints(tmp_path / "model.npz").template
    vectors = np.zeros((4, 22, 3))
    vectors[:, Joint.LEFT_HIP, 1] = 0.7  # radians, about the thigh
    vectors[:, Joint.LEFT_KNEE, 0] = 1.5
    joints, _ = pose_body(rest, np.zeros((4, 3)), from_axis_angle(vectors))
    error, poses = _fitted(joints, tmp_path, 24)
    assert error.max() < 0.003
    assert np.abs(poses[:, Joint.LEFT_KNEE, 1:]).max() < 0.4  # 1.0 by the shortest turn
    assert poses[:, Joint.LEFT_HIP, 1].min() > 0.3


def test_several_motions_become_a_folder_that_is_replaced_whole(place, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["export-motion", str(place / "run"), "--data", str(place / "table"), "--format", "bvh", "--recorded"]
    report = reported([*words, "--out", str(out)], capsys)
    assert len(report.motions) == 6
    assert sorted(path.name for path in out.iterdir()) == sorted(["motions.json", *(m.file for m in report.motions)])
    assert json.loads((out / "motions.json").read_text())["motions"][0]["error_mm"]["pelvis"] == 0.0
    assert report.motions[1].motion == "scripted, goal-loc"
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert main([*words, "--out", str(out)]) == 0
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("")
    refused([*words, "--out", str(tmp_path / "mine")], capsys, code=8, message="holds no motions.json")


def test_names_of_files_are_short_safe_and_different():
    ids = ["adt/../../etc/passwd", "adt/a b:c*?\n", "x" * 500, "x" * 501, "CON", "ä"]
    names = [file_name(name, ".bvh") for name in ids]
    assert len({name.lower() for name in names}) == len(ids)
    assert [name for name in names if not re.fullmatch(r"[A-Za-z0-9-]{9,71}\.bvh", name)] == []


@pytest.mark.parametrize("kind", ["none", "non-commercial"])
def test_what_a_licence_keeps_needs_the_users_word(kind, place, tmp_path, capsys):
    table = tmp_path / "table"
    shutil.copytree(place / "table", table)
    msgspec.structs.replace(DatasetInfo.read(table), redistribution=kind, citation="@misc{x}").write(table)
    run = ["run", "--limit", "1", "--data", str(table), "-q", "--condition"]
    assert main([*run, "goal-loc", "--method", "scripted", "--out", str(tmp_path / "control")]) == 0
    assert main([*run, "none", "--method", "static", "--out", str(tmp_path / "method")]) == 0
    capsys.readouterr()
    out = tmp_path / "a.npz"
    export = ["export-motion", "--format", "npz", "--limit", "1", "--out", str(out)]
    control = [*export, str(tmp_path / "control"), "--data", str(table)]  # moved from the recorded first pose
    method = [*export, str(tmp_path / "method"), "--data", str(table)]
    for words in ([*export, str(table)], control, [*method, "--recorded"]):
        refused(words, capsys, code=10, message="--permission synthetic-adt")
    assert not out.exists()
    assert main(method) == 0
    assert "left out: recorded motion and goals of synthetic-adt" in capsys.readouterr().out
    with np.load(out) as held:
        assert not {"goal_location", "gaze_origin", "world_from_canonical"} & set(held)
    assert main([*export, str(table), "--permission", "synthetic-adt"]) == 0
    assert "notice: " in capsys.readouterr().out
    about = json.loads(str(np.load(out)["about"]))
    assert about["notice"]
    assert about["citation"] == "@misc{x}"


@pytest.mark.parametrize(
    ("more", "code", "message"),
    [
        (("--format", "bvh", "--out", "a.glb", "--sequence", ID), 2, "expected a file that ends in .bvh, found '.glb'"),
        (("--format", "bvh", "--out", "a.bvh"), 2, "expected a folder for 4 files"),
        (("--format", "smpl", "--out", "a.npz", "--sequence", ID), 2, "--body-model FILE.npz"),
        (("--format", "smpl", "--out", "a.npz", "--sequence", ID, "--body-model", "no.npz"), 3, "no such file"),
        (("--format", "glb", "--out", "a.glb", "--root", "."), 2, "--root: belongs to --format rrd"),
        (("--format", "bvh", "--out", "a.bvh", "--sequence", "obj5/pikc"), 2, "Near it:"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_is_written(
    more, code, message, place, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    refused(["export-motion", str(place / "table"), *more], capsys, code=code, message=message)
    assert list(tmp_path.iterdir()) == []


def test_without_rerun_the_message_holds_the_line_that_installs_it(place, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    _exported(place, tmp_path / "a.rrd", "rrd", code=9)
    assert "pip install 'prbench[rerun]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_film_of_one_sequence_is_written(place, tmp_path):
    assert b"ftyp" in _exported(place, tmp_path / "a.mp4", "mp4").read_bytes()[:32]
