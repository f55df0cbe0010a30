"""The page on JSON reports (``docs/json.md``), written from the classes of the reports.

``python -m prbench.cli.json_page docs/json.md`` writes it again after a report has changed; a test compares the two.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import importlib
import inspect
import itertools
import re
import sys
import textwrap
import types
import typing
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import click
import msgspec

from prbench.cli.commands import Command
from prbench.cli.main import Document, program

_START = """\
# Reports as JSON

You want to use what a command reports in a program of yours.

`--json` prints the report of a command on standard output, as one JSON document; notes and progress stay on standard
error. `--out FILE` writes the same document, unless the command's own result is written there (the help of a command
tells). Every document has the same envelope, and each command a report of its own:

```bash
prbench adapters list static --json
```

```json
{
  "prbench": "0.10.0",
  "command": "adapters list",
  "exit_code": 0,
  "notes": [],
  "report": {
    "methods": [
      {
        "name": "static",
        "package": "prbench",
        "version": "0.10.0",
        "target": "prbench_adapters.static:load",
        "problem": "",
        "details": null
      }
    ],
    "controls": []
  },
  "error": null
}
```

A command that cannot do its work prints a document, too: `report` is null, and `error` says why. Numbers that JSON
cannot hold (not a number, infinity) are null. Paths are written as they were given. Keys may be added in later
versions; a key that is described here keeps its name and meaning within a major version.

`python -m prbench.cli.json_page docs/json.md` writes this page from the classes of the reports.
"""
_COUNTABLE = ("string", "integer", "number", "boolean", "path")
_PLAIN_TYPES: dict[Any, str] = {
    str: "string",
    int: "integer",
    float: "number",
    bool: "boolean",
    type(None): "null",
    Path: "path",
    Any: "any",
    object: "any",
}


def json_page() -> str:
    """Return the text of ``docs/json.md``."""
    writer = _Writer()
    writer.add_envelope()
    for name, report in reports().items():
        writer.add_command(name, report)
    return "\n".join(writer.lines) + "\n"


def all_commands() -> list[tuple[str, Command]]:
    """Return every command with its name, such as ``leaderboard export``, in the order of the help."""
    found = program.walk(click.Context(program))
    return [(name, command) for name, command in found if isinstance(command, Command)]


def reports() -> dict[str, type]:
    """Return the class of every report by the name of its command, and of the first argument where that chooses it."""
    found = {}
    for name, command in all_commands():
        if isinstance(command.report, Mapping):
            found |= {f"{name} {value}": report for value, report in command.report.items()}
        elif isinstance(command.report, str):  # named, since its module takes long to import
            module, _, report = command.report.partition(":")
            found[name] = getattr(importlib.import_module(module), report)
        elif command.report is not None:
            found[name] = command.report
    return found


def shapes_in(shape: type) -> list[type]:
    """Return a report's class and all classes that its fields hold, each once, outer ones first."""
    found = [shape]
    for current in found:  # grows meanwhile
        for annotation in fields_of(current).values():
            found += [inner for inner in _classes(annotation) if inner not in found]
    return found


def fields_of(shape: type) -> dict[str, Any]:
    """Return the fields of a class with their types."""
    _import_for_types(shape.__module__)
    hints = typing.get_type_hints(shape)
    if dataclasses.is_dataclass(shape):
        return {each.name: hints[each.name] for each in dataclasses.fields(shape)}
    return {each.encode_name: hints[each.name] for each in msgspec.structs.fields(shape)}


@functools.cache
def _import_for_types(name: str) -> None:
    """Import what a module imports for type checkers alone, so that the types in its records have a meaning."""
    module = sys.modules[name]
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            exec(compile(ast.Module(node.body, []), name, "exec"), vars(module))


def descriptions_of(shape: type) -> dict[str, str]:
    """Return what a class says about its fields, by their names.

    Either the docstring has a section "Attributes:" (Google style: ``name: text``, further lines indented), or a string
    stands below each field; fields of a class that it extends are described there.
    """
    found: dict[str, str] = {}
    for each in reversed(shape.__mro__):
        if not has_fields(each) or each is msgspec.Struct:
            continue
        _, _, section = (inspect.getdoc(each) or "").partition("\nAttributes:\n")
        name = ""
        for line in section.splitlines():
            if line.strip() and not line.startswith("    "):
                break  # another section
            entry = re.match(r"    (\w+): (.*)", line)
            if entry:
                name = entry[1]
                found[name] = entry[2]
            elif name and line.strip():
                found[name] += f" {line.strip()}"
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        assert isinstance(tree, ast.ClassDef)
        for field, below in itertools.pairwise(tree.body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(below, ast.Expr):
                found[field.target.id] = " ".join(str(ast.literal_eval(below.value)).split())
    return {name: text for name, text in found.items() if name in fields_of(shape)}


def _classes(annotation: Any) -> Iterator[type]:
    """Yield the classes with fields that a type names."""
    if has_fields(annotation):
        yield annotation
    for inner in typing.get_args(annotation):
        yield from _classes(inner)


def has_fields(annotation: Any) -> bool:
    """Return True for a data class or struct, which is an object in JSON."""
    return isinstance(annotation, type) and (
        issubclass(annotation, msgspec.Struct) or dataclasses.is_dataclass(annotation)
    )


class _Writer:
    """Collects the lines of the page; a class that several reports hold is described where it comes first."""

    def __init__(self) -> None:
        self.lines = _START.splitlines()
        self.headings: dict[type, str] = {}

    def add_envelope(self) -> None:
        """Describe the envelope."""
        self._add_section("The envelope", Document)

    def add_command(self, name: str, report: type) -> None:
        """Describe the report of one command."""
        self._add_section(f"prbench {name}", report, owner=name)

    def _add_section(self, title: str, shape: type, owner: str = "") -> None:
        first_seen = [each for each in shapes_in(shape) if each not in self.headings]
        for each in first_seen:
            self.headings[each] = title if each is shape else self._free_heading(each.__name__, owner)
        self.lines += ["", f"## {title}", "", _first_paragraph(shape), ""]
        self._add_table(shape)
        for each in first_seen:
            if each is not shape:
                self.lines += ["", f"### {self.headings[each]}", "", _first_paragraph(each), ""]
                self._add_table(each)

    def _free_heading(self, name: str, owner: str) -> str:
        """Return the name of a class, or, if another class has a heading of that name, its name and the command's."""
        taken = name in self.headings.values()
        return f"{name} of {owner}" if taken else name

    def _add_table(self, shape: type) -> None:
        described = descriptions_of(shape)
        self.lines += ["| name | type | meaning |", "|---|---|---|"]
        for name, annotation in fields_of(shape).items():
            meaning = described.get(name, "").replace("``", "`").replace("|", "\\|")
            self.lines.append(f"| `{name}` | {self._in_words(annotation)} | {meaning} |")

    def _plural(self, annotation: Any) -> str:
        """Name a type as what a list holds."""
        words = self._in_words(annotation)
        return f"{words}s" if words in _COUNTABLE else words

    def _in_words(self, annotation: Any) -> str:
        """Say what JSON holds for a type."""
        origin = typing.get_origin(annotation)
        inner = typing.get_args(annotation)
        if annotation in _PLAIN_TYPES:
            return _PLAIN_TYPES[annotation]
        if has_fields(annotation):
            heading = self.headings[annotation]
            return f"[{heading}](#{_anchor(heading)})"
        if origin in (types.UnionType, typing.Union):
            return " or ".join(self._in_words(each) for each in inner)
        if origin is typing.Literal:
            return " or ".join(f"`{value}`" for value in inner)
        if origin in (dict, Mapping) or annotation is dict:
            return f"object: {self._in_words(inner[1]) if inner else 'any'} by name"
        if origin in (list, tuple, set, frozenset) or annotation in (list, tuple):
            kinds = dict.fromkeys(self._plural(each) for each in inner if each is not Ellipsis)
            return f"list of {' and '.join(kinds) or 'any'}"
        if isinstance(annotation, type) and issubclass(annotation, Enum):
            return " or ".join(f"`{each.value}`" for each in annotation)
        raise TypeError(f"no words for the type {annotation}")


def _first_paragraph(shape: type) -> str:
    return " ".join((inspect.getdoc(shape) or "").partition("\n\n")[0].split()).replace("``", "`")


def _anchor(heading: str) -> str:
    """Return the name under which a page links to a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def main() -> int:
    """Write the page to the file that the command line names, or print it."""
    text = json_page()
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(text, encoding="utf-8", newline="\n")
    else:
        print(text, end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
