"""Configuration of EgoAllo on this machine, and the instructions that lead to it.

The configuration is a small TOML file that the user writes once; whoever has none yet gets the instructions.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec

from prbench.curation.poses.states import PoseState
from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, read_text
from prbench.limits import HARMLESS_SIZE
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.bodies import HOW_TO_GET
from prbench.readers.egoallo.files import Need

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

_PLACEHOLDER = re.compile(r"\{(\w+)\}")
_DEFAULT_COMMAND = (
    "{python}", "3_aria_inference.py", "--traj-root", "{mps}", "--traj-length", "{frames}",
    "--guidance-mode", "{guidance}", "--smplh-npz-path", "{model}",
)  # fmt: skip
"""EgoAllo's own script (repository brentyi/egoallo, commit 0c20ae8)."""
_INSTALL = """\
EgoAllo estimates bodies from the glasses' path; prbench reads its outputs and can run it, but does not contain it.
It needs Python 3.12 or newer and an NVIDIA GPU (repository brentyi/egoallo, MIT; commands of commit 0c20ae8):

  git clone https://github.com/brentyi/egoallo.git
  cd egoallo
  python3.12 -m venv .venv && . .venv/bin/activate
  pip install -e .
  pip install "jax[cuda12]==0.6.1" git+https://github.com/brentyi/jaxls.git
  bash download_checkpoint_and_data.sh        # 0.6 GB checkpoint, then 8 GB of examples that are not needed

"""
_CONFIG = """\
Then write a file, say egoallo.toml (paths are relative to it):

  [egoallo]
  python = "egoallo/.venv/bin/python"
  folder = "egoallo"
  model = "{model}"
  # command = ["{{python}}", "3_aria_inference.py", "--traj-root", "{{mps}}", "--traj-length", "{{frames}}",
  #            "--guidance-mode", "{{guidance}}", "--smplh-npz-path", "{{model}}"]      # this is the default
  # needs = ["vrs", "points"]                   # what of a recording the command cannot do without
  # timeout_minutes = 120                       # of one recording
  # environment = {{ CUDA_VISIBLE_DEVICES = "0" }}

and run:

  prbench poses egoallo --root {root} --config egoallo.toml

It prepares each recording (unpacks archives, turns ADT to Z up), runs the command, checks what comes out and moves it
to {target}. The same command resumes.

By hand instead: `prbench poses egoallo --root {root} --prepare` writes the prepared folders, then for each

  python 3_aria_inference.py --traj-root {by_hand} --traj-length FRAMES --guidance-mode MODE

whose outputs then lie where prbench looks.
"""


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
        # Filled per argument and never joined: a path with spaces or quotes stays one argument, and no shell sees it.
        filled = {"python": self.python} | dict(values)
        return [_PLACEHOLDER.sub(lambda match: filled[match[1]], text) for text in self.command]


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    egoallo: PosesConfig


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
    base = path.expanduser().absolute().parent
    model = None if config.model is None else base / config.model.expanduser()
    # A bare name such as python3.12 is found on PATH; anything with a separator is a path relative to the file.
    looks_like_path = "/" in config.python or "\\" in config.python
    python = str(base / Path(config.python).expanduser()) if looks_like_path else config.python
    return msgspec.structs.replace(config, python=python, folder=base / config.folder.expanduser(), model=model)


def _path(kind: type, value: object) -> object:
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise NotImplementedError(f"values of the type {kind}")


def instructions(root: Path, lacking: Sequence[PoseState]) -> str:
    """Commands that lead to the bodies which are lacking."""
    example = lacking[0].target if lacking else root / ego.POSES_FOLDER / "RECORDING" / ego.OUTPUT_FOLDER
    return (
        _INSTALL
        + HOW_TO_GET
        + "\n\n"
        + _CONFIG.format(root=root, target=example, by_hand=example.parent, model=ego.MODEL_FILE)
    )
