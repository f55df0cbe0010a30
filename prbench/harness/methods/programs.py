"""Methods that are programs of their own: ``cmd:`` commands and TOML files, turned into how they are started."""

from __future__ import annotations

import itertools
import os
import shlex
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.bounded import foreign_input, read_toml, require, structured
from prbench.harness.methods import installed, process


def split_command(text: str, *, where: str, windows: bool = os.name == "nt") -> tuple[str, ...]:
    """Split a command line into words; no shell takes part, so there are no pipes and no variables.

    Args:
        text: The command as the user wrote it.
        where: Name of the command's source in messages.
        windows: Backslashes are separators of paths, as on Windows, instead of a POSIX shell's escapes.

    Raises:
        UsageError: if it is empty or a quotation is not closed.
    """
    lexer = shlex.shlex(text, posix=True)
    lexer.whitespace_split = True
    lexer.commenters = ""
    if windows:
        lexer.escape = ""
    try:
        words = list(lexer)
    except ValueError as error:
        raise UsageError(f"{where}: expected every quotation to be closed, found: {text.strip()} ({error}).") from error
    if not words or not words[0]:
        raise UsageError(f'{where}: expected a command, such as cmd:"python glide.py", found nothing.')
    return tuple(words)


def shown_command(words: Iterable[str]) -> str:
    """Return a command for a record that others may read: absolute paths are cut to their last part."""
    return shlex.join(installed.without_folders(word) for word in words)


_Seconds = Annotated[float, msgspec.Meta(gt=0)]
_Text = Annotated[str, msgspec.Meta(min_length=1)]
_PLACES = ("virtual_environment", "conda", "container")
_OF_CONTAINERS = ("engine", "gpus", "user", "volumes")


class _MethodTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[method]``: what is started, and where.

    Attributes:
        command: Program and arguments: a list, or one text that is split into words.
        name: Name that the program must introduce itself by; any name if absent.
        directory: Folder that it starts in, relative to the file.
    """

    command: _Text | Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    name: _Text | None = None
    directory: str = "."


class EnvironmentTable(msgspec.Struct, frozen=True, kw_only=True, rename="kebab", forbid_unknown_fields=True):
    """``[environment]``: in what the command runs. At most one of the first three.

    Attributes:
        virtual_environment: Folder of a Python virtual environment.
        conda: Name or folder of a conda environment.
        container: Image, best named by its digest.
        engine: Program that runs the container; by default the first of these that is installed.
        gpus: True if the container sees the machine's NVIDIA GPUs.
        user: ``uid:gid`` inside the container.
        volumes: Further folders that the container sees, read-only: ``FOLDER`` or ``FOLDER:PLACE``.
        variables: Further environment variables.
    """

    virtual_environment: _Text | None = None
    conda: _Text | None = None
    container: _Text | None = None
    engine: Literal["podman", "docker"] | None = None
    gpus: bool = False
    user: _Text | None = None
    volumes: tuple[_Text, ...] = ()
    variables: dict[str, str] = {}


class _LimitsTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[limits]``: time limits, seconds.

    Attributes:
        start_s: Until the program has introduced itself.
        batch_s: Until a batch is answered.
    """

    start_s: _Seconds = 120.0
    batch_s: _Seconds = 600.0


class MethodDescription(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole TOML file."""

    method: _MethodTable
    environment: EnvironmentTable = EnvironmentTable()
    limits: _LimitsTable = _LimitsTable()


@foreign_input()
def read_description(path: Path) -> MethodDescription:
    """Read and check the file.

    Raises:
        InputFileError: naming the key that is missing, unknown, of the wrong kind, or does not fit the others.
    """
    beside = [file.name for file in path.parent.glob("*.toml")] if path.parent.is_dir() else []
    remedy = "" if path.exists() else did_you_mean(path.name, beside).strip()
    content = read_toml(path, "a TOML file that describes a method", remedy)
    description = structured(path, content, MethodDescription, remedy="docs/environments.md describes the file.")
    # Keys that are right by themselves may not fit the others.
    environment = description.environment
    name = description.method.name
    named = [place.replace("_", "-") for place in _PLACES if getattr(environment, place) is not None]
    stray = [key for key in _OF_CONTAINERS if getattr(environment, key) and environment.container is None]
    own = [variable for variable in environment.variables if variable.upper().startswith("PRBENCH_")]
    problem = None if name is None else installed.name_problem(name)
    if len(named) > 1:
        where, expected, found, remedy = f"environment.{named[1]}", "one kind of environment", " and ".join(named), ""
    elif stray:
        where, expected, found, remedy = f"environment.{stray[0]}", "it beside 'container' only", "no container", ""
    elif own:
        where, expected, found = f"environment.variables.{own[0]}", "no variable of the harness", own[0]
        remedy = "Programs never get variables that begin with PRBENCH_."
    elif problem:
        where, expected, found, remedy = "method.name", "a name of the method's own", str(name), f"{problem}."
    else:
        return description
    raise InputFileError(path, where, expected=expected, found=found, remedy=remedy)


_METHOD_FOLDER = "/method"  # where a container finds the program's folder
_BIN = "Scripts" if os.name == "nt" else "bin"


def find_executable(word: str, *, directory: Path, path: str, where: str) -> str:
    """Find the absolute path of a program as a shell in ``directory`` would find it.

    Args:
        word: A name that is looked up in ``path``, or a path, relative to ``directory``.
        directory: Folder in which the program starts.
        path: Folders, joined as in the variable ``PATH``.
        where: Name of the command's source in messages.

    Raises:
        UsageError: if there is no such program, with what may have been meant.
    """
    if "/" in word or (os.name == "nt" and "\\" in word) or word.startswith("~"):
        file = directory / Path(word).expanduser()
        if not file.is_file() or not os.access(file, os.X_OK):
            names = [path.name for path in file.parent.iterdir()] if file.parent.is_dir() else []
            found = "a file that cannot be executed" if file.is_file() else "none"
            remedy = " Start it with its interpreter." if file.is_file() else did_you_mean(file.name, names)
            raise UsageError(f"{where}: expected a program at {file}, found {found}.{remedy}")
        return os.path.normpath(file.absolute())
    found = shutil.which(word, path=path)
    if found is None:
        raise UsageError(f"{where}: the program '{word}' was not found. It is looked up in the folders of PATH.")
    return str(Path(found).absolute())


def below(file: Path, path: str) -> Path:
    """Resolve a path of a description: absolute, in the user's home, or relative to the file's folder."""
    return Path(os.path.normpath(file.absolute().parent / Path(path).expanduser()))


def runs_in_container(method: str) -> bool:
    """Return True if a method is described to run in a container.

    Raises:
        InputFileError: if its TOML file is not what it should be.
    """
    return (
        installed.is_description(method)
        and read_description(Path(method).expanduser()).environment.container is not None
    )


def program_of(
    method: str,
    *,
    environment: Mapping[str, str],
    weights: Path | None = None,
    timeout: float | None = None,
    hidden: tuple[Path, ...] = (),
) -> process.Program:
    """Make out what a ``cmd:`` or a TOML file asks for.

    Args:
        method: Text behind ``--method``: ``cmd:`` and a command, or the path of a TOML file.
        environment: Environment variables of the program.
        weights: A file or folder that the user gave, which a container has to be shown.
        timeout: Seconds for a batch; by default the description's.
        hidden: Folders that a container must not see, even inside what it is shown.

    Raises:
        UsageError: if the command is empty, or its program or script does not exist.
        InputFileError: if the TOML file is not what it should be, or an environment or its tool is missing.
    """
    file = Path(method).expanduser()
    if installed.is_command(method):
        where = f"--method {installed.PREFIX}…"
        words = split_command(method.removeprefix(installed.PREFIX), where=where)
        description = MethodDescription(method=_MethodTable(command=words))
        directory = Path.cwd()
    else:
        description = read_description(file)
        where = f"{file}, method.command"
        command = description.method.command
        words = split_command(command, where=where) if isinstance(command, str) else command
        directory = below(file, description.method.directory)
        if not directory.is_dir():
            raise InputFileError(file, "method.directory", expected=f"a folder at {directory}", found="none")
    table = description.environment
    variables = {**environment, **table.variables}
    readable = [directory]
    place = ""
    if table.virtual_environment is not None:
        folder = below(file, table.virtual_environment)
        programs = folder / _BIN
        if shutil.which("python", path=str(programs)) is None:
            where = "environment.virtual-environment"
            expected = f"a virtual environment at {folder}"
            remedy = f"Make it: python -m venv {folder}"
            raise InputFileError(file, where, expected=expected, found=f"no python in {programs}", remedy=remedy)
        variables["PATH"] = os.pathsep.join([str(programs), variables.get("PATH", os.defpath)])
        variables["VIRTUAL_ENV"] = str(folder)
        # It would send the environment's own interpreter to another library.
        variables.pop("PYTHONHOME", None)
        readable.append(folder)
        place = f"virtual environment {folder.name}: "
    path = variables.get("PATH", os.defpath)
    if table.conda is not None:
        before, place, folders = _conda(table.conda, file, variables)
        started = (*before, *words)
        readable += folders
    elif table.container is not None:
        before, place = _container(table, file, path, directory, weights, hidden)
        started = (*before, *words)
    else:
        program = find_executable(words[0], directory=directory, path=path, where=where)
        # As in a shell, words that begin with ~/ lead to the user's home.
        started = (program, *(str(Path(word).expanduser()) if word.startswith("~/") else word for word in words[1:]))
    # The files and folders that the command names: its program, and what lies outside its directory.
    named = (directory / Path(word).expanduser() for word in started)
    readable += [Path(os.path.normpath(path)) for path in named if path.exists()]
    limits = description.limits
    return process.Program(
        name=description.method.name or installed.short_name(method if installed.is_command(method) else str(file)),
        words=tuple(started),
        directory=directory,
        environment=tuple(sorted(variables.items())),
        start_timeout=limits.start_s,
        batch_timeout=limits.batch_s if timeout is None else timeout,
        package=place + shown_command(words),
        expected_name=description.method.name,
        readable=tuple(readable),
        in_container=table.container is not None,
    )


def _conda(named: str, file: Path, variables: Mapping[str, str]) -> tuple[list[str], str, list[Path]]:
    """Return the words before the command, the name of the environment, and the folders that it needs."""
    conda = shutil.which("conda", path=variables.get("PATH", os.defpath)) or variables.get("CONDA_EXE")
    is_folder = "/" in named or "\\" in named or named.startswith(("~", "."))
    folder = below(file, named)
    expected, found, remedy = "", "", ""
    if conda is None:
        expected, found = "the program 'conda'", "none in PATH"
        remedy = "Install conda, or start prbench from a shell in which it works."
    elif is_folder and not (folder / "conda-meta").is_dir():
        expected = f"a conda environment at {folder}"
        found = "no conda-meta in it" if folder.is_dir() else "no such folder"
    if conda is None or expected:
        raise InputFileError(file, "environment.conda", expected=expected, found=found, remedy=remedy)
    chosen = ["-p", str(folder)] if is_folder else ["-n", named]
    before = [conda, "run", "--no-capture-output", *chosen]
    return before, f"conda {folder.name if is_folder else named}: ", [folder] if is_folder else []


def _container(
    table: EnvironmentTable, file: Path, path: str, directory: Path, weights: Path | None, hidden: tuple[Path, ...]
) -> tuple[list[str], str]:
    """Return the words before the command, and the name of the container."""
    engines = (table.engine,) if table.engine else ("podman", "docker")
    engine, program = next(((name, at) for name in engines if (at := shutil.which(name, path=path))), ("", ""))
    key = "environment.engine" if table.engine else "environment.container"
    remedy = "Install it, or name the other one with engine."
    require(file, (bool(program), key, f"the program {' or '.join(engines)}", "none in PATH", remedy))
    mounts = [(directory, _METHOD_FOLDER)]
    for text in table.volumes:
        drive = 2 if text[1:2] == ":" and text[:1].isalpha() else 0  # C: of Windows is no separator
        source, _, target = text[drive:].partition(":")
        folder = below(file, text[:drive] + source)
        if not folder.exists():
            expected = f"the file or folder {folder}"
            raise InputFileError(file, "environment.volumes", expected=expected, found="nothing there")
        mounts.append((folder, target or str(folder)))
    if weights is not None and weights.exists():
        mounts.append((weights.absolute(), str(weights.absolute())))
    words = [program, "run", "--rm", "--init", "-i", "--network", "none", "--workdir", _METHOD_FOLDER]
    masked: dict[str, list[str]] = {}
    for source, target in mounts:
        words += ["--volume", f"{source}:{target}:ro"]
        for secret in map(Path.resolve, hidden):
            if secret.is_relative_to(source.resolve()):
                shown = (Path(target) / secret.relative_to(source.resolve())).as_posix()
                masked[shown] = ["--volume", f"/dev/null:{shown}:ro"] if secret.is_file() else ["--tmpfs", shown]
    words += itertools.chain.from_iterable(masked.values())
    # Nobody's program needs to be root; podman without root maps the user by itself.
    user = table.user
    if user is None and engine == "docker" and hasattr(os, "getuid"):
        user = f"{os.getuid()}:{os.getgid()}"
    words += [] if user is None else ["--user", user]
    if table.gpus:
        words += ["--gpus", "all"] if engine == "docker" else ["--device", "nvidia.com/gpu=all"]
    for name, value in sorted(table.variables.items()):
        words += ["--env", f"{name}={value}"]
    return [*words, str(table.container)], f"{engine} {table.container}: "
