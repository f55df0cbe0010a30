"""Of a long CSV file only the rows around wanted times: found by searching, parsed together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa
import pyarrow.csv

from prbench.readers.aria_mps.blocks import BLOCK, TextStart, line_blocks, read_start
from prbench.readers.aria_mps.line_search import Lines, NotSearchable, TimedLines
from prbench.readers.aria_mps.wanted import Wanted
from prbench.readers.files import Column, arrow_types, missing_file, require_column_names, require_integers
from prbench.readers.last_line import require_whole_last_line
from prbench.readers.zipped import RememberingTail, Source, shown


def search_rows(
    source: Source, columns: Mapping[str, Column], time_column: str, wanted: Wanted, *, block: int = BLOCK
) -> pa.Table:
    """The rows around wanted times, equal to those of a whole read to the last bit.

    What lies between these rows is never looked at: neither a repeated row nor a damaged number there is noticed. In
    an archive every byte is unpacked, and its checksum compared.

    Args:
        source: CSV, plain or in an archive.
        columns: Name and type of each column to parse.
        time_column: The one of them that increases; integers.
        wanted: Which rows.
        block: Bytes of text in memory at once, about.

    Raises:
        NotSearchable: if the text is unusual or its times do not increase, as far as they were looked at.
        pa.ArrowInvalid: if a found row does not parse.
        InputFileError: if the file or a column is missing, the last line is cut, or an archive is damaged.
    """
    try:
        start = read_start(source)
    except FileNotFoundError as error:
        raise missing_file(source) from error
    except UnicodeDecodeError as error:
        raise NotSearchable("no text") from error
    require_column_names(source, start.names, columns)
    text = _found_text(source, start, start.names.index(time_column), wanted, block)
    require_whole_last_line(shown(source), columns, start.names, tail=text[-RememberingTail.LENGTH :])
    table = pyarrow.csv.read_csv(
        pa.BufferReader(start.header + text),
        read_options=pyarrow.csv.ReadOptions(use_threads=False),  # workers share the cores among them
        convert_options=pyarrow.csv.ConvertOptions(column_types=arrow_types(columns), include_columns=list(columns)),
    )
    require_integers(source, table, columns)
    return table


def _found_text(source: Source, start: TextStart, column: int, wanted: Wanted, block: int) -> bytes:
    """The lines around the wanted times, one after the other, with their line breaks."""
    first_us = after_us = None
    pieces, last_line, last_is_taken = [], b"", False
    for text in line_blocks(source, len(start.header), block):
        lines = TimedLines(text, column, _time_ends(start.first_line, column))
        begin_us, end_us = lines.times(np.array([text.begin, lines.last])).tolist()
        first_us = begin_us if first_us is None else first_us
        pairs = lines.around(wanted.between(first_us, after_us, end_us))
        if last_is_taken:  # it is the first one here
            pairs = Lines(np.where(pairs.first == text.begin, pairs.second, pairs.first), pairs.second)
        pieces.append(lines.copied(pairs))
        last_is_taken = bool((pairs.second == lines.last).any()) or (last_is_taken and lines.last == text.begin)
        only_last = np.array([lines.last])
        after_us, last_line = end_us, lines.copied(Lines(only_last, only_last))
    if after_us is not None and not last_is_taken and wanted.beyond(after_us):
        pieces.append(last_line)
    return b"".join(pieces)


def _time_ends(first_line: bytes, column: int) -> int:
    """Bytes of a line in which its time column ends, with room for longer cells."""
    return sum(len(cell) + 1 for cell in first_line.split(b",")[: column + 1]) + 24
