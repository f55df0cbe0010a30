"""Environment variables that an isolated method gets, and folders that its interpreter needs."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import prbench
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
    """Return the part of the user's environment that an isolated method gets.

    ``HOME`` is not among it, nor is any variable of the harness. Where models are cached is named instead.

    Args:
        environment: Environment variables of the user.
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
    """Return the only variables of prbench that installed methods need: paths of text encoders."""
    return {name: environment[name] for name in _TEXT_ENCODERS if environment.get(name)}


def readable_folders(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Return the folders that the variables of an isolated environment lead to: models and libraries."""
    named = [environment.get(name) for name in (*_MODEL_CACHES, "HF_HUB_CACHE", *_TEXT_ENCODERS)]
    libraries = environment.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    return tuple(Path(text).absolute() for text in [*named, *libraries] if text and Path(text).exists())


def import_path() -> tuple[str, ...]:
    """Return the folders and archives of ``sys.path`` that exist."""
    return tuple(dict.fromkeys(str(Path(entry).absolute()) for entry in sys.path if entry and Path(entry).exists()))


def python_folders(target: str) -> tuple[Path, ...]:
    """Return the folders that this interpreter needs to import a module.

    Args:
        target: ``module:callable`` of an entry point; nothing of it is imported.
    """
    prefixes = (sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix)
    packages = (prbench.__name__, "prbench_data_manifests", "prbench_benchmarks", target.partition(":")[0])
    found = [Path(text) for text in (*prefixes, *import_path())]
    found += [folder for name in packages for folder in _package_folders(name.partition(".")[0])]
    return tuple(dict.fromkeys([*found, *_editable_folders(), *executable_folders(Path(sys.executable))]))


def executable_folders(program: Path) -> tuple[Path, ...]:
    """Return a program's files outside the system's folders: itself, and the installation that it is part of."""
    actual = program.resolve()
    found = [program, actual]
    for folder in (program.parent, actual.parent, *_virtual_environment_home(program)):
        if folder.name in ("bin", "condabin", "Scripts", "shims") and not _is_personal(folder.parent):
            found.append(folder.parent)
    return tuple(dict.fromkeys(found))


def _cache_home(environment: Mapping[str, str]) -> Path:
    return Path(environment.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _virtual_environment_home(program: Path) -> Iterator[Path]:
    """Yield the folder of the interpreter that a virtual environment was made with."""
    settings = program.parent.parent / "pyvenv.cfg"
    if settings.is_file():
        for line in settings.read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition("=")
            if key.strip() == "home":
                yield Path(value.strip())


def _is_personal(folder: Path) -> bool:
    """Return True for a folder too broad to show: the user's home, its ``.local``, or above."""
    home = Path.home()
    return folder == home / ".local" or home.is_relative_to(folder)


def _package_folders(name: str) -> Iterator[Path]:
    """Yield the folders of a top-level package, whichever import hook finds it."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return
    if spec is None:
        return
    yield from (Path(folder) for folder in spec.submodule_search_locations or ())
    if spec.origin and not spec.submodule_search_locations and Path(spec.origin).is_file():
        yield Path(spec.origin)


def _editable_folders() -> Iterator[Path]:
    """Yield folders of packages that setuptools installed in place: their finders map names to folders."""
    for finder in sys.meta_path:
        module = sys.modules.get(getattr(finder, "__module__", ""))
        mapping = getattr(module, "MAPPING", None)
        if isinstance(mapping, dict):
            yield from (Path(folder) for folder in mapping.values() if Path(folder).exists())
