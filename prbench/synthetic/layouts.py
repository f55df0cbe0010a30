"""Layouts: what each dataset's sensors make of a performance, as a ``Recording`` in memory and as native files.

The layout of a preset is the ``LAYOUT`` of ``synthetic.py`` in its reader's folder.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prbench.errors import UsageError
from prbench.protocol.manifests import load_manifest
from prbench.readers import SYNTHETIC_PREFIX
from prbench.recording import Recording
from prbench.synthetic.people.person import PRESETS
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.sensors import Switches

# Folder of a tree that is being written; see :meth:`Layout.finish`.
SHARED_PARTS = ".shared-parts"


@dataclass(frozen=True)
class Layout:
    """The sensors and the native files of one dataset.

    Functions that write raise ``StorageError`` if the disk is full or the folder cannot be written.

    Attributes:
        dataset: Name of the imitated dataset.
        sense: Imitates the dataset's sensors: takes a performance, ``noise`` (multiplies every error) and ``switches``
            (which errors are on), and returns the native content, before any text is made of it.
        to_recording: The reader's own function from native content to streams.
        write: Writes the native files of one recording below the dataset's folder.
        events: Returns the performance's events as this dataset can know them, times still those of the performance.
        clock_start: Returns the native time of the performance's first instant, seconds.
        object_id: Returns the id under which the native files know an object of the performance.
        gaze_bias: Deviation of the recording's constant gaze error, radians an axis.
        finish: Writes the files that all recordings of a tree share (tables of contents, annotations), after the last
            one. What :attr:`write` must hand over lies in ``root / SHARED_PARTS``, one file a recording; the folder is
            removed afterwards.
        write_estimates: Writes bodies as EgoAllo would estimate them where readers look for them; None where the layout
            has no bodies of its own beside which estimates could stand.
    """

    dataset: str
    sense: Callable[..., Any]
    to_recording: Callable[..., Recording]
    write: Callable[[Any, Path], None]
    events: Callable[[Performance], tuple[TrueEvent, ...]]
    clock_start: Callable[[Performance], float]
    object_id: Callable[[str], str]
    gaze_bias: float
    finish: Callable[[Path], None] = lambda _: None
    write_estimates: Callable[..., None] | None = None

    def recording(self, readings: Any) -> Recording:
        """Return the streams that a reader would find in the files of :attr:`write`, bit for bit."""
        return self.to_recording(readings, load_manifest(self.dataset), dataset=f"{SYNTHETIC_PREFIX}{self.dataset}")


def layout_for(preset: str) -> Layout:
    """Return the layout of a preset.

    Raises:
        UsageError: for an unknown preset, naming those there are.
    """
    if preset not in PRESETS:
        raise UsageError(f"there are no native files of '{preset}'; use one of: {', '.join(sorted(PRESETS))}.")
    # Imported on demand: a layout needs its dataset's reader, and h5py or torch with it.
    return importlib.import_module(f"prbench.readers.{preset.replace('-', '_')}.synthetic").LAYOUT


def synthetic_recording(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> Recording:
    """Sense a performance and turn it into a recording.

    Args:
        performance: Performance of a preset that has sensors.
        noise: Multiplies every sensor error; 0 for ideal sensors.
        switches: Which errors are on; all if None.

    Raises:
        UsageError: for a preset without sensors.
    """
    layout = layout_for(performance.preset)
    return layout.recording(layout.sense(performance, noise=noise, switches=switches))
