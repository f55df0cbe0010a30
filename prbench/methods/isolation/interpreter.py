"""What an interpreter needs of the file system: its own folders, and those that packages are imported from."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path

import prbench


def import_path() -> tuple[str, ...]:
    """Where this process finds modules: the folders and archives of ``sys.path`` that exist."""
    return tuple(dict.fromkeys(str(Path(entry).absolute()) for entry in sys.path if entry and Path(entry).exists()))


def python_folders(target: str) -> tuple[Path, ...]:
    """What this interpreter needs to import a module.

    Args:
        target: ``module:callable`` of an entry point; nothing of it is imported.
    """
    prefixes = (sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix)
    packages = (prbench.__name__, "prbench_data_manifests", "prbench_benchmarks", target.partition(":")[0])
    found = [Path(text) for text in (*prefixes, *import_path())]
    found += [folder for name in packages for folder in _package_folders(name.partition(".")[0])]
    return tuple(dict.fromkeys([*found, *_editable_folders(), *executable_folders(Path(sys.executable))]))


def executable_folders(program: Path) -> tuple[Path, ...]:
    """What a program needs that lies outside the system's folders: itself, and the installation that it is part of."""
    actual = program.resolve()
    found = [program, actual]
    for folder in (program.parent, actual.parent, *_virtual_environment_home(program)):
        if folder.name in ("bin", "condabin", "Scripts", "shims") and not _is_personal(folder.parent):
            found.append(folder.parent)
    return tuple(dict.fromkeys(found))


def _virtual_environment_home(program: Path) -> Iterator[Path]:
    """The folder of the interpreter that a virtual environment was made with."""
    settings = program.parent.parent / "pyvenv.cfg"
    if settings.is_file():
        for line in settings.read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition("=")
            if key.strip() == "home":
                yield Path(value.strip())


def _is_personal(folder: Path) -> bool:
    """A folder too broad to show: the user's home, its ``.local``, or above."""
    home = Path.home()
    return folder == home / ".local" or home.is_relative_to(folder)


def _package_folders(name: str) -> Iterator[Path]:
    """Where a top-level package lies, whichever import hook finds it."""
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
    """Of packages that setuptools installed in place: their finders hold a mapping from names to folders."""
    for finder in sys.meta_path:
        module = sys.modules.get(getattr(finder, "__module__", ""))
        mapping = getattr(module, "MAPPING", None)
        if isinstance(mapping, dict):
            yield from (Path(folder) for folder in mapping.values() if Path(folder).exists())
