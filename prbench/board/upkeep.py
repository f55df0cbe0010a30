"""What is done to a board: begun, added to, withdrawn from, rebuilt, checked.

The line in ``history.jsonl`` is written last when something comes and first when it goes. So a command that was killed
leaves a board without the submission, or with all of it, and does the rest when it is called again.
"""

from __future__ import annotations

import json
import os
import shutil
import stat
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path

import msgspec

import prbench
from prbench.board.folder import (
    ADD,
    HISTORY,
    INFO,
    SUBMISSIONS,
    VERIFICATION,
    WITHDRAW,
    BoardDataset,
    BoardFolder,
    BoardInfo,
    HistoryEntry,
    history_text,
)
from prbench.board.pages import CSV, PAGES, ROWS, has_rows, page_texts, read_verification, rows_table, write_pages
from prbench.board.submission import RUNS, Submission, open_submission, read_submission
from prbench.board.verifying import Verification, verify_submission
from prbench.engine import Engine
from prbench.errors import InputFileError, PrbenchError, RedistributionError, RunError, StorageError, UsageError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import (
    bytes_digest,
    remove_folder,
    sole_writer,
    text_digest,
    write_bytes,
    write_json,
    write_text,
)
from prbench.harness.benchmark import load_benchmark
from prbench.harness.controls import HOLDS_RECORDINGS
from prbench.harness.methods.installed import METHOD_CONTROLS
from prbench.harness.run_folder.folder import FOLDS_FILE, RunFolder
from prbench.harness.run_folder.record import CONTROL
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.protocol.own_protocol import read_protocol
from prbench.shown import clean, markdown

# Files that a board starts with, and their templates.
_FIRST_FILES = {
    "README.md": "README.md",
    ".gitattributes": "gitattributes",
    ".github/workflows/board.yml": "workflow.yml",
    ".github/ISSUE_TEMPLATE/submission.yml": "submission.yml",
}
# Other files that may lie in a board.
_OTHER_FILES = frozenset({"LICENSE", "CITATION.cff", ".gitignore"})
_GIT = ".git"


def begin_board(
    path: Path, data: Sequence[Path], *, benchmark: str, protocol: Path | None = None, **about: str | tuple[str, ...]
) -> BoardFolder:
    """Write ``board.toml`` and the files around it; files that stand there already are left as they are.

    Args:
        path: The folder, which may be a clone of a repository.
        data: Tables on which methods are going to be compared.
        benchmark: Name of the benchmark.
        protocol: File of a protocol of one's own; None for the benchmark's.
        about: Title, url, contact, maintainers and licence.

    Raises:
        TableError: if a table cannot be opened.
        StorageError: if another board stands there, or the folder cannot be written.
    """
    made = load_benchmark(benchmark)
    rules = made.present_rules if protocol is None else read_protocol(protocol)
    tables = [made.open_table(folder) for folder in data]
    datasets = [
        BoardDataset(
            name=table.info.dataset,
            title=table.info.title,
            redistribution=table.info.redistribution,
            identity=table.identity,
        )
        for table in tables
    ]
    info = BoardInfo(
        **about,
        benchmark=benchmark,
        protocol_version=rules.version,
        protocol=rules.digest,
        datasets=tuple(sorted(datasets, key=lambda each: each.name)),
    )
    with sole_writer(path):
        _clear_leftovers(path)
        if (path / INFO).exists() and BoardFolder.open(path).info != info:
            raise StorageError(f"{path / INFO}: another board stands there. Choose an empty folder, or edit that file.")
        values = {
            "title": markdown(info.title),
            "contact": markdown(info.contact or "no one is named"),
            # A text in double quotes is the same in YAML and JSON.
            "licence": json.dumps(clean(info.licence), ensure_ascii=False)[1:-1],
            "version": prbench.__version__,
        }
        for name, template in _FIRST_FILES.items():
            text = resources.files("prbench.board.templates").joinpath(f"{template}.template").read_text("utf-8")
            for key, value in values.items():
                text = text.replace(f"<<{key}>>", value)
            if not (path / name).exists():
                write_text(path / name, text)
        write_text(path / INFO, info.text)
        board = BoardFolder.open(path)
        write_pages(board)
    return board


def add_submission(
    path: Path, file: Path, data: Sequence[Path], *, date: str, reason: str = "", engine: Engine | None = None
) -> tuple[HistoryEntry, Verification]:
    """Verify a submission and add it to a board, whole or not at all.

    Args:
        path: The board.
        file: The submission, from a stranger.
        data: Tables of all its datasets.
        date: Today, as ``2026-01-31``.
        reason: Why a withdrawn submission comes back; stays in the history.
        engine: Processes that score.

    Returns:
        The new line of the history, and what was verified.

    Raises:
        InputFileError, RunError, PredictionsError: if the submission is damaged, hostile or not what it says.
        StorageError: if it or one of its name is on the board, or was withdrawn from it and no reason is given.
        RedistributionError: if it holds recorded motion that a licence keeps.
    """
    with sole_writer(path):
        board = BoardFolder.open(path)
        _clear_leftovers(path)
        arriving = path / SUBMISSIONS / ".arriving.partial"
        try:
            submission = open_submission(file, arriving)
            _require_new(board, submission, reason)
            for problem in submission_problems(board.info, submission, arriving):
                raise problem
            verification = verify_submission(submission, arriving, data, engine=engine)
            remove_folder(board.submission(submission.id))  # of a command that was killed
            arriving.replace(board.submission(submission.id))
        finally:
            shutil.rmtree(arriving, ignore_errors=True)
        write_json(board.verification(submission.id), msgspec.to_builtins(verification))
        entry = HistoryEntry(
            date=date,
            action=ADD,
            id=submission.id,
            reason=reason,
            name=submission.name,
            submission=submission.digest,
            verification=bytes_digest(read_whole(board.verification(submission.id))),
            motions=motions_of(submission),
        )
        board = replace(board, history=(*board.history, entry))
        write_pages(board)
        _write_history(path, board.history)
    return entry, verification


def withdraw_submission(path: Path, name: str, *, date: str, reason: str) -> HistoryEntry:
    """Take a submission from a board: its line and the reason stay, its motions go.

    Args:
        path: The board.
        name: Id of the submission, or its name.
        date: Today, as ``2026-01-31``.
        reason: Why.

    Raises:
        UsageError: if no submission of that id stands there, or no reason is given.
    """
    if not reason.strip():
        raise UsageError("--reason: expected why it is withdrawn, found nothing; the reason stays in the history.")
    with sole_writer(path):
        board = BoardFolder.open(path)
        _clear_leftovers(path)
        added = [entry.id for entry in board.history if entry.action == ADD and name in (entry.id, entry.name)]
        if not added:
            known = ", ".join(board.standing) or "none"
            raise UsageError(f"'{clean(name)}': expected a submission on the board, found none. There are: {known}.")
        name = added[-1]
        entry = board.withdrawn.get(name)
        if entry is None:
            entry = HistoryEntry(date=date, action=WITHDRAW, id=name, reason=reason)
            board = replace(board, history=(*board.history, entry))
            _write_history(path, board.history)
        elif entry.reason != reason:
            raise UsageError(f"{name} was withdrawn on {entry.date}: {clean(entry.reason)}. Reasons are not changed.")
        remove_folder(board.submission(name))
        board.verification(name).unlink(missing_ok=True)
        write_pages(board)
    return entry


def sound_board(path: Path) -> BoardFolder:
    """Open a board on which everything follows from its history.

    Raises:
        PrbenchError: if its files contradict its history; says the first contradiction.
    """
    board = BoardFolder.open(path)
    for problem in board_problems(board):
        raise problem
    return board


def build_board(path: Path) -> BoardFolder:
    """Make the pages of a board again from what stands in it.

    Raises:
        PrbenchError: see :func:`sound_board`.
    """
    with sole_writer(path):
        _clear_leftovers(path)
        board = sound_board(path)
        write_pages(board)
    return board


class BoardCheck(msgspec.Struct, frozen=True, kw_only=True):
    """What a check of a board found.

    Attributes:
        submissions: Number of submissions that stand on it.
        withdrawn: Number of those that were withdrawn.
        rescored: Ids of those whose motions were scored again.
        problems: What is wrong; empty for a sound board.
    """

    submissions: int
    withdrawn: int
    rescored: tuple[str, ...]
    problems: tuple[str, ...]


def check_board(
    path: Path, *, against: Path | None = None, data: Sequence[Path] = (), engine: Engine | None = None
) -> BoardCheck:
    """Look for anything on a board that no command of prbench has put there; changes nothing.

    Args:
        path: The board.
        against: The board before a change: its history may only have grown.
        data: Tables; submissions on them are scored again.
        engine: Processes that score.

    Raises:
        InputFileError: if the folder holds no board.
    """
    board = BoardFolder.open(path)
    found = list(board_problems(board))
    if against is not None and (against / INFO).is_file():
        found += list(_changed_since(board, BoardFolder.open(against)))
    if not found:
        found += list(_stale_pages(board))
    rescored = []
    at_hand = {load_benchmark(board.info.benchmark).open_table(folder).info.dataset for folder in data}
    for name in board.standing if not found else ():
        submission = read_submission(board.submission(name))
        if {table.dataset for run in submission.runs for table in run.tables} <= at_hand:
            try:
                again = verify_submission(submission, board.submission(name), data, engine=engine)
            except PrbenchError as error:
                found.append(error)
                continue
            rescored.append(name)
            if _means(again) != _means(read_verification(board.verification(name)), only=again):
                found.append(
                    RunError(f"{board.verification(name)}: expected what re-scoring finds, found other numbers.")
                )
    return BoardCheck(
        submissions=len(board.standing),
        withdrawn=len(board.withdrawn),
        rescored=tuple(rescored),
        problems=tuple(str(each) for each in found),
    )


def _means(verification: Verification, only: Verification | None = None) -> dict[str, object]:
    """Return training data and rounded means of a verification, of runs on the tables of another one alone."""
    tables = {each.content_digest for each in (only or verification).datasets}
    found: dict[str, object] = {"training": verification.training}
    for each in verification.datasets:
        if each.content_digest in tables:
            found[f"{each.run}/{each.dataset}"] = [
                (metric.metric, round(metric.rescored, 5)) for metric in each.metrics
            ]
    return found


def board_problems(board: BoardFolder) -> Iterator[PrbenchError]:
    """Yield what in the files of a board contradicts its history."""
    expected = {SUBMISSIONS: set(board.standing), VERIFICATION: {f"{name}.json" for name in board.standing}}
    for file, name, is_plain in _files(board.path):
        parts = name.split("/")
        if not is_plain:
            yield InputFileError(file, "", expected="a plain file", found="a link, or something else that is no file")
        elif parts[0] in expected and len(parts) > 1 and parts[1] in expected[parts[0]]:
            continue
        elif parts[0] in expected:
            remedy = "Add it with `prbench leaderboard add`, or delete it."
            yield InputFileError(file, "", expected="a submission that the history adds", found="none", remedy=remedy)
        elif name not in {INFO, HISTORY, *PAGES, *_FIRST_FILES, *_OTHER_FILES} and parts[0] != ".github":
            yield InputFileError(file, "", expected="a file of the board", found="a file that belongs to nothing in it")
    for name, entry in board.standing.items():
        folder = board.submission(name)
        try:
            submission = read_submission(folder)
            if (submission.id, submission.digest) != (name, entry.submission):
                raise RunError(f"{folder}: expected the submission that {HISTORY} adds, found another.")
            if bytes_digest(read_whole(board.verification(name))) != entry.verification:
                raise RunError(
                    f"{board.verification(name)}: expected what was verified on {entry.date}, found an edited file."
                )
            verification = read_verification(board.verification(name))
            covered = {(each.run, each.dataset) for each in verification.datasets}
            submitted = {(run.name, table.dataset) for run in submission.runs for table in run.tables}
            # A merged run has the motions of its folds, which are verified in its place.
            merged = {each for each in submitted if (folder / RUNS / each[0] / FOLDS_FILE).is_file()}
            if verification.digest != submission.digest or covered - merged != submitted - merged:
                raise RunError(f"{board.verification(name)}: expected what was verified of {folder}, found another.")
            if motions_of(submission) != entry.motions or submission.name != entry.name:
                raise RunError(f"{board.path / HISTORY}: expected name and motions of {name}, found others.")
            yield from submission_problems(board.info, submission, folder)
        except PrbenchError as error:
            yield error
        except OSError as error:
            yield RunError(f"{folder}: expected a submission that {HISTORY} adds, found {error.strerror}.")
    taken: dict[str, str] = {}
    for name, entry in board.standing.items():
        for key in _keys(entry.name, entry.motions):
            if key in taken:
                yield StorageError(
                    f"{board.submission(name)}: expected another name and other motions than {taken[key]} has."
                )
            taken[key] = name


def submission_problems(info: BoardInfo, submission: Submission, folder: Path) -> Iterator[PrbenchError]:
    """Yield why a submission cannot stand on a board.

    Args:
        info: What the board compares.
        submission: The submission.
        folder: Where it was unpacked.
    """
    ours = (info.benchmark, info.protocol)
    if (submission.benchmark, submission.protocol_digest) != ours:
        yield RunError(
            f"{folder}: expected runs of {info.benchmark} under the protocol {info.protocol[:12]}…, found"
            f" {clean(submission.benchmark)} under {submission.protocol_digest[:12]}…. Run the methods again."
        )
    datasets = {each.name: each for each in info.datasets}
    for described in submission.runs:
        run = RunFolder.open(folder / RUNS / described.name, any_benchmark=True)
        for table in described.tables:
            dataset = datasets.get(table.dataset)
            if dataset is None or dataset.identity != table.identity_digest:
                known = ", ".join(f"{each.name} {each.identity[:12]}…" for each in info.datasets)
                yield RunError(
                    f"{run.path}: expected runs on the board's tables ({known}), found {clean(table.dataset)}"
                    f" {table.identity_digest[:12]}…. Build the table again with the version of prbench of the board."
                )
                continue
            own = run.record.method.kind == CONTROL and run.record.method.name in HOLDS_RECORDINGS
            copies = DatasetSummary.read(run.dataset(table.dataset).path).hands_in_recordings
            if dataset.redistribution != "yes" and (own or copies) and dataset.name not in submission.permission:
                yield RedistributionError(
                    f"{run.path}: holds recorded motion of {dataset.title} ({dataset.name}), whose licence keeps it."
                    f" Submit without this run, or with --permission {dataset.name} if the licensor has given it."
                )


def motions_of(submission: Submission) -> tuple[str, ...]:
    """Return a digest of the motions of each run that is no control; controls are the same for everybody."""
    found = []
    for run in submission.runs:
        begin = f"{RUNS}/{run.name}/"
        digests = [
            each.sha256 for each in submission.members if each.path.startswith(begin) and "/predictions/" in each.path
        ]
        # A merged run has no motions of its own.
        if digests and run.method not in METHOD_CONTROLS and run.control is None:
            found.append(text_digest(*sorted(digests)))
    return tuple(sorted(found))


def _keys(name: str, motions: Sequence[str]) -> Iterator[str]:
    """Yield what no two submissions may share: the letters and digits of the name, and the motions of each run."""
    yield "".join(filter(str.isalnum, unicodedata.normalize("NFKC", name).casefold()))
    yield from motions


def _require_new(board: BoardFolder, submission: Submission, reason: str) -> None:
    """Refuse what stands on a board, takes a name from it, or was withdrawn and comes back without a word."""
    keys = set(_keys(submission.name, motions_of(submission)))
    for name, entry in board.standing.items():
        if submission.digest == entry.submission:
            raise StorageError(f"{board.submission(name)}: the board holds this very submission.")
        shared = keys.intersection(_keys(entry.name, entry.motions))
        if shared:
            what = "motions" if shared.intersection(entry.motions) else "name"
            raise StorageError(
                f"{board.submission(name)}: has the same {what} ({clean(entry.name)}). Withdraw it first, or submit"
                " under another name and without what stands there."
            )
    for name, entry in board.withdrawn.items():
        added = next(each for each in reversed(board.history) if each.id == name and each.action == ADD)
        if not reason and (submission.digest == added.submission or keys.intersection(added.motions)):
            raise StorageError(
                f"{name} was withdrawn on {entry.date}: {clean(entry.reason)}. If it comes back, say why: --reason."
            )


def _changed_since(board: BoardFolder, base: BoardFolder) -> Iterator[PrbenchError]:
    """Yield lines of an earlier history that are gone, and rules that changed together with the history."""
    lines = iter(board.history)
    for number, entry in enumerate(base.history, start=1):
        if entry not in lines:
            yield InputFileError(
                board.path / HISTORY,
                f"line {number} of {base.path / HISTORY}",
                expected=f"it to stay ({entry.action} {entry.id}); the history only grows",
                found="it edited, moved or gone",
            )
            return
    if len(board.history) == len(base.history):
        return
    for name in sorted({name for each in (base, board) for _, name, _ in _files(each.path)}):
        if name == INFO or name.startswith(".git"):
            before, after = ((each.path / name) for each in (base, board))
            if not (before.is_file() and after.is_file()) or read_whole(before) != read_whole(after):
                remedy = "Change it in a pull request of its own."
                yield InputFileError(
                    after, "", expected="it as before, where submissions come or go", found="it changed", remedy=remedy
                )


def _stale_pages(board: BoardFolder) -> Iterator[PrbenchError]:
    """Yield the pages that are not what the board makes of its submissions."""
    texts = page_texts(board)
    same = {
        name: (board.path / name).is_file() and read_whole(board.path / name) == text.encode()
        for name, text in texts.items()
    }
    same[ROWS] = has_rows(board.path / ROWS, rows_table(texts[CSV]))
    for name in (name for name, equal in same.items() if not equal):
        remedy = "Run `prbench leaderboard build` and commit what it writes; nobody edits pages."
        yield InputFileError(
            board.path / name, "", expected="what the submissions make of it", found="another page", remedy=remedy
        )


@foreign_input()
def _files(path: Path) -> Iterator[tuple[Path, str, bool]]:
    """Yield every file of a board but git's own: its path, its name in the board, and whether it is a plain file."""
    for folder, folders, files in os.walk(path):
        folders[:] = sorted(name for name in folders if (Path(folder) / name) != path / _GIT)
        for name in sorted([*files, *(each for each in folders if (Path(folder) / each).is_symlink())]):
            file = Path(folder) / name
            yield file, file.relative_to(path).as_posix(), stat.S_ISREG(file.lstat().st_mode)


def _clear_leftovers(path: Path) -> None:
    """Delete what a killed command has left half-written in a board."""
    for left in sorted(path.rglob(".*.partial*")):
        if left.relative_to(path).parts[0] == _GIT:
            continue
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)


def _write_history(path: Path, history: Sequence[HistoryEntry]) -> None:
    write_bytes(path / HISTORY, history_text(history).encode())
