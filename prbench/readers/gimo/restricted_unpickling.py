"""Pickles of torch tensors, read without running what they might hold (``formats/gimo.md`` section 3).

GIMO's poses are plain pickles. A pickle may call any function it names; this reader knows the handful that build
tensors and arrays and refuses every other name before anything is called. The bytes inside a tensor's storage are
a second pickle, which ``torch.load(weights_only=True)`` reads under the same kind of rule.
"""

from __future__ import annotations

import codecs
import collections
import io
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from prbench.errors import InputFileError
from prbench.readers.files import missing_file

_LARGEST = 1 << 20
"""Bytes; a pose has a few thousand."""


def load_tensors(path: Path) -> dict[str, np.ndarray]:
    """The named tensors of a pickled dictionary, as arrays.

    Raises:
        InputFileError: if the file is missing, too large, no pickle, names a class or function that tensors do not need
            (nothing of it is run), or holds anything but a dictionary of tensors.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise _refused(path, f"{path.stat().st_size:,} bytes", "This is no pose of one frame.")
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise missing_file(path) from error
    try:
        loaded = _TensorUnpickler(io.BytesIO(content)).load()
    except ForbiddenName as error:
        raise _refused(
            path, f"the name '{error}'", "Nothing of it was run; do not open it with other programs."
        ) from error
    except Exception as error:  # a damaged pickle can fail in any way that its opcodes can
        raise _refused(path, f"{type(error).__name__}: {error}".splitlines()[0], "Copy the file again.") from error
    if not isinstance(loaded, dict):
        raise _refused(path, f"a {type(loaded).__name__}", "")
    return {str(name): _array(path, str(name), value) for name, value in loaded.items()}


class ForbiddenName(Exception):
    """A pickle asks for something that tensors do not need."""


def _refused(path: Path, found: str, remedy: str) -> InputFileError:
    return InputFileError(path, "", expected="a pickled dictionary of torch tensors", found=found, remedy=remedy)


def _array(path: Path, name: str, value: Any) -> np.ndarray:
    import torch

    array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise _refused(path, f"'{name}' of the type {array.dtype}", "")
    return array


class _TensorUnpickler(pickle.Unpickler):
    """Knows a few names; every other one ends the reading."""

    def find_class(self, module: str, name: str) -> Any:
        allowed = _allowed()
        if (module, name) not in allowed:
            raise ForbiddenName(f"{module}.{name}")
        return allowed[module, name]

    def persistent_load(self, pid: Any) -> Any:
        raise ForbiddenName(f"persistent id {pid!r:.60}")


def _allowed() -> dict[tuple[str, str], Callable[..., Any]]:
    import torch._utils

    arrays = {(f"numpy{core}.multiarray", "_reconstruct"): _empty_array for core in (".core", "._core")}
    return {
        ("torch._utils", "_rebuild_tensor_v2"): torch._utils._rebuild_tensor_v2,
        ("torch._utils", "_rebuild_parameter"): torch._utils._rebuild_parameter,
        ("torch.storage", "_load_from_bytes"): _load_storage,
        ("collections", "OrderedDict"): collections.OrderedDict,
        ("numpy", "ndarray"): _named_only,
        ("numpy", "dtype"): np.dtype,
        ("_codecs", "encode"): _latin_bytes,
        **arrays,
    }


def _load_storage(content: bytes) -> Any:
    """A storage from the bytes of a pickle of its own, which may name nothing but storages either."""
    import torch

    try:
        return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        raise ForbiddenName(f"inside a storage: {str(error).splitlines()[0][:120]}") from error


def _named_only(*_: Any) -> Any:
    """Stands for a class that is handed to another function and never called itself."""
    raise ForbiddenName("numpy.ndarray, called")


def _empty_array(*_: Any) -> np.ndarray:
    """What numpy makes before it fills an array in; always an array, whatever class the file names."""
    return np.ndarray.__new__(np.ndarray, (0,), "b")


def _latin_bytes(text: str, encoding: str = "latin1") -> bytes:
    """How old pickles hold bytes; no other codec is looked up."""
    if encoding not in ("latin1", "latin-1"):
        raise ForbiddenName(f"codec {encoding}")
    return codecs.latin_1_encode(text)[0]
