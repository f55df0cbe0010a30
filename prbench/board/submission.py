"""A submission: finished runs, who made them and what their method learned from, in one file that anybody can verify.

The file is a ZIP archive (:mod:`prbench.files.archives`) of ``submission.json`` and the folders ``runs/NAME``. Unpacked
they are run folders as any others. ``submission.json`` names every file with its digest, so its own digest stands for
all of them, and it is what a submission is known by.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec

import prbench
from prbench.board.collect import collect_runs, run_folders
from prbench.errors import InputFileError, RunError
from prbench.files.archives import open_archive, write_archive
from prbench.files.bounded import foreign_input, read_whole, require
from prbench.files.storage import atomic_folder, bytes_digest, file_digest, sole_writer
from prbench.harness.results import NOT_AT_HAND, CheckedSummary
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.folder import MERGED, RunFolder
from prbench.harness.run_folder.record import RunRecord, TableRecord
from prbench.harness.run_folder.signature import SIGNATURE, SUMS
from prbench.limits import HARMLESS_SIZE

FILE_NAME = "submission.json"
SUFFIX = ".prbench.zip"
RUNS = "runs"
_AGAIN = "Ask its authors for a file as `prbench leaderboard submit` writes it."

Digest = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
# Text that people write about themselves; it is shown on pages.
Words = Annotated[str, msgspec.Meta(min_length=1, max_length=300)]
Address = Annotated[str, msgspec.Meta(max_length=300, pattern=r"^https?://[^\s<>\"'`\\]+$")]


class TrainingDataset(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Recordings of one of the benchmark's datasets that a method learned from.

    Attributes:
        dataset: Name of the dataset.
        participants: Ids of the participants whose recordings were used, in whatever split; empty for a whole split.
        split: The split that was used where no participants are named; ``all`` for the whole dataset.
    """

    dataset: Words
    participants: tuple[Words, ...] = ()
    split: Literal["train", "validation", "test", "all"] = "train"

    @property
    def words(self) -> str:
        """What was used, in words."""
        if self.participants:
            return f"{self.dataset} (participants {', '.join(self.participants)})"
        return f"{self.dataset} ({'all of it' if self.split == 'all' else f'{self.split} split'})"


class TrainingData(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the methods of a submission learned from, as their authors declare it; all empty where that is nothing.

    Attributes:
        datasets: Datasets of the benchmark.
        corpora: Names of other data, such as ``AMASS``.
        licence: Licence of the data, in words.
        recordings: SHA-256 of ``dataset/recording_id`` of each recording that is known to have been used, so that
            overlap with tested ones is found and no id has to be public; sorted.
    """

    datasets: tuple[TrainingDataset, ...] = ()
    corpora: tuple[Words, ...] = ()
    licence: Words | None = None
    recordings: tuple[Digest, ...] = ()

    @property
    def words(self) -> str:
        """The declaration in words, such as ``declared adt (train split), AMASS``."""
        named = [*(each.words for each in self.datasets), *self.corpora]
        if self.recordings:
            named.append(f"{len(self.recordings)} recordings by their digests")
        return f"declared {', '.join(named) or 'none'}"


class SubmittedTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The part of a run on one dataset.

    Attributes:
        dataset: Name of the dataset.
        identity_digest: Digest of the ids of its table, which everybody with the same licensed data shares.
        sequences: Number of sequences that were scored.
    """

    dataset: str
    identity_digest: str
    sequences: int


class SubmittedRun(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One run of a submission.

    Attributes:
        name: Name of its folder below ``runs``.
        method: Name of its method.
        condition: What the method was given.
        control: ``shuffled-goal``, or null.
        tables: Its datasets.
    """

    name: str
    method: str
    condition: str
    control: str | None
    tables: tuple[SubmittedTable, ...]

    @classmethod
    def of(cls, name: str, run: RunRecord) -> SubmittedRun:
        """Describe a run by its record."""
        tables = tuple(
            SubmittedTable(
                dataset=table.dataset,
                identity_digest=table.identity_digest,
                sequences=table.sequences - table.unsupported,
            )
            for table in run.tables
        )
        return cls(name=name, method=run.method.name, condition=run.condition, control=run.control, tables=tables)


class Member(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One file of a submission.

    Attributes:
        path: Its place in the archive.
        size: Bytes.
        sha256: Digest of its bytes.
    """

    path: str
    size: int
    sha256: Digest


class About(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What authors say of a submission.

    Attributes:
        name: Name of the submission.
        authors: Names of the method's authors.
        contact: How to reach them.
        url: Page of the method.
        paper: Address of the paper.
        code: Address of the code.
        permission: Datasets whose recorded motion the authors may pass on by their own word, although its licence
            keeps it.
        training: What the methods learned from; None where nobody says.
    """

    name: Words
    authors: tuple[Words, ...] = ()
    contact: Words | None = None
    url: Address | None = None
    paper: Address | None = None
    code: Address | None = None
    permission: tuple[Words, ...] = ()
    training: TrainingData | None = None


class Submission(About, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole of ``submission.json``. Holds no time of day, host or absolute path.

    Attributes:
        schema_version: Version of the form.
        prbench_version: Version of prbench that packed it.
        benchmark: Name of the benchmark of all runs.
        protocol_digest: Digest of the rules by which all runs were scored.
        runs: The runs, by name.
        members: All other files of the submission, by path.
    """

    schema_version: Literal[1] = 1
    prbench_version: str
    benchmark: str
    protocol_digest: str
    runs: Annotated[tuple[SubmittedRun, ...], msgspec.Meta(min_length=1)]
    members: tuple[Member, ...]

    @property
    def encoded(self) -> bytes:
        """The bytes of ``submission.json``."""
        return json.dumps(msgspec.to_builtins(self), indent=1, sort_keys=True, ensure_ascii=True).encode() + b"\n"

    @property
    def digest(self) -> str:
        """SHA-256 over ``submission.json`` and so over every file."""
        return bytes_digest(self.encoded)

    @property
    def id(self) -> str:
        """Name of the submission's folder on a board."""
        return f"{slug(self.name).lower()}-{self.digest[:10]}"

    @property
    def training_words(self) -> str:
        """What its methods learned from, in words."""
        return "not declared" if self.training is None else self.training.words


def recording_digest(name: str) -> str:
    """Return what stands for a recording, ``dataset/recording_id``, where its id need not be public."""
    return bytes_digest(name.encode())


def slug(name: str) -> str:
    """Return a name that a folder can have on every system."""
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")[:60] or "run"


def pack(
    paths: Iterable[Path],
    out: Path,
    about: About,
    *,
    check: Callable[[RunFolder, TableRecord], CheckedSummary],
) -> Submission:
    """Write a submission of finished runs, whole or not at all; equal runs give equal bytes.

    Args:
        paths: Run folders, or folders that hold some.
        out: The archive.
        about: What the authors say.
        check: Verifies a run, with or without its tables.

    Raises:
        RunError: if a run is unfinished, edited, broken in itself, holds no motions, or is of another benchmark or
            protocol than the others.
        StorageError: if the archive cannot be written.
    """
    named = _named(run_folders(paths))
    collected = collect_runs([run.path for run in named.values()], check=check, any_benchmark=True)
    problems = list(collected.left_out)
    problems += [
        f"{row.run}: {row.unverified}" for row in collected.rows if NOT_AT_HAND not in (row.unverified or NOT_AT_HAND)
    ]
    if problems:
        raise RunError(f"expected finished runs with their motions, found others. {'; '.join(problems)}.")
    first = next(iter(named.values())).record
    for run in named.values():
        for key in ("benchmark", "protocol_digest"):
            expected = getattr(first, key)
            found = getattr(run.record, key)
            if found != expected:
                raise RunError(
                    f"{run.path / run_record.FILE_NAME}, {key}: expected {expected}, as the other runs have it, found"
                    f" {found}. Submit runs of different benchmarks or protocols in files of their own."
                )
    files: dict[str, Path | bytes] = {}
    for name, run in named.items():
        signed = (path for file in (SUMS, SIGNATURE) if (path := run.path / file).is_file())
        notices = (own.notice for table in run.record.tables if (own := run.dataset(table.dataset)).notice.is_file())
        for path in (*run.files, *signed, *notices):
            files[f"{RUNS}/{name}/{path.relative_to(run.path).as_posix()}"] = path
    files = dict(sorted(files.items()))
    submission = Submission(
        **{field: getattr(about, field) for field in About.__struct_fields__},
        prbench_version=prbench.__version__,
        benchmark=first.benchmark,
        protocol_digest=first.protocol_digest,
        runs=tuple(SubmittedRun.of(name, run.record) for name, run in named.items()),
        members=tuple(
            Member(path=name, size=path.stat().st_size, sha256=file_digest(path))
            for name, path in files.items()
            if isinstance(path, Path)
        ),
    )
    with sole_writer(out):
        write_archive(out, {FILE_NAME: submission.encoded, **files})
    return submission


def _named(folders: Sequence[Path]) -> dict[str, RunFolder]:
    """Open runs and give each a name of its own: that of its folder, or of the folder of a run on all folds."""
    named: dict[str, RunFolder] = {}
    for folder in folders:
        name = slug(folder.parent.name if folder.name == MERGED else folder.name)
        number = sum(other.rpartition("--")[0] == name or other == name for other in named)
        named[f"{name}--{number + 1}" if number else name] = RunFolder.open(folder, any_benchmark=True)
    return dict(sorted(named.items()))


def open_submission(path: Path, folder: Path) -> Submission:
    """Unpack a submission into a folder that appears whole or not at all.

    Args:
        path: The archive, from a stranger.
        folder: The folder, which must not exist yet or is replaced; run folders stand in ``runs`` of it.

    Raises:
        InputFileError: if it is no such archive, is damaged or hostile, or holds other files than it lists.
        StorageError: if the folder cannot be written.
    """
    with open_archive(path) as archive:
        if FILE_NAME not in archive.members:
            raise InputFileError(path, "", expected=f"a submission (with {FILE_NAME})", found="none", remedy=_AGAIN)
        submission = _decoded(archive.read(FILE_NAME), path)
        _require_listed(path, submission, {name: info.file_size for name, info in archive.members.items()})
        with atomic_folder(folder) as temporary:
            for member in submission.members:
                _require_digest(path, member, archive.unpack(member.path, temporary))
            (temporary / FILE_NAME).write_bytes(submission.encoded)
            _require_run_files(path, submission, temporary)
    return submission


def read_submission(folder: Path) -> Submission:
    """Read an unpacked submission and compare every file with its digest.

    Raises:
        InputFileError: if a file is missing, changed, or not listed.
    """
    with foreign_input(folder):
        submission = _decoded(read_whole(folder / FILE_NAME, largest=HARMLESS_SIZE), folder / FILE_NAME)
        there = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if not path.is_dir()}
        _require_listed(folder, submission, {name: path.lstat().st_size for name, path in there.items()})
        for member in submission.members:
            _require_digest(folder, member, file_digest(there[member.path]))
    return submission


def _decoded(content: bytes, path: Path) -> Submission:
    try:
        submission = msgspec.json.decode(content, type=Submission)
    except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
        raise InputFileError(
            path, FILE_NAME, expected="the form of a submission", found=str(error), remedy=_AGAIN
        ) from error
    same = submission.encoded == content
    require(path, (same, FILE_NAME, "the bytes that prbench writes for these values", "others", _AGAIN))
    return submission


def _require_listed(path: Path, submission: Submission, sizes: dict[str, int]) -> None:
    """Refuse files that the list does not name, or that it names and that are missing or of another size."""
    listed = {member.path: member.size for member in submission.members}
    there = {name: size for name, size in sizes.items() if name != FILE_NAME}
    once = len(listed) == len(submission.members) and FILE_NAME not in listed
    require(path, (once, f"{FILE_NAME}, members", "each file once", "a repeated one", _AGAIN))
    for name in sorted(listed | there):
        expected = (
            f"{listed[name]:,} bytes, as {FILE_NAME} says" if name in listed else f"only files that {FILE_NAME} lists"
        )
        found = f"{there[name]:,} bytes" if name in there else "no such file"
        require(path, (listed.get(name) == there.get(name), name, expected, found, _AGAIN))


def _require_digest(path: Path, member: Member, found: str) -> None:
    expected = f"the file with the SHA-256 {member.sha256[:12]}…, as {FILE_NAME} says"
    require(path, (found == member.sha256, member.path, expected, f"{found[:12]}…: it was changed", _AGAIN))


def _require_run_files(path: Path, submission: Submission, folder: Path) -> None:
    """Refuse files that no run has, and runs that are not those that the submission describes."""
    known: set[str] = set()
    for described in submission.runs:
        run = RunFolder.open(folder / RUNS / described.name, any_benchmark=True)
        found = SubmittedRun.of(described.name, run.record)
        where = f"{RUNS}/{described.name}/{run_record.FILE_NAME}"
        require(
            path,
            (found == described, where, f"the run that {FILE_NAME} describes", "another one", _AGAIN),
            (run.record.benchmark == submission.benchmark, where, submission.benchmark, run.record.benchmark, _AGAIN),
            (run.record.protocol_digest == submission.protocol_digest, where, "its protocol", "another one", _AGAIN),
        )
        beside = [run.path / SUMS, run.path / SIGNATURE]
        beside += [run.dataset(table.dataset).notice for table in run.record.tables]
        known.update(file.relative_to(folder).as_posix() for file in (*run.files, *beside))
    for member in submission.members:
        require(path, (member.path in known, member.path, "files of runs", "a file that no run has", _AGAIN))
