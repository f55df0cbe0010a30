"""``prbench error-budget``: why the motions of runs fail, and what explains it (docs/error-budget.md)."""
