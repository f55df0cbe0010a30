"""`prbench align` over files: records, pictures, refusals, and what readers give to compare."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from scipy.spatial.transform import Rotation

from prbench.alignment.report import _TO_HEAD, compare, egoallo_heads
from prbench.cli.main import main
from prbench.errors import InputFileError
from prbench.geometry.skeleton import PARENTS, XSENS_SEGMENTS, Joint
from prbench.readers.aria_mps import format as mps
from prbench.readers.egoallo.format import EgoAlloOutput
from prbench.readers.found import RecordingFiles
from prbench.readers.gimo.bvh import write_bvh
from prbench.readers.gimo.hololens import hololens_and_suit
from prbench.recording import NO_GAZE, NO_POSES, BodyStream, PoseStream, Recording
from prbench.representation.converters.smpl import pose_body
from prbench.synthetic.write_tree import synthesize_tree
from prbench_adapters.corpora.nymeria.devices import segment_streams
from prbench_adapters.corpora.nymeria.synthetic import _GRAVITY, _NO_GRAPH
from tests import fakes
from tests.adapters.corpora.suits import walking_suit, write_arrays
from tests.alignment.heads import OFFSET, mounting, tracks
from tests.cli.reports import reported
from tests.readers import gimo_sample
from tests.shared import made_once

GOOD, CUT = "20230607_s0_james_johnson_act0_e72nhq", "20230607_s0_james_johnson_act1_e72nhr"
BAND = np.array([0.03, -0.02, 0.01])  # m: wristband against the hand's origin


def write_trajectory(folder: Path, stream: PoseStream) -> None:
    """Write a device's poses at 250 Hz."""
    rows = slice(None, None, 4)
    times = np.rint(stream.times[rows] * 1e6).astype(np.int64)
    poses = mps.AriaTrajectory(times, stream.position[rows], stream.rotation[rows], np.ones(len(times)))
    path = folder / "mps" / "slam" / "closed_loop_trajectory.csv"
    path.parent.mkdir(parents=True)
    pa.csv.write_csv(pa.table(mps.trajectory_columns(poses, _NO_GRAPH, _GRAVITY, None)), path)


def write_nymeria(root: Path) -> None:
    """One sequence of 75 s with a left wristband, and one whose glasses were worn for 40 s."""
    glasses, head = tracks(75.0)
    # The hand turns as another head does, half a metre from the first; its band has a clock of its own.
    band, hand = tracks(75.0, "a hand")
    for name, last in ((GOOD, len(glasses.times)), (CUT, 40_000)):
        suit = walking_suit(len(head.times))
        position, rotation = suit.position.copy(), suit.rotation.copy()
        for segment, stream in (("Head", head), ("L_Hand", hand)):
            rotation[:, XSENS_SEGMENTS.index(segment)] = stream.rotation
        position += (head.position - position[:, 6])[:, None]
        (root / name / "body").mkdir(parents=True)
        times = np.rint(head.times * 1e6).astype(np.int64)
        write_arrays(
            root / name / "body" / "xdata.npz", replace(suit, time_us=times, position=position, rotation=rotation)
        )
        worn = PoseStream(*(values[:last] for values in vars(glasses).values()))
        write_trajectory(root / name / "recording_head", worn)
        if name == GOOD:
            # In the glasses' world: T_WD · X · T_OH⁻¹ · (hand + turned place of the band).
            at = glasses.times
            on_suit = at + OFFSET
            place, turned = PoseStream(head.times, position[:, 14], hand.rotation, head.valid).pose_at(on_suit)
            origin, facing = head.pose_at(on_suit)
            x = mounting("someone")
            in_head = (
                Rotation.from_quat(facing, scalar_first=True)
                .inv()
                .apply(place + Rotation.from_quat(turned, scalar_first=True).apply(BAND) - origin)
            )
            where = glasses.position + Rotation.from_quat(glasses.rotation, scalar_first=True).apply(
                in_head @ x[:3, :3].T + x[:3, 3]
            )
            write_trajectory(root / name / "recording_lwrist", replace(band, times=band.times + 777.0, position=where))


@pytest.fixture(scope="module")
def root():
    return made_once("nymeria-to-align", write_nymeria)


def test_a_tree_becomes_records_and_pictures_of_the_same_bytes_from_any_number_of_workers(root, tmp_path, capsys):
    assert main(["align", "nymeria", "--root", str(root), "--out", str(tmp_path / "one"), "--json"]) == 3
    report = json.loads(capsys.readouterr().out)["report"]
    good, cut = report
    assert good == json.loads((tmp_path / "one" / f"{GOOD}.json").read_text())
    assert good["alignment"]["clock"]["offset"] == pytest.approx(OFFSET, abs=1e-3)
    assert np.allclose(good["alignment"]["device_from_segment"], mounting("someone"), atol=2e-3)
    (left,) = good["distances"]
    assert (left["of"], left["refused"]) == ("left", "")
    assert left["mean_cm"] == pytest.approx(100 * np.linalg.norm(BAND), abs=0.3)
    assert left["deviation_cm"] < 0.3
    assert good["messages"] == ["no trajectory of the right wristband"]
    assert "at least 60 s" in cut["alignment"]["refused"]
    assert main(["align", "nymeria", "--root", str(root), "--out", str(tmp_path / "two"), "--workers", "2"]) == 3
    assert "at least 60 s" in capsys.readouterr().err
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert names == sorted(f"{name}.{kind}" for name in (GOOD, CUT) for kind in ("json", "png"))
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_a_jump_of_the_suits_clock_is_not_bridged_and_zero_rotations_are_invalid(tmp_path):
    suit = walking_suit(1200)
    time_us = suit.time_us.copy()
    time_us[600:] += 50_000
    rotation = suit.rotation.copy()
    rotation[100:110, 6] = 0.0
    streams = segment_streams(write_arrays(tmp_path / "xdata.npz", replace(suit, time_us=time_us, rotation=rotation)))
    head = streams["Head"]
    assert np.diff(head.times[head.valid]).max() > 0.1
    assert not head.valid[50:55].any()
    assert head.valid[[49, 55]].all()
    assert streams["L_Hand"].valid[50:55].all()


def test_a_missing_trajectory_is_said_with_its_name(tmp_path, capsys):
    folder = tmp_path / GOOD / "body"
    folder.mkdir(parents=True)
    write_arrays(folder / "xdata.npz", walking_suit(600))
    assert main(["align", "nymeria", "--root", str(tmp_path), "--quiet"]) == 3
    assert main(["align", "nymeria", "--root", str(tmp_path)]) == 3
    assert "closed_loop_trajectory.csv: expected this file" in capsys.readouterr().err
    assert main(["align", "nymeria", "--root", str(tmp_path), "--recordings", "x"]) == 3
    assert main(["align", "nymeriad", "--root", str(tmp_path)]) == 2


def test_joints_without_rotations_are_refused_and_the_distance_to_the_glasses_is_given(tmp_path, capsys):
    synthesize_tree("adt", tmp_path, recordings=1, seed=2, n_events=2)
    assert main(["align", "adt", "--root", str(tmp_path), "--json"]) == 3
    (report,) = json.loads(capsys.readouterr().out)["report"]
    assert "positions of joints alone" in report["alignment"]["refused"]
    (head,) = report["distances"]
    assert 3.0 < head["mean_cm"] < 15.0
    assert head["deviation_cm"] < 1.0


def test_egoallos_head_turns_as_the_posed_body_does():
    rng = np.random.default_rng(3)
    windows = []
    for first in (0, 3):  # the windows share two frames
        times = (np.arange(first, first + 5) * 33_000_000).astype(np.int64)
        turned = Rotation.random(5 * 22, rng=np.random.default_rng(7)).as_quat(scalar_first=True).reshape(5, 22, 4)
        root = np.concatenate([turned[:, 0], np.zeros((5, 3))], axis=1)[None]
        windows.append(EgoAlloOutput(str(first), times, root[0], root, turned[None, :, 1:], np.zeros((1, 5, 16))))
    world = np.eye(4)
    world[:3, :3] = Rotation.random(rng=rng).as_matrix()
    body = BodyStream(np.arange(8) * 0.033, np.zeros((8, 22, 3)), np.ones(8, dtype=bool))
    whose = ("d", "r", "p", "egoallo", 0.0, (0.0, 1.0), NO_GAZE, NO_POSES, NO_POSES, body, (), ())
    found = egoallo_heads(windows[::-1], Recording(*whose, world_from_source=world))
    _, matrices = pose_body(np.zeros((22, 3)), np.zeros((5, 3)), turned)
    expected = Rotation.from_matrix(world[:3, :3] @ matrices[:, Joint.HEAD])
    assert np.allclose((Rotation.from_quat(found[:5], scalar_first=True).inv() * expected).magnitude(), 0.0, atol=1e-6)
    assert len(found) == 8
    chain = [Joint.HEAD]
    while PARENTS[chain[-1]] > 0:
        chain.append(Joint(PARENTS[chain[-1]]))
    assert tuple(reversed(chain)) == _TO_HEAD


def test_a_recording_that_cannot_be_read_is_refused_with_its_error():
    class Damaged:
        found = RecordingFiles("d", "r", Path(), ())

        def read(self):
            raise InputFileError("x.csv", "row 3", expected="a number", found="word")

    report, evidence = compare(Damaged())
    assert "row 3: expected a number" in report.alignment.refused
    assert evidence == {}


def write_gimo(root: Path) -> Path:
    """One sequence of 75 s whose suit turns as a whole with its head, and the HoloLens on that head."""
    sequence = gimo_sample.readings()
    folder = gimo_sample.write_root(root, sequence) / sequence.segment.scene / sequence.segment.sequence
    hololens, head = tracks(75.0, noise=(0.0, 0.0))
    at = slice(None, None, 4)  # the suit's 60 Hz
    motion = gimo_sample.skeleton((len(head.times[at]) - gimo_sample.LEAD) // 2)
    values = motion.values.copy()
    n = len(values)
    turned = Rotation.from_quat(head.rotation[at][:n], scalar_first=True)
    values[:, 3:6] = turned.as_euler("ZXY", degrees=True)
    above = fakes.STANDING[Joint.HEAD] - fakes.STANDING[Joint.PELVIS]
    values[:, :3] = 100.0 * (head.position[at][:n] - turned.apply(above))
    write_bvh(replace(motion, values=values), folder / "skeleton.bvh")
    poses = np.tile(np.eye(4), (len(hololens.times[::16]), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(hololens.rotation[::16], scalar_first=True).as_matrix()
    poses[:, :3, 3] = hololens.position[::16]
    rows = np.column_stack([np.rint(hololens.times[::16] * 1e7), poses.reshape(-1, 16), np.zeros((len(poses), 2))])
    np.savetxt(folder / "2022_head_hand_eye.csv", rows, fmt="%.10g", delimiter=",")
    return folder


def test_the_hololens_is_found_on_the_suits_head(tmp_path, capsys):
    folder = write_gimo(tmp_path / "gimo")
    (report,) = reported(["align", "gimo", "--root", str(tmp_path / "gimo"), "--out", str(tmp_path / "out")], capsys)
    x = np.array(report.alignment.device_from_segment)
    assert np.abs(x - mounting("someone")).max() < 2e-3
    (csv,) = folder.glob("*_head_hand_eye.csv")
    lines = csv.read_text().splitlines()
    cells = lines[9].split(",")
    csv.write_text("\n".join([*lines[:9], ",".join([cells[0], "9", *cells[2:]]), *lines[10:]]))
    with pytest.raises(InputFileError, match="line 10"):
        hololens_and_suit(folder)
    csv.write_text("1,2,3\n")
    with pytest.raises(InputFileError, match="16 or more numbers"):
        hololens_and_suit(folder)
    csv.unlink()
    with pytest.raises(InputFileError, match="a recording of the HoloLens"):
        hololens_and_suit(folder)
