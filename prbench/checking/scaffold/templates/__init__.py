"""The files of a new method, as templates: see :mod:`prbench.checking.scaffold.values` for their few marks."""
