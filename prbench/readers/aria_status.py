"""``summary.json`` of the Aria Machine Perception Services: what its operators say of a stream.

Source: docs/specification/aria-mps.md#summaries.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from prbench.errors import InputFileError
from prbench.readers.files import decode_json
from prbench.readers.zipped import Source, shown

_ANYTHING = msgspec.json.Decoder()


def read_warnings(path: Source) -> tuple[str, ...]:
    """What the operators of a stream warn of; their names vary between versions, and none is required.

    Returns:
        One remark for each operator with the status WARNING.

    Raises:
        InputFileError: if the file is damaged, or an operator reports an ERROR: the stream is then not to be used.
    """
    warnings = []
    for operator, report in _reports(decode_json(path, _ANYTHING)):
        if report["status"] == "ERROR":
            raise InputFileError(
                shown(path),
                operator,
                expected="no operator with the status ERROR",
                found=f"ERROR{_reason(report)}",
                remedy="The services could not compute this stream; leave the recording out, or request it again.",
            )
        if report["status"] == "WARNING":
            warnings.append(f"{shown(path).parent.name}: {operator} warns{_reason(report)}")
    return tuple(warnings)


def _reports(summary: object) -> Iterator[tuple[str, dict]]:
    """Every entry that has a status, with the name of its operator; some operators hold a list of them."""
    if not isinstance(summary, dict):
        return
    for operator, value in summary.items():
        for report in value if isinstance(value, list) else [value]:
            if isinstance(report, dict) and "status" in report:
                yield str(operator), report


def _reason(report: dict) -> str:
    details = [report.get("message"), *report.get("errors", []), *report.get("warnings", [])]
    said = "; ".join(str(detail) for detail in details if detail)
    return f" ({said[:160]})" if said else ""
