"""What a program says about itself in its hello, checked before anything depends on it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench.methods.declared import Declared
from prbench.methods.names import NAME_FORM, has_form
from prbench.methods.remote.messages import WIRE_VERSION

_TEXT_LIMIT = 100


@dataclass(frozen=True)
class RemoteWeights:
    """What a program says that it will use under a condition."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Introduction:
    """A program's hello."""

    name: str
    version: str
    declared: Declared
    weights: Mapping[Condition, RemoteWeights] = field(default_factory=dict)
    trainable: bool = False
    """Of prbench's own worker alone: the installed method can be fitted to a table."""

    @classmethod
    def read(cls, header: Mapping[str, Any], *, origin: str) -> Introduction:
        """Read the header of a ``hello``.

        Args:
            header: As received.
            origin: What to call the program in messages.

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
        return cls(
            _name(header, origin),
            _text(header, "version", origin),
            Declared.checked(
                _array(header, "conditions", origin),
                header.get("max_frames"),
                header.get("native_fps"),
                motionless is True,
                origin=origin,
            ),
            _weights(header.get("weights"), origin),
            trainable=header.get("trainable") is True,
        )


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


def _weights(value: object, origin: str) -> dict[Condition, RemoteWeights]:
    known = {condition.value: condition for condition in Condition}
    weights = {}
    for condition, entry in (value if isinstance(value, dict) else {"": value} if value is not None else {}).items():
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
