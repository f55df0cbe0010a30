"""The TOML file that describes a program and the environment that it needs (``docs/environments.md``)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from prbench.errors import InputFileError, did_you_mean
from prbench.files.bounded import foreign_input, read_text
from prbench.harness.methods.names import name_problem
from prbench.limits import HARMLESS_SIZE

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
    _require_known(path, content)
    try:
        description = msgspec.convert(content, MethodDescription)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at `$.")
        where = place.rstrip("`") or "[method]"
        raise InputFileError(
            path, where, expected="what docs/environments.md describes", found=reason[:1].lower() + reason[1:]
        ) from error
    _require_consistent(path, description.environment)
    _require_own_name(path, description.method.name)
    return description


def _require_own_name(path: Path, name: str | None) -> None:
    if name is not None and (problem := name_problem(name)):
        raise InputFileError(
            path, "method.name", expected="a name of the method's own", found=name, remedy=f"{problem}."
        )


def _require_known(path: Path, content: dict[str, object]) -> None:
    _refuse_unknown(path, "", content, list(_TABLES), kind="table")
    for name, table in _TABLES.items():
        keys = content.get(name)
        if isinstance(keys, dict):
            known = [field.encode_name for field in msgspec.structs.fields(table)]
            _refuse_unknown(path, f"{name}.", keys, known, kind="key")


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


def _require_consistent(path: Path, environment: EnvironmentTable) -> None:
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
