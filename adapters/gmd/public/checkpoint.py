"""A checkpoint of the original program: a file of ``torch.save``, from which numbers are read and nothing else.

It is opened with ``weights_only=True``: PyTorch then builds tensors and plain containers, and refuses whatever would
run code. Files that ask for more are refused here too.
"""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from prbench.boundary import foreign_input
from prbench.errors import InputFileError, UsageError
from prbench_adapters.gmd.public.names import is_learnt

_COPIES = ("model_avg", "model")
"""The copies of the network in a checkpoint, the one to sample with first: a moving average over training."""
_SAFE_SINCE = (2, 6)
"""Earlier versions of PyTorch could be made to run code in spite of ``weights_only`` (CVE-2025-32434)."""
_REFUSED = re.compile(r"GLOBAL ([\w.]+)")


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """One network of the original program."""

    path: Path
    copy: str
    """Which of the copies in the file this is: ``model_avg``, ``model``, or ``only`` where there are no two."""
    tensors: dict[str, Tensor]
    """By the original's names, on the CPU."""

    def require(self, name: str, shape: tuple[int | None, ...]) -> Tensor:
        """The tensor of this name.

        Args:
            name: The original's.
            shape: Its sizes; None for any.

        Raises:
            InputFileError: if there is none, it has another shape, or it holds anything but finite numbers.
        """
        tensor = self.tensors.get(name)
        wanted = f"({', '.join('any' if size is None else str(size) for size in shape)})"
        if tensor is None:
            raise self.misfit(name, f"a tensor of shape {wanted}", "none of this name")
        sizes = tuple(tensor.shape)
        if len(sizes) != len(shape) or any(want not in (None, size) for want, size in zip(shape, sizes, strict=True)):
            raise self.misfit(name, f"shape {wanted}", f"shape {sizes}")
        if not (tensor.is_floating_point() and bool(torch.isfinite(tensor).all())):
            raise self.misfit(name, "finite numbers", f"{tensor.dtype} with NaN, infinity or no fractions")
        return tensor.float()

    def misfit(self, name: str, expected: str, found: str) -> InputFileError:
        """An error about one tensor of this file."""
        remedy = (
            "Give the motion network's file as --motion and the trajectory network's as --trajectory, both as GMD was"
            " released (absolute root, U-Net with adaptive group normalisation)."
        )
        return InputFileError(self.path, f"'{name}'", expected=expected, found=found, remedy=remedy)


def read_checkpoint(path: Path) -> Checkpoint:
    """Read the averaged network of a checkpoint, or the only one that it holds.

    Args:
        path: ``model000500000.pt`` or the like.

    Raises:
        InputFileError: if there is no such file, it is no checkpoint, or it holds more than numbers.
        UsageError: if this version of PyTorch cannot be trusted to open it.
    """
    require_safe_torch()
    content = _mapping(path, _content(path))
    copy = next((name for name in _COPIES if name in content), "only")
    state = content if copy == "only" else _mapping(path, content[copy])
    tensors = {}
    for name, value in state.items():
        if not isinstance(value, Tensor):
            found = f"a {type(value).__name__}"
            raise InputFileError(path, f"'{name}'", expected="a tensor", found=found, remedy=_saving_anew(path))
        if is_learnt(name):
            tensors[name] = value
    return Checkpoint(path, copy, tensors)


def require_safe_torch() -> None:
    """Refuse a PyTorch whose ``weights_only`` does not keep its promise.

    Raises:
        UsageError: naming the version that does.
    """
    numbers = tuple(int(part) for part in re.findall(r"\d+", torch.__version__)[:2])
    if numbers < _SAFE_SINCE:
        least = ".".join(map(str, _SAFE_SINCE))
        raise UsageError(
            f"opening a checkpoint safely needs PyTorch {least} or later, found {torch.__version__} (CVE-2025-32434)."
            f" Run: pip install 'torch>={least}'"
        )


def _mapping(path: Path, value: object) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        raise InputFileError(path, "", expected="tensors by name", found=f"a {type(value).__name__}")
    return value


@foreign_input()
def _content(path: Path) -> object:
    if not path.is_file():
        raise InputFileError(path, "", expected="a checkpoint (.pt)", found="no such file")
    if not zipfile.is_zipfile(path):
        raise _no_checkpoint(path, "another format, or a truncated file")
    try:
        return torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except pickle.UnpicklingError as error:
        wanted = _REFUSED.search(str(error))
        found = f"one that asks for '{wanted[1]}'" if wanted else "one that asks for more"
        expected = "a checkpoint of numbers alone"
        raise InputFileError(path, "", expected=expected, found=found, remedy=_saving_anew(path)) from error
    except RuntimeError as error:
        raise _no_checkpoint(path, "an archive without one, or a damaged one") from error


def _no_checkpoint(path: Path, found: str) -> InputFileError:
    remedy = "If it is what was downloaded, unpack it first and name the model….pt inside; else download it again."
    return InputFileError(path, "", expected="a checkpoint of torch.save (.pt)", found=found, remedy=remedy)


def _saving_anew(path: Path) -> str:
    return (
        "prbench runs no code of a file. If you trust it, keep its tensors alone, where the original program runs: "
        f"python -c \"import torch; c = torch.load('{path.name}', map_location='cpu'); c = c.get('model_avg', c);"
        " torch.save({k: v for k, v in c.items() if torch.is_tensor(v)}, 'tensors.pt')\" and import tensors.pt."
    )
