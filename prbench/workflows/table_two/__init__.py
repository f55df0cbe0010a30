"""Table 2 of *Prime and Reach* in one command: its rows planned, run unattended, and printed in its layout."""

from prbench.workflows.table_two.layout import Cell, DatasetLayout, Line, TableLayout
from prbench.workflows.table_two.plan import ALL, PlannedRow
from prbench.workflows.table_two.request import TableRequest
from prbench.workflows.table_two.run import TableReport, run_table

__all__ = [
    "ALL",
    "Cell",
    "DatasetLayout",
    "Line",
    "PlannedRow",
    "TableLayout",
    "TableReport",
    "TableRequest",
    "run_table",
]
