"""Table 2 of *Prime and Reach* in one command: its rows planned, run unattended, and printed in its layout."""

from prbench.workflows.table_two.layout import Cell, DatasetLayout, TableLayout
from prbench.workflows.table_two.request import TableRequest
from prbench.workflows.table_two.run import run_table

__all__ = [
    "Cell",
    "DatasetLayout",
    "TableLayout",
    "TableRequest",
    "run_table",
]
