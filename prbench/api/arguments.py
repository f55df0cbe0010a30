"""Arguments as people write them in a notebook: one value or several, text or paths, turned into one form."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from prbench.errors import UsageError

PathLike = str | os.PathLike[str]
"""A path as text or as a :class:`pathlib.Path`; ``~`` means the home folder."""


def as_path(value: PathLike) -> Path:
    """Return a path; ``~`` is the home folder, as a shell has it.

    Args:
        value: Path as text or :class:`pathlib.Path`.
    """
    return Path(value).expanduser()


def as_optional_path(value: PathLike | None) -> Path | None:
    """Return :func:`as_path` of a value, or None for None.

    Args:
        value: Path as text or :class:`pathlib.Path`, or None.
    """
    return None if value is None else as_path(value)


def as_texts(value: str | Iterable[str]) -> tuple[str, ...]:
    """Return one text or several as a tuple.

    Args:
        value: A text, or texts.
    """
    return (value,) if isinstance(value, str) else tuple(value)


def as_options(value: Mapping[str, object] | None, *, name: str = "option") -> dict[str, str]:
    """Return options by name as text, which is what ``--option NAME=VALUE`` hands over.

    Args:
        value: Options by name; ``True`` and ``False`` become ``true`` and ``false``. None stands for no options.
        name: Name of the argument, for the message.

    Raises:
        UsageError: if it maps no names to values.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise UsageError(f"{name}: expected a dict such as {{'name': 'value'}}, found {type(value).__name__}.")
    return {str(key): _as_text(each) for key, each in value.items()}


def _as_text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def require_positive(**numbers: int | None) -> None:
    """Refuse counts below 1; None stands for "not given".

    Args:
        numbers: Values by the name of their argument.

    Raises:
        UsageError: naming the first wrong one.
    """
    for name, value in numbers.items():
        if value is not None and value < 1:
            raise UsageError(f"{name}: expected a whole number of at least 1, found '{value}'")
