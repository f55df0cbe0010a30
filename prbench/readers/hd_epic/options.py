"""What a user may choose about reading HD-EPIC."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from prbench.readers.options import ReaderOptions

BoxChoice = Literal["point", "cube"]


class HdEpicOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the reader; see the fields."""

    source: Literal["mps", "intermediate"] = "mps"
    """Where camera and gaze come from: the MPS files of SLAM-and-Gaze, or the newer per-frame intermediate data."""
    boxes: BoxChoice = "point"
    """``point``: zero-size boxes at the annotated points; ``cube``: cubes as large as the 2D boxes say."""
    annotations: Path | None = None
    """The annotation repository, where it does not lie beside the data."""
    poses: Literal["egoallo"] = "egoallo"
    """Where bodies come from."""
    smplh_model: Path | None = None
    """The licensed SMPL-H ``model.npz`` that turns EgoAllo's outputs into joints."""
    poses_root: Path | None = None
    """Folder of EgoAllo's outputs by video, where it is not ``egoallo`` below the root."""
