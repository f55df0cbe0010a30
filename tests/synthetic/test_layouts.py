"""What holds for the sensors and files of every layout."""

from __future__ import annotations

import json
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from prbench.readers import reader_for
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.people import perform
from prbench.synthetic.sensors import Switches
from prbench.synthetic.write_tree import synthesize_tree
from tests.comparing import differences
from tests.shared import made_once

NOISES = [("adt", 1.0), ("adt", 5.0), ("gimo", 1.0), ("hd-epic", 1.0), ("hot3d", 2.0), ("mogaze", 0.0), ("mogaze", 2.0)]
ANGLES = "gaze.yaw gaze.pitch gaze.yaw_range gaze.pitch_range"
EVERY_GAZE = f"{ANGLES} gaze.time_us gaze.depth"
SUIT = "skeletons.joints skeletons.markers"
GLASSES = "bodies.world_from_cpf glasses.trajectory.position glasses.trajectory.rotation"
MPS_GAZE = {
    "gaze_bias": ANGLES,
    "gaze_jitter": ANGLES,
    "gaze_losses": EVERY_GAZE,
    "blinks": ANGLES,
    "gaze_clock": "gaze.time_us",
}
TOUCHED = {
    "adt": {
        **MPS_GAZE,
        "pose_noise": "glasses.position glasses.rotation glasses.quality",
        "pose_losses": "glasses.quality",
        "body_noise": SUIT,
        "body_wobble": SUIT,
        "body_losses": SUIT,
        "object_noise": "objects.position objects.rotation",
    },
    "gimo": {
        "gaze_bias": "gaze.points",
        "gaze_jitter": "gaze.points",
        "gaze_losses": "gaze.points gaze.frames",
        "body_noise": "body.motion.values body.poses.trans",
    },
    "hd-epic": {
        **{name: re.sub(r"\bgaze\.", "glasses.gaze.", touched) for name, touched in MPS_GAZE.items()},
        "pose_noise": GLASSES,
        "pose_drift": GLASSES,
        "pose_clock": f"{GLASSES} glasses.trajectory.time_us bodies.body_quats bodies.time_ns bodies.world_from_root",
        "hand_noise": "glasses.wrists.palm glasses.wrists.wrist",
        "hand_losses": "glasses.wrists.confidence glasses.wrists.palm glasses.wrists.wrist",
        "limb_wobble": "bodies.body_quats",
        "foot_slip": "bodies.body_quats",
        "root_height": "bodies.body_quats bodies.world_from_root",
        "video_clock": "clock.device_ns",
        "annotated_times": "priming.frame tracks.start tracks.end tracks.masks.box_px tracks.masks.frame",
        "annotated_points": "priming.location priming.frame_primed tracks.masks.location",
        "mask_losses": "priming tracks.masks",
    },
    "hot3d": {
        "object_noise": "objects.rows.position objects.rows.rotation",
        "object_gaps": "objects.rows.position objects.rows.rotation objects.rows.time_ns",
        "hand_noise": "hands.position",
        "hand_start": "hands.position masks",
        "hand_losses": "hands.angles hands.position hands.rotation hands.time_ns masks",
        "clock_drift": "hands.time_ns headset.time_ns masks objects.rows.time_ns",
    },
    "mogaze": {
        "gaze_bias": "gaze_points",
        "gaze_jitter": "gaze_points",
        "blinks": "gaze_points gaze_confidence",
        "body_noise": "state",
        "object_noise": "bodies.position bodies.rotation",
    },
}
"""Maps each switch to the columns of the readings that its error changes."""
NOISE = {"body_losses": 200.0, "mask_losses": 20.0}  # errors that are rare at the default
PERFORMED = {
    "adt": {"seed": 11, "index": 3, "n_events": 2},
    "gimo": {"seed": 11, "index": 0, "n_events": 2},
    "hd-epic": {"seed": 5, "index": 3, "n_events": 2},
    "hot3d": {"seed": 1, "index": 6, "n_events": 1},
    "mogaze": {"seed": 1, "index": 0, "n_events": 4},
}
RELEASED = {"adt": "adt/aria_digital_twin_test_data", "hot3d": "hot3d/Aria/P0003_c701bd11"}
NOISED = {"adt": 1.0, "hot3d": 2.0}
COLUMNS = [
    *(("adt", f"{name}.csv") for name in ("aria_trajectory", "eyegaze", "3d_bounding_box", "scene_objects")),
    ("hot3d", "dynamic_objects.csv"),
    ("hot3d", "headset_trajectory.csv"),
    ("hot3d", "masks/mask_hand_pose_available.csv"),
    ("hot3d", "mps/slam/closed_loop_trajectory.csv"),
    ("hot3d", "mps/eye_gaze/personalized_eye_gaze.csv"),
]
KEYS = [
    *(("adt", f"{name}.json") for name in ("metadata", "instances", "skeleton_aria_association", "Skeleton_*")),
    ("hot3d", "metadata.json"),
    ("hot3d", "umetrack_hand_user_profile.json"),
    ("hot3d", "umetrack_hand_pose_trajectory.jsonl"),
]


def tree(layout: str, noise: float = 1.0) -> Path:
    """A tree of two short recordings."""
    return made_once(
        f"tree-{layout}-{noise}",
        lambda root: synthesize_tree(layout, root, recordings=2, seed=4, n_events=2, noise=noise),
    )


@pytest.mark.parametrize(("layout", "noise"), NOISES)
def test_files_and_memory_give_the_same_recording_bit_for_bit(layout: str, noise: float) -> None:
    reader = reader_for(layout)
    found = reader.find(tree(layout, noise))
    assert len(found) == 2
    for index, files in enumerate(found):
        performance = perform(layout, seed=4, index=index, n_events=2)
        expected = layout_for(layout).recording(layout_for(layout).sense(performance, noise=noise))
        assert files.recording_id == expected.recording_id == performance.recording_id
        repeated = (layout, index) == ("gimo", 1)  # dataset.csv holds its row twice, which the reader tells
        assert list(differences(reader.read(files), expected)) == ([".messages"] if repeated else [])


@pytest.mark.parametrize(("layout", "switch"), [(layout, switch) for layout in TOUCHED for switch in TOUCHED[layout]])
def test_switching_one_error_off_leaves_everything_else_bit_identical(layout: str, switch: str) -> None:
    performance, noise = perform(layout, provocations={}, **PERFORMED[layout]), NOISE.get(switch, 1.0)
    sense = layout_for(layout).sense
    off = sense(performance, noise=noise, switches=replace(Switches(), **{switch: False}))
    paths = differences(sense(performance, noise=noise), off)
    changed = {re.sub(r"\[[^\]]*\]", "", path).removeprefix(".").removeprefix("readings.") for path in paths}
    assert changed == set(TOUCHED[layout][switch].split())


def test_every_switch_is_covered_by_the_test_above() -> None:
    assert {switch for switches in TOUCHED.values() for switch in switches} == {each.name for each in fields(Switches)}


def both(layout: str, name: str, samples: Path) -> list[Path]:
    """The file as it is written, and as the release has it."""
    written = reader_for(layout).find(tree(layout, NOISED[layout]))[0].folder
    return [next(folder.glob(name)) for folder in (written, samples / RELEASED[layout])]


@pytest.mark.parametrize(("layout", "name"), COLUMNS)
def test_columns_stand_in_the_order_of_the_release(layout: str, name: str, samples: Path) -> None:
    written, released = (path.read_text().splitlines()[0] for path in both(layout, name, samples))
    assert written == released


@pytest.mark.parametrize(("layout", "name"), KEYS)
def test_json_files_have_the_keys_of_the_release(layout: str, name: str, samples: Path) -> None:
    def shape(value: Any) -> Any:
        """Keys and kinds of a JSON value: of a list its first entry, of objects by id the first."""
        if isinstance(value, list):
            return [shape(value[0])] if value else []
        if isinstance(value, dict):
            return {"id" if re.match(r"\d|SYNTH", key) else key: shape(entry) for key, entry in value.items()}
        return float if isinstance(value, float) else type(value)

    def content(path: Path) -> Any:
        if path.suffix == ".json":
            return json.loads(path.read_text())
        lines = map(json.loads, path.read_text().splitlines())
        return next(line for line in lines if len(line["hand_poses"]) == 2)

    written, released = (shape(content(path)) for path in both(layout, name, samples))
    assert written == released
