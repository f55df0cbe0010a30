"""What a user can choose about reading Aria Digital Twin."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from prbench.readers.options import ReaderOptions


class AdtOptions(ReaderOptions, frozen=True, kw_only=True):
    """Options of the reader of Aria Digital Twin."""

    poses: Literal["native", "egoallo"] = "native"
    """Where bodies come from: the suit, or EgoAllo's estimates (the study's table S1). Hands stay the suit's."""
    smplh_model: Path | None = None
    """The licensed body model that EgoAllo's outputs need (``model.npz``)."""
    poses_root: Path | None = None
    """Folder of EgoAllo's outputs by recording; beside the recordings by default."""
    gaze: Literal["release", "personalized"] = "release"
    """Which gaze: the release's ``eyegaze.csv``, or the services' personalized one where a recording has it."""
