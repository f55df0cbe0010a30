"""The one engine that lays out and renders tables: Markdown, CSV, LaTeX, JSON; the terminal's is in ``prbench.cli``.

A table is rows × columns. Columns, title and notes are data; code fills in rows. A row has words for its text columns
and cells, which carry the numbers. Words in tables are other people's: each renderer escapes them for its format
(``prbench.shown``). Numbers are ours.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from prbench.errors import UsageError
from prbench.files.storage import sole_writer, write_text
from prbench.metrics.registry import MetricInfo, exported_unit, printed_scale, printed_unit
from prbench.shown import csv_text, html, latex, markdown

DASH = "–"
Markup = Callable[[str], str]  # of a format
_ARROWS = {"": "", "higher": " ↑", "lower": " ↓"}


class Column(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One column and the format of its numbers.

    Attributes:
        key: Metric of the cells that stand in it, or key of the rows' words.
        title: Title as printed.
        better: Direction of the better values: an arrow behind the title.
        unit: Unit in parentheses behind the title; empty for none.
        text: Holds words: set to the left.
        digits: Digits behind the point.
        missing: Stands where a row has neither words nor a cell: by default a dash, nothing in a column of words.
    """

    key: str
    title: str
    better: Literal["", "higher", "lower"] = ""
    unit: str = ""
    text: bool = False
    digits: int = 2
    missing: str | None = None

    @property
    def heading(self) -> str:
        """Title, arrow and unit."""
        return f"{self.title}{_ARROWS[self.better]}{f' ({self.unit})' if self.unit else ''}"


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """One number of a table in its printed unit, with all that its CSV row says of it.

    Attributes:
        dataset: Name of the dataset.
        metric: Id of the metric or quantity, which is the key of its column. Cells without a column stand in CSV and
            JSON alone.
        value: Rates in %, lengths in metres, times in seconds; null where a dash is printed.
        unit: ``%``, ``m``, ``s``, ``ratio``, or empty.
        condition: What the method was given.
        method: Name of the method.
        variant: What tells two rows of one method apart.
        low: Lower bound of the 95 % interval; null without one.
        high: Upper bound of the interval.
        sd: Standard deviation over sequences, or the number after ± in the study.
        sequences: float | None of sequences behind the value.
        recordings: float | None of recordings that they come from.
        detectable: Smallest difference to an unrelated method of the same spread that would be found with 80 % power;
            null where nothing can be tested.
        rank: One more than the number of methods that are better by a supported difference; null where nothing is
            ranked.
        best: The number is printed bold.
        mark: Sign behind the number, such as ``†``.
        origin: ``measured``, ``measured on synthetic data``, ``published: …`` or ``measured - published: …``.
        note: What a reader of the number needs to know.
    """

    dataset: str = ""
    metric: str
    value: float | None
    unit: str = ""
    condition: str = ""
    method: str = ""
    variant: str = ""
    low: float | None = None
    high: float | None = None
    sd: float | None = None
    sequences: int | None = None
    recordings: int | None = None
    detectable: float | None = None
    rank: int | None = None
    best: bool = False
    mark: str = ""
    origin: str = "measured"
    note: str = ""


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One row: words by the key of their column, and cells, each in the column of its metric.

    Attributes:
        text: Words as printed. Where a column of numbers has words too, these are printed in place of the cell's
            number.
        cells: Its numbers; those without a column stand in CSV and JSON alone.
    """

    text: Mapping[str, str]
    cells: tuple[Cell, ...] = ()


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rows of one origin: measured and published ones never stand in the same block.

    Attributes:
        title: Says where the numbers come from; empty in a table of one block.
        rows: Rows in printed order.
        signed: The numbers are differences: their signs are printed.
    """

    title: str = ""
    rows: tuple[Row, ...]
    signed: bool = False


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table, or what a figure draws; blocks without rows are left out.

    Attributes:
        number: float | None in the study, such as ``2`` or ``S3``; empty for a table that no study has.
        title: What it shows.
        columns: Printed columns.
        blocks: Rows, by where they come from.
        dataset: Dataset of one part of a table that has several.
        part: The part in words: dataset, and how much data stand behind it.
        stamp: A warning that has to stand with the numbers, such as that they come from a smoke configuration.
        notes: What a reader of the table needs to know.
    """

    number: str = ""
    title: str = ""
    columns: tuple[Column, ...] = ()
    blocks: tuple[Block, ...] = ()
    dataset: str = ""
    part: str = ""
    stamp: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        msgspec.structs.force_setattr(self, "blocks", tuple(block for block in self.blocks if block.rows))

    @property
    def heading(self) -> str:
        """Number, title and part in one line."""
        number = f"Table {self.number}, " if self.number else ""
        part = f": {self.part}" if self.part else ""
        stamp = f" [{self.stamp}]" if self.stamp else ""
        return f"{number}{self.title}{part}{stamp}"

    @property
    def cells(self) -> list[Cell]:
        """All cells, with the table's warning in their notes."""
        cells = [cell for block in self.blocks for row in block.rows for cell in row.cells]
        if not self.stamp:
            return cells
        return [msgspec.structs.replace(cell, note=note_of(self.stamp, cell.note)) for cell in cells]


def note_of(*parts: str) -> str:
    """Join the parts of a note that are not empty."""
    return "; ".join(part for part in parts if part)


def metric_column(info: MetricInfo, *, in_study: bool = False, with_unit: bool = True, **more: Any) -> Column:
    """Return the column of a metric.

    Args:
        info: The metric.
        in_study: Use its title in the study's tables.
        with_unit: Name the printed unit.
        more: Other fields of the column.
    """
    title = (info.title_in_study or info.title) if in_study else info.title
    better: Literal["", "higher", "lower"] = ""
    if info.higher_is_better is not None:
        better = "higher" if info.higher_is_better else "lower"
    unit = printed_unit(info.unit).strip() if with_unit else ""
    return Column(key=info.id, title=title, better=better, unit=unit, **more)


def metric_cell(
    metric: str,
    unit: str,
    mean: float | None,
    low: float | None = None,
    high: float | None = None,
    *,
    detectable: float | None = None,
    **about: Any,
) -> Cell:
    """Return the cell of a metric from values as stored, which are rates from 0 to 1, metres and the like.

    Args:
        metric: Id of the metric.
        unit: Unit of the stored values.
        mean: None for a dash, which has neither bounds nor a detectable difference.
        low: Lower bound of the interval.
        high: Upper bound of the interval.
        detectable: Smallest difference that would be found.
        about: Other fields of the cell.
    """
    scale = printed_scale(unit)
    stored = {"value": mean, "low": low, "high": high, "detectable": detectable}
    shown = {name: None if value is None or mean is None else scale * value for name, value in stored.items()}
    return Cell(metric=metric, unit=exported_unit(unit), **shown, **about)


_CSV_COLUMNS = ("table", *(name for name in Cell.__struct_fields__ if name not in ("rank", "best", "mark")))
_PACKAGES = "% Needs \\usepackage{booktabs}, \\usepackage[T1]{fontenc} and \\usepackage[utf8]{inputenc}.\n"


def cell_text(
    cell: Cell, column: Column, *, signed: bool = False, between: str = " ", bold: Markup = str, escape: Markup = str
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


def grid(table: Table, block: Block, *, escape: Markup, bold: Markup, between: str = " ") -> list[list[str]]:
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
        rule = ["---" if column.text else "---:" for column in table.columns]
        header = [markdown(column.heading) for column in table.columns]
        for block in table.blocks:
            if block.title:
                parts.append(f"**{markdown(block.title)}**")
            rows = grid(table, block, escape=markdown, bold=lambda number: f"**{number}**")
            parts.append("\n".join("| " + " | ".join(line) + " |" for line in (header, rule, *rows)))
        if table.notes:
            parts.append("\n".join(f"- {markdown(note)}" for note in table.notes))
    return "\n\n".join(parts) + "\n"


def as_latex(tables: Sequence[Table]) -> str:
    """Return one ``table`` environment each, with rules of the package booktabs."""
    texts = []
    for table in tables:
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
                # A bracket or a star at the beginning of a row would be read as an argument of the line break before.
                guard = "{}" if row[0].startswith(("[", "*")) else ""
                lines.append(guard + " & ".join(row) + r" \\")
        lines += [r"\bottomrule", r"\end{tabular}"]
        lines += [rf"\par\footnotesize {latex(note)}" for note in table.notes]
        texts.append("\n".join([*lines, r"\end{table}"]) + "\n")
    return _PACKAGES + "\n".join(texts)


def as_html(tables: Sequence[Table]) -> str:
    """Return a section a table, for pages whose scripts sort and draw it.

    Columns name their key, unit and direction, cells their value, bounds and rank as ``data-`` attributes, and a row
    its words that stand in no column.
    """
    parts = []
    for table in tables:
        title = html(table.heading)
        heads = []
        for column in table.columns:
            told = {"key": column.key, "unit": column.unit, "better": column.better, "text": str(column.text).lower()}
            heads.append(f'<th scope="col"{_data(told)}>{html(column.heading)}</th>')
        keys = {column.key for column in table.columns}
        for block in table.blocks:
            lines = []
            printed = grid(table, block, escape=html, bold=lambda number: f"<strong>{number}</strong>")
            for row, texts in zip(block.rows, printed, strict=True):
                found = {cell.metric: cell for cell in row.cells}
                cells = []
                for column, text in zip(table.columns, texts, strict=True):
                    cell = found.get(column.key)
                    told = {} if cell is None else {key: getattr(cell, key) for key in ("value", "low", "high", "rank")}
                    cells.append(f"<td{_data(told)}>{text}</td>")
                beside = {key: text for key, text in row.text.items() if key not in keys}
                lines.append(f"<tr{_data(beside)}>{''.join(cells)}</tr>")
            # The box can be scrolled by the keyboard, too, so it needs a name.
            parts.append(
                f'<section class="table"{_data({"dataset": table.dataset})}>\n<h2>{title}</h2>\n<div class="scroll"'
                f' tabindex="0" role="region" aria-label="{title}"><table>\n<caption>{title}</caption>\n'
                f"<thead><tr>{''.join(heads)}</tr></thead>\n<tbody>\n" + "\n".join(lines) + "\n</tbody></table></div>"
            )
            notes = "".join(f"<li>{html(note)}</li>" for note in table.notes)
            parts.append(f"<details><summary>Notes</summary><ul>{notes}</ul></details>\n</section>")
    return "\n".join(parts)


def _data(values: Mapping[str, object]) -> str:
    """Return attributes of an element; what is not known has none."""
    texts = {
        key: f"{value:.9g}" if isinstance(value, float) else str(value)
        for key, value in values.items()
        if value is not None
    }
    return "".join(f' data-{key}="{html(text)}"' for key, text in texts.items())


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
    """Return the tables as they are, indented by two spaces."""
    return msgspec.json.format(msgspec.json.encode(tables), indent=2).decode() + "\n"


_Renderer = Callable[[Sequence[Table]], str]
FORMATS: dict[str, _Renderer] = {".csv": as_csv, ".tex": as_latex, ".md": as_markdown, ".json": as_json}


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
