"""Joints of one output file, computed once: later reads take them from the user's cache and need no body model."""

from __future__ import annotations

import contextlib
import io
import re
import zipfile
import zlib
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.bounded import read_whole, require_regular
from prbench.errors import InputFileError, StorageError
from prbench.locks import sole_file
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.model import HOW_TO_GET, model_digest, read_smplh_rest
from prbench.readers.egoallo.outputs import JointsOnly, parse_output
from prbench.readers.egoallo.to_recording import window_joints
from prbench.readers.found import is_present
from prbench.storage import bytes_digest, cache_folder

_GUIDANCE = re.compile(r"^guidance_mode:[ ]*['\"]?(\w+)['\"]?[ ]*$", re.MULTILINE)
_OPTIONS_BYTES = 65536
_VERSION = 1  # of what is kept; raise it when the arithmetic changes


def read_window(path: Path, model: Path | None) -> tuple[ego.BodyWindow, Float[np.ndarray, "t 3"] | None]:
    """Joints of one output file, and the head positions that it was made from (None in files with joints only).

    Args:
        path: The output.
        model: SMPL-H model; None is enough where the joints of exactly these bytes were computed before.

    Raises:
        InputFileError: if the output is damaged (docs/specification/egoallo.md#bad-input), or the model is needed and
        missing or damaged.
    """
    content = _content(path)
    output = parse_output(path, content)
    if isinstance(output, JointsOnly):
        return ego.BodyWindow(path.name, output.time_ns, output.joints), None
    guidance = read_guidance(path)
    head = output.world_from_cpf[:, 4:].astype(np.float64)
    samples = len(output.world_from_root)
    kept = cache_folder() / "egoallo" / f"{bytes_digest(content)}.npz"
    wanted = None if model is None else model_digest(model)
    joints = _kept_joints(kept, wanted, frames=len(output.time_ns))
    if joints is None:
        if model is None or wanted is None:
            raise InputFileError(
                path,
                "",
                expected="the SMPL-H body model, from which joints are computed",
                found="no model, and no joints of this file from an earlier run",
                remedy=HOW_TO_GET,
            )
        joints = window_joints(output, read_smplh_rest(model)).joints
        _keep(kept, joints, wanted)
    return ego.BodyWindow(path.name, output.time_ns, joints, samples, guidance), head


def read_guidance(path: Path) -> str:
    """``guidance_mode`` of an output, from the options beside it; empty where they are missing or say nothing.

    The file is YAML that may name Python objects: it is looked at as text and never loaded.
    """
    options = path.with_name(f"{path.stem}{ego.ARGUMENTS_SUFFIX}")
    if not is_present(options):
        return ""
    require_regular(options)
    with open(options, "rb") as file:
        text = file.read(_OPTIONS_BYTES).decode("utf-8", errors="replace")
    found = _GUIDANCE.search(text)
    return found[1] if found else ""


def _content(path: Path) -> bytes:
    try:
        return read_whole(path)
    except FileNotFoundError as error:
        raise InputFileError(
            path, "", expected="an output of EgoAllo", found="no such file", remedy="Run `prbench poses egoallo`."
        ) from error


def _kept_joints(kept: Path, wanted: str | None, *, frames: int) -> np.ndarray | None:
    """Joints from the cache, if they are whole and of the wanted model (of any model where none is given)."""
    try:
        with np.load(io.BytesIO(kept.read_bytes()), allow_pickle=False) as file:
            version, model, joints = int(file["version"]), str(file["model"]), file["joints"]
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        return None if isinstance(error, FileNotFoundError) else _forget(kept)
    fits = version == _VERSION and joints.shape == (frames, 22, 3) and joints.dtype == np.float32
    return joints if fits and wanted in (None, model) else None


def _forget(kept: Path) -> None:
    """Drop a damaged entry, where that is possible; it is made again."""
    with contextlib.suppress(OSError):
        kept.unlink(missing_ok=True)


def _keep(kept: Path, joints: np.ndarray, model: str) -> None:
    with contextlib.suppress(StorageError), sole_file(kept) as temporary:  # a full cache costs time, not the build
        np.savez(temporary, version=_VERSION, model=model, joints=joints)
