"""Whether the files of a table are still the ones that were built.

``dataset.json`` and ``corpus.json`` hold the SHA-256 of every Parquet file beside them. Hashing costs 0.25 s for 10,000
sequences, so it is done whenever a table is opened, and nothing is remembered that an edit could get past. A main table
whose bytes differ is looked at value by value before it is refused: written anew with equal values it is still the same
table. Tables of earlier versions have no such digests: there the values of the main table decide, and a warning says
that nothing vouches for the others.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from prbench.errors import TableError
from prbench.storage import file_digest

_SHOWN = 12  # characters of a digest


class UnverifiedTableWarning(UserWarning):
    """Some files of a table have no digest, so that an edit of them would go unnoticed."""


def digests_of_files(folder: Path, tables: Iterable[str]) -> dict[str, str]:
    """SHA-256 of each Parquet file of some tables, by its path relative to the folder; absent files are left out."""
    return {path.relative_to(folder).as_posix(): file_digest(path) for name in tables for path in _files(folder, name)}


def require_unchanged(
    folder: Path,
    described_in: Path,
    expected: Mapping[str, str],
    *,
    main: str,
    others: Iterable[str],
    require_same_values: Callable[[], object],
) -> None:
    """Refuse a table of which a file was edited.

    Args:
        folder: Holds the Parquet files.
        described_in: ``dataset.json`` or ``corpus.json``.
        expected: The digests that stand in there, by relative path; empty in tables of earlier versions.
        main: Name of the table whose values the content digest is of.
        others: Names of the further tables; where one is absent, whoever wants to read it says so.
        require_same_values: Compares the values of the main table with the content digest and raises the error.

    Raises:
        TableError: naming the first file that was edited.
    """
    if not expected:
        require_same_values()
        warnings.warn(
            f"{described_in}: was written by an earlier version, without digests of {' and '.join(others)}, so"
            " these are unverified. Build it again to have edits of them noticed.",
            UnverifiedTableWarning,
            stacklevel=4,
        )
        return
    if digests_of_files(folder, [main]) != _of_table(expected, main):
        require_same_values()
    for name in others:
        for path, found in digests_of_files(folder, [name]).items():
            if found != expected.get(path):
                described = f"SHA-256 {expected[path][:_SHOWN]}…" if path in expected else "no such file"
                raise TableError(
                    f"{folder / path}: expected the file that {described_in.name} describes ({described}), found"
                    f" another one ({found[:_SHOWN]}…). It was changed after the build: copy the folder again, or build"
                    " it again."
                )


def _files(folder: Path, table: str) -> list[Path]:
    """The file of a table or its parts; none where it is absent."""
    single = folder / f"{table}.parquet"
    return [single] if single.is_file() else sorted((folder / table).glob("part-*.parquet"))


def _of_table(digests: Mapping[str, str], table: str) -> dict[str, str]:
    return {path: digest for path, digest in digests.items() if path.split("/")[0].removesuffix(".parquet") == table}
