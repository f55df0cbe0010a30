"""Text from files cannot steer a terminal and cannot flood a message."""

from __future__ import annotations

import pytest

from prbench.errors import InputFileError
from prbench.shown import LONGEST_QUOTE, clean, quoted


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a cup", "a cup"),
        ("Tasse à café … ± 茶碗", "Tasse à café … ± 茶碗"),
        ("cup\x1b[2J", "cup\\x1b[2J"),
        ("cup\x9b31m", "cup\\x9b31m"),
        ("a\nb\rc", "a\\nb\\rc"),
        ("gpj.\u202eexe", "gpj.\\u202eexe"),
        ("a\u2028b", "a\\u2028b"),
        ("\udcff", "\\udcff"),
    ],
)
def test_only_what_steers_is_spelt_out(text, shown):
    assert clean(text) == shown
    assert clean(text).encode()  # nothing is left that cannot be printed


def test_line_breaks_of_our_own_stay_where_asked():
    assert clean("one\ntwo\x1b", keep="\n") == "one\ntwo\\x1b"


def test_a_long_text_is_cut_and_what_is_missing_counted():
    text = "x" * 100_000
    assert quoted(text) == f"{'x' * LONGEST_QUOTE} … (99800 more characters)"
    assert quoted("short") == "short"


def test_a_message_quotes_no_more_than_its_share_and_no_escape():
    error = InputFileError("a\x1bb.csv", "key " + "k" * 9_000, expected="a number", found="\x1b[31m" + "y" * 9_000)
    assert len(str(error)) < 600
    assert "\x1b" not in str(error)
    assert error.found.startswith("\x1b"), "what was found stays as it is for programs"
