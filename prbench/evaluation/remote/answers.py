"""What a program answers to ``generate``."""

from __future__ import annotations

from numbers import Integral

from prbench.contract import ConditionBatch, Cost, Motions
from prbench.evaluation.remote.faults import BrokenProtocol, ReportedError
from prbench.evaluation.remote.messages import Header, motions_of

_SHOWN_TEXT = 2000  # characters of what a program says about its own error


def motions_in(header: Header, payload: bytes | None, batch: ConditionBatch, number: int) -> Motions:
    """The motions of an answer, in the order of the batch.

    Args:
        header: As received.
        payload: As received.
        batch: What was asked for.
        number: Of the request.

    Raises:
        ReportedError: if the program says that it failed.
        BrokenProtocol: if it answers something else than it was asked for.
        MemoryError: if it says that the batch does not fit in memory.
    """
    kind = header["message"]
    if kind not in ("motions", "error"):
        raise BrokenProtocol(f"answered with the message {kind[:80]!r}, where 'motions' or 'error' was due")
    if header.get("batch") != number and not (kind == "error" and header.get("batch") is None):
        raise BrokenProtocol(
            f"answered batch {str(header.get('batch'))[:40]}, where batch {number} was due: every request has exactly"
            " one answer, which repeats its number"
        )
    if kind == "error":
        text = error_text(header)
        if header.get("out_of_memory") is True:
            raise MemoryError(text)
        raise ReportedError(f"reported an error: {text}")
    if payload is None:
        raise BrokenProtocol("answered without a payload, where 'bytes' and as many bytes of motions were due")
    try:
        motions = motions_of(payload, batch)
    except ValueError as error:
        raise BrokenProtocol(f"sent motions that cannot be used: {error}") from error
    passes = header.get("network_passes")
    if passes is None:
        return motions
    if not isinstance(passes, Integral) or isinstance(passes, bool) or passes < 0:
        raise BrokenProtocol(f"declared {str(passes)[:40]!r} network_passes, where a whole number was due")
    return Motions(motions.joints, motions.n_frames, Cost(int(passes)))


def error_text(header: Header) -> str:
    """What a program says about its own error."""
    text = header.get("text")
    return text.strip()[:_SHOWN_TEXT] if isinstance(text, str) and text.strip() else "no reason given"
