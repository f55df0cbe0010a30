"""NumPy archives: all that is known of one motion, as plain arrays that load without pickles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from prbench.geometry.skeleton import PARENTS, Joint
from prbench.viewing.replay.scene import Scene


def write(scene: Scene, path: Path, about: dict[str, Any], _: object) -> None:
    """Write the first motion of a scene as ``.npz``; docs/exporting.md names the arrays.

    Args:
        scene: The sequence; its goal is left out where it has none.
        path: The file.
        about: What is said of the motion, written as JSON.
    """
    motion = scene.motions[0]
    names = [joint.name.lower() for joint in Joint]
    arrays: dict[str, Any] = {"joints": motion.joints.astype(np.float32), "joint_names": names, "parents": PARENTS}
    arrays |= {name: getattr(scene, name) for name in ("fps", "times", "prime_time", "event_time")}
    arrays["units"] = "metres, seconds; canonical frame: Y up, the first pose faces +Z"
    arrays["about"] = msgspec.json.encode(about, order="sorted").decode()
    if scene.goal is not None:
        arrays |= {"goal_location": scene.goal.location, "goal_box_corners": scene.goal.box_corners}
        arrays["world_from_canonical"] = scene.world_from_canonical
    if motion.gaze is not None:
        arrays |= {f"gaze_{name}": getattr(motion.gaze, name) for name in ("origin", "direction", "valid")}
    with open(path, "wb") as file:  # a path without the suffix would get it
        np.savez(file, **arrays)
