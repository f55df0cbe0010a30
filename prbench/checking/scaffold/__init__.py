"""A new method's or dataset's package or program: complete, installable, and working before anything is changed."""

from prbench.checking.scaffold.create import ScaffoldRequest, new_adapter, new_dataset
