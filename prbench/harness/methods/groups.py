"""The methods of a benchmark: where packages offer them, and what they must be able to do."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from prbench.contract import ENTRY_POINT_GROUP, Adapter, Condition
from prbench.harness.methods.remote.adapter import RemoteAdapter
from prbench.harness.methods.remote.method import RemoteMethod
from prbench.harness.methods.remote.served import serve_motions
from prbench.protocol.benchmarks import find_benchmark


@dataclass(frozen=True)
class MethodGroup:
    """What loading a method needs to know of its benchmark; picklable, so that every worker can load it."""

    entry_points: str
    """Entry-point group."""
    interface: type
    """Protocol that a loaded method has to satisfy."""
    members: str
    """What the protocol asks for, in words."""
    conditions: type[StrEnum]
    """The conditions that a method may name."""
    remote: type[RemoteMethod]
    """A method of the group behind the wire protocol."""
    serve: Callable[[str, Any, dict[str, Any], bytes], tuple[dict[str, Any], bytes]]
    """Answers a request for an installed method in ``harness.methods.worker``: name, method, header, payload."""


MOTIONS = MethodGroup(
    ENTRY_POINT_GROUP, Adapter, "name, conditions and generate()", Condition, RemoteAdapter, serve_motions
)
"""The methods of prime-and-reach."""


def group_of(benchmark: str) -> MethodGroup:
    """Return the methods of a benchmark; only that of the benchmark asked for is imported.

    Raises:
        UsageError: for an unknown benchmark.
    """
    about = find_benchmark(benchmark)
    if about.default:
        return MOTIONS
    module, _, attribute = about.value.partition(":")
    return getattr(importlib.import_module(module), attribute).methods
