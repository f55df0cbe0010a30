"""Tables as CSV, LaTeX and Markdown: what is in them, and what names of other people cannot do there."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess

import pytest

from prbench.errors import UsageError
from prbench.shown import latex
from prbench_benchmarks.prime_and_reach.study.document import StudyBlock, StudyTable, StudyValue, interval_text
from prbench_benchmarks.prime_and_reach.study.formats import as_csv, as_latex, as_markdown, write_tables

HOSTILE = r"""=x|\input{/etc/passwd}%&_#$^~<b>[a](b)\\*{} "q" 中 é"""


def table_of(name: str = "P&R", **more) -> StudyTable:
    settings = {"number": "2", "title": "Methods", "dataset": "adt", "part": "adt, 85 sequences", **more}
    return StudyTable(
        header=("Method", "Prime Success ↑"),
        blocks=(
            StudyBlock("Measured", ((name, "40.00 [30.00, 50.00]"), ("* [x", "–"))),
            StudyBlock("Published: Table 2", ((name, "52.08"),)),
        ),
        values=(
            StudyValue(dataset="adt", method=name, metric="prime_success", value=40.0, low=30.0, high=50.0, unit="%"),
            StudyValue(dataset="adt", method=name, metric="foot_skating", value=None, unit="ratio", origin="published"),
        ),
        notes=(f"A note of {name}: 95 % ± 1 of δ.",),
        **settings,
    )


def tabular_rows(text: str) -> list[list[str]]:
    """Cells of the rows of a tabular, as LaTeX would split them."""
    body = text.split(r"\toprule")[1].split(r"\bottomrule")[0]
    lines = [line for line in body.splitlines() if line.endswith(r"\\") and not line.startswith(r"\multicolumn")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)&", line.removesuffix(r"\\"))] for line in lines]


def require_balanced(text: str) -> None:
    """Every brace, environment and formula that begins ends."""
    bare = re.sub(r"\\[{}$%&#_]", "", text)
    bare = re.sub(r"(?m)^%.*$", "", bare)
    assert bare.count("{") == bare.count("}")
    assert bare.count("$") % 2 == 0
    assert re.findall(r"\\begin\{(\w+)\}", bare) == list(reversed(re.findall(r"\\end\{(\w+)\}", bare)))
    assert "%" not in bare


def require_whole_latex(text: str) -> None:
    """Every table of a file ends, and each of its rows has as many cells as the table has columns."""
    tables = text.split(r"\begin{table}")[1:]
    assert tables
    for table in tables:
        require_balanced(r"\begin{table}" + table)
        columns = re.search(r"\\begin\{tabular\}\{([lr]+)\}", table)
        assert columns is not None
        rows = tabular_rows(table)
        assert len(rows) > 1
        assert {len(row) for row in rows} == {len(columns[1])}


@pytest.mark.parametrize("name", ["P&R", HOSTILE, "x\x1b[31m\n\\end{tabular}"])
def test_latex_has_the_rows_and_nothing_that_a_name_brings(name):
    text = as_latex([table_of(name)])
    require_balanced(text)
    rows = tabular_rows(text)
    assert [len(row) for row in rows] == [2, 2, 2, 2]
    assert rows[1][0] == latex(name)
    assert rows[3] == [latex(name), "52.08"]
    assert text.count(r"\midrule") == 2
    assert r"\input" not in text
    assert text.count(r"\end{tabular}") == 1
    assert text.isascii() or "é" in text


def test_a_row_does_not_begin_with_what_the_line_break_before_takes():
    rows = tabular_rows(as_latex([table_of()]))
    assert rows[2][0] == "{}* [x"


def test_the_label_is_that_of_table_and_dataset():
    assert r"\label{tab:table-2-adt}" in as_latex([table_of()])


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex")
@pytest.mark.parametrize("name", ["P&R", HOSTILE])
def test_latex_compiles(name, tmp_path):
    packages = "\\usepackage{booktabs}\\usepackage[T1]{fontenc}\\usepackage[utf8]{inputenc}"
    body = as_latex([table_of(name)])
    document = f"\\documentclass{{article}}{packages}\\begin{{document}}\n{body}\\end{{document}}\n"
    (tmp_path / "t.tex").write_text(document, encoding="utf-8")
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "t.tex"], cwd=tmp_path, capture_output=True
    )
    assert done.returncode == 0, done.stdout[-2000:]


def test_csv_has_one_number_a_row_and_no_formula():
    rows = list(csv.DictReader(io.StringIO(as_csv([table_of(HOSTILE)]))))
    assert [row["value"] for row in rows] == ["40", ""]
    assert [row["origin"] for row in rows] == ["measured", "published"]
    assert all(row["method"].startswith("'=") for row in rows)
    assert (rows[0]["low"], rows[0]["high"]) == ("30", "50")


def test_a_stamp_stands_with_every_number():
    table = table_of(stamp="SMOKE")
    assert "[SMOKE]" in as_latex([table]).split(r"\label")[0]
    assert all(row["note"].startswith("SMOKE") for row in csv.DictReader(io.StringIO(as_csv([table]))))
    assert as_markdown([table]).splitlines()[0].endswith("\\[SMOKE\\]")


def test_markdown_shows_names_as_they_are():
    text = as_markdown([table_of("[a](javascript:b)|<img>\x1b")])
    assert "<img>" not in text
    assert "\x1b" not in text
    assert all(len(re.split(r"(?<!\\)\|", line)) == 4 for line in text.splitlines() if line.startswith("|"))


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"written as \.csv, \.tex, \.md, not as '\.xlsx'"):
        write_tables([table_of()], tmp_path / "t.xlsx")
    write_tables([table_of()], tmp_path / "t.TEX")
    assert (tmp_path / "t.TEX").read_text().startswith("% Needs")


def test_intervals_are_written_with_their_mean():
    assert interval_text(1.0, None, None) == "1.00"
    assert interval_text(None, None, None) == "–"
    assert interval_text(-1.0, -2.0, 0.5, sign=True) == "-1.00 [-2.00, +0.50]"
