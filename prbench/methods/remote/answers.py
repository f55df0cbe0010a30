"""What a program answers to ``generate``."""

from __future__ import annotations

from prbench.contract import ConditionBatch, Cost, Motions
from prbench.methods.remote.faults import BrokenProtocol, ReportedError
from prbench.methods.remote.messages import Header, motions_of, shown_json

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
    _require_batch(header, number)
    if kind == "error":
        raise _reported(header)
    if payload is None:
        raise BrokenProtocol("answered without a payload, where 'bytes' and as many bytes of motions were due")
    try:
        motions = motions_of(payload, batch)
    except ValueError as error:
        raise BrokenProtocol(f"sent motions that cannot be used: {error}") from error
    passes = header.get("network_passes")
    if passes is None:
        return motions
    if type(passes) is not int or passes < 0:
        raise BrokenProtocol(f"declared {shown_json(passes)} network_passes, where a whole number of 0 or more was due")
    return Motions(motions.joints, motions.n_frames, Cost(passes))


def error_text(header: Header) -> str:
    """What a program says about its own error, without what would move the cursor or colour a terminal.

    Raises:
        BrokenProtocol: if it is no text.
    """
    text = header.get("text")
    if text is not None and not isinstance(text, str):
        raise BrokenProtocol(f"reported an error with the 'text' {shown_json(text)}, where a string was due")
    said = "" if text is None else text.expandtabs(4).strip()[:_SHOWN_TEXT]
    shown = "".join(
        letter if letter.isprintable() or letter == "\n" else "\N{REPLACEMENT CHARACTER}" for letter in said
    )
    return shown or "no reason given"


def _require_batch(header: Header, number: int) -> None:
    found = header.get("batch")
    if (type(found) is int and found == number) or (found is None and header["message"] == "error"):
        return
    answered = "without the number of a batch" if found is None else f"batch {shown_json(found)}"
    raise BrokenProtocol(
        f"answered {answered}, where batch {number} was due: every request has exactly one answer, which repeats its"
        " number"
    )


def _reported(header: Header) -> MemoryError | ReportedError:
    """The failure that a program reports."""
    text, out_of_memory = error_text(header), header.get("out_of_memory")
    if out_of_memory is not None and not isinstance(out_of_memory, bool):
        raise BrokenProtocol(
            f"reported the error '{text}' with 'out_of_memory' {shown_json(out_of_memory)}, where true or false was due"
        )
    return MemoryError(text) if out_of_memory else ReportedError(f"reported an error: {text}")
