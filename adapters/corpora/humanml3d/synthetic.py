"""The official folder of HumanML3D: joints, texts, mirrored copies, split lists.

Source: docs/specification/humanml3d.md#text-files.

Features (``new_joint_vecs``) are not written: nothing reads them yet.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.files.storage import atomic_path, write_text
from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.representation import mirror
from prbench.synthetic.activities import NarratedMotion
from prbench_adapters.corpora.humanml3d import files as layout

_LONGEST = 9.9  # Seconds of a motion in the dataset.
_SHORTEST = 2.05
_SIDES = {"left": "right", "right": "left"}


# One motion of the dataset, at 20 frames a second, with its text lines: caption, from, to; both 0 for all of it.
CaptionedMotion = tuple[Float[np.ndarray, "n 22 3"], tuple[tuple[str, float, float], ...]]


def captioned_motions(motion: NarratedMotion) -> tuple[CaptionedMotion, ...]:
    """Return neighbouring actions two by two: a caption for both together, and one for each part."""
    actions = [row for row in motion.narrations if row.kind == "atomic_action"]
    rows = sorted(actions, key=lambda row: (row.start, row.end))
    stride = round(motion.rate / layout.RATE)
    motions = []
    for number in range(0, len(rows) - 1, 2):
        first = rows[number]
        second = rows[number + 1]
        if second.end - first.start > _LONGEST or min(row.end - row.start for row in (first, second)) < _SHORTEST:
            continue
        begin, stop = (round(time * motion.rate) for time in (first.start, second.end))
        joints = motion.joints[begin : stop + 1 : stride]
        clauses = [row.texts[0].removesuffix(".").split(" ", 1)[1] for row in (first, second)]
        clauses = [clause.removeprefix("person ") for clause in clauses]
        lines = (
            (f"a person {clauses[0]} and then {clauses[1]}.", 0.0, 0.0),
            (f"someone {clauses[0]}, after that the person {clauses[1]}.", 0.0, 0.0),
            (f"a person {clauses[0]}.", 0.0, round(first.end - first.start, 3)),
            (f"a person {clauses[1]}.", round(second.start - first.start, 3), round(second.end - first.start, 3)),
        )
        motions.append((transform_points(invert_rigid(canonical_frame(joints)), joints), lines))
    return tuple(motions)


def mirrored(motion: CaptionedMotion) -> CaptionedMotion:
    """Exchange left and right, in joints and words."""
    joints, lines = motion
    other = [re.sub(r"\b(left|right)\b", lambda found: _SIDES[found[1]], text) for text, _, _ in lines]
    return mirror(joints), tuple((text, start, end) for text, (_, start, end) in zip(other, lines, strict=True))


def write_motion(root: Path, name: str, motion: CaptionedMotion) -> None:
    """Write joints and texts of one motion.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    with atomic_path(root / layout.JOINTS_FOLDER / f"{name}.npy") as temporary:
        np.save(temporary, motion[0].astype(np.float32), allow_pickle=False)
    lines = []
    for text, start, end in motion[1]:
        # No tagger here, so every part of speech is X, the universal tag for others.
        tokens = " ".join(f"{word}/X" for word in re.findall(r"[a-z]+", text.lower()))
        lines.append(f"{text}#{tokens}#{start}#{end}\n")
    write_text(root / layout.TEXTS_FOLDER / f"{name}.txt", "".join(lines))
