"""Find what a command starts, or say what may have been meant."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from prbench.errors import UsageError, did_you_mean

_INTERPRETERS = {".py": "python", ".js": "node", ".mjs": "node", ".cjs": "node", ".jl": "julia", ".r": "Rscript"}


def find_executable(word: str, *, directory: Path, path: str, where: str) -> str:
    """The absolute path of a program, found as a shell in ``directory`` would find it.

    Args:
        word: A name that is looked up in ``path``, or a path, relative to ``directory``.
        directory: Where the program starts.
        path: Folders, joined as in the variable ``PATH``.
        where: What to call the command's source in messages.

    Raises:
        UsageError: if there is no such program, with what may have been meant.
    """
    if _is_path(word):
        file = directory / Path(word).expanduser()
        return str(_require_executable(file, word, where))
    found = shutil.which(word, path=path)
    if found is None:
        raise UsageError(f"{where}: the program '{word}' was not found.{_hint(word, directory, path)}")
    return str(Path(found).absolute())


def require_script(words: tuple[str, ...], *, directory: Path, where: str) -> None:
    """Refuse a script that is not there before its interpreter does so in its own words.

    Raises:
        UsageError: with the nearest file.
    """
    if len(words) < 2 or Path(words[1]).suffix.lower() not in _INTERPRETERS:
        return
    file = directory / Path(words[1]).expanduser()
    if not file.is_file():
        beside = [path.name for path in file.parent.iterdir()] if file.parent.is_dir() else []
        raise UsageError(
            f"{where}: expected the file {words[1]} in {directory}, found none.{did_you_mean(file.name, beside)}"
        )


def _is_path(word: str) -> bool:
    return "/" in word or (os.name == "nt" and "\\" in word) or word.startswith("~")


def _require_executable(file: Path, word: str, where: str) -> Path:
    if not file.is_file():
        names = [path.name for path in file.parent.iterdir()] if file.parent.is_dir() else []
        raise UsageError(f"{where}: expected a program at {file}, found none.{did_you_mean(file.name, names)}")
    if not os.access(file, os.X_OK):
        started = f' Start it with its interpreter: cmd:"{_interpreter(word)} {word}".' if _interpreter(word) else ""
        raise UsageError(f"{where}: {file} is a file, but not one that can be executed.{started}")
    return Path(os.path.normpath(file.absolute()))


def _hint(word: str, directory: Path, path: str) -> str:
    if (directory / word).is_file():
        interpreter = _interpreter(word)
        return f' Did you mean cmd:"{interpreter} {word}"?' if interpreter else f" Did you mean ./{word}?"
    return did_you_mean(word, _names_in(path)) or " It is looked up in the folders of PATH."


def _interpreter(word: str) -> str:
    return _INTERPRETERS.get(Path(word).suffix.lower(), "")


def _names_in(path: str) -> Iterator[str]:
    for folder in dict.fromkeys(path.split(os.pathsep)):
        if folder and Path(folder).is_dir():
            yield from (file.name for file in Path(folder).iterdir())
