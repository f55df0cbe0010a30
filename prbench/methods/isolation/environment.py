"""The environment variables of an isolated method: few, and none that leads to data."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from prbench.text.pretrained import CLIP_VARIABLE, DISTILBERT_VARIABLE

_ALLOWED = frozenset(
    {
        "PATH", "LANG", "LANGUAGE", "TZ", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "TMPDIR",
        "PYTHONHASHSEED", "PYTHONUTF8", "PYTHONIOENCODING", "PYTHONWARNINGS",
        "HF_HOME", "HF_HUB_CACHE", "HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE", "TORCH_HOME",
        # Windows: programs do not start, or find no folder of their own, without these.
        "SYSTEMROOT", "SYSTEMDRIVE", "WINDIR", "COMSPEC", "PATHEXT", "TEMP", "TMP", "USERPROFILE",
        "NUMBER_OF_PROCESSORS", "PROCESSOR_ARCHITECTURE",
    }
)  # fmt: skip
_ALLOWED_BEGINNINGS = (
    "LC_", "CUDA_", "CUDNN_", "CUBLAS_", "NVIDIA_", "PYTORCH_", "OMP_", "KMP_", "GOMP_", "MKL_", "OPENBLAS_",
    "NUMEXPR_", "VECLIB_", "HIP_", "HSA_", "ROCR_",
)  # fmt: skip
_TEXT_ENCODERS = (DISTILBERT_VARIABLE, CLIP_VARIABLE)
_MODEL_CACHES = {"HF_HOME": "huggingface", "TORCH_HOME": "torch"}


def isolated_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """What of the user's environment an isolated method gets.

    ``HOME`` is not among it, nor is any variable of the harness. Where models are cached is named instead.

    Args:
        environment: The user's.
    """
    kept = {
        name: value
        for name, value in environment.items()
        if name.upper() in _ALLOWED or name.upper().startswith(_ALLOWED_BEGINNINGS)
    }
    for variable, folder in _MODEL_CACHES.items():
        default = _cache_home(environment) / folder
        if variable not in kept and default.is_dir():
            kept[variable] = str(default)
    return kept


def text_encoder(environment: Mapping[str, str]) -> dict[str, str]:
    """The only variables of prbench that installed methods need: where the text encoders of our own models lie."""
    return {name: environment[name] for name in _TEXT_ENCODERS if environment.get(name)}


def readable_folders(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Folders that the variables of an isolated environment lead to: models and libraries."""
    named = [environment.get(name) for name in (*_MODEL_CACHES, "HF_HUB_CACHE", *_TEXT_ENCODERS)]
    libraries = environment.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    return tuple(Path(text).absolute() for text in [*named, *libraries] if text and Path(text).exists())


def _cache_home(environment: Mapping[str, str]) -> Path:
    return Path(environment.get("XDG_CACHE_HOME") or Path.home() / ".cache")
