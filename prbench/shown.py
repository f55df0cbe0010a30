"""Text that comes from files and other people, made fit to be shown: one function for each place where it appears.

Names of objects, datasets, recordings and methods are anybody's text. JSON needs no function here, as it spells out
what it must; commands need none for the terminal, as everything they print goes through ``prbench.cli.terminal``.
"""

from __future__ import annotations

import re
import unicodedata
from html import escape
from itertools import groupby

# Characters that a message quotes of something that was found in a file.
LONGEST_QUOTE = 200

# Times that a message says the same word in a row before it counts them.
_MOST_IN_A_ROW = 4
# Characters of a word that stays whole; paths are as long.
_LONGEST_WORD = 1000

# Unicode categories that are not drawn but steer: control and format characters, lone surrogates, line separators.
_UNSEEN = {"Cc", "Cf", "Co", "Cs", "Zl", "Zp"}


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


def listed(names: list[str]) -> str:
    """Return how many names there are, and the first three.

    >>> listed(["a", "b", "c", "d"])
    '4 (a, b, c, …)'
    """
    if not names:
        return "0"
    return f"{len(names)} ({', '.join(map(quoted, names[:3]))}{', …' if len(names) > 3 else ''})"


def condensed(text: str) -> str:
    """Return a message in which a word repeated in a row stands once with its count, and no word is endless.

    >>> condensed("found " + "a, " * 999 + "a.")
    'found a, (1000 times)'
    """
    shown: list[str] = []
    for word, group in groupby(text.split(" "), key=lambda each: each.rstrip(",.")):
        words = list(group)
        if word and len(words) > _MOST_IN_A_ROW:
            words = [words[0], f"({len(words)} times)"]
        shown += [quoted(each) if len(each) > _LONGEST_WORD else each for each in words]
    return " ".join(shown)


def markdown(text: object) -> str:
    r"""Return a text as Markdown that shows it and does nothing else: no link, image, markup, formula or table cell.

    >>> markdown("[a](javascript:b) <img> x_y")
    '\\[a\\](javascript:b) &lt;img&gt; x_y'
    """
    shown = _ENTITY.sub("&amp;", clean(text)).replace("<", "&lt;").replace(">", "&gt;")
    shown = _MARKDOWN_MARKS.sub(r"\\\g<0>", shown)
    return _BARE_LINK.sub(lambda link: f"{link[1] or ''}\\{link[0][-1]}", shown)


_MARKDOWN_MARKS = re.compile(r"[\\`*\[\]|~$]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])")
# An ampersand that Markdown takes for the beginning of a character's name; any other shows itself.
_ENTITY = re.compile(r"&(?=#?[A-Za-z0-9]+;)")
# Addresses that GitHub makes links of although nothing marks them.
_BARE_LINK = re.compile(r"(?i)\b(https?|ftp|mailto|xmpp|www)[:.]")


def csv_text(text: object) -> str:
    r"""Return a text for a cell of a CSV file that no spreadsheet takes for a formula.

    An apostrophe stands before what would be one; Excel and LibreOffice show the text behind it.

    >>> csv_text('=cmd|"/c calc"!A0')
    '\'=cmd|"/c calc"!A0'
    """
    shown = clean(text)
    is_formula = shown.lstrip().startswith(_FORMULA_STARTS) and not _NUMBER.fullmatch(shown)
    return f"'{shown}" if is_formula else shown


# The last four are the full-width forms, which Excel takes alike.
_FORMULA_STARTS = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_NUMBER = re.compile(r"[+-]?\d+(\.\d+)?([eE][+-]?\d+)?")


def latex(text: object) -> str:
    r"""Return a text that LaTeX sets letter by letter: no command, formula, comment or table cell.

    A letter beyond those of Western Europe is spelt out as its number, because the usual fonts lack it.

    >>> latex("50% of {a_b} & \\input{x}")
    '50\\% of \\{a\\_b\\} \\& \\textbackslash{}input\\{x\\}'
    """
    shown = []
    for character in clean(text):
        # Latin-1 letters are in every font that `inputenc` and `fontenc` choose; no others are certain.
        certain = character.isascii() or (character.isalpha() and ord(character) < 256)
        shown.append(_LATEX.get(character, character if certain else f"[U+{ord(character):04X}]"))
    return "".join(shown)


# What LaTeX would take for markup, and the signs that tables of prbench use.
_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "%": r"\%", "#": r"\#",
    "_": r"\_", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"$<$", ">": r"$>$", "|": r"$|$",
    '"': r"\textquotedbl{}", "±": r"$\pm$", "×": r"$\times$", "✗": r"$\times$", "−": r"$-$", "–": "--",
    "↑": r"$\uparrow$", "↓": r"$\downarrow$", "†": r"\dag{}", "‡": r"\ddag{}", "§": r"\S{}", "¶": r"\P{}",
    "◊": r"$\diamond$", "∥": r"$\parallel$", "δ": r"$\delta$", "σ": r"$\sigma$", "…": r"\ldots{}",
    "≥": r"$\geq$", "≤": r"$\leq$",
}  # fmt: skip


def html(text: object) -> str:
    """Return a text for the body or an attribute of an HTML page."""
    return escape(clean(text))


def figure_text(text: object) -> str:
    r"""Return a text that matplotlib draws letter by letter: a name between dollars is no formula.

    Line breaks stay, as titles of ours have some.

    >>> figure_text("$\\frac$")
    '\\$\\frac\\$'
    """
    return clean(text, keep="\n").replace("$", r"\$")
