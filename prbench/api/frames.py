"""Rows as pandas frames, and frames as the tables that a notebook shows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from prbench.sequences.chunk import row_values
from prbench.shown import html

if TYPE_CHECKING:
    import pandas as pd

_SHOWN_ROWS = 20


def frame_of(table: pa.Table) -> pd.DataFrame:
    """Return an Arrow table as a pandas frame.

    A column of vectors holds one read-only array a cell; a missing value is None, NaN or NaT, as pandas has it.

    Args:
        table: Rows with plain values and vectors of a fixed size.
    """
    import pandas as pd

    columns = {}
    for name in table.column_names:
        column = table[name]
        if pa.types.is_fixed_size_list(column.type):
            columns[name] = pd.Series(row_values(column.combine_chunks()), dtype=object)
        else:
            columns[name] = column.to_pandas()
    return pd.DataFrame(columns, columns=pd.Index(table.column_names))


def frozen(array: np.ndarray) -> np.ndarray:
    """Make an array read-only and return it.

    Args:
        array: An array that nobody else holds.
    """
    array.setflags(write=False)
    return array


def frame_from_rows(rows: Iterable[tuple], columns: Iterable[str]) -> pd.DataFrame:
    """Return rows as a pandas frame that has its columns without a row, too.

    Args:
        rows: The values of each row.
        columns: Names of the columns, in their order.
    """
    import pandas as pd

    return pd.DataFrame(list(rows), columns=pd.Index(list(columns)))


def notebook_table(title: str, frame: pd.DataFrame, remarks: Iterable[str] = ()) -> str:
    """Return what a notebook shows of an object: a line, a table and further lines.

    Args:
        title: The line above.
        frame: The table; pandas leaves out its middle where it is long.
        remarks: Lines below.
    """
    below = "".join(f"<p>{html(remark)}</p>" for remark in remarks)
    table = frame.to_html(
        index=False, max_rows=_SHOWN_ROWS, na_rep="", border=0, justify="left", float_format="{:.2f}".format
    )
    return f"<p><b>{html(title)}</b></p>{table}{below}"
