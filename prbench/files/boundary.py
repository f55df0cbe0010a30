"""The boundary between files that other people wrote and the code that reads them.

Every function through which such files are read stands behind :func:`foreign_input`. A reader foresees much, never
everything: what it did not foresee leaves it as some exception of Python, NumPy or Arrow. Here that becomes the one
message that a damaged file deserves, so that no list of exceptions has to be complete anywhere else.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from prbench.errors import InputFileError, PrbenchError, UnforeseenInput

_COPY_AGAIN = "The file may be damaged; copy or download it again."
_PLACES = ("shown", "path", "folder", "root")
"""Attributes by which the objects that readers pass around name the file or folder that they stand for."""


@contextlib.contextmanager
def foreign_input(place: Path | str = "input") -> Iterator[None]:
    """Let nothing but errors of prbench, and ``MemoryError``, out of a block or function that reads foreign files.

    The message names the file that was being read: the one that the system's error names, else the path that the
    innermost function of prbench was working on.

    Args:
        place: Named if no path can be found; a file or folder.

    Raises:
        InputFileError: for a file that cannot be opened or read (a folder, a looping link, no permission), nests too
            deep, or is no text.
        UnforeseenInput: for everything else, naming the kind of the original error, which is its cause.
    """
    try:
        yield
    except (PrbenchError, MemoryError):
        raise
    except RecursionError as error:
        raise InputFileError(
            _file_of(error) or place,
            "",
            expected="values nested at most some hundred levels deep",
            found="more",
            remedy=_COPY_AGAIN,
        ) from error
    except UnicodeDecodeError as error:
        raise InputFileError(
            _file_of(error) or place, "", expected="text in UTF-8", found=f"other bytes ({error})", remedy=_COPY_AGAIN
        ) from error
    except Exception as error:
        file = _file_of(error) or place
        refusal = _refusal(error)
        if refusal:
            raise InputFileError(
                file, "", expected="a file that can be read", found=refusal, remedy=_COPY_AGAIN
            ) from error
        raise UnforeseenInput(
            file,
            "",
            expected="content that prbench can read",
            found=f"what ends in {type(error).__name__}: {error}",
            remedy=_COPY_AGAIN,
        ) from error


def _refusal(error: Exception) -> str:
    """Return the reason why the system did not let a file be read; empty if that was not what went wrong."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    looping = isinstance(error, RuntimeError) and str(error).startswith("Symlink loop")  # of Path.resolve
    return "a link that leads to itself" if looping else ""


def _file_of(error: Exception) -> Path | None:
    """The file that was being read when an error arose."""
    named = error.filename if isinstance(error, OSError) else None
    if isinstance(named, str | bytes):
        return Path(os.fsdecode(named))
    return _innermost_path(error.__traceback__)


def _innermost_path(traceback: TracebackType | None) -> Path | None:
    """The path that the innermost function of prbench knew when an error arose; None if none knew one."""
    found = None
    while traceback is not None:
        frame = traceback.tb_frame
        if str(frame.f_globals.get("__name__")).startswith("prbench") and frame.f_globals is not globals():
            found = next(filter(None, map(_path_of, frame.f_locals.values())), None) or found
        traceback = traceback.tb_next
    return found


def _path_of(value: object) -> Path | None:
    if isinstance(value, Path):
        return value
    if not str(type(value).__module__).startswith("prbench"):
        return None
    return next((path for name in _PLACES if isinstance(path := getattr(value, name, None), Path)), None)
