"""The converters as one file for programs: NumPy only, Python 3.8, written from prbench's own modules.

A program of another Python cannot import prbench, but needs the same conversions. Nothing is written twice: this
module takes the functions that are asked for, all that they use, and writes them after one another, with their
comments. A private name that two modules use for different things gets a suffix in the second one.
"""

from __future__ import annotations

import ast
import importlib.util
import io
import tokenize
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import prbench
from prbench.errors import StorageError
from prbench.files.storage import sole_file

ONE_FILE = "prbench_converters.py"
_PACKAGES = ("prbench",)
_FOR_TYPES_ONLY = "jaxtyping"

_CONVERTERS = "prbench.representation.converters"
_ROOTS: Mapping[str, tuple[str, ...]] = {
    "prbench.errors": ("PrbenchError", "InputFileError", "UsageError"),
    "prbench.geometry.skeleton": ("Joint", "PARENTS", "y_up", "z_up"),
    "prbench.randomness": ("sequence_generator",),
    "prbench.contract": ("batch_noise", "sequence_noise"),
    "prbench.representation": ("Statistics", "UniformSkeleton", "canonicalise", "rest_offsets", "retarget"),
}
"""Names that the file offers besides the converters."""

_MARK = "functions are those of prbench.representation.converters"
_HEADER = '''# ruff: noqa
# fmt: off
"""What models put out, as the 22 joints of prbench: NumPy only, Python 3.8 or later, nothing to install.

Written by `prbench adapters list --converters` from prbench {version} (MIT licence); do not change it, write it anew.
The functions are those of prbench.representation.converters and give the same numbers; docs/wrapping.md shows them at
work. Put the file beside your program, then: from prbench_converters import motions_from_features, placed_on
"""
'''


@dataclass
class _Statement:
    """One top-level statement, with the comments above and the text that documents it."""

    first: int
    last: int
    """Lines, from 1 on."""
    defines: frozenset[str]
    uses: frozenset[str]


@dataclass
class _Module:
    """One module, taken apart."""

    name: str
    text: str
    statements: list[_Statement] = field(default_factory=list)
    inside: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Imported from prbench: name here → module and name there."""
    outside: dict[str, str] = field(default_factory=dict)
    """Imported from elsewhere: name here → the line that imports it."""

    def defining(self, name: str) -> _Statement | None:
        """The statement that makes a name."""
        return next((one for one in self.statements if name in one.defines), None)

    def effects(self, names: Iterable[str]) -> list[_Statement]:
        """Statements that make no name and do something with these, such as ``ARRAY.setflags(…)``."""
        wanted = set(names)
        return [one for one in self.statements if not one.defines and one.uses & wanted]


def converters_file() -> str:
    """The text of :data:`ONE_FILE`."""
    offered = importlib.import_module(_CONVERTERS).__all__
    roots = {**_ROOTS, _CONVERTERS: tuple(offered)}
    return one_file(roots, _HEADER.format(version=prbench.__version__))


def write_converters(path: Path) -> None:
    """Write the file, or write it anew.

    Raises:
        StorageError: if something else stands there, another process is writing it, or it cannot be written.
    """
    if path.exists() and not (path.is_file() and _MARK.encode() in path.read_bytes()[:1000]):
        raise StorageError(f"{path}: is something else than the converters; nothing was written. Name another --out.")
    text = converters_file()
    with sole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def one_file(roots: Mapping[str, Iterable[str]], header: str) -> str:
    """Functions and all that they use, as one file.

    Args:
        roots: Names that are wanted, by the module that offers them.
        header: The file's docstring.
    """
    found = [_origin(module, name) for module, names in roots.items() for name in names]
    needed = _needed(found)
    chosen = _names(needed, frozenset(found))
    imports, for_types = _imports(needed)
    parts = [header, "from __future__ import annotations\n\n" + "\n".join((*imports, "", *for_types)) + "\n"]
    for name in _in_order(needed):
        body = _body(_module(name), needed[name], chosen)
        parts.append(f"# From {name.replace('.', '/')}.py\n\n\n{body}\n")
    offered = sorted({chosen[where] for where in found})
    parts.append("__all__ = [\n" + "".join(f'    "{name}",\n' for name in offered) + "]\n")
    return "\n\n".join(parts)


_Needed = dict[str, list[_Statement]]


def _needed(found: Iterable[tuple[str, str]]) -> _Needed:
    """Collect, by module, the statements behind some names and behind all that these use."""
    needed: _Needed = {}
    waiting = list(found)
    while waiting:
        name, wanted = waiting.pop()
        module = _module(name)
        statement = module.defining(wanted)
        assert statement is not None, f"{name} does not define {wanted}"
        # Such as ARRAY.setflags(write=False): it makes no name, so nobody uses it, and still it must come along.
        for one in (statement, *module.effects(statement.defines)):
            if one in needed.setdefault(name, []):
                continue
            needed[name].append(one)
            waiting += [_origin(name, used) for used in one.uses if module.defining(used) or used in module.inside]
    return needed


def _origin(module: str, name: str) -> tuple[str, str]:
    """Module and name under which something is defined that a module defines or imports."""
    while _module(module).defining(name) is None:
        module, name = _module(module).inside[name]
    return module, name


def _names(needed: _Needed, first: frozenset[tuple[str, str]]) -> dict[tuple[str, str], str]:
    """Name in the file of everything that is defined; what is offered keeps its own."""
    defined = [(module, name) for module in sorted(needed) for one in needed[module] for name in sorted(one.defines)]
    taken: dict[str, str] = {}
    chosen: dict[tuple[str, str], str] = {}
    for where in sorted(defined, key=lambda where: where not in first):
        module, name = where
        own = name if name not in taken else f"{name}_of_{module.rsplit('.', 1)[-1]}"
        assert own not in taken, f"{own} is made by {taken[own]} and by {module}; rename one of them"
        taken[own] = module
        chosen[where] = own
    return chosen


def _imports(needed: _Needed) -> tuple[list[str], list[str]]:
    """Lines that import what is used from elsewhere, and those for type checkers alone."""
    lines = set()
    for name, statements in needed.items():
        module = _module(name)
        lines |= {module.outside[used] for one in statements for used in one.uses if used in module.outside}
    for_types = sorted(line for line in lines if line.startswith(f"from {_FOR_TYPES_ONLY} "))
    lines -= set(for_types)
    if for_types:
        lines.add("from typing import TYPE_CHECKING")
        for_types = ["if TYPE_CHECKING:", *(f"    {line}" for line in for_types)]
    return sorted(lines, key=lambda line: (not line.startswith("import"), line)), for_types


def _in_order(needed: _Needed) -> list[str]:
    """Modules, each behind those that it imports from."""
    order: list[str] = []

    def visit(name: str) -> None:
        if name in order:
            return
        module = _module(name)
        used = {used for one in needed[name] for used in one.uses}
        # Sorted, so that equal sources give equal bytes.
        for place in sorted({_origin(name, alias)[0] for alias in used if alias in module.inside}):
            visit(place)
        order.append(name)

    for name in sorted(needed):
        visit(name)
    return order


def _body(module: _Module, statements: list[_Statement], chosen: Mapping[tuple[str, str], str]) -> str:
    """The statements of one module, under the names of the file."""
    renamed = {}
    for name in {name for one in statements for name in (one.uses | one.defines)}:
        if module.defining(name) or name in module.inside:
            own = chosen[_origin(module.name, name)]
            if own != name:
                renamed[name] = own
    lines = _renamed(module.text, renamed).splitlines()
    body = ""
    before = 0
    for one in sorted(statements, key=lambda one: one.first):
        gap = 1 if one.first == before + 1 else 3
        body += "\n" * gap * bool(body) + "\n".join(lines[one.first - 1 : one.last])
        before = one.last
    return body


def _renamed(text: str, names: Mapping[str, str]) -> str:
    """A module's text with other names in place of some; attributes of the same names stay."""
    if not names:
        return text
    lines = text.splitlines(keepends=True)
    places = []
    before = ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        # By tokens and not by text: a name inside a string or a comment, or an attribute of the same name, stays.
        if token.type == tokenize.NAME and token.string in names and before != ".":
            places.append(token.start)
        before = token.string
    # From the end, so that earlier places stay where they are.
    for row, column in reversed(places):
        line = lines[row - 1]
        old = next(name for name in sorted(names, key=len, reverse=True) if line.startswith(name, column))
        lines[row - 1] = line[:column] + names[old] + line[column + len(old) :]
    return "".join(lines)


@cache
def _module(name: str) -> _Module:
    spec = importlib.util.find_spec(name)
    assert spec is not None
    assert spec.origin is not None
    text = Path(spec.origin).read_text(encoding="utf-8")
    module = _Module(name, text)
    lines = text.splitlines()
    for node in ast.parse(text).body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            _take_import(module, node)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            if module.statements:  # the text below a constant belongs to it; the module's own is left away
                module.statements[-1].last = node.end_lineno or node.lineno
        else:
            first = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", []))])
            while first > 1 and lines[first - 2].startswith("#"):
                first -= 1
            names = [one for one in ast.walk(node) if isinstance(one, ast.Name)]
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                defines = {node.name}
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                defines = {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}
            else:
                defines = set()
            used = frozenset(one.id for one in names) - defines
            module.statements.append(_Statement(first, node.end_lineno or node.lineno, frozenset(defines), used))
    return module


def _take_import(module: _Module, node: ast.Import | ast.ImportFrom) -> None:
    for alias in node.names:
        name = alias.asname or alias.name
        as_name = "" if alias.asname is None else f" as {alias.asname}"
        if isinstance(node, ast.Import):
            module.outside[name] = f"import {alias.name}{as_name}"
        elif node.module is not None and node.module.split(".")[0] in _PACKAGES:
            module.inside[name] = (node.module, alias.name)
        else:
            module.outside[name] = f"from {node.module} import {alias.name}{as_name}"
