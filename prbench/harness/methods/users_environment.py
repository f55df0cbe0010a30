"""The environment as the user made it, and processes of prbench's own that leave it so.

Whatever prbench adds for its own sake (where it finds modules, a library's switch) would reach the programs of methods,
and break or hide what their own environments lack.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Iterator

_SET_BY_LIBRARIES = ("KMP_DUPLICATE_LIB_OK",)  # by threadpoolctl, when it is imported
_NOT_THE_USERS = frozenset(name for name in _SET_BY_LIBRARIES if name not in os.environ)
_START = (
    "import json, runpy, sys; sys.path[:] = json.loads(sys.argv.pop(1));"
    " runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)"
)


def users_environment() -> dict[str, str]:
    """The variables of this process without those that libraries set while prbench imported them."""
    return {name: value for name, value in os.environ.items() if name not in _NOT_THE_USERS}


def python_words(module: str, *arguments: str) -> list[str]:
    """The command that runs a module as ``python -m`` does, with this process's ``sys.path`` and no variable for it.

    Args:
        module: Dotted name.
        arguments: What it finds in ``sys.argv[1:]``.
    """
    paths = [os.path.abspath(path) for path in sys.path]  # noqa: PTH100 - an empty entry is the current folder
    return [sys.executable, "-P", "-c", _START, json.dumps(paths), module, *arguments]


@contextlib.contextmanager
def computing_threads(threads: int) -> Iterator[None]:
    """Fix the threads of numerical libraries: the same in this process and in any other, whatever it started with."""
    from threadpoolctl import threadpool_limits  # sets a variable, which users_environment() has to see come

    torch = sys.modules.get("torch")
    if torch is not None and torch.get_num_threads() != threads:
        torch.set_num_threads(threads)  # torch manages its own
    with threadpool_limits(threads):
        yield
