"""Tell apart by its form what ``--method`` names; split a program's command into words, show it without folders."""

from __future__ import annotations

import os
import re
import shlex
import textwrap
from collections.abc import Iterable
from pathlib import Path, PurePosixPath, PureWindowsPath

from prbench.errors import UsageError

_WINDOWS_TOKEN = re.compile(r'(?P<slashes>\\*)(?P<quote>"{1,2})|(?P<space>[ \t]+)|(?P<other>\\+|[^\\" \t]+)')
PREFIX = "cmd:"
_SUFFIX = ".toml"
_PYTHON = ".py"
_LONGEST = 60  # characters of a command in messages


def split_command(text: str, *, where: str, windows: bool = os.name == "nt") -> tuple[str, ...]:
    """Split a command line into words; no shell takes part, so there are no pipes and no variables.

    Args:
        text: As the user wrote it.
        where: What to call its source in messages.
        windows: By the rules of Windows (backslashes are separators of paths) instead of a POSIX shell's.

    Raises:
        UsageError: if it is empty or a quotation is not closed.
    """
    try:
        words = _split_on_windows(text) if windows else shlex.split(text)
    except ValueError as error:
        raise UsageError(f"{where}: expected every quotation to be closed, found: {text.strip()} ({error}).") from error
    if not words or not words[0]:
        raise UsageError(f'{where}: expected a command, such as cmd:"python glide.py", found nothing.')
    return tuple(words)


def shown_command(words: Iterable[str]) -> str:
    """Return a command for a record that others may read: absolute paths are cut to their last part."""
    return shlex.join(without_folders(word) for word in words)


def without_folders(word: str) -> str:
    """Cut an absolute path, also behind ``--key=``, to its last part; return any other word as it is."""
    key, equals, value = word.partition("=")
    if equals and key.startswith("-"):
        return f"{key}={without_folders(value)}"
    for kind in (PurePosixPath, PureWindowsPath):
        if kind(word).is_absolute() or word.startswith(("~/", "~\\")):
            return kind(word).name or word
    return word


def is_command(method: str) -> bool:
    """Return True for a command, such as ``cmd:python glide.py``."""
    return method.startswith(PREFIX)


def is_description(method: str) -> bool:
    """Return True for the path of a description, such as ``glide.toml``."""
    return not is_command(method) and method.lower().endswith(_SUFFIX)


def is_program(method: str) -> bool:
    """Return True for a program of its own, False for the name of an installed adapter or of a control."""
    return is_command(method) or is_description(method)


def short_name(method: str) -> str:
    """Return the name that a method has before it has introduced itself; never a path."""
    if is_command(method):
        words = [without_folders(word.strip("\"'")) for word in method.removeprefix(PREFIX).split()]
        return textwrap.shorten(" ".join(words), _LONGEST, placeholder=" …") or "nothing"
    file, _, name = method.rpartition(":")
    if name.isidentifier() and file.lower().endswith(_PYTHON):
        method = file
    return Path(method).stem if is_description(method) or method.lower().endswith(_PYTHON) else method


def _split_on_windows(text: str) -> list[str]:
    """Split as programs on Windows do: quotes group, a backslash escapes only before a quote."""
    words: list[str] = []
    word = ""
    quoted = False
    begun = False
    for token in _WINDOWS_TOKEN.finditer(text):
        if token["space"] and not quoted:
            words += [word] if begun else []
            word = ""
            begun = False
            continue
        begun = True
        if not token["quote"]:
            word += token[0]
            continue
        # An odd number of backslashes escapes the quote; pairs of them stand for one each.
        escaped = len(token["slashes"]) % 2 == 1
        word += "\\" * (len(token["slashes"]) // 2)
        quotes = len(token["quote"])
        if escaped:
            word = word + '"'
            quotes = quotes - 1
        if quotes == 2 and quoted:
            word += '"'  # a doubled quote inside a quotation stands for itself
        elif quotes == 1:
            quoted = not quoted
    if quoted:
        raise ValueError("No closing quotation")
    return words + ([word] if begun else [])
