"""Options of the reader of GIMO."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from prbench.readers.gimo.to_recording import GazeOrigin, Target
from prbench.readers.options import ReaderOptions

Route = Literal["smplx", "mesh", "bvh"]


class GimoOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the GIMO reader."""

    events: Path | None = None
    """Table of pick events (``docs/gimo-events.md``); ``prbench_events.csv`` at the root if None."""
    hints: bool = True
    """Take the hint of ``dataset.csv`` as event frame where the table of events does not name a segment."""
    training_2: Literal["train", "drop"] = "train"
    """Use of the segments that the official loader never uses: train on them, or leave them out."""
    body: Literal["auto", "smplx", "mesh", "bvh"] = "auto"
    """Source of joints: fitted parameters, posed meshes, or the suit's skeleton; auto = the first that can be."""
    vposer_model: Path | None = None
    """Snapshot of VPoser v1 (``TR00_E096.pt``), for body smplx."""
    smplx_model: Path | None = None
    """``SMPLX_NEUTRAL.npz``, for bodies smplx and mesh."""
    target: Target = "point"
    """Box of an event: the wrist alone, or a cube of 10 cm around it."""
    gaze_origin: GazeOrigin = "head"
    """Origin of rays: the head joint, or the eyes as HoloLens 2 saw them."""
    meshes: bool = False
    """Load the scanned room, for priming that walls can hide."""

    def routes(self) -> tuple[Route, ...]:
        """Ways to the joints that these options allow, best first."""
        if self.body != "auto":
            return (self.body,)
        smplx: tuple[Route, ...] = ("smplx",) if self.vposer_model and self.smplx_model else ()
        mesh: tuple[Route, ...] = ("mesh",) if self.smplx_model else ()
        return (*smplx, *mesh, "bvh")
