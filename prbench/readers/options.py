"""Options of readers: a data class beside each reader, filled from the ``name=value`` texts of a command line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from prbench.errors import UsageError, did_you_mean
from prbench.files.storage import file_digest


class ReaderOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of every reader's options; this one has none.

    Fields are ``bool``, ``int``, ``float``, ``str``, ``Literal`` or ``Path | None``, each with a default and a
    docstring. What a field changes must show in the recording, never only in a log.
    """

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of all options."""
        return tuple(field.name for field in msgspec.structs.fields(cls))


Options = TypeVar("Options", bound=ReaderOptions)


def parse_options(form: type[Options], given: Mapping[str, str], *, dataset: str) -> Options:
    """Options of a reader from texts.

    Raises:
        UsageError: for a name that the reader does not know, or a value that is none of its kind.
    """
    for name in given:
        if name not in form.names():
            hint = did_you_mean(name, form.names())
            known = ", ".join(form.names()) or "none"
            raise UsageError(f"the reader of {dataset} has no option '{name}'.{hint} Its options are: {known}.")
    try:
        return msgspec.convert(dict(given), form, strict=False, dec_hook=_path)
    except msgspec.ValidationError as error:
        raise UsageError(
            f"an option of the reader of {dataset} has a wrong value: {error}.{_allowed(form, str(error))}"
        ) from error


def _allowed(form: type[ReaderOptions], message: str) -> str:
    """The values that the blamed option may have, where they are a list."""
    blamed = re.search(r"`\$\.(\w+)`", message)
    hints = get_type_hints(form)
    if blamed is None or get_origin(hints.get(blamed[1])) is not Literal:
        return ""
    return f" {blamed[1]} is one of: {', '.join(map(str, get_args(hints[blamed[1]])))}."


def described_options(options: ReaderOptions) -> dict[str, str]:
    """Options as text without places of this machine: of a file its digest, of a folder its name."""
    return {name: _described(getattr(options, name)) for name in options.names()}


def _described(value: Any) -> str:
    if isinstance(value, Path):
        value = value.expanduser()
        return file_digest(value) if value.is_file() else value.name
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _path(kind: type, value: Any) -> Any:
    if kind is Path:
        return Path(value)
    raise NotImplementedError(f"options of the type {kind}")
