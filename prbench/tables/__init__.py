"""The one engine that lays out and renders tables: Markdown, CSV, LaTeX, JSON; the terminal's is in ``prbench.cli``.

A table is rows × columns. Columns, title and notes are data, declared in TOML beside the benchmark or made from
metrics; code fills in rows. A row has words for its text columns and cells, which carry the numbers.
"""

from prbench.tables.records import DASH, Block, Cell, Column, Row, Table, metric_cell, metric_column, note_of
from prbench.tables.rendering import (
    FORMATS,
    FlatTable,
    as_csv,
    as_json,
    as_latex,
    as_markdown,
    cell_text,
    csv_lines,
    grid,
    markdown_grid,
    require_format,
    write_tables,
)

__all__ = [
    "DASH",
    "FORMATS",
    "Block",
    "Cell",
    "Column",
    "FlatTable",
    "Row",
    "Table",
    "as_csv",
    "as_json",
    "as_latex",
    "as_markdown",
    "cell_text",
    "csv_lines",
    "grid",
    "markdown_grid",
    "metric_cell",
    "metric_column",
    "note_of",
    "require_format",
    "write_tables",
]
