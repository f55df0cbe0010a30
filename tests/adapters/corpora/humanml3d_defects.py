"""Defects of copies of HumanML3D."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from prbench_adapters.corpora.humanml3d import files as layout
from tests.readers.defects import Defect, removed


def _joints(root: Path, name: str) -> Path:
    return root / layout.JOINTS_FOLDER / f"{name}.npy"


def _texts(root: Path, name: str) -> Path:
    return root / layout.TEXTS_FOLDER / f"{name}.txt"


def _nan_joints(root: Path, name: str) -> None:
    joints = np.load(_joints(root, name), allow_pickle=False)
    joints[5, 3, 1] = np.nan
    np.save(_joints(root, name), joints, allow_pickle=False)


def _other_joints(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path, str], None]:
    def apply(root: Path, name: str) -> None:
        joints = np.load(_joints(root, name), allow_pickle=False)
        np.save(_joints(root, name), change(joints), allow_pickle=False)

    return apply


def _thrown(joints: np.ndarray) -> np.ndarray:
    joints[5, 3, 1] = 9e29
    return joints


def _frozen(joints: np.ndarray) -> np.ndarray:
    joints[:, 20] = joints[0, 20]
    return joints


def _features_only(root: Path, name: str) -> None:
    """Remove the joints, which were never made or deleted to save space, and leave features."""
    n = len(np.load(_joints(root, name), allow_pickle=False))
    _joints(root, name).unlink()
    features = root / layout.FEATURES_FOLDER / f"{name}.npy"
    features.parent.mkdir()
    np.save(features, np.zeros((n, 263), dtype=np.float32), allow_pickle=False)


def _not_listed(root: Path, name: str) -> None:
    for file in layout.SPLIT_FILES.values():
        others = [other for other in (root / file).read_text().split() if other != name]
        (root / file).write_text("".join(f"{other}\n" for other in others))


def _nan_times(root: Path, name: str) -> None:
    """Write nan in place of 0.0, as newer text files do."""
    path = _texts(root, name)
    path.write_text(path.read_text().replace("#0.0#0.0", "#nan#nan"))


# All defects of the layout.
DEFECTS = (
    Defect("nan-joints", "a joint of one frame is NaN", _nan_joints, "failed", "frame 5"),
    Defect("thrown-joint", "a joint of one frame is light-years away", _other_joints(_thrown), "failed", "frame 5"),
    Defect("frozen-joint", "a hand stays where it was", _other_joints(_frozen), "read", "bones change by up to"),
    Defect(
        "repeated-frame",
        "a frame stands twice",
        _other_joints(lambda j: j[[*range(9), *range(8, 60)]]),
        "read",
        "1 frames repeat the one before",
    ),
    Defect("feet", "lengths are in feet", _other_joints(lambda j: j * 3.28084), "read", "m longer or shorter"),
    Defect("lost-start", "the first frames are lost", _other_joints(lambda j: j[20:]), "read", "pelvis begins"),
    Defect("lost-end", "the last frames are lost", _other_joints(lambda j: j[:-20]), "read", "a text ends at"),
    Defect("other-axes", "Z is up", _other_joints(lambda j: j[..., [0, 2, 1]]), "read", "the lowest joint is at"),
    Defect("features-only", "features without joints", _features_only, "failed", "263 features only"),
    Defect("missing-texts", "the text file is missing", removed(_texts), "failed", ".txt"),
    Defect("not-listed", "the motion stands in no split list", _not_listed, "skipped", "not listed"),
    Defect("nan-times", "nan instead of 0.0 for whole motions", _nan_times, "read", ""),
)
