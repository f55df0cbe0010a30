"""Find what a command starts, and put it into the environment that it needs: virtual environment, conda, container."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.harness.methods.programs.description import EnvironmentTable

_INTERPRETERS = {".py": "python", ".js": "node", ".mjs": "node", ".cjs": "node", ".jl": "julia", ".r": "Rscript"}
_METHOD_FOLDER = "/method"  # where a container finds the program's folder
_BIN = "Scripts" if os.name == "nt" else "bin"


def find_executable(word: str, *, directory: Path, path: str, where: str) -> str:
    """Find the absolute path of a program as a shell in ``directory`` would find it.

    Args:
        word: A name that is looked up in ``path``, or a path, relative to ``directory``.
        directory: Where the program starts.
        path: Folders, joined as in the variable ``PATH``.
        where: Name of the command's source in messages.

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


@dataclass(frozen=True)
class Surroundings:
    """A command, and where and in which environment it starts."""

    words: tuple[str, ...]
    directory: Path
    environment: dict[str, str]
    where: str
    """What to call the command's source in messages."""
    readable: tuple[Path, ...] = ()
    """Paths that it needs beside its directory and its executable."""
    place: str = ""
    """Kind and name of the environment, for the record."""

    def found(self) -> Surroundings:
        """Return the same with the program's absolute path; words that begin with ``~/`` lead to the user's home.

        Raises:
            UsageError: if the program, or the script that it is to run, does not exist.
        """
        path = self.environment.get("PATH", os.defpath)
        program = find_executable(self.words[0], directory=self.directory, path=path, where=self.where)
        require_script(self.words, directory=self.directory, where=self.where)
        arguments = (str(Path(word).expanduser()) if word.startswith("~/") else word for word in self.words[1:])
        return replace(self, words=(program, *arguments))


def inside_environment(
    start: Surroundings, table: EnvironmentTable, *, file: Path, weights: Path | None, hidden: tuple[Path, ...]
) -> Surroundings:
    """Return the command inside the environment that a description asks for.

    Args:
        start: The command as it would run in the user's own environment.
        table: What is asked for.
        file: The description; paths in it are relative to its folder.
        weights: A file or folder that the user gave, which a container has to be shown.
        hidden: Folders that a container must not see, even inside what it is shown.

    Raises:
        InputFileError: if an environment or its tool is missing.
        UsageError: if the program is.
    """
    start = replace(start, environment={**start.environment, **table.variables})
    if table.virtual_environment is not None:
        return _in_virtual_environment(start, table.virtual_environment, file)
    if table.conda is not None:
        return _in_conda(start, table.conda, file)
    if table.container is not None:
        return _in_container(start, table, file, weights, hidden)
    return start.found()


def below(file: Path, path: str) -> Path:
    """Resolve a path of a description: absolute, in the user's home, or relative to the file's folder."""
    return Path(os.path.normpath(file.absolute().parent / Path(path).expanduser()))


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


def _in_virtual_environment(start: Surroundings, named: str, file: Path) -> Surroundings:
    folder = below(file, named)
    programs = folder / _BIN
    if shutil.which("python", path=str(programs)) is None:
        raise InputFileError(
            file,
            "environment.virtual-environment",
            expected=f"a virtual environment at {folder}",
            found=f"no python in {programs}",
            remedy=f"Make it: python -m venv {folder}",
        )
    path = os.pathsep.join([str(programs), start.environment.get("PATH", os.defpath)])
    environment = {**start.environment, "PATH": path, "VIRTUAL_ENV": str(folder)}
    # It would send the environment's own interpreter to another library.
    environment.pop("PYTHONHOME", None)
    found = replace(start, environment=environment, readable=(*start.readable, folder)).found()
    return replace(found, place=f"virtual environment {folder.name}")


def _in_conda(start: Surroundings, named: str, file: Path) -> Surroundings:
    conda = shutil.which("conda", path=start.environment.get("PATH", os.defpath)) or start.environment.get("CONDA_EXE")
    if conda is None:
        raise InputFileError(
            file,
            "environment.conda",
            expected="the program 'conda'",
            found="none in PATH",
            remedy="Install conda, or start prbench from a shell in which it works.",
        )
    is_folder = "/" in named or "\\" in named or named.startswith(("~", "."))
    folder = below(file, named)
    if is_folder and not (folder / "conda-meta").is_dir():
        raise InputFileError(
            file,
            "environment.conda",
            expected=f"a conda environment at {folder}",
            found="no conda-meta in it" if folder.is_dir() else "no such folder",
        )
    chosen = ("-p", str(folder)) if is_folder else ("-n", named)
    require_script(start.words, directory=start.directory, where=start.where)
    return replace(
        start,
        words=(conda, "run", "--no-capture-output", *chosen, *start.words),
        readable=(*start.readable, *([folder] if is_folder else [])),
        place=f"conda {folder.name if is_folder else named}",
    )


def _in_container(
    start: Surroundings, table: EnvironmentTable, file: Path, weights: Path | None, hidden: tuple[Path, ...]
) -> Surroundings:
    engine, program = _engine(start.environment, table.engine, file)
    mounts = [(start.directory, _METHOD_FOLDER), *(_volume(text, file) for text in table.volumes)]
    if weights is not None and weights.exists():
        mounts.append((weights.absolute(), str(weights.absolute())))
    words = [program, "run", "--rm", "--init", "-i", "--network", "none", "--workdir", _METHOD_FOLDER]
    for source, target in mounts:
        words += ["--volume", f"{source}:{target}:ro"]
    for masked in _masked(mounts, hidden):
        words += ["--tmpfs", masked]
    words += _user(engine, table.user)
    if table.gpus:
        words += ["--gpus", "all"] if engine == "docker" else ["--device", "nvidia.com/gpu=all"]
    for name, value in sorted(table.variables.items()):
        words += ["--env", f"{name}={value}"]
    return replace(start, words=(*words, str(table.container), *start.words), place=f"{engine} {table.container}")


def _engine(environment: Mapping[str, str], asked: str | None, file: Path) -> tuple[str, str]:
    """Return name and path of the program that runs containers."""
    names = (asked,) if asked else ("podman", "docker")
    for name in names:
        program = shutil.which(name, path=environment.get("PATH", os.defpath))
        if program is not None:
            return name, program
    raise InputFileError(
        file,
        "environment.engine" if asked else "environment.container",
        expected=f"the program {' or '.join(names)}",
        found="none in PATH",
        remedy="Install it, or name the other one with engine.",
    )


def _volume(text: str, file: Path) -> tuple[Path, str]:
    """Return a folder of this machine and its place in the container; ``C:`` of Windows is no separator."""
    drive = 2 if text[1:2] == ":" and text[:1].isalpha() else 0
    source, _, target = text[drive:].partition(":")
    folder = below(file, text[:drive] + source)
    if not folder.exists():
        raise InputFileError(
            file, "environment.volumes", expected=f"the file or folder {folder}", found="nothing there"
        )
    return folder, target or str(folder)


def _user(engine: str, asked: str | None) -> list[str]:
    """Nobody's program needs to be root; podman without root maps the user by itself."""
    if asked is None and engine == "docker" and hasattr(os, "getuid"):
        asked = f"{os.getuid()}:{os.getgid()}"
    return [] if asked is None else ["--user", asked]


def _masked(mounts: list[tuple[Path, str]], hidden: tuple[Path, ...]) -> list[str]:
    """Return the places in the container that would show a hidden folder."""
    places = []
    for source, target in mounts:
        for folder in hidden:
            if folder.resolve().is_relative_to(source.resolve()):
                inner = folder.resolve().relative_to(source.resolve())
                places.append((Path(target) / inner).as_posix())
    return list(dict.fromkeys(places))
