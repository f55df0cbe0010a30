"""The site's page on JSON reports, written from the classes of the reports.

``docs/hooks.py`` puts it into the site; ``python docs/json_page.py FILE`` writes the page alone.
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
from collections.abc import Mapping
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
  "report": [
    {
      "name": "static",
      "package": "prbench",
      "version": "0.10.0",
      "target": "prbench_adapters.static:load",
      "problem": "",
      "built_in": true
    }
  ],
  "error": null
}
```

A command that cannot do its work prints a document, too: `report` is null, and `error` says why. Numbers that JSON
cannot hold (not a number, infinity) are null. Paths are written as they were given. Keys may be added in later
versions; a key that is described here keeps its name and meaning within a major version.
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
    """Return the text of the page; a class that several reports hold is described where it comes first."""
    lines = _START.splitlines()
    headings: dict[type, str] = {}
    for name, report in {"": Document, **reports()}.items():
        title = f"prbench {name}" if name else "The envelope"
        shapes = [each for each in shapes_in(report) if each not in headings]
        for each in shapes:
            taken = each.__name__ in headings.values()
            headings[each] = f"{each.__name__} of {name}" if taken else each.__name__
        if has_fields(report) and shapes and shapes[0] is report:
            headings[report] = title
        lines += ["", f"## {title}", ""]
        if headings.get(report) != title:
            words = _in_words(report, headings)
            lines.append(f"{words[0].upper()}{words[1:]}.")
        for each in shapes:
            if headings[each] != title:
                lines += ["", f"### {headings[each]}", ""]
            described = descriptions_of(each)
            summary = (inspect.getdoc(each) or "").partition("\n\n")[0]
            lines += [" ".join(summary.split()).replace("``", "`"), "", "| name | type | meaning |", "|---|---|---|"]
            for field, annotation in fields_of(each).items():
                meaning = described.get(field, "").replace("``", "`").replace("|", "\\|")
                lines.append(f"| `{field}` | {_in_words(annotation, headings)} | {meaning} |")
    return "\n".join(lines) + "\n"


def all_commands() -> list[tuple[str, Command]]:
    """Return every command with its name, such as ``leaderboard export``, in the order of the help."""
    found = program.walk(click.Context(program))
    return [(name, command) for name, command in found if isinstance(command, Command)]


def reports() -> dict[str, Any]:
    """Return the type of every report by the name of its command, and of the first argument where that chooses it."""
    found = {}
    for name, command in all_commands():
        kinds = command.report if isinstance(command.report, Mapping) else {"": command.report}
        found |= {f"{name} {value}".strip(): _imported(report) for value, report in kinds.items() if report is not None}
    return found


def _imported(report: Any) -> Any:
    """Return a type; of a list of one, a list of that. Some are named (``module:class``): they take long to import."""
    if isinstance(report, list):
        return list[_imported(report[0])]
    if not isinstance(report, str):
        return report
    module, _, name = report.partition(":")
    return getattr(importlib.import_module(module), name)


def shapes_in(shape: Any) -> list[type]:
    """Return all classes with fields that a report and their fields hold, each once, outer ones first."""
    found: list[type] = []
    waiting = [shape]
    for current in waiting:  # grows meanwhile
        if has_fields(current) and current not in found:
            found.append(current)
            waiting += fields_of(current).values()
        waiting += typing.get_args(current)
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
        entries = re.match(r"(?:    .*\n?|\n)*", section)
        for name, text in re.findall(r"^    (\w+): (.*(?:\n     .*)*)", entries[0] if entries else "", re.MULTILINE):
            found[name] = " ".join(text.split())
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        assert isinstance(tree, ast.ClassDef)
        for field, below in itertools.pairwise(tree.body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(below, ast.Expr):
                found[field.target.id] = " ".join(str(ast.literal_eval(below.value)).split())
    return {name: text for name, text in found.items() if name in fields_of(shape)}


def has_fields(annotation: Any) -> bool:
    """Return True for a data class or struct, which is an object in JSON."""
    return isinstance(annotation, type) and (
        issubclass(annotation, msgspec.Struct) or dataclasses.is_dataclass(annotation)
    )


def _in_words(annotation: Any, headings: Mapping[type, str]) -> str:
    """Say what JSON holds for a type."""
    origin = typing.get_origin(annotation)
    inner = typing.get_args(annotation)
    if annotation in _PLAIN_TYPES:
        return _PLAIN_TYPES[annotation]
    if has_fields(annotation):
        heading = headings[annotation]
        anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        return f"[{heading}](#{anchor})"
    if origin is typing.Literal:
        return " or ".join(f"`{value}`" for value in inner)
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " or ".join(f"`{each.value}`" for each in annotation)
    words = [_in_words(each, headings) for each in inner if each is not Ellipsis]
    if origin in (types.UnionType, typing.Union):
        return " or ".join(words)
    if origin in (dict, Mapping) or annotation is dict:
        return f"object: {words[1] if words else 'any'} by name"
    if origin in (list, tuple, set, frozenset) or annotation in (list, tuple):
        kinds = dict.fromkeys(f"{each}s" if each in _COUNTABLE else each for each in words)
        return f"list of {' and '.join(kinds) or 'any'}"
    raise TypeError(f"no words for the type {annotation}")


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json_page(), encoding="utf-8", newline="\n")
