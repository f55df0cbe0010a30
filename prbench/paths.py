"""Paths as people write them: text wherever a path is asked for."""

from __future__ import annotations

from pathlib import Path


def turn_into_paths(request: object, *names: str) -> None:
    """Turn text in some attributes of a frozen data class into paths; for its ``__post_init__``.

    Args:
        request: The instance.
        names: Attributes that hold a path, several paths, or None.
    """
    for name in names:
        value = getattr(request, name)
        if isinstance(value, str):
            object.__setattr__(request, name, Path(value))
        elif isinstance(value, tuple | list):
            object.__setattr__(request, name, tuple(Path(each) for each in value))
