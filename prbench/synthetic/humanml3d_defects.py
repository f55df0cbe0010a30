"""Defects of real copies of HumanML3D (docs/specification/humanml3d.md#text-files)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from prbench.corpora.humanml3d import files as layout
from prbench.files.storage import atomic_path
from prbench.synthetic.defects import Damage, Defect, removed


def _joints(root: Path, name: str) -> Path:
    return root / layout.JOINTS_FOLDER / f"{name}.npy"


def _texts(root: Path, name: str) -> Path:
    return root / layout.TEXTS_FOLDER / f"{name}.txt"


def _on_joints(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def apply(root: Path, name: str) -> None:
        joints = change(np.load(_joints(root, name), allow_pickle=False))
        with atomic_path(_joints(root, name)) as temporary:
            np.save(temporary, joints, allow_pickle=False)

    return apply


def _with_nan(joints: np.ndarray) -> np.ndarray:
    joints[5, 3, 1] = np.nan
    return joints


def _features_only(root: Path, name: str) -> None:
    """Remove the joints, which were never made or deleted to save space, and leave features."""
    n = len(np.load(_joints(root, name), allow_pickle=False))
    _joints(root, name).unlink()
    with atomic_path(root / layout.FEATURES_FOLDER / f"{name}.npy") as temporary:
        np.save(temporary, np.zeros((n, 263), dtype=np.float32), allow_pickle=False)


def _cut_line(root: Path, name: str) -> None:
    content = _texts(root, name).read_text()
    _texts(root, name).write_text(content[: len(content) // 2].rsplit("#", 2)[0])


def _not_listed(root: Path, name: str) -> None:
    for file in layout.SPLIT_FILES.values():
        names = (root / file).read_text().split()
        (root / file).write_text("".join(f"{other}\n" for other in names if other != name))


def _nan_times(root: Path, name: str) -> None:
    """Write nan where newer text files hold 0.0."""
    path = _texts(root, name)
    path.write_text(path.read_text().replace("#0.0#0.0", "#nan#nan"))


DEFECTS = (
    Defect("nan-joints", "a joint of one frame is NaN", _on_joints(_with_nan), "failed", "frame 5"),
    Defect("millimetres", "joints in millimetres", _on_joints(lambda joints: joints * 1e3), "failed", "metres"),
    Defect(
        "flat", "joints of another shape", _on_joints(lambda joints: joints.reshape(len(joints), -1)), "failed", "22, 3"
    ),
    Defect(
        "features-only", "the features are there, the joints are not", _features_only, "failed", "263 features only"
    ),
    Defect("missing-texts", "the text file is missing", removed(_texts), "failed", ".txt"),
    Defect("cut-texts", "the text file is cut", _cut_line, "failed", "caption#tokens#from#to"),
    Defect("not-listed", "the motion stands in no split list", _not_listed, "skipped", "not listed"),
    Defect("nan-times", "nan instead of 0.0 for whole motions", _nan_times, "read", ""),
)
"""All defects of the layout."""
