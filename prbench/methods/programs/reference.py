"""What ``--method`` may be, told apart by its form alone."""

from __future__ import annotations

import textwrap
from pathlib import Path

from prbench.methods.programs.words import without_folders

PREFIX = "cmd:"
SUFFIX = ".toml"
_LONGEST = 60  # characters of a command in messages


def is_command(method: str) -> bool:
    """``cmd:python glide.py``."""
    return method.startswith(PREFIX)


def is_description(method: str) -> bool:
    """``glide.toml``."""
    return not is_command(method) and method.lower().endswith(SUFFIX)


def is_program(method: str) -> bool:
    """Whether a method is a program of its own, not the name of an installed adapter or of a control."""
    return is_command(method) or is_description(method)


def short_name(method: str) -> str:
    """What to call a method before it has introduced itself: never a path."""
    if is_command(method):
        words = [without_folders(word.strip("\"'")) for word in method.removeprefix(PREFIX).split()]
        return textwrap.shorten(" ".join(words), _LONGEST, placeholder=" …") or "nothing"
    return Path(method).stem if is_description(method) else method
