"""prbench: curate prime-and-reach motion sequences, run motion generators over them and score the results.

Everything that ``import prbench`` offers is listed in ``prbench.__all__`` and explained in docs/python-api.md. It is
imported when it is first used, so that ``import prbench`` itself loads neither NumPy nor torch nor pandas. Editors and
type checkers read the names and types in ``__init__.pyi``, which stands beside this file.
"""

# pyright: reportUnsupportedDunderAll=false
# The names of __all__ are made by __getattr__.

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("prbench")
except PackageNotFoundError:  # imported from a source tree that was never installed
    __version__ = "0.0.0+uninstalled"

__all__ = [
    "Build",
    "Cluster",
    "Comparison",
    "Event",
    "Events",
    "Gaze",
    "Goal",
    "Head",
    "Joint",
    "Measures",
    "Picture",
    "PrbenchError",
    "PrimedEvent",
    "Recording",
    "Recordings",
    "Replay",
    "Run",
    "Scores",
    "Sequence",
    "Story",
    "SyntheticRecordings",
    "Table",
    "__version__",
    "build_dataset",
    "compare",
    "embedded_tables",
    "measure",
    "measure_futures",
    "open_run",
    "open_table",
    "prime",
    "run",
    "score",
    "synthesize",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562).

    Raises:
        AttributeError: if prbench offers no such name; ends in the nearest one that it offers.
    """
    if name in __all__:
        value = getattr(import_module("prbench.api"), name)
        globals()[name] = value
        return value
    near = ""
    if not name.startswith("_"):
        from prbench.errors import did_you_mean

        near = did_you_mean(name, __all__)
    raise AttributeError(f"module 'prbench' has no attribute '{name}'.{near}", name=name, obj=None)


def __dir__() -> list[str]:
    """List the public names beside what has been imported already."""
    return sorted({*globals(), *__all__})
