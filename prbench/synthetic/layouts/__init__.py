"""Layouts: what each dataset's sensors make of a performance, as a ``Recording`` in memory and as native files.

A new layout is a new module with a ``LAYOUT`` and one line in :data:`LAYOUT_MODULES`.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from prbench.errors import UsageError
from prbench.recording import Recording
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.sensors.errors import Switches

LAYOUT_MODULES: dict[str, str] = {
    "adt": "prbench.synthetic.layouts.adt",
    "gimo": "prbench.synthetic.layouts.gimo",
    "hd-epic": "prbench.synthetic.layouts.hd_epic",
    "hot3d": "prbench.synthetic.layouts.hot3d",
    "mogaze": "prbench.synthetic.layouts.mogaze",
}
"""Module of each preset's layout; of presets that are not listed there is motion only."""

SHARED_PARTS = ".shared-parts"
"""Folder of a tree that is being written; see :meth:`Layout.finish`."""


@runtime_checkable
class Layout(Protocol):
    """The sensors and the native files of one dataset."""

    def sense(self, performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> Any:
        """What the sensors say: the native content, before any text is made of it.

        Args:
            performance: The truth.
            noise: Multiplies every error; 0 for ideal sensors.
            switches: Which errors are on; all if None.
        """
        ...

    def recording(self, readings: Any) -> Recording:
        """The streams that a reader would find in the files of :meth:`write`, bit for bit."""
        ...

    def write(self, readings: Any, root: Path) -> None:
        """Write the native files of one recording below the dataset's folder.

        Raises:
            StorageError: if the disk is full or the folder cannot be written.
        """
        ...

    def finish(self, root: Path) -> None:
        """Write the files that all recordings of a tree share (tables of contents, annotations), after the last one.

        What :meth:`write` must hand over lies in ``root / SHARED_PARTS``, one file a recording; the folder is removed
        afterwards.
        """
        ...

    def events(self, performance: Performance) -> tuple[TrueEvent, ...]:
        """The performance's events as this dataset can know them, times still those of the performance."""
        ...

    def clock_start(self, performance: Performance) -> float:
        """Native time of the performance's first instant, seconds."""
        ...

    def object_id(self, object_id: str) -> str:
        """The id under which the native files know an object of the performance."""
        ...

    def gaze_bias(self, performance: Performance, *, noise: float, switches: Switches) -> tuple[float, float]:
        """The recording's constant gaze error, yaw and pitch, radians."""
        ...


@runtime_checkable
class EstimatedBodies(Protocol):
    """A layout with bodies of its own, beside which EgoAllo's estimates can stand."""

    def write_estimates(self, performance: Performance, readings: Any, root: Path, *, noise: float = 1.0) -> None:
        """Write what EgoAllo would make of one recording where readers look for it.

        Raises:
            StorageError: if the disk is full or the folder cannot be written.
        """
        ...


def layout_for(preset: str) -> Layout:
    """The layout of a preset.

    Raises:
        UsageError: for a preset of which there is motion only, naming those that have a layout.
    """
    if preset not in LAYOUT_MODULES:
        known = ", ".join(LAYOUT_MODULES)
        raise UsageError(f"there are no native files of '{preset}'; use one of: {known}.")
    return importlib.import_module(LAYOUT_MODULES[preset]).LAYOUT


def synthetic_recording(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> Recording:
    """Sense a performance and turn it into a recording.

    Args:
        performance: Of a preset that has sensors.
        noise: Multiplies every sensor error; 0 for ideal sensors.
        switches: Which errors are on; all if None.

    Raises:
        UsageError: for a preset without sensors.
    """
    layout = layout_for(performance.preset)
    return layout.recording(layout.sense(performance, noise=noise, switches=switches))
