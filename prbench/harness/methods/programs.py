"""Methods that are programs of their own: ``cmd:`` commands and TOML files, turned into how they are started."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Literal

import msgspec

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.bounded import foreign_input, read_text
from prbench.harness.methods.installed import name_problem
from prbench.harness.methods.process import Program
from prbench.limits import HARMLESS_SIZE

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


_Seconds = Annotated[float, msgspec.Meta(gt=0)]
_Text = Annotated[str, msgspec.Meta(min_length=1)]
_PLACES = ("virtual_environment", "conda", "container")
_OF_CONTAINERS = ("engine", "gpus", "user", "volumes")


class _MethodTable(msgspec.Struct, frozen=True, kw_only=True):
    """``[method]``: what is started, and where."""

    command: _Text | Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    """Program and arguments: a list, or one text that is split into words."""
    name: _Text | None = None
    """Name that the program must introduce itself by; any name if absent."""
    directory: str = "."
    """Folder that it starts in, relative to the file."""


class EnvironmentTable(msgspec.Struct, frozen=True, kw_only=True, rename="kebab"):
    """``[environment]``: in what the command runs. At most one of the first three."""

    virtual_environment: _Text | None = None
    """Folder of a Python virtual environment."""
    conda: _Text | None = None
    """Name or folder of a conda environment."""
    container: _Text | None = None
    """Image, best named by its digest."""
    engine: Literal["podman", "docker"] | None = None
    """Program that runs the container; by default the first of these that is installed."""
    gpus: bool = False
    """True if the container sees the machine's NVIDIA GPUs."""
    user: _Text | None = None
    """``uid:gid`` inside the container."""
    volumes: tuple[_Text, ...] = ()
    """Further folders that the container sees, read-only: ``FOLDER`` or ``FOLDER:PLACE``."""
    variables: dict[str, str] = {}
    """Further environment variables."""


class _LimitsTable(msgspec.Struct, frozen=True, kw_only=True):
    """``[limits]``: time limits, seconds."""

    start_s: _Seconds = 120.0
    """Until the program has introduced itself."""
    batch_s: _Seconds = 600.0
    """Until a batch is answered."""


class MethodDescription(msgspec.Struct, frozen=True, kw_only=True):
    """The whole TOML file."""

    method: _MethodTable
    environment: EnvironmentTable = EnvironmentTable()
    limits: _LimitsTable = _LimitsTable()

    @classmethod
    def of(cls, words: tuple[str, ...]) -> MethodDescription:
        """Describe a bare command."""
        return cls(method=_MethodTable(command=words))


_TABLES: dict[str, type[msgspec.Struct]] = {
    "method": _MethodTable,
    "environment": EnvironmentTable,
    "limits": _LimitsTable,
}


@foreign_input()
def read_description(path: Path) -> MethodDescription:
    """Read and check the file.

    Raises:
        InputFileError: naming the key that is missing, unknown, of the wrong kind, or does not fit the others.
    """
    try:
        content = tomllib.loads(read_text(path, encoding="utf-8", largest=HARMLESS_SIZE))
    except FileNotFoundError as error:
        beside = [file.name for file in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        remedy = did_you_mean(path.name, beside).strip()
        raise InputFileError(
            path, "", expected="a TOML file that describes a method", found="no such file", remedy=remedy
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputFileError(path, "", expected="a TOML file", found=str(error)) from error
    _refuse_unknown(path, "", content, list(_TABLES), kind="table")
    for name, table in _TABLES.items():
        keys = content.get(name)
        if isinstance(keys, dict):
            known = [field.encode_name for field in msgspec.structs.fields(table)]
            _refuse_unknown(path, f"{name}.", keys, known, kind="key")
    try:
        description = msgspec.convert(content, MethodDescription)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at `$.")
        where = place.rstrip("`") or "[method]"
        raise InputFileError(
            path, where, expected="what docs/environments.md describes", found=reason[:1].lower() + reason[1:]
        ) from error
    environment = description.environment
    named = [name.replace("_", "-") for name in _PLACES if getattr(environment, name) is not None]
    if len(named) > 1:
        raise InputFileError(
            path, f"environment.{named[1]}", expected="one kind of environment", found=f"{named[0]} and {named[1]}"
        )
    stray = [name for name in _OF_CONTAINERS if getattr(environment, name)]
    if stray and environment.container is None:
        raise InputFileError(
            path, f"environment.{stray[0]}", expected="it beside 'container' only", found="no container"
        )
    own = [name for name in environment.variables if name.upper().startswith("PRBENCH_")]
    if own:
        raise InputFileError(
            path,
            f"environment.variables.{own[0]}",
            expected="no variable of the harness",
            found=own[0],
            remedy="Programs never get variables that begin with PRBENCH_.",
        )
    _require_own_name(path, description.method.name)
    return description


def _require_own_name(path: Path, name: str | None) -> None:
    if name is not None and (problem := name_problem(name)):
        raise InputFileError(
            path, "method.name", expected="a name of the method's own", found=name, remedy=f"{problem}."
        )


def _refuse_unknown(path: Path, prefix: str, found: dict[str, object], known: list[str], *, kind: str) -> None:
    for name in found:
        if name not in known:
            raise InputFileError(
                path,
                f"{prefix}{name}",
                expected=f"one of {', '.join(known)}",
                found=f"an unknown {kind}",
                remedy=did_you_mean(name, known).strip(),
            )


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
    if "/" in word or (os.name == "nt" and "\\" in word) or word.startswith("~"):
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
        folder = below(file, table.virtual_environment)
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
    if table.conda is not None:
        return _in_conda(start, table.conda, file)
    if table.container is not None:
        engine, program = _engine(start.environment, table.engine, file)
        mounts = [(start.directory, _METHOD_FOLDER), *(_volume(text, file) for text in table.volumes)]
        if weights is not None and weights.exists():
            mounts.append((weights.absolute(), str(weights.absolute())))
        words = [program, "run", "--rm", "--init", "-i", "--network", "none", "--workdir", _METHOD_FOLDER]
        for source, target in mounts:
            words += ["--volume", f"{source}:{target}:ro"]
        for masked in _masked(mounts, hidden):
            words += ["--tmpfs", masked]
        # Nobody's program needs to be root; podman without root maps the user by itself.
        asked = table.user
        if asked is None and engine == "docker" and hasattr(os, "getuid"):
            asked = f"{os.getuid()}:{os.getgid()}"
        words += [] if asked is None else ["--user", asked]
        if table.gpus:
            words += ["--gpus", "all"] if engine == "docker" else ["--device", "nvidia.com/gpu=all"]
        for name, value in sorted(table.variables.items()):
            words += ["--env", f"{name}={value}"]
        return replace(start, words=(*words, str(table.container), *start.words), place=f"{engine} {table.container}")
    return start.found()


def below(file: Path, path: str) -> Path:
    """Resolve a path of a description: absolute, in the user's home, or relative to the file's folder."""
    return Path(os.path.normpath(file.absolute().parent / Path(path).expanduser()))


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


def _masked(mounts: list[tuple[Path, str]], hidden: tuple[Path, ...]) -> list[str]:
    """Return the places in the container that would show a hidden folder."""
    places = []
    for source, target in mounts:
        for folder in hidden:
            if folder.resolve().is_relative_to(source.resolve()):
                inner = folder.resolve().relative_to(source.resolve())
                places.append((Path(target) / inner).as_posix())
    return list(dict.fromkeys(places))


@dataclass(frozen=True)
class MethodProgram:
    """A program that the user named, ready to be started."""

    program: Program
    package: str
    """The command and its environment, for the record: without the folders of this machine."""
    expected_name: str | None = None
    """Name that it must introduce itself by; any name if None."""
    readable: tuple[Path, ...] = ()
    """Files and folders that it needs beside the system's."""
    in_container: bool = False


def program_of(
    method: str,
    *,
    environment: Mapping[str, str],
    weights: Path | None = None,
    timeout: float | None = None,
    hidden: tuple[Path, ...] = (),
) -> MethodProgram:
    """Make out what a ``cmd:`` or a TOML file asks for.

    Args:
        method: As given by ``--method``.
        environment: Environment variables of the program.
        weights: A file or folder that the user gave.
        timeout: Seconds for a batch; by default the description's.
        hidden: Folders that a container must not see.

    Raises:
        UsageError: if the command is empty or its program does not exist.
        InputFileError: if the TOML file is not what it should be.
    """
    if is_command(method):
        return _of_command(method, dict(environment), timeout)
    return _of_description(Path(method).expanduser(), dict(environment), weights, timeout, hidden)


def runs_in_container(method: str) -> bool:
    """Return True if a method is described to run in a container.

    Raises:
        InputFileError: if its TOML file is not what it should be.
    """
    return is_description(method) and read_description(Path(method).expanduser()).environment.container is not None


def own_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the user's environment as a program of their own gets it: without the harness's variables."""
    return {name: value for name, value in environment.items() if not name.upper().startswith("PRBENCH_")}


def _of_command(method: str, environment: dict[str, str], timeout: float | None) -> MethodProgram:
    where = f"--method {PREFIX}…"
    words = split_command(method.removeprefix(PREFIX), where=where)
    start = Surroundings(words, Path.cwd(), environment, where).found()
    return _method_program(method, words, start, MethodDescription.of(words), timeout)


def _of_description(
    file: Path, environment: dict[str, str], weights: Path | None, timeout: float | None, hidden: tuple[Path, ...]
) -> MethodProgram:
    description = read_description(file)
    command = description.method.command
    where = f"{file}, method.command"
    words = split_command(command, where=where) if isinstance(command, str) else command
    directory = below(file, description.method.directory)
    if not directory.is_dir():
        raise InputFileError(file, "method.directory", expected=f"a folder at {directory}", found="none")
    start = inside_environment(
        Surroundings(words, directory, environment, where),
        description.environment,
        file=file,
        weights=weights,
        hidden=hidden,
    )
    return _method_program(str(file), words, start, description, timeout)


def _method_program(
    method: str,
    words: tuple[str, ...],
    start: Surroundings,
    description: MethodDescription,
    timeout: float | None,
) -> MethodProgram:
    limits = description.limits
    program = Program(
        name=description.method.name or short_name(method),
        words=start.words,
        directory=start.directory,
        environment=tuple(sorted(start.environment.items())),
        start_timeout=limits.start_s,
        batch_timeout=limits.batch_s if timeout is None else timeout,
    )
    return MethodProgram(
        program,
        package=f"{start.place}: {shown_command(words)}" if start.place else shown_command(words),
        expected_name=description.method.name,
        readable=(start.directory, *start.readable, *_named_files(start)),
        in_container=description.environment.container is not None,
    )


def _named_files(start: Surroundings) -> tuple[Path, ...]:
    """Return the existing paths that the command names: its program, and files or folders outside its directory."""
    paths = (start.directory / Path(word).expanduser() for word in start.words)
    return tuple(Path(os.path.normpath(path)) for path in paths if path.exists())
