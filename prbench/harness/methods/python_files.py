"""Methods that no package offers: a function in a Python file (``drift.py``), or in a module (``mine.drift:load``)."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from prbench.errors import AdapterError
from prbench.files.storage import file_digest
from prbench.harness.methods.installed import InstalledEntry

_LOAD = "load"
_FILE = re.compile(r"(?P<path>.+\.py)(?::(?P<name>[A-Za-z_]\w*))?", re.IGNORECASE)
_MODULE = re.compile(r"(?P<module>[A-Za-z_]\w*(\.[A-Za-z_]\w*)*):(?P<name>[A-Za-z_]\w*)")
_SHOWN_DIGEST = 12


def is_python_method(method: str) -> bool:
    """Return True for an existing Python file, with or without ``:NAME``, and for ``module:NAME``."""
    found = _FILE.fullmatch(method)
    if found is not None:
        return Path(found["path"]).expanduser().is_file()
    return _MODULE.fullmatch(method) is not None


def find_python_method(method: str) -> InstalledEntry:
    """Return what is known of such a method without importing it.

    Args:
        method: As given by ``--method``.

    Raises:
        AdapterError: if the file has no such function, or no such module is found.
    """
    path, name = _source(method)
    if name not in _top_level_names(path):
        raise AdapterError(
            f"{path}: expected a function '{name}(weights, *, options, device)' that makes the method, found none in"
            f" this file. A program is given by its command, as 'cmd:python {path.name}'."
        )
    return InstalledEntry(method, path.name, file_digest(path)[:_SHOWN_DIGEST], f"{path}:{name}")


def import_python_method(method: str) -> ModuleType:
    """Import the module of such a method; what it imports from beside itself is found, as for a script.

    Args:
        method: As given by ``--method``.
    """
    by_name = _MODULE.fullmatch(method)
    if by_name is not None:
        return importlib.import_module(by_name["module"])
    path, _ = _source(method)
    name = f"prbench_method_{path.stem}_{file_digest(path)[:_SHOWN_DIGEST]}"
    if name in sys.modules:
        return sys.modules[name]
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Before it runs: data classes look themselves up here.
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def python_loader(method: str) -> Callable[..., Any]:
    """Import such a method, and return the function that makes it."""
    _, name = _source(method)
    return getattr(import_python_method(method), name)


def _source(method: str) -> tuple[Path, str]:
    """File and name of the function.

    Raises:
        AdapterError: if no such module is found.
    """
    found = _FILE.fullmatch(method)
    if found is not None:
        return Path(found["path"]).expanduser().absolute(), found["name"] or _LOAD
    by_name = _MODULE.fullmatch(method)
    assert by_name is not None
    try:
        spec = importlib.util.find_spec(by_name["module"])
    except ModuleNotFoundError:
        spec = None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        raise AdapterError(
            f"method '{method}': expected a module '{by_name['module']}' that Python can import, found none."
            " Install it, put its folder on PYTHONPATH, or give the path of its file."
        )
    return Path(spec.origin), by_name["name"]


def _top_level_names(path: Path) -> set[str]:
    """Names that a file makes; it is read and not run.

    Raises:
        AdapterError: if it is no Python.
    """
    try:
        body = ast.parse(path.read_bytes()).body
    except (SyntaxError, ValueError) as error:
        raise AdapterError(f"{path}: expected Python, found: {error}.") from error
    names = set()
    for statement in body:
        if isinstance(statement, ast.FunctionDef | ast.ClassDef):
            names.add(statement.name)
        elif isinstance(statement, ast.Assign):
            names |= {target.id for target in statement.targets if isinstance(target, ast.Name)}
        elif isinstance(statement, ast.Import | ast.ImportFrom):
            names |= {alias.asname or alias.name for alias in statement.names}
    return names
