"""NumPy archives: all that is known of one motion, as plain arrays that load without pickles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from prbench.geometry.skeleton import PARENTS, Joint
from prbench.viewing.replay.scene import Scene, ShownMotion


def write_arrays(scene: Scene, motion: ShownMotion, path: Path, about: dict[str, Any]) -> None:
    """Write a motion as ``.npz``; docs/exporting.md#npz names the arrays.

    Args:
        scene: The sequence; its goal is left out where it has none.
        motion: One motion of it.
        path: The file.
        about: What is said of the motion, written as JSON.
    """
    arrays = {
        "joints": motion.joints.astype(np.float32),
        "joint_names": np.array([joint.name.lower() for joint in Joint]),
        "parents": np.array(PARENTS),
        "fps": np.array(scene.fps),
        "times": scene.times,
        "prime_time": np.array(scene.prime_time),
        "event_time": np.array(scene.event_time),
        "units": np.array("metres, seconds; canonical frame: Y up, the first pose faces +Z"),
        "about": np.array(msgspec.json.encode(about, order="sorted").decode()),
    }
    if scene.goal is not None:
        arrays["goal_location"] = scene.goal.location
        arrays["goal_box_corners"] = scene.goal.box_corners
        arrays["world_from_canonical"] = scene.world_from_canonical
    if motion.gaze is not None:
        arrays["gaze_origin"] = motion.gaze.origin
        arrays["gaze_direction"] = motion.gaze.direction
        arrays["gaze_valid"] = motion.gaze.valid
    with open(path, "wb") as file:  # a path without the suffix would get it
        np.savez(file, **arrays)
