"""The methods of a benchmark: where packages offer them, and what they must be able to do."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from prbench.contract import ENTRY_POINT_GROUP, Adapter, Condition
from prbench.methods.remote.adapter import RemoteAdapter
from prbench.methods.remote.method import RemoteMethod


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
    has_worker: bool = False
    """Installed methods can be isolated: :mod:`prbench.methods.worker` serves them."""


MOTIONS = MethodGroup(
    ENTRY_POINT_GROUP, Adapter, "name, conditions and generate()", Condition, RemoteAdapter, has_worker=True
)
"""The methods of prime-and-reach."""
