"""A board as a folder of text and Parquet: submissions, what was verified of them, and a history that only grows.

``history.jsonl`` decides what stands on the board: it names every submission with the digests of its files, and a
withdrawn one keeps its lines. The pages are made from it and the submissions alone.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date as Date
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from prbench.board.submission import Submission
from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, read_text, read_toml, require, structured
from prbench.files.storage import bytes_digest, text_digest
from prbench.harness.run_folder.record import CONTROL

INFO = "board.toml"
HISTORY = "history.jsonl"
SUBMISSIONS = "submissions"
VERIFICATION = "verification"
_MARKERS = ("<<<<<<<", "=======", ">>>>>>>", "|||||||")
_AGAIN = "Take the line from the repository again; no command writes such a one."
_Text = Annotated[str, msgspec.Meta(max_length=1000)]
_Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class BoardDataset(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A dataset whose sequences a board compares.

    Attributes:
        dataset: Name of the dataset.
        title: The same for readers.
        redistribution: Whether data made from the dataset may be passed on: ``yes``, ``non-commercial``, or ``none``,
            for which any other word counts.
        identity: Identity digest of its table, which every submission's table has to have.
    """

    dataset: str
    title: str
    redistribution: str
    identity: _Digest


class BoardInfo(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The content of ``board.toml``.

    Attributes:
        title: Title of the board.
        url: Address at which it can be read; empty if there is none yet.
        contact: Whom to write to.
        maintainers: Their names, for citations.
        licence: Licence under which submissions are published.
        benchmark: Name of the benchmark.
        protocol_version: Version of its protocol.
        protocol: Digest of that protocol.
        datasets: The datasets that it compares methods on.
    """

    title: str
    url: str
    contact: str
    maintainers: tuple[str, ...]
    licence: str
    benchmark: str
    protocol_version: int
    protocol: _Digest
    datasets: tuple[BoardDataset, ...]

    @property
    def rules(self) -> str:
        """Benchmark and protocol in words."""
        return f"{self.benchmark}, protocol version {self.protocol_version} ({self.protocol[:12]})"


class HistoryEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A line of ``history.jsonl``.

    Attributes:
        date: Day on which it happened, as the maintainer gave it.
        action: What was done.
        id: The submission.
        reason: Why it was withdrawn, or added again.
        name: Name of the added submission.
        submission: Digest of its ``submission.json``, which holds the digests of all its files.
        verification: Digest of what was verified of it, ``verification/ID.json``.
        motions: Digests of the motions of each of its runs that is no control.
    """

    date: str
    action: Literal["add", "withdraw"]
    id: Annotated[str, msgspec.Meta(pattern="^[a-z0-9][a-z0-9-]{0,80}-[0-9a-f]{10}$")]
    reason: _Text = ""
    name: _Text = ""
    submission: str = ""
    verification: str = ""
    motions: tuple[_Digest, ...] = ()

    @property
    def line(self) -> str:
        """The line without its end."""
        return msgspec.json.encode(self).decode()

    @classmethod
    def adding(cls, submission: Submission, verification: bytes, *, date: str, reason: str) -> HistoryEntry:
        """Return the entry for a verified submission."""
        motions = []
        for name, run in submission.runs.items():
            paths = [path for path in submission.members if re.match(f"runs/{re.escape(name)}/.*predictions/", path)]
            digests = sorted(submission.members[path] for path in paths)
            # Controls are the same for everybody, and a merged run has no motions of its own.
            if digests and run.method.kind != CONTROL and run.control is None:
                motions.append(text_digest(*digests))
        about = {"id": submission.id, "name": submission.name, "submission": submission.digest, "reason": reason}
        digest = bytes_digest(verification)
        return cls(**about, date=date, action="add", verification=digest, motions=tuple(sorted(motions)))

    def shared_with(self, other: HistoryEntry) -> str:
        """Return what the submission has in common with another: its files, its name, motions; empty for nothing."""
        if self.submission == other.submission:
            return "files"
        letters = ["".join(filter(str.isalnum, each.name.casefold())) for each in (self, other)]
        if letters[0] == letters[1]:
            return "name"
        return "motions" if set(self.motions) & set(other.motions) else ""


@dataclass(frozen=True)
class BoardFolder:
    """A board on disk.

    Attributes:
        path: The folder.
        info: The content of ``board.toml``.
        history: What was added and withdrawn, in order.
        standing: Maps the ids of the submissions that stand on the board to the entries that added them, sorted.
        withdrawn: Maps the ids of those that were withdrawn to the two entries that added and withdrew them, sorted.
    """

    path: Path
    info: BoardInfo
    history: tuple[HistoryEntry, ...]
    standing: dict[str, HistoryEntry]
    withdrawn: dict[str, tuple[HistoryEntry, HistoryEntry]]

    @classmethod
    @foreign_input()
    def open(cls, path: Path, more: tuple[HistoryEntry, ...] = ()) -> BoardFolder:
        """Read what a board is and what happened to it.

        Args:
            path: The folder.
            more: Entries that are going to stand behind those of ``history.jsonl``.

        Raises:
            InputFileError: if the folder holds no board, ``board.toml`` is damaged, or a line of ``history.jsonl`` is
                no entry or contradicts an earlier one; names the key or line.
        """
        values = read_toml(path / INFO, "a board", f"Make one with `prbench leaderboard init {path}`.")
        info = structured(path / INFO, values, BoardInfo)
        file = path / HISTORY
        # Not splitlines, which also splits at signs that a reason may hold.
        lines = list(filter(None, read_text(file).split("\n"))) if file.exists() else []
        entries: list[HistoryEntry] = []
        standing: dict[str, HistoryEntry] = {}
        withdrawn: dict[str, tuple[HistoryEntry, HistoryEntry]] = {}
        for number, line in enumerate(lines + [entry.line for entry in more], start=1):
            where = f"line {number}"
            remedy = "Keep the lines of both sides without it, and run `prbench leaderboard build`."
            marked = line.startswith(_MARKERS)
            require(file, (not marked, where, "an entry", "a merge conflict's marker", remedy))
            try:
                entry = msgspec.json.decode(line, type=HistoryEntry)
                Date.fromisoformat(entry.date)
            except (msgspec.DecodeError, ValueError) as error:
                raise InputFileError(file, where, expected="an entry", found=str(error), remedy=_AGAIN) from error
            stands = entry.id in standing
            if entry.action == "add":
                require(file, (not stands, where, f"a new submission {entry.id}", "it again", _AGAIN))
                standing[entry.id] = entry
                withdrawn.pop(entry.id, None)
            else:
                fits = stands and bool(entry.reason)
                require(file, (fits, where, "one that stands, and why it went", f"{entry.id}: {entry.reason}", _AGAIN))
                withdrawn[entry.id] = standing.pop(entry.id), entry
            entries.append(entry)
        return cls(path, info, tuple(entries), dict(sorted(standing.items())), dict(sorted(withdrawn.items())))

    @property
    def text(self) -> str:
        """The bytes of ``history.jsonl``."""
        return "".join(entry.line + "\n" for entry in self.history)

    def submission(self, name: str) -> Path:
        """Return the folder of a submission: what its archive held."""
        return self.path / SUBMISSIONS / name

    def verification(self, name: str) -> Path:
        """Return the file that says what was verified of a submission."""
        return self.path / VERIFICATION / f"{name}.json"
