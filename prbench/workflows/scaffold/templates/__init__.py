"""The files of a new method, as templates: see :mod:`prbench.workflows.scaffold.templating` for their few marks."""
