"""Why motions fail: what each lacks for Prime and Reach Success, what feet and bones do (docs/error-budget.md)."""
