"""The weights that a method uses, and their digest."""

from __future__ import annotations

import hashlib
from pathlib import Path

from prbench.contract import Adapter, Condition
from prbench.errors import AdapterError, UsageError
from prbench.storage import file_digest


def used_weights(adapter: Adapter, condition: Condition, given: Path | None, *, origin: str) -> Path | None:
    """Return the weights used under a condition: those the method names itself (``weights_for``), else those given.

    Raises:
        AdapterError: if it names something that is no path.
    """
    weights_for = getattr(adapter, "weights_for", None)
    if weights_for is None:
        return given
    weights = weights_for(condition)
    if weights is None or isinstance(weights, Path):
        return weights
    raise AdapterError(f"{origin}: expected weights_for() to return a pathlib.Path or None, found {weights!r}.")


def require_weights(weights: Path | None) -> None:
    """Refuse a path that does not exist; a single word may be a name that the method knows.

    Raises:
        UsageError: if it is neither.
    """
    if weights is not None and not weights.exists() and (len(weights.parts) > 1 or weights.suffix):
        raise UsageError(f"--weights {weights}: expected a file or folder, found neither.")


def weights_digest(weights: Path | None) -> str | None:
    """Return the SHA-256 of a weights file, or of the names and contents of a folder.

    Raises:
        UsageError: if the path does not exist.
    """
    if weights is None:
        return None
    if weights.is_file():
        return file_digest(weights)
    if not weights.is_dir():
        raise UsageError(f"--weights {weights}: expected a file or folder, found neither.")
    total = hashlib.sha256()
    for path in sorted(path for path in weights.rglob("*") if path.is_file()):
        total.update(f"{path.relative_to(weights).as_posix()}\t{file_digest(path)}\n".encode())
    return total.hexdigest()
