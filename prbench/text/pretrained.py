"""What the text encoders with files of their own share: where the files may be, and what is said if none will do."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

_HUB_ID = re.compile(r"[\w.-]+(/[\w.-]+)?")


def careful_loading(source: str) -> dict[str, Any] | None:
    """Options of ``from_pretrained`` with which no code of a repository is run, and a folder asks nobody else.

    Args:
        source: A local folder or a hub id.

    Returns:
        None if it is neither.
    """
    local = Path(source).is_dir()
    if not local and _HUB_ID.fullmatch(source) is None:
        return None
    return {"trust_remote_code": False, "local_files_only": local}


def first_line(error: BaseException) -> str:
    """What went wrong, short enough for a message."""
    return str(error).strip().partition("\n")[0].rstrip(".")[:300] or type(error).__name__
