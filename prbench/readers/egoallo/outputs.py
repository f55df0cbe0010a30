"""One output file of EgoAllo: read, checked, refused with key and remedy.

Sources: docs/specification/egoallo.md#files and docs/specification/egoallo.md#bad-input.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input, read_whole
from prbench.readers.egoallo import format as ego
from prbench.readers.files import require_increasing

_AGAIN = "Delete it and run `prbench poses egoallo` again."
_SHAPES = {
    ego.WORLD_FROM_CPF: ("T", 7),
    ego.WORLD_FROM_ROOT: ("S", "T", 7),
    ego.BODY_QUATS: ("S", "T", ego.N_BODY_QUATS, 4),
    ego.BETAS: ("S", "T", ego.N_BETAS),
}
_QUATERNIONS = {ego.WORLD_FROM_CPF: slice(0, 4), ego.WORLD_FROM_ROOT: slice(0, 4), ego.BODY_QUATS: slice(0, 4)}


@dataclass(frozen=True)
class JointsOnly:
    """A file of another pipeline: joints instead of rotations."""

    name: str
    time_ns: Int[np.ndarray, " t"]
    joints: Float[np.ndarray, "t 22 3"]


@foreign_input()
def read_output(path: Path) -> ego.EgoAlloOutput | JointsOnly:
    """Read one output file.

    Raises:
        InputFileError: if the file is missing or no npz archive of plain arrays, or a key is missing, empty, of another
            shape than the others, or holds NaN, quaternions of another length than 1, or times that do not increase.
    """
    try:
        return parse_output(path, read_whole(path))
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="an output of EgoAllo", found="no such file", remedy=_AGAIN) from error


@foreign_input()
def parse_output(path: Path, content: bytes) -> ego.EgoAlloOutput | JointsOnly:
    """:func:`read_output` of bytes that are at hand; ``path`` is for the messages."""
    arrays = _load(path, content)
    time_ns = _times(path, arrays)
    if ego.JOINTS in arrays and ego.WORLD_FROM_ROOT not in arrays:
        joints = _require(path, arrays, ego.JOINTS, (len(time_ns), 22, 3))
        return JointsOnly(path.name, time_ns, joints)
    sizes: dict[str, int] = {"T": len(time_ns)}
    checked = {}
    for key, form in _SHAPES.items():
        if key == ego.WORLD_FROM_ROOT and key in arrays and arrays[key].ndim == len(form):
            sizes["S"] = _samples(path, arrays[key])
        shape = tuple(size if isinstance(size, int) else sizes.get(size, -1) for size in form)
        checked[key] = _require(path, arrays, key, shape)
        if key in _QUATERNIONS:
            _require_rotations(path, key, checked[key][..., _QUATERNIONS[key]])
    return ego.EgoAlloOutput(
        name=path.name,
        time_ns=time_ns,
        world_from_cpf=checked[ego.WORLD_FROM_CPF],
        world_from_root=checked[ego.WORLD_FROM_ROOT],
        body_quats=checked[ego.BODY_QUATS],
        betas=checked[ego.BETAS],
    )


def _load(path: Path, content: bytes) -> dict[str, np.ndarray]:
    """The arrays that are used; what else an archive holds is not even unpacked."""
    archive = Archive(path, content, remedy=f"The file may be truncated. {_AGAIN}")
    return archive.load((ego.TIMES, ego.JOINTS, *_SHAPES))


def _times(path: Path, arrays: Mapping[str, np.ndarray]) -> Int[np.ndarray, " t"]:
    times = _present(path, arrays, ego.TIMES)
    if times.ndim != 1 or not np.issubdtype(times.dtype, np.integer):
        found = f"{times.dtype} {times.shape}"
        raise InputFileError(path, ego.TIMES, expected="integers (T,), nanoseconds", found=found, remedy=_AGAIN)
    if len(times) == 0:
        raise InputFileError(path, ego.TIMES, expected="at least one frame", found="T = 0", remedy=_AGAIN)
    require_increasing(path, times, unit="ns", place=f"{ego.TIMES}, frame", first=0, remedy=_AGAIN)
    return times.astype(np.int64)


def _samples(path: Path, roots: np.ndarray) -> int:
    if roots.shape[0] == 0:
        raise InputFileError(path, ego.WORLD_FROM_ROOT, expected="at least one sample", found="S = 0", remedy=_AGAIN)
    return roots.shape[0]


def _present(path: Path, arrays: Mapping[str, np.ndarray], key: str) -> np.ndarray:
    if key not in arrays:
        raise InputFileError(
            path,
            "",
            expected=f"an array '{key}'",
            found=f"the arrays {', '.join(sorted(arrays)) or 'none that is known'}",
            remedy=f"Outputs of EgoAllo hold it, and joints-only files hold '{ego.JOINTS}' and '{ego.TIMES}'. {_AGAIN}",
        )
    return arrays[key]


def _require(path: Path, arrays: Mapping[str, np.ndarray], key: str, shape: tuple[int, ...]) -> np.ndarray:
    """One array of floats of the expected shape, without NaN."""
    array = _present(path, arrays, key)
    if array.shape != shape or not np.issubdtype(array.dtype, np.floating):
        expected = f"floats of the shape {shape} (as many frames as '{ego.TIMES}' and as many samples everywhere)"
        found = f"{array.dtype} {array.shape}"
        raise InputFileError(path, key, expected=expected, found=found, remedy=_AGAIN)
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        raise InputFileError(
            path,
            f"{key}{bad[0].tolist()}",
            expected="finite numbers",
            found=f"NaN or infinity in {len(bad)} places",
            remedy=_AGAIN,
        )
    return array if array.dtype == np.float64 else array.astype(np.float32)


def _require_rotations(path: Path, key: str, quaternions: np.ndarray) -> None:
    error = np.abs(np.linalg.norm(quaternions.astype(np.float64), axis=-1) - 1)
    worst = np.unravel_index(int(np.argmax(error)), error.shape)
    if error[worst] > ego.QUATERNION_TOLERANCE:
        length = float(np.linalg.norm(quaternions[worst].astype(np.float64)))
        raise InputFileError(
            path,
            f"{key}{[int(index) for index in worst]}",
            expected="a quaternion of length 1",
            found=f"length {length:.4f}",
            remedy=_AGAIN,
        )
