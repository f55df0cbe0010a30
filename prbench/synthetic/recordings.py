"""Performances as :class:`Recording` objects in memory: the exit that tables and training use.

The same streams come out of writing native files and reading them back, bit for bit: sensors round to the files'
resolution, and one function turns readings into streams, whoever read them.
"""

from __future__ import annotations

from prbench.errors import UsageError
from prbench.formats.adt import AdtReadings
from prbench.manifests import load_manifest
from prbench.recording import Recording
from prbench.recording.from_adt import recording_from_adt
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors.adt import sense
from prbench.synthetic.sensors.errors import Switches

PRESETS_WITH_SENSORS = ("adt",)
"""Presets that have sensors and native files; of the others there is motion only."""


def recording_from_readings(readings: AdtReadings) -> Recording:
    """The streams of one synthetic ADT recording."""
    return recording_from_adt(readings, load_manifest("adt"), dataset="synthetic-adt")


def synthetic_recording(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> Recording:
    """Sense a performance and turn it into a recording.

    Args:
        performance: Of a preset that has sensors.
        noise: Multiplies every sensor error; 0 for ideal sensors.
        switches: Which errors are on; all if None.

    Raises:
        UsageError: for a preset without sensors.
    """
    require_sensors(performance.preset)
    return recording_from_readings(sense(performance, noise=noise, switches=switches))


def require_sensors(preset: str) -> None:
    """Refuse a preset of which there is motion only.

    Raises:
        UsageError: naming the presets that have sensors.
    """
    if preset not in PRESETS_WITH_SENSORS:
        known = ", ".join(PRESETS_WITH_SENSORS)
        raise UsageError(f"preset '{preset}' has motion but no sensors and no native files; use one of: {known}.")
