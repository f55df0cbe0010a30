"""JSON files beside a table that say what it is: ``dataset.json`` and ``corpus.json``."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import msgspec

from prbench.boundary import foreign_input
from prbench.bounded import read_whole
from prbench.errors import TableError
from prbench.limits import LARGEST_JSON
from prbench.shown import quoted
from prbench.storage import is_path_part


class QuarantinedRecording(msgspec.Struct, frozen=True, kw_only=True):
    """A recording that was left out, and why."""

    recording_id: str
    status: str
    message: str


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """What every built table says of itself. Holds no time of day, host, absolute path or worker count."""

    schema_version: int
    protocol_version: int
    protocol_digest: str
    dataset: str
    title: str
    synthetic: bool
    prbench_version: str
    manifest_digest: str
    input_digest: str
    """Over the names and contents of all files that were used."""
    options: dict[str, str]
    outcomes: dict[str, int]
    quarantine: tuple[QuarantinedRecording, ...]
    identity_digest: str
    content_digest: str
    file_digests: dict[str, str] = {}
    """SHA-256 of each Parquet file beside this one, by relative path; empty in tables of earlier versions."""
    licence: str
    redistribution: str
    homepage: str
    citation: str


Info = TypeVar("Info", bound=Provenance)


@foreign_input()
def read_info(path: Path, kind: type[Info], *, what: str) -> Info:
    """Read the file that describes a built ``dataset`` or ``corpus``, whichever ``what`` says.

    Raises:
        TableError: if the folder holds none, or it is damaged or of another version.
    """
    folder = path.parent
    try:
        info = msgspec.json.decode(read_whole(path, largest=LARGEST_JSON), type=kind)
    except (FileNotFoundError, NotADirectoryError) as error:
        found = "no such file in it" if folder.is_dir() else "a file" if folder.is_file() else "no such folder"
        raise TableError(
            f"{folder}: expected a built {what} (a folder with {path.name}), found {found}. {_remedy(path, what)}"
        ) from error
    except (msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: not a valid {path.name}: {error}. Build the {what} again.") from error
    if not is_path_part(info.dataset):  # folders are named after it, and nothing is made before this is known
        raise TableError(
            f"{path}, dataset: expected a name that a folder can have, found '{quoted(info.dataset)}'."
            f" Build the {what} again."
        )
    return info


def _remedy(path: Path, what: str) -> str:
    """Name the built ones that lie one folder farther down, where a folder of several was given."""
    inner = sorted(str(file.parent) for file in path.parent.glob(f"*/{path.name}"))
    return f"Did you mean {', '.join(inner)}?" if inner else f"Make one with `prbench build-{what}`."


def counts_stated(path: Path) -> dict[str, int]:
    """The counts in a file that describes a dataset or corpus of any version; none where it cannot be read."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=_Counted).counts
    except (OSError, msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError):
        return {}


class _Counted(msgspec.Struct):
    counts: dict[str, int]
