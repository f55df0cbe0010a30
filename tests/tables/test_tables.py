"""Tables as CSV, LaTeX and Markdown: what is in them, and what names of other people cannot do there."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import subprocess

import pytest

from prbench.errors import UsageError
from prbench.metrics import METRICS
from prbench.shown import latex
from prbench.tables import (
    Block,
    Cell,
    Column,
    Row,
    Table,
    as_csv,
    as_json,
    as_latex,
    as_markdown,
    cell_text,
    csv_lines,
    metric_cell,
    metric_column,
    write_tables,
)

HOSTILE = r"""=x|\input{/etc/passwd}%&_#$^~<b>[a](b)\\*{} "q" 中 é"""


COLUMNS = (
    Column(key="method", title="Method", text=True),
    Column(key="prime_success", title="Prime Success", better="higher"),
)


def table_of(name: str = "P&R", *, best: bool = False, **more) -> Table:
    settings = {"number": "2", "title": "Methods", "dataset": "adt", "part": "adt, 85 sequences", **more}
    whole = Cell(
        dataset="adt", method=name, metric="prime_success", value=40.0, low=30.0, high=50.0, unit="%", best=best
    )
    beside = Cell(dataset="adt", method=name, metric="foot_skating", value=None, unit="ratio", origin="published")
    return Table(
        columns=COLUMNS,
        blocks=(
            Block(
                title="Measured",
                rows=(Row(text={"method": name}, cells=(whole, beside)), Row(text={"method": "* [x"})),
            ),
            Block(title="Published: Table 2", rows=(Row(text={"method": name, "prime_success": "52.08"}),)),
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
    with pytest.raises(UsageError, match=r"written as \.csv, \.tex, \.md, \.json, not as '\.xlsx'"):
        write_tables([table_of()], tmp_path / "t.xlsx")
    write_tables([table_of()], tmp_path / "t.TEX")
    assert (tmp_path / "t.TEX").read_text().startswith("% Needs")


def test_a_number_is_written_with_its_interval_or_spread_and_its_mark():
    column = Column(key="x", title="X", digits=3)
    plain = Cell(metric="x", value=-1.0)
    assert cell_text(plain, COLUMNS[1]) == "-1.00"
    assert cell_text(Cell(metric="x", value=None), column) == "–"
    assert cell_text(Cell(metric="x", value=1.0, sd=0.25, mark="†"), column) == "1.000 ± 0.250 †"
    bounded = Cell(metric="x", value=1.0, low=-2.0, high=0.5, best=True)
    assert cell_text(bounded, column, signed=True, between="\n", bold="_{}_".format) == "_+1.000_\n[-2.000, +0.500]"


def test_what_leads_is_bold_in_each_format_and_only_the_number():
    table = table_of(best=True)
    assert "**40.00** [30.00, 50.00]" in as_markdown([table])
    assert r"\textbf{40.00} [30.00, 50.00]" in as_latex([table])


def test_words_stand_in_place_of_numbers_and_dashes_where_nothing_is():
    rows = [line.split(" | ")[-1].rstrip(" |") for line in as_markdown([table_of()]).splitlines() if line[:1] == "|"]
    assert rows == ["Prime Success ↑", "---:", "40.00 [30.00, 50.00]", "–", "Prime Success ↑", "---:", "52.08"]


def test_json_has_the_numbers_of_the_csv():
    [found] = json.loads(as_json([table_of(stamp="SMOKE")]))
    assert (found["number"], found["part"], found["stamp"]) == ("2", "adt, 85 sequences", "SMOKE")
    row = found["blocks"][0]["rows"][0]
    assert [cell["value"] for cell in row["cells"]] == [40.0, None]


def test_csv_writes_each_type_in_its_own_way():
    row = {"a": -1e-9, "b": True, "c": None, "d": "=1", "e": 3, "f": 1e-5, "not asked for": 1}
    assert csv_lines("abcdefg", [row]).splitlines() == ["a,b,c,d,e,f,g", "0,true,,'=1,3,0.00001,"]


def test_the_column_and_the_cell_of_a_metric_have_its_printed_unit():
    prime = next(info for info in METRICS if info.id == "prime_success")
    assert metric_column(prime).heading == "Prime Success ↑ (%)"
    assert metric_column(prime, with_unit=False).heading == "Prime Success ↑"
    cell = metric_cell(prime.id, prime.unit, 0.5, 0.25, 0.75, method="pr")
    assert (cell.value, cell.low, cell.high, cell.unit, cell.method) == (50.0, 25.0, 75.0, "%", "pr")
    hidden = metric_cell(prime.id, prime.unit, None, 0.25, 0.75)
    assert (hidden.value, hidden.low) == (None, None)


def test_blocks_without_rows_are_left_out():
    table = Table(number="S2", title="Sequences", part="adt", blocks=(Block(rows=()), Block(rows=(Row(text={}),))))
    assert len(table.blocks) == 1
    assert table.heading == "Table S2, Sequences: adt"
