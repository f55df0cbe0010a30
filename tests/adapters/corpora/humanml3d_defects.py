"""Defects of copies of HumanML3D."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from prbench.files.storage import atomic_path
from prbench_adapters.corpora.humanml3d import files as layout
from tests.readers.defects import Defect, removed


def _joints(root: Path, name: str) -> Path:
    return root / layout.JOINTS_FOLDER / f"{name}.npy"


def _texts(root: Path, name: str) -> Path:
    return root / layout.TEXTS_FOLDER / f"{name}.txt"


def _nan_joints(root: Path, name: str) -> None:
    joints = np.load(_joints(root, name), allow_pickle=False)
    joints[5, 3, 1] = np.nan
    with atomic_path(_joints(root, name)) as temporary:
        np.save(temporary, joints, allow_pickle=False)


def _features_only(root: Path, name: str) -> None:
    """Remove the joints, which were never made or deleted to save space, and leave features."""
    n = len(np.load(_joints(root, name), allow_pickle=False))
    _joints(root, name).unlink()
    with atomic_path(root / layout.FEATURES_FOLDER / f"{name}.npy") as temporary:
        np.save(temporary, np.zeros((n, 263), dtype=np.float32), allow_pickle=False)


def _on_texts(
    files: Callable[[Path, str], list[Path]], change: Callable[[str, str], str], root: Path, name: str
) -> None:
    """Change some text files; the change is told the text and the name of the motion."""
    for path in files(root, name):
        path.write_text(change(path.read_text(), name))


_NOT_LISTED = partial(
    _on_texts,
    lambda root, _: [root / file for file in layout.SPLIT_FILES.values()],
    lambda text, name: "".join(f"{other}\n" for other in text.split() if other != name),
)
# Newer text files hold nan in place of 0.0.
_NAN_TIMES = partial(
    _on_texts, lambda root, name: [_texts(root, name)], lambda text, _: text.replace("#0.0#0.0", "#nan#nan")
)


# All defects of the layout.
DEFECTS = (
    Defect("nan-joints", "a joint of one frame is NaN", _nan_joints, "failed", "frame 5"),
    Defect("features-only", "features without joints", _features_only, "failed", "263 features only"),
    Defect("missing-texts", "the text file is missing", removed(_texts), "failed", ".txt"),
    Defect("not-listed", "the motion stands in no split list", _NOT_LISTED, "skipped", "not listed"),
    Defect("nan-times", "nan instead of 0.0 for whole motions", _NAN_TIMES, "read", ""),
)
