"""Performances as :class:`Recording` objects in memory: the exit that tables and training use.

The same streams come out of writing native files and reading them back, bit for bit: sensors round to the files'
resolution, and one function turns readings into streams, whoever read them.
"""

from __future__ import annotations

from prbench.recording import Recording
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors.errors import Switches


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
