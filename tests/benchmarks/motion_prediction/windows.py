"""A small table of windows: people who walk along curves, two recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from prbench.geometry.skeleton import head_forward
from prbench.readers.mogaze.format import STATE_COLUMNS, MogazeReadings, Segment
from prbench.readers.mogaze.synthetic import write as write_mogaze
from prbench_benchmarks.motion_prediction.joint_sets import SMPL22
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import SCHEMA_VERSION, Run, WindowsInfo, write_windows
from prbench_benchmarks.motion_prediction.windows import sliding_windows
from tests.fakes import STANDING
from tests.recording.mogaze_scene import CUP, GOGGLES, PLATE, TABLE, N, still_life
from tests.shared import made_once

RULES = load_prediction_protocol().windows


def swaying() -> MogazeReadings:
    """A person who stands as people do: nothing of them is at rest to the last digit, and they look about."""
    readings = still_life()
    sway = 0.004 * np.sin(np.arange(N) / 40)
    readings.state[:, STATE_COLUMNS.index("baseTransX")] += sway
    readings.gaze_points[:, 0] = 200 * np.sin(np.arange(N) / 30)
    (goggles,) = (body for body in readings.bodies if body.body_id == GOGGLES)
    goggles.position[:, 0] += sway
    return readings


def mogaze() -> Path:
    """Native files of MoGaze, made once a run: three recordings, each one segment of 120 frames at 30 a second."""

    def make(folder: Path) -> None:
        for name in ("p1_1", "p7_1", "p7_2"):
            segments = (Segment(0, N, "null"),)
            write_mogaze(replace(swaying(), recording_id=name, participant_id=name[:2], segments=segments), folder)
        names = {CUP: "cup_red", PLATE: "plate_red", GOGGLES: "goggles", TABLE: "table"}
        bodies = "".join(f'<body id="{key}" name="{name}"/>' for key, name in names.items())
        (folder / "scene.xml").write_text(f"<scene>{bodies}</scene>")

    return made_once("mogaze-of-one-segment", make)


def walking(
    name: str, n: int, *, split: str = "test", gaze: bool = True, number: int = 0, pose_source: str = "invented"
) -> Run:
    """A person who walks along a curve and looks about."""
    seconds = np.arange(n) / RULES.fps
    path = np.stack([0.9 * seconds + number, 0.02 * np.sin(9 * seconds), 0.5 * np.sin(seconds + number)], axis=1)
    joints = STANDING + path[:, None]
    joints[:, 20] += 0.2 * np.sin(3 * seconds + number)[:, None]
    look = np.stack([np.sin(seconds), np.zeros(n), np.cos(seconds)], axis=1)
    return Run(
        run_id=f"{name}/0",
        recording_id=name,
        participant_id=f"P{number}",
        split=split,
        published_split="",
        segment="0",
        pose_source=pose_source,
        fps=RULES.fps,
        start_time=0.0,
        joints=joints,
        joints_valid=np.ones(n, dtype=bool),
        gaze=look,
        gaze_valid=np.full(n, gaze),
        head_direction=head_forward(joints, 0.0)[0],
    )


def cut(run: Run) -> Run:
    """The run with its windows."""
    return replace(run, windows=sliding_windows(run, np.zeros(run.n_frames, dtype=bool), RULES))


def info(joint_set: str = SMPL22.name) -> WindowsInfo:
    """Provenance of an invented table."""
    words = ("title", "prbench_version", "manifest_digest", "input_digest", "identity_digest", "content_digest")
    return WindowsInfo(
        **dict.fromkeys((*words, "licence", "homepage", "citation", "protocol_digest"), ""),
        schema_version=SCHEMA_VERSION,
        protocol_version=1,
        dataset="synthetic-walks",
        synthetic=True,
        options={},
        outcomes={},
        quarantine=(),
        redistribution="yes",
        fps=RULES.fps,
        observed_frames=RULES.observed_frames,
        future_frames=RULES.future_frames,
        fewest_gaze_frames=RULES.fewest_gaze_frames,
        joint_set=joint_set,
        has_gaze=False,
        estimated_bodies=False,
        participants=0,
        recordings=0,
        runs=0,
        frames=0,
    )


def write(folder: Path, *runs: Run) -> Path:
    """Write a table; two recordings of 6 s and 5 s by default."""
    runs = runs or (walking("a", 180), walking("b", 150, split="train", number=1))
    write_windows(folder, info(), map(cut, runs))
    return folder
