"""The page on JSON reports says what the commands print, field by field."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest

from prbench.cli.json_page import (
    all_commands,
    descriptions_of,
    fields_of,
    json_page,
    reports,
    shapes_in,
)
from prbench.cli.main import Document

PAGE = Path(__file__).parents[2] / "docs" / "json.md"
WITHOUT_REPORT: set[str] = set()
"""Commands that print text alone: they explain prbench, and are read by people and shells."""


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == json_page(), "python -m prbench.cli.json_page docs/json.md"


@pytest.mark.parametrize(("name", "report"), reports().items(), ids=reports())
def test_every_field_of_a_report_is_described_and_no_other(name, report) -> None:
    for shape in [*shapes_in(Document), *shapes_in(report)]:
        described = descriptions_of(shape)
        assert set(described) == set(fields_of(shape)), f"{name}: {shape.__name__}"
        assert not [field for field, text in described.items() if not text.endswith(".")]


def test_every_command_reports_and_has_the_option() -> None:
    for name, command in all_commands():
        options = {option for parameter in command.params for option in parameter.opts}
        assert ("--json" in options) is (name not in WITHOUT_REPORT), name


@pytest.mark.parametrize(("name", "report"), reports().items(), ids=reports())
def test_msgspec_knows_the_shape_of_every_report(name, report) -> None:
    schema = msgspec.json.schema(report, schema_hook=lambda kind: {"type": "string"})
    assert schema["$defs"]


class _Inner(msgspec.Struct):
    """One part.

    Attributes:
        size: Length, in metres;
            or nothing.

    Raises:
        this: is no field.
    """

    size: float | None


@dataclass
class _Outer:
    """The whole.

    Attributes:
        parts: By name.
    """

    parts: dict[str, list[_Inner]]


@dataclass
class _Further(_Outer):
    """More than the whole."""

    rest: int
    """What is left,
    counted."""


def test_descriptions_are_read_from_docstrings_of_structs_and_dataclasses() -> None:
    assert shapes_in(_Outer) == [_Outer, _Inner]
    assert descriptions_of(_Inner) == {"size": "Length, in metres; or nothing."}
    assert descriptions_of(_Outer) == {"parts": "By name."}
    assert descriptions_of(_Further) == {"parts": "By name.", "rest": "What is left, counted."}
