"""Messages of the wire protocol (docs/wire-protocol.md), read and written by both sides.

A message is one header line, a JSON object in UTF-8, followed by exactly ``bytes`` bytes if the header has that key.
"""

from __future__ import annotations

import io
import json
from typing import Any, BinaryIO

from prbench.methods.remote.payloads import batch_of, conditions_payload, motions_of, motions_payload

__all__ = [
    "HEADER_LIMIT",
    "WIRE_VERSION",
    "Header",
    "batch_of",
    "conditions_payload",
    "encode_message",
    "motions_of",
    "motions_payload",
    "parse_header",
    "read_message",
    "shown_json",
    "write_message",
]

WIRE_VERSION = 1
HEADER_LIMIT = 65_536
"""Bytes of a header line, its end included."""
Header = dict[str, Any]


def encode_message(header: Header, payload: bytes | None = None) -> list[bytes]:
    """The bytes of a message, in one or two pieces so that a payload is not copied.

    Raises:
        ValueError: if the header is longer than the protocol allows, or holds what JSON cannot.
    """
    if payload is not None:
        header = {**header, "bytes": len(payload)}
    line = json.dumps(header, allow_nan=False).encode() + b"\n"
    if len(line) > HEADER_LIMIT:
        raise ValueError(f"expected a header of at most {HEADER_LIMIT:,} bytes, found {len(line):,}")
    return [line] if payload is None else [line, payload]


def parse_header(line: bytes) -> Header:
    """The JSON object of a header line; it has the key ``bytes`` only if a payload follows.

    Raises:
        ValueError: if the line is no header; says why.
    """
    try:
        header = json.loads(line.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"no JSON in UTF-8: {error}") from error
    if not isinstance(header, dict) or not isinstance(header.get("message"), str):
        raise ValueError("no JSON object with a text under 'message'")
    if "bytes" in header and not (type(header["bytes"]) is int and header["bytes"] >= 0):
        raise ValueError(f"'bytes' is {shown_json(header['bytes'])}, no whole number of 0 or more")
    return header


def shown_json(value: object) -> str:
    """A value of a header as JSON, with its type where the eye may take it for another.

    >>> shown_json(7), shown_json("7"), shown_json(None)
    ('7', '"7" (a string)', 'null')
    """
    text = json.dumps(value)
    text = text if len(text) <= 40 else f"{text[:40]}…"
    names = {str: "a string", float: "a number with decimals", list: "an array", dict: "an object"}
    return f"{text} ({names[type(value)]})" if type(value) in names else text


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")


def write_message(stream: BinaryIO | io.BufferedIOBase, header: Header, payload: bytes | None = None) -> None:
    """Write one message and flush.

    Raises:
        ValueError: see :func:`encode_message`.
    """
    for piece in encode_message(header, payload):
        stream.write(piece)
    stream.flush()


def read_message(stream: BinaryIO | io.BufferedIOBase) -> tuple[Header, bytes | None] | None:
    """Read one message; waits for it.

    Returns:
        Header and payload (None if the header announces none); None where the stream ends between messages.

    Raises:
        ValueError: if what comes is no message.
        EOFError: if the stream ends in mid-message.
    """
    line = stream.readline(HEADER_LIMIT)
    if not line:
        return None
    if not line.endswith(b"\n"):
        if len(line) == HEADER_LIMIT:
            raise ValueError(f"expected a header of at most {HEADER_LIMIT:,} bytes, found no line end in as many")
        raise EOFError(f"the stream ended inside a header, after {len(line):,} bytes")
    header = parse_header(line)
    if "bytes" not in header:
        return header, None
    payload = stream.read(header["bytes"])
    if len(payload) < header["bytes"]:
        raise EOFError(f"the stream ended after {len(payload):,} of {header['bytes']:,} bytes of payload")
    return header, payload
