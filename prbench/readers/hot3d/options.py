"""What a user can choose about reading HOT3D."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from prbench.readers.options import ReaderOptions


class Hot3dOptions(ReaderOptions, frozen=True, kw_only=True):
    """Options of the reader of HOT3D."""

    poses: Literal["egoallo"] = "egoallo"
    """Where bodies come from; the dataset has none of its own."""
    smplh_model: Path | None = None
    """The licensed body model that EgoAllo's outputs need (``model.npz``)."""
    poses_root: Path | None = None
    """Folder of EgoAllo's outputs by recording; beside the recordings by default."""
    hands: Literal["umetrack", "mano"] = "umetrack"
    """Which hand annotation gives wrists and vertices."""
    mano_models: Path | None = None
    """Folder of ``MANO_LEFT.npz`` and ``MANO_RIGHT.npz``, for ``hands=mano``."""
    meshes: bool = False
    """Load the objects' surfaces: for the in-hand rule ``surface``, and to mark what is primed through an object."""
