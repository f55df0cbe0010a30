"""The page on JSON reports, which the site makes, says what the commands print, field by field."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import pytest

from docs.json_page import all_commands, descriptions_of, fields_of, json_page, reports, shapes_in
from prbench.cli.main import Document
from tests.docs.test_citations import anchor_of


def test_the_page_has_a_section_for_every_command_and_every_record_and_its_links_lead_there() -> None:
    lines = json_page().splitlines()
    sections = {anchor_of(line.lstrip("# ")) for line in lines if line.startswith("##")}
    assert {f"prbench-{name.replace(' ', '-')}" for name in reports()} <= sections
    rows = [line.split(" | ") for line in lines if line.startswith("| `")]
    links = {link.partition(")")[0] for row in rows for link in row[1].split("](#")[1:]}
    assert links
    assert links <= sections


@pytest.mark.parametrize(("name", "report"), reports().items(), ids=reports())
def test_every_field_of_a_report_is_described_and_no_other(name, report) -> None:
    for shape in [*shapes_in(Document), *shapes_in(report)]:
        described = descriptions_of(shape)
        assert set(described) == set(fields_of(shape)), f"{name}: {shape.__name__}"
        assert not [field for field, text in described.items() if not text.endswith(".")]
    schema = msgspec.json.schema(report, schema_hook=lambda kind: {"type": "string"})
    assert schema["$defs"]


def test_every_command_reports_as_json() -> None:
    for name, command in all_commands():
        assert "--json" in {option for parameter in command.params for option in parameter.opts}, name


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
    assert descriptions_of(_Further) == {"parts": "By name.", "rest": "What is left, counted."}
