"""``prbench analyse errors``: why the motions of runs fail, and what explains it (docs/error-budget.md)."""
