"""Where prbench keeps what it can make again."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

CACHE_VARIABLE = "PRBENCH_CACHE"


def cache_folder() -> Path:
    """The folder named by ``PRBENCH_CACHE``, else the user's cache folder."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("prbench", appauthor=False))
