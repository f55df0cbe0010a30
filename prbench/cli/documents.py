"""JSON documents: what ``--json`` prints and ``--out`` writes, in one envelope for all commands."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import msgspec

import prbench
from prbench.cli.commands import Answer, Session, session
from prbench.cli.places import Remote
from prbench.errors import PrbenchError


class Failure(msgspec.Struct, frozen=True, kw_only=True):
    """Why a command gave no report.

    Attributes:
        kind: Class of the error, such as ``TableError``.
        message: What was expected and found, and what to do.
    """

    kind: str
    message: str


class Document(msgspec.Struct, frozen=True, kw_only=True):
    """The envelope around every report.

    Attributes:
        prbench: Version of prbench that wrote the document.
        command: Name of the command, such as ``leaderboard compare``.
        exit_code: What the command ended with.
        notes: What the command said beside its report, on standard error.
        report: The command's report; its shape is described below, command by command; null if there is an error.
        error: Why there is no report; null if there is one.
    """

    prbench: str
    command: str
    exit_code: int
    notes: list[str]
    report: Any
    error: Failure | None


def document_of(result: Answer | PrbenchError, now: Session) -> Document:
    """Put a command's answer, or the error for which there is none, into the envelope."""
    failed = isinstance(result, PrbenchError)
    return Document(
        prbench=prbench.__version__,
        command=now.command,
        exit_code=result.exit_code,
        notes=now.notes,
        report=None if failed else result.report,
        error=Failure(kind=type(result).__name__, message=str(result)) if failed else None,
    )


def print_document(document: Document) -> None:
    """Print a document on standard output."""
    print(_encoded(document).decode("utf-8"))
    sys.stdout.flush()


def write_document(document: Document, path: Path | Remote) -> None:
    """Write a document to a file, here or at a URL, whole or not at all.

    Raises:
        StorageError: if it cannot be written.
    """
    from prbench.files.locks import sole_writer
    from prbench.files.storage import write_json

    if isinstance(path, Remote):
        from prbench.object_stores.outputs import written_file

        with written_file(path.url) as copy:
            write_json(copy, msgspec.json.decode(_encoded(document)))
        return
    with sole_writer(path):
        write_json(path, msgspec.json.decode(_encoded(document)))


def _encoded(document: Document) -> bytes:
    """Encode a document; what JSON cannot say (NaN, infinity) becomes null."""
    report = msgspec.json.encode(document.report, enc_hook=_plain).decode()
    # Messages in a report name places as well. Notes stay as they were told: some say where a local copy lies.
    document = msgspec.structs.replace(document, report=msgspec.Raw(session().shown_place(report).encode()))
    return msgspec.json.format(msgspec.json.encode(document), indent=2)


def _plain(value: Any) -> Any:
    """Encode what JSON has no form for: paths, and NumPy's numbers and arrays."""
    if isinstance(value, Path):
        return session().shown_place(str(value))
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no form in JSON")
