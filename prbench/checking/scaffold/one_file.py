"""The converters as one file for programs: NumPy only, Python 3.8, written from prbench's own modules.

A program of another Python cannot import prbench, but needs the same conversions. Nothing is written twice: this
module takes the functions that are asked for, all that they use, and writes them after one another, with their
comments. No two of these modules may use one name for different things.
"""

from __future__ import annotations

import ast
import importlib.util
import pprint
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import prbench
from prbench.errors import StorageError
from prbench.files.bounded import read_whole
from prbench.files.storage import sole_file
from prbench.limits import HARMLESS_SIZE

ONE_FILE = "prbench_converters.py"
_PACKAGES = ("prbench",)
_FOR_TYPES_ONLY = "jaxtyping"

_CONVERTERS = "prbench.representation.converters"
# Names that the file offers besides the converters
_ROOTS: Mapping[str, tuple[str, ...]] = {
    "prbench.errors": ("PrbenchError", "InputFileError", "UsageError"),
    "prbench.geometry.skeleton": ("Joint", "PARENTS", "y_up", "z_up"),
    "prbench.randomness": ("sequence_generator",),
    "prbench.contract": ("batch_noise", "sequence_noise"),
    "prbench.representation": ("Statistics", "UniformSkeleton", "canonicalise", "rest_offsets", "retarget"),
}

_MARK = "functions are those of prbench.representation.converters"
_HEADER = '''# ruff: noqa
# fmt: off
"""What models put out, as the 22 joints of prbench: NumPy only, Python 3.8 or later, nothing to install.

Written by `prbench adapters list --converters` from prbench {version} (MIT licence); do not change it, write it anew.
The functions are those of prbench.representation.converters and give the same numbers; docs/wrapping.md shows them at
work. Put the file beside your program, then: from prbench_converters import motions_from_features, placed_on
"""
'''


@dataclass(eq=False)
class _Statement:
    """One top-level statement, with the comments above and the text that documents it."""

    text: str
    defines: frozenset[str]
    uses: frozenset[str]


@dataclass
class _Module:
    """One module, taken apart.

    Attributes:
        inside: Imported from prbench: maps a name to the module that it comes from.
        outside: Imported from elsewhere: maps a name to the line that imports it.
    """

    statements: list[_Statement] = field(default_factory=list)
    inside: dict[str, str] = field(default_factory=dict)
    outside: dict[str, str] = field(default_factory=dict)


def converters_file() -> str:
    """Return the text of :data:`ONE_FILE`."""
    roots = {**_ROOTS, _CONVERTERS: tuple(importlib.import_module(_CONVERTERS).__all__)}
    return one_file(roots, _HEADER.format(version=prbench.__version__))


def write_converters(path: Path) -> None:
    """Write the file, or write it anew.

    Raises:
        StorageError: if something else stands there, another process is writing it, or it cannot be written.
    """
    if path.exists() and not (path.is_file() and _MARK.encode() in read_whole(path, largest=HARMLESS_SIZE)[:1000]):
        raise StorageError(f"{path}: is something else than the converters; nothing was written. Name another --out.")
    text = converters_file()
    with sole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def one_file(roots: Mapping[str, Iterable[str]], header: str) -> str:
    """Write functions and all that they use into one text.

    Args:
        roots: Names that are wanted, by the module that offers them.
        header: The file's docstring.
    """
    # Collect, by module, the statements behind the names and behind all that these use.
    needed: dict[str, list[_Statement]] = {}
    wanted_names = [(module, name) for module, names in roots.items() for name in names]
    waiting = [place for module, name in wanted_names if (place := _origin(module, name)) is not None]
    assert len(waiting) == len(wanted_names), "a module does not define what it is to offer"
    offered = sorted({name for _, name in waiting})
    while waiting:
        name, wanted = waiting.pop()
        # Such as ARRAY.setflags(write=False): it makes no name, so nobody uses it, and still it must come along.
        for one in _module(name).statements:
            makes = wanted in one.defines or (not one.defines and wanted in one.uses)
            if makes and one not in needed.setdefault(name, []):
                needed[name].append(one)
                waiting += [place for used in one.uses if (place := _origin(name, used)) is not None]
    made = [each for statements in needed.values() for one in statements for each in one.defines]
    twice = sorted({each for each in made if made.count(each) > 1})
    assert not twice, f"two modules make {', '.join(twice)}; rename one of each"
    uses = [(name, used) for name, statements in needed.items() for one in statements for used in one.uses]
    lines = {_module(name).outside[used] for name, used in uses if used in _module(name).outside}
    for_types = sorted(line for line in lines if line.startswith(f"from {_FOR_TYPES_ONLY} "))
    if for_types:
        lines = (lines - set(for_types)) | {"from typing import TYPE_CHECKING"}
        for_types = ["if TYPE_CHECKING:", *(f"    {line}" for line in for_types)]
    imports = sorted(lines, key=lambda line: (not line.startswith("import"), line))
    parts = [header, "from __future__ import annotations\n\n" + "\n".join((*imports, "", *for_types)) + "\n"]
    # Modules, each behind those that it imports from; sorted, so that equal sources give equal bytes.
    imported: dict[str, set[str]] = {name: set() for name in sorted(needed)}
    for name, used in uses:
        origin = _origin(name, used)
        if origin is not None and origin[0] != name:
            imported[name].add(origin[0])
    for name in TopologicalSorter({name: sorted(others) for name, others in imported.items()}).static_order():
        body = "\n\n\n".join(one.text for one in _module(name).statements if one in needed[name])
        parts.append(f"# From {name.replace('.', '/')}.py\n\n\n{body}\n")
    parts.append("__all__ = [\n" + "".join(f'    "{name}",\n' for name in offered) + "]\n")
    return "\n\n".join(parts)


def _origin(module: str, name: str) -> tuple[str, str] | None:
    """Return the module and name behind a name that a module defines or imports from prbench; else None."""
    while all(name not in one.defines for one in _module(module).statements):
        if name not in _module(module).inside:
            return None
        module = _module(module).inside[name]
    return module, name


@cache
def _module(name: str) -> _Module:
    spec = importlib.util.find_spec(name)
    assert spec is not None
    assert spec.origin is not None
    lines = Path(spec.origin).read_text(encoding="utf-8").splitlines()
    module = _Module()
    for node in ast.parse("\n".join(lines)).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            for alias in node.names:
                as_name = "" if alias.asname is None else f" as {alias.asname}"
                if isinstance(node, ast.Import):
                    module.outside[alias.asname or alias.name] = f"import {alias.name}{as_name}"
                elif node.module is not None and node.module.split(".")[0] in _PACKAGES:
                    assert alias.asname is None, f"{name} imports {alias.name} under another name"
                    module.inside[alias.name] = node.module
                else:
                    module.outside[alias.asname or alias.name] = f"from {node.module} import {alias.name}{as_name}"
            continue
        first = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", []))])
        while first > 1 and lines[first - 2].startswith("#"):
            first -= 1
        text = "\n".join(lines[first - 1 : node.end_lineno])
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            if module.statements:  # the text below a constant belongs to it; the module's own is left away
                module.statements[-1].text += f"\n{text}"
            continue
        defines: set[str] = set()
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defines = {node.name}
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            defines = {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}
        used = frozenset(one.id for one in ast.walk(node) if isinstance(one, ast.Name)) - defines
        if "tomllib" in used:  # what a module reads from a file beside it is written out
            (table,) = defines
            value = getattr(importlib.import_module(name), table)
            text = f"{table} = {pprint.pformat(value, width=118, sort_dicts=False)}"
            used = frozenset()
        if isinstance(node, ast.Assign) and any(_FOR_TYPES_ONLY in module.outside.get(each, "") for each in used):
            # A name for a type of arrays stands in annotations alone.
            text = f"if TYPE_CHECKING:\n{textwrap.indent(text, '    ')}"
        module.statements.append(_Statement(text, frozenset(defines), used))
    return module
