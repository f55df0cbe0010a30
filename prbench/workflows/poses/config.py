"""Configuration of EgoAllo on this machine: a small TOML file that the user writes once."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import msgspec

from prbench.boundary import foreign_input
from prbench.bounded import read_text
from prbench.errors import InputFileError
from prbench.limits import HARMLESS_SIZE
from prbench.readers.egoallo.inputs import Need

_PLACEHOLDERS = {
    "python": "the interpreter named in the config",
    "recording": "name of the recording",
    "mps": "folder with slam/, hand_tracking/ and a link to the VRS file: EgoAllo's --traj-root",
    "trajectory": "the trajectory file in it",
    "out": "folder where outputs must appear ({mps}/egoallo_outputs)",
    "frames": "frames that cover the whole recording: EgoAllo's --traj-length",
    "guidance": "aria_wrist_only where wrists were tracked, else no_hands: EgoAllo's --guidance-mode",
    "model": "the SMPL-H model",
}
"""Placeholders that may stand in braces in a command, and their meanings."""

_DEFAULT_COMMAND = (
    "{python}", "3_aria_inference.py", "--traj-root", "{mps}", "--traj-length", "{frames}",
    "--guidance-mode", "{guidance}", "--smplh-npz-path", "{model}",
)  # fmt: skip
"""EgoAllo's own script (repository brentyi/egoallo, commit 0c20ae8)."""


class PosesConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table ``[egoallo]`` of a config file."""

    python: str
    """Interpreter of the environment in which EgoAllo is installed."""
    folder: Path
    """EgoAllo's repository: the command runs there."""
    command: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)] = _DEFAULT_COMMAND
    """Program and arguments, one text each; never a line for a shell."""
    model: Path | None = None
    """The SMPL-H model; found as the readers find it if None."""
    needs: frozenset[Need] = frozenset(("vrs", "points"))
    """Inputs that EgoAllo cannot do without; ``points`` tell it the floor, ``vrs`` the calibration."""
    timeout_minutes: Annotated[float, msgspec.Meta(gt=0)] = 120.0
    """Longest time for one recording."""
    environment: dict[str, str] = {}
    """Further environment variables, for example ``CUDA_VISIBLE_DEVICES``."""

    def command_line(self, values: Mapping[str, str]) -> list[str]:
        """The command with its placeholders filled; texts stay single arguments whatever they hold."""
        filled = {"python": self.python} | dict(values)
        return [_PLACEHOLDER.sub(lambda match: filled[match[1]], text) for text in self.command]


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    egoallo: PosesConfig


_PLACEHOLDER = re.compile(r"\{(\w+)\}")


@foreign_input()
def read_config(path: Path) -> PosesConfig:
    """Read a config file; relative paths in it are relative to its folder.

    Raises:
        InputFileError: if it is missing, no TOML, lacks a key or holds an unknown one, or its command has an unknown
            placeholder.
    """
    try:
        content = tomllib.loads(read_text(path, encoding="utf-8", largest=HARMLESS_SIZE))
        config = msgspec.convert(content, _File, dec_hook=_path).egoallo
    except FileNotFoundError as error:
        raise InputFileError(
            path,
            "",
            expected="a config file",
            found="no such file",
            remedy="`prbench poses egoallo --root DIR` without --config prints one to start from.",
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise InputFileError(
            path,
            "",
            expected="a table [egoallo] with python and folder, and optionally command, model, needs, timeout_minutes"
            " and environment",
            found=str(error),
            remedy="`prbench poses egoallo --root DIR` without --config prints one to start from.",
        ) from error
    unknown = [name for text in config.command for name in _PLACEHOLDER.findall(text) if name not in _PLACEHOLDERS]
    if unknown:
        raise InputFileError(
            path,
            "egoallo.command",
            expected=f"the placeholders {', '.join(f'{{{name}}}' for name in _PLACEHOLDERS)}",
            found=f"{{{unknown[0]}}}",
        )
    return _with_absolute_paths(config, path.expanduser().absolute().parent)


def _with_absolute_paths(config: PosesConfig, base: Path) -> PosesConfig:
    model = None if config.model is None else base / config.model.expanduser()
    looks_like_path = "/" in config.python or "\\" in config.python
    python = str(base / Path(config.python).expanduser()) if looks_like_path else config.python
    return msgspec.structs.replace(config, python=python, folder=base / config.folder.expanduser(), model=model)


def _path(kind: type, value: object) -> object:
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise NotImplementedError(f"values of the type {kind}")
