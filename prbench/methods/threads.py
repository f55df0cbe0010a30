"""The number of threads that a method computes with; its rounding may depend on it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def computing_threads(threads: int) -> Iterator[None]:
    """Fix the threads of numerical libraries: the same in this process and in any other, whatever it started with."""
    from threadpoolctl import threadpool_limits  # sets a variable, which users_environment() has to see come

    torch = sys.modules.get("torch")
    if torch is not None and torch.get_num_threads() != threads:
        torch.set_num_threads(threads)  # torch manages its own
    with threadpool_limits(threads):
        yield
