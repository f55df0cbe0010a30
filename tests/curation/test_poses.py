"""EgoAllo as a step, with a fake program that can crash, hang, stop half-way or answer for somebody else."""

from __future__ import annotations

import gzip
import shutil
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from prbench.cli.main import main
from prbench.curation.poses import make_poses, pose_states, read_config
from prbench.curation.poses.states import prepare
from prbench.errors import InputFileError, UsageError
from prbench.geometry.skeleton import Joint
from prbench.readers import reader_for
from prbench.readers.aria_mps.files import read_trajectory
from prbench.readers.egoallo.synthetic import write_smplh_model
from prbench.synthetic.write_tree import synthesize_tree
from tests.cli.reports import printed_document, refused, reported

FAKE = Path(__file__).with_name("fake_egoallo.py")


@pytest.fixture
def config(tmp_path, monkeypatch) -> Path:
    """A configuration that runs the fake program, which notes its calls."""
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("FAKE_CALLS", str(tmp_path / "calls.txt"))
    path = tmp_path / "egoallo.toml"
    arguments = (
        "{python}", str(FAKE), "--traj-root", "{mps}", "--traj-length", "{frames}", "--guidance-mode", "{guidance}",
        "--recording", "{recording}",
    )  # fmt: skip
    quoted = ", ".join(f'"{text}"' for text in arguments)
    path.write_text(
        f'[egoallo]\npython = "{sys.executable}"\nfolder = "."\ncommand = [{quoted}]\ntimeout_minutes = 0.5\n'
    )
    return path


@pytest.fixture
def root(adt_tree, tmp_path, config) -> Path:
    """Four seconds of two ADT recordings without EgoAllo's bodies, with what it needs."""
    copy = tmp_path / "ADT"
    shutil.copytree(adt_tree, copy)
    for metadata in copy.glob("*/metadata.json"):
        metadata.with_name("video.vrs").write_bytes(b"VRS")
        trajectory = metadata.with_name("aria_trajectory.csv")
        trajectory.write_text("".join(trajectory.read_text().splitlines(keepends=True)[:121]))
    config.write_text(config.read_text().replace('"{recording}"]', '"{recording}", "--smplh-npz-path", "{model}"]'))
    write_smplh_model(copy / "smplh" / "neutral" / "model.npz")
    return copy


def _names(root: Path) -> list[str]:
    return [state.found.recording_id for state in pose_states(root)]


def _make(root: Path, config: Path) -> dict[str, tuple[str, str]]:
    outcomes = make_poses(tuple(pose_states(root)), read_config(config), root=root)
    return {outcome.recording_id: (outcome.state, outcome.message) for outcome in outcomes}


def _calls(root: Path) -> list[str]:
    return [line.split()[0] for line in (root.parent / "calls.txt").read_text().splitlines()]


def _leftovers(root: Path) -> list[str]:
    return [path.name for path in (root / "egoallo").rglob("*") if "partial" in path.name or path.name == "slam"]


def test_good_outputs_are_placed_where_readers_look_and_are_not_made_again(root, config):
    assert {state for state, _ in _make(root, config).values()} == {"made"}
    assert [state.state for state in pose_states(root)] == ["complete", "complete"]
    assert {state for state, _ in _make(root, config).values()} == {"kept"}
    assert _calls(root) == _names(root)
    assert _leftovers(root) == []
    reader = reader_for("adt", {"poses": "egoallo"})
    recording = reader.read(reader.find(root)[0])
    assert recording.pose_source == "egoallo"
    height = recording.body.joints[:, Joint.PELVIS, 1] - np.interp(
        recording.body.times, recording.head.times, recording.head.position[:, 1]
    )
    np.testing.assert_allclose(height, -0.7, atol=0.01)  # the fake's pelvis, turned back from Z up


def test_overlapping_windows_are_joined(root, config, monkeypatch):
    monkeypatch.setenv("FAKE_BEHAVIOUR", "windows")
    _make(root, config)
    reader = reader_for("adt", {"poses": "egoallo"})
    body = reader.read(reader.find(root)[0]).body
    assert np.diff(body.times).max() == pytest.approx(0.033, abs=1e-6)


@pytest.mark.parametrize(
    ("behaviour", "said"),
    [
        ("crash", "RuntimeError: CUDA out of memory"),
        ("other", "belongs to another recording"),
        ("partial", "its outputs cover only"),
        ("nonsense", "wrote no output"),
        ("broken", "truncated"),
    ],
)
def test_a_failure_is_told_and_the_next_recording_goes_on(root, config, monkeypatch, behaviour, said):
    first, second = _names(root)
    monkeypatch.setenv("FAKE_BEHAVIOUR", f"{first}={behaviour}")
    outcomes = _make(root, config)
    assert outcomes[first][0] == "failed"
    assert said in outcomes[first][1]
    assert outcomes[second][0] == "made"
    assert (root / "egoallo" / first / "egoallo.log").stat().st_size > 0
    assert not (root / "egoallo" / first / "egoallo_outputs").exists()
    assert _leftovers(root) == []
    monkeypatch.setenv("FAKE_BEHAVIOUR", "good")
    assert {name: state for name, (state, _) in _make(root, config).items()} == {first: "made", second: "kept"}
    assert _calls(root) == [first, second, first]


def test_a_program_that_hangs_is_ended_with_its_children(root, config, monkeypatch):
    config.write_text(config.read_text().replace("timeout_minutes = 0.5", "timeout_minutes = 0.03"))
    monkeypatch.setenv("FAKE_BEHAVIOUR", "hang")
    started = time.monotonic()
    states = tuple(pose_states(root, limit=1))
    (outcome,) = make_poses(states, read_config(config), root=root)
    assert time.monotonic() - started < 20
    assert outcome.state == "failed"
    assert "ran out of time" in outcome.message


def test_existing_outputs_of_a_part_are_done_again_and_kept_aside(root, config):
    _make(root, config)
    name = _names(root)[0]
    folder = root / "egoallo" / name / "egoallo_outputs"
    (path,) = folder.glob("*.npz")
    with np.load(path) as archive:
        half = {key: value[:40] if value.shape[0] > 1 else value[:, :40] for key, value in archive.items()}
    np.savez(path, **half)
    state = next(pose_states(root))
    assert state.state == "partial"
    assert "1 outputs cover 1.4 of 4.0 s, missing first at 1.5 s from the start" in state.message
    assert _make(root, config)[name][0] == "made"
    assert next(pose_states(root)).state == "complete"
    with np.load(next((root / "egoallo" / name / "egoallo_outputs.replaced").glob("*.npz"))) as archive:
        assert len(archive["timestamps_ns"]) == 40


def test_outputs_of_the_other_recording_are_noticed(root, config):
    _make(root, config)
    first, second = (root / "egoallo" / name / "egoallo_outputs" for name in _names(root))
    shutil.rmtree(first)
    shutil.copytree(second, first)
    states = [state.state for state in pose_states(root)]
    assert states == ["refused", "complete"]


def test_what_a_recording_lacks_is_told_before_anything_runs(root, config):
    name = _names(root)[0]
    (root / name / "video.vrs").unlink()
    assert "needs the VRS recording" in _make(root, config)[name][1]
    config.write_text(config.read_text() + 'needs = ["points"]\n')
    assert _make(root, config)[name][1] != ""  # the fake, like EgoAllo, refuses to run without it
    assert "exactly one VRS file" in _make(root, config)[name][1]


def test_the_prepared_points_are_turned_or_invented(root, tmp_path):
    found = reader_for("adt").find(root)[0]
    prepare(reader_for("adt").egoallo_inputs(root, found), tmp_path / "flat")
    text = gzip.decompress((tmp_path / "flat" / "slam" / "semidense_points.csv.gz").read_bytes()).decode()
    assert {line.split(",")[4] for line in text.splitlines()[1:]} == {"0"}
    own = found.folder / "mps" / "slam"
    own.mkdir(parents=True)
    header = "uid,graph_uid,px_world,py_world,pz_world,inv_dist_std,dist_std\n"
    (own / "semidense_points.csv.gz").write_bytes(gzip.compress(f"{header}1,g,1.5,0.25,-3.0,0.00001,0.001\n".encode()))
    prepare(reader_for("adt").egoallo_inputs(root, found), tmp_path / "turned")
    text = gzip.decompress((tmp_path / "turned" / "slam" / "semidense_points.csv.gz").read_bytes()).decode()
    assert text.splitlines()[1].split(",")[2:5] == ["1.5", "3", "0.25"]


def test_the_command_tells_what_is_lacking_makes_it_and_resumes(root, config, monkeypatch, capsys):
    words = ["poses", "egoallo", "--root", str(root)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    for part in ("2 missing", "git clone https://github.com/brentyi/egoallo.git", "[egoallo]", "Extended SMPL+H model"):
        assert part in printed
    first, second = _names(root)
    lacking = reported(words, capsys)
    assert [(each.recording_id, each.state) for each in lacking] == [(first, "missing"), (second, "missing")]
    assert reported([*words, "--dry-run"], capsys) == lacking
    assert not (root.parent / "calls.txt").exists()

    monkeypatch.setenv("FAKE_BEHAVIOUR", f"{second}=crash")
    words += ["--config", str(config)]
    document = printed_document(words, capsys, code=3)
    assert [(each["recording_id"], each["state"]) for each in document.report] == [(first, "made"), (second, "failed")]
    assert any(text.startswith(f"failed: {second}: ended with exit code 1") for text in document.notes)
    monkeypatch.setenv("FAKE_BEHAVIOUR", "good")
    assert [each.state for each in reported(words, capsys)] == ["kept", "made"]
    assert main(words[:4]) == 0
    assert "2 complete" in capsys.readouterr().out
    assert _calls(root) == [first, second, second]
    refused([*words, "--dataset", "gimo"], capsys, code=2, message="EgoAllo needs Aria glasses")


def test_a_wrong_config_is_explained(tmp_path):
    path = tmp_path / "egoallo.toml"
    with pytest.raises(InputFileError, match="no such file"):
        read_config(path)
    for text, said in (
        ('[egoallo]\npython = "p"\n', "folder"),
        ('[egoallo]\npython = "p"\nfolder = "f"\ntimeout = 3\n', "timeout"),
        ('[egoallo]\npython = "p"\nfolder = "f"\ncommand = "p run"\n', "array"),
        ('[egoallo]\npython = "p"\nfolder = "f"\ncommand = ["p", "{root}"]\n', r"\{root\}"),
        ("[egoallo\n", "TOML|table|Expected"),
    ):
        path.write_text(text)
        with pytest.raises(InputFileError, match=said):
            read_config(path)


def test_arguments_are_never_a_line_for_a_shell(tmp_path):
    path = tmp_path / "egoallo.toml"
    path.write_text('[egoallo]\npython = "p"\nfolder = "f"\ncommand = ["{python}", "--x={recording}"]\n')
    assert read_config(path).command_line({"recording": "a; rm -rf {mps} $HOME"}) == ["p", "--x=a; rm -rf {mps} $HOME"]


def test_a_program_that_cannot_be_started_ends_the_work(root, config):
    config.write_text(config.read_text().replace(sys.executable, "/nowhere/python"))
    with pytest.raises(UsageError, match="cannot start"):
        _make(root, config)


POINTS = gzip.compress(
    b"uid,graph_uid,px_world,py_world,pz_world,inv_dist_std,dist_std\n0,g,0.0,0.0,0.0,0.00001,0.001\n"
)


@pytest.fixture(scope="module")
def trees(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("aria")
    return {
        name: synthesize_tree(name, folder / name, recordings=1, seed=4, n_events=1).root
        for name in ("hd-epic", "hot3d")
    }


def _without_bodies(trees: dict[str, Path], dataset: str, tmp_path: Path) -> tuple[Path, str]:
    """A copy of a tree without EgoAllo's outputs, with a VRS file and points where the real ones have them."""
    root = shutil.copytree(trees[dataset], tmp_path / dataset)
    for folder in root.rglob("egoallo_outputs"):
        shutil.rmtree(folder)
    (found,) = reader_for(dataset).find(root)
    name = found.recording_id
    if dataset == "hot3d":
        (found.folder / "recording.vrs").write_bytes(b"VRS")
        (found.folder / "mps" / "slam" / "semidense_points.csv.gz").write_bytes(POINTS)
        return root, name
    (archive,) = root.rglob("SLAM/multi/*.zip")
    with zipfile.ZipFile(archive, "a") as opened:
        (trajectory,) = (entry for entry in opened.namelist() if entry.endswith("closed_loop_trajectory.csv"))
        opened.writestr(f"{trajectory.rpartition('/')[0]}/semidense_points.csv.gz", POINTS)
    vrs = archive.parents[4] / "VRS" / archive.parents[2].name / f"{name}_anonymized.vrs"
    vrs.parent.mkdir(parents=True)
    vrs.write_bytes(b"VRS")
    return root, name


@pytest.mark.parametrize(("dataset", "guidance"), [("hd-epic", "aria_wrist_only"), ("hot3d", "no_hands")])
def test_bodies_are_made_from_what_the_dataset_has(trees, config, tmp_path, dataset, guidance):
    root, name = _without_bodies(trees, dataset, tmp_path)
    (state,) = pose_states(root)
    assert state.state == "missing"
    (outcome,) = make_poses([state], read_config(config), root=root)
    assert outcome.state == "made", outcome.message
    assert (tmp_path / "calls.txt").read_text().split()[::2] == [name, guidance]
    (again,) = pose_states(root)
    assert again.state == "complete"
    reader = reader_for(dataset)
    recording = reader.read(reader.find(root)[0])
    assert recording.body is not None
    assert recording.pose_source == "egoallo"


def test_poses_can_be_kept_outside_of_the_dataset(trees, config, tmp_path):
    root, name = _without_bodies(trees, "hot3d", tmp_path)
    elsewhere = {"poses_root": tmp_path / "poses"}
    make_poses(tuple(pose_states(root, "hot3d", **elsewhere)), read_config(config), root=root)
    assert list((tmp_path / "poses" / name / "egoallo_outputs").glob("*.npz"))
    reader = reader_for("hot3d", {"poses_root": str(tmp_path / "poses")})
    assert reader.read(reader.find(root)[0]).body is not None
    assert next(pose_states(root, "hot3d", **elsewhere)).state == "complete"
    assert next(pose_states(root)).state == "missing"


def test_poses_of_other_worlds_are_left_out_of_what_egoallo_sees(trees, tmp_path):
    root, _ = _without_bodies(trees, "hot3d", tmp_path)
    (path,) = root.rglob("mps/slam/closed_loop_trajectory.csv")
    header, *rows = path.read_text().splitlines()
    rows[:50] = [f"UNDEFINED_ROW,{row.partition(',')[2]}" for row in rows[:50]]
    path.write_text("\n".join([header, *rows]) + "\n")
    (found,) = reader_for("hot3d").find(root)
    trajectory, _ = prepare(reader_for("hot3d").egoallo_inputs(root, found), tmp_path / "prepared")
    written = read_trajectory(trajectory)
    assert len(written.time_us) == len(rows) - 50
    np.testing.assert_array_equal(written.position, read_trajectory(path).position)
    np.testing.assert_array_equal(written.rotation, read_trajectory(path).rotation)


def test_what_is_not_there_is_named(trees, config, tmp_path):
    root, _ = _without_bodies(trees, "hd-epic", tmp_path)
    shutil.rmtree(next(root.rglob("VRS")))
    (outcome,) = make_poses(tuple(pose_states(root)), read_config(config), root=root)
    assert outcome.failed
    assert "VRS recording" in outcome.message
    assert not (tmp_path / "calls.txt").exists()
