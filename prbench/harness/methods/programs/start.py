"""Finds out how a program is started from what the user wrote behind ``--method``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from prbench.errors import InputFileError
from prbench.harness.methods.programs.description import MethodDescription, read_description
from prbench.harness.methods.programs.surroundings import Surroundings, below, inside_environment
from prbench.harness.methods.programs.words import (
    PREFIX,
    is_command,
    is_description,
    short_name,
    shown_command,
    split_command,
)
from prbench.harness.methods.remote.process import Program


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
