"""What is done to a board: begun, added to, withdrawn from, rebuilt, checked.

The line in ``history.jsonl`` is written last when something comes and first when it goes. So a command that was killed
leaves a board without the submission, or with all of it, and does the rest when it is called again.
"""

from __future__ import annotations

import json
import os
import shutil
import stat
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

import prbench
from prbench.board.folder import HISTORY, INFO, BoardDataset, BoardFolder, BoardInfo, HistoryEntry
from prbench.board.pages import PAGES, Standing, pages_of
from prbench.board.submission import RUNS, Submission, open_submission, read_submission
from prbench.board.verifying import Verification, verify_submission
from prbench.engine import Engine
from prbench.errors import PrbenchError, RunError, StorageError, UsageError
from prbench.files.bounded import read_whole
from prbench.files.storage import file_digest, remove_folder, sole_writer, write_bytes, write_json, write_text
from prbench.harness.benchmark import load_benchmark
from prbench.harness.controls import HOLDS_RECORDINGS
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import CONTROL
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.sequences.dataset_info import require_may_pass_on
from prbench.shown import clean, markdown

# Files that a board starts with, and their templates.
_FIRST_FILES = {
    "README.md": "README.md",
    ".gitattributes": "gitattributes",
    ".github/workflows/board.yml": "workflow.yml",
    ".github/ISSUE_TEMPLATE/submission.yml": "submission.yml",
}
# All files at the top of a board.
_KNOWN = frozenset({INFO, HISTORY, *PAGES, *_FIRST_FILES, "LICENSE", "CITATION.cff", ".gitignore", ".git"})


def begin_board(path: Path, data: Sequence[Path], *, benchmark: str, **about: Any) -> BoardFolder:
    """Write ``board.toml`` and the files around it; files that stand there already are left as they are.

    Args:
        path: The folder, which may be a clone of a repository.
        data: Tables on which methods are going to be compared.
        benchmark: Name of the benchmark.
        about: Title, url, contact, maintainers and licence.

    Raises:
        TableError: if a table cannot be opened.
        UsageError: if two are of one dataset.
        StorageError: if another board stands there, or the folder cannot be written.
    """
    made = load_benchmark(benchmark)
    datasets = []
    for table in map(made.open_table, data):
        terms = {name: getattr(table.info, name) for name in ("dataset", "title", "redistribution")}
        datasets.append(BoardDataset(**terms, identity=table.identity))
    if len({each.dataset for each in datasets}) < len(datasets):
        raise UsageError(f"--data: expected each dataset once, found {', '.join(each.dataset for each in datasets)}.")
    about |= {"protocol_version": made.present_rules.version, "protocol": made.present_rules.digest}
    ordered = tuple(sorted(datasets, key=lambda each: each.dataset))
    info = BoardInfo(**about, benchmark=benchmark, datasets=ordered)
    # A text in double quotes is the same in YAML and JSON.
    quoted_licence = json.dumps(clean(info.licence), ensure_ascii=False)[1:-1]
    values = {"title": markdown(info.title), "contact": markdown(info.contact or "nobody is named")}
    values |= {"licence": quoted_licence, "version": prbench.__version__}
    with sole_writer(path):
        _clear_leftovers(path)
        if (path / INFO).exists() and BoardFolder.open(path).info != info:
            raise StorageError(f"{path / INFO}: another board stands there. Choose an empty folder, or edit that file.")
        for name, template in _FIRST_FILES.items():
            text = resources.files("prbench.board.templates").joinpath(f"{template}.template").read_text("utf-8")
            for key, value in values.items():
                text = text.replace(f"<<{key}>>", value)
            if not (path / name).exists():
                write_text(path / name, text)
        write_text(path / INFO, tomli_w.dumps(msgspec.to_builtins(info)))
        return _with_pages(BoardFolder.open(path))


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
        StorageError: if it, its name or its motions are on the board, or were withdrawn and no reason is given.
        RedistributionError: if it holds recorded motion that a licence keeps.
    """
    with sole_writer(path):
        board = BoardFolder.open(path)
        _clear_leftovers(path)
        arriving = board.submission(".arriving.partial")
        try:
            submission = open_submission(file, arriving)
            draft = HistoryEntry.adding(submission, b"", date=date, reason=reason)
            # Refuse what stands on a board, takes a name from it, or was withdrawn and comes back without a word.
            for other in board.standing.values():
                if shared := draft.shared_with(other):
                    remedy = "Withdraw it first, or submit something else."
                    raise StorageError(f"{board.submission(other.id)}: has the same {shared}. {remedy}")
            for added, gone in board.withdrawn.values():
                if draft.shared_with(added) in ("files", "motions") and not draft.reason:
                    when = f"{gone.id} was withdrawn on {gone.date}: {clean(gone.reason)}"
                    raise StorageError(f"{when}. Say why it returns: --reason.")
            BoardFolder.open(path, (draft,))  # what could not be read again is refused before it is written
            _require_fitting(board.info, submission, arriving)
            verification = verify_submission(submission, arriving, data, engine=engine)
            remove_folder(board.submission(submission.id))  # of a command that was killed
            arriving.replace(board.submission(submission.id))
        finally:
            shutil.rmtree(arriving, ignore_errors=True)
        write_json(board.verification(submission.id), msgspec.to_builtins(verification))
        verified = read_whole(board.verification(submission.id))
        entry = HistoryEntry.adding(submission, verified, date=date, reason=reason)
        board = _with_pages(BoardFolder.open(path, (entry,)))
        write_text(path / HISTORY, board.text)
    return entry, verification


def withdraw_submission(path: Path, name: str, *, date: str, reason: str) -> HistoryEntry:
    """Take a submission from a board: its line and the reason stay, its motions go.

    Args:
        path: The board.
        name: Id of the submission, or its name.
        date: Today, as ``2026-01-31``.
        reason: Why.

    Raises:
        UsageError: if there is no such submission, it was withdrawn for another reason, or no reason is given.
    """
    with sole_writer(path):
        board = BoardFolder.open(path)
        _clear_leftovers(path)
        ids = [entry.id for entry in board.history if name in (entry.id, entry.name)]
        if not ids:
            known = ", ".join(board.standing) or "none"
            raise UsageError(f"{path}: there is no submission '{clean(name)}' to withdraw. Those that stand: {known}.")
        if not reason.strip():
            raise UsageError("--reason: expected why it is withdrawn, found nothing; the reason stays in the history.")
        entry = HistoryEntry(date=date, action="withdraw", id=ids[-1], reason=reason)
        if entry.id in board.standing:
            board = BoardFolder.open(path, (entry,))
            write_text(path / HISTORY, board.text)
        gone = board.withdrawn[entry.id][1]
        if gone.reason != reason:
            raise UsageError(f"{gone.id} was withdrawn on {gone.date}: {clean(gone.reason)}. A reason is not changed.")
        remove_folder(board.submission(gone.id))
        board.verification(gone.id).unlink(missing_ok=True)
        _with_pages(board)
    return gone


def sound_board(path: Path) -> BoardFolder:
    """Open a board on which everything follows from its history.

    Raises:
        RunError: if its files contradict its history; says the first contradiction.
        InputFileError: if the folder holds no board.
    """
    board = BoardFolder.open(path)
    for problem in board_problems(board):
        raise RunError(problem)
    return board


def build_board(path: Path) -> BoardFolder:
    """Make the pages of a board again from what stands in it; see :func:`sound_board` for what it raises."""
    with sole_writer(path):
        _clear_leftovers(path)
        return _with_pages(sound_board(path))


class BoardCheck(msgspec.Struct, frozen=True, kw_only=True):
    """What a check of a board found.

    Attributes:
        submissions: Number of submissions that stand on it.
        withdrawn: Number of those that were withdrawn.
        rescored: Ids of those whose motions were scored again.
        believed: Ids of those that are new, and whose verification nothing here has shown: score them before a merge.
        problems: What is wrong; empty for a sound board.
    """

    submissions: int
    withdrawn: int
    rescored: tuple[str, ...]
    believed: tuple[str, ...]
    problems: tuple[str, ...]


def check_board(
    path: Path, *, against: Path | None = None, data: Sequence[Path] = (), engine: Engine | None = None
) -> BoardCheck:
    """Look for anything on a board that no command of prbench has put there; changes nothing.

    Args:
        path: The board.
        against: The board before a change: its history may only have grown, by the same rules.
        data: Tables; submissions on them are scored again.
        engine: Processes that score.

    Raises:
        InputFileError: if the folder holds no board.
    """
    board = BoardFolder.open(path)
    problems = list(board_problems(board))
    known = dict(board.standing)
    if against is not None and (against / INFO).is_file():
        base = BoardFolder.open(against)
        known = base.standing
        lines = iter(board.history)
        if not all(entry in lines for entry in base.history):
            problems.append(f"{path / HISTORY}: expected every line of {against / HISTORY} in its order, found others.")
        if len(board.history) > len(base.history) and _rules_of(board) != _rules_of(base):
            expected = f"the same {INFO} and .github where submissions come or go"
            problems.append(f"{path}: expected {expected}, found others. Change them in a pull request of their own.")
    elif against is not None:
        known = {}
    rescored = []
    if not problems:
        wanted = pages_of(board)
        stale = [name for name in PAGES if not (path / name).is_file() or read_whole(path / name) != wanted[name]]
        problems += [f"{path / name}: is not made of the submissions; `prbench leaderboard build`." for name in stale]
        benchmark = load_benchmark(board.info.benchmark)
        at_hand = {benchmark.open_table(folder).info.dataset for folder in data}
        for name in board.standing:
            found = Standing.read(board, name)
            if {table.dataset for run in found.stated.runs.values() for table in run.tables} <= at_hand:
                rescored.append(name)
                try:
                    again = verify_submission(found.stated, board.submission(name), data, engine=engine)
                    _require_as_stored(again, found.verified, board.verification(name))
                except PrbenchError as error:
                    problems.append(str(error))
    counts = {"submissions": len(board.standing), "withdrawn": len(board.withdrawn)}
    believed = tuple(name for name in board.standing if name not in {*known, *rescored})
    return BoardCheck(**counts, rescored=tuple(rescored), believed=believed, problems=tuple(problems))


def _rules_of(board: BoardFolder) -> tuple[BoardInfo, dict[str, str]]:
    """Return what decides how a board is kept, and what runs in its repository."""
    files = (path for path in (board.path / ".github").rglob("*") if path.is_file())
    return board.info, {path.relative_to(board.path).as_posix(): file_digest(path) for path in files}


def _require_as_stored(again: Verification, stored: Verification, path: Path) -> None:
    """Refuse an edited verification: what it says in words, and all that it says if the tables are the same."""
    told = [(each.run, each.dataset, each.content_digest, each.declared) for each in again.datasets]
    stated = [(each.run, each.dataset, each.content_digest, each.declared) for each in stored.datasets]
    same_tables = [each[2] for each in told] == [each[2] for each in stated]
    if again.training != stored.training or (same_tables and (told, again.verdict) != (stated, stored.verdict)):
        expected = f"'{again.training}; {again.verdict}', which scoring again finds"
        raise RunError(f"{path}: expected {expected}, found others. It was edited.")


def board_problems(board: BoardFolder) -> Iterator[str]:
    """Yield what in the files of a board contradicts its history."""
    known = {*(board.path / name for name in _KNOWN), *map(board.verification, board.standing)}
    folders = {board.path / ".github", *map(board.submission, board.standing)}
    for folder, below, files in os.walk(board.path):
        if Path(folder) == board.path and ".git" in below:
            below.remove(".git")
        for file in sorted(Path(folder) / name for name in [*files, *below]):
            mode = file.lstat().st_mode
            if stat.S_ISDIR(mode):
                continue
            if not stat.S_ISREG(mode):
                yield f"{file}: expected a plain file, found a link or a device."
            elif file not in known and folders.isdisjoint(file.parents):
                yield f"{file}: belongs to nothing on the board. Add it with `prbench leaderboard add`, or delete it."
    for name, entry in board.standing.items():
        try:
            submission = read_submission(board.submission(name))
            verified = read_whole(board.verification(name))
            if HistoryEntry.adding(submission, verified, date=entry.date, reason=entry.reason) != entry:
                yield f"{board.submission(name)}, {board.verification(name)}: {HISTORY} adds others; one was edited."
            _require_fitting(board.info, submission, board.submission(name))
        except (PrbenchError, OSError) as error:
            yield str(error)
    entries = list(board.standing.values())
    for place, entry in enumerate(entries):
        for other in entries[:place]:
            if shared := entry.shared_with(other):
                yield f"{board.submission(entry.id)}: has the {shared} of {other.id}. Withdraw one of the two."


def _require_fitting(info: BoardInfo, submission: Submission, folder: Path) -> None:
    """Refuse a submission that follows other rules, is on other tables, or holds what a licence keeps."""
    if (submission.benchmark, submission.protocol_digest) != (info.benchmark, info.protocol):
        expected = f"{info.benchmark} under protocol {info.protocol[:12]}…"
        found = f"{clean(submission.benchmark)} under {submission.protocol_digest[:12]}…"
        raise RunError(f"{submission.id}: expected {expected}, found {found}.")
    datasets = {each.dataset: each for each in info.datasets}
    for name, record in submission.runs.items():
        run = RunFolder.open(folder / RUNS / name, any_benchmark=True)
        for table in record.tables:
            ours = datasets.get(table.dataset)
            if ours is None or ours.identity != table.identity_digest:
                known = ", ".join(f"{each.dataset} {each.identity[:12]}…" for each in info.datasets)
                found = f"{clean(table.dataset)} {table.identity_digest[:12]}…"
                raise RunError(f"{submission.id}, run {name}: expected the board's tables ({known}), found {found}.")
            holds = record.method.kind == CONTROL and record.method.name in HOLDS_RECORDINGS
            if holds or DatasetSummary.read(run.dataset(table.dataset).path).hands_in_recordings:
                what = f"run {name} of {submission.id}"
                require_may_pass_on(ours, what, submission.permission, published=True)


def _with_pages(board: BoardFolder) -> BoardFolder:
    """Write the pages, each whole or not at all."""
    for name, content in pages_of(board).items():
        write_bytes(board.path / name, content)
    return board


def _clear_leftovers(path: Path) -> None:
    """Delete what a killed command has left half-written in a board."""
    for left in sorted(path.rglob(".*.partial*")):
        if left.relative_to(path).parts[0] == ".git":
            continue
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
        else:
            left.unlink(missing_ok=True)
