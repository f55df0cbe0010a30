"""A submission: finished runs, who made them and what their methods learned from, in one file that anybody can verify.

The file is a ZIP archive (:mod:`prbench.files.archives`) of ``submission.json`` and the folders ``runs/NAME``. Unpacked
they are run folders as any others. ``submission.json`` names every file with its digest, so its own digest stands for
all of them, and it is what a submission is known by.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

import prbench
from prbench.board.collect import collect_runs, run_folders
from prbench.datasets import layout_of, readable_datasets
from prbench.errors import InputFileError, RunError, UsageError, did_you_mean
from prbench.files.archives import open_archive, write_archive
from prbench.files.bounded import foreign_input, read_toml, read_whole, require
from prbench.files.storage import atomic_folder, bytes_digest, file_digest, sole_writer
from prbench.harness.benchmark import CaseTable
from prbench.harness.controls import HOLDS_RECORDINGS
from prbench.harness.results import NOT_AT_HAND, RunChecker
from prbench.harness.run_folder.folder import MERGED, RunFolder
from prbench.harness.run_folder.record import CONTROL, RunRecord
from prbench.harness.run_folder.signature import SIGNATURE, SUMS, require_unchanged
from prbench.limits import HARMLESS_SIZE
from prbench.sequences.dataset_info import require_may_pass_on, run_notice
from prbench.shown import quoted

FILE_NAME = "submission.json"
RUNS = "runs"
_AGAIN = "Ask its authors for a file as `prbench leaderboard submit` writes it."
_PEOPLE = ("recording_id", "participant_id", "split")

_HEX = re.compile("[0-9a-f]{64}")
Digest = Annotated[str, msgspec.Meta(pattern=f"^{_HEX.pattern}$")]
# Text that people write about themselves, and that pages show.
Words = Annotated[str, msgspec.Meta(min_length=1, max_length=300, pattern=r"^[^\x00-\x1f\x7f-\x9f\u2028-\u202e]+$")]
RunName = Annotated[str, msgspec.Meta(pattern="^[A-Za-z0-9-]{1,80}$")]
Address = Annotated[str, msgspec.Meta(max_length=300, pattern=r"^https?://[^\s<>\"'`\\]+$")]


class TrainingDataset(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Recordings of one dataset that a method learned from.

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
        used = "all of it" if self.split == "all" else f"{self.split} split"
        if self.participants:
            used = f"participants {', '.join(self.participants)}"
        return f"{self.dataset} ({used})"


class TrainingData(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the methods of a submission learned from, as their authors declare it; empty where that is nothing.

    Attributes:
        datasets: Datasets of the benchmark.
        corpora: Names of other data, such as ``AMASS``.
        licence: Licence of the data, in words.
        recordings: SHA-256 of ``dataset/recording_id`` of recordings that were used, so that overlap with tested ones
            is found and no id has to be public.
    """

    datasets: tuple[TrainingDataset, ...] = ()
    corpora: tuple[Words, ...] = ()
    licence: Words | None = None
    recordings: tuple[Digest, ...] = ()

    @property
    def words(self) -> str:
        """The declaration in words, such as ``declared adt (train split), AMASS``."""
        named = [*(each.words for each in self.datasets), *self.corpora]
        if self.recordings and not self.datasets:
            named.append(f"{len(self.recordings)} recordings by their digests")
        return f"declared {', '.join(named) or 'none'}"

    def used(self, table: CaseTable) -> set[str]:
        """Return the recordings of a table that are declared, by their ids in the table."""
        dataset = table.info.dataset
        entries = [each for each in self.datasets if each.dataset == dataset]
        rows = table.runs if hasattr(table, "runs") else table.scalars(columns=_PEOPLE)
        found = set()
        for recording, participant, split in set(zip(*(rows[name].to_pylist() for name in _PEOPLE), strict=True)):
            named = any(
                participant in each.participants or (not each.participants and each.split in ("all", split))
                for each in entries
            )
            if named or _recording_digest(dataset, recording) in self.recordings:
                found.add(recording)
        return found

    def with_digests(self, tables: Iterable[CaseTable]) -> TrainingData:
        """Return the declaration with the digests of all recordings of some tables that it names."""
        digests = {_recording_digest(table.info.dataset, name) for table in tables for name in self.used(table)}
        return msgspec.structs.replace(self, recordings=tuple(sorted(digests.union(self.recordings))))


def _recording_digest(dataset: str, recording: str) -> str:
    return bytes_digest(f"{dataset}/{recording}".encode())


def declared_training(texts: Sequence[str]) -> TrainingData:
    """Return the declaration that ``--trained-on`` makes.

    Args:
        texts: ``none``, or datasets, each with a split or participants behind a colon; or one TOML file, whose keys
            are those of :class:`TrainingData`, and in which ``recordings`` may name them as ``dataset/recording_id``.

    Raises:
        UsageError: if ``none`` stands beside a dataset, a dataset is unknown, or the file holds other keys or values.
        InputFileError: if the file is missing or no TOML.
    """
    if list(texts) == ["none"]:
        return TrainingData()
    values: dict[str, Any] = {"datasets": []}
    if len(texts) == 1 and texts[0].endswith(".toml"):
        values = read_toml(Path(texts[0]), "a declaration of training data")
        if isinstance(names := values.get("recordings"), list):
            digests = (name if _HEX.fullmatch(name) else bytes_digest(name.encode()) for name in map(str, names))
            values["recordings"] = sorted(set(digests))
        texts = ()
    for text in texts:
        dataset, _, detail = text.partition(":")
        entry = {"dataset": dataset, "participants": detail.split(",")}
        if detail in ("", "train", "validation", "test", "all"):
            entry = {"dataset": dataset, "split": detail or "train"}
        values["datasets"].append(entry)
    try:
        training = msgspec.convert(values, TrainingData)
    except msgspec.ValidationError as error:
        raise UsageError(f"training data: {error}") from error
    known = readable_datasets()
    for name in (each.dataset for each in training.datasets):
        if layout_of(name) not in known:
            raise UsageError(
                f"training data: expected datasets among {', '.join(known)}, found {quoted(name)}."
                f"{did_you_mean(name, known)} Name other data in `corpora` of a TOML file."
            )
    return training


class Submission(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole of ``submission.json``. Holds no time of day, host or absolute path.

    Attributes:
        schema_version: Version of the form.
        prbench_version: Version of prbench that packed it.
        name: Name of the submission.
        authors: Names of the methods' authors.
        contact: How to reach them.
        url: Page of the method.
        paper: Address of the paper.
        code: Address of the code.
        training: What the methods learned from; None where nobody says.
        permission: Datasets whose recorded motion is in the submission by the authors' own word.
        benchmark: Name of the benchmark of all runs.
        protocol_digest: Digest of the rules by which all runs were scored.
        runs: Maps the name of each run, which is that of its folder below ``runs``, to its ``run.json``.
        members: Maps the path of each other file to the SHA-256 of its bytes.
        digest: SHA-256 of ``submission.json``, and so over everything; not written.
    """

    schema_version: Literal[1] = 1
    prbench_version: str
    name: Words
    authors: tuple[Words, ...] = ()
    contact: Words | None = None
    url: Address | None = None
    paper: Address | None = None
    code: Address | None = None
    training: TrainingData | None = None
    permission: tuple[Words, ...] = ()
    benchmark: str
    protocol_digest: str
    runs: Annotated[dict[RunName, RunRecord], msgspec.Meta(min_length=1)]
    members: dict[str, Digest]
    digest: str = ""

    @property
    def id(self) -> str:
        """Name of the submission's folder on a board."""
        return f"{_slug(self.name).lower()}-{self.digest[:10]}"

    @property
    def training_words(self) -> str:
        """What its methods learned from, in words."""
        return "not declared" if self.training is None else self.training.words

    @classmethod
    def decoded(cls, content: bytes, path: Path) -> Submission:
        """Take up the bytes of a stranger's ``submission.json``.

        Raises:
            InputFileError: if they hold something else.
        """
        try:
            submission = msgspec.json.decode(content, type=cls)
        except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
            expected = "the form of a submission"
            raise InputFileError(path, FILE_NAME, expected=expected, found=str(error), remedy=_AGAIN) from error
        return msgspec.structs.replace(submission, digest=bytes_digest(content))


def _slug(name: str) -> str:
    """Return a name that a folder can have on every system."""
    return re.sub(r"[^A-Za-z0-9]+", "-", name).strip("-")[:60] or "run"


def pack(
    paths: Iterable[Path],
    out: Path,
    *,
    checker: RunChecker,
    training: TrainingData | None = None,
    permitted: tuple[str, ...] = (),
    **about: Any,
) -> Submission:
    """Write a submission of finished runs, whole or not at all; equal runs give equal bytes.

    Args:
        paths: Run folders, or folders that hold some.
        out: The archive.
        checker: Verifies the runs, with or without their tables; from those that it has the digests of the recordings
            that training used are taken.
        training: What the methods learned from; None where nobody says.
        permitted: Datasets whose recorded motion may be passed on although the licence keeps it.
        about: Name, authors and addresses, as fields of :class:`Submission`.

    Raises:
        RunError: if a run is unfinished, edited, broken in itself, holds no motions, or is of another benchmark or
            protocol than the others.
        RedistributionError: if a run holds recorded motion that its licence keeps.
        UsageError: if what the authors say does not fit the form.
        StorageError: if the archive cannot be written.
    """
    named: dict[str, RunFolder] = {}
    for folder in run_folders(paths):
        # The merged run stands in the folder that people know; those on the folds beside it.
        name = _slug(folder.parent.name if folder.name == MERGED else folder.name)
        alike = sum(other.split("--")[0] == name for other in named)
        named[f"{name}--{alike + 1}" if alike else name] = RunFolder.open(folder, any_benchmark=True)
    collected = collect_runs([run.path for run in named.values()], check=checker.check, any_benchmark=True)
    unverified = [row for row in collected.rows if row.unverified and NOT_AT_HAND not in row.unverified]
    problems = [*collected.left_out, *(f"{row.run}: {row.unverified}" for row in unverified)]
    if problems:
        raise RunError(f"expected finished runs with their motions, found others. {'; '.join(problems)}.")
    for row in collected.rows:
        # Motions of a method are its own; those of some controls are people's.
        holds = row.record.method.kind == CONTROL and row.method in HOLDS_RECORDINGS
        if holds or row.summary.hands_in_recordings:
            what = f"the motions of '{row.method}' in a submission"
            require_may_pass_on(row.table, what, permitted, published=True)
    files: dict[str, Path] = {}
    for name, run in sorted(named.items()):
        require_unchanged(run)
        files |= {f"{RUNS}/{name}/{path.relative_to(run.path).as_posix()}": path for path in _files_of(run)}
    rules = {(run.record.benchmark, run.record.protocol_digest) for run in named.values()}
    if len(rules) > 1:
        found = ", ".join(f"{benchmark} {digest[:12]}…" for benchmark, digest in sorted(rules))
        expected = "runs of one benchmark and protocol"
        raise RunError(f"expected {expected}, found {found}. Submit them in files of their own.")
    ((benchmark, protocol_digest),) = rules
    if training is not None:
        tables = (checker.find_table(table) for run in named.values() for table in run.record.tables)
        training = training.with_digests(table for table in tables if table is not None)
    values = {key: value for key, value in about.items() if value is not None}
    values |= {"prbench_version": prbench.__version__, "benchmark": benchmark, "protocol_digest": protocol_digest}
    values |= {"training": training, "permission": permitted}
    values["runs"] = {name: msgspec.to_builtins(run.record) for name, run in sorted(named.items())}
    values["members"] = {name: file_digest(path) for name, path in files.items()}
    content = json.dumps(msgspec.to_builtins(values), indent=1, sort_keys=True).encode() + b"\n"
    try:
        submission = Submission.decoded(content, out)
    except InputFileError as error:  # the rest of it is prbench's own
        raise UsageError(f"what authors say of a submission: {error.found}.") from error
    with sole_writer(out):
        write_archive(out, {FILE_NAME: content, **files})
    return submission


def _files_of(run: RunFolder) -> list[Path]:
    """Return the files of a run that a submission holds."""
    beside = [run.path / SUMS, run.path / SIGNATURE]
    beside += [run.dataset(table.dataset).notice for table in run.record.tables]
    return [*run.files, *(path for path in beside if path.is_file())]


def open_submission(path: Path, folder: Path) -> Submission:
    """Unpack a submission into a folder that appears whole or not at all.

    Args:
        path: The archive, from a stranger.
        folder: The folder, which is replaced if it exists; run folders stand in ``runs`` of it.

    Raises:
        InputFileError: if it is no such archive, is damaged or hostile, or holds other files than it lists.
        StorageError: if the folder cannot be written.
    """
    with open_archive(path) as archive, atomic_folder(folder) as temporary:
        for name in archive.namelist():
            target = temporary / name  # every name was found to stay inside, and to be there once
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(name) as source, open(target, "xb") as file:
                shutil.copyfileobj(source, file)
        return read_submission(temporary, shown=path)


@foreign_input()
def read_submission(folder: Path, *, shown: Path | None = None) -> Submission:
    """Read an unpacked submission and hold every file against its digest, every run against its description.

    Args:
        folder: The folder.
        shown: Its name in messages; its own by default.

    Raises:
        InputFileError: if a file is missing, changed, not listed, no file of a run, or no plain file.
        RunError: if a run is damaged.
    """
    path = shown or folder
    there = [file for file in folder.rglob("*") if file.is_symlink() or not file.is_dir()]
    names = {file.relative_to(folder).as_posix() for file in there}
    links = sorted(file.name for file in there if file.is_symlink())
    require(
        path,
        (not links, ", ".join(links), "plain files", "a link", _AGAIN),
        (FILE_NAME in names, "", f"a submission (with {FILE_NAME})", "none", _AGAIN),
    )
    content = read_whole(folder / FILE_NAME, largest=HARMLESS_SIZE)
    submission = Submission.decoded(content, path)
    for name in sorted((names - {FILE_NAME}) ^ set(submission.members)):
        found = "one more" if name in names else "no such file"
        require(path, (False, name, f"the files that {FILE_NAME} lists", found, _AGAIN))
    for name, digest in submission.members.items():
        expected = f"the SHA-256 {digest[:12]}…, as {FILE_NAME} lists it"
        found = file_digest(folder / name)
        require(path, (found == digest, name, expected, f"{found[:12]}…: the file was changed", _AGAIN))
    known: set[str] = set()
    for name, record in submission.runs.items():
        run = RunFolder.open(folder / RUNS / name, any_benchmark=True)
        same = run.record == record and run.path == folder / RUNS / name
        once = len({table.dataset for table in record.tables}) == len(record.tables)
        rules = (record.benchmark, record.protocol_digest) == (submission.benchmark, submission.protocol_digest)
        require(
            path,
            (same, f"run {name}", f"the run.json that {FILE_NAME} holds", "another", _AGAIN),
            (once, f"run {name}", "each dataset once", "one twice", _AGAIN),
            (rules, f"run {name}", "the benchmark and protocol of the submission", "others", _AGAIN),
        )
        require_unchanged(run)
        for table in record.tables:
            notice = run.dataset(table.dataset).notice
            texts = [run_notice(table, recorded_motion=each).encode() for each in (False, True)]
            plain = not notice.is_file() or read_whole(notice, largest=HARMLESS_SIZE) in texts
            require(path, (plain, f"run {name}, {notice.name}", "the notice of prbench", "another text", _AGAIN))
        known.update(file.relative_to(folder).as_posix() for file in _files_of(run))
    for name in submission.members:
        require(path, (name in known, name, "files of runs", "a file that no run has", _AGAIN))
    return submission
