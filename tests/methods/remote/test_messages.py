"""One header line, then exactly as many bytes as it announces."""

from __future__ import annotations

import io

import pytest

from prbench.methods.remote.messages import HEADER_LIMIT, parse_header, read_message, write_message


def test_messages_follow_one_another_without_anything_in_between() -> None:
    stream = io.BytesIO()
    write_message(stream, {"message": "hello", "name": "gleiten ↗"})
    write_message(stream, {"message": "motions", "batch": 0}, b"\n{payload}\n")
    write_message(stream, {"message": "motions", "batch": 1}, b"")
    assert stream.getvalue().count(b"\n") == 5
    stream.seek(0)
    assert read_message(stream) == ({"message": "hello", "name": "gleiten ↗"}, None)
    assert read_message(stream) == ({"message": "motions", "batch": 0, "bytes": 11}, b"\n{payload}\n")
    assert read_message(stream) == ({"message": "motions", "batch": 1, "bytes": 0}, b"")
    assert read_message(stream) is None


def test_windows_line_ends_are_read() -> None:
    assert parse_header(b'{"message": "hello"}\r\n') == {"message": "hello"}


@pytest.mark.parametrize("size", ["null", "2.0", "true", '"2"', "-2"])
def test_a_size_is_a_whole_number_or_left_out(size: str) -> None:
    with pytest.raises(ValueError, match=f"'bytes' is {size}.*, no whole number of 0 or more"):
        parse_header(f'{{"message": "hello", "bytes": {size}}}\n'.encode())


def test_a_stream_that_ends_in_mid_message_is_told_from_one_that_ends() -> None:
    with pytest.raises(EOFError, match="inside a header, after 5 bytes"):
        read_message(io.BytesIO(b'{"mes'))
    with pytest.raises(EOFError, match="after 3 of 9 bytes of payload"):
        read_message(io.BytesIO(b'{"message": "motions", "bytes": 9}\nabc'))


def test_a_header_has_at_most_64_kib_on_either_side() -> None:
    frame = len(b'{"message": ""}\n')
    stream = io.BytesIO()
    write_message(stream, {"message": "x" * (HEADER_LIMIT - frame)})
    assert len(stream.getvalue()) == HEADER_LIMIT == 65536
    stream.seek(0)
    assert read_message(stream) is not None
    with pytest.raises(ValueError, match="at most 65,536 bytes, found 65,537"):
        write_message(stream, {"message": "x" * (HEADER_LIMIT - frame + 1)})
    with pytest.raises(ValueError, match="at most 65,536 bytes, found no line end"):
        read_message(io.BytesIO(b"x" * HEADER_LIMIT + b"\n"))


def test_what_is_no_json_is_never_written() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_message(io.BytesIO(), {"message": "generate", "fps": float("nan")})
