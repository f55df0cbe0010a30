"""Which bodies were estimated from the head rather than captured."""

from __future__ import annotations

_ESTIMATED = frozenset({"egoallo"})


def is_estimated(pose_source: str) -> bool:
    """Return True for bodies that were computed from whole tracks of the head: a frame may carry later head motion.

    Source: docs/specification/motion-prediction.md#from-recordings-to-windows.
    """
    return pose_source in _ESTIMATED
