"""EgoAllo: names in its output files, and what they hold.

Source: docs/specification/egoallo.md.

World of an output: that of the trajectory it was made from, metres, Z up. Quaternions: w x y z. Times: the glasses'
device clock, integer nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

OUTPUT_FOLDER = "egoallo_outputs"
POSES_FOLDER = "egoallo"  # Folder below a dataset's root that holds outputs by recording id.
ARGUMENTS_SUFFIX = "_args.yaml"

WORLD_FROM_CPF = "Ts_world_cpf"
WORLD_FROM_ROOT = "Ts_world_root"
BODY_QUATS = "body_quats"
BETAS = "betas"
TIMES = "timestamps_ns"
LEFT_HAND_QUATS = "left_hand_quats"
RIGHT_HAND_QUATS = "right_hand_quats"
CONTACTS = "contacts"
FRAME_NUMS = "frame_nums"
N_BODY_QUATS = 21
N_HAND_QUATS = 15
N_BETAS = 16

MODEL_FILE = "smplh/neutral/model.npz"
N_MODEL_JOINTS = 52

# EgoAllo's defaults, in output frames.
WINDOW_FRAMES = 128
WINDOW_OVERLAP = 32
INPUT_STEP = 33  # Every so many poses of a 1 kHz trajectory are used: ``int(rate // 30)``, so 30.3 Hz and not 30.
LONGEST_STEP = 0.1  # Seconds; a longer step between two frames is a gap that is never bridged.
SAME_FRAME_NS = 20_000_000  # Frames of two windows closer than this are one frame: steps are 33 ms.
# Metres, median; a head pose further from the recording's at the same time belongs to another one (choice).
LARGEST_CPF_ERROR = 0.05
QUATERNION_TOLERANCE = 1e-3


@dataclass(frozen=True)
class EgoAlloOutput:
    """One output file: a window of a recording, ``samples`` guesses of the body.

    Attributes:
        name: File name.
        world_from_cpf: w x y z, then x y z: the head pose (central pupil frame) that the guess was made from.
        world_from_root: Pelvis: w x y z, then x y z.
        body_quats: Rotations of the joints 1 to 21 in their parents.
        betas: Shape, one a frame; averaged over time before use.
    """

    name: str
    time_ns: Int[np.ndarray, " t"]
    world_from_cpf: Float[np.ndarray, "t 7"]
    world_from_root: Float[np.ndarray, "s t 7"]
    body_quats: Float[np.ndarray, "s t 21 4"]
    betas: Float[np.ndarray, "s t 16"]


@dataclass(frozen=True)
class EgoAlloBody:
    """All windows of one recording as one body.

    Attributes:
        joints: World of the trajectory that the outputs were made from, metres.
        messages: Messages for the user about them.
    """

    time_ns: Int[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    messages: tuple[str, ...] = ()
