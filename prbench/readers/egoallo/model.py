"""The SMPL-H body model's rest joints (docs/specification/egoallo.md#joints). The file is licensed: users bring it."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from prbench.boundary import foreign_input
from prbench.errors import InputFileError
from prbench.numpy_files import Archive
from prbench.readers.egoallo import format as ego
from prbench.storage import bytes_digest

HOW_TO_GET = (
    "Download the 'Extended SMPL+H model' (16 shape parameters) from https://mano.is.tue.mpg.de/ (free registration)"
    " and give its smplh/neutral/model.npz with --option smplh_model=FILE, in the environment variable"
    " PRBENCH_SMPLH_MODEL, or as smplh/neutral/model.npz below the dataset's root. It is needed once: the joints are"
    " kept."
)
_CONVERT = (
    "Some copies hold Python objects, which prbench never unpickles. If yours is from the official site, convert it"
    " once: python -c \"import numpy as np; m = np.load('model.npz', allow_pickle=True);"
    " np.savez('plain.npz', **{k: np.asarray(m[k].todense() if hasattr(m[k], 'todense') else m[k])"
    " for k in ('J_regressor', 'v_template', 'shapedirs')})\""
)
_KEYS = (ego.REGRESSOR, ego.TEMPLATE, ego.SHAPES)


@foreign_input()
def read_smplh_rest(path: Path) -> ego.SmplhRest:
    """Rest joints of the model, linear in the shape; of its 52 joints the first 22.

    Raises:
        InputFileError: if the file is missing, damaged, lacks a key, or holds arrays of other shapes or objects.
    """
    path = path.expanduser()
    try:
        state = path.stat()
    except OSError as error:
        raise InputFileError(
            path, "", expected="the SMPL-H body model", found="no such file", remedy=HOW_TO_GET
        ) from error
    return _read((path, state.st_size, state.st_mtime_ns))


def model_digest(path: Path) -> str:
    """What tells two models apart: SHA-256 of their rest joints' template and directions.

    Raises:
        InputFileError: see :func:`read_smplh_rest`.
    """
    rest = read_smplh_rest(path)
    return bytes_digest(np.ascontiguousarray(rest.template).tobytes() + np.ascontiguousarray(rest.directions).tobytes())


@lru_cache(maxsize=4)
def _read(state: tuple[Path, int, int]) -> ego.SmplhRest:
    """Read once a process; size and time of change make a changed file another one."""
    path = state[0]
    arrays = _load(path)
    for key, axes in zip(_KEYS, (2, 2, 3), strict=True):
        if arrays[key].ndim != axes or arrays[key].dtype.kind not in "fiu":
            found = f"shape {arrays[key].shape} of {arrays[key].dtype}"
            raise InputFileError(path, key, expected=f"numbers with {axes} axes", found=found, remedy=HOW_TO_GET)
    regressor, template, shapes = (arrays[key].astype(np.float64) for key in _KEYS)
    points = regressor.shape[1]
    for key, array, shape in (
        (ego.REGRESSOR, regressor, (ego.N_MODEL_JOINTS, points)),
        (ego.TEMPLATE, template, (points, 3)),
        (ego.SHAPES, shapes[..., : ego.N_BETAS], (points, 3, ego.N_BETAS)),
    ):
        if array.shape != shape or not np.isfinite(array).all():
            raise InputFileError(
                path,
                key,
                expected="52 joints, as many points everywhere, at least 16 shapes, finite numbers (SMPL-H, extended)",
                found=f"the shape {arrays[key].shape}",
                remedy=HOW_TO_GET,
            )
    body = regressor[:22]
    return ego.SmplhRest(body @ template, np.einsum("jv,vkb->jkb", body, shapes[:, :, : ego.N_BETAS]))


def _load(path: Path) -> dict[str, np.ndarray]:
    archive = Archive(path, remedy=f"Copy or download it again. {_CONVERT}")
    missing = [key for key in _KEYS if key not in archive.members]
    if missing:
        raise InputFileError(
            path,
            "",
            expected=f"an array '{missing[0]}'",
            found=", ".join(archive.members) or "nothing",
            remedy=f"This is no SMPL-H model. {HOW_TO_GET}",
        )
    return archive.load(_KEYS)
