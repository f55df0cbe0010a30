"""What a conditions file says about itself: enough to score what comes back, nothing that names the data."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from prbench.contract import Condition
from prbench.errors import InputFileError
from prbench.storage import text_digest

FORMAT_VERSION = 1
METADATA_KEY = "prbench_conditions"
"""Key of the Parquet metadata, and name of the array in an ``.npz``, that holds the information as JSON."""


class ConditionsInfo(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the rows of a conditions file were made. A method may see this as it may see the rows."""

    format_version: int = FORMAT_VERSION
    condition: Condition
    seed: int
    """The run's seed, behind opaque ids and noise seeds."""
    samples: int
    """Rows of each sequence, with noise of their own."""
    split: str
    limit: int | None
    max_frames: int | None
    """Longer sequences, at the rate of the file, were left out."""
    native_fps: float | None
    """Rate that ``n_frames`` and ``fps`` are given at; None for the table's own."""
    protocol_version: int
    tables: tuple[str, ...]
    """Fingerprints of the tables, sorted."""

    def as_json(self) -> str:
        """One line, sorted keys."""
        return msgspec.json.encode(self, order="sorted").decode()

    @classmethod
    def from_json(cls, text: str | bytes, path: Path) -> ConditionsInfo:
        """Read what :meth:`as_json` wrote.

        Args:
            text: JSON.
            path: The file that it stands in, for messages.

        Raises:
            InputFileError: if it is of a newer version or not what the format asks for.
        """
        remedy = "Export the conditions again with `prbench export-conditions`."
        try:
            version = msgspec.json.decode(text, type=_Versioned).format_version
            if version == FORMAT_VERSION:
                return msgspec.json.decode(text, type=cls)
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            raise InputFileError(
                path, METADATA_KEY, expected="what prbench wrote about the file", found=str(error), remedy=remedy
            ) from error
        raise InputFileError(
            path, METADATA_KEY, expected=f"format version {FORMAT_VERSION}", found=str(version), remedy=remedy
        )


class _Versioned(msgspec.Struct):
    format_version: int


def fingerprints(identities: Iterable[str]) -> tuple[str, ...]:
    """One digest a table, sorted. Whoever has the table recognises it; the key of the opaque ids does not follow.

    Args:
        identities: Identity digests of the tables.
    """
    return tuple(sorted(text_digest("prbench conditions", identity) for identity in identities))
