"""Memory that is free again, given back to the operating system."""

from __future__ import annotations

import ctypes
import sys

import pyarrow as pa


def give_back() -> None:
    """Return what allocators keep of freed memory; call it between two stages that each take much of their own.

    Arrow's pool and the C library keep freed memory for later, in pieces that the next stage seldom fits into.
    """
    pa.default_memory_pool().release_unused()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
        if trim is not None:
            trim(0)
