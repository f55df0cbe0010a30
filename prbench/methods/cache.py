"""Where prbench keeps what it can make again (see :func:`prbench.storage.cache_folder`)."""

from __future__ import annotations

from prbench.storage import CACHE_VARIABLE, cache_folder

__all__ = ["CACHE_VARIABLE", "cache_folder"]
