"""Most memory that this process ever held."""

from __future__ import annotations

import sys
from pathlib import Path

import psutil


def peak_megabytes() -> float:
    """Peak of the resident memory, 10^6 bytes; pages of mapped files count too."""
    if sys.platform == "win32":
        return psutil.Process().memory_info().peak_wset / 1e6
    if sys.platform == "linux":
        # Not getrusage's, which counts what the parent held when it started this process.
        status = Path("/proc/self/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # bytes on macOS
