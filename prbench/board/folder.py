"""A board as a folder of text and Parquet: submissions, what was verified of them, and a history that only grows.

``history.jsonl`` decides what stands on the board: it names every submission with the digests of its files, and a
withdrawn one keeps its lines. The pages are made from it and the submissions alone, so they are the same on every
machine. A page never depends on the time, a path or the order of files.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date as Date
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import tomli_w

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, read_text, read_toml

INFO = "board.toml"
HISTORY = "history.jsonl"
SUBMISSIONS = "submissions"
VERIFICATION = "verification"
ADD = "add"
WITHDRAW = "withdraw"
_Text = Annotated[str, msgspec.Meta(max_length=1000)]
_Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
_Id = Annotated[str, msgspec.Meta(pattern="^[a-z0-9][a-z0-9-]{0,80}-[0-9a-f]{10}$")]
_CONFLICT = re.compile(r"(<{7}|={7}|>{7}|\|{7})( |$)")
_REBUILD = "`prbench leaderboard build` makes the pages again."


class BoardDataset(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A dataset whose sequences a board compares.

    Attributes:
        name: Name of the dataset.
        title: The same for readers.
        redistribution: Whether data made from the dataset may be passed on: ``yes``, ``non-commercial`` or ``none``.
        identity: Identity digest of its table, which every submission's table has to have.
    """

    name: _Text
    title: _Text
    redistribution: Literal["yes", "non-commercial", "none"]
    identity: _Digest


class BoardInfo(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The content of ``board.toml``.

    Attributes:
        title: Title of the board.
        url: Where it can be read; empty for nowhere yet.
        contact: Whom to write to.
        maintainers: Their names, for citations.
        licence: Licence under which submissions are published.
        benchmark: Name of the benchmark.
        protocol_version: Version of its protocol.
        protocol: Digest of that protocol.
        datasets: The datasets that it compares methods on.
    """

    title: _Text
    url: _Text
    contact: _Text
    maintainers: tuple[_Text, ...]
    licence: _Text
    benchmark: _Text
    protocol_version: int
    protocol: _Digest
    datasets: tuple[BoardDataset, ...]

    @property
    def text(self) -> str:
        """The bytes of ``board.toml``."""
        return tomli_w.dumps(msgspec.to_builtins(self))


class HistoryEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A line of ``history.jsonl``.

    Attributes:
        date: Day on which it happened, as the maintainer gave it.
        action: ``add`` or ``withdraw``.
        id: The submission.
        reason: Why it was withdrawn, or added again.
        name: Name of the added submission.
        submission: Digest of its ``submission.json``, which holds the digests of all its files.
        verification: Digest of what was verified of it, ``verification/ID.json``.
        motions: Digests of the motions of each of its runs that is no control.
    """

    date: Annotated[str, msgspec.Meta(pattern=r"^\d{4}-\d\d-\d\d$")]
    action: Literal["add", "withdraw"]
    id: _Id
    reason: _Text = ""
    name: _Text = ""
    submission: _Digest | None = None
    verification: _Digest | None = None
    motions: tuple[_Digest, ...] = ()


def history_text(entries: Iterable[HistoryEntry]) -> str:
    """Return the bytes of ``history.jsonl``."""
    return "".join(msgspec.json.encode(entry).decode() + "\n" for entry in entries)


@foreign_input()
def read_history(path: Path) -> tuple[HistoryEntry, ...]:
    """Read ``history.jsonl``; a board without one has no submission yet.

    Raises:
        InputFileError: naming the line that is no entry, or contradicts an earlier one.
    """
    if not path.exists():
        return ()
    entries: list[HistoryEntry] = []
    standing: dict[str, HistoryEntry] = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        where = f"line {number}"
        if _CONFLICT.match(line):
            remedy = f"Keep the lines of both sides, take the marker out, and rebuild: {_REBUILD}"
            raise InputFileError(path, where, expected="an entry", found="a merge conflict's marker", remedy=remedy)
        try:
            entry = msgspec.json.decode(line, type=HistoryEntry)
            Date.fromisoformat(entry.date)
        except (msgspec.DecodeError, ValueError) as error:
            remedy = "Take the line from the repository again; no command writes such a one."
            raise InputFileError(path, where, expected="an entry", found=str(error), remedy=remedy) from error
        stands = entry.id in standing
        if entry.action == ADD and (stands or None in (entry.submission, entry.verification)):
            found = "it again" if stands else "no digest of it or of what was verified"
            raise InputFileError(path, where, expected=f"a new submission {entry.id}", found=found)
        if entry.action == WITHDRAW and not (stands and entry.reason):
            found = "no reason" if stands else "none of that id that stands"
            raise InputFileError(path, where, expected=f"a submission to withdraw, and why ({entry.id})", found=found)
        if entry.action == ADD:
            standing[entry.id] = entry
        else:
            del standing[entry.id]
        entries.append(entry)
    return tuple(entries)


@dataclass(frozen=True)
class BoardFolder:
    """A board on disk.

    Attributes:
        path: The folder.
        info: The content of ``board.toml``.
        history: What was added and withdrawn, in order.
    """

    path: Path
    info: BoardInfo
    history: tuple[HistoryEntry, ...] = ()

    @classmethod
    @foreign_input()
    def open(cls, path: Path) -> BoardFolder:
        """Read what a board is and what happened to it.

        Raises:
            InputFileError: if the folder holds no board, or ``board.toml`` or ``history.jsonl`` is damaged.
        """
        file = path / INFO
        values = read_toml(file, "a board", f"Make one with `prbench leaderboard init {path}`.")
        try:
            info = msgspec.convert(values, BoardInfo)
        except msgspec.ValidationError as error:
            key = str(error).partition("`$.")[2].rstrip("`")
            raise InputFileError(file, key, expected="a value of the key's type", found=str(error)) from error
        return cls(path, info, read_history(path / HISTORY))

    @property
    def standing(self) -> dict[str, HistoryEntry]:
        """Maps the ids of the submissions that stand on the board to the entries that added them, in id order."""
        found: dict[str, HistoryEntry] = {}
        for entry in self.history:
            if entry.action == ADD:
                found[entry.id] = entry
            else:
                del found[entry.id]
        return dict(sorted(found.items()))

    @property
    def withdrawn(self) -> dict[str, HistoryEntry]:
        """Maps the ids of withdrawn submissions to the entries that withdrew them."""
        last = {entry.id: entry for entry in self.history}
        return {name: entry for name, entry in sorted(last.items()) if entry.action == WITHDRAW}

    def submission(self, name: str) -> Path:
        """Return the folder of a submission: what its archive held."""
        return self.path / SUBMISSIONS / name

    def verification(self, name: str) -> Path:
        """Return the file that says what was verified of a submission."""
        return self.path / VERIFICATION / f"{name}.json"
