"""The files of a new method, as templates: see :mod:`prbench.checking.scaffold.create` for their few marks."""
