"""Read the entries of ``target_information.json`` from any of five shapes of the file.

Source: docs/specification/pr-release.md#tolerant-parser.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prbench.errors import InputFileError
from prbench.files.bounded import read_text
from prbench.limits import LARGEST_JSON
from prbench.release.fields import names_a_field
from prbench.release.known import letters
from prbench.release.layout import index_of
from prbench.release.values import SUBSETS

_WRAPPERS = ("sequences", "data", "annotations")
_KEYS = (
    "id", "key", "index", "idx", "sequence", "seq", "sequenceid", "seqid", "sequencename", "file", "filename",
    "motion", "motionfile", "name",
)  # fmt: skip
_DEEPEST = 4  # wrappers within wrappers


@dataclass(frozen=True)
class Entry:
    """One sequence as the file describes it."""

    key: str
    """The key as the file writes it."""
    index: int | None
    """Its number; None for a key without one."""
    fields: Mapping[str, Any]


@dataclass(frozen=True)
class Entries:
    """All sequences of a file."""

    path: Path
    entries: tuple[Entry, ...]
    shape: str
    """The recognised shape, in words."""

    @property
    def field_names(self) -> list[str]:
        """Fields of all entries, in the order of first appearance."""
        return list(dict.fromkeys(name for entry in self.entries for name in entry.fields))

    def values(self, field: str) -> list[Any]:
        """Return the values of one field, of the entries that have it."""
        return [entry.fields[field] for entry in self.entries if entry.fields.get(field) is not None]


def read_entries(path: Path) -> Entries:
    """Read the file.

    Raises:
        InputFileError: if it is missing, no JSON, of none of the five shapes, or two keys mean one sequence.
    """
    content = _load(path)
    keyed, shape = _unfold(path, content, depth=0)
    entries = tuple(Entry(key, index_of(key), fields) for key, fields in keyed)
    if not entries:
        raise InputFileError(path, "", expected="one sequence or more", found="none")
    _require_distinct(path, entries)
    return Entries(path, entries, " of ".join(shape))


def _load(path: Path) -> Any:
    try:
        return json.loads(read_text(path, largest=LARGEST_JSON), object_pairs_hook=_without_repeats)
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="a JSON file", found="no file") from error
    except RecursionError as error:
        raise InputFileError(path, "", expected="entries of sequences", found="thousands of nested lists") from error
    except (ValueError, OSError) as error:  # JSONDecodeError and UnicodeDecodeError are ValueErrors
        remedy = "The file may be truncated; copy or download it again."
        raise InputFileError(path, "", expected="valid JSON", found=str(error), remedy=remedy) from error


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        repeated = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key '{repeated}' twice in one object")
    return found


def _unfold(path: Path, content: Any, *, depth: int) -> tuple[list[tuple[str, dict[str, Any]]], list[str]]:
    """Return keys with their fields, and the nested shapes from outside to inside."""
    if isinstance(content, list):
        return _from_list(path, content), ["list of entries"]
    # A bound on the depth, because a file that nests for ever is damaged or hostile.
    if not isinstance(content, dict) or depth > _DEEPEST:
        raise _unknown(path, f"a {type(content).__name__}" if depth == 0 else "something else inside its wrapper")
    wrapper = _wrapper(content)
    if wrapper is not None:
        # Fields beside a wrapper, such as one frame rate for all, belong to every sequence in it.
        defaults = {name: value for name, value in content.items() if name != wrapper and names_a_field(name)}
        keyed, shape = _unfold(path, content[wrapper], depth=depth + 1)
        return [(key, defaults | fields) for key, fields in keyed], [f"wrapper '{wrapper}'", *shape]
    if content and all(
        str(name).strip().lower() in SUBSETS and isinstance(part, dict | list) for name, part in content.items()
    ):
        return _by_subset(path, content, depth)
    if _is_by_field(content):
        return _transposed(path, content), ["object by field"]
    wrong = next((key for key, fields in content.items() if not isinstance(fields, dict)), None)
    if wrong is not None:
        raise _unknown(path, f"a {type(content[wrong]).__name__} under the key '{wrong}'")
    return list(content.items()), ["object by sequence"]


def _wrapper(content: dict[str, Any]) -> str | None:
    held = [name for name in content if letters(name) in _WRAPPERS and isinstance(content[name], dict | list)]
    others = [name for name, value in content.items() if isinstance(value, dict | list) and name not in held]
    return held[0] if len(held) == 1 and not others else None


def _by_subset(path: Path, content: dict[str, Any], depth: int) -> tuple[list[tuple[str, dict[str, Any]]], list[str]]:
    keyed = list[tuple[str, dict[str, Any]]]()
    shape = list[str]()
    for subset, part in content.items():
        if not part:
            continue
        inner, shape = _unfold(path, part, depth=depth + 1)
        keyed += [(key, {"subset": subset} | fields) for key, fields in inner]
    return keyed, ["object by subset", *shape]


def _from_list(path: Path, content: list[Any]) -> list[tuple[str, dict[str, Any]]]:
    keyed = []
    for place, fields in enumerate(content):
        if not isinstance(fields, dict):
            raise _unknown(path, f"a {type(fields).__name__} at place {place} of the list")
        named = {letters(name): name for name in fields}
        name = next((named[known] for known in _KEYS if known in named), None)
        if name is None or not isinstance(fields[name], str | int):
            raise InputFileError(
                path,
                f"place {place} of the list",
                expected=f"a field that names the sequence ({', '.join(_KEYS[:8])} …)",
                found=", ".join(fields) or "no fields",
            )
        keyed.append((str(fields[name]), {other: value for other, value in fields.items() if other != name}))
    return keyed


def _is_by_field(content: dict[str, Any]) -> bool:
    """Return True if keys are names of fields and values are lists or objects by sequence."""
    if not content or not all(isinstance(part, dict | list) for part in content.values()):
        return False
    if any(isinstance(part, list) for part in content.values()):
        return True
    # Objects by field and by sequence look alike; the level that has more names of fields is that of the fields.
    outer = sum(names_a_field(name) for name in content)
    inner = sum(names_a_field(name) for part in list(content.values())[:1] for name in part)
    return outer > inner


def _transposed(path: Path, content: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    key_field = _key_field(content)
    names = None if key_field is None else content.pop(key_field)
    keys = [str(name) for name in names] if isinstance(names, list) else None
    rows: dict[str, dict[str, Any]] = {}
    for field, part in content.items():
        if isinstance(part, dict):
            keyed: Iterable[tuple[str, Any]] = part.items()
        elif keys is None or len(keys) == len(part):
            keyed = zip(keys or map(str, range(len(part))), part)
        else:
            raise InputFileError(path, field, expected=f"{len(keys)} values, one a sequence", found=f"{len(part)}")
        for key, value in keyed:
            rows.setdefault(key, {})[field] = value
    return list(rows.items())


def _key_field(content: dict[str, Any]) -> str | None:
    """Return the name of the list that holds the keys, if there is one."""
    return next((name for name, part in content.items() if isinstance(part, list) and letters(name) in _KEYS), None)


def _require_distinct(path: Path, entries: Iterable[Entry]) -> None:
    first: dict[int | str, str] = {}
    for entry in entries:
        # `seq_12` and `12` name one motion file and would overwrite each other.
        name = entry.key if entry.index is None else entry.index
        if name in first:
            raise InputFileError(
                path, f"sequence {name}", expected="one key", found=f"'{first[name]}' and '{entry.key}'"
            )
        first[name] = entry.key


def _unknown(path: Path, found: str) -> InputFileError:
    return InputFileError(
        path,
        "",
        expected="an object by sequence, a wrapper around it, a list of entries, an object by field, or by subset",
        found=found,
    )
