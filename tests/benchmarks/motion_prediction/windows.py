"""A small table of windows: people who walk along curves, two recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from prbench.geometry.skeleton import head_forward
from prbench_benchmarks.motion_prediction.joint_sets import SMPL22
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import SCHEMA_VERSION, Run, WindowsInfo, write_windows
from prbench_benchmarks.motion_prediction.windows import sliding_windows
from tests.fakes import STANDING

RULES = load_prediction_protocol().windows


def walking(name: str, n: int, *, split: str = "test", gaze: bool = True, number: int = 0) -> Run:
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
        pose_source="invented",
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
    return replace(run, windows=sliding_windows(run, np.zeros(len(run), dtype=bool), RULES))


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
