"""A few seconds of a person who stands still while a cup moves by itself, as MoGaze's files would hold them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.format import OFFSET_KEYS, STATE_COLUMNS
from prbench.readers.mogaze.synthetic import box_mesh, write

N = 480
PICK, PUT = 120, 240
"""Frames between which the cup moves from (0, -0.5, 0.8) to (0.5, -0.5, 0.8); Z up."""
CUP, PLATE, GOGGLES, TABLE = 17, 4, 9, 2

OFFSETS = dict.fromkeys(OFFSET_KEYS, 0.0) | {
    "pelvisTransZ": 0.0741, "torsoTransZ": 0.2008, "neckTransZ": 0.2336, "headTransY": -0.0181, "headTransZ": 0.1399,
    "linnerShoulderTransX": 0.0365, "linnerShoulderTransZ": 0.1833, "rinnerShoulderTransX": -0.0357,
    "rinnerShoulderTransZ": 0.1833, "lShoulderTransX": 0.1528, "rShoulderTransX": -0.1528, "lElbowTransX": 0.2434,
    "rElbowTransX": -0.2434, "lWristTransX": 0.2588, "rWristTransX": -0.2671, "lHipTransX": 0.0903,
    "rHipTransX": -0.0903, "lKneeTransZ": -0.3834, "rKneeTransZ": -0.3834, "lAnkleTransZ": -0.3535,
    "rAnkleTransZ": -0.3415, "lToeTransY": -0.1355, "lToeTransZ": -0.0587, "rToeTransY": -0.1355, "rToeTransZ": -0.0587,
}  # fmt: skip
STANDING_HEIGHT = 0.3834 + 0.3535 + 0.0587 + 0.01
"""Of the base: the lower toe is 1 cm above the floor."""


def body(key: int, name: str, position: np.ndarray, half: tuple[float, float, float]) -> mogaze.MogazeBody:
    """A body that is never turned."""
    rotation = np.tile((0.0, 0.0, 0.0, 1.0), (N, 1))
    return mogaze.MogazeBody(key, name, position, rotation, -np.array(half), np.array(half))


def still_life() -> mogaze.MogazeReadings:
    """The readings; everything that tests change is a fresh array."""
    state = np.zeros((N, 66))
    state[:, STATE_COLUMNS.index("baseTransZ")] = STANDING_HEIGHT
    share = np.clip((np.arange(N) - PICK) / (PUT - PICK), 0.0, 1.0)
    cup = np.array((0.0, -0.5, 0.8)) + share[:, None] * (0.5, 0.0, 0.0)
    places = {GOGGLES: (0.0, -0.1, 1.6), TABLE: (0.0, -0.6, 0.6), PLATE: (-0.4, -0.5, 0.8)}
    fixed = {key: np.tile(place, (N, 1)) for key, place in places.items()}
    return mogaze.MogazeReadings(
        recording_id="p1_1",
        participant_id="p1",
        state=state,
        fixed=dict(OFFSETS),
        bodies=(
            body(TABLE, "table", fixed[TABLE], (0.4, 0.4, 0.16)),
            body(PLATE, "plate_red", fixed[PLATE], (0.09, 0.09, 0.004)),
            body(GOGGLES, "goggles", fixed[GOGGLES], (0.0, 0.0, 0.0)),
            body(CUP, "cup_red", cup, (0.04, 0.03, 0.05)),
        ),
        gaze_points=np.tile((0.0, 0.0, 1000.0), (N, 1)),
        gaze_confidence=np.ones(N),
        calibration=np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]),  # turns z of the tracker to -Y, forward
        segments=(
            mogaze.Segment(0, PICK, "null"),
            mogaze.Segment(PICK, PUT, "cup_red"),
            mogaze.Segment(PUT + 1, N, "null"),
        ),
    )


NAMES = {CUP: "cup_red", PLATE: "plate_red", GOGGLES: "goggles", TABLE: "table"}


def write_names(folder: Path, names: Mapping[int, str] = NAMES, meshes: Mapping[int, str] | None = None) -> None:
    """Write ``scene.xml``: a name for each body's number, and a mesh for some."""
    lines = ["<scene>"]
    for key, name in names.items():
        lines.append(f'<body id="{key}" name="{name}"><color>1 0 0 0</color>')
        lines += [f'<meshfile src="{meshes[key]}"/>'] if meshes and key in meshes else []
        lines.append("</body>")
    (folder / "scene.xml").write_text("\n".join([*lines, "</scene>"]))


def write_scene(root: Path) -> Path:
    """Write one recording with a scene, and a mesh of the cup alone; return its folder."""
    folder = root / "mogaze"
    write(still_life(), folder)
    (folder / "meshfiles").mkdir()
    (folder / "meshfiles" / "cup.obj").write_text(box_mesh(np.array([-0.1, -0.2, -0.3]), np.array([0.1, 0.2, 0.4])))
    write_names(folder, meshes={CUP: "mogaze/meshfiles/cup.obj", PLATE: "mogaze/meshfiles/plate.obj"})
    return folder
