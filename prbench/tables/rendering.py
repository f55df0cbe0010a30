"""Tables as CSV, LaTeX (booktabs), Markdown and JSON.

Words in tables are other people's: each renderer escapes them for its format (``prbench.shown``). Numbers are ours.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from prbench.errors import UsageError
from prbench.files.storage import sole_writer, write_text
from prbench.shown import csv_text, latex, markdown
from prbench.tables.records import DASH, Block, Cell, Column, Row, Table

_FOR_PRINT = {"rank", "best", "mark"}
_CSV_COLUMNS = ("table", *(name for name in Cell.__struct_fields__ if name not in _FOR_PRINT))
_PACKAGES = "% Needs \\usepackage{booktabs}, \\usepackage[T1]{fontenc} and \\usepackage[utf8]{inputenc}.\n"


class FlatTable(msgspec.Struct, frozen=True, kw_only=True):
    """A table, or one part of it, in JSON.

    Attributes:
        number: Number in the study, such as ``S3``.
        title: What it shows.
        part: Dataset of a part; empty for a table of one part.
        stamp: A warning that belongs to all its numbers, such as that a smoke configuration made them; empty if there
            is none.
        notes: What a reader of the table needs to know.
        values: Its numbers, one a cell.
    """

    number: str
    title: str
    part: str
    stamp: str
    notes: tuple[str, ...]
    values: list[Cell]

    @classmethod
    def of(cls, table: Table) -> FlatTable:
        """Return a table's numbers one below the other."""
        same = {name: getattr(table, name) for name in ("number", "title", "part", "stamp", "notes")}
        return cls(**same, values=table.cells)


def cell_text(
    cell: Cell,
    column: Column,
    *,
    signed: bool = False,
    between: str = " ",
    bold: Callable[[str], str] = str,
    escape: Callable[[str], str] = str,
) -> str:
    """Return a number as printed, with its interval or ± and its mark.

    Args:
        cell: The number; a dash if it has no value.
        column: Says how many digits are printed.
        signed: Print the sign of positive numbers, too.
        between: Stands between the number and its interval.
        bold: Marks a number that leads its block.
        escape: Makes signs fit for the format.
    """
    if cell.value is None:
        return escape(DASH)
    form = f"{'+' if signed else ''}.{column.digits}f"
    text = f"{cell.value:{form}}"
    if cell.best:
        text = bold(text)
    if cell.low is not None and cell.high is not None:
        text += f"{between}[{cell.low:{form}}, {cell.high:{form}}]"
    elif cell.sd is not None:
        text += f" {escape('±')} {cell.sd:{form}}"
    return f"{text} {escape(cell.mark)}".rstrip()


def grid(
    table: Table, block: Block, *, escape: Callable[[str], str], bold: Callable[[str], str], between: str = " "
) -> list[list[str]]:
    """Return the printed cells of a block.

    Args:
        table: Has the columns.
        block: Has the rows.
        escape: Makes words fit for the format.
        bold: Marks a number that leads its block.
        between: Stands between a number and its interval.
    """

    def shown(row: Row, cells: Mapping[str, Cell], column: Column) -> str:
        if column.key in row.text:
            return escape(row.text[column.key])
        if column.key in cells:
            cell = cells[column.key]
            return cell_text(cell, column, signed=block.signed, between=between, bold=bold, escape=escape)
        if column.missing is None:
            return "" if column.text else escape(DASH)
        return escape(column.missing)

    rows = []
    for row in block.rows:
        cells = {cell.metric: cell for cell in row.cells}
        rows.append([shown(row, cells, column) for column in table.columns])
    return rows


def as_markdown(tables: Sequence[Table]) -> str:
    """Return a section a table, a grid a block, and notes below."""
    parts = []
    for table in tables:
        parts.append(f"## {markdown(table.heading)}")
        for block in table.blocks:
            if block.title:
                parts.append(f"**{markdown(block.title)}**")
            parts.append(markdown_grid(table, block))
        if table.notes:
            parts.append("\n".join(f"- {markdown(note)}" for note in table.notes))
    return "\n\n".join(parts) + "\n"


def markdown_grid(table: Table, block: Block) -> str:
    """Return one block with its header, without a line break at the end."""
    rule = ["---" if column.text else "---:" for column in table.columns]
    header = [markdown(column.heading) for column in table.columns]
    rows = grid(table, block, escape=markdown, bold=lambda number: f"**{number}**")
    return "\n".join("| " + " | ".join(line) + " |" for line in (header, rule, *rows))


def as_latex(tables: Sequence[Table]) -> str:
    """Return one ``table`` environment each, with rules of the package booktabs."""
    return _PACKAGES + "\n".join(map(_latex_table, tables))


def _latex_table(table: Table) -> str:
    part = f": {table.part}" if table.part else ""
    stamp = f" [{table.stamp}]" if table.stamp else ""
    label = "-".join(re.findall(r"[a-z0-9]+", f"table {table.number} {table.dataset}".lower()))
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex(table.title + part + stamp)}}}",
        rf"\label{{tab:{label}}}",
        r"\small",
        rf"\begin{{tabular}}{{{''.join('l' if column.text else 'r' for column in table.columns)}}}",
        r"\toprule",
        " & ".join(latex(column.heading) for column in table.columns) + r" \\",
    ]
    for block in table.blocks:
        lines.append(r"\midrule")
        if block.title:
            lines.append(rf"\multicolumn{{{len(table.columns)}}}{{l}}{{\textit{{{latex(block.title)}}}}} \\")
        for row in grid(table, block, escape=latex, bold=lambda number: rf"\textbf{{{number}}}"):
            # A bracket or a star at the beginning of a row would be read as an argument of the line break before it.
            guard = "{}" if row[0].startswith(("[", "*")) else ""
            lines.append(guard + " & ".join(row) + r" \\")
    lines += [r"\bottomrule", r"\end{tabular}"]
    lines += [rf"\par\footnotesize {latex(note)}" for note in table.notes]
    lines.append(r"\end{table}")
    return "\n".join(lines) + "\n"


def as_csv(tables: Sequence[Table]) -> str:
    """Return all numbers, one a row. UTF-8, LF; an empty value where a dash is printed."""
    rows = ({"table": table.number, **msgspec.structs.asdict(cell)} for table in tables for cell in table.cells)
    return csv_lines(_CSV_COLUMNS, rows)


def csv_lines(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows as CSV with a header, each value by its type: names cannot be formulas, numbers have no exponent.

    Args:
        columns: Header, and keys of the values that are written; a key that a row lacks is written as empty.
        rows: Values: words, numbers, truth, or None for an empty cell.
    """

    def shown(value: Any) -> str:
        if value is None:
            return ""
        if isinstance(value, bool):
            return str(value).lower()
        if isinstance(value, float):
            # Six decimals at most; what rounds to nothing has no sign.
            text = f"{value:.6f}".rstrip("0").rstrip(".")
            return "0" if text == "-0" else text
        return csv_text(value) if isinstance(value, str) else str(value)

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([shown(row.get(name)) for name in columns] for row in rows)
    return text.getvalue()


def as_json(tables: Sequence[Table]) -> str:
    """Return the tables with their numbers one below the other, indented by two spaces."""
    text = msgspec.json.encode([FlatTable.of(table) for table in tables])
    return msgspec.json.format(text, indent=2).decode() + "\n"


FORMATS: dict[str, Callable[[Sequence[Table]], str]] = {
    ".csv": as_csv,
    ".tex": as_latex,
    ".md": as_markdown,
    ".json": as_json,
}


def require_format(path: Path) -> None:
    """Refuse a kind of file that tables are not written as, before anything is computed.

    Raises:
        UsageError: for any but CSV, LaTeX, Markdown and JSON.
    """
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"{path}: a table is written as {', '.join(FORMATS)}, not as '{path.suffix}'.")


def write_tables(tables: Sequence[Table], path: Path) -> None:
    """Write tables in the format of the file's suffix, whole or not at all.

    Raises:
        UsageError: for an unknown suffix.
        StorageError: if the file cannot be written.
    """
    require_format(path)
    with sole_writer(path):
        write_text(path, FORMATS[path.suffix.lower()](tables))
