"""The hello of a program and its answers to ``generate``, checked before anything depends on them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, TypeVar

from prbench.contract import Condition, ConditionBatch, Cost, Motions
from prbench.errors import AdapterError
from prbench.harness.methods.declared import Declared
from prbench.harness.methods.names import NAME_FORM, has_form
from prbench.harness.methods.remote.faults import BrokenProtocol, ReportedError
from prbench.harness.methods.remote.messages import WIRE_VERSION, Header, motions_of, shown_json

_SHOWN_TEXT = 2000  # characters of what a program says about its own error
_TEXT_LIMIT = 100
_Answer = TypeVar("_Answer")


def motions_in(
    header: Header, payload: bytes | None, batch: ConditionBatch, number: int, *, gaze: bool = False
) -> Motions:
    """Return the motions of an answer, in the order of the batch.

    Args:
        header: As received.
        payload: As received.
        batch: What was asked for.
        number: Number of the request.
        gaze: The program declares gaze.

    Raises:
        ReportedError: if the program says that it failed.
        BrokenProtocol: if it answers something else than it was asked for.
        MemoryError: if it says that the batch does not fit in memory.
    """
    motions = answer_in(header, payload, number, due="motions", read=lambda sent: motions_of(sent, batch, gaze=gaze))
    passes = header.get("network_passes")
    if passes is None:
        return motions
    if type(passes) is not int or passes < 0:
        raise BrokenProtocol(f"declared {shown_json(passes)} network_passes, where a whole number of 0 or more was due")
    return replace(motions, cost=Cost(passes))


def answer_in(
    header: Header, payload: bytes | None, number: int, *, due: str, read: Callable[[bytes], _Answer]
) -> _Answer:
    """Return what an answer holds.

    Args:
        header: As received.
        payload: As received.
        number: Number of the request.
        due: The message that answers it, ``motions`` or ``futures``.
        read: Turns the payload into the answer; raises ValueError where it cannot.

    Raises:
        ReportedError: if the program says that it failed.
        BrokenProtocol: if it answers something else than it was asked for.
        MemoryError: if it says that the batch does not fit in memory.
    """
    kind = header["message"]
    if kind not in (due, "error"):
        raise BrokenProtocol(f"answered with the message {kind[:80]!r}, where '{due}' or 'error' was due")
    _require_batch(header, number)
    if kind == "error":
        raise _reported(header)
    if payload is None:
        raise BrokenProtocol(f"answered without a payload, where 'bytes' and as many bytes of {due} were due")
    try:
        return read(payload)
    except ValueError as error:
        raise BrokenProtocol(f"sent {due} that cannot be used: {error}") from error


def error_text(header: Header) -> str:
    """Return what a program says about its own error, without what would move the cursor or colour a terminal.

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


@dataclass(frozen=True)
class RemoteWeights:
    """Weights that a program says it uses under a condition."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Introduction:
    """A program's hello."""

    name: str
    version: str
    declared: Declared
    weights: Mapping[StrEnum, RemoteWeights] = field(default_factory=dict)
    one_design: bool = False
    """True for a predictor whose K futures are one design."""
    trainable: bool = False
    """True if the installed method can be fitted to a table; only prbench's own worker says so."""

    @classmethod
    def read(cls, header: Mapping[str, Any], *, origin: str, conditions: type[StrEnum] = Condition) -> Introduction:
        """Read the header of a ``hello``.

        Args:
            header: As received.
            origin: Name of the program in messages.
            conditions: The conditions of its benchmark.

        Raises:
            AdapterError: naming the key that is not what the protocol asks for.
        """
        if header["message"] != "hello":
            raise AdapterError(
                f"{origin}: expected it to answer 'hello' with 'hello', found the message {header['message'][:80]!r}."
            )
        _require_version(header.get("wire"), origin)
        motionless = header.get("motionless")
        if motionless is not None and not isinstance(motionless, bool):
            raise AdapterError(
                f"{origin}: expected 'motionless' in its hello to be true or false, found {_shown(motionless)}."
            )
        gaze = header.get("gaze")
        if gaze is not None and not isinstance(gaze, bool):
            raise AdapterError(f"{origin}: expected 'gaze' in its hello to be true or false, found {_shown(gaze)}.")
        one_design = header.get("one_design")
        if one_design is not None and not isinstance(one_design, bool):
            raise AdapterError(
                f"{origin}: expected 'one_design' in its hello to be true or false, found {_shown(one_design)}."
            )
        return cls(
            _name(header, origin),
            _text(header, "version", origin),
            Declared.checked(
                _array(header, "conditions", origin),
                header.get("max_frames"),
                header.get("native_fps"),
                motionless is True,
                gaze is True,
                origin=origin,
                known=conditions,
            ),
            _weights(header.get("weights"), origin, conditions),
            one_design=one_design is True,
            trainable=header.get("trainable") is True,
        )


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
    text = error_text(header)
    out_of_memory = header.get("out_of_memory")
    if out_of_memory is not None and not isinstance(out_of_memory, bool):
        raise BrokenProtocol(
            f"reported the error '{text}' with 'out_of_memory' {shown_json(out_of_memory)}, where true or false was due"
        )
    return MemoryError(text) if out_of_memory else ReportedError(f"reported an error: {text}")


def _array(header: Mapping[str, Any], key: str, origin: str) -> list[Any]:
    value = header.get(key)
    if isinstance(value, list):
        return value
    raise AdapterError(f"{origin}: expected '{key}' in its hello to be an array of strings, found {_shown(value)}.")


def _require_version(found: object, origin: str) -> None:
    if type(found) is int and found == WIRE_VERSION:
        return
    remedy = "Update prbench" if type(found) is int and found > WIRE_VERSION else "Update the program"
    if type(found) is not int:
        remedy = f"Send the whole number {WIRE_VERSION}"
    raise AdapterError(
        f"{origin}: expected version {WIRE_VERSION} of the wire protocol ('wire' in its hello),"
        f" found {_shown(found)}. {remedy}."
    )


def _name(header: Mapping[str, Any], origin: str) -> str:
    value = header.get("name")
    if isinstance(value, str) and has_form(value):
        return value
    raise AdapterError(f"{origin}: expected 'name' in its hello to be a text of {NAME_FORM}; found {_shown(value)}.")


def _text(header: Mapping[str, Any], key: str, origin: str) -> str:
    value = header.get(key)
    if isinstance(value, str) and value.strip() and value.isprintable() and len(value) <= _TEXT_LIMIT:
        return value
    raise AdapterError(
        f"{origin}: expected '{key}' in its hello to be a text of 1 to {_TEXT_LIMIT} printable characters,"
        f" found {_shown(value)}."
    )


def _weights(value: object, origin: str, conditions: type[StrEnum]) -> dict[StrEnum, RemoteWeights]:
    known = {condition.value: condition for condition in conditions}
    weights = {}
    if value is None:
        return {}
    stated = value if isinstance(value, dict) else {"": value}  # "" is no condition, and so refused below
    for condition, entry in stated.items():
        name, digest = (entry.get("name"), entry.get("sha256")) if isinstance(entry, dict) else (None, None)
        fits = isinstance(name, str) and isinstance(digest, str) and re.fullmatch("[0-9a-f]{64}", digest)
        if condition not in known or not fits:
            raise AdapterError(
                f"{origin}: expected 'weights' in its hello to give a condition's name and sha256 (64 hexadecimal"
                f' digits), as {{"goal-loc": {{"name": …, "sha256": …}}}}, found {_shown(value)}.'
            )
        weights[known[condition]] = RemoteWeights(str(name), str(digest))
    return weights


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 120 else text[:120] + "…"
