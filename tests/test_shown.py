"""Text from files cannot steer a terminal and cannot flood a message."""

from __future__ import annotations

import pytest
from matplotlib import cbook
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from prbench.errors import InputFileError
from prbench.shown import LONGEST_QUOTE, clean, csv_text, figure_text, html, markdown, quoted


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


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("hd_epic and DNO", "hd_epic and DNO"),
        ("MDM *", r"MDM \*"),
        ("<img src=x onerror=alert(1)>", "&lt;img src=x onerror=alert(1)&gt;"),
        ("[click](javascript:alert(1))", r"\[click\](javascript:alert(1))"),
        ("![](http://a.b)", r"!\[\](http\://a.b)"),
        ("www.evil.org", r"www\.evil.org"),
        ("a|b\n| c |", r"a\|b\\n\| c \|"),
        ("`rm`", r"\`rm\`"),
        ("&#106;avascript", "&amp;#106;avascript"),
        ("&lt;cup", "&amp;lt;cup"),
        ("salt & pepper", "salt & pepper"),
        ("_bold_ $x$ ~~y~~", r"\_bold\_ \$x\$ \~\~y\~\~"),
    ],
)
def test_markdown_shows_names_and_does_nothing_else(text, shown):
    assert markdown(text) == shown


@pytest.mark.parametrize("text", ['=cmd|"/c calc"!A0', "+1+1", "-1+1", "@SUM(A1)", "\t=1", " =1", "\uff1dcmd"])
def test_no_cell_of_a_csv_file_is_a_formula(text):
    assert csv_text(text).startswith(("'", "\\t"))


@pytest.mark.parametrize("text", ["-0.25", "+3", "1e-5", "pr", "a=b", "", "goal-loc"])
def test_other_cells_stay_as_they_are(text):
    assert csv_text(text) == text


def test_pages_hold_text_only():
    assert html("<b>\x1b'\"") == "&lt;b&gt;\\x1b&#x27;&quot;"


def test_a_figure_draws_dollars_and_no_formulas(tmp_path):
    figure = Figure()
    name = "cup $\\frac$ \\$5\x1b $x^2$"
    drawn = figure.text(0, 0, figure_text(name))
    FigureCanvasAgg(figure).print_png(tmp_path / "drawn.png")
    assert not cbook.is_math_text(drawn.get_text())
    figure.text(0, 0, name)
    with pytest.raises(ValueError, match="frac"):  # what matplotlib does to the bare name
        FigureCanvasAgg(figure).print_png(tmp_path / "bare.png")
