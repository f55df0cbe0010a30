"""Read the files of HumanML3D's official folder: text lines and joint positions, checked, or a clear no.

Source: docs/specification/humanml3d.md#text-files.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.arrays import load_array
from prbench.files.bounded import read_text, require, require_rows
from prbench.geometry.skeleton import N_JOINTS, Joint, bone_lengths
from prbench.limits import FARTHEST_COORDINATE, HARMLESS_SIZE
from prbench.representation import REST_OFFSETS
from prbench.sequences.corpus import Caption

JOINTS_FOLDER = "new_joints"  # Joint positions, one (F, 22, 3) array a motion: metres, Y up, 20 fps.
FEATURES_FOLDER = "new_joint_vecs"  # 263 features a frame, one array a motion.
TEXTS_FOLDER = "texts"
TEXTS_ARCHIVE = "texts.zip"
SPLIT_FILES = {"train": "train.txt", "validation": "val.txt", "test": "test.txt"}
MIRROR_PREFIX = "M"
RATE = 20.0
# ``caption#tokens#from#to``; both times 0.0 mean the whole motion.
_TEXT_SEPARATOR = "#"


WHOLE = "caption"  # Kind of a caption of the whole motion; its times count as 0.
PART = "sub_caption"
TextLine = tuple[Caption, float, float]  # One caption, and the seconds from which and to which it describes the motion.

_SAME = 1e-3  # metres by which what is constant in the dataset may differ
_UNLIKE = 0.1  # metres; the dataset's motions differ by 0.2 mm, those of other people in its form by some centimetres
_GROUND = 0.05  # metres; the features hold one frame less than the motion whose lowest joint was put on the ground
_SHORTEST_TRUNK = 0.05  # metres; longer ones are in millimetres
_LONGEST_TRUNK = 20.0


def read_texts(path: Path) -> tuple[TextLine, ...]:
    """Read one text file. A time that is NaN counts as 0, as in the official loader; empty lines are passed over.

    Raises:
        InputFileError: if the file is missing, a line lacks a part, or a time is no number.
    """
    content = read_text(path, expected="this file", remedy="Unpack texts.zip.", largest=HARMLESS_SIZE)
    lines = []
    for number, line in enumerate(content.splitlines(), start=1):
        if not line.strip():
            continue
        parts = line.strip().rsplit(_TEXT_SEPARATOR, 3)
        remedy = "The file may be cut; unpack texts.zip again."
        require(path, (len(parts) == 4, f"line {number}", "caption#tokens#from#to", f"'{line[:80]}'", remedy))
        text, tokens, *times = (part.strip() for part in parts)
        start, end = (_seconds(path, number, cell) for cell in times)
        lines.append((Caption(text, WHOLE if start == end == 0.0 else PART, tokens), start, end))
    return tuple(lines)


def remark_on(joints: Float[np.ndarray, "frames 22 3"], lines: Sequence[TextLine]) -> str:
    """Say what no motion of the dataset shows; empty where nothing is wrong.

    All of them have one skeleton, and begin above the origin with their lowest joint on the ground
    (docs/specification/humanml3d.md#forward-conversion). A motion that lost a part or exchanged columns does not.

    Args:
        joints: See :func:`read_joints`.
        lines: Texts of the motion.
    """
    bones = bone_lengths(joints)
    stretch = np.ptp(bones, axis=0).max()
    unlike = np.abs(np.median(bones, axis=0) - np.linalg.norm(REST_OFFSETS[1:], axis=1)).max()
    still = int((np.diff(joints, axis=0) == 0).all(axis=(1, 2)).sum())
    start = np.abs(joints[0, Joint.PELVIS, [0, 2]]).max()
    lowest = joints[..., 1].min()
    end = max((end for _, _, end in lines), default=0.0)
    duration = len(joints) / RATE
    checks = (
        (stretch > _SAME, f"bones change by up to {stretch:.3f} m"),
        (unlike > _UNLIKE, f"a bone is {unlike:.3f} m longer or shorter than the dataset's"),
        (still > 0, f"{still} frames repeat the one before"),
        (start > _SAME, f"the pelvis begins {start:.3f} m from the origin"),
        (abs(lowest) > _GROUND, f"the lowest joint is at {lowest:.3f} m"),
        (end > duration + 1 / RATE, f"a text ends at {end:.2f} s, the motion at {duration:.2f} s"),
    )
    return "; ".join(said for is_wrong, said in checks if is_wrong)


def _seconds(path: Path, number: int, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError as error:
        raise InputFileError(path, f"line {number}", expected="a time in seconds", found=f"'{cell}'") from error
    if math.isinf(value):
        raise InputFileError(path, f"line {number}", expected="a finite time in seconds", found=cell)
    return 0.0 if math.isnan(value) else value


def read_joints(path: Path) -> Float[np.ndarray, "frames 22 3"]:
    """Read one file of ``new_joints``.

    Returns:
        Positions, metres, Y up, 20 frames a second.

    Raises:
        InputFileError: if it is no plain array of (frames, 22, 3), holds NaN, or is in another unit.
    """
    joints = load_array(path, remedy="Make the file again.")
    fits = joints.ndim == 3 and joints.shape[1:] == (N_JOINTS, 3) and joints.dtype.kind in "fiu"
    fits = fits and len(joints) >= 2
    require(path, (fits, "", "numbers of the shape (2 or more, 22, 3)", f"{joints.shape} of {joints.dtype}", ""))
    joints = joints.astype(np.float64)
    trunk = float(np.median(np.linalg.norm(joints[:, Joint.HEAD] - joints[:, Joint.PELVIS], axis=-1)))
    # Where a joint is NaN, so is the trunk: that is refused below, with its frame.
    millimetres = (not trunk > _LONGEST_TRUNK, "", "metres", f"{trunk:.0f} from pelvis to head", "Divide by 1,000.")
    require(path, millimetres, (not trunk < _SHORTEST_TRUNK, "", "a body", f"{trunk:.4f} m from pelvis to head", ""))
    farthest = np.abs(joints).max(axis=(1, 2))  # NaN where a joint is
    bad = ~(farthest <= FARTHEST_COORDINATE)
    expected = f"finite positions within {FARTHEST_COORDINATE:g} m"
    remedy = "Leave the motion out."
    require_rows(path, bad, expected, lambda row: f"{farthest[row]:g}", place="frame", first=0, remedy=remedy)
    return joints
