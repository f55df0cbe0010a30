"""Reports of commands as JSON, read by the shape that the command documents."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import pytest

from prbench.cli import main
from prbench.cli.documents import Document

_Report = TypeVar("_Report")


def reported(words: Sequence[str], shape: type[_Report], capsys: pytest.CaptureFixture, *, code: int = 0) -> _Report:
    """Run a command with ``--json`` and return its report, which holds nothing beside what its shape names."""
    document = printed_document(words, capsys, code=code)
    assert document.error is None
    report = msgspec.convert(document.report, shape, strict=True, dec_hook=lambda _, value: Path(value))
    assert msgspec.to_builtins(report, enc_hook=str) == document.report, "keys that no shape names"
    return report


def refused(words: Sequence[str], capsys: pytest.CaptureFixture, *, code: int, message: str) -> None:
    """Run a command with ``--json`` that cannot work, and expect an error in the document."""
    document = printed_document(words, capsys, code=code)
    assert document.report is None
    assert document.error is not None
    assert message in document.error.message


def printed_document(words: Sequence[str], capsys: pytest.CaptureFixture, *, code: int) -> Document:
    """Run a command with ``--json`` and return what it printed, which is the document and nothing else."""
    capsys.readouterr()
    assert main([*words, "--json"]) == code
    values: Any = json.loads(capsys.readouterr().out)
    document = msgspec.convert(values, Document, strict=True)
    assert msgspec.to_builtins(document) == values
    assert document.exit_code == code
    return document
