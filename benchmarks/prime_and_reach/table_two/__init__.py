"""Table 2 of *Prime and Reach* in one command: its rows planned, run unattended, and printed in its layout."""

from prbench_benchmarks.prime_and_reach.table_two.layout import Cell, DatasetLayout, TableLayout
from prbench_benchmarks.prime_and_reach.table_two.request import TableRequest
from prbench_benchmarks.prime_and_reach.table_two.run import run_table

__all__ = [
    "Cell",
    "DatasetLayout",
    "TableLayout",
    "TableRequest",
    "run_table",
]
