"""Most memory that this process ever held."""

from __future__ import annotations

import sys

import psutil


def peak_megabytes() -> float:
    """Peak of the resident memory, 10^6 bytes; pages of mapped files count too."""
    if sys.platform == "win32":
        return psutil.Process().memory_info().peak_wset / 1e6
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
