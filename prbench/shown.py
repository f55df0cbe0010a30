"""Text that comes from files and other people, made fit to be shown: on a terminal, in a message, in a log."""

from __future__ import annotations

import unicodedata

LONGEST_QUOTE = 200
"""Characters that a message quotes of something that was found in a file."""

_UNSEEN = {"Cc", "Cf", "Co", "Cs", "Zl", "Zp"}
"""Unicode categories that are not drawn but steer: control and format characters, lone surrogates, line separators."""


def clean(text: object, *, keep: str = "") -> str:
    r"""Return a text in which every character that steers a terminal or hides text is spelt out as an escape.

    Escape sequences, carriage returns, line breaks, marks that turn the direction of writing and bytes of file names
    that are no text are written as ``\x1b``, ``\n``, ``\u202e``, ``\udcff``; all that can be seen stays as it is.

    Args:
        text: Anything; turned into text first.
        keep: Characters that stay although they cannot be seen, for example line breaks of our own messages.

    >>> clean("cup\x1b[31m")
    'cup\\x1b[31m'
    """
    text = str(text)
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        character
        if character in keep or unicodedata.category(character) not in _UNSEEN
        else character.encode("unicode_escape").decode("ascii")
        for character in text
    )


def quoted(text: object, *, longest: int = LONGEST_QUOTE) -> str:
    """Return a text cleaned and cut to a length that a message can hold, with the number of characters left out.

    >>> quoted("x" * 300, longest=4)
    'xxxx … (296 more characters)'
    """
    text = str(text)
    if len(text) <= longest:
        return clean(text)
    return f"{clean(text[:longest])} … ({len(text) - longest} more characters)"
