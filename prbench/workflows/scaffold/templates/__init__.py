"""The files of a new method, as templates: see :mod:`prbench.workflows.scaffold.values` for their few marks."""
