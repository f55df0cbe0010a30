"""Tables of the study as CSV, LaTeX (booktabs) and Markdown.

Names in the tables are other people's: every cell is escaped for the format that it is written in (``prbench.shown``).
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields
from pathlib import Path

from prbench.errors import UsageError
from prbench.files.storage import sole_writer, write_text
from prbench.shown import csv_text, latex, markdown
from prbench_benchmarks.prime_and_reach.study.document import StudyTable, StudyValue

_COLUMNS = ("table", *(field.name for field in fields(StudyValue)))
_PACKAGES = "% Needs \\usepackage{booktabs}, \\usepackage[T1]{fontenc} and \\usepackage[utf8]{inputenc}.\n"


def as_csv(tables: Sequence[StudyTable]) -> str:
    """All numbers, one a row. UTF-8, LF; an empty value where a dash is printed."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for table in tables:
        for value in table.values:
            row = asdict(value)
            if table.stamp:
                row["note"] = "; ".join(part for part in (table.stamp, value.note) if part)
            writer.writerow([csv_text(table.number), *(_csv_cell(cell) for cell in row.values())])
    return text.getvalue()


def _csv_cell(cell: str | float | None) -> str:
    if cell is None:
        return ""
    if isinstance(cell, float):
        shown = f"{cell:.6f}".rstrip("0").rstrip(".")
        return "0" if shown == "-0" else shown
    return csv_text(cell) if isinstance(cell, str) else str(cell)


def as_latex(tables: Sequence[StudyTable]) -> str:
    """One ``table`` environment each; rules of the package booktabs."""
    return _PACKAGES + "\n".join(_latex_table(table) for table in tables)


def _latex_table(table: StudyTable) -> str:
    columns = "l" * table.text_columns + "r" * (len(table.header) - table.text_columns)
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex(table.title)}{latex(f': {table.part}') if table.part else ''}"
        rf"{latex(f' [{table.stamp}]') if table.stamp else ''}}}",
        rf"\label{{tab:{_label(table)}}}",
        r"\small",
        rf"\begin{{tabular}}{{{columns}}}",
        r"\toprule",
        _latex_row(table.header),
    ]
    for block in table.blocks:
        lines.append(r"\midrule")
        if block.title:
            lines.append(rf"\multicolumn{{{len(table.header)}}}{{l}}{{\textit{{{latex(block.title)}}}}} \\")
        lines += [_latex_row(row) for row in block.rows]
    lines += [r"\bottomrule", r"\end{tabular}"]
    lines += [rf"\par\footnotesize {latex(note)}" for note in table.notes]
    lines.append(r"\end{table}")
    return "\n".join(lines) + "\n"


def _latex_row(cells: Sequence[str]) -> str:
    # A bracket or a star at the beginning of a row would be read as an argument of the line break before it.
    return " & ".join(f"{{}}{latex(cell)}" if cell.startswith(("[", "*")) else latex(cell) for cell in cells) + r" \\"


def _label(table: StudyTable) -> str:
    return "-".join(re.findall(r"[a-z0-9]+", f"table {table.number} {table.dataset}".lower()))


def as_markdown(tables: Sequence[StudyTable]) -> str:
    """A section each, a grid for each block, notes below."""
    parts = []
    for table in tables:
        parts.append(f"## {markdown(table.heading)}")
        for block in table.blocks:
            if block.title:
                parts.append(f"**{markdown(block.title)}**")
            rule = ["---"] * table.text_columns + ["---:"] * (len(table.header) - table.text_columns)
            lines = [[markdown(cell) for cell in table.header], rule]
            lines += [[markdown(cell) for cell in row] for row in block.rows]
            parts.append("\n".join("| " + " | ".join(line) + " |" for line in lines))
        if table.notes:
            parts.append("\n".join(f"- {markdown(note)}" for note in table.notes))
    return "\n\n".join(parts) + "\n"


FORMATS: dict[str, Callable[[Sequence[StudyTable]], str]] = {".csv": as_csv, ".tex": as_latex, ".md": as_markdown}


def require_format(path: Path) -> None:
    """Refuse a kind of file that tables are not written as, before anything is computed.

    Raises:
        UsageError: for any but CSV, LaTeX and Markdown.
    """
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"{path}: a table is written as {', '.join(FORMATS)}, not as '{path.suffix}'.")


def write_tables(tables: Sequence[StudyTable], path: Path) -> None:
    """Write tables in the format of the file's suffix, whole or not at all.

    Raises:
        UsageError: for an unknown suffix.
        StorageError: if the file cannot be written.
    """
    require_format(path)
    with sole_writer(path):
        write_text(path, FORMATS[path.suffix.lower()](tables))
