"""Reports of commands as JSON, read by the shape that the command documents."""

from __future__ import annotations

import json
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from docs.json_page import fields_of, has_fields, reports
from prbench.cli import main
from prbench.cli.main import Document


def reported(words: Sequence[str], capsys: pytest.CaptureFixture, *, code: int = 0, kind: str = "") -> Any:
    """Run a command with ``--json`` and return its report, which holds exactly what the page on JSON documents.

    ``kind`` chooses among the reports of a command that has several.
    """
    document = printed_document(words, capsys, code=code)
    assert document.error is None
    return documented(document.report, reports()[f"{document.command} {kind}".strip()])


def documented(value: Any, kind: Any) -> Any:
    """Return JSON as attributes, after a look that every object has the keys of its class and no other."""
    inner = typing.get_args(kind)
    if value is None:
        return None
    if kind is Path:
        return Path(value)
    if typing.get_origin(kind) in (types.UnionType, typing.Union):
        if isinstance(value, str):
            return Path(value) if Path in inner else value
        objects = [each for each in inner if has_fields(each) and isinstance(value, dict)]
        plain = [each for each in inner if not has_fields(each) and typing.get_args(each)]
        fitting = [each for each in objects if set(value) == set(fields_of(each))] + objects + plain
        return documented(value, fitting[0]) if fitting else value
    if has_fields(kind):
        kinds = fields_of(kind)
        may_lack = getattr(getattr(kind, "__struct_config__", None), "omit_defaults", False)
        assert set(value) <= set(kinds) if may_lack else set(value) == set(kinds), kind.__name__
        return SimpleNamespace(**{name: documented(value[name], kinds[name]) for name in value})
    if isinstance(value, list) and inner:
        return [
            documented(each, inner[min(place, len(inner) - 1) if Ellipsis not in inner else 0])
            for place, each in enumerate(value)
        ]
    if isinstance(value, dict) and inner:
        return {name: documented(each, inner[1]) for name, each in value.items()}
    return value


def plain(value: Any) -> Any:
    """Return what :func:`documented` has read as the JSON that it was."""
    return json.loads(json.dumps(value, default=lambda each: str(each) if isinstance(each, Path) else vars(each)))


def refused(words: Sequence[str], capsys: pytest.CaptureFixture, *, code: int, message: str) -> None:
    """Run a command with ``--json`` that cannot work, and expect an error in the document."""
    document = printed_document(words, capsys, code=code)
    assert document.report is None
    assert document.error is not None
    assert message in document.error["message"]


def printed_document(words: Sequence[str], capsys: pytest.CaptureFixture, *, code: int) -> Document:
    """Run a command with ``--json`` and return what it printed, which is the document and nothing else."""
    capsys.readouterr()
    assert main([*words, "--json"]) == code
    values: Any = json.loads(capsys.readouterr().out)
    document = msgspec.convert(values, Document, strict=True)
    assert msgspec.to_builtins(document) == values
    assert document.exit_code == code
    return document
