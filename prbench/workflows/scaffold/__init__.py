"""A new method's package or program: complete, installable, and working before anything is changed."""

from prbench.workflows.scaffold.create import ScaffoldReport, ScaffoldRequest, new_adapter

__all__ = ["ScaffoldReport", "ScaffoldRequest", "new_adapter"]
